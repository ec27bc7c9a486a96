"""How a lobe is added to a point: normals made valid, albedos estimated, lost energy given back."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf import ashikhmin_shirley
from pointmr_engine.shading.bsdf.albedo_tables import ONLY, lookup2, lookup3
from pointmr_engine.shading.bsdf.fresnel import dielectric_average, f0_of_ior, f82, f82_average, remap
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    ASHIKHMIN_SHIRLEY,
    BECKMANN,
    BUMP_CORRECTION,
    BUMPED,
    F0,
    FRESNEL_DIELECTRIC,
    FRESNEL_F82,
    FRESNEL_SCHLICK,
    GLASS,
    HAS_DIFFUSE,
    HAS_EVALUATION,
    HAS_SINGULAR,
    HAS_TRANSMISSION,
    IOR,
    KIND_MASK,
    NORMAL,
    REFRACTION,
    SAMPLE,
    SINGULAR_ALPHA_SQUARED,
    SINGULAR_LOBE,
    THIN_FILM,
    TINT,
    TRANSLUCENT,
    TRANSMISSION_TINT,
    WEIGHT,
    WEIGHT_CUTOFF,
)
from pointmr_engine.shading.bsdf.microfacet import fresnel
from pointmr_engine.shading.bsdf.vector import (
    combine,
    dot,
    load3,
    mean,
    multiply,
    normalized,
    row3,
    scale,
    store3,
)


@device
def push(lobes, i, kind, weight, normal):
    """Add a lobe -> its index, or -1 where its weight is negligible, not finite, or there is no room."""
    weight = (max(weight[0], 0.0), max(weight[1], 0.0), max(weight[2], 0.0))
    sample_weight = mean(weight)
    j = np.int64(lobes.count[i])
    if not (sample_weight >= WEIGHT_CUTOFF and sample_weight < math.inf) or j >= lobes.kind.shape[1]:
        return np.int64(-1)
    ns = row3(lobes.normal, i)
    if normal[0] != ns[0] or normal[1] != ns[1] or normal[2] != ns[2]:
        kind |= BUMPED
    lobes.count[i] = j + 1
    lobes.kind[i, j] = kind
    store3(lobes.data, i, j, WEIGHT, weight)
    lobes.data[i, j, SAMPLE] = sample_weight
    store3(lobes.data, i, j, NORMAL, normal)
    return j


@device
def drop(lobes, i):
    """Take back the lobe pushed last."""
    lobes.count[i] -= 1


@device
def finish_diffuse(lobes, i, j):
    """Flags and albedo of a diffuse lobe whose weight is final."""
    flags = HAS_EVALUATION | HAS_DIFFUSE
    if lobes.kind[i, j] & KIND_MASK == TRANSLUCENT:
        flags |= HAS_TRANSMISSION
    lobes.flags[i] |= np.uint8(flags)
    for c in range(3):
        lobes.diffuse_color[i, c] += lobes.data[i, j, WEIGHT + c]


@device
def set_alpha(lobes, i, j, alpha_x, alpha_y):
    """Store the roughness of a microfacet lobe, singular where it is too smooth."""
    alpha_x = min(max(alpha_x, 0.0), 1.0)
    alpha_y = min(max(alpha_y, 0.0), 1.0)
    lobes.data[i, j, ALPHA_X] = alpha_x
    lobes.data[i, j, ALPHA_Y] = alpha_y
    flags = HAS_EVALUATION
    if not alpha_x * alpha_y > SINGULAR_ALPHA_SQUARED:
        lobes.kind[i, j] |= SINGULAR_LOBE
        flags = HAS_SINGULAR
    base = lobes.kind[i, j] & KIND_MASK
    if base == GLASS or base == REFRACTION:
        flags |= HAS_TRANSMISSION
    lobes.flags[i] |= np.uint8(flags)


@device
def _roughness(data, i, j):
    return math.sqrt(math.sqrt(np.float64(data[i, j, ALPHA_X]) * np.float64(data[i, j, ALPHA_Y])))


@device
def albedo(kind, data, i, j, tables, cos_ni):
    """Estimated (reflected rgb, transmitted rgb) of a microfacet lobe without its weight."""
    reflected, transmitted, _ = fresnel(kind, data, i, j, tables.film, cos_ni)
    if kind & THIN_FILM or not (mean(reflected) > 0.0 or kind & FRESNEL_F82):
        return reflected, transmitted
    ior = np.float64(data[i, j, IOR])
    z = math.sqrt(abs((ior - 1.0) / (ior + 1.0)))
    if kind & FRESNEL_SCHLICK:
        s = lookup3(tables.schlick_dielectric, ONLY, z, cos_ni, _roughness(data, i, j))
        f0 = load3(data, i, j, F0)
        mixed = (f0[0] + (1.0 - f0[0]) * s, f0[1] + (1.0 - f0[1]) * s, f0[2] + (1.0 - f0[2]) * s)
        reflected = multiply(mixed, load3(data, i, j, TINT))
    elif kind & FRESNEL_F82:
        s = lookup2(tables.schlick, ONLY, cos_ni, _roughness(data, i, j))
        f0, b = load3(data, i, j, F0), load3(data, i, j, TINT)
        c = 1.0 - s**0.2  # as if all facets were met at one cosine ...
        alpha, edge = _roughness(data, i, j) ** 2, 1.0 - cos_ni
        # ... but at grazing angles, where a part of them is met at less than the edge's (a fit, to within a tenth)
        b = scale(1.0 - 0.35 * edge * edge * edge * edge * alpha / max(alpha + 0.3 * cos_ni, 1e-6), b)
        reflected = (f82(c, f0[0], b[0]), f82(c, f0[1], b[1]), f82(c, f0[2], b[2]))
    elif kind & FRESNEL_DIELECTRIC and ior > 1.0:
        s = lookup3(tables.schlick_dielectric, ONLY, z, cos_ni, _roughness(data, i, j))
        f0_real = f0_of_ior(ior)
        f = f0_real + (1.0 - f0_real) * s
        reflected = (f, f, f)
    return reflected, transmitted


@device
def _average_fresnel(kind, data, i, j):
    """Mean single-scattering Fresnel rgb: the colour that each further bounce between facets takes."""
    ior = np.float64(data[i, j, IOR])
    if kind & FRESNEL_DIELECTRIC:
        f = dielectric_average(ior)
        return f, f, f
    if kind & FRESNEL_F82:
        f0 = load3(data, i, j, F0)
        b = load3(data, i, j, TINT)
        return f82_average(f0[0], b[0]), f82_average(f0[1], b[1]), f82_average(f0[2], b[2])
    transmission = load3(data, i, j, TRANSMISSION_TINT)
    if transmission[0] == 0.0 and transmission[1] == 0.0 and transmission[2] == 0.0:
        s = remap(dielectric_average(ior), f0_of_ior(ior))
        f0 = load3(data, i, j, F0)
        mixed = (f0[0] + (1.0 - f0[0]) * s, f0[1] + (1.0 - f0[1]) * s, f0[2] + (1.0 - f0[2]) * s)
        return multiply(mixed, load3(data, i, j, TINT))
    return transmission


@device
def _darkened(fss, e_average, missing):
    """Single plus multiple scattering of colour fss over what the scale 1 + missing would make of white."""
    if fss == 1.0:
        return 1.0
    fms = fss * e_average / (1.0 - fss * (1.0 - e_average))
    return (1.0 + fms * missing) / (1.0 + missing)


@device
def _inverse_side(ior):
    """(variant of the tables of glass, its index of refraction above 1)."""
    if ior < 1.0:
        return ONLY + 1, 1.0 / ior
    return ONLY, ior


@device
def single_scattering(kind, data, i, j, tables, cos_ni):
    """Share of the light that leaves a microfacet lobe after one bounce, its Fresnel term and weight left out."""
    base = kind & KIND_MASK
    if kind & BECKMANN or base == REFRACTION:
        return 1.0
    roughness = _roughness(data, i, j)
    if base == GLASS:
        side, ior = _inverse_side(np.float64(data[i, j, IOR]))
        z = math.sqrt(abs((ior - 1.0) / (ior + 1.0)))
        return lookup3(tables.glass, side, z, cos_ni, roughness)
    return lookup2(tables.ggx, ONLY, cos_ni, roughness)


@device
def passed_on(kind, data, i, j, tables, wi):
    """(reflected rgb, transmitted rgb) of even light that a glossy lobe of weight 1 sends along wi after one bounce."""
    if kind & KIND_MASK == ASHIKHMIN_SHIRLEY:
        a = ashikhmin_shirley.albedo(kind, data, i, j, wi)
        return (a, a, a), (0.0, 0.0, 0.0)
    cos_ni = dot(load3(data, i, j, NORMAL), wi)
    reflected, transmitted = albedo(kind, data, i, j, tables, cos_ni)
    share = single_scattering(kind, data, i, j, tables, cos_ni)
    return scale(share, reflected), scale(share, transmitted)


@device
def finish_microfacet(kind, data, i, j, tables, wi, compensate, fss):
    """Sampling weight and energy compensation of a complete GGX or Beckmann lobe.

    fss: rgb of the facets where the Fresnel term is in the weight; negative: ask the Fresnel term.
    -> what the lobe takes from the layers below (weight times reflected albedo).
    """
    cos_ni = dot(load3(data, i, j, NORMAL), wi)
    reflected, transmitted = albedo(kind, data, i, j, tables, cos_ni)
    weight = load3(data, i, j, WEIGHT)
    sample_weight = np.float64(data[i, j, SAMPLE])
    if kind & (FRESNEL_DIELECTRIC | FRESNEL_SCHLICK | FRESNEL_F82):
        sample_weight *= mean(combine(1.0, reflected, 1.0, transmitted))
    gain = 1.0
    if compensate and not kind & BECKMANN:
        roughness = _roughness(data, i, j)
        e = single_scattering(kind, data, i, j, tables, cos_ni)
        if kind & KIND_MASK == GLASS:
            side, ior = _inverse_side(np.float64(data[i, j, IOR]))
            z = math.sqrt(abs((ior - 1.0) / (ior + 1.0)))
            e_average = lookup2(tables.glass_average, side, z, roughness)
        else:
            e_average = lookup2(tables.ggx_average, ONLY, 0.0, roughness)
        missing = (1.0 - e) / e
        if fss[0] < 0.0:
            fss = _average_fresnel(kind, data, i, j)
        darkening = (
            _darkened(fss[0], e_average, missing),
            _darkened(fss[1], e_average, missing),
            _darkened(fss[2], e_average, missing),
        )
        weight = multiply(weight, darkening)
        sample_weight *= mean(darkening)
        gain = 1.0 + missing
    store3(data, i, j, WEIGHT, scale(gain, weight))
    data[i, j, SAMPLE] = sample_weight
    return multiply(weight, reflected)


@device
def below(layer, weight):
    """Weight left for the layers below one that reflects `layer` of `weight`."""
    share = 0.0
    for c in range(3):
        if weight[c] != 0.0:
            share = max(share, layer[c] / weight[c])
    return scale(min(max(1.0 - share, 0.0), 1.0), weight)


@device
def valid_normal(lobes, i, wi, normal):
    """The shading normal, raised toward the geometric one until the mirrored view is above the surface."""
    ng = row3(lobes.geometric_normal, i)
    if not lobes.flags[i] & BUMP_CORRECTION:
        return normal
    if normal[0] == ng[0] and normal[1] == ng[1] and normal[2] == ng[2]:
        return normal
    iz = dot(wi, ng)
    mirrored = combine(2.0 * dot(normal, wi), normal, -1.0, wi)
    threshold = min(0.9 * iz, 0.01)
    if dot(ng, mirrored) >= threshold:
        return normal
    # in the plane of both normals, find the one whose mirrored view just reaches the threshold
    x_axis = normalized(combine(1.0, normal, -dot(normal, ng), ng), normal)
    ix = dot(wi, x_axis)
    a = ix * ix + iz * iz
    if not a > 0.0:
        return ng
    b = 2.0 * (a + iz * threshold)
    c = (threshold + iz) * (threshold + iz)
    root = math.sqrt(max(b * b - 4.0 * a * c, 0.0))
    nz2 = 0.25 * (b + root if ix < 0.0 else b - root) / a
    return combine(math.sqrt(max(1.0 - nz2, 0.0)), x_axis, math.sqrt(max(nz2, 0.0)), ng)
