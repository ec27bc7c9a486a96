"""Soft shadows: one cone from every surface point to each lamp, as wide as the lamp seen from there.

A cone ends with the lamp's shape; the share of its sub-rays that nothing blocks, each weighted by the irradiance that
its cell of the lamp brings, is the share of the lamp's light that arrives.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.cones.cones import Cones, jitter, perpendicular
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.raytracing.lamps import (
    AX,
    AY,
    AZ,
    CONE,
    ELLIPSE,
    HALF_U,
    HALF_V,
    PX,
    PY,
    PZ,
    RADIUS,
    RECTANGLE,
    SPHERE,
    SPOT,
    SUN,
    TAN_SPREAD,
    UX,
    UY,
    UZ,
    VX,
    VY,
    VZ,
    spot_at,
    spread_at,
)
from pointmr_engine.raytracing.terminator import rise
from pointmr_engine.scene.group import SHADOW
from pointmr_engine.shading.bsdf.layout import BUMPED, HAS_TRANSMISSION
from pointmr_engine.shading.bsdf.vector import dot, row3

ACROSS = 7  # of a cone's 8 cells lie in its lamp: the others are room for all to be shifted by half of one
CELL = 2.0 / ACROSS  # a cell's width on a lamp that reaches from -1 to 1
NEAR = 0.02  # footprints: what is nearer throws no shadow
EDGE_ON = 1e-3  # cosine below which flat lamps are not seen
# of the height of a lamp that a surface sees in part: where half of its light comes from, roughly
LIT = 2 / 3
_SHORT = 1.0 - 1e-5  # of the way to a lamp: what it is made of throws no shadow
# what take_shares needs of a cone: how its cells are shifted, cosines at the point towards the lamp and along its
# sides, cosines between these and the cone's axis, and between all three and the lamp's axis; which side of the surface
# the cone is for: 1, -1, or 0 for both
SHIFT_X, SHIFT_Y, TOWARDS, ALONG_X, ALONG_Y, LEAN_X, LEAN_Y, FACING, FACING_X, FACING_Y, SIDE = range(11)
TERMS = 11
NOTHING, BUMPS, ALL = 0, 1, 2  # of a point: what a lamp behind it may light


@device
def _set_frame(cones, m, x, y, n, d):
    """Axes of cone m, so that its coordinates count along the vectors x, y and d: x, y and n at right angles, unit."""
    depth = 1.0 / dot(d, n)
    lean_x, lean_y = dot(d, x) * depth, dot(d, y) * depth
    for k in range(3):
        cones.axes[m, 0, k] = x[k] - lean_x * n[k]
        cones.axes[m, 1, k] = y[k] - lean_y * n[k]
        cones.axes[m, 2, k] = n[k] * depth


@device
def _round_frame(row, shape, dx, dy, dz, distance, angle):
    """(x, y, half-width at `distance`) of what is round about d, a unit vector; a width of 0: nothing to be seen."""
    wide = row[RADIUS]
    if shape == SUN:
        wide = math.sqrt(max(row[CONE] * (2.0 - row[CONE]), 0.0)) / max(1.0 - row[CONE], 1e-3)
    elif shape == SPHERE:
        if distance <= wide:
            wide = 0.0
        else:
            wide *= distance / math.sqrt(distance * distance - wide * wide)
    ax, ay, az = perpendicular(1.0, 0.0, 0.0, dx, dy, dz)
    bx, by, bz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    c, s = math.cos(angle), math.sin(angle)
    return (
        (c * ax + s * bx, c * ay + s * by, c * az + s * bz),
        (c * bx - s * ax, c * by - s * ay, c * bz - s * az),
        wide,
    )


@device
def _towards(row, shape, px, py, pz):
    """(direction to a lamp's middle, distance) from a point: 1 to a sun, 0 where the point is its middle."""
    if shape == SUN:
        return -row[AX], -row[AY], -row[AZ], 1.0
    dx, dy, dz = row[PX] - px, row[PY] - py, row[PZ] - pz
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    inverse = 1.0 / distance if distance > 0.0 else 0.0
    return dx * inverse, dy * inverse, dz * inverse, distance


@device
def _lit_part(row, shape, px, py, pz, n):
    """Unit direction to a lamp's middle, or where a surface of normal n sees a part of it, to the middle of that."""
    dx, dy, dz, distance = _towards(row, shape, px, py, pz)
    if shape == RECTANGLE or shape == ELLIPSE:
        wide_x, wide_y = row[HALF_U], row[HALF_V]
        x, y = (row[UX], row[UY], row[UZ]), (row[VX], row[VY], row[VZ])
    else:
        x, y, wide_x = _round_frame(row, shape, dx, dy, dz, distance, 0.0)
        wide_y = wide_x
    middle = distance * dot(n, (dx, dy, dz))  # heights over the surface's plane, and across the lamp
    up_x, up_y = wide_x * dot(n, x), wide_y * dot(n, y)
    up = math.sqrt(up_x * up_x + up_y * up_y)
    if middle >= up or middle <= -up:
        return dx, dy, dz
    t = (LIT * (middle + up) - middle) / (up * up)
    a, b = t * up_x * wide_x, t * up_y * wide_y
    dx, dy, dz = (
        distance * dx + a * x[0] + b * y[0],
        distance * dy + a * x[1] + b * y[1],
        distance * dz + a * x[2] + b * y[2],
    )
    inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    return dx * inverse, dy * inverse, dz * inverse


@uncounted
def lit_from_behind(lobes, out, count):
    """out (N,) uint8: what a lamp behind points 0..count may light: NOTHING of them, BUMPS that face it, or ALL that
    light passes through."""
    for k in range(count):
        out[k] = ALL if lobes.flags[k] & HAS_TRANSMISSION else NOTHING
        for j in range(np.int64(lobes.count[k])):
            if out[k] == NOTHING and lobes.kind[k, j] & BUMPED:
                out[k] = BUMPS


@uncounted
def raise_points(
    lamps, i, tables, hits, frames, shading_normal, lobe_count, count, side, corners, normals, out
):
    """out (N, 3) float64: where cones from points 0..count to lamp i start: off coarse triangles that look smooth.

    side: 1.0 towards what of the lamp is on the viewer's side of the surface, -1.0 behind it, if it is on both. The
    other arguments as of raytracing.terminator.rise.
    """
    row, shape = lamps.values[i], lamps.shape[i]
    for k in range(count):
        px, py, pz = frames.position[k, 0], frames.position[k, 1], frames.position[k, 2]
        if lobe_count[k] > 0:
            x, y, z = row3(shading_normal, k)
            dx, dy, dz = _lit_part(row, shape, px, py, pz, (side * x, side * y, side * z))
            _, x, y, z = rise(tables, hits, frames, shading_normal, np.int64(k), dx, dy, dz, corners, normals)
            px, py, pz = px + x, py + y, pz + z
        out[k, 0], out[k, 1], out[k, 2] = px, py, pz


@device
def _add_cone(lamps, i, p, n, turn, cones, terms, m):
    """Fill row m: a cone from p to lamp i, but for where it starts and for whom; whether it has any width.

    n: normal at p; turn: two numbers in 0..1 that shift its cells.
    """
    row, shape = lamps.values[i], lamps.shape[i]
    px, py, pz = p
    dx, dy, dz, distance = _towards(row, shape, px, py, pz)
    if not distance > 0.0:
        return False
    shift_x, shift_y = turn[0] - 0.5, turn[1] - 0.5
    if shape == RECTANGLE or shape == ELLIPSE:
        x, y, across = (
            (row[UX], row[UY], row[UZ]),
            (row[VX], row[VY], row[VZ]),
            (-row[AX], -row[AY], -row[AZ]),
        )
        wide_x, wide_y = row[HALF_U], row[HALF_V]
        if dot((dx, dy, dz), across) < EDGE_ON:
            return False
    else:
        across = dx, dy, dz
        angle = 2.0 * math.pi * ((97.0 * turn[0] + turn[1]) % 1.0)
        x, y, wide_x = _round_frame(row, shape, dx, dy, dz, distance, angle)
        wide_y = wide_x
        if wide_x == 0.0:
            return False
    a, b = CELL * shift_x * wide_x, CELL * shift_y * wide_y
    tx = distance * dx + a * x[0] + b * y[0]
    ty = distance * dy + a * x[1] + b * y[1]
    tz = distance * dz + a * x[2] + b * y[2]
    way = math.sqrt(tx * tx + ty * ty + tz * tz)
    d = tx / way, ty / way, tz / way
    cones.spread[m, 0], cones.spread[m, 1] = 4.0 * CELL * wide_x / way, 4.0 * CELL * wide_y / way
    terms[m, SHIFT_X], terms[m, SHIFT_Y] = shift_x, shift_y
    terms[m, TOWARDS] = dot(n, d)
    terms[m, ALONG_X], terms[m, ALONG_Y] = dot(n, x) * cones.spread[m, 0], dot(n, y) * cones.spread[m, 1]
    terms[m, LEAN_X], terms[m, LEAN_Y] = dot(d, x), dot(d, y)
    axis = -row[AX], -row[AY], -row[AZ]
    terms[m, FACING] = dot(d, axis)
    terms[m, FACING_X], terms[m, FACING_Y] = dot(x, axis), dot(y, axis)
    cones.origin[m, 0], cones.origin[m, 1], cones.origin[m, 2] = px, py, pz
    cones.start[m, 0] = cones.start[m, 1] = 0.0
    _set_frame(cones, m, x, y, across, d)
    cones.t_max[m] = way * _SHORT
    if shape == SUN:
        cones.t_max[m] = math.inf
    elif shape == SPHERE:
        cones.t_max[m] = way * (_SHORT - row[RADIUS] / distance)
    cones.visibility[m] = SHADOW
    return True


@uncounted
def lamp_cones(
    lamps, i, position, below, normal, behind, width, offset, lobe_count, count, cones: Cones, rows, terms
):
    """Cones from points 0..count to lamp i, for those that it could light; returns how many, rows (2 N,) their points.

    A flat lamp's cells are even on the lamp, others' across the direction to it. Where they lie differs from point to
    point, lest their borders show. Two cones, one behind the other, of a point that light passes through and whose
    plane cuts the lamp: one for each side. terms (2 N, TERMS) float64: what take_shares needs of the cones, filled.

    position (N, 3) float64, and below for what is behind the surface; normal (N, 3) float32: what points are shaded by,
    for a lamp below a flat triangle may light it where it looks round, and the triangles beside it are what hides it;
    behind (N,) uint8: lit_from_behind; width (N,) float32: the points' footprints; offset (N,) float64: what is nearer
    throws no shadow.
    """
    m = np.int64(0)
    for k in range(count):
        if lobe_count[k] == 0:
            continue
        n = row3(normal, k)
        turn = jitter(position[k, 0], position[k, 1], position[k, 2], width[k])
        if not _add_cone(lamps, i, row3(position, k), n, turn, cones, terms, m):
            continue
        towards, reach = terms[m, TOWARDS], abs(terms[m, ALONG_X]) + abs(terms[m, ALONG_Y])
        if behind[k] == NOTHING and towards + reach <= 0.0:
            continue
        rows[m], cones.t_min[m], terms[m, SIDE] = k, max(offset[k], NEAR * width[k]), 1.0
        m += 1
        if behind[k] != ALL:
            continue
        if abs(towards) >= reach:
            terms[m - 1, SIDE] = 0.0
        elif _add_cone(lamps, i, row3(below, k), n, turn, cones, terms, m):
            rows[m], cones.t_min[m], terms[m, SIDE] = k, cones.t_min[m - 1], -1.0
            m += 1
    return m


@device
def _irradiance(cones, terms, m, i, j, shape, row, beam, side):
    """Of the irradiance that cone m's lamp brings, what cell (i, j) does: its solid angle, the cosine at the point, and
    what a `beam` lets out that way.

    In any unit; 0 for cells whose middles the lamp does not fill. shape, row: the lamp's; side: as SIDE.
    """
    u, v = CELL * (i - 3.5 + terms[m, SHIFT_X]), CELL * (j - 3.5 + terms[m, SHIFT_Y])
    if shape == RECTANGLE:
        if max(abs(u), abs(v)) > 1.0:
            return 0.0
    elif u * u + v * v > 1.0:
        return 0.0
    u, v = 0.25 * i - 0.875, 0.25 * j - 0.875
    cosine = terms[m, TOWARDS] + u * terms[m, ALONG_X] + v * terms[m, ALONG_Y]
    if side != 0.0:
        cosine *= side
        if cosine < 0.0:
            return 0.0
    cosine = abs(cosine)
    u *= cones.spread[m, 0]
    v *= cones.spread[m, 1]
    square = 1.0 + 2.0 * (u * terms[m, LEAN_X] + v * terms[m, LEAN_Y]) + u * u + v * v
    if beam:
        facing = terms[m, FACING] + u * terms[m, FACING_X] + v * terms[m, FACING_Y]
        facing /= math.sqrt(square)
        cosine *= spot_at(row, facing) if row[SPOT] != 0.0 else spread_at(row, facing)
    return cosine / (square * square)


@device
def _arriving(mask, shape, row, beam, cones, terms, m, side):
    """(irradiance of cone m's lamp, what the blocked sub-rays in `mask` leave of it)."""
    total, left = 0.0, 0.0
    for b in range(64):
        e = _irradiance(cones, terms, m, b & 7, b >> 3, shape, row, beam, side)
        total += e
        if (mask >> np.uint64(b)) & np.uint64(1) == np.uint64(0):
            left += e
    return total, left


@uncounted
def take_shares(masks, lamps, i, cones: Cones, terms, behind, rows, count, share, beneath):
    """share (N,) float32 of points rows[0..count]: what the blocked sub-rays in `masks` leave of lamp i's irradiance.

    beneath (N,) float32: of what of the lamp is behind the surface. cones, terms, behind: of lamp_cones.
    """
    shape, row = lamps.shape[i], lamps.values[i]
    beam = row[SPOT] != 0.0 or row[TAN_SPREAD] < math.inf
    for m in range(count):
        mask, k, side = masks[m], rows[m], terms[m, SIDE]
        left = 1.0
        if mask != np.uint64(0):
            total, left = _arriving(mask, shape, row, beam, cones, terms, m, side)
            if total == 0.0 and behind[k] == BUMPS:
                total, left = _arriving(mask, shape, row, beam, cones, terms, m, 0.0)
            left = left / total if total > 0.0 else 1.0
        if side >= 0.0:
            share[k] = left
        if side <= 0.0 or behind[k] != ALL:
            beneath[k] = left
