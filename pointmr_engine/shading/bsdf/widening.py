"""Glossy lobes as wide as the normals below them differ: half vectors vary as the normals do."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    BECKMANN,
    COAT,
    HAS_EVALUATION,
    KIND_MASK,
    MIRROR,
    SINGULAR_ALPHA_SQUARED,
    SINGULAR_LOBE,
    TRANSLUCENT,
)

FLATTEST = 1e-5  # squared roughness that is not worth telling from none, nor from rounding


@device
def is_glossy(kind):
    """Whether a lobe of this kind has a roughness."""
    return kind & KIND_MASK > TRANSLUCENT


@device
def note_mirror(lobes, i, j):
    """Remember of lobe j of point i, before it is widened, whether it is singular by its material."""
    if lobes.kind[i, j] & SINGULAR_LOBE:
        lobes.kind[i, j] = lobes.kind[i, j] | MIRROR


@device
def set_roughness(lobes, i, j, x, y, extra):
    """Give the glossy lobe j of point i the roughness x, y (GGX alpha) and `extra` squared roughness."""
    x, y = min(math.sqrt(x * x + extra), 1.0), min(math.sqrt(y * y + extra), 1.0)
    lobes.data[i, j, ALPHA_X] = x
    lobes.data[i, j, ALPHA_Y] = y
    if x * y > SINGULAR_ALPHA_SQUARED:
        lobes.kind[i, j] = lobes.kind[i, j] & ~SINGULAR_LOBE
    else:
        lobes.kind[i, j] = lobes.kind[i, j] | SINGULAR_LOBE


@uncounted
def widen_lobes(lobes, rows, first, variance, of_coat):
    """Widen the glossy lobes of the points `rows` (m,) int64, from lobe first (m,) on, by the variance of slopes below
    them: variance (m,) float32, and of_coat (m,) below coats.

    A Beckmann lobe of roughness alpha has slopes of variance alpha^2 / 2.
    """
    for k in range(len(rows)):
        i = rows[k]
        for j in range(np.int64(first[k]), np.int64(lobes.count[i])):
            kind = lobes.kind[i, j]
            extra = 2.0 * np.float64(of_coat[k] if kind & COAT else variance[k])
            if is_glossy(kind) and extra > FLATTEST:
                x, y = np.float64(lobes.data[i, j, ALPHA_X]), np.float64(lobes.data[i, j, ALPHA_Y])
                note_mirror(lobes, i, j)
                lobes.flags[i] |= HAS_EVALUATION  # a mirror no longer, which light samples are worth
                if extra > x * y:
                    lobes.kind[i, j] = lobes.kind[i, j] | BECKMANN
                set_roughness(lobes, i, j, x, y, extra)
