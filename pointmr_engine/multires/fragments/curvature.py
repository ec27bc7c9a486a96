"""Triangles beyond their edges: fragments are merged of several, of which one stands for all.

Its textures and normals go on to the middle of what is seen of them. How far the normals of a smooth triangle spread in
a footprint follows from those of its corners.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.baked.triangle_normals import interpolated_normal
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.pointers import pointer_f32, pointer_i32
from pointmr_engine.numerics.transforms import cofactors
from pointmr_engine.shading.bsdf.vector import cross, dot, normalized, row3

# barycentric coordinates: how far outside a triangle its normals go on, and its textures, whose values at corners may
# be anything
BEYOND, BEYOND_OF_TEXTURES = 3.0, 0.5
ALIKE = 0.9  # least cosine between the normal at a fragment's middle and that of its hit
RIM = 0.45  # cosine to the viewer below which the hit's normal stays: wide lobes that graze lose light
GAPS = 2.0  # times the variance of normals in a footprint that is added for small lamps
STEEP = 0.3  # cosine to the viewer below which footprints grow no longer
FLATTEST = 1e-5  # variance of slopes below which a footprint counts as flat
SLIVER = 2.0  # squared change of normals per metre at most, against that along the edges


@device
def _edge(tables, p, t, m, side):
    """Edge 0 -> side (1 or 2) of triangle t of part p in world space, placed by m (3, 4)."""
    corners, positions = pointer_i32(tables.triangles[p]), pointer_f32(tables.positions[p])
    a, b = 3 * np.int64(corners[3 * t]), 3 * np.int64(corners[3 * t + side])
    x = np.float64(positions[b]) - positions[a]
    y = np.float64(positions[b + 1]) - positions[a + 1]
    z = np.float64(positions[b + 2]) - positions[a + 2]
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z,
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z,
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z,
    )


@device
def _normal_at(tables, p, t, q, u, v):
    """Unit normal in world space, 0 where there is none. q (3, 3): cofactors of the triangle's placement."""
    x, y, z = interpolated_normal(tables, p, t, u, v)
    n = (
        q[0, 0] * x + q[0, 1] * y + q[0, 2] * z,
        q[1, 0] * x + q[1, 1] * y + q[1, 2] * z,
        q[2, 0] * x + q[2, 1] * y + q[2, 2] * z,
    )
    return normalized(n, (0.0, 0.0, 0.0))


@device
def _along(v, n):
    """The part of v along a surface of unit normal n."""
    a = dot(v, n)
    return v[0] - a * n[0], v[1] - a * n[1], v[2] - a * n[2]


@device
def shape_operator(tables, p, t, m, q, facing, out, k):
    """How the unit normal changes along a smooth triangle (Weingarten's map), to out[k]; returns (square, largest).

    out (N, 6) float32: the symmetric matrix xx, xy, xz, yy, yz, zz, per metre of world space; positive where the
    surface is convex to the side of `facing`. Its square: the mean over the triangle's edges of the squared
    change per metre; largest: the squared change along an edge, of the edge where it is largest. q (3, 3) float64 to
    work in.
    """
    cofactors(m, q)
    a, b = _normal_at(tables, p, t, q, 0.0, 0.0), _normal_at(tables, p, t, q, 1.0, 0.0)
    c = _normal_at(tables, p, t, q, 0.0, 1.0)
    n = normalized((a[0] + b[0] + c[0], a[1] + b[1] + c[1], a[2] + b[2] + c[2]), (0.0, 0.0, 0.0))
    b = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    c = (c[0] - a[0], c[1] - a[1], c[2] - a[2])
    e, f = _edge(tables, p, t, m, 1), _edge(tables, p, t, m, 2)
    g, d = (f[0] - e[0], f[1] - e[1], f[2] - e[2]), (c[0] - b[0], c[1] - b[1], c[2] - b[2])
    x = normalized(_along(e, n), (0.0, 0.0, 0.0))
    y = cross(n, x)
    length, fx, fy = dot(e, x), dot(f, x), dot(f, y)
    if not (dot(n, n) > 0.0 and fy * fy > 1e-12 * dot(f, f) and length * length > 1e-12 * dot(e, e)):
        return 0.0, 0.0
    # along edges the change is known; across slivers it need not be what follows from them
    first, second, third = dot(b, b) / dot(e, e), dot(c, c) / dot(f, f), dot(d, d) / dot(g, g)
    largest = max(dot(b, b), dot(c, c), dot(d, d))
    bx, by, cx, cy = dot(b, x), dot(b, y), dot(c, x), dot(c, y)
    xx, yy = bx / length, (cy - by * fx / length) / fy
    xy = 0.5 * (by / length + (cx - bx * fx / length) / fy)
    square, most = 0.5 * (xx * xx + yy * yy) + xy * xy, SLIVER * max(first, second, third)
    if square > most:
        shrink = math.sqrt(most / square)
        xx, xy, yy = shrink * xx, shrink * xy, shrink * yy
    sign = 1.0 if dot(n, facing) >= 0.0 else -1.0
    xx, xy, yy = sign * xx, sign * xy, sign * yy
    i = np.int64(0)
    for r in range(3):
        for s in range(r, 3):
            out[k, i] = xx * x[r] * x[s] + xy * (x[r] * y[s] + y[r] * x[s]) + yy * y[r] * y[s]
            i += 1
    return (first + second + third) / 3.0, largest


@device
def bend_at(tables, hits, k, facing, out, q):
    """`shape_operator` where hit k lies, to out[k]; 0 of triangles that are shaded flat. Arguments as there."""
    p = np.int64(hits.part[k])
    if tables.normals[p] == 0:
        return 0.0, 0.0
    t = np.int64(hits.triangle[k]) - np.int64(tables.first_triangle[p])
    return shape_operator(tables, p, t, hits.world_from_part[k], q, facing, out, k)


@uncounted
def spread_of_curvature(
    tables, hits, facing, direction, width, seen, whole, mean, rows, count, curved, spread, gaps, shape,
    q,
):  # fmt: skip
    """curved (N,) float32 at rows[0..count]: variance of the slopes of the normals over the footprints `width`.

    spread (N,) float32: the same where it is worth noting. gaps (N,) float32: what is added for small lamps, so that
    neighbours' lobes leave no gaps between them; most of it where footprints are longer than wide. shape (N, 6)
    float32: shape_operator, as far as fragments fill their footprints; stays 0 where triangles are shaded flat, which
    have no variance.

    Neither is more than what the triangle's corners and what merged with it differ by: rims and seams bend less than
    their footprints would if they went on as they are.

    hits: of those rows; facing (N, 3): normals to the viewer's side; direction (N, 3) of the camera's rays; tables:
    PartTables; seen (N,) int32: subpixels in which each is seen, of which a footprint has `whole`; mean (N, 3) float32:
    of the unit normals of the triangles that merged into each. q (3, 3) float64 to work in.
    """
    for i in range(count):
        k = rows[i]
        bend, largest = bend_at(tables, hits, np.int64(k), row3(facing, k), shape, q)
        # variance is that of the mean direction: most curved surfaces bend about one axis
        variance = bend * np.float64(width[k]) * np.float64(width[k]) / 12.0
        part = min(np.float64(seen[k]) / whole, 1.0)
        # a small triangle says nothing of what lies beyond it; how much that differs has been seen
        most = largest / 12.0 + 0.5 * max(1.0 - dot(row3(mean, k), row3(mean, k)), 0.0)
        if part * variance > most:
            part = most / variance
        for a in range(6):
            shape[k, a] *= math.sqrt(part)
        variance *= part
        curved[k] = min(variance, 2.0)
        cosine = max(abs(dot(row3(facing, k), row3(direction, k))), STEEP)
        longer = min(variance * (0.5 + 0.5 / (cosine * cosine)), max(most, variance))
        gaps[k] = min((1.0 + GAPS) * longer - variance, 2.0)
        if variance > FLATTEST:
            spread[k] = curved[k]


@device
def _place_on(tables, p, t, m, x, y, z):
    """Barycentric coordinates (u, v) of a point of the world beside triangle t of part p, placed by m (3, 4)."""
    corners, positions = pointer_i32(tables.triangles[p]), pointer_f32(tables.positions[p])
    a, b, c = 3 * np.int64(corners[3 * t]), 3 * np.int64(corners[3 * t + 1]), 3 * np.int64(corners[3 * t + 2])
    uu = uv = vv = du = dv = 0.0
    for r in range(3):
        e = f = 0.0
        d = (x if r == 0 else y if r == 1 else z) - m[r, 3]
        for s in range(3):
            o = np.float64(positions[a + s])
            d -= m[r, s] * (o + tables.center[p, s])
            e += m[r, s] * (positions[b + s] - o)
            f += m[r, s] * (positions[c + s] - o)
        uu, uv, vv, du, dv = uu + e * e, uv + e * f, vv + f * f, du + d * e, dv + d * f
    det = uu * vv - uv * uv
    if not det > 1e-12 * uu * vv:
        return -1e9, -1e9
    return (vv * du - uv * dv) / det, (uu * dv - uv * du) / det


@uncounted
def go_to_middles(
    tables, hits, fragments, first, rows, count, stays, direction, world_from_camera, normal, place, q
):  # fmt: skip
    """Normals and textures at rows[0..count] are those at the middles of what is seen of fragments first + row.

    normal (N, 3) float32: smooth normals; place (N, 2) float32, barycentric: where textures are read. Where the middle
    lies far outside the triangle, or the hit's place was chosen (stays (N,) bool), both are left. direction (N, 3): of
    the camera's rays; q (3, 3) float64 to work in.
    """
    c = world_from_camera
    for i in range(count):
        k = rows[i]
        p = np.int64(hits.part[k])
        t, m, f = (
            np.int64(hits.triangle[k]) - np.int64(tables.first_triangle[p]),
            hits.world_from_part[k],
            first + k,
        )
        a, b, d = (
            np.float64(fragments.position[f, 0]),
            np.float64(fragments.position[f, 1]),
            np.float64(fragments.position[f, 2]),
        )
        u, v = _place_on(
            tables, p, t, m, c[0, 0] * a + c[0, 1] * b + c[0, 2] * d + c[0, 3],
            c[1, 0] * a + c[1, 1] * b + c[1, 2] * d + c[1, 3], c[2, 0] * a + c[2, 1] * b + c[2, 2] * d + c[2, 3],
        )  # fmt: skip
        least = min(u, v, 1.0 - u - v)
        if least >= -BEYOND_OF_TEXTURES and not stays[k]:
            place[k, 0], place[k, 1] = u, v
        if least < -BEYOND or tables.normals[p] == 0:
            continue
        cofactors(m, q)
        x, y, z = _normal_at(tables, p, t, q, u, v)
        along = x * normal[k, 0] + y * normal[k, 1] + z * normal[k, 2]
        inverse = 1.0 if along > 0.0 else -1.0
        along *= inverse
        facing = inverse * (direction[k, 0] * x + direction[k, 1] * y + direction[k, 2] * z)
        if abs(along) > ALIKE and abs(facing) > RIM:
            normal[k, 0], normal[k, 1], normal[k, 2] = inverse * x, inverse * y, inverse * z
