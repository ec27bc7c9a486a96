"""Soft shadows: one cone from every surface point to each lamp, as wide as the lamp seen from there.

A cone begins with the point's footprint and ends with the lamp's shape; the share of its sub-rays that nothing blocks,
weighted by how much of each one's cell the lamp fills, is the share of the lamp's light that arrives (science: a mask
over the light per fragment). Sharp lamps take cones that close to a point: no area is sampled for them.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.cones import Cones
from pointmr_engine.numerics.hashing import hash_u32
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.raytracing.lamps import (
    AX,
    AY,
    AZ,
    CONE,
    DISC,
    DISTANT,
    ELLIPSE,
    HALF_U,
    HALF_V,
    POINT,
    PX,
    PY,
    PZ,
    RADIUS,
    RECTANGLE,
    SPHERE,
    SUN,
    UX,
    UY,
    UZ,
    VX,
    VY,
    VZ,
)
from pointmr_engine.scene.group import SHADOW

WIDER = 9.0 / 8.0  # cones of area lights: room for their cells to be shifted by half of one
NEAR = 0.02  # footprints: what is nearer throws no shadow
_SHORT = 1.0 - 1e-5  # of the way to a lamp: what it is made of throws no shadow


def cell_weights() -> np.ndarray:
    """(2, 64) float32: share of each of the 8 x 8 cells that the inscribed square and disc fill; each row sums to 1."""
    fine = (np.arange(256) + 0.5) / 128.0 - 1.0
    disc = (fine[:, None] ** 2 + fine[None, :] ** 2 <= 1.0).reshape(8, 32, 8, 32).mean((1, 3)).ravel()
    return np.stack([np.full(64, 1 / 64), disc / disc.sum()]).astype(np.float32)


@device
def perpendicular(x, y, z, dx, dy, dz):
    """A unit vector along (x, y, z) less its part along the unit vector d; any across d where there is none."""
    along = x * dx + y * dy + z * dz
    x, y, z = x - along * dx, y - along * dy, z - along * dz
    length = math.sqrt(x * x + y * y + z * z)
    if length > 1e-6:
        return x / length, y / length, z / length
    if abs(dx) < 0.7:
        x, y, z = 0.0, dz, -dy
    else:
        x, y, z = -dz, 0.0, dx
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@device
def set_axes(cones, m, x, y, z, dx, dy, dz):
    """Axes of cone m: along the unit vector d, with x as near to (x, y, z) as can be."""
    x, y, z = perpendicular(x, y, z, dx, dy, dz)
    cones.axes[m, 0, 0], cones.axes[m, 0, 1], cones.axes[m, 0, 2] = x, y, z
    cones.axes[m, 1, 0] = dy * z - dz * y
    cones.axes[m, 1, 1] = dz * x - dx * z
    cones.axes[m, 1, 2] = dx * y - dy * x
    cones.axes[m, 2, 0], cones.axes[m, 2, 1], cones.axes[m, 2, 2] = dx, dy, dz


@device
def jitter(x, y, z, width):
    """Two numbers in [0, 1) that differ from point to point, but not with the place of the point in the image."""
    scale = 8.0 / width if width > 0.0 else 1.0
    a, b, c = (
        np.int64(math.floor(x * scale)),
        np.int64(math.floor(y * scale)),
        np.int64(math.floor(z * scale)),
    )
    h = hash_u32(np.uint32(a & 0xFFFFFFFF))
    h = hash_u32(np.uint32(h ^ np.uint32(b & 0xFFFFFFFF)))
    h = hash_u32(np.uint32(h ^ np.uint32(c & 0xFFFFFFFF)))
    return (h & np.uint32(0xFFFF)) / 65536.0, (h >> np.uint32(16)) / 65536.0


@uncounted
def lamp_cones(
    lamps, i, position, normal, both, width, offset, lobe_count, count, cones: Cones, rows, shifts
):
    """Cones from points 0..count to lamp i, for those that it could light; returns how many, rows (N,) their points.

    shifts (N, 2) float64: of area lights' cells, filled.

    position (N, 3) float64; normal (N, 3) float32, on the viewer's side; both (N,) bool: lit from behind as well;
    width (N,) float32: the points' footprints; offset (N,) float64: what is nearer throws no shadow.
    """
    row, shape = lamps.values[i], lamps.shape[i]
    m = np.int64(0)
    for k in range(count):
        if lobe_count[k] == 0:
            continue
        px, py, pz = position[k, 0], position[k, 1], position[k, 2]
        distance = math.inf
        dx, dy, dz = -row[AX], -row[AY], -row[AZ]
        wide_x = wide_y = 0.0
        ux, uy, uz = row[UX], row[UY], row[UZ]
        if shape == SUN:
            wide_x = math.sqrt(max(row[CONE] * (2.0 - row[CONE]), 0.0)) / max(1.0 - row[CONE], 1e-3)
            wide_y = wide_x
        elif shape != DISTANT:
            dx, dy, dz = row[PX] - px, row[PY] - py, row[PZ] - pz
            distance = math.sqrt(dx * dx + dy * dy + dz * dz)
            if not distance > 0.0:
                continue
            dx, dy, dz = dx / distance, dy / distance, dz / distance
            if shape == SPHERE or shape == DISC:
                wide_x = wide_y = row[RADIUS]
                if shape == SPHERE:
                    if distance <= row[RADIUS]:
                        continue
                    wide_x *= distance / math.sqrt(distance * distance - row[RADIUS] * row[RADIUS])
                    wide_y = wide_x
            elif shape != POINT:
                if dx * row[AX] + dy * row[AY] + dz * row[AZ] >= 0.0:
                    continue
                along = ux * dx + uy * dy + uz * dz
                wide_x = row[HALF_U] * math.sqrt(max(1.0 - along * along, 0.0))
                x, y, z = perpendicular(ux, uy, uz, dx, dy, dz)
                x, y, z = dy * z - dz * y, dz * x - dx * z, dx * y - dy * x
                wide_y = row[HALF_V] * abs(row[VX] * x + row[VY] * y + row[VZ] * z)
            wide_x, wide_y = wide_x / distance, wide_y / distance
        facing = normal[k, 0] * dx + normal[k, 1] * dy + normal[k, 2] * dz
        if not both[k] and facing < -max(wide_x, wide_y):
            continue
        rows[m] = k
        cones.origin[m, 0], cones.origin[m, 1], cones.origin[m, 2] = px, py, pz
        turn = jitter(px, py, pz, width[k])
        cones.start[m, 0] = cones.start[m, 1] = 0.0
        cones.spread[m, 0], cones.spread[m, 1] = wide_x, wide_y
        if shape == RECTANGLE or shape == ELLIPSE:
            # the cells lie elsewhere on the lamp from point to point, lest their borders show
            shift_x, shift_y = turn[0] - 0.5, turn[1] - 0.5
            shifts[m, 0], shifts[m, 1] = shift_x, shift_y
            cones.spread[m, 0], cones.spread[m, 1] = wide_x * WIDER, wide_y * WIDER
            x, y, z = perpendicular(ux, uy, uz, dx, dy, dz)
            a, b = 0.25 * WIDER * wide_x * shift_x, 0.25 * WIDER * wide_y * shift_y
            ex, ey, ez = dy * z - dz * y, dz * x - dx * z, dx * y - dy * x
            tx, ty, tz = dx + a * x + b * ex, dy + a * y + b * ey, dz + a * z + b * ez
            inverse = 1.0 / math.sqrt(tx * tx + ty * ty + tz * tz)
            dx, dy, dz = tx * inverse, ty * inverse, tz * inverse
        elif wide_x > 0.0:
            angle = 2.0 * math.pi * turn[0]
            x, y, z = perpendicular(ux, uy, uz, dx, dy, dz)
            ex, ey, ez = dy * z - dz * y, dz * x - dx * z, dx * y - dy * x
            c, s = math.cos(angle), math.sin(angle)
            ux, uy, uz = c * x + s * ex, c * y + s * ey, c * z + s * ez
        set_axes(cones, m, ux, uy, uz, dx, dy, dz)
        cones.t_min[m] = max(offset[k], NEAR * width[k])
        cones.t_max[m] = distance
        if distance < math.inf:
            cones.t_max[m] = distance * _SHORT - (row[RADIUS] if shape == SPHERE else 0.0)
        cones.visibility[m] = SHADOW
        m += 1
    return m


@device
def _overlap(i, shift):
    """Share of cell i of 8 that the middle 8 / WIDER cells fill, the cells shifted by `shift` of one."""
    low, high = i - 4.0 + shift, i - 3.0 + shift
    edge = 4.0 / WIDER
    return max(min(high, edge) - max(low, -edge), 0.0)


@uncounted
def take_shares(masks, weights, shape, rows, shifts, count, share):
    """share (N,) float32 of points rows[0..count]: what the blocked sub-rays in `masks` leave of a lamp.

    weights: cell_weights(); shifts: of lamp_cones.
    """
    kind = np.int64(0)
    if shape == SPHERE or shape == DISC or shape == SUN:
        kind = np.int64(1)
    for m in range(count):
        mask = masks[m]
        if mask == np.uint64(0):
            share[rows[m]] = 1.0
            continue
        total, left = 0.0, 0.0
        for b in range(64):
            w = np.float64(weights[kind, b])
            if shape == RECTANGLE:
                w = _overlap(b & 7, shifts[m, 0]) * _overlap(b >> 3, shifts[m, 1])
            elif shape == ELLIPSE:
                u = ((b & 7) - 3.5 + shifts[m, 0]) * (0.25 * WIDER)
                v = ((b >> 3) - 3.5 + shifts[m, 1]) * (0.25 * WIDER)
                # a cell is a quarter wide: the rim takes part of it
                w = min(max((1.0 - math.sqrt(u * u + v * v)) / (0.25 * WIDER) + 0.5, 0.0), 1.0)
            total += w
            if (mask >> np.uint64(b)) & np.uint64(1) == np.uint64(0):
                left += w
        share[rows[m]] = left / total if total > 0.0 else 1.0
