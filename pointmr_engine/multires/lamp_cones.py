"""Soft shadows: one cone from every surface point to each lamp, as wide as the lamp seen from there.

A cone begins with the point's footprint and ends with the lamp's shape; the share of its sub-rays that nothing blocks,
weighted by how much of each one's cell the lamp fills, is the share of the lamp's light that arrives (science: a mask
over the light per fragment). Sharp lamps take cones that close to a point: no area is sampled for them.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.cones import Cones
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


@uncounted
def lamp_cones(lamps, i, position, normal, both, width, offset, lobe_count, count, cones: Cones, rows):
    """Cones from points 0..count to lamp i, for those that it could light; returns how many, rows (N,) their points.

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
        half = np.float64(0.5) * width[k]
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
        set_axes(cones, m, ux, uy, uz, dx, dy, dz)
        cones.start[m, 0] = cones.start[m, 1] = half
        shrink = 0.0 if distance == math.inf else half / distance
        cones.spread[m, 0], cones.spread[m, 1] = wide_x - shrink, wide_y - shrink
        # the cone begins on a plane across its axis: what lies below the surface is left out
        slope = math.sqrt(max(1.0 - facing * facing, 0.0)) / max(abs(facing), 0.25)
        cones.t_min[m] = max(offset[k], half * slope)
        cones.t_max[m] = distance
        if distance < math.inf:
            cones.t_max[m] = distance * _SHORT - (row[RADIUS] if shape == SPHERE else 0.0)
        cones.visibility[m] = SHADOW
        m += 1
    return m


@uncounted
def take_shares(masks, weights, shape, rows, count, share):
    """share (N,) float32 of points rows[0..count]: what the blocked sub-rays in `masks` leave of a lamp.

    weights: cell_weights().
    """
    kind = np.int64(0)
    if shape == SPHERE or shape == DISC or shape == ELLIPSE or shape == SUN:
        kind = np.int64(1)
    for m in range(count):
        mask = masks[m]
        if mask == np.uint64(0):
            share[rows[m]] = 1.0
            continue
        total = np.float32(0)
        for b in range(64):
            if (mask >> np.uint64(b)) & np.uint64(1) == np.uint64(0):
                total += weights[kind, b]
        share[rows[m]] = total
