"""Light that fragments share: each asks with few rays, and all hear the answers.

What the world sends to a surface, and what a rough lobe sees, changes slowly along the surface: by about as much as one
moves against the distance of what is met, and as the surface turns (the split-sphere model: Ward, Rubinstein, Clear
1988, "A Ray Tracing Solution for Diffuse Interreflection"); for a lobe, against its width. So fragments within a few
cones take the mean of what arrives at each other, as far as that model allows: all of it in the open, none of it in a
corner or in foliage. Fragments of one cone that are nearly alike do so as one. How what the world sends changes with
the normal is known from the rays' directions (Ward, Heckbert 1992, "Irradiance Gradients"): each fragment receives the
mean for its own normal.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.reconstruction.fragments import cell_at
from pointmr_engine.multires.sharing.light_shares import DIM, Shares, has_to_share
from pointmr_engine.multires.sharing.sharing_eights import receive
from pointmr_engine.multires.sharing.sharing_lanes import (
    ANGLE,
    ARRIVED,
    AT_X,
    AT_Y,
    COLUMNS,
    FACING,
    HEARD,
    NEARNESS,
    PLACE,
    SUM_ARRIVED,
    SUM_FACING,
    SUM_HEARD,
    SUM_TURNED,
    SUMS,
    TURNED,
)
from pointmr_engine.numerics.jit import device, uncounted

REACH = 5  # cones: how far apart fragments share
NEIGHBOURHOOD = 2  # cones: how far apart what rays met tells how near things are
ERROR = 0.5  # of what arrives: change along the surface at which sharing ends
ALIKE = 0.2  # of it: fragments of a cone that differ by less receive the same

MOST_TURN = 1.0  # of what arrives: by how much it may change from the mean normal to a fragment's


class Change(NamedTuple):
    """How fast light of a kind changes along a surface, of what arrives.

    turn: with the root of 1 less the cosine of normals (their angle over 1.4); view: with the angle by which the view
    turns.
    """

    turn: float
    view: float


# the split sphere has 1 for the turn of the world, and this for what its gradient leaves of it; lamps have no gradient;
# mirrored, light turns twice as far, of which a half is what wires, scans and cars were measured to need
OF_WORLD, OF_LAMPS, OF_LOBE = Change(2.0, 0.0), Change(4.0, 0.0), Change(math.sqrt(2.0), 1.0)
# what is refracted turns less than a mirror that spreads light as much would turn it
OF_REFRACTION = Change(0.25 * math.sqrt(2.0), 1.0)


@uncounted
def _by_cone(x, y, subpixels, shares, count, start, order):
    """Order the fragments 0..count that share by cone: start (rows, columns + 1) int32 of each in order (F,) int32."""
    rows, columns = start.shape[0], start.shape[1] - 1
    start[:] = 0
    for k in range(count):
        if has_to_share(shares, k):
            i, j = cell_at(x[k], y[k], subpixels, (rows, columns))
            start[j, i] += 1
    total = 0
    for j in range(rows):
        for i in range(columns + 1):
            total += start[j, i]
            start[j, i] = total
    for k in range(count - 1, -1, -1):
        if has_to_share(shares, k):
            i, j = cell_at(x[k], y[k], subpixels, (rows, columns))
            start[j, i] -= 1
            order[start[j, i]] = k
    return total


@uncounted
def _met_about(shares, start, order, wide, sums, near):
    """near (rows, columns) float32: mean of 1 / metres of the rays of fragments within `wide` cones of each cone.

    sums (2, rows, columns) float64 to work in.
    """
    rows, columns = near.shape
    for j in range(rows):
        for i in range(columns):
            met, rays = 0.0, 0.0
            for s in range(start[j, i], start[j, i + 1]):
                met += np.float64(shares.nearness[order[s]])
                rays += np.float64(shares.rays[order[s]])
            sums[0, j, i], sums[1, j, i] = met, rays
    for j in range(rows):
        for i in range(columns):
            met, rays = 0.0, 0.0
            for q in range(max(j - wide, 0), min(j + wide + 1, rows)):
                for p in range(max(i - wide, 0), min(i + wide + 1, columns)):
                    met += sums[0, q, p]
                    rays += sums[1, q, p]
            near[j, i] = met / max(rays, 1.0)


@uncounted
def _join_alike(shares, start, order, near, origin, turn, view, into, begin, table):
    """Fragments of a cone that would share nearly all become one row of table (COLUMNS, F) float32; returns how many.

    into (F,) int32: the row of each of order (F,); begin (rows, columns + 1) int32: first rows of cones; origin (3,)
    float64: about which places keep their precision, which are seen from there if view is more than 0.
    """
    rows, columns = near.shape
    n = np.int64(0)
    for j in range(rows):
        for i in range(columns):
            first = n
            begin[j, i] = first
            for s in range(start[j, i], start[j, i + 1]):
                k = np.int64(order[s])
                x = np.float32(shares.position[k, 0] - origin[0])
                y = np.float32(shares.position[k, 1] - origin[1])
                z = np.float32(shares.position[k, 2] - origin[2])
                width = shares.width[k]
                nearness = near[j, i]
                if view > np.float32(0):
                    nearness += view / max(math.sqrt(x * x + y * y + z * z), np.float32(1e-30))
                found = n
                for g in range(first, n):
                    dx, dy, dz = table[PLACE, g] - x, table[PLACE + 1, g] - y, table[PLACE + 2, g] - z
                    facing = np.float32(0)
                    for c in range(3):
                        facing += table[FACING + c, g] * shares.normal[k, c]
                    change = math.sqrt(dx * dx + dy * dy + dz * dz) * nearness
                    change += turn * math.sqrt(max(np.float32(1) - facing, np.float32(0)))
                    if change + abs(table[ANGLE, g] - width) < ALIKE * ERROR * width:
                        found = np.int64(g)
                        break
                into[s] = found
                if found == n:
                    n += 1
                    table[NEARNESS, found], table[ANGLE, found] = nearness, width
                    table[AT_X, found], table[AT_Y, found] = i, j
                    table[PLACE, found], table[PLACE + 1, found], table[PLACE + 2, found] = x, y, z
                    for c in range(3):
                        table[FACING + c, found] = shares.normal[k, c]
                        table[HEARD + c, found] = table[ARRIVED + c, found] = np.float32(0)
                        table[TURNED + c, found] = np.float32(0)
                for c in range(3):
                    table[TURNED + c, found] += shares.worth[k] * shares.turned[k, c]
                    if shares.albedo[k, c] > DIM:
                        table[HEARD + c, found] += shares.worth[k]
                        table[ARRIVED + c, found] += shares.worth[k] * (
                            shares.light[k, c] / shares.albedo[k, c]
                        )
        begin[j, columns] = n
    return n


@device
def _turn(received, row, normal, k):
    """What arrives at normal[k], against at the mean normal of those whose light it is: row of `received`."""
    heard, arrived = np.float32(0), np.float32(0)
    for c in range(3):
        heard += received[SUM_HEARD + c, row]
        arrived += received[SUM_ARRIVED + c, row]
    change = np.float32(0)
    if heard > 0.0 and arrived > 0.0:
        for c in range(3):
            change += (normal[k, c] - received[SUM_FACING + c, row] / heard) * received[SUM_TURNED + c, row]
        change = min(max(change / arrived, np.float32(-MOST_TURN)), np.float32(MOST_TURN))
    return np.float32(1) + change


@uncounted
def _add_received(shares, order, into, total, received, out):
    """Add what the fragments order[0..total] reflect of what their rows `into` received to out (F, 3)."""
    for s in range(total):
        k, row = np.int64(order[s]), np.int64(into[s])
        turn = _turn(received, row, shares.normal, k)
        for c in range(3):
            heard, arrived = received[SUM_HEARD + c, row], received[SUM_ARRIVED + c, row]
            if heard > 0.0 and shares.albedo[k, c] > DIM:
                out[k, c] += turn * shares.albedo[k, c] * arrived / heard
            else:
                out[k, c] += shares.light[k, c]


def share_light(x, y, cone: int, change: Change, shares: Shares, count: int, shape, eye, out) -> None:
    """Add what fragments 0..count of a tile of `shape` cones (rows, columns) share to out (F, 3) float32.

    x, y (F,) float32: their places, subpixels, of which a cone has `cone` a side; change: OF_WORLD, ...; eye (3,)
    float64: where they are seen from, or for a parallel view a place among them.
    """
    (rows, columns), n = shape, np.int64(count)
    start, order = np.empty((rows, columns + 1), np.int32), np.empty(count, np.int32)
    total = np.int64(_by_cone(x, y, np.int64(cone), shares, n, start, order))
    near, begin = np.empty(shape, np.float32), np.empty_like(start)
    _met_about(shares, start, order, np.int64(NEIGHBOURHOOD), np.empty((2, rows, columns)), near)
    into, table = np.empty(total, np.int32), np.empty((COLUMNS, total), np.float32)
    made = _join_alike(
        shares, start, order, near, eye, np.float32(change.turn), np.float32(change.view), into, begin, table
    )
    received = np.empty((SUMS, made), np.float32)
    receive(table[:, :made], begin, np.int64(REACH), np.float32(change.turn), np.float32(ERROR), received)
    _add_received(shares, order, into, total, received, out)
