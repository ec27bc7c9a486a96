"""Points and triangles of dynamic sampling in camera space, drawn into tiles, and as fragments."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.cut_outs import cut_out_of, draw_cut_out
from pointmr_engine.forward.draw import draw_triangle, to_target
from pointmr_engine.forward.fragments import fill_look, meet_plane, ray_through
from pointmr_engine.forward.subpixels import cover_ellipse, cover_run
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.pointers import load_f32, load_i32

STEEP = 4.0  # depth over width of the steepest disc: triangles seen edge-on would reach to the eye


class PlacedPoints(NamedTuple):
    """N points; what shades them, and where they are drawn."""

    position: np.ndarray  # (N, 3) float64, camera space
    normal: np.ndarray  # (N, 3) float32 unit normal of the triangle's plane, camera space; 0: it has none
    x: np.ndarray  # (N,) float32 pixels of the whole image
    y: np.ndarray
    part: np.ndarray  # (N,) int32
    triangle: np.ndarray  # (N,) int32, in its shape
    place: np.ndarray  # (N, 2) float32 barycentric weights of vertices 1 and 2
    row: np.ndarray  # (N,) int32 of the transforms


class PlacedTriangles(NamedTuple):
    """T triangles that are drawn as they are."""

    corners: np.ndarray  # (T, 3, 3) float64, camera space
    bounds: np.ndarray  # (T, 4) float64: least x, y, largest x, y in pixels of the whole image
    part: np.ndarray  # (T,) int32
    triangle: np.ndarray  # (T,) int32
    row: np.ndarray  # (T,) int32


@device
def _corners(octree, tables, transforms, row, part, triangle, out, k):
    """Corners of a part's triangle in camera space, into out[k] (3, 3)."""
    m, group = transforms.matrix, np.int64(transforms.group[row])
    for c in range(3):
        i = 3 * np.int64(load_i32(tables.triangles[part], 3 * triangle + c))
        at = tables.positions[part]
        x = load_f32(at, i) + (octree.part_offset[part, 0] - octree.group_center[group, 0])
        y = load_f32(at, i + 1) + (octree.part_offset[part, 1] - octree.group_center[group, 1])
        z = load_f32(at, i + 2) + (octree.part_offset[part, 2] - octree.group_center[group, 2])
        for r in range(3):
            a = 4 * r
            out[k, c, r] = m[row, a] * x + m[row, a + 1] * y + m[row, a + 2] * z + m[row, a + 3]


@uncounted
def place_triangles(view, octree, tables, transforms, subpixels, out: PlacedTriangles):
    """Fill corners and bounds of the listed triangles. octree: OctreeArrays; tables: PartTables."""
    for k in range(len(out.part)):
        _corners(octree, tables, transforms, np.int64(out.row[k]), np.int64(out.part[k]), np.int64(out.triangle[k]),
                 out.corners, k)  # fmt: skip
        out.bounds[k, 0] = out.bounds[k, 1] = np.inf
        out.bounds[k, 2] = out.bounds[k, 3] = -np.inf
        for c in range(3):
            z = out.corners[k, c, 2]
            if z < view.near:  # clipped later: anywhere
                out.bounds[k, 0] = out.bounds[k, 1] = -np.inf
                out.bounds[k, 2] = out.bounds[k, 3] = np.inf
                break
            x, y, _ = to_target(view, out.corners[k, c, 0], out.corners[k, c, 1], z)
            out.bounds[k, 0] = min(out.bounds[k, 0], x / subpixels)
            out.bounds[k, 1] = min(out.bounds[k, 1], y / subpixels)
            out.bounds[k, 2] = max(out.bounds[k, 2], x / subpixels)
            out.bounds[k, 3] = max(out.bounds[k, 3], y / subpixels)


@device
def _plane(p, k):
    """Unit normal (cross product of the edges) of triangle p[k] (3, 3)."""
    ax, ay, az = p[k, 1, 0] - p[k, 0, 0], p[k, 1, 1] - p[k, 0, 1], p[k, 1, 2] - p[k, 0, 2]
    bx, by, bz = p[k, 2, 0] - p[k, 0, 0], p[k, 2, 1] - p[k, 0, 1], p[k, 2, 2] - p[k, 0, 2]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / length if length > 0.0 else 0.0
    return x * scale, y * scale, z * scale


@uncounted
def place_points(octree, tables, transforms, points: PlacedPoints, corners, start, stop):
    """Fill position and normal of points start..stop. corners: (1, 3, 3) float64 to work in."""
    for k in range(start, stop):
        _corners(octree, tables, transforms, np.int64(points.row[k]), np.int64(points.part[k]),
                 np.int64(points.triangle[k]), corners, 0)  # fmt: skip
        u, v = np.float64(points.place[k, 0]), np.float64(points.place[k, 1])
        for r in range(3):
            points.position[k, r] = (
                (1.0 - u - v) * corners[0, 0, r] + u * corners[0, 1, r] + v * corners[0, 2, r]
            )
        x, y, z = _plane(corners, 0)
        points.normal[k, 0], points.normal[k, 1], points.normal[k, 2] = x, y, z


@uncounted
def draw_triangle_list(
    view,
    target,
    width,
    height,
    left,
    low,
    triangles: PlacedTriangles,
    cut_outs,
    solid,
    subpixels,
    entries,
    used,
):
    """Draw the triangles in a tile of width x height subpixels at (left, low); returns how many entries are used.

    cut_outs: CutOuts; solid: triangles with holes are left out.
    """
    x0, y0 = left / subpixels, low / subpixels
    x1, y1 = (left + width) / subpixels, (low + height) / subpixels
    b = triangles.bounds
    for k in range(len(triangles.part)):
        if b[k, 0] > x1 or b[k, 2] < x0 or b[k, 1] > y1 or b[k, 3] < y0:
            continue
        hole = cut_out_of(cut_outs, np.int64(triangles.part[k]), np.int64(triangles.triangle[k]))
        written = False
        if hole < 0:
            written = draw_triangle(view, target, width, height, left, low, triangles.corners[k], used)
        elif not solid:
            phase = (k * np.int64(40503) >> np.int64(7)) & np.int64(63)
            written = draw_cut_out(
                view, target, width, height, left, low, triangles.corners[k], used, cut_outs, hole, phase
            )
        if written:
            entries.surfel[used] = -1 - 2 * k
            entries.row[used] = triangles.row[k]
            used += 1
    return used


@device
def _slopes(view, n, k, x, y, z):
    """Growth of nearness per subpixel of the plane through (x, y, z) with normal n[k], no steeper than STEEP."""
    nx, ny, nz = np.float64(n[k, 0]), np.float64(n[k, 1]), np.float64(n[k, 2])
    if view.perspective:
        d = nx * x + ny * y + nz * z
        most_x, most_y = STEEP / (z * view.scale_x), STEEP / (z * view.scale_y)
    else:
        d = nz / view.depth_scale
        most_x, most_y = STEEP * view.depth_scale / view.scale_x, STEEP * view.depth_scale / view.scale_y
    if d == 0.0:
        return 0.0, 0.0
    a, b = nx / (d * view.scale_x), ny / (d * view.scale_y)
    steep = max(abs(a) / most_x, abs(b) / most_y, 1.0)
    return a / steep, b / steep


@uncounted
def draw_points(
    view,
    target,
    width,
    height,
    left,
    low,
    points: PlacedPoints,
    first,
    last,
    subpixels,
    radius,
    entries,
    used,
):
    """Draw points first..last as discs of `radius` subpixels in the image, at least the subpixel that they lie in.

    They lie in the planes of their triangles, but are round in the image whatever the plane: a depth buffer keeps as
    many points of a plane seen at an angle as of one that faces the camera. Returns how many entries are used then.
    """
    square = radius * radius
    for k in range(first, last):
        x, y = np.float64(points.x[k]) * subpixels - left, np.float64(points.y[k]) * subpixels - low
        if x < -radius or y < -radius or x > width + radius or y > height + radius:
            continue
        px, py, pz = points.position[k, 0], points.position[k, 1], points.position[k, 2]
        _, _, w = to_target(view, px, py, pz)
        written = False
        if radius > 0.0:
            a, b = _slopes(view, points.normal, k, px, py, pz)
            written = cover_ellipse(
                target, width, height, x, y, square, 0.0, square, w, a, b, used, 2.0, np.int64(0)
            )
        i, j = np.int64(math.floor(x)), np.int64(math.floor(y))
        if 0 <= i < width and 0 <= j < height and cover_run(target, j, i, i, w, 0.0, used, 2.0, np.int64(0)):
            written = True
        if written:
            entries.surfel[used] = -2 - 2 * k  # one fragment, wherever it is visible
            entries.row[used] = points.row[k]
            used += 1
    return used


@uncounted
def fill_point_fragments(
    view,
    left,
    low,
    parts,
    looks,
    normals,
    points: PlacedPoints,
    triangles: PlacedTriangles,
    entries,
    fragments,
    count,
):
    """Attributes of fragments 0..count, as fragments.fill_fragments has them."""
    for k in range(count):
        e = fragments.entry[k]
        row = np.int64(entries.row[e])
        fragments.row[k] = row
        i = (-1 - entries.surfel[e]) >> 1
        if entries.surfel[e] & 1 == 0:
            part, triangle = np.int64(points.part[i]), np.int64(points.triangle[i])
            u, v = np.float64(points.place[i, 0]), np.float64(points.place[i, 1])
            nx, ny, nz = (
                np.float64(points.normal[i, 0]),
                np.float64(points.normal[i, 1]),
                np.float64(points.normal[i, 2]),
            )
            for r in range(3):
                fragments.position[k, r] = points.position[i, r]
        else:
            part, triangle = np.int64(triangles.part[i]), np.int64(triangles.triangle[i])
            corners = triangles.corners[i]
            dx, dy = ray_through(view, left + fragments.x[k], low + fragments.y[k])
            u, v = meet_plane(view, corners, dx, dy)
            u, v = max(u, 0.0), max(v, 0.0)
            if u + v > 1.0:
                u, v = u / (u + v), v / (u + v)
            for r in range(3):
                fragments.position[k, r] = (
                    (1.0 - u - v) * corners[0, r] + u * corners[1, r] + v * corners[2, r]
                )
            nx, ny, nz = _plane(triangles.corners, i)
        fragments.part[k] = part
        fragments.triangle[k] = triangle
        fragments.place[k, 0], fragments.place[k, 1] = u, v
        fragments.geometric[k, 0], fragments.geometric[k, 1], fragments.geometric[k, 2] = nx, ny, nz
        fill_look(parts, looks, normals, row, part, triangle, u, v, fragments, k)
