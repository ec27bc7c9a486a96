"""Rays of diffuse lobes: through leaves, and where diffuse light may bounce.

Their lights have been sampled where they leave, so that of what they meet, only what it reflects counts.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.lobes.lobe_paths import BY_SAMPLES, lobe_place, send_ray, survives
from pointmr_engine.multires.sharing.light_shares import MOST_DIFFUSE
from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.rng import R2, sample_1d
from pointmr_engine.raytracing.path_arrays import UNSHARED
from pointmr_engine.shading.bsdf.layout import KIND_MASK, NORMAL, OREN_NAYAR, TRANSLUCENT, WEIGHT
from pointmr_engine.shading.bsdf.vector import cosine_hemisphere, dot, load3, row3
from pointmr_engine.shading.lobes import diffuse_direction, value_of
from pointmr_engine.shading.points import RAY_DIFFUSE, RAY_REFLECTION, RAY_TRANSMISSION

WEAK = 0.5  # throughputs below it go on by chance, for lights have been sampled
# rays of a cone that sees one surface; its fragments have their shares of them, up to MOST_DIFFUSE
DIFFUSE_RAYS = 16.0
# what the rays stand for, as if they were of a lobe this rough: of what passes leaves, and of what bounces
THROUGH_ROUGH, BOUNCE_ROUGH = 0.4, 0.2


@device
def may_bounce(paths, limits, k):
    """Whether diffuse lobes of path k may send rays that would find more than what shines."""
    return paths.state.depth[k] < limits.bounces and paths.state.diffuse_depth[k] < limits.diffuse


@device
def scatter_diffuse(
    paths, samples, k, hits, frames, lobes, limits, tables, bounce, wi, wanted, room, out, m, record
):  # fmt: skip
    """The rays of point k's diffuse lobes, while there is `room`; returns the next row.

    wanted: rays of each that reflects; less than 1: by chance.

    They go on beside what else does, for where one of both is chosen by chance, weak lobes beside them would stand for
    them, too. Matt lobes send theirs together, and share what these find (light_shares.begin_shares). Others as of
    scatter.scatter_lobes.
    """
    bounces, matt = may_bounce(paths, limits, k) or limits.seeks, False
    for j in range(np.int64(lobes.count[k])):
        base = lobes.kind[k, j] & KIND_MASK
        if m + 1 > room or base > TRANSLUCENT:
            continue
        if base == TRANSLUCENT:
            m = _through(
                paths, samples, k, np.int64(j), hits, frames, lobes, limits, tables, bounce, out, m, record
            )
        elif bounces and not (matt and base <= OREN_NAYAR):
            matt = matt or base <= OREN_NAYAR
            u, v = lobe_place(tables, samples, paths.slot[k], bounce, k, j)
            times = min(max(np.int64(wanted), np.int64(1)), np.int64(MOST_DIFFUSE), room - m)
            for number in range(times):
                m = _reflect(
                    paths, samples, k, np.int64(j), base <= OREN_NAYAR, number, times, wanted, u, v, hits, frames,
                    lobes, limits, tables, bounce, wi, out, m, record,
                )  # fmt: skip
                u, v = (u + R2[0]) % 1.0, (v + R2[1]) % 1.0
    return m


@device
def _goes_on(samples, tables, bounce, weak, out, m, k, slot, number):
    """Whether row m, the ray of that number of point k's diffuse lobe, goes on; by chance if it is below `weak`."""
    out.bsdf_pdf[m] = BY_SAMPLES
    seed = np.uint32(samples.seed[slot] ^ np.uint32(k) ^ np.uint32(number << 24))
    chance = sample_1d(tables, seed, np.uint32(64 * bounce + 11), samples.number[slot])
    return survives(out, m, chance, weak)


@device
def _through(paths, samples, k, j, hits, frames, lobes, limits, tables, bounce, out, m, record):
    """The ray of a translucent lobe, if it goes on, which counts as transmission (as in Cycles)."""
    slot, nm = paths.slot[k], load3(lobes.data, k, j, NORMAL)
    u, v = lobe_place(tables, samples, slot, bounce, k, j)
    wo = cosine_hemisphere((-nm[0], -nm[1], -nm[2]), u, v)
    if dot(row3(lobes.geometric_normal, k), wo) >= 0.0:
        return m
    send_ray(paths, k, out, m, hits, frames, lobes, limits, load3(lobes.data, k, j, WEIGHT), 1.0, wo,
             -dot(nm, wo) / math.pi, RAY_TRANSMISSION | RAY_DIFFUSE, np.int64(0), np.int64(1), record,
             THROUGH_ROUGH)  # fmt: skip
    return m + 1 if _goes_on(samples, tables, bounce, WEAK, out, m, k, slot, np.int64(0)) else m


@device
def _reflect(
    paths, samples, k, j, matt, number, times, wanted, u, v, hits, frames, lobes, limits, tables, bounce, wi, out, m,
    record,
):  # fmt: skip
    """A ray of diffuse lobe j, or of all matt lobes of which it is the first, if it goes on: that `number` of `times`.

    wanted: as of `scatter_diffuse`; u, v: random numbers.
    """
    slot = paths.slot[k]
    chosen, total = j, np.float64(0)
    if matt:
        for i in range(j, np.int64(lobes.count[k])):
            total += _share(lobes, k, np.int64(i))
        left = u * total
        for i in range(j, np.int64(lobes.count[k])):
            share = _share(lobes, k, np.int64(i))
            if share > 0.0:
                chosen, u = np.int64(i), min(left / share, 0.9999999999)
                if left < share:
                    break
                left -= share
    wo = diffuse_direction(lobes, k, chosen, u, v)
    if dot(row3(lobes.geometric_normal, k), wo) <= 0.0:
        return m
    r, g, b, density = 0.0, 0.0, 0.0, 0.0
    for i in range(j, np.int64(lobes.count[k])):
        share = _share(lobes, k, np.int64(i)) if matt else np.float64(i == j)
        if not share > 0.0:
            continue
        f, pdf, _ = value_of(lobes, k, np.int64(i), wi, wo, i == chosen)
        r, g, b = r + f[0], g + f[1], b + f[2]
        density += share * pdf / (total if matt else 1.0)
    if not density > 0.0:
        return m
    w = (r / density, g / density, b / density)
    send_ray(paths, k, out, m, hits, frames, lobes, limits, w, 1.0 / times, wo, density,
             RAY_REFLECTION | RAY_DIFFUSE, np.int64(0), np.int64(0), record, BOUNCE_ROUGH)  # fmt: skip
    if not matt:
        out.flags[m] |= UNSHARED
    t, o = paths.throughput[k], out.throughput[m]
    # of a first surface; behind, of what came so far: rays of which there are several are weak by that alone
    weak = WEAK * (1.0 if bounce == 0 else max(t[0], t[1], t[2])) / times
    weak = max(weak, max(o[0], o[1], o[2]) / min(wanted, 1.0))
    return m + 1 if _goes_on(samples, tables, bounce, weak, out, m, k, slot, number) else m


@device
def _share(lobes, k, i):
    """Chance, times that of all, by which the matt lobe i of point k is chosen; 0 of others."""
    if lobes.kind[k, i] & KIND_MASK > OREN_NAYAR:
        return np.float64(0)
    w = load3(lobes.data, k, i, WEIGHT)
    return max(abs(w[0]), abs(w[1]), abs(w[2]))
