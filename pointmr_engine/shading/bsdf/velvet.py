"""Velvet of Ashikhmin, Premoze and Shirley (2000): an inverted Gaussian of microfacets, standing rather than lying."""

from __future__ import annotations

import math

from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf.vector import basis, combine, dot, normalized, to_world

_MIRROR = 1.0 - 1e-5  # half vectors nearer to the normal than this have no facets to speak of


@device
def evaluate(sharpness, normal, wi, wo):
    """BSDF * cos per unit weight (grey), and pdf; sharpness is 1 / sigma^2."""
    cos_ni = dot(normal, wi)
    cos_no = dot(normal, wo)
    if not (cos_ni > 0.0 and cos_no > 0.0):
        return 0.0, 0.0
    pdf = 0.5 / math.pi
    half = normalized(combine(1.0, wi, 1.0, wo), normal)
    cos_nh = dot(normal, half)
    cos_hi = dot(half, wi)
    if not (cos_nh < _MIRROR and cos_hi > 1e-5):
        return 0.0, pdf
    cos2 = cos_nh * cos_nh
    sin2 = 1.0 - cos2
    facets = math.exp(-sharpness * cos2 / sin2) * sharpness / (math.pi * sin2 * sin2)
    # V-shaped grooves shadow and mask
    visible = min(1.0, 2.0 * cos_nh * min(cos_ni, cos_no) / cos_hi)
    return 0.25 * facets * visible / cos_ni, pdf


@device
def sample(normal, u1, u2):
    """A direction above the surface, all of them equally likely."""
    radius = math.sqrt(max(u1 * (2.0 - u1), 0.0))
    phi = 2.0 * math.pi * u2
    x, y = basis(normal)
    return to_world(radius * math.cos(phi), radius * math.sin(phi), 1.0 - u1, x, y, normal)
