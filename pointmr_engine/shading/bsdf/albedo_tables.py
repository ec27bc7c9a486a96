"""Tables of directional albedos: energy compensation, layering, sheen. Built by `build_tables.py`."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np


class Tables(NamedTuple):
    """Precomputed albedos, float32. Axes: roughness (sqrt of alpha), cosine, z = sqrt(|ior - 1| / (ior + 1))."""

    ggx: np.ndarray  # (32 cosine, 32 roughness) albedo of reflecting GGX
    ggx_average: np.ndarray  # (32 roughness,)
    glass: np.ndarray  # (2: ior above or below 1, 16 z, 16 cosine, 16 roughness) albedo of GGX glass
    glass_average: np.ndarray  # (2, 16 z, 16 roughness)
    schlick_dielectric: np.ndarray  # (16 z, 16 cosine, 16 roughness) mean mix of f0 and 1, dielectric
    schlick: np.ndarray  # (16 cosine, 16 roughness) the same for Schlick's fifth power
    sheen: np.ndarray  # (3: a, b, albedo; 32 roughness; 32 cosine)
    film: np.ndarray  # (6: re rgb, im rgb; m) spectral sensitivities against optical path difference


@lru_cache(maxsize=1)
def load_tables() -> Tables:
    """The tables shipped with the package (read once)."""
