"""BSDF lobes: leaves and view become lobes, which are evaluated and sampled.

Per batch: `reset(lobes, view)`, then `append(...)` for every leaf of every material's points, then per point
the njit functions `evaluate` and `sample`. Directions point away from the surface: `wi` to the viewer, `wo` to
the light; both are tuples of three floats. Values are BSDF times |cos|.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pointmr_engine.shading.bsdf.albedo_tables import Tables
from pointmr_engine.shading.bsdf.layout import (  # noqa: F401  (the public names of lobes)
    COLUMN_COUNT,
    HAS_DIFFUSE,
    HAS_EVALUATION,
    HAS_SINGULAR,
    HAS_TRANSMISSION,
    LABEL_DIFFUSE,
    LABEL_GLOSSY,
    LABEL_NONE,
    LABEL_REFLECT,
    LABEL_SINGULAR,
    LABEL_TRANSMIT,
    LABEL_TRANSPARENT,
    Lobes,
    View,
)
from pointmr_engine.shading.leaves import Leaf


def allocate(n: int, max_lobes: int, tables: Tables) -> Lobes:
    """Room for n points of up to max_lobes lobes each (a Principled leaf needs up to 7, any other leaf 1)."""


def reset(lobes: Lobes, view: View, bump_correction: bool = True) -> None:
    """Empty the first len(view.incoming) points and note their normals."""


def append(
    lobes: Lobes,
    leaf: Leaf,
    rows: np.ndarray,
    view: View,
    tables: Tables,
    reflective_caustics: bool = True,
    refractive_caustics: bool = True,
) -> None:
    """Expand a leaf into lobes of the points `rows` ((m,) integers, rows of view and lobes).

    The leaf's block and normals have m rows (the block may have 1). Weights and parameters are clamped as Cycles
    does; non-finite weights drop the lobe. A point without room for another lobe keeps what it has.
    """


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate(lobes, i, wi, wo):
    """All lobes of point i between two directions -> (diffuse rgb, glossy rgb, transmission rgb, pdf).

    Each rgb is a tuple, BSDF * |cos|; their sum is the total. pdf is that of `sample`, per solid angle, with the
    chance of choosing each lobe (transparency included). Singular lobes contribute nothing.
    """


@njit(cache=True, nogil=True, error_model="numpy")
def sample(lobes, i, wi, u_choose, u1, u2):
    """Choose a lobe of point i and a direction -> (wo, value rgb, pdf, label, alpha, eta).

    value / pdf is the throughput: for a lobe with an extent, value is the sum of all lobes and pdf that of
    `evaluate`; for LABEL_SINGULAR and LABEL_TRANSPARENT both are relative to a delta (only the ratio counts, weight
    of multiple importance sampling 1). LABEL_NONE or pdf 0: absorbed. alpha: the sampled lobe's GGX alpha (1
    diffuse, 0 singular); eta: relative index of refraction of a refracted direction, else 1.
    """
