"""Sheen of cloth fibres: a cosine lobe warped by a linear transform (Zeltner, Burley, Chiang 2022)."""

from __future__ import annotations

import math

from pointmr_engine.numerics.jit import device


@device
def evaluate(a, b, x, y, z):
    """Density of direction (x, y, z) in the frame whose x is toward the viewer; also BSDF * cos per unit weight."""
    if z <= 0.0:
        return 0.0
    u = a * x + b * z
    v = a * y
    ratio = a / (u * u + v * v + z * z)
    return z * ratio * ratio / math.pi


@device
def sample(a, b, u1, u2):
    """A local direction of that density."""
    radius = math.sqrt(u1)
    phi = 2.0 * math.pi * u2
    z = math.sqrt(max(1.0 - u1, 0.0))
    x = radius * math.cos(phi) - z * b
    y = radius * math.sin(phi)
    z *= a
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return 0.0, 0.0, 1.0
    return x / length, y / length, z / length
