"""The anisotropic Phong model of Ashikhmin and Shirley (2000), without its Fresnel term."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf.layout import ALPHA_X, ALPHA_Y, ANISOTROPIC, NORMAL, TANGENT
from pointmr_engine.shading.bsdf.vector import basis, combine, cross, dot, load3, normalized, to_world

_LOOKS = 4  # per side, of directions whose mean is the albedo


@device
def _exponents(data, i, j):
    x = np.float64(data[i, j, ALPHA_X])
    y = np.float64(data[i, j, ALPHA_Y])
    return 2.0 / (x * x) - 2.0, 2.0 / (y * y) - 2.0


@device
def evaluate(kind, data, i, j, wi, wo):
    """BSDF * cos per unit weight (grey), and pdf."""
    normal = load3(data, i, j, NORMAL)
    cos_ni = dot(normal, wi)
    cos_no = dot(normal, wo)
    if cos_ni < 0.0 or cos_no < 0.0:
        return 0.0, 0.0
    cos_ni = max(cos_ni, 1e-6)
    cos_no = max(cos_no, 1e-6)
    half = normalized(combine(1.0, wi, 1.0, wo), normal)
    cos_hi = max(abs(dot(half, wi)), 1e-6)
    nx, ny = _exponents(data, i, j)
    across = cross(normal, half)
    sin2 = dot(across, across)
    exponent = nx
    if kind & ANISOTROPIC and sin2 > 0.0:
        x = load3(data, i, j, TANGENT)
        hx = dot(half, x)
        hy = dot(half, cross(normal, x))
        exponent = (nx * hx * hx + ny * hy * hy) / sin2
    # cos^n through the sine: the cosine itself has no digits left at high exponents
    lobe = math.exp(0.5 * exponent * math.log1p(-min(sin2, 1.0 - 1e-12)))
    lobe *= math.sqrt((nx + 1.0) * (ny + 1.0)) / (8.0 * math.pi)
    pdf = lobe / cos_hi
    return cos_no * lobe / (cos_hi * max(cos_ni, cos_no)), pdf


@device
def sample(kind, data, i, j, wi, u1, u2):
    """A direction, valid or not: the caller checks its side."""
    normal = normalized(load3(data, i, j, NORMAL), wi)
    nx, ny = _exponents(data, i, j)
    phi = 2.0 * math.pi * u1
    if kind & ANISOTROPIC:
        x = load3(data, i, j, TANGENT)
        y = cross(normal, x)
        ratio = math.sqrt((nx + 1.0) / (ny + 1.0))
        phi = math.atan2(ratio * math.sin(phi), math.cos(phi))
    else:
        x, y = basis(normal)
    c = math.cos(phi)
    s = math.sin(phi)
    # 1 - u2^(1/(n+1)) without cancellation
    exponent = math.log(max(u2, 1e-300)) / (nx * c * c + ny * s * s + 1.0)
    cosine = math.exp(exponent)
    sine = math.sqrt(max(-math.expm1(2.0 * exponent), 0.0))
    half = to_world(sine * c, sine * s, cosine, x, y, normal)
    return normalized(combine(2.0 * dot(half, wi), half, -1.0, wi), wi)


@device
def albedo(kind, data, i, j, wi):
    """What the lobe reflects of even light, seen along wi, per unit weight (grey)."""
    normal = load3(data, i, j, NORMAL)
    cos_ni, total = dot(normal, wi), 0.0
    for b in range(_LOOKS):
        for a in range(_LOOKS):
            wo = sample(kind, data, i, j, wi, (a + 0.5) / _LOOKS, (b + 0.5) / _LOOKS)
            cos_no = dot(normal, wo)
            if cos_no > 0.0:
                total += min(cos_no / max(cos_ni, 1e-6), 1.0)  # the value over its density
    return total / (_LOOKS * _LOOKS)
