"""Iridescence of a thin film over a dielectric or a metal (Belcour and Barla 2017).

The reflectance is a series over the bounces inside the film; each term meets the eye through the Fourier
transform of the colour matching functions, tabulated against the optical path difference (`Tables.film`).
"""

from __future__ import annotations

import math

from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf.fresnel import dielectric_polarized, f82

TABLE_RANGE = 60000.0 / (2.0 * math.pi)  # nanometres of optical path difference at the table's end
_BOUNCES = 4  # terms of the series; higher ones are invisible


@device
def film_reflectance(table, cos_i, thickness, film_ior, ior, metallic, f0, b):
    """(reflectance rgb, refracted cosine below the film, negative) of a film `thickness` nanometres thick.

    Below it lies a dielectric of index `ior`, or where `metallic` a metal given by rgb f0 and edge term b.
    """
    n = film_ior
    if thickness < 1.0:  # waves do not see so thin a film: fade it out
        t = max(thickness, 0.0)
        n = 1.0 + (film_ior - 1.0) * t * t * (3.0 - 2.0 * t)
    s12, p12, cos_2, sign_s, sign_p = dielectric_polarized(cos_i, n)
    if s12 == 1.0 and p12 == 1.0:
        return (1.0, 1.0, 1.0), 0.0
    s23, p23, cos_3, s_re, p_re = dielectric_polarized(-cos_2, ior / n)
    s_im = 0.0
    p_im = 0.0
    if not metallic and s23 == 1.0 and p23 == 1.0:
        return (1.0, 1.0, 1.0), 0.0
    path = -2.0 * n * thickness * cos_2
    red = green = 0.0
    for channel in range(3):
        if metallic:
            s23, s_re, s_im, p_re, p_im = _metal_below(n, -cos_2, f0[channel], b[channel])
            p23 = s23
        total = 0.0
        for polarization in range(2):
            if polarization == 0:
                total += _series(table, channel, s12, s23, path, -sign_s * s_re, -sign_s * s_im)
            else:
                total += _series(table, channel, p12, p23, path, -sign_p * p_re, -sign_p * p_im)
        total = min(max(0.5 * total, 0.0), 1.0)
        if channel == 0:
            red = total
        elif channel == 1:
            green = total
    return (red, green, total), cos_3


@device
def _series(table, channel, r12, r23, path, phase_re, phase_im):
    """One channel, one polarisation: reflectances above and below the film, phase shift as a unit phasor."""
    t121 = 1.0 - r12
    r123 = r12 * r23
    amplitude = math.sqrt(r123)
    rs = t121 * t121 * r23 / (1.0 - r123) if r123 < 1.0 else 0.0
    total = rs + r12
    c = rs - t121
    re = phase_re
    im = phase_im
    last = table.shape[1] - 1
    for m in range(1, _BOUNCES):
        c *= amplitude
        x = min(max(m * path / TABLE_RANGE, 0.0), 1.0) * last
        k = min(int(x), last - 1)
        t = x - k
        s_re = (1.0 - t) * table[channel, k] + t * table[channel, k + 1]
        s_im = (1.0 - t) * table[channel + 3, k] + t * table[channel + 3, k + 1]
        total += 2.0 * c * (re * s_re + im * s_im)
        re, im = re * phase_re - im * phase_im, re * phase_im + im * phase_re
    return total


@device
def _metal_below(n1, c, f0, b):
    """Reflectance and phase shifts (unit phasors of s, then p) of one channel of a metal under a film of index n1.

    The metal's complex index follows from f0 and the reflectance at 82 degrees (Gulbrandsen); c: cosine in the film.
    """
    r = min(f0, 0.999)
    edge = f82(1.0 / 7.0, f0, b)
    root = math.sqrt(max(r, 0.0))
    n_max = (1.0 + root) / (1.0 - root)
    n2 = n_max + ((1.0 - r) / (1.0 + r) - n_max) * edge
    k2 = math.sqrt(max((r * (n2 + 1.0) * (n2 + 1.0) - (n2 - 1.0) * (n2 - 1.0)) / (1.0 - r), 0.0))
    # the amplitude is F82 of the index relative to the film; Fresnel's equations would lose the edge tint
    n = n2 / n1
    kk = (k2 / n1) * (k2 / n1)
    below = ((n - 1.0) * (n - 1.0) + kk) / ((n + 1.0) * (n + 1.0) + kk)
    f = 6.0 / 7.0
    f5 = f * f * f * f * f
    reflectance = f82(c, below, (7.0 / (f5 * f)) * (below + (1.0 - below) * f5 - edge))
    # phase shifts (Born and Wolf 14.4.1)
    two_nk = 2.0 * n2 * k2
    difference = n2 * n2 - k2 * k2
    t1 = difference - n1 * n1 * (1.0 - c * c)
    t2 = math.sqrt(t1 * t1 + two_nk * two_nk)
    u2 = max(0.5 * (t2 + t1), 0.0)
    v2 = max(0.5 * (t2 - t1), 0.0)
    u = math.sqrt(u2)
    v = math.sqrt(v2)
    s_re, s_im = _unit(n1 * n1 * c * c - u2 - v2, -2.0 * n1 * c * v)
    q = (n2 * n2 + k2 * k2) * c
    p_re, p_im = _unit(q * q - n1 * n1 * (u2 + v2), 2.0 * n1 * c * (two_nk * u - difference * v))
    return reflectance, s_re, s_im, p_re, p_im


@device
def _unit(re, im):
    """A complex number's direction; 1 for zero."""
    size = math.sqrt(re * re + im * im)
    if size == 0.0:
        return 1.0, 0.0
    return re / size, im / size
