"""Robust ray tests: rays in a hierarchy's single precision space, triangles decided in double precision."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.pointers import load_f32

# of the largest coordinate: bounds every rounding of the box and triangle tests (16 units of 2^-24)
PAD = 1e-6
# stands for a direction component of zero, so that no infinity times zero can appear
FLAT = np.float32(1e-18)


@uncounted
def _axis(o, d, pad):
    """(reciprocal, shift of the first plane, shift of the last plane) of one axis, in single precision."""
    if abs(d) < FLAT:
        d = -FLAT if d < np.float32(0) else FLAT
    r = np.float32(1) / d
    p = -pad if d < np.float32(0) else pad
    return r, -(o + p) * r, (p - o) * r


@uncounted
def localize(ox, oy, oz, dx, dy, dz, radius):
    """A ray for a hierarchy whose coordinates, about its own centre (of which o is relative), are at most `radius`.

    Everything in single precision: the direction of unit length, and the origin moved along the ray to the hierarchy
    when it starts far away, so that rounding is relative to the hierarchy's size and not to the distance. Returns
    (length, shift, pad, origin (3), direction (3), near (3), scale (3), shift_near (3), shift_far (3)), the last
    four as simd.slab_test wants them; local t = t * length - shift.
    """
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    s = 1.0 / length
    dx *= s
    dy *= s
    dz *= s
    closest = -(ox * dx + oy * dy + oz * dz)
    shift = 0.0
    if closest > 4.0 * radius:
        shift = closest - 2.0 * radius
        ox += shift * dx
        oy += shift * dy
        oz += shift * dz
    pad = PAD * (max(abs(ox), abs(oy), abs(oz)) + radius)
    origin = (np.float32(ox), np.float32(oy), np.float32(oz))
    direction = (np.float32(dx), np.float32(dy), np.float32(dz))
    wide = np.float32(pad)
    rx, nx, fx = _axis(origin[0], direction[0], wide)
    ry, ny, fy = _axis(origin[1], direction[1], wide)
    rz, nz, fz = _axis(origin[2], direction[2], wide)
    near = (
        np.int64(24 if rx < np.float32(0) else 0),
        np.int64(32 if ry < np.float32(0) else 8),
        np.int64(40 if rz < np.float32(0) else 16),
    )
    return length, shift, pad, origin, direction, near, (rx, ry, rz), (nx, ny, nz), (fx, fy, fz)


@uncounted
def shear_of(origin, direction, scale):
    """(axes (kx, ky, kz), origin in that order, shear (Sx, Sy, Sz)) of a local ray for simd.triangle_test."""
    x, y, z = direction
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        axes = (np.int64(1), np.int64(2), np.int64(0))
        o = (origin[1], origin[2], origin[0])
        p, q, r = y, z, scale[0]
    elif ay >= az:
        axes = (np.int64(2), np.int64(0), np.int64(1))
        o = (origin[2], origin[0], origin[1])
        p, q, r = z, x, scale[1]
    else:
        axes = (np.int64(0), np.int64(1), np.int64(2))
        o = origin
        p, q, r = x, y, scale[2]
    return axes, o, (p * r, q * r, r)


@uncounted
def edge_met_exactly(blocks, block, lane, axes, origin, shear):
    """Decide in double precision a triangle of simd.triangle_test that the ray meets at an edge: (hit, t, u, v).

    The products of single precision coordinates are exact in double precision, so neighbours agree on every edge.
    """
    x0, y0, z0 = _sheared(blocks, block, lane, np.int64(0), axes, origin, shear)
    x1, y1, z1 = _sheared(blocks, block, lane, np.int64(1), axes, origin, shear)
    x2, y2, z2 = _sheared(blocks, block, lane, np.int64(2), axes, origin, shear)
    a = x2 * y1 - y2 * x1
    b = x0 * y2 - y0 * x2
    c = x1 * y0 - y1 * x0
    det = a + b + c
    inside = (a >= 0.0 and b >= 0.0 and c >= 0.0) or (a <= 0.0 and b <= 0.0 and c <= 0.0)
    if not inside or det == 0.0:
        return False, np.float32(0), np.float32(0), np.float32(0)
    t = (a * z0 + b * z1 + c * z2) / det
    return True, np.float32(t), np.float32(b / det), np.float32(c / det)


@uncounted
def _sheared(blocks, block, lane, vertex, axes, origin, shear):
    at = vertex * 24 + lane
    z = load_f32(blocks, block * 72 + at + 8 * axes[2]) - origin[2]
    x = (load_f32(blocks, block * 72 + at + 8 * axes[0]) - origin[0]) - shear[0] * z
    y = (load_f32(blocks, block * 72 + at + 8 * axes[1]) - origin[1]) - shear[1] * z
    return np.float64(x), np.float64(y), np.float64(shear[2] * z)


@uncounted
def plane_distance(blocks, block, lane, ox, oy, oz, dx, dy, dz):
    """Parameter t, in double precision, at which a ray meets the plane of a block's triangle (NaN: parallel)."""
    ax, ay, az = _vertex(blocks, block, lane, np.int64(0))
    bx, by, bz = _vertex(blocks, block, lane, np.int64(1))
    cx, cy, cz = _vertex(blocks, block, lane, np.int64(2))
    bx, by, bz = bx - ax, by - ay, bz - az
    cx, cy, cz = cx - ax, cy - ay, cz - az
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    return (nx * (ax - ox) + ny * (ay - oy) + nz * (az - oz)) / (nx * dx + ny * dy + nz * dz)


@uncounted
def point_distance(blocks, block, lane, u, v, ox, oy, oz, dx, dy, dz):
    """Parameter t, in double precision, of the point of a block's triangle with barycentric weights u, v."""
    ax, ay, az = _vertex(blocks, block, lane, np.int64(0))
    bx, by, bz = _vertex(blocks, block, lane, np.int64(1))
    cx, cy, cz = _vertex(blocks, block, lane, np.int64(2))
    p, q = np.float64(u), np.float64(v)
    x = ax + p * (bx - ax) + q * (cx - ax) - ox
    y = ay + p * (by - ay) + q * (cy - ay) - oy
    z = az + p * (bz - az) + q * (cz - az) - oz
    return (x * dx + y * dy + z * dz) / (dx * dx + dy * dy + dz * dz)


@uncounted
def _vertex(blocks, block, lane, vertex):
    at = vertex * 24 + lane
    return (
        np.float64(load_f32(blocks, block * 72 + at)),
        np.float64(load_f32(blocks, block * 72 + at + 8)),
        np.float64(load_f32(blocks, block * 72 + at + 16)),
    )
