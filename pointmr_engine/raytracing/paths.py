"""Paths of a tile: the kernels that end paths and send them on."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.image.film import clamp_light
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import sample_1d, sample_4d
from pointmr_engine.raytracing.path_arrays import (
    BACKDROP,
    FINAL,
    LAST,
    THROUGH,
    Limits,
    Paths,
    Samples,
    Scattered,
    note_density,
)
from pointmr_engine.scene.group import DIFFUSE, GLOSSY, TRANSMISSION
from pointmr_engine.shading.bsdf.layout import (
    HAS_TRANSMISSION,
    KIND_MASK,
    LABEL_DIFFUSE,
    LABEL_NONE,
    LABEL_REFLECT,
    LABEL_SINGULAR,
    LABEL_TRANSPARENT,
    NORMAL,
    TRANSLUCENT,
    WEIGHT,
)
from pointmr_engine.shading.lobes import sample as sample_lobes
from pointmr_engine.shading.points import (
    RAY_DIFFUSE,
    RAY_GLOSSY,
    RAY_REFLECTION,
    RAY_SINGULAR,
    RAY_TRANSMISSION,
)


@uncounted
def add_radiance(paths: Paths, samples: Samples, limits: Limits, radiance, weight, n):
    """Add throughput * radiance (n, 3) * weight (n,) of paths 0..n to their samples."""
    for k in range(n):
        r = float(radiance[k, 0]) * weight[k]
        g = float(radiance[k, 1]) * weight[k]
        b = float(radiance[k, 2]) * weight[k]
        if r == 0.0 and g == 0.0 and b == 0.0:
            continue
        t = paths.throughput[k]
        limit = limits.clamp_direct if paths.state.depth[k] <= 1 else limits.clamp_indirect
        r, g, b = clamp_light(r * t[0], g * t[1], b * t[2], limit)
        slot = paths.slot[k]
        samples.radiance[slot, 0] += r
        samples.radiance[slot, 1] += g
        samples.radiance[slot, 2] += b


@uncounted
def see_through(paths: Paths, samples: Samples, missed, n):
    """Paths that meet nothing but a transparent film: their share goes to the sample's transparency."""
    for k in range(n):
        if missed[k] and paths.flags[k] & BACKDROP:
            t = paths.throughput[k]
            samples.transparency[paths.slot[k]] += (float(t[0]) + float(t[1]) + float(t[2])) / 3.0


@uncounted
def hold_out(paths: Paths, samples: Samples, hits, lobes, alive, n):
    """Holdout objects and shaders: what they cover becomes transparency; paths that end here are no longer alive."""
    for k in range(n):
        if not alive[k] or not paths.flags[k] & BACKDROP:
            continue
        t = paths.throughput[k]
        if hits.holdout[k]:
            clear = lobes.transparency[k]
            covered = 0.0
            for c in range(3):
                covered += (1.0 - min(float(clear[c]), 1.0)) * t[c] / 3.0
            lobes.count[k] = 0
            lobes.flags[k] = 0
            for c in range(3):
                lobes.emission[k, c] = 0.0
        elif lobes.holdout[k] > 0.0:
            covered = lobes.holdout[k] * (float(t[0]) + float(t[1]) + float(t[2])) / 3.0
        else:
            continue
        samples.transparency[paths.slot[k]] += covered
        left = 0.0
        for c in range(3):
            left = max(left, float(lobes.transparency[k, c]), float(lobes.emission[k, c]))
        if lobes.count[k] == 0 and left <= 0.0:
            alive[k] = False


@uncounted
def average_normals(lobes, rows, out):
    """Normals of the points `rows` as their lobes see them, weighted as they are, into out (len(rows), 3)."""
    for i in range(len(rows)):
        k = rows[i]
        x, y, z = 0.0, 0.0, 0.0
        for j in range(lobes.count[k]):
            d = lobes.data[k, j]
            w = (abs(d[WEIGHT]) + abs(d[WEIGHT + 1]) + abs(d[WEIGHT + 2])) / 3.0
            x += w * d[NORMAL]
            y += w * d[NORMAL + 1]
            z += w * d[NORMAL + 2]
        size = math.sqrt(x * x + y * y + z * z)
        if size > 0.0:
            out[i, 0], out[i, 1], out[i, 2] = x / size, y / size, z / size
        else:
            for c in range(3):
                out[i, c] = lobes.normal[k, c]


@uncounted
def finish_final(flags, lobe_count, lobe_flags, alive, n):
    """Paths that may not scatter any more keep only what lies straight behind."""
    for k in range(n):
        if alive[k]:
            if flags[k] & LAST:
                alive[k] = False
            elif flags[k] & FINAL:
                lobe_count[k] = 0
                lobe_flags[k] = 0


@uncounted
def roulette(throughput, depth, flags, slot, seed, number, tables, bounce, alive, n):
    """Russian roulette by the throughput, once a path has scattered twice or passed a surface."""
    for k in range(n):
        if not alive[k] or (depth[k] <= 1 and not flags[k] & THROUGH):
            continue
        chance = math.sqrt(max(throughput[k, 0], throughput[k, 1], throughput[k, 2]))
        if chance >= 1.0:
            continue
        u = sample_1d(tables, seed[slot[k]], bounce, number[slot[k]])
        if u >= chance:
            alive[k] = False
        else:
            for c in range(3):
                throughput[k, c] /= chance


@device
def only_diffuse(lobe_count, lobe_kind, k):
    """Whether point k scatters by diffuse lobes and nothing else."""
    for j in range(lobe_count[k]):
        if (lobe_kind[k, j] & KIND_MASK) > TRANSLUCENT:
            return False
    return lobe_count[k] > 0


@uncounted
def scatter(paths: Paths, samples: Samples, lobes, limits: Limits, tables, bounce, alive, n, out: Scattered):
    """Sample the lobes of the paths 0..n that are alive; those that absorb their path are no longer alive.

    The throughput becomes that of the ray that goes on.
    """
    for k in range(n):
        if not alive[k]:
            continue
        d = paths.rays.direction[k]
        slot = paths.slot[k]
        u0, u1, u2, _ = sample_4d(tables, samples.seed[slot], 2 * bounce + 2, samples.number[slot])
        wo, value, pdf, label, alpha, _ = sample_lobes(lobes, k, (-d[0], -d[1], -d[2]), u0, u1, u2)
        if label == LABEL_NONE or not pdf > 0.0:
            alive[k] = False
            continue
        if limits.diffuse_by_lights and label & LABEL_DIFFUSE and only_diffuse(lobes.count, lobes.kind, k):
            alive[k] = False
            continue
        t = paths.throughput[k]
        r, g, b = t[0] * value[0] / pdf, t[1] * value[1] / pdf, t[2] * value[2] / pdf
        if not (max(r, g, b) > 0.0 and math.isfinite(r + g + b)):
            alive[k] = False
            continue
        t[0], t[1], t[2] = r, g, b
        out.label[k] = label
        out.alpha[k] = alpha
        out.pdf[k] = math.inf if label & LABEL_SINGULAR else pdf
        for a in range(3):
            out.direction[k, a] = wo[a]


@uncounted
def move(
    paths: Paths, hits, frames, scattered: Scattered, normal, flags, limits: Limits, alive, out: Paths, n
):
    """Write the paths 0..n that are alive to `out`, on their way from the surface; returns how many.

    normal (n, 3) and flags (n,) are those of the surface's lobes. What passes a surface straight is the same ray,
    begun later.
    """
    m = np.int64(0)
    a, b = paths.state, out.state
    for k in range(n):
        if not alive[k]:
            continue
        label = np.int64(scattered.label[k])
        kind = np.int64(a.kind[k])
        path_flags = np.int64(paths.flags[k])
        depth, passed = a.depth[k], a.transparent_depth[k]
        diffuse, glossy, transmission = a.diffuse_depth[k], a.glossy_depth[k], a.transmission_depth[k]
        visibility = paths.rays.visibility[k]
        b.density[m] = a.density[k]
        if label & LABEL_TRANSPARENT:
            passed += 1
            path_flags |= THROUGH
            if passed >= limits.transparent:
                path_flags |= LAST
            for c in range(3):
                out.rays.origin[m, c] = paths.rays.origin[k, c]
                out.rays.direction[m, c] = paths.rays.direction[k, c]
                out.origin_normal[m, c] = paths.origin_normal[k, c]
            out.rays.t_min[m] = hits.t[k] + frames.offset[k]
            out.rays.t_max[m] = paths.rays.t_max[k]
            out.bsdf_pdf[m] = paths.bsdf_pdf[k]
            out.origin_transmissive[m] = paths.origin_transmissive[k]
            b.width[m] = a.width[k]
            b.spread[m] = a.spread[k]
        else:
            depth += 1
            path_flags &= ~BACKDROP
            kind = RAY_REFLECTION if label & LABEL_REFLECT else RAY_TRANSMISSION
            kind |= RAY_DIFFUSE if label & LABEL_DIFFUSE else RAY_GLOSSY
            if label & LABEL_SINGULAR:
                kind |= RAY_SINGULAR
            if not label & LABEL_REFLECT:
                transmission += 1
                visibility = TRANSMISSION
            elif label & LABEL_DIFFUSE:
                diffuse += 1
                visibility = DIFFUSE
            else:
                glossy += 1
                visibility = GLOSSY
            if (
                depth > limits.bounces
                or diffuse > limits.diffuse
                or glossy > limits.glossy
                or transmission > limits.transmission
            ):
                path_flags |= FINAL
            for c in range(3):
                out.rays.origin[m, c] = frames.position[k, c]
                out.rays.direction[m, c] = scattered.direction[k, c]
                out.origin_normal[m, c] = normal[k, c]
            out.rays.t_min[m] = frames.offset[k]
            out.rays.t_max[m] = math.inf
            out.bsdf_pdf[m] = scattered.pdf[k]
            out.origin_transmissive[m] = (flags[k] & HAS_TRANSMISSION) != 0
            b.width[m] = a.width[k] + a.spread[k] * hits.t[k]
            b.spread[m] = a.spread[k] + scattered.alpha[k] * limits.lobe_spread
            note_density(out, m, scattered.pdf[k])
        for c in range(3):
            out.throughput[m, c] = paths.throughput[k, c]
        out.rays.visibility[m] = visibility
        out.rays.skip_triangle[m] = hits.triangle[k]
        out.rays.skip_path[m] = hits.path[k]
        out.flags[m] = path_flags
        out.slot[m] = paths.slot[k]
        b.kind[m] = kind
        b.depth[m] = depth
        b.diffuse_depth[m] = diffuse
        b.glossy_depth[m] = glossy
        b.transmission_depth[m] = transmission
        b.transparent_depth[m] = passed
        b.length[m] = 0
        m += 1
    return m
