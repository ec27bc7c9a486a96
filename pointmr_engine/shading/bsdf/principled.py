"""The Principled BSDF as layers of lobes, from the top: sheen, coat, then metal, glass, or specular over diffuse.

Each layer takes its estimated albedo from what lies below (Blender 4 and later). Subsurface scattering is a
diffuse lobe.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.shading.bsdf import diffuse
from pointmr_engine.shading.bsdf.fresnel import f0_of_ior, f82_term, ior_of_f0
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    ANISOTROPIC,
    COAT,
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
    load3,
    multiply,
    normalized,
    positive3,
    rotate_about,
    row3,
    scale,
    store3,
    tangent_towards,
    unit_interval,
)
from pointmr_engine.shading.leaves import COLUMNS, PRINCIPLED

_C = {name: np.int64(k) for k, name in enumerate(COLUMNS[PRINCIPLED])}
_WEIGHT = _C["weight_r"]
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
_LAYER_COAT, _LAYER_METAL, _LAYER_GLASS, _LAYER_SPECULAR = range(4)
_BLACK = (0.0, 0.0, 0.0)
_ASK = (-1.0, -1.0, -1.0)


@device
def _at_most_one(c):
    return min(c[0], 1.0), min(c[1], 1.0), min(c[2], 1.0)


@device
def _coat_transmittance(tint, strength, ior, cos_ni):
    """Absorption by the coat along the refracted view ray, normalised to perpendicular view."""
    depth = 1.0 / math.sqrt(1.0 - (1.0 - cos_ni * cos_ni) / (ior * ior))
    return (
        1.0 + strength * (tint[0] ** depth - 1.0),
        1.0 + strength * (tint[1] ** depth - 1.0),
        1.0 + strength * (tint[2] ** depth - 1.0),
    )


@device
def _set_facets(lobes, i, j, alpha_x, alpha_y, anisotropic, tangent, film, film_ior):
    """Roughness, tangent and film of a lobe."""
    data = lobes.data
    if anisotropic:
        lobes.kind[i, j] |= ANISOTROPIC
        store3(data, i, j, TANGENT, tangent_towards(load3(data, i, j, NORMAL), tangent))
    if film > FILM_CUTOFF:
        lobes.kind[i, j] |= THIN_FILM
        data[i, j, FILM_THICKNESS] = film
        data[i, j, FILM_IOR] = film_ior
    set_alpha(lobes, i, j, alpha_x, alpha_y)


@device
def _base_diffuse(lobes, i, wi, normal, weight, base, block, r):
    """The bottom: diffuse, with subsurface scattering as Lambert."""
    subsurface = unit_interval(block[r, _SUBSURFACE])
    roughness = unit_interval(block[r, _DIFFUSE_ROUGHNESS])
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


@uncounted
def append(
    lobes, rows, view, tables, block, normals, coat_normals, tangents, reflective, refractive, multiple
):
    """Expand Principled leaves at the points `rows`; arrays of one row serve all, zero normals mean the point's."""
    data = lobes.data
    for k in range(rows.shape[0]):
        i = rows[k]
        r = k if block.shape[0] > 1 else 0
        wi = row3(view.incoming, i)
        ns = row3(view.normal, i)
        normal = normalized(row3(normals, k if normals.shape[0] > 1 else 0), ns)
        coat_normal = normalized(row3(coat_normals, k if coat_normals.shape[0] > 1 else 0), ns)
        tangent = row3(tangents, k if tangents.shape[0] > 1 else 0)
        backfacing = view.backfacing[i]
        free = not view.diffuse_ray[i]
        reflects = reflective or free
        refracts = refractive or free
        weight = positive3(block, r, _WEIGHT)
        base = positive3(block, r, _BASE)
        color = _at_most_one(base)
        ior = max(np.float64(block[r, _IOR]), 1e-5)
        roughness = unit_interval(block[r, _ROUGHNESS])
        tint = positive3(block, r, _SPECULAR_TINT)
        film = np.float64(block[r, _FILM])
        film_ior = max(np.float64(block[r, _FILM_IOR]), 1e-5)
        alpha_x = roughness * roughness
        alpha_y = alpha_x
        anisotropy = unit_interval(block[r, _ANISOTROPIC])
        anisotropic = anisotropy > 0.0 and dot(tangent, tangent) > 0.0
        if anisotropic:
            aspect = math.sqrt(1.0 - 0.9 * anisotropy)
            alpha_x /= aspect
            alpha_y *= aspect
            rotation = np.float64(block[r, _ROTATION])
            if rotation != 0.0:
                tangent = rotate_about(tangent, normal, 2.0 * math.pi * rotation)
        lifted = valid_normal(lobes, i, wi, normal)

        opacity = unit_interval(block[r, _ALPHA])
        if opacity < 1.0:
            for c in range(3):
                lobes.transparency[i, c] += weight[c] * (1.0 - opacity)
            weight = scale(opacity, weight)

        coat = max(np.float64(block[r, _COAT]), 0.0)
        strength = max(np.float64(block[r, _SHEEN]), 0.0)
        if strength > WEIGHT_CUTOFF:
            share = min(coat, 1.0)
            top = normalized(combine(1.0 - share, normal, share, coat_normal), normal)
            fuzz = scale(strength, multiply(positive3(block, r, _SHEEN_TINT), weight))
            weight = below(
                push_sheen(lobes, i, tables, wi, top, fuzz, unit_interval(block[r, _SHEEN_ROUGHNESS])), weight
            )
        metallic = unit_interval(block[r, _METALLIC])
        transmission = unit_interval(block[r, _TRANSMISSION])
        eta = ior
        f0 = f0_of_ior(ior)
        level = max(np.float64(block[r, _SPECULAR_LEVEL]), 0.0)
        if level != 0.5:
            f0 *= 2.0 * level
            eta = ior_of_f0(f0)
            if ior < 1.0:
                eta = 1.0 / eta
        # one loop over the microfacet layers, so that their common steps are compiled once
        for layer in range(4):
            j = -1
            if layer == _LAYER_COAT:
                coat_ior = max(np.float64(block[r, _COAT_IOR]), 1.0)
                top = valid_normal(lobes, i, wi, coat_normal) if coat > WEIGHT_CUTOFF else coat_normal
                share = coat
                present = coat > WEIGHT_CUTOFF and reflects
                kind = REFLECTION | FRESNEL_DIELECTRIC | COAT
            elif layer == _LAYER_METAL:
                top = lifted
                share = metallic
                present = metallic > WEIGHT_CUTOFF and reflects
                kind = REFLECTION | FRESNEL_F82
            elif layer == _LAYER_GLASS:
                share = transmission
                present = transmission > WEIGHT_CUTOFF and (reflects or refracts)
                kind = GLASS | FRESNEL_SCHLICK
            else:
                share = 1.0
                present = reflects and (eta != 1.0 or film > FILM_CUTOFF)
                kind = REFLECTION | FRESNEL_SCHLICK
            if present:
                j = push(lobes, i, kind, scale(share, weight), top)
            taken = _BLACK
            if j >= 0:
                if layer == _LAYER_COAT:
                    data[i, j, IOR] = coat_ior
                    coat_roughness = unit_interval(block[r, _COAT_ROUGHNESS])
                    set_alpha(lobes, i, j, coat_roughness * coat_roughness, coat_roughness * coat_roughness)
                else:
                    facets_x = alpha_x
                    facets_y = alpha_y
                    tilted = anisotropic
                    layer_film_ior = film_ior
                    if layer == _LAYER_METAL:
                        data[i, j, IOR] = 1.0
                        store3(data, i, j, F0, color)
                        for c in range(3):
                            data[i, j, TINT + c] = f82_term(color[c], min(tint[c], 1.0))
                    else:
                        glass = layer == _LAYER_GLASS
                        store3(data, i, j, F0, _at_most_one(scale(f0_of_ior(ior) if glass else f0, tint)))
                        shown = 0.0 if glass and not reflects else 1.0
                        passed = 1.0 if glass and refracts else 0.0
                        data[i, j, IOR] = eta
                        for c in range(3):
                            data[i, j, TINT + c] = shown
                            data[i, j, TRANSMISSION_TINT + c] = passed * math.sqrt(color[c])
                        if glass:
                            data[i, j, IOR] = 1.0 / ior if backfacing else ior
                            layer_film_ior = film_ior / ior if backfacing else film_ior
                            facets_x = roughness * roughness
                            facets_y = facets_x
                            tilted = False
                    _set_facets(lobes, i, j, facets_x, facets_y, tilted, tangent, film, layer_film_ior)
                compensate = multiple or layer == _LAYER_COAT
                taken = finish_microfacet(lobes.kind[i, j], data, i, j, tables, wi, compensate, _ASK)
            if layer == _LAYER_METAL:
                weight = scale(1.0 - metallic, weight)
            elif layer == _LAYER_GLASS:
                weight = scale(1.0 - transmission, weight)
            else:
                weight = below(taken, weight)
            if layer == _LAYER_COAT:
                coat_tint = positive3(block, r, _COAT_TINT)
                if coat > WEIGHT_CUTOFF and (
                    coat_tint[0] != 1.0 or coat_tint[1] != 1.0 or coat_tint[2] != 1.0
                ):
                    weight = multiply(weight, _coat_transmittance(coat_tint, coat, coat_ior, dot(wi, top)))
                for c in range(3):
                    lobes.emission[i, c] += np.float64(block[r, _EMISSION + c]) * weight[c]
        _base_diffuse(lobes, i, wi, normal, weight, base, block, r)
