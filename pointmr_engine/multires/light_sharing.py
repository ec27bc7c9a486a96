"""Light that fragments share: each asks with few rays, and all hear the answers.

What the world sends to a surface, and what a rough lobe sees, changes slowly along the surface: by about as much as one
moves against the distance of what is met, and as the surface turns (the split-sphere model: Ward, Rubinstein, Clear
1988, "A Ray Tracing Solution for Diffuse Interreflection"); for a lobe, against its width. So fragments within a few
cones take the mean of what arrives at each other, as far as that model allows: all of it in the open, none of it in a
corner or in foliage. Fragments of one cone that are nearly alike do so as one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.fragments import cell_at
from pointmr_engine.numerics.jit import device, summed, uncounted
from pointmr_engine.shading.bsdf.layout import KIND_MASK, NORMAL, OREN_NAYAR, TRANSLUCENT, WEIGHT

REACH = 5  # cones: how far apart fragments share
NEIGHBOURHOOD = 2  # cones: how far apart what rays met tells how near things are
ERROR = 0.5  # of what arrives: change along the surface at which sharing ends
ALIKE = 0.2  # of it: fragments of a cone that differ by less receive the same
DIM = 1e-4  # reflectance below which a fragment has nothing to share

# Rows of the table of what fragments tell each other, by channel or axis: what rays about them met, place and normal in
# the world, how much they count, by channel, what arrives times that, the angle from which it does, and their cone.
NEARNESS, PLACE, FACING, HEARD, ARRIVED, WIDTH, AT_X, AT_Y = 0, 1, 4, 7, 10, 13, 14, 15
COLUMNS = 16


class Change(NamedTuple):
    """How fast light of a kind changes along a surface, of what arrives.

    turn: with the root of 1 less the cosine of normals (their angle over 1.4); view: with the angle by which the view
    turns.
    """

    turn: float
    view: float


# the split sphere has 1 for the turn of the world, but light from one side of it, or from lamps, makes more of bumps;
# mirrored, light turns twice as far, of which a half is what wires, scans and cars were measured to need
OF_WORLD, OF_LAMPS, OF_LOBE = Change(3.0, 0.0), Change(4.0, 0.0), Change(math.sqrt(2.0), 1.0)
# of the way against the distance of what a lobe's rays met: how much of what it sees changes
MOVE_OF_LOBE = 0.25


class Shares(NamedTuple):
    """What the F fragments of a tile received of one kind of light; world space."""

    light: np.ndarray  # (F, 3) float32, as the surface reflects it
    albedo: np.ndarray  # (F, 3) float32: what it reflects; 0: does not share
    position: np.ndarray  # (F, 3) float64
    normal: np.ndarray  # (F, 3) float32
    rays: np.ndarray  # (F,) float32: how many asked
    nearness: np.ndarray  # (F,) float32: sum of 1 / distance of what they met
    worth: np.ndarray  # (F,) float32: how much what arrived counts
    width: np.ndarray  # (F,) float32: angle from which light arrives, against a hemisphere's


def allocate_shares(n: int) -> Shares:
    """Room for n fragments, undefined."""
    f = np.float32
    return Shares(
        np.empty((n, 3), f),
        np.empty((n, 3), f),
        np.empty((n, 3)),
        np.empty((n, 3), f),
        np.empty(n, f),
        np.empty(n, f),
        np.empty(n, f),
        np.empty(n, f),
    )


@device
def clear_share(shares: Shares, row, x, y, z):
    """Row of a fragment at (x, y, z) that has nothing to share, and has received nothing."""
    shares.rays[row] = shares.nearness[row] = shares.worth[row] = shares.width[row] = np.float32(0)
    shares.position[row, 0], shares.position[row, 1], shares.position[row, 2] = x, y, z
    for c in range(3):
        shares.light[row, c] = shares.albedo[row, c] = shares.normal[row, c] = np.float32(0)


@device
def add_lobe(shares: Shares, row, passed, normal, rough):
    """A lobe that sends rays becomes part of what a fragment shares. passed: rgb of its albedo times throughput."""
    if shares.width[row] == 0 or 2.0 * rough < shares.width[row]:
        shares.width[row] = 2.0 * rough
        for c in range(3):
            shares.normal[row, c] = normal[c]
    for c in range(3):
        shares.albedo[row, c] += np.float32(passed[c])
    shares.worth[row] += np.float32(max(passed[0], passed[1], passed[2]))


@uncounted
def begin_shares(lobes, throughput, position, first, count, shares):
    """Rows first..first + count of `shares`: what the points 0..count reflect diffusely, nothing received yet.

    What reflects otherwise than plain diffuse surfaces, or lets light through, does not share.
    """
    for k in range(count):
        row = first + k
        clear_share(shares, row, position[k, 0], position[k, 1], position[k, 2])
        shares.width[row] = shares.worth[row] = np.float32(1)
        single = True
        normal = np.int64(-1)
        for j in range(np.int64(lobes.count[k])):
            base = lobes.kind[k, j] & KIND_MASK
            if base > TRANSLUCENT:
                continue
            if normal < 0:
                normal = np.int64(j)
            for c in range(3):
                single = single and lobes.data[k, j, NORMAL + c] == lobes.data[k, normal, NORMAL + c]
                shares.albedo[row, c] += throughput[k, c] * lobes.data[k, j, WEIGHT + c]
            single = single and base <= OREN_NAYAR
        for c in range(3):
            if normal >= 0:
                shares.normal[row, c] = lobes.data[k, normal, NORMAL + c]
            if not single:
                shares.albedo[row, c] = np.float32(0)


@uncounted
def count_lobe_rays(slot, triangle, t, closest, count, base, rays, near):
    """What rays of lobes met first, by their slots: paths 0..count of slots from `base` on, at t.

    closest (N,) float32: see `count_near`; rays, near (N,) float32.
    """
    for i in range(count):
        k = np.int64(slot[i]) - base
        if k >= 0:
            rays[k] += np.float32(1)
            if triangle[i] != -1:
                near[k] += np.float32(MOVE_OF_LOBE / max(t[i], closest[k]))


@uncounted
def count_near(source, triangle, t, closest, count, first, shares):
    """Shadow rays 0..count of the fragments first + source (N,): what each met, at t.

    closest (N,) float32 by source: metres, nearer than which nothing counts as being: light that changes within a cone
    differs from fragment to fragment anyhow, as in hair, and the pixel filter takes its mean.
    """
    for i in range(count):
        if triangle[i] != -1:
            k = np.int64(source[i])
            shares.nearness[first + k] += np.float32(1.0 / max(t[i], closest[k]))


@uncounted
def count_blocked(source, triangle, t, far, width, closest, count, first, shares):
    """Count the shadow rays 0..count of fragments first + source: how fast their light changes along the surface.

    far (N,) float64: how far away the lights are; width (N,) float64 by source: angle from which light comes, against a
    hemisphere's; closest: see `count_near`.
    """
    for i in range(count):
        k = np.int64(source[i])
        shares.rays[first + k] += np.float32(1)
        if triangle[i] != -1:
            shares.nearness[first + k] += np.float32(
                shares.width[first + k] / (max(t[i], closest[k]) * width[k])
            )
        elif far[i] > 0.0:  # what arrives falls off with the distance
            shares.nearness[first + k] += np.float32(1.0 / far[i])


@uncounted
def take_reflected(light, part, source, triangle, count, first, shares):
    """Move `part` (N, 3) of the light of shadow rays 0..count that nothing stops to the fragments that share it."""
    for i in range(count):
        row = first + np.int64(source[i])
        if triangle[i] == -1 and has_to_share(shares, row):
            for c in range(3):
                shares.light[row, c] += part[i, c]
                light[i, c] -= part[i, c]


@device
def has_to_share(shares: Shares, k):
    """Whether fragment k shares what it receives."""
    return max(shares.albedo[k, 0], shares.albedo[k, 1], shares.albedo[k, 2]) > 0.0


@uncounted
def take_light(radiance, before, first, count, shares):
    """Move what radiance (N, 3) has gained since `before` to the fragments first..first + count that share."""
    for k in range(count):
        row = first + k
        if has_to_share(shares, row):
            for c in range(3):
                shares.light[row, c] += radiance[k, c] - before[k, c]
                radiance[k, c] = before[k, c]


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
                    if change + abs(table[WIDTH, g] - width) < ALIKE * ERROR * width:
                        found = np.int64(g)
                        break
                into[s] = found
                if found == n:
                    n += 1
                    table[NEARNESS, found], table[WIDTH, found] = nearness, width
                    table[AT_X, found], table[AT_Y, found] = i, j
                    table[PLACE, found], table[PLACE + 1, found], table[PLACE + 2, found] = x, y, z
                    for c in range(3):
                        table[FACING + c, found] = shares.normal[k, c]
                        table[HEARD + c, found] = table[ARRIVED + c, found] = np.float32(0)
                for c in range(3):
                    if shares.albedo[k, c] > DIM:
                        table[HEARD + c, found] += shares.worth[k]
                        table[ARRIVED + c, found] += shares.worth[k] * (
                            shares.light[k, c] / shares.albedo[k, c]
                        )
        begin[j, columns] = n
    return n


@device
def _take_band(table, begin, low, high, row, column, own, band):
    """Copy rows of cones low..high of a table to `band`, column by column: cones side by side are one run of it.

    column (columns + 1,) int64: where columns begin; own (columns,): where those of `row` do.
    """
    n = np.int64(0)
    for i in range(len(own)):
        column[i] = n
        for q in range(low, high):
            if q == row:
                own[i] = n
            for s in range(begin[q, i], begin[q, i + 1]):
                for c in range(COLUMNS):
                    band[c, n] = table[c, s]
                n += 1
    column[len(own)] = n


@summed
def _received_about(band, first, end, s, falloff, turn, sums):
    """sums (6,) float32: weights and weighted light of the rows first..end of a band, as far as s shares theirs."""
    near = band[NEARNESS, s]
    px, py, pz = band[PLACE, s], band[PLACE + 1, s], band[PLACE + 2, s]
    nx, ny, nz = band[FACING, s], band[FACING + 1, s], band[FACING + 2, s]
    nothing, one = np.float32(0), np.float32(1)
    width = band[WIDTH, s]
    narrow = one / max(np.float32(ERROR) * width, np.float32(1e-12))
    u, v, w, r, g, b = nothing, nothing, nothing, nothing, nothing, nothing
    for k in range(end - first):
        t = first + np.uint64(k)
        dx, dy, dz = band[PLACE, t] - px, band[PLACE + 1, t] - py, band[PLACE + 2, t] - pz
        facing = band[FACING, t] * nx + band[FACING + 1, t] * ny + band[FACING + 2, t] * nz
        change = np.sqrt(dx * dx + dy * dy + dz * dz) * max(near, band[NEARNESS, t])
        change += turn * np.sqrt(max(one - facing, nothing))
        change += abs(band[WIDTH, t] - width)
        i, j = band[AT_X, t] - band[AT_X, s], band[AT_Y, t] - band[AT_Y, s]
        weight = max(one - change * narrow, nothing) * max(one - (i * i + j * j) * falloff, nothing)
        weight = one if t == s else weight
        u += weight * band[HEARD, t]
        v += weight * band[HEARD + 1, t]
        w += weight * band[HEARD + 2, t]
        r += weight * band[ARRIVED, t]
        g += weight * band[ARRIVED + 1, t]
        b += weight * band[ARRIVED + 2, t]
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = u, v, w, r, g, b


@uncounted
def _receive(table, begin, wide, turn, column, own, band, sums, received):
    """received (6, F) float32: what the rows of a table receive together, within `wide` cones; others: _take_band."""
    rows, columns = begin.shape[0], begin.shape[1] - 1
    falloff = np.float32(1.0 / (wide + 1.0) ** 2)
    for j in range(rows):
        _take_band(table, begin, max(j - wide, 0), min(j + wide + 1, rows), j, column, own, band)
        for i in range(columns):
            first, end = np.uint64(column[max(i - wide, 0)]), np.uint64(column[min(i + wide + 1, columns)])
            for s in range(begin[j, i], begin[j, i + 1]):
                _received_about(band, first, end, np.uint64(own[i] + s - begin[j, i]), falloff, turn, sums)
                for c in range(6):
                    received[c, s] = sums[c]


@uncounted
def _add_received(shares, order, into, total, received, out):
    """Add what the fragments order[0..total] reflect of what their rows `into` received to out (F, 3)."""
    for s in range(total):
        k, row = np.int64(order[s]), np.int64(into[s])
        for c in range(3):
            if received[c, row] > 0.0 and shares.albedo[k, c] > DIM:
                out[k, c] += shares.albedo[k, c] * received[3 + c, row] / received[c, row]
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
    most = int(np.convolve(begin[:, -1] - begin[:, 0], np.ones(2 * REACH + 1, np.int64)).max())
    received = np.empty((6, made), np.float32)
    _receive(
        table, begin, np.int64(REACH), np.float32(change.turn), np.empty(columns + 1, np.int64),
        np.empty(columns, np.int64), np.empty((COLUMNS, most), np.float32), np.empty(6, np.float32), received,
    )  # fmt: skip
    _add_received(shares, order, into, total, received, out)
