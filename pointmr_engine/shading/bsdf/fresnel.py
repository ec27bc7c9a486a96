"""Reflectance of interfaces: dielectric, Schlick remapped to an f0, metal with an edge tint (F82)."""

from __future__ import annotations

import math

from pointmr_engine.numerics.jit import device


@device
def dielectric_polarized(cos_i, eta):
    """Reflectance of both polarisations and the refracted cosine, of light meeting relative index eta.

    -> (Rs, Rp, cos_t, sign of rs, sign of rp); cos_t is negative, on the other side; 0 under total reflection.
    """
    cos_i = abs(cos_i)
    square = eta * eta - (1.0 - cos_i * cos_i)
    if square <= 0.0:
        return 1.0, 1.0, 0.0, 1.0, 1.0
    g = math.sqrt(square)  # eta * |cos_t|
    cos_t = g / eta
    rs = (cos_i - g) / (cos_i + g)
    rp = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    return rs * rs, rp * rp, -cos_t, 1.0 if rs >= 0.0 else -1.0, 1.0 if rp >= 0.0 else -1.0


@device
def dielectric(cos_i, eta):
    """Reflectance of unpolarised light -> (R, cos_t), see `dielectric_polarized`."""
    rs, rp, cos_t, _, _ = dielectric_polarized(cos_i, eta)
    return 0.5 * (rs + rp), cos_t


@device
def f0_of_ior(ior):
    """Reflectance at normal incidence."""
    r = (ior - 1.0) / (ior + 1.0)
    return r * r


@device
def ior_of_f0(f0):
    """Index of refraction above 1 with reflectance f0 at normal incidence (f0 up to 0.99)."""
    root = math.sqrt(min(max(f0, 0.0), 0.99))
    return (1.0 + root) / (1.0 - root)


@device
def remap(reflectance, f0):
    """Where a reflectance lies between f0 and 1, in 0..1."""
    if f0 >= 1.0:
        return 1.0
    return min(max((reflectance - f0) / (1.0 - f0), 0.0), 1.0)


@device
def dielectric_average(eta):
    """Cosine-weighted mean reflectance of a dielectric: the fit of Kulla and Conty (2017)."""
    if eta < 1.0:
        return 0.997118 + eta * (0.1014 - eta * (0.965241 + eta * 0.130607))
    return (eta - 1.0) / (4.08567 + 1.00071 * eta)


@device
def f82_term(f0, tint):
    """The factor b of F(c) = Schlick(c) - b c (1-c)^6, so that F = tint * Schlick at the cosine 1/7 (82 degrees)."""
    f = 6.0 / 7.0
    f5 = f * f * f * f * f
    return (f0 + (1.0 - f0) * f5) * (7.0 / (f5 * f)) * (1.0 - tint)


@device
def f82(cos_i, f0, b):
    """Metallic reflectance of one channel."""
    s = min(max(1.0 - cos_i, 0.0), 1.0)
    s5 = s * s * s * s * s
    return min(max(f0 + (1.0 - f0) * s5 - b * cos_i * s5 * s, 0.0), 1.0)


@device
def f82_average(f0, b):
    """Cosine-weighted mean of `f82`."""
    return f0 + (1.0 - f0) / 21.0 - b / 126.0
