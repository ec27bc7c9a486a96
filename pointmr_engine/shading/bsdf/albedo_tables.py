"""Tables of directional albedos: energy compensation, layering, sheen, thin films. Built by `build_tables.py`."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import device

PATH = Path(__file__).with_name("tables.npz")
ONLY = np.int64(0)  # the variant of tables that have one
SHEEN_A, SHEEN_B, SHEEN_ALBEDO = np.arange(3)


class Tables(NamedTuple):
    """Precomputed albedos, float32, C order. The first axis, where there are variants, chooses one.

    The other axes are evenly spaced in 0..1: roughness (square root of GGX alpha), cosine of the view, and
    z = sqrt(|ior - 1| / (ior + 1)).
    """

    ggx: np.ndarray  # (1, 32 cosine, 32 roughness) albedo of reflecting GGX
    ggx_average: np.ndarray  # (1, 1, 32 roughness) its cosine-weighted mean
    glass: np.ndarray  # (2: ior above or below 1, 16 z, 16 cosine, 16 roughness) albedo of GGX glass
    glass_average: np.ndarray  # (2, 16 z, 16 roughness)
    # (1, 16 z, 16 cosine, 16 roughness) mean mix of f0 and 1, dielectric curve
    schlick_dielectric: np.ndarray
    schlick: np.ndarray  # (1, 16 cosine, 16 roughness) the same for Schlick's fifth power
    sheen: np.ndarray  # (3: a, b, albedo; 32 roughness; 32 cosine)
    film: np.ndarray  # (6: re rgb, im rgb; m) spectral sensitivities over the optical path difference


@lru_cache(maxsize=1)
def load_tables() -> Tables:
    """The tables shipped with the package (read once). Raises FileNotFoundError if the package lacks them."""
    with np.load(PATH) as file:
        return Tables(*(np.ascontiguousarray(file[name], np.float32) for name in Tables._fields))


@device
def _position(x, size):
    """Index and fraction of x in 0..1 among evenly spaced entries."""
    x = min(max(x, 0.0), 1.0) * (size - 1)
    k = min(int(x), max(size - 2, 0))
    return k, x - k


@device
def lookup2(table, variant, y, x):
    """Bilinear interpolation in one variant; x along the last axis; both clamped to 0..1."""
    k, t = _position(y, table.shape[1])
    m, u = _position(x, table.shape[2])
    n = min(k + 1, table.shape[1] - 1)
    low = (1.0 - u) * table[variant, k, m] + u * table[variant, k, m + 1]
    high = (1.0 - u) * table[variant, n, m] + u * table[variant, n, m + 1]
    return (1.0 - t) * low + t * high


@device
def lookup3(table, variant, z, y, x):
    """Trilinear interpolation in one variant."""
    h, s = _position(z, table.shape[1])
    k, t = _position(y, table.shape[2])
    m, u = _position(x, table.shape[3])
    total = 0.0
    for corner in range(8):
        a = corner & 1
        b = (corner >> 1) & 1
        c = corner >> 2
        w = (u if a else 1.0 - u) * (t if b else 1.0 - t) * (s if c else 1.0 - s)
        total += w * table[variant, h + c, k + b, m + a]
    return total
