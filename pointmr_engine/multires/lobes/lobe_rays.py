"""Rays within lobes: which lobes take one instead of a cone, and directions drawn from the lobes as they are."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf.glossy import evaluate, sample
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    GLASS,
    IOR,
    KIND_MASK,
    NORMAL,
    REFRACTION,
    SAMPLE,
    SINGULAR_LOBE,
    TRANSLUCENT,
    WEIGHT,
)
from pointmr_engine.shading.bsdf.microfacet import IOR_MATCHED
from pointmr_engine.shading.bsdf.vector import dot, load3, row3
from pointmr_engine.shading.lobes import value_of

# roughness (GGX alpha) above which lobes take rays, at one cone a pixel: their cones would be too wide. With more
# cones it is less, as the rays' noise is and the cones' bias is not
ROUGH = 0.15
LONG = 1.5  # times as rough along as across: a cone, which is round, is not the lobe
# rays of a first surface's lobe: so many for all of the light, up to MOST. A bright place that one ray in many meets is
# most of the noise where little else shines, as at rims, and these rays are few against shadow rays
EACH, MOST = 64.0, 4


@device
def rays_of(throughput, small):
    """How many rays the lobe of a first surface takes; small: it weighs too little for more than one."""
    return np.int64(1) if small else min(max(np.int64(EACH * throughput), np.int64(1)), np.int64(MOST))


@device
def takes_ray(lobes, k, j, rough, limit, largest, small, strong):
    """Whether a lobe of throughput `largest` takes a ray by chance instead of a cone. limit: ROUGH, for these cones."""
    kind = lobes.kind[k, j]
    refracts = kind & KIND_MASK == REFRACTION or kind & KIND_MASK == GLASS
    if kind & SINGULAR_LOBE or (refracts and abs(np.float64(lobes.data[k, j, IOR]) - 1.0) < IOR_MATCHED):
        return False
    x, y = np.float64(lobes.data[k, j, ALPHA_X]), np.float64(lobes.data[k, j, ALPHA_Y])
    return small or largest < strong or rough > limit or max(x, y) > LONG * min(x, y)


@device
def draw_direction(lobes, k, j, wi, transmitted, u, v):
    """A direction of lobe j of point k on one side, by its visible facets.

    Returns (direction, (rgb) BSDF * cosine / density, the lobe's own density there, its chance of this side); the
    weight is 0 where there is no such direction. The lobe's own density counts both sides.
    """
    kind = lobes.kind[k, j]
    none = (0.0, 0.0, 0.0)
    # which side is given: samples are told so by the first number
    wo, refracted, singular, _, chance = sample(
        kind, lobes.data, k, j, lobes.film_table, wi, 0.9999999999 if transmitted else 0.0, u, v
    )
    normal = load3(lobes.data, k, j, NORMAL)
    if (
        not chance > 0.0
        or singular
        or refracted != transmitted
        or (dot(normal, wo) < 0.0) != transmitted
        or (dot(row3(lobes.geometric_normal, k), wo) < 0.0) != transmitted
    ):
        return wo, none, 0.0, 0.0
    f, pdf, _ = evaluate(kind, lobes.data, k, j, lobes.film_table, wi, wo)
    if not pdf > 0.0:
        return wo, none, 0.0, 0.0
    w, scale = load3(lobes.data, k, j, WEIGHT), chance / pdf
    return wo, (w[0] * f[0] * scale, w[1] * f[1] * scale, w[2] * f[2] * scale), pdf, chance


@device
def behind_glossy(lobes, k, j, wi, wo, weight, density, side):
    """Factors (rgb) of what surfaces reflect that lie in direction wo, drawn from lobe j of point k with `weight`.

    density: of lobe j there; side: its chance to reflect (draw_direction). Paths are told apart by the lobe that
    chance chose, and a glossy one carries what all lobes reflect: so a part of what diffuse surfaces send each other
    arrives although they may not bounce, and what chance gives to diffuse lobes of glossy light does not (as in Cycles,
    and in `distributed`). Here it is as much, without that chance. What shines itself is the lobe's alone, for light
    samples bring it to diffuse ones.
    """
    own = np.float64(lobes.data[k, j, SAMPLE])
    pdf, by_diffuse = own * density, 0.0  # times the sum of all chances
    r, g, b = 0.0, 0.0, 0.0
    for i in range(np.int64(lobes.count[k])):
        if i == j:
            continue
        chance = np.float64(lobes.data[k, i, SAMPLE])
        f, chosen, _ = value_of(lobes, k, np.int64(i), wi, wo, False)
        pdf += chance * chosen
        base = lobes.kind[k, i] & KIND_MASK
        if base <= TRANSLUCENT:
            r, g, b = r + f[0], g + f[1], b + f[2]
        if base < TRANSLUCENT:
            by_diffuse += chance * max(dot(load3(lobes.data, k, i, NORMAL), wo), 0.0) / math.pi
    if not pdf > 0.0:
        return 1.0, 1.0, 1.0
    kept, added = max(1.0 - by_diffuse / pdf, 0.0), own * side / pdf
    return (
        kept + r * added / weight[0] if weight[0] > 0.0 else 1.0,
        kept + g * added / weight[1] if weight[1] > 0.0 else 1.0,
        kept + b * added / weight[2] if weight[2] > 0.0 else 1.0,
    )
