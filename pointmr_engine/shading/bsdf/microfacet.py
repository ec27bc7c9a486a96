"""Microfacet reflection and refraction: GGX and Beckmann, Smith's height-correlated masking, visible normals.

Normals are stored in single precision, so the distributions take squared sine and cosine of the half vector
from a cross and a dot product: 1 - cos^2 would lose everything at low roughness.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf.fresnel import dielectric, f0_of_ior, f82, remap
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    ANISOTROPIC,
    BECKMANN,
    F0,
    FILM_IOR,
    FILM_THICKNESS,
    FRESNEL_DIELECTRIC,
    FRESNEL_F82,
    FRESNEL_SCHLICK,
    IOR,
    KIND_MASK,
    NORMAL,
    REFLECTION,
    REFRACTION,
    SINGULAR_LOBE,
    TANGENT,
    THIN_FILM,
    TINT,
    TRANSMISSION_TINT,
)
from pointmr_engine.shading.bsdf.thin_film import film_reflectance
from pointmr_engine.shading.bsdf.vector import basis, combine, cross, dot, load3, mean, normalized, to_world

IOR_MATCHED = 1e-4  # closer to 1, refraction goes straight on
_BLACK = (0.0, 0.0, 0.0)
_WHITE = (1.0, 1.0, 1.0)


@device
def fresnel(kind, data, i, j, film_table, cos_i):
    """(reflectance rgb, transmittance rgb, refracted cosine) of lobe j's facets met at cosine cos_i."""
    base = kind & KIND_MASK
    ior = np.float64(data[i, j, IOR])
    cos_t = 0.0
    film = _WHITE
    if kind & THIN_FILM:
        metallic = (kind & FRESNEL_F82) != 0
        thickness = np.float64(data[i, j, FILM_THICKNESS])
        film_ior = np.float64(data[i, j, FILM_IOR])
        f0 = load3(data, i, j, F0)
        edge = load3(data, i, j, TINT)
        film, cos_t = film_reflectance(film_table, cos_i, thickness, film_ior, ior, metallic, f0, edge)
    if kind & FRESNEL_SCHLICK:
        f0 = load3(data, i, j, F0)
        f0_real = f0_of_ior(ior)
        if kind & THIN_FILM:
            fr = _scaled_film(film[0], f0[0], f0_real)
            fg = _scaled_film(film[1], f0[1], f0_real)
            fb = _scaled_film(film[2], f0[2], f0_real)
        else:
            real, cos_t = dielectric(cos_i, ior)
            s = remap(real, f0_real)
            fr = f0[0] + (1.0 - f0[0]) * s
            fg = f0[1] + (1.0 - f0[1]) * s
            fb = f0[2] + (1.0 - f0[2]) * s
        tint = load3(data, i, j, TINT)
        reflectance = (fr * tint[0], fg * tint[1], fb * tint[2])
        tint = load3(data, i, j, TRANSMISSION_TINT)
        transmittance = ((1.0 - fr) * tint[0], (1.0 - fg) * tint[1], (1.0 - fb) * tint[2])
    elif kind & FRESNEL_F82:
        reflectance = film
        if not kind & THIN_FILM:
            f0 = load3(data, i, j, F0)
            b = load3(data, i, j, TINT)
            reflectance = (f82(cos_i, f0[0], b[0]), f82(cos_i, f0[1], b[1]), f82(cos_i, f0[2], b[2]))
        transmittance = _BLACK
    elif kind & FRESNEL_DIELECTRIC:
        f, cos_t = dielectric(cos_i, ior)
        reflectance = (f, f, f)
        transmittance = (1.0 - f, 1.0 - f, 1.0 - f)
    else:
        reflectance = _WHITE
        transmittance = _WHITE
        if base != REFLECTION:
            f, cos_t = dielectric(cos_i, ior)
            if f == 1.0:  # total reflection, which a lobe that only refracts does not have
                transmittance = _BLACK
    if base == REFLECTION:
        transmittance = _BLACK
    elif base == REFRACTION:
        reflectance = _BLACK
    return reflectance, transmittance, cos_t


@device
def _scaled_film(film, f0, f0_real):
    """Film reflectance scaled by the wanted f0, the more the nearer it is to the dielectric's own."""
    if f0_real <= 1e-5 or film >= 1.0:
        return film
    s = min(max((film - 1.0) / (f0_real - 1.0), 0.0), 1.0)
    return min(film * (1.0 + s * (f0 / f0_real - 1.0)), 1.0)


@device
def smith_lambda(beckmann, square):
    """Smith's auxiliary function; square = (alpha tan)^2."""
    if not beckmann:
        return 0.5 * (math.sqrt(1.0 + square) - 1.0)
    if square < 0.39:
        return 0.0
    a = 1.0 / math.sqrt(square)  # Walter's rational fit
    return ((0.396 * a - 1.259) * a + 1.0) / ((2.181 * a + 3.535) * a)


@device
def distribution(beckmann, x2, y2, z2, alpha2):
    """Normal distribution; x2, y2 are the half vector's tangential components over alpha, squared, z2 its cosine's."""
    if beckmann:
        return math.exp(-(x2 + y2) / z2) / (math.pi * alpha2 * z2 * z2) if z2 > 0.0 else 0.0
    d = x2 + y2 + z2
    return 1.0 / (math.pi * alpha2 * d * d)


@device
def evaluate(kind, data, i, j, film_table, wi, wo):
    """Lobe j between two directions, without its weight: (BSDF * |cos| rgb, pdf, transmitted).

    As in Cycles, rough refraction is not limited to half vectors that refract one direction into the other, so that
    it is brighter than its samples where it scatters widely (by 3 % at roughness 0.6 and perpendicular view).
    """
    base = kind & KIND_MASK
    normal = load3(data, i, j, NORMAL)
    cos_ni = dot(normal, wi)
    cos_no = dot(normal, wo)
    transmitted = cos_no < 0.0
    if cos_ni <= 0.0 or kind & SINGULAR_LOBE or base == (REFLECTION if transmitted else REFRACTION):
        return _BLACK, 0.0, transmitted
    ior = np.float64(data[i, j, IOR])
    if transmitted:
        if abs(ior - 1.0) < IOR_MATCHED:
            return _BLACK, 0.0, transmitted
        half = combine(-ior, wo, -1.0, wi)
    else:
        half = combine(1.0, wi, 1.0, wo)
    length2 = dot(half, half)
    if not length2 > 0.0:
        return _BLACK, 0.0, transmitted
    length = math.sqrt(length2)
    cos_hi = dot(half, wi) / length
    reflectance, transmittance, _ = fresnel(kind, data, i, j, film_table, cos_hi)
    mean_r = mean(reflectance)
    mean_t = mean(transmittance)
    if not mean_r + mean_t > 0.0:
        return _BLACK, 0.0, transmitted

    beckmann = (kind & BECKMANN) != 0
    alpha_x = np.float64(data[i, j, ALPHA_X])
    alpha_y = np.float64(data[i, j, ALPHA_Y])
    alpha2 = alpha_x * alpha_y
    cos_nh = dot(normal, half)
    z2 = cos_nh * cos_nh
    if kind & ANISOTROPIC and not transmitted:
        x = load3(data, i, j, TANGENT)
        y = cross(normal, x)
        hx = dot(x, half)
        hy = dot(y, half)
        total = hx * hx + hy * hy + z2
        hx /= alpha_x
        hy /= alpha_y
        d = distribution(beckmann, hx * hx / total, hy * hy / total, z2 / total, alpha2)
        ix = alpha_x * dot(x, wi)
        iy = alpha_y * dot(y, wi)
        ox = alpha_x * dot(x, wo)
        oy = alpha_y * dot(y, wo)
        lambda_i = smith_lambda(beckmann, (ix * ix + iy * iy) / (cos_ni * cos_ni))
        lambda_o = (
            smith_lambda(beckmann, (ox * ox + oy * oy) / (cos_no * cos_no)) if cos_no != 0.0 else math.inf
        )
    else:
        across = cross(normal, half)
        sin2 = dot(across, across)
        total = sin2 + z2
        d = distribution(beckmann, sin2 / (total * alpha2), 0.0, z2 / total, alpha2)
        lambda_i = smith_lambda(beckmann, alpha2 * max(1.0 / (cos_ni * cos_ni) - 1.0, 0.0))
        lambda_o = (
            smith_lambda(beckmann, alpha2 * max(1.0 / (cos_no * cos_no) - 1.0, 0.0))
            if cos_no != 0.0
            else math.inf
        )

    common = d / cos_ni
    if transmitted:
        common *= ior * ior / length2 * abs(cos_hi * dot(half, wo) / length)
        chance = mean_t / (mean_r + mean_t)
        f = transmittance
    else:
        common *= 0.25
        chance = mean_r / (mean_r + mean_t)
        f = reflectance
    pdf = common * chance / (1.0 + lambda_i)
    common /= 1.0 + lambda_i + lambda_o
    return (f[0] * common, f[1] * common, f[2] * common), pdf, transmitted


@device
def sample(kind, data, i, j, film_table, wi, u, u1, u2):
    """A direction of lobe j: (wo, refracted, singular, f rgb, chance); chance 0: none.

    f and chance (of this side) are meant for singular directions; others are for `evaluate`.
    """
    normal = normalized(load3(data, i, j, NORMAL), _BLACK)
    cos_ni = dot(normal, wi)
    if cos_ni <= 0.0:
        return wi, False, False, _BLACK, 0.0
    singular = (kind & SINGULAR_LOBE) != 0
    half = normal
    if not singular:
        if kind & ANISOTROPIC:
            x = load3(data, i, j, TANGENT)
            y = cross(normal, x)
        else:
            x, y = basis(normal)
        alpha_x = np.float64(data[i, j, ALPHA_X])
        alpha_y = np.float64(data[i, j, ALPHA_Y])
        local = (dot(x, wi), dot(y, wi), cos_ni)
        if kind & BECKMANN:
            h = _visible_beckmann(local, alpha_x, alpha_y, u1, u2)
        else:
            h = _visible_ggx(local, alpha_x, alpha_y, u1, u2)
        half = to_world(h[0], h[1], h[2], x, y, normal)
    cos_hi = dot(half, wi)
    reflectance, transmittance, cos_t = fresnel(kind, data, i, j, film_table, cos_hi)
    mean_r = mean(reflectance)
    mean_t = mean(transmittance)
    if not mean_r + mean_t > 0.0:
        return wi, False, False, _BLACK, 0.0
    chance = mean_r / (mean_r + mean_t)
    refracted = u >= chance
    if refracted:
        ior = np.float64(data[i, j, IOR])
        wo = combine(cos_hi / ior + cos_t, half, -1.0 / ior, wi)
        chance = 1.0 - chance
        f = transmittance
        singular = singular or abs(ior - 1.0) < IOR_MATCHED
    else:
        wo = combine(2.0 * cos_hi, half, -1.0, wi)
        f = reflectance
    wo = normalized(wo, wi)
    return wo, refracted, singular, f, chance


@device
def _visible_ggx(wi, alpha_x, alpha_y, u1, u2):
    """A visible normal of GGX: a spherical cap, unstretched (Dupuy and Benyoub 2023)."""
    v = normalized((alpha_x * wi[0], alpha_y * wi[1], wi[2]), (0.0, 0.0, 1.0))
    phi = 2.0 * math.pi * u1
    z = (1.0 - u2) * (1.0 + v[2]) - v[2]
    sine = math.sqrt(max(1.0 - z * z, 0.0))
    x = alpha_x * (sine * math.cos(phi) + v[0])
    y = alpha_y * (sine * math.sin(phi) + v[1])
    return normalized((x, y, max(z + v[2], 0.0)), (0.0, 0.0, 1.0))


@device
def _inverse_erf(y):
    """Inverse error function: Winitzki's estimate, two Newton steps."""
    y = min(max(y, -0.9999999), 0.9999999)
    w = math.log(1.0 - y * y)
    t = 2.0 / (math.pi * 0.147) + 0.5 * w
    x = math.copysign(math.sqrt(max(math.sqrt(t * t - w / 0.147) - t, 0.0)), y)
    for _ in range(2):
        x -= (math.erf(x) - y) * math.exp(x * x) * 0.5 * math.sqrt(math.pi)
    return x


@device
def _visible_beckmann(wi, alpha_x, alpha_y, u1, u2):
    """A visible normal of Beckmann: the slope's distribution inverted by guarded Newton steps (Jakob 2014)."""
    v = normalized((alpha_x * wi[0], alpha_y * wi[1], wi[2]), (0.0, 0.0, 1.0))
    sine = math.sqrt(v[0] * v[0] + v[1] * v[1])
    if sine < 1e-4:
        radius = math.sqrt(-math.log(max(1.0 - u1, 1e-300)))
        phi = 2.0 * math.pi * u2
        slope_x = radius * math.cos(phi)
        slope_y = radius * math.sin(phi)
    else:
        tangent = sine / v[2]
        top = math.erf(1.0 / tangent)
        k = tangent / math.sqrt(math.pi)
        target = u1 * (1.0 + top + k * math.exp(-1.0 / (tangent * tangent)))
        # b = erf(slope) in (-1, top); the distribution's integral up to b is 1 + b + k exp(-slope^2), increasing
        low = -1.0
        high = top
        b = 0.5 * (low + high)
        slope = 0.0
        for _ in range(24):
            slope = _inverse_erf(b)
            error = 1.0 + b + k * math.exp(-slope * slope) - target
            if abs(error) < 1e-9:
                break
            if error > 0.0:
                high = b
            else:
                low = b
            derivative = 1.0 - slope * tangent
            step = b - error / derivative if derivative > 1e-9 else low
            b = step if low < step < high else 0.5 * (low + high)
        across = _inverse_erf(2.0 * u2 - 1.0)
        c = v[0] / sine
        s = v[1] / sine
        slope_x = c * slope - s * across
        slope_y = s * slope + c * across
    return normalized((-alpha_x * slope_x, -alpha_y * slope_y, 1.0), (0.0, 0.0, 1.0))
