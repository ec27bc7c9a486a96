"""Looks: exact camera rays through places of the image where fragments are seen, and what belongs to their surface."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.reconstruction.fragments import ray_through
from pointmr_engine.hierarchy.set_chunks import BALL_REACH
from pointmr_engine.hierarchy.surfels import XX, XY, XZ, YY, YZ, ZZ
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import R2, sample_2d

AROUND = 0x5AD0  # dimension set of the numbers that `look_around` takes
OFF = 1.0  # footprints: farthest from the fragment's plane that a point of its surface may be found
JUST = 1e-6  # of its length: as far beyond its point a ray goes that is to meet it
ALIKE = 0.9  # least cosine between the normals of a fragment and of a point of its surface


@device
def _aim(view, world_from_camera, x, y, rays, i):
    """Ray i through the place (x, y), as ray_through gives it, from the camera's near end on."""
    c = world_from_camera
    dx, dy, dz = 0.0, 0.0, 1.0
    if view.perspective:
        length = math.sqrt(x * x + y * y + 1.0)
        dx, dy, dz = x / length, y / length, 1.0 / length
        x, y = x * view.near, y * view.near
    for r in range(3):
        rays.direction[i, r] = c[r, 0] * dx + c[r, 1] * dy + c[r, 2] * dz
        rays.origin[i, r] = c[r, 0] * x + c[r, 1] * y + c[r, 2] * view.near + c[r, 3]
    rays.t_min[i] = 0.0
    rays.t_max[i] = math.inf


@uncounted
def look_where_seen(view, left, low, world_from_camera, fragments, first, rows, seen, direction, rays):
    """Rays 0..len(rows) towards the fragments first + rows.

    seen (F, 2) float32, subpixels of the tile: of each fragment a place that shows it, which the ray goes through;
    empty: it goes through the fragment's middle. left, low: the tile's first subpixel. direction (N, 3) float64 of the
    camera rays, world space: changed at `rows`.
    """
    for i in range(len(rows)):
        k = rows[i]
        f = first + k
        if len(seen) > 0:
            x, y = ray_through(view, left + np.float64(seen[f, 0]), low + np.float64(seen[f, 1]))
        else:
            x, y = fragments.position[f, 0], fragments.position[f, 1]
            if view.perspective:
                x, y = x / fragments.position[f, 2], y / fragments.position[f, 2]
        _aim(view, world_from_camera, x, y, rays, i)
        for r in range(3):
            direction[k, r] = rays.direction[i, r]


@device
def _deviation(row, s, x, y, z):
    """Standard deviation along (x, y, z) of the places of surfel s, of row (S, 16), in its group's space."""
    xx, xy, xz = np.float64(row[s, XX]), np.float64(row[s, XY]), np.float64(row[s, XZ])
    yy, yz, zz = np.float64(row[s, YY]), np.float64(row[s, YZ]), np.float64(row[s, ZZ])
    along = xx * x * x + yy * y * y + zz * z * z
    return math.sqrt(max(along + 2.0 * (xy * x * y + xz * x * z + yz * y * z), 0.0))


@uncounted
def end_behind_clumps(view, matrix, entries, surfels, fragments, first, rows, hits, rays):
    """End rays 0..len(rows) behind the clumps that the fragments first + rows show, where these are drawn with gaps.

    What is drawn leaves as many subpixels open as the clump has gaps: rays that went through it besides would show more
    of what lies behind. Where a clump is drawn without gaps, rays tell where they are.

    matrix (K, 12) float64 camera_from_group of the tile's placements; surfels (S, 16): of the sample sets; hits: of the
    fragments, without `first`.
    """
    for i in range(len(rows)):
        f = first + rows[i]
        s, r = entries.surfel[fragments.entry[f]], np.int64(fragments.row[f])
        if s < 0 or s & 1 == 0:
            continue
        x, y, z = 0.0, 0.0, 1.0
        if view.perspective:
            x, y, z = fragments.position[f, 0], fragments.position[f, 1], fragments.position[f, 2]
            inverse = 1.0 / math.sqrt(x * x + y * y + z * z)
            x, y, z = x * inverse, y * inverse, z * inverse
        u = matrix[r, 0] * x + matrix[r, 4] * y + matrix[r, 8] * z
        v = matrix[r, 1] * x + matrix[r, 5] * y + matrix[r, 9] * z
        w = matrix[r, 2] * x + matrix[r, 6] * y + matrix[r, 10] * z
        rays.t_max[i] = hits.t[rows[i]] + BALL_REACH * _deviation(surfels, s >> 1, u, v, w)


@uncounted
def aim_at_points(points, rows, direction, rays):
    """Turn rays 0..len(rows) to points (N, 3), world space, `rows`, where they end, and direction (N, 3) with them."""
    for i in range(len(rows)):
        k, square = rows[i], 0.0
        for a in range(3):
            square += (points[k, a] - rays.origin[i, a]) ** 2
        length = math.sqrt(square)
        rays.t_max[i] = length * (1.0 + JUST)
        if length > 0.0:
            for a in range(3):
                rays.direction[i, a] = direction[k, a] = (points[k, a] - rays.origin[i, a]) / length


@uncounted
def look_through_lens(view, lens, left, low, first, rows, shown, direction, rays):
    """`look_where_seen` for a perspective image whose subpixels belong to views from points of the lens.

    lens: lens.LensRays; shown (F, 2) float32: as `seen`.
    """
    side = np.int64(len(lens.of))
    for i in range(len(rows)):
        k = rows[i]
        x, y = np.float64(shown[first + k, 0]), np.float64(shown[first + k, 1])
        column, row = np.int64(x) % side, np.int64(y) % side
        n = np.int64(lens.of[row, column])
        u = ((left + x - column - 0.5) / side + 0.5 - lens.shift[n, 0]) * (side / view.scale_x)
        v = ((low + y - row - 0.5) / side + 0.5 - lens.shift[n, 1]) * (side / view.scale_y)
        _aim(view, lens.world_from_camera[n], u, v, rays, i)
        for r in range(3):
            direction[k, r] = rays.direction[i, r]


@uncounted
def look_around(
    view, left, low, world_from_camera, fragments, first, rows, cell, tables, samples, slot, turn, rays
):
    """Rays 0..len(rows) through other places of the cells, `cell` subpixels wide, that show fragments first + rows.

    slot (N,): the fragments' samples; turn: which of the looks at the same fragments this is, that they lie apart.
    """
    for i in range(len(rows)):
        f, s = first + rows[i], slot[rows[i]]
        u, v = sample_2d(tables, samples.seed[s], np.uint32(AROUND), samples.number[s])
        u, v = u + turn * R2[0], v + turn * R2[1]
        u, v = u - math.floor(u), v - math.floor(v)
        x = left + fragments.x[f] + (u - 0.5) * cell
        y = low + fragments.y[f] + (v - 0.5) * cell
        x, y = ray_through(view, x, y)
        _aim(view, world_from_camera, x, y, rays, i)


@uncounted
def same_surface(frame, rows, found, hits, width, out):
    """out (len(rows),) bool: whether what looks found belongs to the surfaces of their fragments `rows`.

    frame: Frames of the fragments; found: Frames of the looks' hits; width (N,) float32: the fragments' footprints,
    metres.
    """
    for i in range(len(rows)):
        k = rows[i]
        out[i] = False
        if hits.triangle[i] < 0:
            continue
        facing = off = 0.0
        for a in range(3):
            n = np.float64(frame.geometric_normal[k, a])
            facing += n * np.float64(found.geometric_normal[i, a])
            off += n * (found.position[i, a] - frame.position[k, a])
        out[i] = abs(facing) >= ALIKE and abs(off) <= OFF * np.float64(width[k])
