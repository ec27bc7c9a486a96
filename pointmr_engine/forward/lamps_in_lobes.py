"""Lamps as narrow lobes see them: what share of a lobe's directions meets the lamp.

A lobe that is narrower than what one point of a lamp stands for would show these points, a dot each. So directions are
spread evenly over the lobe instead: where all of them meet the lamp, its light is exact, and its edge is as sharp as
the lobe.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.rng import R2
from pointmr_engine.raytracing.lamps import intersect_lamp, lamp_pdf_scale
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    ASHIKHMIN_SHIRLEY,
    GLASS,
    KIND_MASK,
    NORMAL,
    REFRACTION,
    SINGULAR_LOBE,
    TRANSLUCENT,
    WEIGHT,
)
from pointmr_engine.shading.bsdf.microfacet import evaluate, sample
from pointmr_engine.shading.bsdf.vector import dot, load3, row3

DIRECTIONS = 16  # in a lobe; the next point's go on in the same sequence
NARROW = 32.0  # squared roughnesses in a lamp's solid angle from which a lobe sees it by itself
REACH = 12.0  # roughnesses from a lamp's middle, and
BALL = 1.6  # ... its radius, if it were round: how far from it lobes may look; farther away they change little over it


@device
def _sees(lobes, k, j, wi, direction, solid):
    """Whether lobe j of point k is narrow for a lamp of so many steradians, and looks near it."""
    kind = lobes.kind[k, j]
    base = kind & KIND_MASK
    if base <= TRANSLUCENT or base == ASHIKHMIN_SHIRLEY or base == REFRACTION or base == GLASS:
        return False
    a, b = np.float64(lobes.data[k, j, ALPHA_X]), np.float64(lobes.data[k, j, ALPHA_Y])
    if kind & SINGULAR_LOBE or NARROW * a * b > solid:
        return False
    normal = load3(lobes.data, k, j, NORMAL)
    cosine = 2.0 * dot(normal, wi) * dot(normal, direction) - dot(wi, direction)
    return math.acos(min(max(cosine, -1.0), 1.0)) < BALL * math.sqrt(solid / math.pi) + REACH * max(a, b)


@device
def lamp_in_lobes(lobes, k, wi, lamps, i, px, py, pz, direction, solid, number):
    """(r, g, b, lobes): light of lamp i, all of which arrives at p, that narrow lobes of point k send to the viewer.

    direction, solid: of the lamp's middle, its solid angle; number: of the point, by which it has directions of its
    own; lobes: bits of those that are meant, for which nothing else is to be asked.
    """
    r = g = b = 0.0
    bits = np.int64(0)
    plane, normal = row3(lobes.geometric_normal, k), row3(lobes.normal, k)
    for j in range(np.int64(lobes.count[k])):
        if not _sees(lobes, k, np.int64(j), wi, direction, solid):
            continue
        bits |= np.int64(1) << np.int64(j)
        facing, weight = load3(lobes.data, k, j, NORMAL), load3(lobes.data, k, j, WEIGHT)
        for s in range(DIRECTIONS):
            at = DIRECTIONS * number + s + 0.5
            u, v = (at * R2[0]) % 1.0, (at * R2[1]) % 1.0
            kind = lobes.kind[k, j]
            wo, _, _, _, chance = sample(kind, lobes.data, k, j, lobes.film_table, wi, 0.0, u, v)
            if not chance > 0.0 or dot(facing, wo) <= 0.0 or dot(plane, wo) <= 0.0:
                continue
            t = intersect_lamp(lamps, i, px, py, pz, wo[0], wo[1], wo[2])
            if not t > 0.0:
                continue
            _, scale = lamp_pdf_scale(
                lamps, i, px, py, pz, normal[0], normal[1], normal[2], False, wo[0], wo[1], wo[2], t
            )
            f, pdf, _ = evaluate(kind, lobes.data, k, j, lobes.film_table, wi, wo)
            if pdf > 0.0:
                scale *= chance / (pdf * DIRECTIONS)
                r += weight[0] * f[0] * scale
                g += weight[1] * f[1] * scale
                b += weight[2] * f[2] * scale
    return r * lamps.radiance[i, 0], g * lamps.radiance[i, 1], b * lamps.radiance[i, 2], bits


@device
def hide_lobes(lobes, k, bits):
    """Leave the lobes `bits` of point k out of what is evaluated, until they are widened again."""
    for j in range(np.int64(lobes.count[k])):
        if (bits >> np.int64(j)) & 1:
            lobes.kind[k, j] |= SINGULAR_LOBE
