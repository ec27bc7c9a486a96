"""Energy-preserving Oren-Nayar: Fujii's form with the multiple scattering of OpenPBR. Lambert needs no file."""

from __future__ import annotations

import math

from pointmr_engine.numerics.jit import device


@device
def single_albedo(a, b, cos_v):
    """Directional albedo of the single-scattering part."""
    if cos_v < 1e-6:  # tan grows without bound: first-order expansion
        g = (0.5 * math.pi - 2.0 / 3.0) - cos_v
    else:
        sine = math.sqrt(max(1.0 - cos_v * cos_v, 0.0))
        g = sine * (math.acos(min(cos_v, 1.0)) - 2.0 / 3.0 - sine * cos_v)
        g += 2.0 / 3.0 * (sine / cos_v) * (1.0 - sine * sine * sine)
    return a * math.pi + b * g


@device
def setup(roughness, color, cos_v):
    """Coefficients a, b and the multiple-scattering rgb (without the factor of the light direction)."""
    sigma = min(max(roughness, 0.0), 1.0)
    a = 1.0 / (math.pi + sigma * (0.5 * math.pi - 2.0 / 3.0))
    b = sigma * a
    average = a * math.pi + ((2.0 * math.pi - 5.6) / 3.0) * b
    missing_v = max(1.0 - single_albedo(a, b, max(cos_v, 0.0)), 0.0)
    common = missing_v * average / (math.pi * (1.0 - average)) if average < 1.0 else 0.0
    r = min(max(color[0], 0.0), 1.0)
    g = min(max(color[1], 0.0), 1.0)
    bl = min(max(color[2], 0.0), 1.0)
    missing = 1.0 - average
    return (
        a,
        b,
        (
            common * r * r / (1.0 - r * missing),
            common * g * g / (1.0 - g * missing),
            common * bl * bl / (1.0 - bl * missing),
        ),
    )


@device
def evaluate(a, b, multiple, cos_v, cos_l, cos_vl):
    """BSDF * cos per unit colour, rgb; cosines of view, light and between them."""
    cos_v = max(cos_v, 0.0)
    t = cos_vl - cos_l * cos_v
    if t > 0.0:
        t /= max(cos_l, cos_v, 1e-30)
    single = max(a + b * t, 0.0)
    missing = max(1.0 - single_albedo(a, b, cos_l), 0.0)
    return (
        cos_l * (single + multiple[0] * missing),
        cos_l * (single + multiple[1] * missing),
        cos_l * (single + multiple[2] * missing),
    )
