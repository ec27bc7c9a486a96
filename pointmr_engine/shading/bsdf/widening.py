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
    COLUMN_COUNT,
    HAS_EVALUATION,
    KIND_MASK,
    MIRROR,
    NORMAL,
    SINGULAR_ALPHA_SQUARED,
    SINGULAR_LOBE,
    TRANSLUCENT,
    WEIGHT,
)
from pointmr_engine.shading.bsdf.setup import single_scattering
from pointmr_engine.shading.bsdf.vector import dot, load3, row3

# difference of roughnesses, in parts of their mean, that is worth another lobe; of a coat, which has a roughness of its
# own, none is known
UNEVEN = 0.3
LEAST = 0.05  # of the mean roughness that what is smooth has at least
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


@device
def widen_keeping_light(lobes, i, j, extra, tables, wi):
    """Give the glossy lobe j of point i `extra` squared roughness, and the light along wi that it had: normals that
    differ hide no light from each other, as facets of one roughness do. tables: albedo_tables.Tables.
    """
    kind, cosine = lobes.kind[i, j], dot(load3(lobes.data, i, j, NORMAL), wi)
    x, y = np.float64(lobes.data[i, j, ALPHA_X]), np.float64(lobes.data[i, j, ALPHA_Y])
    before = single_scattering(kind, lobes.data, i, j, tables, cosine)
    set_roughness(lobes, i, j, x, y, extra)
    _scale_weight(lobes, i, j, before / single_scattering(kind, lobes.data, i, j, tables, cosine))


@device
def _scale_weight(lobes, i, j, share):
    """Leave lobe j of point i this share of its weight."""
    for c in range(4):  # WEIGHT, SAMPLE
        lobes.data[i, j, WEIGHT + c] *= np.float32(share)


@uncounted
def widen_lobes(lobes, rows, first, variance, of_coat, chance):
    """Widen the glossy lobes of the points `rows` (m,) int64, from lobe first (m,) on, by the variance of slopes below
    them: variance (m,) float32, and of_coat (m,) below coats.

    A Beckmann lobe of roughness alpha has slopes of variance alpha^2 / 2. The normals' slopes have no tails, but those
    of a GGX lobe stay what they are, however its peak is blurred, and go by alpha^2: of lobes so much wider, as large a
    part stay GGX as alpha^2 is of the new one, by chance (m,) float64, 0..1, and the others become Beckmann.
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
                if not chance[k] * (x * y + extra) < x * y:
                    lobes.kind[i, j] = lobes.kind[i, j] | BECKMANN
                set_roughness(lobes, i, j, x, y, extra)


@uncounted
def filter_glossy(lobes, rows, density, most):
    """Make glossy lobes of the points `rows` (m,) int64 rougher that paths see by way of rough surfaces.

    density (m,) float32: least density per solid angle of a direction on the way (RayState.density); below `most` of
    them lobes are widened, to a GGX alpha of up to 1/2, so that light samples find lamps that such paths hardly meet.
    As Cycles' Filter Glossy.
    """
    for k in range(len(rows)):
        i, share = rows[k], np.float64(density[k]) / most
        if not share < 1.0:
            continue
        alpha = 0.5 * math.sqrt(1.0 - share)
        for j in range(np.int64(lobes.count[i])):
            if is_glossy(lobes.kind[i, j]):
                x, y = np.float64(lobes.data[i, j, ALPHA_X]), np.float64(lobes.data[i, j, ALPHA_Y])
                set_roughness(lobes, i, j, max(x, alpha), max(y, alpha), 0.0)
                lobes.flags[i] |= HAS_EVALUATION


@device
def _rougher(lobes, i, j, times, share, tables, cosine, compensated):
    """Leave lobe j of point i this share of its weight, and `times` its roughness; cosine: of its normal to the viewer,
    compensated: what facets lose to each other is added to the weight."""
    kind, before = lobes.kind[i, j], 1.0
    if compensated:
        before = single_scattering(kind, lobes.data, i, j, tables, cosine)
    x, y = np.float64(lobes.data[i, j, ALPHA_X]), np.float64(lobes.data[i, j, ALPHA_Y])
    set_roughness(lobes, i, j, times * times * x, times * times * y, 0.0)
    if compensated:
        share *= before / single_scattering(kind, lobes.data, i, j, tables, cosine)
    _scale_weight(lobes, i, j, share)


@uncounted
def split_lobes(lobes, rows, first, pairs, incoming, tables, compensated):
    """Make two of glossy lobes whose roughness differs, of the points `rows` (m,) int64, from lobe first (m,) on.

    pairs (3, m) float32: the roughnesses of both, in parts of the lobe's own, and the weight of the first: one lobe of
    the mean roughness has neither the tails of what is rough nor the peak of what is smooth. A point without room
    keeps it. incoming (N, 3) to the viewer; tables: albedo_tables.Tables; compensated: see `_rougher`.
    """
    room = np.int64(lobes.kind.shape[1])
    for k in range(len(rows)):
        i, less, more = np.int64(rows[k]), max(np.float64(pairs[0, k]), LEAST), np.float64(pairs[1, k])
        if not more - less > UNEVEN:
            continue
        part, wi = np.float64(pairs[2, k]), row3(incoming, i)
        for j in range(np.int64(first[k]), np.int64(lobes.count[i])):
            kind, new = lobes.kind[i, j], np.int64(lobes.count[i])
            if not is_glossy(kind) or kind & (COAT | SINGULAR_LOBE) or new == room:
                continue
            lobes.count[i] += 1
            lobes.kind[i, new] = kind
            for c in range(COLUMN_COUNT):
                lobes.data[i, new, c] = lobes.data[i, j, c]
            cosine = dot(load3(lobes.data, i, j, NORMAL), wi)
            _rougher(lobes, i, j, less, part, tables, cosine, compensated)
            _rougher(lobes, i, new, more, 1.0 - part, tables, cosine, compensated)
