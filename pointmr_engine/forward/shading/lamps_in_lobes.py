"""Lamps as narrow lobes see them: what share of a lobe's directions meets the lamp.

A lobe that is narrower than what one point of a lamp stands for would show these points, a dot each. So directions are
spread evenly over the lobe as well: where all of them meet the lamp, its light is exact, and its edge is as sharp as
the lobe. What lies in the lobe's tails, where hardly a direction goes, is left to the points (power heuristic; Veach
1997), so that the glow about a highlight has no grain.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.rng import R2
from pointmr_engine.raytracing.lamps import intersect_lamp, lamp_pdf_scale
from pointmr_engine.shading.bsdf.glossy import evaluate, sample
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    ASHIKHMIN_SHIRLEY,
    KIND_MASK,
    NORMAL,
    REFLECTION,
    SINGULAR_ALPHA_SQUARED,
    SINGULAR_LOBE,
    WEIGHT,
)
from pointmr_engine.shading.bsdf.vector import dot, load3, row3

DIRECTIONS = 16  # in a lobe; the next point's go on in the same sequence
NARROW = 32.0  # squared roughnesses in a lamp's solid angle from which a lobe sees it by itself
REACH = 12.0  # roughnesses from a lamp's middle, and
BALL = 1.6  # ... its radius, if it were round: how far from it lobes may look; farther away, points find all


@device
def narrow_lobes(lobes, k, alpha, more, solid):
    """Bits of the lobes of point k that are narrow for a lamp of so many steradians; alpha (N, L, 2): how rough, but
    for so much squared roughness `more`."""
    bits = np.int64(0)
    for j in range(np.int64(lobes.count[k])):
        rough = np.float64(alpha[k, j, 0]) * np.float64(alpha[k, j, 1]) + more
        base = lobes.kind[k, j] & KIND_MASK
        reflects = base == REFLECTION or base == ASHIKHMIN_SHIRLEY
        if reflects and rough > SINGULAR_ALPHA_SQUARED and NARROW * rough <= solid:
            bits |= np.int64(1) << np.int64(j)
    return bits


@device
def _looks_near(lobes, k, j, wi, direction, radius):
    """Whether directions of lobe j of point k may meet a lamp about `direction`, but for few of them.

    radius: of the lamp, rad, as far as it reaches if it is long.
    """
    a, b = np.float64(lobes.data[k, j, ALPHA_X]), np.float64(lobes.data[k, j, ALPHA_Y])
    normal = load3(lobes.data, k, j, NORMAL)
    cosine = 2.0 * dot(normal, wi) * dot(normal, direction) - dot(wi, direction)
    return math.acos(min(max(cosine, -1.0), 1.0)) < BALL * radius + REACH * max(a, b)


@device
def _share_of_points(pdf, solid, points):
    """What of a direction's light is left to a lamp's points, by the density `pdf` of the lobe's directions there."""
    ratio = pdf * solid * DIRECTIONS / points
    return 1.0 / (1.0 + ratio * ratio)


@device
def lamp_in_lobes(lobes, k, bits, wi, lamps, i, px, py, pz, direction, solid, longer, points, number):
    """(r, g, b): what directions of the lobes `bits` of point k find of lamp i, all of whose light arrives at p.

    direction, solid: of the lamp's middle, its solid angle, of which `points` find the rest (point_beside_lobes);
    number: of the point, by which it has directions of its own.
    """
    r = g = b = 0.0
    radius = math.sqrt(solid * longer / math.pi)
    plane, normal = row3(lobes.geometric_normal, k), row3(lobes.normal, k)
    for j in range(np.int64(lobes.count[k])):
        if not (bits >> np.int64(j)) & 1 or not _looks_near(lobes, k, np.int64(j), wi, direction, radius):
            continue
        facing, weight = load3(lobes.data, k, j, NORMAL), load3(lobes.data, k, j, WEIGHT)
        kind = lobes.kind[k, j]
        for s in range(DIRECTIONS):
            at = DIRECTIONS * number + s + 0.5
            u, v = (at * R2[0]) % 1.0, (at * R2[1]) % 1.0
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
                scale *= chance / (pdf * DIRECTIONS) * (1.0 - _share_of_points(pdf, solid, points))
                r += weight[0] * f[0] * scale
                g += weight[1] * f[1] * scale
                b += weight[2] * f[2] * scale
    return r * lamps.radiance[i, 0], g * lamps.radiance[i, 1], b * lamps.radiance[i, 2]


@device
def point_beside_lobes(lobes, k, bits, wi, wo, solid, points):
    """(r, g, b): BSDF * cosine of the lobes `bits` in the direction of one of the lamp's points, as far as it is left.

    The lobes as `hide_lobes` left them.
    """
    r = g = b = 0.0
    if dot(row3(lobes.geometric_normal, k), wo) <= 0.0:
        return r, g, b
    for j in range(np.int64(lobes.count[k])):
        if not (bits >> np.int64(j)) & 1 or dot(load3(lobes.data, k, j, NORMAL), wo) <= 0.0:
            continue
        kind = lobes.kind[k, j] & ~SINGULAR_LOBE
        f, pdf, _ = evaluate(kind, lobes.data, k, j, lobes.film_table, wi, wo)
        weight, share = load3(lobes.data, k, j, WEIGHT), _share_of_points(pdf, solid, points)
        r, g, b = r + share * weight[0] * f[0], g + share * weight[1] * f[1], b + share * weight[2] * f[2]
    return r, g, b


@device
def hide_lobes(lobes, k, alpha, more, bits):
    """Leave the lobes `bits` of point k out of what is evaluated, until they are widened; alpha, more: as above."""
    for j in range(np.int64(lobes.count[k])):
        if (bits >> np.int64(j)) & 1:
            lobes.kind[k, j] |= SINGULAR_LOBE
            for side in range(2):
                rough = np.float64(alpha[k, j, side])
                lobes.data[k, j, ALPHA_X + side] = math.sqrt(rough * rough + more)
