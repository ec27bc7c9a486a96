"""Tables of directional albedos: energy compensation, layering, sheen, thin films. Built by `build_tables.py`."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit

PATH = Path(__file__).with_name("tables.npz")


class Tables(NamedTuple):
    """Precomputed albedos, float32, C order.

    Axes are evenly spaced in 0..1: roughness (square root of GGX alpha), cosine of the view, and
    z = sqrt(|ior - 1| / (ior + 1)).
    """

    ggx: np.ndarray  # (32 cosine, 32 roughness) albedo of reflecting GGX
    ggx_average: np.ndarray  # (32 roughness,) its cosine-weighted mean
    glass: np.ndarray  # (2: ior above or below 1, 16 z, 16 cosine, 16 roughness) albedo of GGX glass
    glass_average: np.ndarray  # (2, 16 z, 16 roughness)
    schlick_dielectric: np.ndarray  # (16 z, 16 cosine, 16 roughness) mean mix of f0 and 1, dielectric curve
    schlick: np.ndarray  # (16 cosine, 16 roughness) the same for Schlick's fifth power
    sheen: np.ndarray  # (3: a, b, albedo; 32 roughness; 32 cosine)
    film: np.ndarray  # (6: re rgb, im rgb; m) spectral sensitivities over the optical path difference


@lru_cache(maxsize=1)
def load_tables() -> Tables:
    """The tables shipped with the package (read once). Raises FileNotFoundError if the package lacks them."""
    with np.load(PATH) as file:
        return Tables(*(np.ascontiguousarray(file[name], np.float32) for name in Tables._fields))


@njit(cache=True, nogil=True, error_model="numpy")
def _position(x, size):
    x = min(max(x, 0.0), 1.0) * (size - 1)
    k = min(int(x), max(size - 2, 0))
    return k, x - k


@njit(cache=True, nogil=True, error_model="numpy")
def lookup1(table, x):
    """Linear interpolation; x in 0..1, clamped."""
    k, t = _position(x, table.shape[0])
    return (1.0 - t) * table[k] + t * table[k + 1]


@njit(cache=True, nogil=True, error_model="numpy")
def lookup2(table, y, x):
    """Bilinear interpolation; x along the last axis."""
    k, t = _position(y, table.shape[0])
    return (1.0 - t) * lookup1(table[k], x) + t * lookup1(table[k + 1], x)


@njit(cache=True, nogil=True, error_model="numpy")
def lookup3(table, z, y, x):
    """Trilinear interpolation."""
    k, t = _position(z, table.shape[0])
    return (1.0 - t) * lookup2(table[k], y, x) + t * lookup2(table[k + 1], y, x)
