"""Direct light: one light sample per point, weighed against the BSDF, and a shadow ray through transparent surfaces."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.image.film import clamp_light
from pointmr_engine.numerics.hashing import hash_path
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import sample_4d
from pointmr_engine.raytracing import walk
from pointmr_engine.raytracing.light_sampling import LAMP, NONE, TRIANGLE, LightSamples
from pointmr_engine.raytracing.path_arrays import FINAL, Limits, Paths, Samples
from pointmr_engine.raytracing.paths import only_diffuse
from pointmr_engine.raytracing.rays import Hits, Rays, allocate_rays
from pointmr_engine.scene.group import DIFFUSE, GLOSSY, SHADOW, TRANSMISSION
from pointmr_engine.shading.bsdf.layout import (
    BUMPED,
    HAS_EVALUATION,
    HAS_TRANSMISSION,
    KIND_MASK,
    TRANSLUCENT,
)
from pointmr_engine.shading.bsdf.vector import combine, dot, row3
from pointmr_engine.shading.lobes import evaluate, value_of

# of a shadow ray's light, for each surface that it has passed: chance decides about what has less left
FAINT = 0.01
_SHORT = 1.0 - 1e-6  # shadow rays end this much before the light, so as not to meet what it is made of


class ShadowRays(NamedTuple):
    """Shadow rays and what they would add to a sample's radiance."""

    rays: Rays
    light: np.ndarray  # (N, 3) float64
    matt: np.ndarray  # (N, 3) float64: what Lambertian and Oren-Nayar lobes have of it ...
    glossy: np.ndarray  # (N, 3) float64: ... and glossy ones
    slot: np.ndarray  # (N,) int32
    whole: np.ndarray  # (N,) float64: the largest channel of what it would have added before it met a surface
    passed: np.ndarray  # (N,) int32: transparent surfaces so far
    source: np.ndarray  # (N,) int32: row of the path that it belongs to
    raised: np.ndarray  # (N,) bool: starts off a coarse triangle that looks smooth (terminator.raise_origins)


def allocate_shadow_rays(n: int) -> ShadowRays:
    """Room for n shadow rays."""
    slot, passed, source = (np.zeros(n, np.int32) for _ in range(3))
    light, matt, glossy = np.zeros((3, n, 3))
    raised = np.zeros(n, np.bool_)
    return ShadowRays(allocate_rays(n), light, matt, glossy, slot, np.zeros(n), passed, source, raised)


@uncounted
def choose_points(
    paths: Paths,
    samples: Samples,
    lobes,
    frames,
    tables,
    bounce,
    alive,
    n,
    rows,
    position,
    normal,
    transmissive,
    u,
):  # noqa: E501
    """The points of paths 0..n that light samples are worth it for, with their random numbers; returns how many."""
    m = np.int64(0)
    for k in range(n):
        if not alive[k] or not lobes.flags[k] & HAS_EVALUATION or paths.flags[k] & FINAL:
            continue
        rows[m] = k
        for a in range(3):  # rows at once would take numba longer to compile, here and below
            position[m, a] = frames.position[k, a]
            normal[m, a] = lobes.normal[k, a]
        transmissive[m] = (lobes.flags[k] & HAS_TRANSMISSION) != 0
        slot = paths.slot[k]
        u0, u1, u2, _ = sample_4d(tables, samples.seed[slot], 2 * bounce + 1, samples.number[slot])
        u[m, 0], u[m, 1], u[m, 2] = u0, u1, u2
        m += 1
    return m


@device
def _split(out, n, light, some, whole, seen):
    """Row n of out: what lobes that reflect `some` of `whole` have of the light, if they are `seen` by it."""
    for a in range(3):
        out[n, a] = light[a] * some[a] / whole[a] if seen and whole[a] != 0.0 else 0.0


@uncounted
def connect(
    paths: Paths,
    hits: Hits,
    frames,
    lobes,
    limits: Limits,
    lights: LightSamples,
    rows,
    m,
    out: ShadowRays,
):
    """Shadow rays for light samples 0..m of paths `rows`, those that could add anything; returns how many.

    Rays that stand for those that lobes send (LightSamples.scattered) start on the triangle, above it where nothing is
    transmitted, and meet what diffuse rays do.
    """
    n = np.int64(0)
    for i in range(m):
        if lights.kind[i] == NONE or not lights.pdf[i] > 0.0:
            continue
        k = np.int64(rows[i])  # as everywhere: another type would compile the lobes once more
        light = lights.radiance[i]
        if light[0] == 0 and light[1] == 0 and light[2] == 0:
            continue
        d = paths.rays.direction[k]
        wo = (lights.direction[i, 0], lights.direction[i, 1], lights.direction[i, 2])
        scattered = lights.scattered[i]
        # lobes send nothing to below the triangle: of a closed surface, its other side would shine there
        above = scattered or (limits.diffuse_by_lights and lights.kind[i] == TRIANGLE)
        if above and not lobes.flags[k] & HAS_TRANSMISSION and dot(row3(lobes.geometric_normal, k), wo) < 0.0:
            continue
        diffuse, matt, glossy, transmission, pdf = evaluate(lobes, k, (-d[0], -d[1], -d[2]), wo)
        if limits.diffuse_by_lights and lights.kind[i] != LAMP and lobes.flags[k] & HAS_TRANSMISSION:
            by_rays = _sent_through(lobes, k, wo, 0.0 if scattered else lights.anywhere[i], pdf)
            diffuse = combine(1.0, diffuse, 1.0, by_rays)
        seen = lights.visibility[i]
        f0, f1, f2 = 0.0, 0.0, 0.0
        if seen & DIFFUSE:
            f0, f1, f2 = f0 + diffuse[0], f1 + diffuse[1], f2 + diffuse[2]
        if seen & GLOSSY:
            f0, f1, f2 = f0 + glossy[0], f1 + glossy[1], f2 + glossy[2]
        if seen & TRANSMISSION:
            f0, f1, f2 = f0 + transmission[0], f1 + transmission[1], f2 + transmission[2]
        weight = 1.0 / (lights.pdf[i] * lights.times[i])
        if lights.mis[i] and not (limits.diffuse_by_lights and only_diffuse(lobes.count, lobes.kind, k)):
            ratio = pdf / lights.pdf[i]
            weight /= 1.0 + ratio * ratio
        t = paths.throughput[k]
        r, g, b = t[0] * f0 * light[0] * weight, t[1] * f1 * light[1] * weight, t[2] * f2 * light[2] * weight
        if not (max(abs(r), abs(g), abs(b)) > 0.0 and math.isfinite(r + g + b)):
            continue
        limit = limits.clamp_direct if paths.state.depth[k] == 0 else limits.clamp_indirect
        r, g, b = clamp_light(r, g, b, limit)
        out.light[n, 0], out.light[n, 1], out.light[n, 2] = r, g, b
        _split(out.matt, n, (r, g, b), matt, (f0, f1, f2), seen & DIFFUSE)
        _split(out.glossy, n, (r, g, b), glossy, (f0, f1, f2), seen & GLOSSY)
        out.slot[n] = paths.slot[k]
        out.whole[n] = max(abs(r), abs(g), abs(b))
        out.source[n] = k
        out.passed[n] = paths.state.transparent_depth[k]
        for a in range(3):
            out.rays.origin[n, a] = frames.position[k, a]
            out.rays.direction[n, a] = wo[a]
        out.rays.t_min[n] = frames.offset[k]
        # a lamp without shadows is met by a ray that has no length
        out.rays.t_max[n] = lights.distance[i] * _SHORT if lights.cast_shadow[i] else 0.0
        out.rays.visibility[n] = DIFFUSE if scattered else SHADOW
        out.rays.skip_triangle[n] = hits.triangle[k]
        out.rays.skip_path[n] = hits.path[k]
        out.raised[n] = not scattered
        n += 1
    return n


@device
def _sent_through(lobes, k, wo, of_light, of_lobes):
    """What bumped translucent lobes of point k send toward wo beyond what `evaluate` says, where no rays of theirs look
    for lights, but those of Cycles do.

    Bumps darken what is sent to samples of lights, and nothing that is sent by rays through the surface. of_light,
    of_lobes: densities of both at wo, weighed by the power heuristic; of_light 0: there are rays alone.
    """
    added, wi = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)  # of no influence on what is translucent
    within = dot(row3(lobes.geometric_normal, k), wo) < 0.0
    for j in range(np.int64(lobes.count[k])):
        kind = lobes.kind[k, j]
        if kind & KIND_MASK != TRANSLUCENT or not kind & BUMPED:
            continue
        by_ray, own, _ = value_of(lobes, k, np.int64(j), wi, wo, True)
        if not own > 0.0:
            continue
        by_light, _, _ = value_of(lobes, k, np.int64(j), wi, wo, False)
        ratio = of_light / max(own, of_lobes)
        weight = 1.0 / (1.0 + ratio * ratio)
        added = combine(1.0, added, weight if within else 0.0, by_ray)
        added = combine(1.0, added, -weight, by_light)
    return added


@uncounted
def settle(shadows: ShadowRays, hits: Hits, samples: Samples, limit, n, waiting):
    """Add the light of shadow rays 0..n that nothing stops; rows that a transparent surface meets go to `waiting`."""
    m = np.int64(0)
    for i in range(n):
        if hits.triangle[i] == walk.BLOCKED:
            continue
        if hits.triangle[i] >= 0:
            if shadows.passed[i] < limit:
                waiting[m] = i
                m += 1
            continue
        slot = shadows.slot[i]
        for a in range(3):
            samples.radiance[slot, a] += shadows.light[i, a]
    return m


@device
def _chance(shadows, samples, i, passed):
    """A number in 0..1 of shadow ray i, another one behind each of the surfaces that it has passed."""
    slot = shadows.slot[i]
    h = hash_path(np.uint64(samples.seed[slot]), np.int64(samples.number[slot]))
    h = hash_path(h, np.int64(passed))
    h = hash_path(h, np.int64(shadows.rays.direction[i, 0] * 2.0**40))  # rays of one point differ by it
    return np.float64(h >> np.uint64(11)) * 2.0**-53


@uncounted
def dim(shadows: ShadowRays, samples: Samples, veils, waiting, taken, hits: Hits, frames, share):
    """Shadow rays `waiting` pass taken (len(waiting),) surfaces each; those that go on are packed to rows 0.., counted.

    hits, frames: of these surfaces, ray after ray, nearest first; share (M, 3): what each lets through. Rays that have
    hardly any light left go on by chance (Russian roulette).
    """
    n, first = np.int64(0), np.int64(0)
    for j in range(len(waiting)):
        i, last = waiting[j], first + taken[j] - 1
        r, g, b = shadows.light[i, 0], shadows.light[i, 1], shadows.light[i, 2]
        alive = True
        for k in range(first, last + 1):
            r, g, b = r * share[k, 0], g * share[k, 1], b * share[k, 2]
            passed = shadows.passed[i] + (k - first)
            left, least = max(abs(r), abs(g), abs(b)), FAINT * (1 + passed) * shadows.whole[i]
            if left < least:
                if not left > least * _chance(shadows, samples, i, passed):
                    alive = False
                    break
                r, g, b = r * (least / left), g * (least / left), b * (least / left)
        first = last + 1
        if not alive:
            continue
        for a, now in enumerate((r, g, b)):
            before = shadows.light[i, a]
            share_left = now / before if before != 0.0 else 0.0
            shadows.matt[n, a] = shadows.matt[i, a] * share_left
            shadows.glossy[n, a] = shadows.glossy[i, a] * share_left
            shadows.light[n, a] = now
        shadows.slot[n] = shadows.slot[i]
        shadows.whole[n] = shadows.whole[i]
        shadows.source[n] = shadows.source[i]
        shadows.passed[n] = shadows.passed[i] + taken[j]
        rays = shadows.rays
        for a in range(3):
            rays.origin[n, a] = rays.origin[i, a]
            rays.direction[n, a] = rays.direction[i, a]
        rays.t_min[n] = hits.t[last] + frames.offset[last]
        rays.t_max[n] = rays.t_max[i]
        rays.visibility[n] = rays.visibility[i]
        rays.skip_triangle[n] = hits.triangle[last]
        rays.skip_path[n] = hits.path[last]
        veils.row[n] = veils.row[i]
        n += 1
    return n
