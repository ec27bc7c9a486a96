"""Paths behind a surface point: rows of the next bounce's paths, each with a cone or as a ray."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.cones.cones import jitter, set_axes
from pointmr_engine.multires.cones.lamp_cones import NEAR
from pointmr_engine.multires.lobes.lobe_cones import WITHIN_LOBE
from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.rng import sample_2d
from pointmr_engine.raytracing.path_arrays import (
    BACKDROP,
    FINAL,
    LAST,
    NO_LAMPS,
    SEES_LAMPS,
    THROUGH,
    UNSHARED,
    copy_path,
    copy_ray,
    note_density,
)
from pointmr_engine.scene.group import DIFFUSE, GLOSSY, TRANSMISSION
from pointmr_engine.shading.bsdf.layout import HAS_TRANSMISSION
from pointmr_engine.shading.bsdf.vector import dot, row3

# Paths.bsdf_pdf of rays whose lights have been sampled: what no sample can find counts in full, all else not at all
BY_SAMPLES = 1e-9
WIDEST = 3.0  # tangent of a cone's half angle at most
FARTHEST = 10.0  # half widths: a cone that would leave its surface farther off begins at a point
LOBE_PLACES = 0x10B0  # first dimension set of the directions of rays within lobes


@device
def lobe_place(tables, samples, slot, bounce, k, j):
    """Two random numbers for lobe j of point k: at first surfaces the fragments of a pixel share them out."""
    seed = samples.seed[slot] if bounce == 0 else np.uint32(samples.seed[slot] ^ np.uint32(k))
    return sample_2d(tables, seed, np.uint32(LOBE_PLACES + 16 * bounce + (j & 15)), samples.number[slot])


@device
def survives(out, m, chance, weak):
    """Whether row m of paths goes on, by a random number, where its throughput is below `weak`; it is then that."""
    t = np.float64(max(out.throughput[m, 0], out.throughput[m, 1], out.throughput[m, 2]))
    if t >= weak:
        return True
    if chance * weak >= t:
        return False
    for c in range(3):
        out.throughput[m, c] *= weak / t
    return True


@device
def go_on(
    paths, k, out, m, hits, frames, normal, flags, limits, r, g, b, dx, dy, dz, kind, glossy, transmission
):
    """Row m of `out` becomes the path k after one more bounce, with throughput (r, g, b).

    kind: RAY_*; glossy, transmission: 1 of what counts as that, as a diffuse bounce what counts as neither.
    """
    a, s = paths.state, out.state
    diffuse = np.int64(1) - glossy - transmission
    path_flags = np.int64(paths.flags[k]) & ~np.int64(BACKDROP | SEES_LAMPS | NO_LAMPS | UNSHARED)
    s.depth[m] = a.depth[k] + 1
    s.diffuse_depth[m] = a.diffuse_depth[k] + diffuse
    s.glossy_depth[m] = a.glossy_depth[k] + glossy
    s.transmission_depth[m] = a.transmission_depth[k] + transmission
    s.transparent_depth[m] = a.transparent_depth[k]
    if (
        s.depth[m] > limits.bounces
        or s.diffuse_depth[m] > limits.diffuse
        or s.glossy_depth[m] > limits.glossy
        or s.transmission_depth[m] > limits.transmission
    ):
        path_flags |= FINAL
    s.kind[m] = kind
    s.length[m] = 0
    out.flags[m] = path_flags
    out.slot[m] = paths.slot[k]
    out.throughput[m, 0], out.throughput[m, 1], out.throughput[m, 2] = r, g, b
    out.bsdf_pdf[m] = math.inf
    out.origin_transmissive[m] = (flags[k] & HAS_TRANSMISSION) != 0
    for c in range(3):
        out.rays.origin[m, c] = frames.position[k, c]
        out.origin_normal[m, c] = normal[k, c]
    out.rays.direction[m, 0], out.rays.direction[m, 1], out.rays.direction[m, 2] = dx, dy, dz
    out.rays.t_min[m] = frames.offset[k]
    out.rays.t_max[m] = math.inf
    out.rays.visibility[m] = TRANSMISSION if transmission else DIFFUSE if diffuse else GLOSSY
    out.rays.skip_triangle[m] = hits.triangle[k]
    out.rays.skip_path[m] = hits.path[k]
    s.width[m] = a.width[k] + a.spread[k] * hits.t[k]
    s.density[m] = a.density[k]


@device
def pass_through(paths, k, out, m, hits, frames, limits, r, g, b):
    """Row m of `out` becomes the path k, begun again behind the surface that it passes straight."""
    copy_path(paths, k, 1.0, out, m)
    copy_ray(paths.rays, k, out.rays, m)
    passed = paths.state.transparent_depth[k] + 1
    out.state.transparent_depth[m] = passed
    out.state.length[m] = 0
    path_flags = np.int64(paths.flags[k]) | THROUGH
    if passed >= limits.transparent:
        path_flags |= LAST
    out.flags[m] = path_flags
    out.throughput[m, 0], out.throughput[m, 1], out.throughput[m, 2] = r, g, b
    out.rays.t_min[m] = hits.t[k] + frames.offset[k]
    out.rays.skip_triangle[m] = hits.triangle[k]
    out.rays.skip_path[m] = hits.path[k]


@device
def no_cone(record, m, alpha):
    """Row m of the cones is a ray, of what kind `alpha` says (lobe_cones)."""
    record.alpha[m] = alpha
    record.part[m] = 0
    record.blur[m] = 0.0
    record.cones.t_min[m] = record.cones.t_max[m] = 0.0
    for c in range(3):
        record.behind[m, c] = 1


@device
def send_ray(paths, k, out, m, hits, frames, lobes, limits, w, factor, wo, density, kind, glossy, transmission, record,
              rough):  # fmt: skip
    """Row m of `out` becomes a ray within a lobe, in direction wo, which it favours by `density` per solid angle."""
    t = paths.throughput[k]
    go_on(
        paths, k, out, m, hits, frames, lobes.normal, lobes.flags, limits, w[0] * t[0] * factor, w[1] * t[1] * factor,
        w[2] * t[2] * factor, wo[0], wo[1], wo[2], kind, glossy, transmission,
    )  # fmt: skip
    out.state.spread[m] = paths.state.spread[k]
    note_density(out, m, density)
    no_cone(record, m, WITHIN_LOBE)
    record.rough[m] = rough


@device
def open_cone(cones, m, out, wide, grain, across, d, normal, outward):
    """The cone of path m: slopes `wide` in the plane of incidence, wide * across beside it; grain: of its cells.

    d: its axis; normal: of the lobe; outward: of the surface itself.
    """
    (dx, dy, dz), (ix, iy, iz) = d, normal
    set_axes(cones, m, ix, iy, iz, dx, dy, dz)
    start, spread = 0.5 * out.state.width[m], 0.5 * out.state.spread[m]
    if wide > 0.0:
        start = 0.0  # only mirrors need the footprint
        # sub-rays leave elsewhere in the lobe from point to point, lest their cells show
        o = out.rays.origin
        turn = jitter(o[m, 0], o[m, 1], o[m, 2], out.state.width[m])
        a = 0.25 * grain * (turn[0] - 0.5)
        b = 0.25 * grain * across * (turn[1] - 0.5)
        ax = cones.axes
        dx, dy, dz = (
            dx + a * ax[m, 0, 0] + b * ax[m, 1, 0],
            dy + a * ax[m, 0, 1] + b * ax[m, 1, 1],
            dz + a * ax[m, 0, 2] + b * ax[m, 1, 2],
        )
        inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
        set_axes(cones, m, ix, iy, iz, dx * inverse, dy * inverse, dz * inverse)
    begin_cone(
        cones,
        m,
        out,
        normal,
        outward,
        start,
        start,
        min(wide + spread, WIDEST),
        min(wide * across + spread, WIDEST),
        0.0,
    )


@device
def _clear_of(axes, start_x, start_y, spread_x, spread_y, normal):
    """How far along its axis all sub-rays of a cone that begins across a plane have left it.

    inf: nowhere, or of a cone that begins at a point.
    """
    x, y = abs(dot(normal, row3(axes, 0))), abs(dot(normal, row3(axes, 1)))
    leaves = abs(dot(normal, row3(axes, 2))) - x * spread_x - y * spread_y
    deep = x * start_x + y * start_y
    return deep / leaves if deep < FARTHEST * max(start_x, start_y) * leaves else math.inf


@device
def begin_cone(cones, m, out, normal, outward, start_x, start_y, spread_x, spread_y, bent):
    """The cone of path m, whose axes are set, begins where the path does, on a surface of that normal.

    outward: the normal of the surface itself, from which bumps and normal maps turn the other away. Half widths at its
    start and what they gain per metre; bent: how far the surface leaves its plane within them, per metre of half width.
    """
    # a plane across the axis would begin before the surface on one side, and below it on the other
    clear = max(
        _clear_of(cones.axes[m], start_x, start_y, abs(spread_x), abs(spread_y), normal),
        _clear_of(cones.axes[m], start_x, start_y, abs(spread_x), abs(spread_y), outward),
    )
    if start_x > 0.0 or start_y > 0.0:
        clear += max(start_x, start_y) * bent
    if clear == math.inf:
        start_x = start_y = clear = 0.0
    for a in range(3):
        cones.origin[m, a] = out.rays.origin[m, a]
    cones.start[m, 0], cones.start[m, 1] = start_x, start_y
    cones.spread[m, 0], cones.spread[m, 1] = spread_x, spread_y
    cones.t_min[m] = max(out.rays.t_min[m], NEAR * out.state.width[m], clear)
    cones.t_max[m] = out.rays.t_max[m]
    cones.visibility[m] = out.rays.visibility[m]
