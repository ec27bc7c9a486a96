"""Light that the lobes of fragments send to the camera: from lamps by a few fixed points of each, from the world by
maps.

Nothing is random, so nothing is noisy: a lamp is one point where it looks small, up to sixteen where it is wide and 64
where a surface sees a part of it, or a narrow lobe one of a tube; more along a rectangle's longer side. What can bring
little beside the light that is there already is fewer. Lobes are widened by the part of the lamp that each point stands
for, so that sharp highlights keep the lamp's size.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.shading.bump_horizon import irradiance_of_bump
from pointmr_engine.forward.shading.lamp_points import (
    MANY,
    NARROWER,
    SHARP,
    length_of_lamp,
    points_of_lamp,
)
from pointmr_engine.forward.shading.lamps_in_lobes import (
    hide_lobes,
    lamp_in_lobes,
    narrow_lobes,
    point_beside_lobes,
)
from pointmr_engine.forward.shading.world_light import world_irradiance, world_lobe
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.raytracing.lamps import (
    DISTANT,
    POINT,
    TAN_SPREAD,
    sample_lamp,
)
from pointmr_engine.scene.group import DIFFUSE, GLOSSY, TRANSMISSION
from pointmr_engine.shading.bsdf.layout import (
    ALPHA_X,
    ALPHA_Y,
    BUMP_CORRECTION,
    BUMPED,
    GLASS,
    HAS_TRANSMISSION,
    IOR,
    KIND_MASK,
    MIRROR,
    NORMAL,
    REFRACTION,
    SAMPLE,
    SHEEN,
    SINGULAR_LOBE,
    TRANSLUCENT,
    WEIGHT,
)
from pointmr_engine.shading.bsdf.setup import passed_on
from pointmr_engine.shading.bsdf.vector import dot, load3, mean, row3
from pointmr_engine.shading.bsdf.widening import is_glossy, note_mirror, set_roughness, widen_keeping_light
from pointmr_engine.shading.lobes import evaluate

NO_GAPS = np.zeros(0, np.float32)  # of shade_lamps
NO_SHARES = np.zeros(
    (0, 0), np.float32
)  # of what lies behind surfaces, where nothing tells their sides apart
ADDED = 1.1  # of an opaque surface's light: who sends more, and is not opaque, has had its transparency added
FILLS = (
    0.025  # of a lamp's solid angle, over its length in widths: the variance of gaps that it fills by itself
)
FAINT, FAINTER = 0.25, 0.05  # of a point's light so far: who cannot bring as much is 4 x 4, 2 x 2 points
_GLITTER = 0.125  # squared roughness that a light's squared angular radius is as wide as


@device
def _widen(lobes, i, alpha, extra):
    """Give the microfacet lobes of point i their roughness `alpha` (n, L, 2) and `extra` squared roughness."""
    for j in range(np.int64(lobes.count[i])):
        if is_glossy(lobes.kind[i, j]):
            set_roughness(lobes, i, j, np.float64(alpha[i, j, 0]), np.float64(alpha[i, j, 1]), extra)


@device
def _hide_mirrors(lobes, i):
    """Leave mirrors, however wide, out of what is evaluated, until they are widened again; whether there are any."""
    some = False
    for j in range(np.int64(lobes.count[i])):
        if lobes.kind[i, j] & MIRROR:
            lobes.kind[i, j] = lobes.kind[i, j] | SINGULAR_LOBE
            some = True
    return some


@uncounted
def widen_by_normals(lobes, spread, alpha, incoming, tables, keep, count):
    """Widen the microfacet lobes of points 0..count by the variance of their pieces' slopes; alpha keeps the result.

    keep: the viewer, along incoming (N, 3) float32, receives as much light as before; hits behind first surfaces, which
    are widened for less noise, would be brighter besides. tables: albedo_tables.Tables.
    Half vectors vary as the normals do, and a Beckmann lobe of roughness alpha has slopes of variance alpha^2 / 2.
    """
    for i in range(count):
        extra = 2.0 * np.float64(spread[i])
        for j in range(np.int64(lobes.count[i])):
            x, y = np.float64(lobes.data[i, j, ALPHA_X]), np.float64(lobes.data[i, j, ALPHA_Y])
            if is_glossy(lobes.kind[i, j]):
                note_mirror(lobes, i, j)
                if keep and extra > 0.0:
                    widen_keeping_light(lobes, np.int64(i), np.int64(j), extra, tables, row3(incoming, i))
                elif extra > 0.0:
                    set_roughness(lobes, i, j, x, y, extra)
            alpha[i, j, 0] = lobes.data[i, j, ALPHA_X]
            alpha[i, j, 1] = lobes.data[i, j, ALPHA_Y]


@uncounted
def widen_more(lobes, spread, times, alpha, count):
    """Widen the microfacet lobes of points 0..count from `alpha` on, which stays, by `times` their `spread` (N,) > 0.

    0 times: undo it.
    """
    for i in range(count):
        if spread[i] > 0.0:
            _widen(lobes, i, alpha, 2.0 * times * np.float64(spread[i]))


@device
def _whole_lamp(lamps, i, px, py, pz, nx, ny, nz, transmissive):
    """(direction to a lamp's middle, solid angle that its radiance fills; 0 for delta lamps, its light): its scale."""
    shape = lamps.shape[i]
    dx, dy, dz, _, pdf, scale = sample_lamp(lamps, i, px, py, pz, nx, ny, nz, transmissive, 0.5, 0.5)
    if not pdf > 0.0:
        return dx, dy, dz, 0.0, 0.0
    if shape == POINT or shape == DISTANT:
        return dx, dy, dz, 0.0, scale
    return dx, dy, dz, 1.0 / pdf, scale / pdf


@device
def _sharpest(lobes, i, alpha):
    """The least squared roughness of point i's microfacet lobes; 1 where it has none."""
    least = 1.0
    for j in range(np.int64(lobes.count[i])):
        if is_glossy(lobes.kind[i, j]):
            least = min(least, np.float64(alpha[i, j, 0]) * np.float64(alpha[i, j, 1]))
    return least


@device
def _passed_on(lobes, k):
    """What point k's lobes send at most of what they receive."""
    r = g = b = 0.0
    for j in range(np.int64(lobes.count[k])):
        w = load3(lobes.data, k, j, WEIGHT)
        r, g, b = r + w[0], g + w[1], b + w[2]
    return r, g, b


@device
def _most_points(lamps, i, lobes, k, solid, rough, arrives, there):
    """Along a lamp's side at most: fewer where all that it can bring is little beside the light that is `there`.

    solid: of lamp i, sr, of which a share `arrives` at point k, whose lobes have the least squared roughness `rough`.
    """
    if lamps.values[i, TAN_SPREAD] < math.inf:
        return MANY  # of its middle's beam only a part may be seen
    share = min(1.0, solid / (math.pi * max(rough, SHARP)))
    brings = arrives * share * max(row3(lamps.radiance, i)) * max(_passed_on(lobes, k))
    if brings < FAINTER * there:
        return np.int64(2)
    return np.int64(4) if brings < FAINT * there else MANY


@device
def _ball(cosine):
    """Mean clamped cosine to a light over the side of a sphere that is seen, by the cosine between light and viewer."""
    c = min(max(cosine, -1.0), 1.0)
    angle = math.acos(c)
    return (math.sin(angle) + (math.pi - angle) * c) * (2.0 / (3.0 * math.pi))


@uncounted
def shade_lamps(lobes, incoming, position, flat, alpha, gaps, lamps, shadow, beneath, first, count, out):
    """Add the lamps' light that points 0..count send to the viewer to out (N, 3) float32.

    incoming (N, 3) float32 to the viewer; position (N, 3) float64; flat (N,) float32, alpha (N, L, 2) as
    widen_by_normals left it; gaps (N or 0,) float32: variance of slopes by which lobes are wider for small lamps, lest
    these be seen in gaps between footprints; shadow (lamps or 0, F) float32: share that arrives at fragments first...,
    and beneath (lamps or 0, F) of what of a lamp is behind the surface, the same if it is of none. What out has is
    light that lamps are weighed against (FAINT).
    """
    for k in range(count):
        if lobes.count[k] == 0:
            continue
        wi = row3(incoming, k)
        px, py, pz = position[k, 0], position[k, 1], position[k, 2]
        normal = row3(lobes.normal, k)
        transmissive = (lobes.flags[k] & HAS_TRANSMISSION) != 0
        plane = np.float64(flat[k])
        r = g = b = 0.0
        widened = False
        gap = np.float64(gaps[k]) if len(gaps) > 0 else 0.0
        e, received = row3(lobes.emission, k), row3(out, k)
        there = max(received[0] + e[0], received[1] + e[1], received[2] + e[2])
        for i in range(len(lamps.shape)):
            arrives = below = 1.0
            if len(shadow) > 0:
                arrives = below = np.float64(shadow[i, first + k])
                if len(beneath) > 0:
                    below = np.float64(beneath[i, first + k])
                if not (arrives > 0.0 or below > 0.0):
                    continue
            dx, dy, dz, solid, scale = _whole_lamp(
                lamps, i, px, py, pz, normal[0], normal[1], normal[2], transmissive
            )
            sharp, most, longer = 0.0, MANY, length_of_lamp(lamps, np.int64(i))
            if solid > 0.0:
                rough = _sharpest(lobes, np.int64(k), alpha)
                if solid > SHARP and rough * math.pi < NARROWER * solid * longer:
                    sharp = math.sqrt(rough)
                most = _most_points(
                    lamps, np.int64(i), lobes, np.int64(k), solid, rough, max(arrives, below), max(there, r, g, b)
                )  # fmt: skip
            across, up, apart_u, apart_v = points_of_lamp(
                lamps, np.int64(i), px, py, pz, normal, solid, sharp, most
            )
            points = across * up
            if points == 1 and plane >= 1.0 and not transmissive:
                if normal[0] * dx + normal[1] * dy + normal[2] * dz <= 0.0:
                    continue
            seen = lamps.visibility[i]
            bits = np.int64(0)
            if solid > 0.0:
                more = 2.0 * max(gap - FILLS * solid / longer, 0.0)
                if seen & GLOSSY and most == MANY:
                    bits = narrow_lobes(lobes, np.int64(k), alpha, more, solid)
                if bits != 0:
                    _widen(lobes, np.int64(k), alpha, more)
                    x, y, z = lamp_in_lobes(
                        lobes, np.int64(k), bits, wi, lamps, np.int64(i), px, py, pz, (dx, dy, dz), solid,
                        longer, np.float64(points), first + k,
                    )  # fmt: skip
                    r, g, b = r + arrives * x, g + arrives * y, b + arrives * z
                _widen(lobes, np.int64(k), alpha, more + _GLITTER * solid / (math.pi * points))
                if bits != 0:
                    hide_lobes(lobes, np.int64(k), alpha, more, bits)
                widened = True
            else:
                if widened:
                    _widen(lobes, np.int64(k), alpha, 0.0)
                # a lamp that is a point is in no mirror
                widened = _hide_mirrors(lobes, np.int64(k))
            for p in range(points):
                if points > 1:
                    u = 0.5 + apart_u * ((p % across + 0.5) / across - 0.5)
                    v = 0.5 + apart_v * ((p // across + 0.5) / up - 0.5)
                    dx, dy, dz, _, pdf, scale = sample_lamp(
                        lamps, i, px, py, pz, normal[0], normal[1], normal[2], transmissive, u, v
                    )
                    scale = scale / (pdf * points) if pdf > 0.0 else 0.0
                if not scale > 0.0:
                    continue
                diffuse, _, glossy, transmission, _ = evaluate(lobes, np.int64(k), wi, (dx, dy, dz))
                f0 = f1 = f2 = 0.0
                if seen & DIFFUSE:
                    f0, f1, f2 = diffuse
                    if plane < 1.0:
                        ball = (1.0 - plane) * _ball(wi[0] * dx + wi[1] * dy + wi[2] * dz) / math.pi
                        f0 = plane * f0 + ball * lobes.diffuse_color[k, 0]
                        f1 = plane * f1 + ball * lobes.diffuse_color[k, 1]
                        f2 = plane * f2 + ball * lobes.diffuse_color[k, 2]
                if seen & GLOSSY:
                    f0, f1, f2 = f0 + glossy[0], f1 + glossy[1], f2 + glossy[2]
                if bits != 0:
                    x, y, z = point_beside_lobes(
                        lobes, np.int64(k), bits, wi, (dx, dy, dz), solid, np.float64(points)
                    )
                    f0, f1, f2 = f0 + x, f1 + y, f2 + z
                if seen & TRANSMISSION:
                    f0, f1, f2 = f0 + transmission[0], f1 + transmission[1], f2 + transmission[2]
                scale *= arrives if arrives == below or dot(normal, (dx, dy, dz)) > 0.0 else below
                r += scale * f0 * lamps.radiance[i, 0]
                g += scale * f1 * lamps.radiance[i, 1]
                b += scale * f2 * lamps.radiance[i, 2]
        if widened:
            _widen(lobes, np.int64(k), alpha, 0.0)
        if math.isfinite(r + g + b):
            out[k, 0] += r
            out[k, 1] += g
            out[k, 2] += b


@device
def towards_normal(normal, direction, roughness):
    """Where a rough lobe looks: between its mirror direction and its normal (Lagarde and de Rousiers 2014)."""
    smooth = 1.0 - min(roughness, 1.0)
    t = smooth * (math.sqrt(smooth) + roughness)
    x = normal[0] + t * (direction[0] - normal[0])
    y = normal[1] + t * (direction[1] - normal[1])
    z = normal[2] + t * (direction[2] - normal[2])
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return normal
    return x / length, y / length, z / length


@uncounted
def shade_world(lobes, incoming, flat, tables, diffuse, glossy, transmission, count, out):
    """Add the world's light that points 0..count send to the viewer to out (N, 3) float32.

    diffuse, glossy, transmission: WorldMaps; tables: albedo_tables.Tables. What transmits looks straight into the
    world.
    """
    for k in range(count):
        wi = row3(incoming, k)
        plane = np.float64(flat[k])
        r = g = b = 0.0
        for j in range(np.int64(lobes.count[k])):
            kind = lobes.kind[k, j]
            base = kind & KIND_MASK
            w = load3(lobes.data, k, j, WEIGHT)
            n = load3(lobes.data, k, j, NORMAL)
            if base <= TRANSLUCENT:
                if base == SHEEN:
                    total = mean(w)
                    share = np.float64(lobes.data[k, j, SAMPLE]) / total if total > 0.0 else 0.0
                    w = (w[0] * share, w[1] * share, w[2] * share)
                sign = -1.0 if base == TRANSLUCENT else 1.0
                n = (sign * n[0], sign * n[1], sign * n[2])
                if kind & BUMPED:
                    outward = row3(lobes.normal, k)
                    outward = (sign * outward[0], sign * outward[1], sign * outward[2])
                    softens = base != TRANSLUCENT and lobes.flags[k] & BUMP_CORRECTION != 0
                    e = irradiance_of_bump(diffuse, n, outward, softens)
                else:
                    e = world_irradiance(diffuse, n[0], n[1], n[2])
                if plane < 1.0:
                    f = world_irradiance(diffuse, sign * wi[0], sign * wi[1], sign * wi[2])
                    e = (
                        f[0] + plane * (e[0] - f[0]),
                        f[1] + plane * (e[1] - f[1]),
                        f[2] + plane * (e[2] - f[2]),
                    )
                r += w[0] * e[0]
                g += w[1] * e[1]
                b += w[2] * e[2]
                continue
            cosine = dot(n, wi)
            rough = math.sqrt(np.float64(lobes.data[k, j, ALPHA_X]) * np.float64(lobes.data[k, j, ALPHA_Y]))
            reflected, transmitted = passed_on(kind, lobes.data, np.int64(k), np.int64(j), tables, wi)
            if reflected[0] + reflected[1] + reflected[2] > 0.0 and base != REFRACTION:
                mirror = (
                    2.0 * cosine * n[0] - wi[0],
                    2.0 * cosine * n[1] - wi[1],
                    2.0 * cosine * n[2] - wi[2],
                )
                d = towards_normal(n, mirror, rough)
                e = world_lobe(glossy, rough, d[0], d[1], d[2])
                r += w[0] * reflected[0] * e[0]
                g += w[1] * reflected[1] * e[1]
                b += w[2] * reflected[2] * e[2]
            if (base == REFRACTION or base == GLASS) and transmitted[0] + transmitted[1] + transmitted[
                2
            ] > 0.0:
                ior = np.float64(lobes.data[k, j, IOR])
                inverse = 1.0 / ior if ior > 0.0 else 1.0
                square = 1.0 - inverse * inverse * (1.0 - cosine * cosine)
                if square > 0.0:
                    along = inverse * cosine - math.sqrt(square)
                    d = (
                        along * n[0] - inverse * wi[0],
                        along * n[1] - inverse * wi[1],
                        along * n[2] - inverse * wi[2],
                    )
                    bend = 0.5 * rough * abs(1.0 - inverse)  # of a mirror that spreads it as much
                    e = world_lobe(transmission, bend, d[0], d[1], d[2])
                    r += w[0] * transmitted[0] * e[0]
                    g += w[1] * transmitted[1] * e[1]
                    b += w[2] * transmitted[2] * e[2]
        if math.isfinite(r + g + b):
            out[k, 0] += r
            out[k, 1] += g
            out[k, 2] += b


@uncounted
def finish(lobes, holdout, passed, fragments, first, count, light, held):
    """Emission, transparency and holdouts of points 0..count, which are fragments first..; True: some are held out.

    light (F, 3): what arrived is there; the share that transparency leaves is taken out, since areas and cut-outs
    account for it: where more is sent than it leaves (Program.adds), passed (count,) float32 at most, what these let
    through; 1 elsewhere. held (F,) float32: share of a fragment that is held out. Albedo and emission go to the
    fragments.
    """
    some = False
    for k in range(count):
        f = first + k
        t = 0.0
        for c in range(3):
            light[f, c] += lobes.emission[k, c]
            t += min(max(np.float64(lobes.transparency[k, c]), 0.0), 1.0) / 3.0
        t = min(t, 0.999)
        if passed[k] < 1.0:
            e, w = row3(lobes.emission, k), _passed_on(lobes, np.int64(k))
            if max(e[0] + w[0], e[1] + w[1], e[2] + w[2]) > ADDED * (1.0 - t):
                t = min(t, np.float64(passed[k]))
        scale = 1.0 / (1.0 - t)
        held[f] = min(max(np.float64(lobes.holdout[k]), 0.0) * scale, 1.0)
        if holdout[k]:
            held[f], scale = 1.0, 0.0
        some = some or held[f] > 0.0
        for c in range(3):
            light[f, c] *= scale
            fragments.albedo[f, c] = min(np.float64(lobes.diffuse_color[k, c]) * scale, 1.0)
            fragments.emission[f, c] = lobes.emission[k, c] * scale
    return some
