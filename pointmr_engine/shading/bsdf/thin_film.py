"""Iridescence of a thin film over a dielectric or a metal (Belcour and Barla 2017).

The reflectance is a series over the bounces inside the film; each term meets the eye through the Fourier
transform of the colour matching functions, tabulated against the optical path difference (`Tables.film`).
"""

from __future__ import annotations

import math

from numba import njit

from pointmr_engine.shading.bsdf.fresnel import dielectric_polarized, f82

TABLE_RANGE = 60000.0 / (2.0 * math.pi)  # nanometres of optical path difference at the table's end


@njit(cache=True, nogil=True, error_model="numpy")
def _film_index(thickness, film_ior):
    """The film's index, faded to none below a nanometre, where waves no longer see it."""
    if thickness < 1.0:
        t = max(thickness, 0.0)
        return 1.0 + (film_ior - 1.0) * t * t * (3.0 - 2.0 * t)
    return film_ior


@njit(cache=True, nogil=True, error_model="numpy")
def _sensitivity(table, channel, path):
    """Real and imaginary part of one channel's transform, interpolated."""
    last = table.shape[1] - 1
    x = min(max(path / TABLE_RANGE, 0.0), 1.0) * last
    k = min(int(x), last - 1)
    t = x - k
    re = (1.0 - t) * table[channel, k] + t * table[channel, k + 1]
    im = (1.0 - t) * table[channel + 3, k] + t * table[channel + 3, k + 1]
    return re, im


@njit(cache=True, nogil=True, error_model="numpy")
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
    for m in range(1, 4):
        c *= amplitude
        s_re, s_im = _sensitivity(table, channel, m * path)
        total += 2.0 * c * (re * s_re + im * s_im)
        re, im = re * phase_re - im * phase_im, re * phase_im + im * phase_re
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def dielectric_film(table, cos_i, thickness, film_ior, ior):
    """Reflectance rgb of a film over a dielectric, and the refracted cosine below it (negative)."""
    n = _film_index(thickness, film_ior)
    s12, p12, cos_2, sign_s12, sign_p12 = dielectric_polarized(cos_i, n)
    if s12 == 1.0 and p12 == 1.0:
        return (1.0, 1.0, 1.0), 0.0
    s23, p23, cos_3, sign_s23, sign_p23 = dielectric_polarized(-cos_2, ior / n)
    if s23 == 1.0 and p23 == 1.0:
        return (1.0, 1.0, 1.0), 0.0
    path = -2.0 * n * thickness * cos_2
    phase_s = -sign_s12 * sign_s23
    phase_p = -sign_p12 * sign_p23
    r = _series(table, 0, s12, s23, path, phase_s, 0.0) + _series(table, 0, p12, p23, path, phase_p, 0.0)
    g = _series(table, 1, s12, s23, path, phase_s, 0.0) + _series(table, 1, p12, p23, path, phase_p, 0.0)
    b = _series(table, 2, s12, s23, path, phase_s, 0.0) + _series(table, 2, p12, p23, path, phase_p, 0.0)
    return (_half_clamped(r), _half_clamped(g), _half_clamped(b)), cos_3


@njit(cache=True, nogil=True, error_model="numpy")
def _half_clamped(x):
    return min(max(0.5 * x, 0.0), 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def metallic_film(table, cos_i, thickness, film_ior, f0, b):
    """Reflectance rgb of a film over a metal given by its f0 and edge term."""
    n = _film_index(thickness, film_ior)
    s12, p12, cos_2, sign_s12, sign_p12 = dielectric_polarized(cos_i, n)
    if s12 == 1.0 and p12 == 1.0:
        return 1.0, 1.0, 1.0
    path = -2.0 * n * thickness * cos_2
    return (
        _metallic_channel(table, 0, n, s12, p12, cos_2, sign_s12, sign_p12, path, f0[0], b[0]),
        _metallic_channel(table, 1, n, s12, p12, cos_2, sign_s12, sign_p12, path, f0[1], b[1]),
        _metallic_channel(table, 2, n, s12, p12, cos_2, sign_s12, sign_p12, path, f0[2], b[2]),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _metallic_channel(table, channel, n1, s12, p12, cos_2, sign_s12, sign_p12, path, f0, b):
    """One channel: complex index from f0 and the reflectance at 82 degrees (Gulbrandsen), phases from the index."""
    r = min(f0, 0.999)
    edge = f82(1.0 / 7.0, f0, b)
    root = math.sqrt(max(r, 0.0))
    n_max = (1.0 + root) / (1.0 - root)
    n2 = n_max + ((1.0 - r) / (1.0 + r) - n_max) * edge
    k2 = math.sqrt(max((r * (n2 + 1.0) * (n2 + 1.0) - (n2 - 1.0) * (n2 - 1.0)) / (1.0 - r), 0.0))
    c = -cos_2
    # amplitudes as F82 of the index relative to the film; Fresnel's equations would lose the edge tint
    n = n2 / n1
    kk = (k2 / n1) * (k2 / n1)
    below = ((n - 1.0) * (n - 1.0) + kk) / ((n + 1.0) * (n + 1.0) + kk)
    f = 6.0 / 7.0
    f5 = f * f * f * f * f
    r23 = f82(c, below, (7.0 / (f5 * f)) * (below + (1.0 - below) * f5 - edge))
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
    s = _series(table, channel, s12, r23, path, -sign_s12 * s_re, -sign_s12 * s_im)
    p = _series(table, channel, p12, r23, path, -sign_p12 * p_re, -sign_p12 * p_im)
    return _half_clamped(s + p)


@njit(cache=True, nogil=True, error_model="numpy")
def _unit(re, im):
    size = math.sqrt(re * re + im * im)
    if size == 0.0:
        return 1.0, 0.0
    return re / size, im / size
