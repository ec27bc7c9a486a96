"""Rays within lobes: which lobes take one instead of a cone, and directions drawn from the lobes as they are."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf.layout import (
    ASHIKHMIN_SHIRLEY,
    IOR,
    KIND_MASK,
    NORMAL,
    REFLECTION,
    SINGULAR_LOBE,
    WEIGHT,
)
from pointmr_engine.shading.bsdf.microfacet import IOR_MATCHED, evaluate, sample
from pointmr_engine.shading.bsdf.vector import dot, load3, row3

# roughness (GGX alpha) above which lobes take rays, at one cone a pixel: their cones would be too wide. With more
# cones it is less, as the rays' noise is and the cones' bias is not
ROUGH = 0.15


@device
def takes_ray(lobes, k, j, rough, limit, largest, small, strong):
    """Whether a lobe of throughput `largest` takes a ray by chance instead of a cone. limit: ROUGH, for these cones."""
    kind = lobes.kind[k, j]
    if kind & SINGULAR_LOBE or kind & KIND_MASK == ASHIKHMIN_SHIRLEY:
        return False
    if kind & KIND_MASK != REFLECTION and abs(np.float64(lobes.data[k, j, IOR]) - 1.0) < IOR_MATCHED:
        return False
    return small or largest < strong or rough > limit


@device
def draw_direction(lobes, k, j, wi, transmitted, u, v):
    """A direction of lobe j of point k on one side, by its visible facets, and (rgb) BSDF * cosine / density there.

    The weight is 0 where there is no such direction.
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
        return wo, none
    f, pdf, _ = evaluate(kind, lobes.data, k, j, lobes.film_table, wi, wo)
    if not pdf > 0.0:
        return wo, none
    w, scale = load3(lobes.data, k, j, WEIGHT), chance / pdf
    return wo, (w[0] * f[0] * scale, w[1] * f[1] * scale, w[2] * f[2] * scale)
