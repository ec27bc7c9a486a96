"""Smooth shading on coarse triangles: shadow rays near the terminator start on the surface that the normals suggest.

Where the light grazes, flat triangles shadow themselves in facets that smooth shading hides everywhere else. Such rays
are raised into the hull of the corners' tangent planes, and at least half way to the parabolic patch through them.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.pointers import pointer_f32, pointer_i32


@uncounted
def share_of_height(cos_shading, cos_geometric, cutoff):
    """How far a ray is raised, 0..1, by its cosines to both normals: from 1 at grazing light smoothly to 0."""
    if cos_shading < cutoff:
        share = 2.0 - (cos_geometric + cos_shading) / cutoff
    else:
        share = 1.0 - cos_geometric / cutoff
    return min(max(share, 0.0), 1.0)


@uncounted
def _difference_along(normals, k, points, i, j):
    """Dot product of normal k with points[i] - points[j]."""
    total = 0.0
    for a in range(3):
        total += normals[k, a] * (points[i, a] - points[j, a])
    return total


@uncounted
def height(corners, normals, side, u, v, w):
    """Height of the smooth surface over the flat triangle, in units of the interpolated normal (not unit length).

    corners, normals (4, 3) float64: of the triangle, and row 3 for room: the point goes there. side: 1.0 for the side
    that the normals point to, -1.0 for the other, where the height is negative. u, v, w: weights of corners 0, 1, 2.
    """
    for a in range(3):
        corners[3, a] = u * corners[0, a] + v * corners[1, a] + w * corners[2, a]
    bend_02 = _difference_along(normals, 2, corners, 0, 2) - _difference_along(normals, 0, corners, 0, 2)
    bend_12 = _difference_along(normals, 2, corners, 1, 2) - _difference_along(normals, 1, corners, 1, 2)
    bend_01 = _difference_along(normals, 1, corners, 1, 0) - _difference_along(normals, 0, corners, 1, 0)
    parabola = bend_02 * u * (u - 1.0) + (bend_02 + bend_12 + bend_01) * u * v + bend_12 * v * (v - 1.0)
    envelope = math.inf
    for k in range(3):
        reach = 0.0
        for j in range(3):
            reach = max(reach, side * _difference_along(normals, k, corners, j, k))
        envelope = min(envelope, max(side * _difference_along(normals, k, corners, k, 3) + reach, 0.0))
    return side * max(envelope, 0.5 * side * parabola)


@uncounted
def rise(tables, hits, frames, shading_normal, k, dx, dy, dz, corners, normals):
    """(kind, x, y, z): the step from point k to where a ray to the light in direction d starts, in the world's space.

    kind: 0 where it starts at the point itself, 2 where it goes below the point's triangle and may meet it, else 1.
    shading_normal (N, 3): on the viewer's side; d a unit vector; corners, normals (4, 3) float64: room to work in.
    """
    p = hits.part[k]
    cutoff = np.float64(tables.terminator_offset[p])
    if not cutoff > 0.0 or tables.normals[p] == 0:
        return 0, 0.0, 0.0, 0.0
    cos_shading = dx * shading_normal[k, 0] + dy * shading_normal[k, 1] + dz * shading_normal[k, 2]
    g = frames.geometric_normal
    cos_geometric = dx * g[k, 0] + dy * g[k, 1] + dz * g[k, 2]
    front = frames.backfacing[k] == (cos_shading < 0.0)  # the light is where geometric_normal points
    share = share_of_height(abs(cos_shading), cos_geometric if front else -cos_geometric, cutoff)
    if share == 0.0:
        return 0, 0.0, 0.0, 0.0
    t = np.int64(hits.triangle[k]) - tables.first_triangle[p]
    triangles, positions = pointer_i32(tables.triangles[p]), pointer_f32(tables.positions[p])
    values = pointer_f32(tables.normals[p])
    for c in range(3):
        vertex = np.int64(triangles[3 * t + c])
        normal = 3 * t + c if tables.normals_per_corner[p] else vertex
        for a in range(3):
            corners[c, a] = positions[3 * vertex + a]
            normals[c, a] = values[3 * normal + a]
    v, w = np.float64(hits.u[k]), np.float64(hits.v[k])
    u = 1.0 - v - w
    m = hits.world_from_part[k]
    up = 0.0  # the interpolated normal's cosine to the side of the light, times something positive
    for r in range(3):
        x = 0.0
        for a in range(3):
            normals[3, a] = u * normals[0, a] + v * normals[1, a] + w * normals[2, a]
            x += m[r, a] * normals[3, a]
        up += x * g[k, r]
    side = 1.0 if (up > 0.0) == front else -1.0
    h = share * height(corners, normals, side, u, v, w)
    nx, ny, nz = h * normals[3, 0], h * normals[3, 1], h * normals[3, 2]
    x = m[0, 0] * nx + m[0, 1] * ny + m[0, 2] * nz
    y = m[1, 0] * nx + m[1, 1] * ny + m[1, 2] * nz
    z = m[2, 0] * nx + m[2, 1] * ny + m[2, 2] * nz
    return 2 if (cos_geometric > 0.0) != front else 1, x, y, z


@uncounted
def raise_origins(tables, hits, frames, shading_normal, shadows, n, corners, normals):
    """Move the origins of shadow rays 0..n that start on smooth triangles in grazing light; their ends stay.

    Arguments as of `rise`.
    """
    rays = shadows.rays
    for i in range(n):
        k = np.int64(shadows.source[i])
        length = rays.t_max[i]
        if length == 0.0 or not shadows.raised[i]:
            continue
        d = rays.direction[i]
        kind, x, y, z = rise(tables, hits, frames, shading_normal, k, d[0], d[1], d[2], corners, normals)
        if kind == 0:
            continue
        rays.origin[i, 0] += x
        rays.origin[i, 1] += y
        rays.origin[i, 2] += z
        if length < math.inf:
            ex, ey, ez = d[0] * length - x, d[1] * length - y, d[2] * length - z
            distance = math.sqrt(ex * ex + ey * ey + ez * ez)
            rays.t_max[i] = distance
            d[0], d[1], d[2] = ex / distance, ey / distance, ez / distance
        if kind == 2:
            rays.skip_triangle[i] = -1
