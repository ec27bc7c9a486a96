"""What the cones of lobes see: their fragments go on as paths, weighted by the part of the lobe that each one fills.

A cone's 64 sub-rays are weighted by the lobe itself, a microfacet distribution seen from where the path comes, and not
by a Gaussian that stands for it. What escapes goes on as one path to the world, narrowed to the open part of the lobe.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.multires.cones.cone_hits import choose_bit
from pointmr_engine.multires.cones.cones import Cones, direction_of
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import R1, sample_1d
from pointmr_engine.raytracing.path_arrays import Paths, copy_path, copy_ray
from pointmr_engine.shading.bsdf.layout import IOR
from pointmr_engine.shading.bsdf.microfacet import distribution, smith_lambda
from pointmr_engine.shading.bsdf.vector import combine, dot, normalized, row3
from pointmr_engine.shading.points import RAY_CAMERA, RAY_SINGULAR

# LobeCones.alpha of rays: passing, or what a cone was
STRAIGHT, THROUGH_MIRROR, WITHIN_LOBE = -1.0, -2.0, -3.0
_NEARLY_SHARP = 1e-6  # roughness of what a ray within a lobe sees: lamps are not seen by it
BY_LOBE = 0.0  # Paths.bsdf_pdf until the direction within the lobe is chosen
# of sub-rays beside a lobe's core, what they are worth there: the lobe differs within their cells
OF_REST = 1.0 / 16.0
NARROWEST = 1e-30  # what is found of a lobe at the middles of its cells, below which these tell nothing of it
# places per side at which the lobe is taken in cells that its core covers in part, and in others beside it
FINE, FINE_BESIDE = 4, 2


class LobeCones(NamedTuple):
    """The cones of N paths, and the lobes that they stand for."""

    cones: Cones
    # (N,) float32 roughness: 0 a mirror, or clear; below 0: a ray instead of a cone, as below
    alpha: np.ndarray
    normal: np.ndarray  # (N, 3) float32 of the lobe where it reflects; 0 where it transmits
    # (N, 3) float32 to where the path came from; of a lobe that transmits: the direction that it favours
    incoming: np.ndarray
    # (N,) int8: 0 the whole lobe; 1 its core, whose next row is 2: what the same lobe sends beside its core
    part: np.ndarray
    # (N, 64) float32 of the sub-rays; they sum to 1, over core and rest together, less what is lost below the surface
    weights: np.ndarray
    ray: np.ndarray  # (N,) bool: a ray will do, however strong the lobe
    rough: np.ndarray  # (N,) float32: of rays within lobes, the lobes' roughness
    blur: np.ndarray  # (N,) float32: of chaotic glass, half the angle over which it blurs lamps; else 0
    behind: np.ndarray  # (N, 3) float32: of rays, factors of what surfaces reflect (lobe_rays.behind_glossy)
    beckmann: np.ndarray  # (N,) bool: whose slopes are as a Gaussian has them, and not as GGX
    # (N,) bool: of curved mirrors and clear glass: the footprint itself, all of which weighs alike
    even: np.ndarray
    # (N, 3) float32: geometric normal where light goes on; lobes that bumps tilt end at its plane
    side: np.ndarray


def allocate_lobe_cones(n: int, cones: Cones) -> LobeCones:
    """Room for n."""
    f = np.float32
    return LobeCones(
        cones,
        np.empty(n, f),
        np.empty((n, 3), f),
        np.empty((n, 3), f),
        np.zeros(n, np.int8),
        np.empty((n, 64), f),
        np.zeros(n, np.bool_),
        np.zeros(n, f),
        np.zeros(n, f),
        np.ones((n, 3), f),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
        np.zeros((n, 3), f),
    )


@device
def lobe_pdf(alpha2, normal, incoming, direction):
    """Density per solid angle of a GGX lobe's reflections, microfacets chosen by their area; 0 below the surface."""
    cosine = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
    x, y, z = direction[0] + incoming[0], direction[1] + incoming[1], direction[2] + incoming[2]
    length = math.sqrt(x * x + y * y + z * z)
    if not (cosine > 0.0 and length > 0.0):
        return 0.0
    h = (normal[0] * x + normal[1] * y + normal[2] * z) / length
    d = h * h * (alpha2 - 1.0) + 1.0
    return max(
        alpha2 * h / (math.pi * d * d * 2.0 * length), 0.0
    )  # |wi + wo| is twice the cosine between wi and h


@device
def inverse_ior(lobes, k, j):
    """Index of refraction before the surface over that behind it, of lobe j of point k."""
    ior = np.float64(lobes.data[k, j, IOR])
    return 1.0 / ior if ior > 0.0 else 1.0


@device
def refraction(normal, incoming, inverse, rough):
    """(direction, roughness of the mirror that spreads as much, whether it refracts) of a lobe that transmits.

    inverse: inverse_ior. Where all is reflected, what its roughness lets through goes along the surface.
    """
    cosine = dot(normal, incoming)
    square = 1.0 - inverse * inverse * (1.0 - cosine * cosine)
    along = inverse * cosine - math.sqrt(max(square, 0.0))
    d = combine(along, normal, -inverse, incoming)
    if not square > 0.0:
        d = normalized(d, normal)
    return d, 0.5 * abs(1.0 - inverse) * rough, square > 0.0


@device
def refracted_pdf(alpha2, axis, direction):
    """Density per solid angle of what a rough surface refracts about `axis`, about as wide as a mirror's lobe.

    alpha: roughness of the mirror that spreads as much. GGX's slopes of half vectors, of a viewer along the normal;
    0 beyond a right angle.
    """
    cosine = dot(axis, direction)
    if not cosine > 0.0:
        return 0.0
    return distribution(
        False, (1.0 - cosine * cosine) / (cosine * cosine) / (4.0 * alpha2), 0.0, 1.0, alpha2
    ) / (4.0 * cosine * cosine * cosine)


@device
def pdf_of(lobes: LobeCones, k, alpha, direction):
    """Density of cone k's lobe, of roughness alpha, in a direction; inf where it is sharp."""
    n, w = lobes.normal, lobes.incoming
    nx, ny, nz = np.float64(n[k, 0]), np.float64(n[k, 1]), np.float64(n[k, 2])
    if not alpha > 0.0:
        return math.inf
    incoming = (np.float64(w[k, 0]), np.float64(w[k, 1]), np.float64(w[k, 2]))
    if nx * nx + ny * ny + nz * nz == 0.0:
        return refracted_pdf(alpha * alpha, incoming, direction)
    return lobe_pdf(alpha * alpha, (nx, ny, nz), incoming, direction)


@device
def slopes_of(cones, k, b):
    """Slopes (u, v) of sub-ray b of cone k."""
    u, v = ((b & 7) + 0.5) * 0.25 - 1.0, ((b >> 3) + 0.5) * 0.25 - 1.0
    return u * np.float64(cones.spread[k, 0]), v * np.float64(cones.spread[k, 1])


@device
def _in_core(c, m, x, y, z):
    """Whether a direction lies in the square that cone m covers."""
    t = x * c.axes[m, 2, 0] + y * c.axes[m, 2, 1] + z * c.axes[m, 2, 2]
    u = x * c.axes[m, 0, 0] + y * c.axes[m, 0, 1] + z * c.axes[m, 0, 2]
    v = x * c.axes[m, 1, 0] + y * c.axes[m, 1, 1] + z * c.axes[m, 1, 2]
    return t > 0.0 and abs(u) <= c.spread[m, 0] * t and abs(v) <= c.spread[m, 1] * t


@device
def looks_within(lobes: LobeCones, m, direction):
    """Sub-rays per solid angle that cone m has in a direction, 0 beyond it: how well it finds what shines there."""
    x, y, z = direction
    c = lobes.cones
    if not _in_core(c, m, x, y, z):
        return 0.0
    t = x * c.axes[m, 2, 0] + y * c.axes[m, 2, 1] + z * c.axes[m, 2, 2]
    worth = OF_REST if lobes.part[m] == 2 else 1.0
    return worth * 16.0 / (np.float64(c.spread[m, 0]) * np.float64(c.spread[m, 1]) * t * t * t)


@device
def looks_of(lobes: LobeCones, m, direction):
    """The same of the lobe whose first cone is m; inf where that is the footprint, which tells all."""
    if lobes.alpha[m] <= 0.0 or lobes.even[m]:
        return math.inf
    found = looks_within(lobes, m, direction)
    if found > 0.0 or lobes.part[m] == 0:
        return found
    return looks_within(lobes, m + 1, direction)


@device
def _density(lobes: LobeCones, m, u, v, alpha2):
    """What the lobe of cone m sends through slopes (u, v), per area of slopes, times a constant; 0 in its core's."""
    c = lobes.cones
    inverse = 1.0 / math.sqrt(1.0 + u * u + v * v)
    w = inverse * inverse * inverse
    nx, ny, nz = lobes.normal[m, 0], lobes.normal[m, 1], lobes.normal[m, 2]
    dx, dy, dz = direction_of(c, m, u, v)
    dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
    if lobes.part[m] == 2 and _in_core(c, m - 1, dx, dy, dz):
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


@device
def finds_lights(paths: Paths, lobes: LobeCones, m):
    """Whether cone m is one of a reflection that finds what shines (scatter_lobes: integrated)."""
    n = lobes.normal
    reflects = n[m, 0] != 0 or n[m, 1] != 0 or n[m, 2] != 0
    return lobes.alpha[m] > 0 and reflects and paths.bsdf_pdf[m] == math.inf and lobes.blur[m] == 0


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
        if paths.bsdf_pdf[m] == BY_LOBE:
            paths.bsdf_pdf[m] = pdf_of(lobes, m, np.float64(lobes.alpha[m]), row3(paths.rays.direction, m))
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
        if paths.bsdf_pdf[k] == BY_LOBE:
            out.bsdf_pdf[r] = pdf_of(lobes, k, np.float64(lobes.alpha[k]), row3(out.rays.direction, r))
        elif finds_lights(paths, lobes, k) and not lobes.even[k]:
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
