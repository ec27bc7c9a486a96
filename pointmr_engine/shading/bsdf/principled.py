"""The Principled BSDF as layers of lobes, from the top: sheen, coat, then metal, glass, or specular over diffuse.

Each layer takes its estimated albedo from what lies below (Blender 4 and later). Subsurface scattering is a
diffuse lobe.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.shading.bsdf import diffuse
from pointmr_engine.shading.bsdf.fresnel import f0_of_ior, f82_term, ior_of_f0
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    ANISOTROPIC,
    F0,
    FILM_IOR,
    FILM_THICKNESS,
    FRESNEL_DIELECTRIC,
    FRESNEL_F82,
    FRESNEL_SCHLICK,
    GLASS,
    IOR,
    LAMBERT,
    NORMAL,
    OREN_NAYAR,
    REFLECTION,
    TANGENT,
    THIN_FILM,
    TINT,
    TRANSMISSION_TINT,
    WEIGHT_CUTOFF,
)
from pointmr_engine.shading.bsdf.setup import (
    below,
    finish_diffuse,
    finish_microfacet,
    push,
    set_alpha,
    valid_normal,
)
from pointmr_engine.shading.bsdf.sheen_lobe import push_sheen
from pointmr_engine.shading.bsdf.vector import (
    combine,
    dot,
    multiply,
    normalized,
    rotate_about,
    row3,
    scale,
    store3,
    tangent_towards,
)
from pointmr_engine.shading.leaves import COLUMNS, PRINCIPLED

_C = {name: k for k, name in enumerate(COLUMNS[PRINCIPLED])}
_BASE = _C["base_color_r"]
_METALLIC = _C["metallic"]
_ROUGHNESS = _C["roughness"]
_IOR = _C["ior"]
_ALPHA = _C["alpha"]
_DIFFUSE_ROUGHNESS = _C["diffuse_roughness"]
_SUBSURFACE = _C["subsurface_weight"]
_SPECULAR_LEVEL = _C["specular_ior_level"]
_SPECULAR_TINT = _C["specular_tint_r"]
_ANISOTROPIC = _C["anisotropic"]
_ROTATION = _C["anisotropic_rotation"]
_TRANSMISSION = _C["transmission_weight"]
_COAT = _C["coat_weight"]
_COAT_ROUGHNESS = _C["coat_roughness"]
_COAT_IOR = _C["coat_ior"]
_COAT_TINT = _C["coat_tint_r"]
_SHEEN = _C["sheen_weight"]
_SHEEN_ROUGHNESS = _C["sheen_roughness"]
_SHEEN_TINT = _C["sheen_tint_r"]
_EMISSION = _C["emission_r"]
_FILM = _C["thin_film_thickness"]
_FILM_IOR = _C["thin_film_ior"]

FILM_CUTOFF = 0.1  # nanometres
_WHITE = (1.0, 1.0, 1.0)
_ASK = (-1.0, -1.0, -1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _unit(x):
    return min(max(np.float64(x), 0.0), 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _positive3(block, r, column):
    return (
        max(np.float64(block[r, column]), 0.0),
        max(np.float64(block[r, column + 1]), 0.0),
        max(np.float64(block[r, column + 2]), 0.0),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _at_most_one(c):
    return min(c[0], 1.0), min(c[1], 1.0), min(c[2], 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _coat(lobes, i, tables, wi, normal, weight, block, r, reflective):
    """Add the coat -> the weight left below it, tint included."""
    strength = max(np.float64(block[r, _COAT]), 0.0)
    ior = max(np.float64(block[r, _COAT_IOR]), 1.0)
    normal = valid_normal(lobes, i, wi, normal)
    under = weight
    if reflective:
        j = push(lobes, i, REFLECTION | FRESNEL_DIELECTRIC, scale(strength, weight), normal)
        if j >= 0:
            alpha = _unit(block[r, _COAT_ROUGHNESS])
            lobes.data[i, j, IOR] = ior
            set_alpha(lobes, i, j, alpha * alpha, alpha * alpha)
            under = below(finish_microfacet(lobes, i, j, tables, wi, True, _ASK), weight)
    tint = _positive3(block, r, _COAT_TINT)
    if tint[0] != 1.0 or tint[1] != 1.0 or tint[2] != 1.0:
        # absorption along the refracted view ray, normalised to perpendicular view
        cos_ni = dot(wi, normal)
        depth = 1.0 / math.sqrt(1.0 - (1.0 - cos_ni * cos_ni) / (ior * ior))
        under = (
            under[0] * (1.0 + strength * (tint[0] ** depth - 1.0)),
            under[1] * (1.0 + strength * (tint[1] ** depth - 1.0)),
            under[2] * (1.0 + strength * (tint[2] ** depth - 1.0)),
        )
    return under


@njit(cache=True, nogil=True, error_model="numpy")
def _set_facets(lobes, i, j, alpha_x, alpha_y, anisotropic, tangent, film, film_ior):
    """Roughness, tangent and film of a lobe."""
    data = lobes.data
    if anisotropic:
        lobes.kind[i, j] |= ANISOTROPIC
        normal = (
            np.float64(data[i, j, NORMAL]),
            np.float64(data[i, j, NORMAL + 1]),
            np.float64(data[i, j, NORMAL + 2]),
        )
        store3(data, i, j, TANGENT, tangent_towards(normal, tangent))
    if film > FILM_CUTOFF:
        lobes.kind[i, j] |= THIN_FILM
        data[i, j, FILM_THICKNESS] = film
        data[i, j, FILM_IOR] = film_ior
    set_alpha(lobes, i, j, alpha_x, alpha_y)


@njit(cache=True, nogil=True, error_model="numpy")
def _base_diffuse(lobes, i, wi, normal, weight, base, block, r):
    """The bottom: diffuse, with subsurface scattering as Lambert."""
    subsurface = _unit(block[r, _SUBSURFACE])
    roughness = _unit(block[r, _DIFFUSE_ROUGHNESS])
    smooth = roughness < WEIGHT_CUTOFF
    share = scale(1.0 - subsurface, multiply(base, weight))
    if subsurface > WEIGHT_CUTOFF:
        below_surface = scale(subsurface, multiply(_at_most_one(base), weight))
        if smooth:
            share = combine(1.0, share, 1.0, below_surface)
        else:
            j = push(lobes, i, LAMBERT, below_surface, normal)
            if j >= 0:
                finish_diffuse(lobes, i, j)
    j = push(lobes, i, LAMBERT if smooth else OREN_NAYAR, share, normal)
    if j >= 0:
        if not smooth:
            a, b, multiple = diffuse.setup(roughness, base, dot(normal, wi))
            lobes.data[i, j, ALPHA_X] = a
            lobes.data[i, j, ALPHA_Y] = b
            store3(lobes.data, i, j, F0, multiple)
        finish_diffuse(lobes, i, j)


@njit(cache=True, nogil=True, error_model="numpy")
def _point(
    lobes, i, tables, wi, backfacing, normal, coat_normal, tangent, block, r, reflective, refractive, multiple
):
    """Expand one Principled leaf at point i."""
    data = lobes.data
    weight = _positive3(block, r, 0)
    base = _positive3(block, r, _BASE)
    color = _at_most_one(base)
    ior = max(np.float64(block[r, _IOR]), 1e-5)
    roughness = _unit(block[r, _ROUGHNESS])
    tint = _positive3(block, r, _SPECULAR_TINT)
    film = np.float64(block[r, _FILM])
    film_ior = max(np.float64(block[r, _FILM_IOR]), 1e-5)
    alpha_x = roughness * roughness
    alpha_y = alpha_x
    anisotropy = _unit(block[r, _ANISOTROPIC])
    anisotropic = anisotropy > 0.0 and dot(tangent, tangent) > 0.0
    if anisotropic:
        aspect = math.sqrt(1.0 - 0.9 * anisotropy)
        alpha_x /= aspect
        alpha_y *= aspect
        rotation = np.float64(block[r, _ROTATION])
        if rotation != 0.0:
            tangent = rotate_about(tangent, normal, 2.0 * math.pi * rotation)
    lifted = valid_normal(lobes, i, wi, normal)

    opacity = _unit(block[r, _ALPHA])
    if opacity < 1.0:
        for c in range(3):
            lobes.transparency[i, c] += weight[c] * (1.0 - opacity)
        weight = scale(opacity, weight)

    coat = max(np.float64(block[r, _COAT]), 0.0)
    strength = max(np.float64(block[r, _SHEEN]), 0.0)
    if strength > WEIGHT_CUTOFF:
        share = min(coat, 1.0)
        top = normalized(combine(1.0 - share, normal, share, coat_normal), normal)
        fuzz = scale(strength, multiply(_positive3(block, r, _SHEEN_TINT), weight))
        weight = below(push_sheen(lobes, i, tables, wi, top, fuzz, _unit(block[r, _SHEEN_ROUGHNESS])), weight)
    if coat > WEIGHT_CUTOFF:
        weight = _coat(lobes, i, tables, wi, coat_normal, weight, block, r, reflective)
    for c in range(3):
        lobes.emission[i, c] += np.float64(block[r, _EMISSION + c]) * weight[c]

    metallic = _unit(block[r, _METALLIC])
    if metallic > WEIGHT_CUTOFF:
        if reflective:
            j = push(lobes, i, REFLECTION | FRESNEL_F82, scale(metallic, weight), lifted)
            if j >= 0:
                data[i, j, IOR] = 1.0
                store3(data, i, j, F0, color)
                edge = (
                    f82_term(color[0], min(tint[0], 1.0)),
                    f82_term(color[1], min(tint[1], 1.0)),
                    f82_term(color[2], min(tint[2], 1.0)),
                )
                store3(data, i, j, TINT, edge)
                _set_facets(lobes, i, j, alpha_x, alpha_y, anisotropic, tangent, film, film_ior)
                finish_microfacet(lobes, i, j, tables, wi, multiple, _ASK)
        weight = scale(1.0 - metallic, weight)

    transmission = _unit(block[r, _TRANSMISSION])
    if transmission > WEIGHT_CUTOFF:
        if reflective or refractive:
            j = push(lobes, i, GLASS | FRESNEL_SCHLICK, scale(transmission, weight), lifted)
            if j >= 0:
                data[i, j, IOR] = 1.0 / ior if backfacing else ior
                store3(data, i, j, F0, _at_most_one(scale(f0_of_ior(ior), tint)))
                shown = 1.0 if reflective else 0.0
                store3(data, i, j, TINT, (shown, shown, shown))
                shown = 1.0 if refractive else 0.0
                store3(
                    data,
                    i,
                    j,
                    TRANSMISSION_TINT,
                    (shown * math.sqrt(color[0]), shown * math.sqrt(color[1]), shown * math.sqrt(color[2])),
                )
                inner = film_ior / ior if backfacing else film_ior
                _set_facets(
                    lobes, i, j, roughness * roughness, roughness * roughness, False, tangent, film, inner
                )
                finish_microfacet(lobes, i, j, tables, wi, multiple, _ASK)
        weight = scale(1.0 - transmission, weight)

    eta = ior
    f0 = f0_of_ior(ior)
    level = max(np.float64(block[r, _SPECULAR_LEVEL]), 0.0)
    if level != 0.5:
        f0 *= 2.0 * level
        eta = ior_of_f0(f0)
        if ior < 1.0:
            eta = 1.0 / eta
    if reflective and (eta != 1.0 or film > FILM_CUTOFF):
        j = push(lobes, i, REFLECTION | FRESNEL_SCHLICK, weight, lifted)
        if j >= 0:
            data[i, j, IOR] = eta
            store3(data, i, j, F0, _at_most_one(scale(f0, tint)))
            store3(data, i, j, TINT, _WHITE)
            store3(data, i, j, TRANSMISSION_TINT, (0.0, 0.0, 0.0))
            _set_facets(lobes, i, j, alpha_x, alpha_y, anisotropic, tangent, film, film_ior)
            weight = below(finish_microfacet(lobes, i, j, tables, wi, multiple, _ASK), weight)
    _base_diffuse(lobes, i, wi, normal, weight, base, block, r)


@njit(cache=True, nogil=True, error_model="numpy")
def append(
    lobes, rows, view, tables, block, normals, coat_normals, tangents, reflective, refractive, multiple
):
    """Expand Principled leaves at the points `rows`; arrays of one row serve all, zero normals mean the point's."""
    for k in range(rows.shape[0]):
        i = rows[k]
        r = k if block.shape[0] > 1 else 0
        wi = row3(view.incoming, i)
        ns = row3(view.normal, i)
        normal = normalized(row3(normals, k if normals.shape[0] > 1 else 0), ns)
        coat_normal = normalized(row3(coat_normals, k if coat_normals.shape[0] > 1 else 0), ns)
        tangent = row3(tangents, k if tangents.shape[0] > 1 else 0)
        free = not view.diffuse_ray[i]
        _point(
            lobes,
            i,
            tables,
            wi,
            view.backfacing[i],
            normal,
            coat_normal,
            tangent,
            block,
            r,
            reflective or free,
            refractive or free,
            multiple,
        )
