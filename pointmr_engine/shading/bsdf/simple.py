"""Leaves that become one lobe each: diffuse, translucent, sheen, velvet, glossy, metallic, glass, refraction."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.shading.bsdf import diffuse
from pointmr_engine.shading.bsdf.fresnel import f0_of_ior, f82_term
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    ANISOTROPIC,
    ASHIKHMIN_SHIRLEY,
    F0,
    FILM_IOR,
    FILM_THICKNESS,
    FRESNEL_F82,
    FRESNEL_SCHLICK,
    GLASS,
    HAS_DIFFUSE,
    HAS_EVALUATION,
    IOR,
    LAMBERT,
    OREN_NAYAR,
    REFLECTION,
    REFRACTION,
    TANGENT,
    THIN_FILM,
    TINT,
    TRANSLUCENT,
    TRANSMISSION_TINT,
    VELVET,
)
from pointmr_engine.shading.bsdf.principled import FILM_CUTOFF
from pointmr_engine.shading.bsdf.setup import finish_diffuse, finish_microfacet, push, set_alpha, valid_normal
from pointmr_engine.shading.bsdf.sheen_lobe import push_sheen
from pointmr_engine.shading.bsdf.vector import (
    dot,
    normalized,
    positive3,
    rotate_about,
    row3,
    scale,
    store3,
    tangent_towards,
    unit_interval,
)
from pointmr_engine.shading.leaves import COLUMNS
from pointmr_engine.shading.leaves import DIFFUSE as DIFFUSE_LEAF
from pointmr_engine.shading.leaves import GLASS as GLASS_LEAF
from pointmr_engine.shading.leaves import GLOSSY as GLOSSY_LEAF
from pointmr_engine.shading.leaves import METALLIC as METALLIC_LEAF

_DIFFUSE_COLOR = np.int64(COLUMNS[DIFFUSE_LEAF].index("color_r"))
_GLOSSY_COLOR = np.int64(COLUMNS[GLOSSY_LEAF].index("color_r"))
_GLASS_COLOR = np.int64(COLUMNS[GLASS_LEAF].index("color_r"))
_GLASS_FILM = np.int64(COLUMNS[GLASS_LEAF].index("thin_film_thickness"))
_METALLIC_BASE = np.int64(COLUMNS[METALLIC_LEAF].index("base_color_r"))
_METALLIC_EDGE = np.int64(COLUMNS[METALLIC_LEAF].index("edge_tint_r"))
_METALLIC_ROUGHNESS = np.int64(COLUMNS[METALLIC_LEAF].index("roughness"))
_METALLIC_FILM = np.int64(COLUMNS[METALLIC_LEAF].index("thin_film_thickness"))
_WEIGHT = np.int64(0)
_ROUGHNESS = np.int64(3)  # of all others, right behind the weight
_SECOND = np.int64(4)  # ior or anisotropy
_ROTATION = np.int64(5)
_ASK = (-1.0, -1.0, -1.0)


@device
def _color(block, r, column):
    """The leaf's own colour; its weight where the colour was not given."""
    color = positive3(block, r, column)
    if color[0] == 0.0 and color[1] == 0.0 and color[2] == 0.0:
        return positive3(block, r, _WEIGHT)
    return color


@device
def _place(view, normals, block, rows, k):
    """Row of the block, viewer's direction and shading normal of the k-th point."""
    i = rows[k]
    r = k if block.shape[0] > 1 else 0
    normal = normalized(row3(normals, k if normals.shape[0] > 1 else 0), row3(view.normal, i))
    return i, r, row3(view.incoming, i), normal


@uncounted
def append_diffuse(lobes, rows, view, block, normals, translucent):
    """Diffuse and translucent leaves; `block` of a translucent or subsurface leaf has the weight alone."""
    for k in range(rows.shape[0]):
        i, r, wi, normal = _place(view, normals, block, rows, k)
        kind = LAMBERT
        roughness = 0.0
        if translucent:
            kind = TRANSLUCENT
            normal = valid_normal(lobes, i, wi, normal)
        elif block.shape[1] > _ROUGHNESS:
            roughness = np.float64(block[r, _ROUGHNESS])
            if roughness >= 1e-5:
                kind = OREN_NAYAR
        j = push(lobes, i, kind, positive3(block, r, _WEIGHT), normal)
        if j < 0:
            continue
        if kind == OREN_NAYAR:
            a, b, multiple = diffuse.setup(roughness, _color(block, r, _DIFFUSE_COLOR), dot(normal, wi))
            lobes.data[i, j, ALPHA_X] = a
            lobes.data[i, j, ALPHA_Y] = b
            store3(lobes.data, i, j, F0, multiple)
        finish_diffuse(lobes, i, j)


@uncounted
def append_sheen(lobes, rows, view, tables, block, normals):
    """Sheen leaves (microfibre model)."""
    for k in range(rows.shape[0]):
        i, r, wi, normal = _place(view, normals, block, rows, k)
        push_sheen(
            lobes, i, tables, wi, normal, positive3(block, r, _WEIGHT), unit_interval(block[r, _ROUGHNESS])
        )


@uncounted
def append_velvet(lobes, rows, view, block, normals):
    """Sheen leaves of Ashikhmin's older model. Like in Cycles they are no part of the Diffuse Color pass."""
    for k in range(rows.shape[0]):
        i, r, wi, normal = _place(view, normals, block, rows, k)
        if not dot(normal, wi) > 1e-5:
            continue
        j = push(lobes, i, VELVET, positive3(block, r, _WEIGHT), normal)
        if j < 0:
            continue
        sigma = max(unit_interval(block[r, _ROUGHNESS]), 0.01)
        lobes.data[i, j, ALPHA_X] = 1.0 / (sigma * sigma)
        lobes.flags[i] |= np.uint8(HAS_EVALUATION | HAS_DIFFUSE)


@device
def _set_tangent(lobes, i, j, normal, axis, tangent, rotation):
    """Anisotropic lobe: the tangent turned about `axis`, then made orthogonal to the lobe's normal."""
    if rotation != 0.0:
        tangent = rotate_about(tangent, axis, 2.0 * math.pi * rotation)
    lobes.kind[i, j] |= ANISOTROPIC
    store3(lobes.data, i, j, TANGENT, tangent_towards(normal, tangent))


@uncounted
def append_glossy(lobes, rows, view, tables, block, normals, tangents, reflective, modifiers, multiple):
    """Glossy leaves. modifiers: 0, BECKMANN or ASHIKHMIN_SHIRLEY; multiple: compensate lost energy."""
    base = ASHIKHMIN_SHIRLEY if modifiers == ASHIKHMIN_SHIRLEY else REFLECTION | modifiers
    for k in range(rows.shape[0]):
        i, r, wi, normal = _place(view, normals, block, rows, k)
        if not (reflective or not view.diffuse_ray[i]):
            continue
        lifted = valid_normal(lobes, i, wi, normal)
        j = push(lobes, i, base, positive3(block, r, _WEIGHT), lifted)
        if j < 0:
            continue
        roughness = unit_interval(block[r, _ROUGHNESS])
        alpha_x = roughness * roughness
        alpha_y = alpha_x
        anisotropy = min(max(np.float64(block[r, _SECOND]), -0.99), 0.99)
        tangent = row3(tangents, k if tangents.shape[0] > 1 else 0)
        if abs(anisotropy) > 1e-4 and dot(tangent, tangent) > 0.0:
            if anisotropy < 0.0:
                alpha_x /= 1.0 + anisotropy
                alpha_y *= 1.0 + anisotropy
            else:
                alpha_x *= 1.0 - anisotropy
                alpha_y /= 1.0 - anisotropy
            _set_tangent(lobes, i, j, lifted, lifted, tangent, np.float64(block[r, _ROTATION]))
        lobes.data[i, j, IOR] = 1.0
        if base == ASHIKHMIN_SHIRLEY:
            lobes.data[i, j, ALPHA_X] = min(max(alpha_x, 1e-4), 1.0)
            lobes.data[i, j, ALPHA_Y] = min(max(alpha_y, 1e-4), 1.0)
            lobes.flags[i] |= np.uint8(HAS_EVALUATION)
        else:
            set_alpha(lobes, i, j, alpha_x, alpha_y)
            if multiple:
                finish_microfacet(
                    lobes.kind[i, j], lobes.data, i, j, tables, wi, True, _color(block, r, _GLOSSY_COLOR)
                )


@uncounted
def append_metallic(lobes, rows, view, tables, block, normals, tangents, reflective, modifiers, multiple):
    """Metallic leaves, coloured by their f0 and the tint at 82 degrees."""
    for k in range(rows.shape[0]):
        i, r, wi, normal = _place(view, normals, block, rows, k)
        if not (reflective or not view.diffuse_ray[i]):
            continue
        lifted = valid_normal(lobes, i, wi, normal)
        j = push(lobes, i, REFLECTION | FRESNEL_F82 | modifiers, positive3(block, r, _WEIGHT), lifted)
        if j < 0:
            continue
        roughness = unit_interval(block[r, _METALLIC_ROUGHNESS])
        alpha_x = roughness * roughness
        alpha_y = alpha_x
        anisotropy = unit_interval(block[r, _METALLIC_ROUGHNESS + 1])
        tangent = row3(tangents, k if tangents.shape[0] > 1 else 0)
        if anisotropy > 0.0 and dot(tangent, tangent) > 0.0:
            aspect = math.sqrt(1.0 - 0.9 * anisotropy)
            alpha_x /= aspect
            alpha_y *= aspect
            rotation = np.float64(block[r, _METALLIC_ROUGHNESS + 2])
            _set_tangent(lobes, i, j, lifted, normal, tangent, rotation)
        lobes.data[i, j, IOR] = 1.0
        for c in range(3):
            f0 = unit_interval(block[r, _METALLIC_BASE + c])
            lobes.data[i, j, F0 + c] = f0
            lobes.data[i, j, TINT + c] = f82_term(f0, unit_interval(block[r, _METALLIC_EDGE + c]))
        _set_film(lobes, i, j, np.float64(block[r, _METALLIC_FILM]), np.float64(block[r, _METALLIC_FILM + 1]))
        set_alpha(lobes, i, j, alpha_x, alpha_y)
        finish_microfacet(lobes.kind[i, j], lobes.data, i, j, tables, wi, multiple, _ASK)


@device
def _set_film(lobes, i, j, thickness, film_ior):
    if thickness > FILM_CUTOFF:
        lobes.kind[i, j] |= THIN_FILM
        lobes.data[i, j, FILM_THICKNESS] = thickness
        lobes.data[i, j, FILM_IOR] = max(film_ior, 1e-5)


@uncounted
def append_glass(lobes, rows, view, tables, block, normals, reflective, refractive, modifiers, multiple):
    """Glass leaves: reflection and refraction in one lobe."""
    for k in range(rows.shape[0]):
        i, r, wi, normal = _place(view, normals, block, rows, k)
        reflects = reflective or not view.diffuse_ray[i]
        refracts = refractive or not view.diffuse_ray[i]
        color = _color(block, r, _GLASS_COLOR)
        # the colour is the facets' tint, so that the compensation sees it; the rest stays in the weight
        weight = positive3(block, r, _WEIGHT)
        share = 0.0
        for c in range(3):
            if color[c] > 0.0:
                share = max(share, weight[c] / color[c])
        if not (reflects or refracts):
            continue
        j = push(
            lobes,
            i,
            GLASS | FRESNEL_SCHLICK | modifiers,
            (share, share, share),
            valid_normal(lobes, i, wi, normal),
        )
        if j < 0:
            continue
        ior = max(np.float64(block[r, _SECOND]), 1e-5)
        roughness = unit_interval(block[r, _ROUGHNESS])
        f0 = f0_of_ior(ior)
        lobes.data[i, j, IOR] = 1.0 / ior if view.backfacing[i] else ior
        store3(lobes.data, i, j, F0, (f0, f0, f0))
        store3(lobes.data, i, j, TINT, scale(1.0 if reflects else 0.0, color))
        store3(lobes.data, i, j, TRANSMISSION_TINT, scale(1.0 if refracts else 0.0, color))
        film_ior = np.float64(block[r, _GLASS_FILM + 1])
        _set_film(
            lobes, i, j, np.float64(block[r, _GLASS_FILM]), film_ior / ior if view.backfacing[i] else film_ior
        )
        set_alpha(lobes, i, j, roughness * roughness, roughness * roughness)
        finish_microfacet(lobes.kind[i, j], lobes.data, i, j, tables, wi, multiple, _ASK)


@uncounted
def append_refraction(lobes, rows, view, block, normals, refractive, modifiers):
    """Refraction leaves: no reflection, nothing under total reflection."""
    for k in range(rows.shape[0]):
        i, r, wi, normal = _place(view, normals, block, rows, k)
        if not (refractive or not view.diffuse_ray[i]):
            continue
        j = push(
            lobes, i, REFRACTION | modifiers, positive3(block, r, _WEIGHT), valid_normal(lobes, i, wi, normal)
        )
        if j < 0:
            continue
        ior = max(np.float64(block[r, _SECOND]), 1e-5)
        roughness = np.float64(block[r, _ROUGHNESS])
        lobes.data[i, j, IOR] = 1.0 / ior if view.backfacing[i] else ior
        set_alpha(lobes, i, j, roughness * roughness, roughness * roughness)
