"""Lamps as grids of points: how many stand for one as it is seen from a point that it lights, and how far apart."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.raytracing.lamps import (
    AX,
    AY,
    AZ,
    CONE,
    ELLIPSE,
    HALF_U,
    HALF_V,
    POINT,
    PX,
    PY,
    PZ,
    RADIUS,
    RECTANGLE,
    SPOT,
    SUN,
    TAN_SPREAD,
    UX,
    UY,
    UZ,
    VX,
    VY,
    VZ,
    area_point,
    spot_attenuation,
)
from pointmr_engine.shading.bsdf.vector import dot

# squared angles (sr) from which a lamp's side is so many points
TWO, ROW_OF_FOUR, ROW_OF_EIGHT = 0.05, 0.6, 4.0
# solid angle from which a lamp is sixteen points for lobes that are narrower than so many of it: one point for a lamp
# widens lobes by all of it, and lifts the tails of those that are about as narrow
SHARP, NARROWER = 1e-6, 3.0
BROAD = 1.2  # tangent of a spread's half angle from which a lamp is sixteen points where its light ends, and not 64
EVEN = 0.02  # of a spot's light may differ over a lamp before its edge counts as cutting it
SMALL = (
    0.15  # of what a spread lights, across, is a lamp that is small enough to send the same from everywhere
)
MANY = np.int64(64)  # points of a lamp at most
LONG = 4.0  # times as long as it is wide: a rectangle of which rows have points by the lobe's width
CELL = 1.4  # roughnesses of a lobe from one point of such a row to the next
# by which points are moved outwards from a lamp's middle, so that their mean square distance from it is the lamp's:
# of rows of n points, n a power of two, by sides of a rectangle and by the concentric mapping of round lamps
APART = (
    (1.0, 1.1547, 1.0, 1.0328, 1.0, 1.0, 1.0, 1.0079),
    (1.0, 1.4142, 1.0, 1.069, 1.0, 1.0, 1.0, 1.016),
)


@device
def points_of_lamp(lamps, i, px, py, pz, normal, solid, sharp, most):
    """(points along lamp i's sides u and v, by how much they are moved outwards along each).

    solid: its solid angle from p, 0 of a lamp that is one point; normal: of the surface there; sharp: the roughness of
    a lobe that is narrower than the lamp's longer side, or 0; most: points along a side.
    """
    shape = lamps.shape[i]
    across = up = np.int64(1)
    if solid > 0.0:
        least = np.int64(8)
        if not sees_a_part(lamps, i, px, py, pz, normal):
            least = _least_points(lamps, i, px, py, pz)
        across, up = _grid_of_points(lamps, i, solid, sharp)
        across, up = max(across, least), max(up, least)
        across, up = min(across, most), min(up, most)
    apart = APART[0 if shape == RECTANGLE else 1]
    return across, up, apart[min(across, 8) - 1], apart[min(up, 8) - 1]


@device
def sees_a_part(lamps, i, px, py, pz, n):
    """Whether the plane of a surface of normal n through p may cut lamp i in two."""
    row, shape = lamps.values[i], lamps.shape[i]
    if shape == SUN:
        middle, reach = -dot(n, (row[AX], row[AY], row[AZ])), math.sqrt(row[CONE] * (2.0 - row[CONE]))
    else:
        middle, reach = dot(n, (row[PX] - px, row[PY] - py, row[PZ] - pz)), row[RADIUS]
        if shape == RECTANGLE or shape == ELLIPSE:
            reach = row[HALF_U] * abs(dot(n, (row[UX], row[UY], row[UZ])))
            reach += row[HALF_V] * abs(dot(n, (row[VX], row[VY], row[VZ])))
    return abs(middle) < reach


@device
def _least_points(lamps, i, px, py, pz):
    """Points along a side of lamp i that it takes to tell what a beam's parts send to p: its edge may cut the lamp."""
    row, shape = lamps.values[i], lamps.shape[i]
    if row[SPOT] != 0.0 and shape != POINT:
        x, y, z = row[PX] - px, row[PY] - py, row[PZ] - pz
        least, most = 1.0, 0.0
        for k in range(4):
            side = row[RADIUS] if k & 1 else -row[RADIUS]
            at = UX if k >> 1 else VX
            t = spot_attenuation(row, x + side * row[at], y + side * row[at + 1], z + side * row[at + 2])
            least, most = min(least, t), max(most, t)
        return np.int64(8) if most - least > EVEN else np.int64(1)
    if row[TAN_SPREAD] < math.inf:
        u, v, h = area_point(row, px, py, pz)
        a, b, reach = row[HALF_U], row[HALF_V], h * row[TAN_SPREAD]
        u, v = abs(u) + a, abs(v) + b
        if u * u + v * v > reach * reach:
            return np.int64(4) if row[TAN_SPREAD] > BROAD else np.int64(8)
        return np.int64(4) if a * a + b * b > SMALL * SMALL * reach * reach else np.int64(1)
    return np.int64(1)


@device
def _row_of_points(square):
    """How many points a side of a lamp is that is seen under an angle of this square."""
    if square > ROW_OF_FOUR:
        return np.int64(8) if square > ROW_OF_EIGHT else np.int64(4)
    return np.int64(2) if square > TWO else np.int64(1)


@device
def length_of_lamp(lamps, i):
    """How many times as long as it is wide a lamp is, or as wide as it is long."""
    row, shape = lamps.values[i], lamps.shape[i]
    if shape != RECTANGLE and shape != ELLIPSE:
        return 1.0
    return max(row[HALF_U], row[HALF_V]) / min(row[HALF_U], row[HALF_V])


@device
def _row_in_lobe(angle, width, least, most):
    """Points, a power of two from least to most, of a lamp's side of `angle` rad, at most `width` rad apart."""
    n = least
    while n < most and np.float64(n) * width < angle:
        n *= 2
    return np.int64(n)


@device
def _grid_of_points(lamps, i, solid, sharp):
    """(points along a lamp's sides u, v), a lamp of `solid` sr; sharp: as of points_of_lamp."""
    row, shape = lamps.values[i], lamps.shape[i]
    longer = 1.0
    if shape == RECTANGLE or shape == ELLIPSE:
        longer = row[HALF_U] / row[HALF_V]
    across, up = _row_of_points(solid * longer), _row_of_points(solid / longer)
    if sharp > 0.0:
        length = length_of_lamp(lamps, i)
        if shape == RECTANGLE and length > LONG:
            width = CELL * sharp
            short = _row_in_lobe(math.sqrt(solid / length), width, np.int64(1), np.int64(4))
            long = _row_in_lobe(math.sqrt(solid * length), width, np.int64(8), MANY // short)
            least_across, least_up = (long, short) if longer > 1.0 else (short, long)
        else:
            least_across = least_up = np.int64(4)
        across, up = max(across, least_across), max(up, least_up)
    if shape == ELLIPSE:
        across = up = max(across, up)
    return across, up
