"""Curvature of smooth-shaded triangles, from their corners' normals: how far the normals of a footprint spread."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.triangle_normals import interpolated_normal
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.pointers import pointer_f32, pointer_i32

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
def spread_of_curvature(tables, hits, width, seen, whole, rows, count, spread):
    """spread (N,) float32 at rows[0..count]: variance of the slopes of the normals over the footprints `width`.

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
        if variance > FLATTEST:
            spread[k] = min(variance, 2.0)
