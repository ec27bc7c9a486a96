"""Shading normals of triangles, in their mesh's space."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.pointers import load_f32, load_i32


@device
def interpolated_normal(tables, part, triangle, u, v):
    """Sum of the vertices' normals at (u, v), not of unit length; of the triangle's plane where there is none.

    tables: PartTables; part, triangle (in its shape): int64.
    """
    at = tables.triangles[part]
    first = 3 * triangle
    i, j, k = load_i32(at, first), load_i32(at, first + 1), load_i32(at, first + 2)
    x = y = z = 0.0
    if tables.normals[part] != 0:
        a, b, c = i, j, k
        if tables.normals_per_corner[part]:
            a, b, c = first, first + 1, first + 2
        w = 1.0 - u - v
        at = tables.normals[part]
        x = w * load_f32(at, 3 * a) + u * load_f32(at, 3 * b) + v * load_f32(at, 3 * c)
        y = w * load_f32(at, 3 * a + 1) + u * load_f32(at, 3 * b + 1) + v * load_f32(at, 3 * c + 1)
        z = w * load_f32(at, 3 * a + 2) + u * load_f32(at, 3 * b + 2) + v * load_f32(at, 3 * c + 2)
    if x == 0.0 and y == 0.0 and z == 0.0:
        at = tables.positions[part]
        ax = np.float64(load_f32(at, 3 * j)) - load_f32(at, 3 * i)
        ay = np.float64(load_f32(at, 3 * j + 1)) - load_f32(at, 3 * i + 1)
        az = np.float64(load_f32(at, 3 * j + 2)) - load_f32(at, 3 * i + 2)
        bx = np.float64(load_f32(at, 3 * k)) - load_f32(at, 3 * i)
        by = np.float64(load_f32(at, 3 * k + 1)) - load_f32(at, 3 * i + 1)
        bz = np.float64(load_f32(at, 3 * k + 2)) - load_f32(at, 3 * i + 2)
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return x, y, z
