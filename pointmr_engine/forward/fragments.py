"""Fragments: what is visible of a tile's entries, each shaded once, and where their light goes in the image.

A surfel is one fragment, however many subpixels show it; a triangle is one fragment in every pixel, seen from the middle
of the subpixels where it is visible.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.draw import Entries, triangle_to_camera
from pointmr_engine.forward.subpixels import EMPTY
from pointmr_engine.hierarchy.surfels import NX, NY, NZ, RED, X, Y, Z
from pointmr_engine.image.filters import filter_extent, filter_weight
from pointmr_engine.numerics.jit import device, uncounted


class Fragments(NamedTuple):
    """F visible fragments, in camera space."""

    entry: np.ndarray  # (F,) int32
    x: np.ndarray  # (F,) float32, subpixels: mean place in the tile of where a triangle is visible
    y: np.ndarray  # (F,) float32
    count: np.ndarray  # (F,) int32 subpixels
    position: np.ndarray  # (F, 3) float64
    normal: (
        np.ndarray
    )  # (F, 3) float32, length at most 1: less where the piece's normals differ; 0: to be looked up
    geometric: np.ndarray  # (F, 3) float32 unit normal of triangles
    albedo: np.ndarray  # (F, 3) float32
    emission: np.ndarray  # (F, 3) float32
    part: np.ndarray  # (F,) int32
    triangle: np.ndarray  # (F,) int32 in its shape
    place: np.ndarray  # (F, 2) float32 barycentric weights of vertices 1 and 2
    row: np.ndarray  # (F,) int32 of the transforms


def allocate_fragments(n: int) -> Fragments:
    """Room for n fragments, undefined."""
    f, i = np.float32, np.int32
    return Fragments(
        np.empty(n, i), np.empty(n, f), np.empty(n, f), np.empty(n, i), np.empty((n, 3)), np.empty((n, 3), f),
        np.empty((n, 3), f), np.empty((n, 3), f), np.empty((n, 3), f), np.empty(n, i), np.empty(n, i),
        np.empty((n, 2), f), np.empty(n, i),
    )  # fmt: skip


@uncounted
def find_fragments(ids, width, height, subpixels, entries: Entries, fragment_of, out: Fragments):
    """Number the fragments of a tile of width x height subpixels and put their numbers into `ids`; returns how many.

    fragment_of (E,) int32, -1 everywhere; `out` has room for as many fragments as there are subpixels.
    """
    count = np.int64(0)
    for top in range(0, height, subpixels):
        for left in range(0, width, subpixels):
            first = count
            for y in range(top, min(top + subpixels, height)):
                for x in range(left, min(left + subpixels, width)):
                    e = ids[y, x]
                    if e == EMPTY:
                        continue
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
                    out.x[k] += x + np.float32(0.5)
                    out.y[k] += y + np.float32(0.5)
                    out.count[k] += 1
                    ids[y, x] = k
    for k in range(count):
        out.x[k] /= out.count[k]
        out.y[k] /= out.count[k]
    return count


@device
def _ray(view, x, y):
    """Camera-space direction (perspective, z = 1) or place (orthographic) of a point of the whole image, in subpixels."""
    return (x - view.shift_x) / view.scale_x, (y - view.shift_y) / view.scale_y


@device
def _cofactor_normal(m, row, x, y, z):
    a = m[row, 5] * m[row, 10] - m[row, 6] * m[row, 9]
    b = m[row, 6] * m[row, 8] - m[row, 4] * m[row, 10]
    c = m[row, 4] * m[row, 9] - m[row, 5] * m[row, 8]
    d = m[row, 9] * m[row, 2] - m[row, 10] * m[row, 1]
    e = m[row, 10] * m[row, 0] - m[row, 8] * m[row, 2]
    f = m[row, 8] * m[row, 1] - m[row, 9] * m[row, 0]
    g = m[row, 1] * m[row, 6] - m[row, 2] * m[row, 5]
    h = m[row, 2] * m[row, 4] - m[row, 0] * m[row, 6]
    i = m[row, 0] * m[row, 5] - m[row, 1] * m[row, 4]
    px, py, pz = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
    length = np.sqrt(px * px + py * py + pz * pz)
    if m[row, 0] * a + m[row, 1] * b + m[row, 2] * c < 0.0:
        length = -length
    if length == 0.0:
        return 0.0, 0.0, 0.0
    return px / length, py / length, pz / length


@uncounted
def fill_fragments(
    view,
    left,
    low,
    octree,
    sets,
    all_corners,
    transforms,
    entries: Entries,
    fragments: Fragments,
    count,
    corners,
):
    """Attributes of fragments 0..count: of surfels from their rows; of triangles where the ray meets their plane.

    all_corners: of the octree's items; corners: (3, 3) float64 to work in. Triangles get no shading normal or colour yet (normal is 0).
    """
    m = transforms.matrix
    for k in range(count):
        e = fragments.entry[k]
        row = np.int64(entries.row[e])
        fragments.row[k] = row
        s = entries.surfel[e]
        if s >= 0:
            x, y, z = np.float64(sets.row[s, X]), np.float64(sets.row[s, Y]), np.float64(sets.row[s, Z])
            for r in range(3):
                at = 4 * r
                fragments.position[k, r] = (
                    m[row, at] * x + m[row, at + 1] * y + m[row, at + 2] * z + m[row, at + 3]
                )
            nx, ny, nz = np.float64(sets.row[s, NX]), np.float64(sets.row[s, NY]), np.float64(sets.row[s, NZ])
            length = min(np.sqrt(nx * nx + ny * ny + nz * nz), 1.0)
            nx, ny, nz = _cofactor_normal(m, row, nx, ny, nz)
            fragments.normal[k, 0], fragments.normal[k, 1], fragments.normal[k, 2] = (
                nx * length,
                ny * length,
                nz * length,
            )
            fragments.geometric[k, 0], fragments.geometric[k, 1], fragments.geometric[k, 2] = nx, ny, nz
            for c in range(3):
                fragments.albedo[k, c] = sets.row[s, RED + c]
                fragments.emission[k, c] = sets.emission[s, c]
            fragments.part[k] = sets.source[s, 0]
            fragments.triangle[k] = sets.source[s, 1]
            fragments.place[k, 0], fragments.place[k, 1] = sets.place[s, 0], sets.place[s, 1]
            continue
        i = (-1 - s) >> 1
        part, triangle = np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1])
        triangle_to_camera(m, row, all_corners, i, corners)
        dx, dy = _ray(view, left + fragments.x[k], low + fragments.y[k])
        u, v = _meet(view, corners, dx, dy)
        u, v = max(u, 0.0), max(v, 0.0)
        if u + v > 1.0:
            u, v = u / (u + v), v / (u + v)
        fragments.part[k] = part
        fragments.triangle[k] = triangle
        fragments.place[k, 0], fragments.place[k, 1] = u, v
        for r in range(3):
            fragments.position[k, r] = (1.0 - u - v) * corners[0, r] + u * corners[1, r] + v * corners[2, r]
            fragments.normal[k, r] = np.float32(0)
        ax, ay, az = (
            corners[1, 0] - corners[0, 0],
            corners[1, 1] - corners[0, 1],
            corners[1, 2] - corners[0, 2],
        )
        bx, by, bz = (
            corners[2, 0] - corners[0, 0],
            corners[2, 1] - corners[0, 1],
            corners[2, 2] - corners[0, 2],
        )
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        scale = 1.0 / length if length > 0.0 else 0.0
        fragments.geometric[k, 0], fragments.geometric[k, 1], fragments.geometric[k, 2] = (
            nx * scale,
            ny * scale,
            nz * scale,
        )


@device
def _meet(view, p, dx, dy):
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


def filter_taps(kind: str, width: float, subpixels: int) -> np.ndarray:
    """(n,) float32 weights of the subpixels along one axis, about a pixel's centre; they sum to 1, n / subpixels is odd."""
    reach = max(0, int(np.ceil(filter_extent(kind, width) - 0.5 - 1e-9)))
    n = (2 * reach + 1) * subpixels
    edges = 64
    offset = ((np.arange(n * edges) + 0.5) / edges - 0.5 * n) / subpixels
    taps = filter_weight(kind, width, offset).reshape(n, edges).sum(1)
    return (taps / taps.sum()).astype(np.float32)


@uncounted
def filter_tile(ids, width, height, subpixels, light, background, taps, lines, line, out):
    """Pixels of a tile: light of the fragments that its subpixels show, under the pixel filter.

    ids as find_fragments left them; light (F, 3) float32; background (rows, columns, 4) float32 of the tile's pixels, premultiplied
    with alpha, for empty subpixels; taps (n,) float32. lines (height, columns of out, 4) and line (width, 4) float32 to work in;
    out (h, w, 4) float32: the pixels whose filter lies inside the tile.
    """
    columns, rows, n = out.shape[1], out.shape[0], len(taps)
    for y in range(height):
        below = y // subpixels
        for x in range(width):
            k = ids[y, x]
            if k >= 0:
                line[x, 0] = light[k, 0]
                line[x, 1] = light[k, 1]
                line[x, 2] = light[k, 2]
                line[x, 3] = np.float32(1)
            else:
                p = x // subpixels
                for c in range(4):
                    line[x, c] = background[below, p, c]
        for p in range(columns):
            a = b = c = d = np.float32(0)
            at = p * subpixels
            for t in range(n):
                weight = taps[t]
                a += weight * line[at + t, 0]
                b += weight * line[at + t, 1]
                c += weight * line[at + t, 2]
                d += weight * line[at + t, 3]
            lines[y, p, 0] = a
            lines[y, p, 1] = b
            lines[y, p, 2] = c
            lines[y, p, 3] = d
    for q in range(rows):
        for p in range(columns):
            for c in range(4):
                out[q, p, c] = np.float32(0)
        for t in range(n):
            weight = taps[t]
            y = q * subpixels + t
            for p in range(columns):
                for c in range(4):
                    out[q, p, c] += weight * lines[y, p, c]
