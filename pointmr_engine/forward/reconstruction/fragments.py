"""Fragments: what is visible of a tile's entries, each shaded once.

A surfel is one fragment, however many subpixels show it; a triangle is one fragment in every pixel, seen from the
middle of the subpixels where it is visible.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.baked.triangle_normals import interpolated_normal
from pointmr_engine.forward.drawing.draw import Entries, triangle_to_camera
from pointmr_engine.forward.drawing.subpixels import EMPTY
from pointmr_engine.hierarchy.surfels import NX, NY, NZ, RED, X, Y, Z
from pointmr_engine.hierarchy.triangle_prefetch import INDICES, VERTICES, prefetch_indices, prefetch_normals
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.pointers import load_i32, prefetch_row


class Fragments(NamedTuple):
    """F visible fragments, in camera space."""

    entry: np.ndarray  # (F,) int32
    x: np.ndarray  # (F,) float32, subpixels: mean place in the tile of where a triangle is visible
    y: np.ndarray  # (F,) float32
    count: np.ndarray  # (F,) int32 subpixels
    position: np.ndarray  # (F, 3) float64
    # (F, 3) float32, length at most 1: less where the piece's normals differ; 0: to be looked up
    normal: np.ndarray
    geometric: np.ndarray  # (F, 3) float32 unit normal of triangles; where fragments have merged, their mean
    albedo: np.ndarray  # (F, 3) float32
    emission: np.ndarray  # (F, 3) float32
    part: np.ndarray  # (F,) int32
    triangle: np.ndarray  # (F,) int32 in its shape
    place: np.ndarray  # (F, 2) float32 barycentric weights of vertices 1 and 2
    row: np.ndarray  # (F,) int32 of the transforms


ITEMS = 12  # fragments: so long before one is filled, its surfel or triangle is asked for
SOLID = 0.9  # squared length of a mean normal, below which a piece is a clump


def allocate_fragments(n: int) -> Fragments:
    """Room for n fragments, undefined."""
    f, i = np.float32, np.int32
    return Fragments(
        np.empty(n, i), np.empty(n, f), np.empty(n, f), np.empty(n, i), np.empty((n, 3)), np.empty((n, 3), f),
        np.empty((n, 3), f), np.empty((n, 3), f), np.empty((n, 3), f), np.empty(n, i), np.empty(n, i),
        np.empty((n, 2), f), np.empty(n, i),
    )  # fmt: skip


@uncounted
def find_fragments(ids, width, height, subpixels, entries: Entries, fragment_of, empty, out: Fragments):
    """Number the fragments of a tile of width x height subpixels and put their numbers into `ids`; returns how many.

    fragment_of (E,) int32, -1 everywhere; `out` has room for as many fragments as there are subpixels. empty (rows,
    columns) uint8: 1 is written for pixels with a subpixel that shows nothing, else 0.
    """
    count = np.int64(0)
    for top in range(0, height, subpixels):
        for left in range(0, width, subpixels):
            first = count
            gap = np.uint8(0)
            last, k = np.int64(EMPTY), np.int64(-1)
            for y in range(top, min(top + subpixels, height)):
                for x in range(left, min(left + subpixels, width)):
                    e = np.int64(ids[y, x])
                    if e == EMPTY:
                        gap = np.uint8(1)
                        continue
                    if e != last:
                        last = e
                        k = np.int64(fragment_of[e])
                        if k < first and entries.surfel[e] < 0 and entries.surfel[e] & 1 != 0:
                            k = np.int64(-1)  # a triangle that is not small, in a new pixel
                        if k < 0:
                            k = count
                            out.entry[k] = e
                            out.x[k] = 0
                            out.y[k] = 0
                            out.count[k] = 0
                            fragment_of[e] = k
                            count += 1
                    out.x[k] += x
                    out.y[k] += y
                    out.count[k] += 1
                    ids[y, x] = k
            empty[top // subpixels, left // subpixels] = gap
    for k in range(count):
        inverse = np.float32(1) / out.count[k]
        out.x[k] = out.x[k] * inverse + np.float32(0.5)
        out.y[k] = out.y[k] * inverse + np.float32(0.5)
    return count


@device
def is_clump(f: Fragments, k):
    """Whether fragment k is of a piece that faces no one side. Triangles whose normal is looked up later are none."""
    square = f.normal[k, 0] ** 2 + f.normal[k, 1] ** 2 + f.normal[k, 2] ** 2
    return square > np.float32(0) and square < np.float32(SOLID)


@device
def cell_at(x, y, subpixels, shape):
    """Column and row of the cell of `subpixels` a side that holds a place, or is next to it, in a tile of `shape`."""
    i, j = np.int64(x) // subpixels, np.int64(y) // subpixels
    return min(max(i, 0), shape[1] - 1), min(max(j, 0), shape[0] - 1)


@device
def ray_through(view, x, y):
    """Camera-space direction (perspective, z = 1) or place (orthographic) of a point of the whole image, in
    subpixels."""
    return (x - view.shift_x) / view.scale_x, (y - view.shift_y) / view.scale_y


@uncounted
def fill_normal_matrices(matrix, count, out):
    """out (K, 9) float64: what carries normals of rows 0..count into camera space, outside to outside; not of unit
    length."""
    for k in range(count):
        sign = 0.0
        for r in range(3):
            r1, r2 = 4 * ((r + 1) % 3), 4 * ((r + 2) % 3)
            for c in range(3):
                c1, c2 = (c + 1) % 3, (c + 2) % 3
                value = matrix[k, r1 + c1] * matrix[k, r2 + c2] - matrix[k, r1 + c2] * matrix[k, r2 + c1]
                out[k, 3 * r + c] = value
                if r == 0:
                    sign += matrix[k, c] * value
        if sign < 0.0:
            for c in range(9):
                out[k, c] = -out[k, c]


@device
def _carry_normal(normals, row, x, y, z):
    """A unit normal in camera space."""
    px = normals[row, 0] * x + normals[row, 1] * y + normals[row, 2] * z
    py = normals[row, 3] * x + normals[row, 4] * y + normals[row, 5] * z
    pz = normals[row, 6] * x + normals[row, 7] * y + normals[row, 8] * z
    square = px * px + py * py + pz * pz
    inverse = 1.0 / np.sqrt(square) if square > 0.0 else 0.0
    return px * inverse, py * inverse, pz * inverse


@device
def _plane_normal(all_corners, i, normals, row):
    """Unit normal of item i's triangle in camera space, to the side from which its corners go counter-clockwise."""
    c = all_corners[i]
    ax, ay, az = np.float64(c[3] - c[0]), np.float64(c[4] - c[1]), np.float64(c[5] - c[2])
    bx, by, bz = np.float64(c[6] - c[0]), np.float64(c[7] - c[1]), np.float64(c[8] - c[2])
    return _carry_normal(normals, row, ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


@uncounted
def fill_fragments(
    view, left, low, octree, sets, all_corners, parts, looks, transforms, normals, entries: Entries, fragments:
    Fragments, count, corners,
):  # fmt: skip
    """Attributes of fragments 0..count: of surfels from their rows; of triangles where the ray meets their plane.

    all_corners: of the octree's items; corners: (3, 3) float64 to work in. normals: of fill_normal_matrices. looks
    (materials, 7) float32: albedo, emission and 1 for materials that are the same everywhere; triangles of others get
    no colour and no normal yet (it is 0).
    """
    m = transforms.matrix
    # the triangle that `corners` and its normal belong to: neighbours often show the same one
    last = np.int64(EMPTY)
    nx = ny = nz = 0.0
    for k in range(count):
        _ask_ahead(k, count, octree, sets, all_corners, parts, entries, fragments)
        e = np.int64(fragments.entry[k])
        row = np.int64(entries.row[e])
        fragments.row[k] = row
        s = entries.surfel[e]
        if s >= 0:
            s >>= 1
            x, y, z = np.float64(sets.row[s, X]), np.float64(sets.row[s, Y]), np.float64(sets.row[s, Z])
            for r in range(3):
                at = 4 * r
                fragments.position[k, r] = (
                    m[row, at] * x + m[row, at + 1] * y + m[row, at + 2] * z + m[row, at + 3]
                )
            x, y, z = np.float64(sets.row[s, NX]), np.float64(sets.row[s, NY]), np.float64(sets.row[s, NZ])
            length = min(np.sqrt(x * x + y * y + z * z), 1.0)
            x, y, z = _carry_normal(normals, row, x, y, z)
            fragments.normal[k, 0], fragments.normal[k, 1], fragments.normal[k, 2] = (
                x * length,
                y * length,
                z * length,
            )
            fragments.geometric[k, 0], fragments.geometric[k, 1], fragments.geometric[k, 2] = x, y, z
            for c in range(3):
                fragments.albedo[k, c] = sets.row[s, RED + c]
                fragments.emission[k, c] = sets.emission[min(s, len(sets.emission) - 1), c]
            fragments.part[k] = sets.source[s, 0]
            fragments.triangle[k] = sets.source[s, 1]
            fragments.place[k, 0], fragments.place[k, 1] = sets.place[s, 0], sets.place[s, 1]
            continue
        i = (-1 - s) >> 1
        part, triangle = np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1])
        if e != last:
            last = e
            triangle_to_camera(m, row, all_corners, i, corners)
            nx, ny, nz = _plane_normal(all_corners, i, normals, row)
        u, v = place_seen(view, corners, left + fragments.x[k], low + fragments.y[k])
        fragments.part[k] = part
        fragments.triangle[k] = triangle
        fragments.place[k, 0], fragments.place[k, 1] = u, v
        for r in range(3):
            fragments.position[k, r] = (1.0 - u - v) * corners[0, r] + u * corners[1, r] + v * corners[2, r]
        fragments.geometric[k, 0], fragments.geometric[k, 1], fragments.geometric[k, 2] = nx, ny, nz
        fill_look(parts, looks, normals, row, part, triangle, u, v, fragments, k)


@device
def _ask_ahead(k, count, octree, sets, all_corners, parts, entries: Entries, fragments: Fragments):
    """Begin to fetch what filling later fragments will read: neighbours in the image lie far apart in memory.

    In three stages, as each one's addresses are in what the one before it has fetched.
    """
    if k + ITEMS < count:
        s = entries.surfel[fragments.entry[k + ITEMS]]
        if s >= 0:
            s >>= 1
            prefetch_row(sets.row, s)
            prefetch_row(sets.source, s)
            prefetch_row(sets.place, s)
        else:
            i = (-1 - s) >> 1
            prefetch_row(octree.item, i)
            prefetch_row(all_corners, i)
    if k + INDICES < count:
        s = entries.surfel[fragments.entry[k + INDICES]]
        if s < 0:
            i = (-1 - s) >> 1
            prefetch_indices(parts, np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1]))
    if k + VERTICES < count:
        s = entries.surfel[fragments.entry[k + VERTICES]]
        if s < 0:
            i = (-1 - s) >> 1
            prefetch_normals(parts, np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1]))


@device
def fill_look(parts, looks, normals, row, part, triangle, u, v, fragments, k):
    """Shading normal and colour of a triangle's fragment, if its material is the same everywhere."""
    slot = np.int64(0)
    if parts.material_index[part] != 0:
        slot = load_i32(parts.material_index[part], triangle)
        slot = min(max(slot, np.int64(0)), np.int64(parts.slots[part]) - 1)
    material = parts.slot_material[parts.first_slot[part] + slot]
    if looks[material, 6] == 0.0:
        fragments.normal[k, 0], fragments.normal[k, 1], fragments.normal[k, 2] = 0.0, 0.0, 0.0
        return
    for c in range(3):
        fragments.albedo[k, c] = looks[material, c]
        fragments.emission[k, c] = looks[material, 3 + c]
    x, y, z = interpolated_normal(parts, part, triangle, u, v)
    x, y, z = _carry_normal(normals, row, x, y, z)
    fragments.normal[k, 0], fragments.normal[k, 1], fragments.normal[k, 2] = x, y, z


@device
def place_seen(view, corners, x, y):
    """Barycentric weights of vertices 1 and 2 of what a point of the image, in subpixels, shows of a triangle."""
    dx, dy = ray_through(view, x, y)
    u, v = meet_plane(view, corners, dx, dy)
    u, v = max(u, 0.0), max(v, 0.0)
    if u + v > 1.0:
        u, v = u / (u + v), v / (u + v)
    return u, v


@device
def meet_plane(view, p, dx, dy):
    """Barycentric weights of vertices 1 and 2 where the ray through (dx, dy) meets the triangle's plane."""
    if view.perspective:
        ox, oy, oz, rx, ry, rz = 0.0, 0.0, 0.0, dx, dy, 1.0
    else:
        ox, oy, oz, rx, ry, rz = dx, dy, 0.0, 0.0, 0.0, 1.0
    ax, ay, az = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
    bx, by, bz = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
    qx, qy, qz = ry * bz - rz * by, rz * bx - rx * bz, rx * by - ry * bx
    det = ax * qx + ay * qy + az * qz
    if det == 0.0:
        return 1.0 / 3.0, 1.0 / 3.0
    tx, ty, tz = ox - p[0, 0], oy - p[0, 1], oz - p[0, 2]
    u = (tx * qx + ty * qy + tz * qz) / det
    wx, wy, wz = ty * az - tz * ay, tz * ax - tx * az, tx * ay - ty * ax
    return u, (rx * wx + ry * wy + rz * wz) / det
