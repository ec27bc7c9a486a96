"""Adding a sheen lobe to a point."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf.albedo_tables import SHEEN_A, SHEEN_ALBEDO, SHEEN_B, lookup2
from pointmr_engine.shading.bsdf.layout import ALPHA_X, ALPHA_Y, SAMPLE, SHEEN, TANGENT, WEIGHT
from pointmr_engine.shading.bsdf.setup import drop, finish_diffuse, push
from pointmr_engine.shading.bsdf.vector import dot, load3, scale, store3, tangent_towards


@device
def push_sheen(lobes, i, tables, wi, normal, weight, roughness):
    """Add sheen of that weight -> what it takes from the layers below."""
    j = push(lobes, i, SHEEN, weight, normal)
    if j < 0:
        return 0.0, 0.0, 0.0
    roughness = min(max(roughness, 1e-3), 1.0)
    cos_ni = dot(normal, wi)
    a = lookup2(tables.sheen, SHEEN_A, roughness, cos_ni)
    b = lookup2(tables.sheen, SHEEN_B, roughness, cos_ni)
    albedo = lookup2(tables.sheen, SHEEN_ALBEDO, roughness, cos_ni)
    if abs(a) < 1e-5 or albedo < 1e-5:
        drop(lobes, i)
        return 0.0, 0.0, 0.0
    lobes.data[i, j, ALPHA_X] = a
    lobes.data[i, j, ALPHA_Y] = b
    store3(lobes.data, i, j, TANGENT, tangent_towards(normal, wi))
    store3(lobes.data, i, j, WEIGHT, scale(albedo, load3(lobes.data, i, j, WEIGHT)))
    lobes.data[i, j, SAMPLE] = np.float64(lobes.data[i, j, SAMPLE]) * albedo
    finish_diffuse(lobes, i, j)
    return load3(lobes.data, i, j, WEIGHT)
