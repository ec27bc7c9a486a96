"""Where light comes from next: a cone or a ray for every glossy and transmitting lobe of a surface point.

A lobe's cone leaves in the direction that it favours, as wide as the lobe; its weight is the lobe's albedo for the
viewer (split sum; Karis 2013). A ray is drawn from the lobe (lobe_rays.py). What is weaker than the threshold goes on
by chance, so that nothing is lost on average.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.shading.lobe_light import towards_normal
from pointmr_engine.multires.lobes.curved_mirrors import open_curved, own_variance
from pointmr_engine.multires.lobes.diffuse_rays import may_bounce, scatter_diffuse
from pointmr_engine.multires.lobes.lobe_cones import (
    BY_LOBE,
    STRAIGHT,
    inverse_ior,
    lobe_pdf,
    refracted_pdf,
    refraction,
)
from pointmr_engine.multires.lobes.lobe_paths import (
    WIDEST,
    go_on,
    lobe_place,
    no_cone,
    open_cone,
    pass_through,
    send_ray,
    survives,
)
from pointmr_engine.multires.lobes.lobe_rays import MOST, behind_glossy, draw_direction, rays_of, takes_ray
from pointmr_engine.multires.lobes.lobe_shares import mean_roughness
from pointmr_engine.multires.lobes.lobe_throughput import passed_by
from pointmr_engine.multires.lobes.mirror_chains import blur_lamps, blurs_lamps, grow
from pointmr_engine.multires.sharing.light_shares import MOST_DIFFUSE, add_lobe, clear_share
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import R2, sample_1d
from pointmr_engine.raytracing.path_arrays import LAST, NO_LAMPS, SEES_LAMPS
from pointmr_engine.shading.bsdf.layout import (
    ASHIKHMIN_SHIRLEY,
    BECKMANN,
    HAS_EVALUATION,
    KIND_MASK,
    MIRROR,
    NORMAL,
    REFLECTION,
    SINGULAR_ALPHA_SQUARED,
    SINGULAR_LOBE,
    TRANSLUCENT,
)
from pointmr_engine.shading.bsdf.vector import dot, load3, row3
from pointmr_engine.shading.points import (
    RAY_GLOSSY,
    RAY_MIRRORED,
    RAY_REFLECTION,
    RAY_SINGULAR,
    RAY_TRANSMISSION,
)

WIDE = 4.0  # half width of a lobe's cone, in slopes of its roughness: what lies beyond is left out ...
# ... of lobes that matter, which have two: one for their middle, one for what is beside it, and a Gaussian less of it
CORE, REST, REST_OF_GAUSSIAN = 2.0, 10.0, 5.0
STRONG = 0.5  # throughput from which a lobe matters: weaker ones take a ray
SPLIT = 0.4  # throughput of a first surface's lobes together from which each of them goes on
CLEAR = 0.25  # throughput from which a path divides at mirrors and clear glass behind the first surface, too
SHARP = 0.3  # roughness below which they are mirrors and clear glass: where a first one bends, what is behind is wider
WEAK = 0.03  # throughputs below it go on by chance: below, rays cost more than their noise is worth ...
WEAK_CLEAR = 0.12  # ... and of what goes straight on behind a first surface, for leaves are much alike
MIRRORED = 4.0  # diffuse rays of what strong mirrors and clear glass show, which nothing shares


@device
def _all_clear(lobes, k):
    """Whether all lobes of point k are of mirrors and clear glass, though the view may have widened them."""
    for j in range(np.int64(lobes.count[k])):
        if lobes.kind[k, j] & KIND_MASK <= TRANSLUCENT or not mean_roughness(lobes, k, np.int64(j)) < SHARP:
            return False
    return True


@device
def _largest(c):
    return max(c[0], c[1], c[2])


@device
def _branch(chosen, weight, before, target, total):
    """Factor of the weight of a branch that goes on, 0 if it does not.

    chosen: only the branch goes on in whose share of `total`, behind `before`, the `target` lies.
    """
    if not weight > 0.0:
        return 0.0
    if chosen:
        if before <= target and target < before + weight:
            return total / weight
        return 0.0
    return 1.0


@uncounted
def scatter_lobes(paths, samples, hits, frames, lobes, limits, tables, tables_of_albedo, bounce, alive, n, room, out,
                  record, cone_of, small, bent, curved, shape, turned, chaos, limit, glinting, shares, refractions,
                  first_share, bounced, passed):  # fmt: skip
    """Paths and cones behind the surfaces of paths 0..n, into out and record; returns how many.

    At the first surface every lobe goes on, while there is room; behind it one of them, by chance, but where a strong
    path meets clear glass or a mirror. Straight transparency is a path without a cone of its own: the ray goes on.
    cone_of (N, L) int32: of lobes whose cones find what shines on them, without chance, the first cone; else -1. small
    (N,) bool: points that weigh too little to be worth cones. bent (N,) bool: points in whose mirrors light samples
    look for lamps. curved (N,), shape (N, 6): as of curvature.spread_of_curvature; they count at the first surface.
    turned, chaos (N,): as of mirror_chains.follow_footprints; they count behind it. limit: roughness above which lobes
    take rays; glinting: throughput below which lobes look for lamps. shares, refractions: what rays of the first
    surfaces' lobes find is shared by these rows, from first_share on (none: not at all). bounced (N,) float64: diffuse
    rays of first surfaces. passed (2, L, 3) float64 to work in.
    """
    m = np.int64(0)
    sharing = bounce == 0 and len(shares.worth) > 0
    bounces = np.int64(limits.diffuse > 0 or limits.seeks)
    for k in range(n):
        if sharing:
            p = frames.position
            clear_share(shares, first_share + k, p[k, 0], p[k, 1], p[k, 2])
            if len(refractions.worth) > 0:
                clear_share(refractions, first_share + k, p[k, 0], p[k, 1], p[k, 2])
        if not alive[k]:
            continue
        # all that follow have a row each for what goes on, and one for a diffuse ray where there are any
        left = room - (1 + bounces) * (n - k)
        crowded = m + (2 * MOST + 1 + bounces * MOST_DIFFUSE) * np.int64(lobes.count[k]) > left
        wi = (-paths.rays.direction[k, 0], -paths.rays.direction[k, 1], -paths.rays.direction[k, 2])
        t = paths.throughput[k]
        clear = (0.0, 0.0, 0.0)
        if not paths.flags[k] & LAST:
            clear = (
                np.float64(t[0]) * lobes.transparency[k, 0],
                np.float64(t[1]) * lobes.transparency[k, 1],
                np.float64(t[2]) * lobes.transparency[k, 2],
            )
        total = max(_largest(clear), 0.0)
        for j in range(np.int64(lobes.count[k])):
            cone_of[k, j] = -1
            r, g = passed_by(paths, lobes, np.int64(k), np.int64(j), tables_of_albedo, wi)
            total += _largest(r) + _largest(g)
            passed[0, j, 0], passed[0, j, 1], passed[0, j, 2] = r
            passed[1, j, 0], passed[1, j, 1], passed[1, j, 2] = g
        slot = paths.slot[k]
        wanted = 1.0
        if bounce == 0:
            wanted = bounced[k]
        elif paths.state.diffuse_depth[k] == 0 and _largest(t) >= STRONG:
            wanted = MIRRORED
        m = scatter_diffuse(
            paths, samples, np.int64(k), hits, frames, lobes, limits, tables, bounce, wi, wanted, left + bounces, out,
            m, record,
        )  # fmt: skip
        if not total > 0.0:
            continue
        divides = bounce == 0 or (_largest(t) >= CLEAR and _all_clear(lobes, np.int64(k)))
        chosen = total < SPLIT or crowded or not divides
        glints = _largest(t) < glinting or paths.state.diffuse_depth[k] > 0
        sampled = bounce > 0 and lobes.flags[k] & HAS_EVALUATION != 0
        strong = STRONG if bounce == 0 else 1.0
        target = chance = 0.0
        if chosen:
            seed = np.uint32(samples.seed[slot] ^ np.uint32(k))
            target = sample_1d(tables, seed, np.uint32(64 * bounce + 8), samples.number[slot]) * total
            chance = sample_1d(tables, seed, np.uint32(64 * bounce + 10), samples.number[slot])
        first, before = m, 0.0
        f = _branch(chosen, _largest(clear), before, target, total)
        before += max(_largest(clear), 0.0)
        weak = WEAK_CLEAR if f > 0.0 and bounce > 0 else WEAK
        if f > 0.0:
            pass_through(paths, k, out, m, hits, frames, limits, clear[0] * f, clear[1] * f, clear[2] * f)
            no_cone(record, m, STRAIGHT)
            m += 1
        for j in range(np.int64(lobes.count[k])):
            begin = m
            r, g = row3(passed[0], j), row3(passed[1], j)
            rough = mean_roughness(lobes, k, j)
            own = own_variance(lobes.kind[k, j], rough, np.float64(curved[k])) if bounce == 0 else -1.0
            largest = total if chosen else _largest(r)
            ray = takes_ray(lobes, np.int64(k), np.int64(j), rough, limit, largest, small[k], strong)
            if sharing and ray and _largest(r) > 0.0:
                add_lobe(shares, first_share + k, r, load3(lobes.data, k, j, NORMAL), rough)
            f = _branch(chosen, _largest(r), before, target, total)
            before += _largest(r)
            if f > 0.0:
                r = (r[0] * f, r[1] * f, r[2] * f)
                integrated = bounce == 0 and not chosen and not ray and not small[k] and _largest(r) >= STRONG
                u, v = lobe_place(tables, samples, slot, bounce, k, j)
                times = rays_of(_largest(r), small[k]) if ray and bounce == 0 and not crowded else 1
                r, f = (r[0] / times, r[1] / times, r[2] / times), f / times
                for _ in range(times):
                    m = _reflect(
                        paths, np.int64(k), np.int64(j), hits, frames, lobes, limits, r, f, wi, u, v, out, m, record,
                        glints, integrated, small[k], bent[k], rough, ray, crowded, own, shape,
                    )  # fmt: skip
                    u, v = (u + R2[0]) % 1.0, (v + R2[1]) % 1.0
                if integrated and m > begin:
                    cone_of[k, j] = begin
                grow(out, begin, m, 2.0 * turned[k])
            largest = total if chosen else _largest(g)
            ray = takes_ray(lobes, np.int64(k), np.int64(j), rough, limit, largest, small[k], strong)
            if bounce == 0 and len(refractions.worth) > 0 and ray and _largest(g) > 0.0:
                nm = load3(lobes.data, k, j, NORMAL)
                _, bend, _ = refraction(nm, wi, inverse_ior(lobes, np.int64(k), np.int64(j)), rough)
                add_lobe(refractions, first_share + k, g, nm, bend)
            f = _branch(chosen, _largest(g), before, target, total)
            before += _largest(g)
            if f > 0.0:
                g = (g[0] * f, g[1] * f, g[2] * f)
                u, v = lobe_place(tables, samples, slot, bounce, k, j)
                times = rays_of(_largest(g), small[k]) if ray and bounce == 0 and not crowded else 1
                g, f = (g[0] / times, g[1] / times, g[2] / times), f / times
                for _ in range(times):
                    m = _refract(
                        paths, np.int64(k), np.int64(j), hits, frames, lobes, limits, g, f, wi, u, v, out, m, record,
                        glints and bounce > 0, sampled, small[k], rough, ray, crowded, own, shape,
                    )  # fmt: skip
                    u, v = (u + R2[0]) % 1.0, (v + R2[1]) % 1.0
            if blurs_lamps(lobes.kind[k, j], rough, np.float64(chaos[k])):
                blur_lamps(out, record, begin, m, np.float64(chaos[k]))
        if chosen and m == first + 1 and not survives(out, first, chance, weak):
            m = first
    return m


@device
def _singular(kind):
    """(RAY_SINGULAR or 0 of the rays of a lobe of this kind, what materials are told of them)."""
    if kind & SINGULAR_LOBE:
        return np.int64(RAY_SINGULAR), np.int64(RAY_SINGULAR)
    return np.int64(0), np.int64(RAY_MIRRORED) if kind & MIRROR else np.int64(0)


@device
def _reflect(
    paths, k, j, hits, frames, lobes, limits, w, factor, wi, u, v, out, m, record, glints, integrated,
    small, bent, rough, ray, alone, own, shape,
):  # fmt: skip
    """The ray of a lobe that reflects, its cone, or the two of one that matters; returns the next row.

    w: its throughput; factor: of chance, in it; u, v: random numbers for the ray; rough: mean_roughness; alone: there
    is room for one row and no more. own: own_variance; from 0 on its cone is the footprint, which `shape` (N, 6) bends.
    """
    kind = lobes.kind[k, j]
    nm = load3(lobes.data, k, j, NORMAL)
    cosine = dot(nm, wi)
    singular, said = _singular(kind)
    if ray:
        wo, weight, density, side = draw_direction(lobes, k, j, wi, False, u, v)
        if _largest(weight) > 0.0:
            send_ray(paths, k, out, m, hits, frames, lobes, limits, weight, factor, wo, density,
                     RAY_REFLECTION | RAY_GLOSSY | said, np.int64(1), np.int64(0), record, rough)  # fmt: skip
            if glints:
                out.flags[m] |= SEES_LAMPS
            out.bsdf_pdf[m] = lobe_pdf(rough * rough, nm, wi, wo)
            if not may_bounce(paths, limits, k):
                record.behind[m, 0], record.behind[m, 1], record.behind[m, 2] = behind_glossy(
                    lobes, k, j, wi, wo, weight, density, side
                )
            m += 1
        return m
    d = (2.0 * cosine * nm[0] - wi[0], 2.0 * cosine * nm[1] - wi[1], 2.0 * cosine * nm[2] - wi[2])
    if own < 0.0:
        d = towards_normal(nm, d, rough)
    if dot(row3(lobes.geometric_normal, k), d) <= 0.0:
        return m
    flags, pdf = np.int64(0), math.inf
    if singular == 0 and not integrated:
        flags, pdf = np.int64(SEES_LAMPS) if glints else np.int64(0), BY_LOBE
    if singular != 0 and bent and kind & KIND_MASK == REFLECTION:
        flags = np.int64(NO_LAMPS)
    return _open_cones(
        paths, k, hits, frames, lobes, limits, w, d, nm, abs(cosine), RAY_REFLECTION | RAY_GLOSSY | said,
        np.int64(0), flags, pdf, 0.0 if singular else rough, kind, small, alone, nm, wi, out, m, record, own,
        shape, 0.0,
    )  # fmt: skip


@device
def _open_cones(
    paths, k, hits, frames, lobes, limits, w, d, axis, across, ray_kind, transmission, flags, pdf, alpha, kind, small,
    alone, normal, wi, out, m, record, own, shape, eta,
):  # fmt: skip
    """The cone of a lobe about direction d, or the two of one that matters; returns the next row.

    axis: the lobe's normal; across: how wide the cone is beside the plane of incidence (open_cone). alpha: roughness of
    a mirror that spreads as much, 0 of what is sharp; kind: of the lobe; normal: of one that reflects, else 0. eta: see
    open_curved. Others as of `_reflect`.
    """
    # a power of the cosine is nearly one
    beckmann = kind & BECKMANN != 0 or kind & KIND_MASK == ASHIKHMIN_SHIRLEY
    outward = row3(lobes.geometric_normal, k)
    even, parts, part = False, 1, 0
    wide = grain = 2.0 * alpha
    while part < parts:
        go_on(paths, k, out, m, hits, frames, lobes.normal, lobes.flags, limits, w[0], w[1], w[2], d[0], d[1], d[2],
              ray_kind, np.int64(1) - transmission, transmission)  # fmt: skip
        out.flags[m] |= flags
        out.bsdf_pdf[m] = pdf
        out.state.spread[m] = paths.state.spread[k]
        if part == 0:
            even = own >= 0.0 and open_curved(record.cones, m, out, shape, k, own, axis, outward, wi, d, eta)
            parts = 2 if alpha > 0.0 and not (small or alone or even) and _largest(w) > STRONG else 1
            wide = grain = min(wide * (CORE if parts == 2 else WIDE), 0.5 * WIDEST)
        else:
            wide *= (REST_OF_GAUSSIAN if beckmann else REST) / CORE
        if not even:
            open_cone(record.cones, m, out, wide, grain, across, d, axis, outward)
        record.alpha[m], record.beckmann[m], record.even[m] = alpha, beckmann, even
        record.part[m] = part + 1 if parts == 2 else 0
        record.ray[m], record.blur[m] = small, 0.0
        for c in range(3):
            record.side[m, c] = -outward[c] if transmission else outward[c]
            record.normal[m, c] = normal[c]
            record.incoming[m, c] = d[c] if transmission else wi[c]
        m, part = m + 1, part + 1
    return m


@device
def _refract(
    paths, k, j, hits, frames, lobes, limits, w, factor, wi, u, v, out, m, record, glints, sampled, small, rough,
    ray, alone, own, shape,
):  # fmt: skip
    """The ray or the cone of a lobe that transmits; returns the next row. Arguments as of `_reflect`.

    sampled: light samples look for what shines in it, too (lobe_shares.share_with_lobes).
    """
    kind = lobes.kind[k, j]
    nm = load3(lobes.data, k, j, NORMAL)
    singular, said = _singular(kind)
    inverse = inverse_ior(lobes, k, j)
    d, bend, refracts = refraction(nm, wi, inverse, rough)
    seen = np.int64(SEES_LAMPS) if glints else np.int64(0)
    if ray:
        wo, weight, density, _ = draw_direction(lobes, k, j, wi, True, u, v)
        if _largest(weight) > 0.0:
            send_ray(paths, k, out, m, hits, frames, lobes, limits, weight, factor, wo, density,
                     RAY_TRANSMISSION | RAY_GLOSSY | said, np.int64(0), np.int64(1), record, bend)  # fmt: skip
            out.flags[m] |= seen
            if sampled:
                out.bsdf_pdf[m] = refracted_pdf(bend * bend, d, wo)
            m += 1
        return m
    if not refracts or dot(row3(lobes.geometric_normal, k), d) >= 0.0:
        return m
    # what hardly bends light hardly spreads it
    sharp = singular != 0 or bend * bend <= SINGULAR_ALPHA_SQUARED
    pdf = BY_LOBE if sampled and not sharp else math.inf
    return _open_cones(
        paths, k, hits, frames, lobes, limits, w, d, nm, 1.0, RAY_TRANSMISSION | RAY_GLOSSY | said, np.int64(1),
        seen, pdf, 0.0 if sharp else bend, kind, small, alone, (0.0, 0.0, 0.0), wi, out, m, record, own, shape,
        inverse,
    )  # fmt: skip
