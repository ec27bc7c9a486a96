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

# barycentric coordinates: how far outside a triangle its normals go on, and its textures, whose values at corners may
# be anything
BEYOND, BEYOND_OF_TEXTURES = 3.0, 0.5
ALIKE = 0.9  # least cosine between the normal at a fragment's middle and that of its hit
RIM = 0.45  # cosine to the viewer below which the hit's normal stays: wide lobes that graze lose light
FLATTEST = 1e-5  # variance of slopes below which a footprint counts as flat


@device
def _bend(tables, p, t, ua, va, ub, vb, scale):
    """Change of the unit normal per metre of world space between two points of a triangle, squared."""
    ax, ay, az = interpolated_normal(tables, p, t, ua, va)
    bx, by, bz = interpolated_normal(tables, p, t, ub, vb)
    a, b = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz
    if not (a > 0.0 and b > 0.0):
        return 0.0
    turn = 2.0 - 2.0 * (ax * bx + ay * by + az * bz) / math.sqrt(a * b)
    corners, positions = pointer_i32(tables.triangles[p]), pointer_f32(tables.positions[p])
    length = 0.0
    for axis in range(3):
        x = np.float64(positions[3 * np.int64(corners[3 * t]) + axis])
        y = np.float64(positions[3 * np.int64(corners[3 * t + 1]) + axis])
        z = np.float64(positions[3 * np.int64(corners[3 * t + 2]) + axis])
        d = (ub - ua) * (y - x) + (vb - va) * (z - x)
        length += d * d
    length *= scale
    return max(turn, 0.0) / length if length > 0.0 else 0.0


@uncounted
def spread_of_curvature(tables, hits, width, seen, whole, rows, count, curved, spread):
    """curved (N,) float32 at rows[0..count]: variance of the slopes of the normals over the footprints `width`.

    spread (N,) float32: the same where it is worth noting.

    hits: of those rows; tables: PartTables; seen (N,) int32: subpixels in which each is seen, of which a footprint has
    `whole`. Triangles that are shaded flat have none.
    """
    for i in range(count):
        k = rows[i]
        p = np.int64(hits.part[k])
        if tables.normals[p] == 0:
            continue
        t = np.int64(hits.triangle[k]) - np.int64(tables.first_triangle[p])
        m = hits.world_from_part[k]
        scale = 0.0
        for r in range(3):
            for c in range(3):
                scale += m[r, c] * m[r, c] / 3.0
        # variance is that of the mean direction: most curved surfaces bend about one axis
        bend = 0.0
        for e in range(3):
            u, v = (1.0 if e == 0 else 0.0), (1.0 if e == 1 else 0.0)
            bend += _bend(tables, p, t, u, v, v, 1.0 - u - v, scale) / 3.0
        variance = bend * np.float64(width[k]) * np.float64(width[k]) / 12.0
        variance *= min(np.float64(seen[k]) / whole, 1.0)
        curved[k] = min(variance, 2.0)
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
        x, y, z = interpolated_normal(tables, p, t, u, v)
        cofactors(m, q)
        x, y, z = (
            q[0, 0] * x + q[0, 1] * y + q[0, 2] * z,
            q[1, 0] * x + q[1, 1] * y + q[1, 2] * z,
            q[2, 0] * x + q[2, 1] * y + q[2, 2] * z,
        )
        length = math.sqrt(x * x + y * y + z * z)
        inverse = 1.0 / length if length > 0.0 else 0.0
        along = inverse * (x * normal[k, 0] + y * normal[k, 1] + z * normal[k, 2])
        inverse = inverse if along > 0.0 else -inverse
        facing = inverse * (direction[k, 0] * x + direction[k, 1] * y + direction[k, 2] * z)
        if abs(along) > ALIKE and abs(facing) > RIM:
            normal[k, 0], normal[k, 1], normal[k, 2] = inverse * x, inverse * y, inverse * z
