"""How much of a path's light each side of a lobe passes on: its albedo for the viewer (split sum; Karis 2013)."""

from __future__ import annotations

import math

from pointmr_engine.multires.lobes.lobe_shares import mean_roughness
from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf.layout import GLASS, IOR, KIND_MASK, NORMAL, REFRACTION, TRANSLUCENT, WEIGHT
from pointmr_engine.shading.bsdf.microfacet import fresnel
from pointmr_engine.shading.bsdf.setup import passed_on, single_scattering
from pointmr_engine.shading.bsdf.vector import dot, load3

LEAN, LEANS = 2.0, 5  # how far facets lean whose Fresnel terms are averaged, in roughnesses, and how many


@device
def _from_inside(lobes, k, j, tables, cosine):
    """(reflected rgb, transmitted rgb) of what refracts, seen from inside: tables of albedo know no total reflection.

    The mean over facets that lean as a rough surface's do, so that no side is 0 to which one of them may send light.
    """
    rough = mean_roughness(lobes, k, j)
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    r, g = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(LEANS):
        lean = rough * LEAN * (2.0 * i / (LEANS - 1) - 1.0)
        c = min(max((cosine + lean * sine) / math.sqrt(1.0 + lean * lean), 1e-4), 1.0)
        a, b, _ = fresnel(lobes.kind[k, j], lobes.data, k, j, tables.film, c)
        r, g = (r[0] + a[0], r[1] + a[1], r[2] + a[2]), (g[0] + b[0], g[1] + b[1], g[2] + b[2])
    n = single_scattering(lobes.kind[k, j], lobes.data, k, j, tables, cosine) / LEANS
    return (n * r[0], n * r[1], n * r[2]), (n * g[0], n * g[1], n * g[2])


@device
def passed_by(paths, lobes, k, j, tables_of_albedo, incoming):
    """(reflected rgb, transmitted rgb) of the path's throughput that lobe j of point k passes on; 0 where diffuse."""
    zero = (0.0, 0.0, 0.0)
    kind = lobes.kind[k, j]
    base = kind & KIND_MASK
    if base <= TRANSLUCENT:
        return zero, zero
    if (base == GLASS or base == REFRACTION) and lobes.data[k, j, IOR] < 1.0:
        cosine = dot(load3(lobes.data, k, j, NORMAL), incoming)
        reflected, transmitted = _from_inside(lobes, k, j, tables_of_albedo, cosine)
    else:
        reflected, transmitted = passed_on(kind, lobes.data, k, j, tables_of_albedo, incoming)
    w, t = load3(lobes.data, k, j, WEIGHT), paths.throughput[k]
    w = (w[0] * t[0], w[1] * t[1], w[2] * t[2])
    r, g = zero, zero
    if base != REFRACTION:
        r = (w[0] * reflected[0], w[1] * reflected[1], w[2] * reflected[2])
    if base == REFRACTION or base == GLASS:
        g = (w[0] * transmitted[0], w[1] * transmitted[1], w[2] * transmitted[2])
    return r, g
