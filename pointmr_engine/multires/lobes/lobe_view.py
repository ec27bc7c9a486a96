"""What the cones of lobes see: their fragments go on as paths, weighted by the part of the lobe that each one fills.

A cone's 64 sub-rays are weighted by the lobe itself, a microfacet distribution seen from where the path comes, and not
by a Gaussian that stands for it. What escapes goes on as one path to the world, narrowed to the open part of the lobe.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.cones.cone_hits import choose_bit
from pointmr_engine.multires.cones.cones import direction_of
from pointmr_engine.multires.lobes.lobe_cones import (
    BY_LOBE,
    THROUGH_MIRROR,
    WITHIN_LOBE,
    LobeCones,
    finds_lights,
    in_square,
    looks_within,
    pdf_of,
    slopes_of,
)
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import R1, sample_1d
from pointmr_engine.raytracing.path_arrays import Paths, copy_path, copy_ray, note_density
from pointmr_engine.shading.bsdf.microfacet import distribution, smith_lambda
from pointmr_engine.shading.bsdf.vector import dot, row3
from pointmr_engine.shading.points import RAY_CAMERA, RAY_SINGULAR

_NEARLY_SHARP = 1e-6  # roughness of what a ray within a lobe sees: lamps are not seen by it
NARROWEST = 1e-30  # what is found of a lobe at the middles of its cells, below which these tell nothing of it
# places per side at which the lobe is taken in cells that its core covers in part, and in others beside it
FINE, FINE_BESIDE = 4, 2


@device
def _density(lobes: LobeCones, m, u, v, alpha2):
    """What the lobe of cone m sends through slopes (u, v), per area of slopes, times a constant; 0 in its core's."""
    c = lobes.cones
    inverse = 1.0 / math.sqrt(1.0 + u * u + v * v)
    w = inverse * inverse * inverse
    nx, ny, nz = lobes.normal[m, 0], lobes.normal[m, 1], lobes.normal[m, 2]
    dx, dy, dz = direction_of(c, m, u, v)
    dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
    if lobes.part[m] == 2 and in_square(c, m - 1, dx, dy, dz):
        return 0.0
    beckmann = lobes.beckmann[m]
    if nx * nx + ny * ny + nz * nz == 0.0:
        return w * distribution(beckmann, (u * u + v * v) / (4.0 * alpha2), 0.0, 1.0, alpha2)
    cosine = nx * dx + ny * dy + nz * dz
    if cosine <= 0.0:
        return 0.0
    hx, hy, hz = dx + lobes.incoming[m, 0], dy + lobes.incoming[m, 1], dz + lobes.incoming[m, 2]
    h = (nx * hx + ny * hy + nz * hz) / math.sqrt(hx * hx + hy * hy + hz * hz)
    if h <= 0.0:
        return 0.0
    h2, c2 = h * h, cosine * cosine
    visible = 1.0 / (1.0 + smith_lambda(beckmann, alpha2 * (1.0 - c2) / c2))
    return w * visible * distribution(beckmann, (1.0 - h2) / alpha2, 0.0, h2, alpha2)


@device
def _weigh(lobes: LobeCones, m):
    """Fill the weights of cone m by what its lobe sends through the sub-rays' cells; returns their sum."""
    c = lobes.cones
    alpha2 = np.float64(lobes.alpha[m]) ** 2
    wide_u, wide_v = 0.25 * c.spread[m, 0], 0.25 * c.spread[m, 1]
    # cells of the rest that the core covers in part send what is left of them
    near = 1.3 * c.spread[m - 1, 0] if lobes.part[m] == 2 else 0.0
    total = 0.0
    for b in range(64):
        u, v = ((b & 7) - 4.0) * wide_u, ((b >> 3) - 4.0) * wide_v
        across = max(abs(u + 0.5 * wide_u), abs(v + 0.5 * wide_v) * wide_u / max(wide_v, 1e-30))
        n = np.int64(1 if lobes.part[m] != 2 else FINE if across < near else FINE_BESIDE)
        w = 0.0
        for j in range(n):
            for i in range(n):
                w += _density(lobes, m, u + (i + 0.5) / n * wide_u, v + (j + 0.5) / n * wide_v, alpha2)
        w *= wide_u * wide_v / (n * n)
        lobes.weights[m, b] = w
        total += w
    return total


@uncounted
def choose_places(paths: Paths, samples, tables, bounce, count, out):
    """out (N,) float64: by what numbers in [0, 1) the cones 0..count choose among their sub-rays.

    Stratified over what lies side by side in the image, as the samples' numbers are; cones of one sample share it out.
    """
    turn = 0
    for m in range(count):
        slot = paths.slot[m]
        turn = turn + 1 if m > 0 and paths.slot[m - 1] == slot else 0
        chance = sample_1d(tables, samples.seed[slot], np.uint32(64 * bounce + 9), samples.number[slot])
        out[m] = (chance + turn * R1) % 1.0


@device
def _whole(lobes: LobeCones, k):
    """What the sub-rays of cone k weigh together: less than 1 where the lobe has two cones, or bumps lose a part."""
    total = 0.0
    for b in range(64):
        total += np.float64(lobes.weights[k, b])
    return total


@uncounted
def thin_out(paths: Paths, lobes: LobeCones, chances, strong, count):
    """Cones 0..count of throughput below `strong`, or not worth it, become a ray each: a sub-ray, by weight."""
    c = lobes.cones
    for m in range(count):
        t = paths.throughput[m]
        if lobes.alpha[m] < 0 or lobes.part[m] != 0 or (max(t[0], t[1], t[2]) >= strong and not lobes.ray[m]):
            continue
        c.t_min[m] = c.t_max[m] = 0.0
        for a in range(3):
            lobes.behind[m, a] = 1
        if lobes.alpha[m] <= 0.0:
            lobes.alpha[m] = THROUGH_MIRROR
            paths.bsdf_pdf[m] = math.inf
            continue
        whole = np.float32(_whole(lobes, np.int64(m)))
        for a in range(3):
            t[a] *= whole
        b = choose_bit(np.int64(-1), lobes.weights, np.int64(m), chances[m])
        u, v = slopes_of(c, m, b)
        inverse = 1.0 / math.sqrt(1.0 + u * u + v * v)
        x, y, z = direction_of(c, m, u, v)
        d = paths.rays.direction
        d[m, 0], d[m, 1], d[m, 2] = x * inverse, y * inverse, z * inverse
        density = pdf_of(lobes, m, np.float64(lobes.alpha[m]), row3(paths.rays.direction, m))
        note_density(paths, m, density)
        if paths.bsdf_pdf[m] == BY_LOBE:
            paths.bsdf_pdf[m] = density
        lobes.rough[m] = lobes.alpha[m]
        lobes.alpha[m] = WITHIN_LOBE


@uncounted
def weigh_sub_rays(lobes: LobeCones, count):
    """Weights of the sub-rays of cones 0..count: equal for mirrors, by their distribution for rough lobes."""
    total = 0.0
    for m in range(count):
        if lobes.alpha[m] <= 0.0 or lobes.even[m]:
            for b in range(64):
                lobes.weights[m, b] = np.float32(1.0 / 64.0)
            continue
        first = m - 1 if lobes.part[m] == 2 else m
        total = _weigh(lobes, np.int64(m)) + (total if first < m else 0.0)
        if lobes.part[m] == 1:
            continue
        if not total > NARROWEST:
            _look_ahead(lobes, np.int64(first), np.int64(m))
            continue
        scale = np.float32(1.0 / total)
        for k in range(first, m + 1):
            for b in range(64):
                lobes.weights[k, b] *= scale if _goes_on(lobes, np.int64(k), np.int64(b)) else np.float32(0.0)


@device
def _goes_on(lobes: LobeCones, k, b):
    """Whether sub-ray b of cone k leaves the surface."""
    u, v = slopes_of(lobes.cones, k, b)
    return dot(row3(lobes.side, k), direction_of(lobes.cones, k, u, v)) >= 0.0


@device
def _look_ahead(lobes: LobeCones, first, last):
    """Weights of the cones of a lobe far narrower than their cells: of the four in the middle of the first."""
    for k in range(first, last + 1):
        for b in range(64):
            lobes.weights[k, b] = 0.0
    for b in (27, 28, 35, 36):
        lobes.weights[first, b] = 0.25


@device
def _look(lobes: LobeCones, k, mask):
    """(weight, mean direction) of the sub-rays `mask` of cone k."""
    c = lobes.cones
    total, u, v = 0.0, 0.0, 0.0
    for b in range(64):
        if (mask >> np.uint64(b)) & np.uint64(1):
            w = np.float64(lobes.weights[k, b])
            total += w
            u += w * (((b & 7) + 0.5) * 0.25 - 1.0)
            v += w * (((b >> 3) + 0.5) * 0.25 - 1.0)
    if total > 0.0:
        u, v = u / total * c.spread[k, 0], v / total * c.spread[k, 1]
    x, y, z = direction_of(c, k, u, v)
    inverse = 1.0 / math.sqrt(x * x + y * y + z * z)
    return total, x * inverse, y * inverse, z * inverse


@uncounted
def follow_cones(
    paths: Paths,
    lobes: LobeCones,
    fragments,
    escaped,
    count,
    n,
    room,
    out: Paths,
    hits,
    alpha,
    behind,
    blur,
    around,
):
    """Paths for what the cones of paths 0..n see, into out; returns (rows of hits, of escapes, of straight rays).

    fragments: count rows of cone_hits.gather, whose rays and hits are rows 0..count of out.rays and hits already. alpha
    (M,) float32: roughness of what is left of the lobe in each row; of what is met, `around` times its part. behind
    (M, 3) float32: LobeCones.behind of each row; blur (M,) float32: its blur. Straight rays have yet to be walked.
    """
    for r in range(count):
        k = np.int64(fragments.cone[r])
        weight, _, _, _ = _look(lobes, k, fragments.mask[r])
        copy_path(paths, k, weight, out, np.int64(r))
        density = pdf_of(lobes, k, np.float64(lobes.alpha[k]), row3(out.rays.direction, r))
        note_density(out, np.int64(r), density)
        if paths.bsdf_pdf[k] == BY_LOBE:
            out.bsdf_pdf[r] = density
        elif finds_lights(paths, lobes, k):
            out.bsdf_pdf[r] = looks_within(lobes, k, row3(out.rays.direction, r))
        out.rays.visibility[r] = paths.rays.visibility[k]
        share = math.sqrt(min(weight, 1.0))
        a = max(np.float64(lobes.alpha[k]), 0.0)
        out.state.spread[r] += 2.0 * a * share
        # the sub-ray that met it was chosen within the lobe, as a ray is
        alpha[r] = around * a * share
        blur[r] = lobes.blur[k]
    m = np.int64(count)
    for k in range(n):
        if lobes.alpha[k] < 0 or escaped[k] == np.uint64(0) or m >= room:
            continue
        weight, x, y, z = _look(lobes, np.int64(k), escaped[k])
        if not weight > 0.0:
            continue
        copy_path(paths, np.int64(k), weight, out, m)
        copy_ray(paths.rays, np.int64(k), out.rays, m)
        out.rays.direction[m, 0], out.rays.direction[m, 1], out.rays.direction[m, 2] = x, y, z
        alpha[m] = lobes.alpha[k] * math.sqrt(min(weight / _whole(lobes, np.int64(k)), 1.0))
        blur[m] = lobes.blur[k]
        hits.triangle[m] = -1
        hits.t[m] = math.inf
        m += 1
    escapes = m - count
    behind[:m] = 1
    for k in range(n):
        if lobes.alpha[k] < 0 and m < room:
            copy_path(paths, np.int64(k), 1.0, out, m)
            copy_ray(paths.rays, np.int64(k), out.rays, m)
            for c in range(3):
                behind[m, c] = lobes.behind[k, c]
            blur[m] = lobes.blur[k]
            sharp = np.int64(paths.state.kind[k]) & (RAY_CAMERA | RAY_SINGULAR) != 0
            alpha[m] = 0.0 if sharp else _NEARLY_SHARP
            if lobes.alpha[k] == WITHIN_LOBE:
                alpha[m] = max(_NEARLY_SHARP, around * np.float64(lobes.rough[k]))
            m += 1
    return count, escapes, m - count - escapes
