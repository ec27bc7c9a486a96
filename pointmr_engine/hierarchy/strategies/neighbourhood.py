"""Neighbourhood-based sampling (talk: the best strategy): keep a candidate, delete all it covers, until none is left.

The talk deletes in random order. Sweeping over the surface instead, and keeping of a few candidates around the next
uncovered one that which covers most, takes a sixth fewer samples for the same covering radius
(benchmarks/oversampling.py).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.strategies.cells import neighbour_ranges, sort_into_cells
from pointmr_engine.hierarchy.strategies.selection import Selection, seed_key, shuffle, uniform, uniforms
from pointmr_engine.numerics.pointers import pointer_f32, pointer_i32

_SWEEP = 64.0  # steps of a spacing in which candidates are swept over
_TRIES = 4  # measured: 3 take 1 % more samples, 6 and more no fewer


def select(
    position: np.ndarray, area: np.ndarray, spacing: float, seed: int, order: str = "sweep"
) -> Selection:
    """Samples more than `spacing` apart, with all candidates within `spacing` of one; each belongs to the nearest.

    order: "sweep", along a random direction, or "random". In the plane both take at most 3.63 times the area (packing),
    on average 2.19 from dense candidates in random order. Linear in their number: each sample, and each candidate that
    is tried, visits the candidates of the 27 cells around it once.
    """
    n = len(position)
    cells = sort_into_cells(position, spacing * (1.0 + 1e-6))
    # in the order of the cells: what is visited together lies together; and by a power of two about as large as the
    # spacing, so that its square is a float32 as exact
    scale = float(np.ldexp(1.0, -int(np.frexp(spacing)[1])))
    place, weight, cell = np.empty((3, n), np.float32), np.empty(n, np.float32), np.empty(n, np.int32)
    _by_cell(cells.start, cells.member, position, area, np.float32(scale), place, weight, cell)
    turn, tries = np.arange(n, dtype=np.int32), 1
    if order == "random":
        shuffle(seed_key(seed, 4), turn)
    elif n:
        direction = np.empty(3)
        uniforms(seed_key(seed, 5), direction)
        _sweep(place, direction - 0.5, scale * spacing / _SWEEP, turn)
        tries = _TRIES
    owner, chosen = np.full(n, -1, np.int32), np.empty(n, np.int32)
    count = _eliminate(
        neighbour_ranges(cells),
        cell,
        place,
        weight,
        turn,
        np.float32((scale * spacing) ** 2),
        np.int64(tries),
        seed_key(seed, 6),
        np.full(n, np.inf, np.float32),
        owner,
        chosen,
    )
    chosen = cells.member[chosen[:count]]
    result = np.empty(n, np.int32)
    result[cells.member] = owner
    return Selection(position[chosen], chosen, result)


_jit = njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _by_cell(start, member, position, area, scale, place, weight, cell):
    """Scaled places (3, C), areas and cells of the candidates in the order of the cells."""
    for k in range(len(start) - 1):
        for m in range(start[k], start[k + 1]):
            c = member[m]
            for axis in range(3):
                place[axis, m] = scale * position[c, axis]
            weight[m] = area[c]
            cell[m] = k


@_jit
def _along(place, direction, m):
    return (
        direction[0] * np.float64(place[0, m])
        + direction[1] * np.float64(place[1, m])
        + direction[2] * np.float64(place[2, m])
    )


@_jit
def _sweep(place, direction, step, turn):
    """Write the order along a direction to turn (C,) int32, to within `step`, and among equals as they come.

    Counted, not compared: in a quarter of a sort's time.
    """
    n = len(turn)
    low, high = np.inf, -np.inf
    for m in range(n):
        d = _along(place, direction, m)
        low, high = min(low, d), max(high, d)
    step = max(step, (high - low) / (4.0 * n))
    start = np.zeros(int((high - low) / step) + 2, np.int32)
    for m in range(n):
        start[int((_along(place, direction, m) - low) / step) + 1] += 1
    for k in range(1, len(start)):
        start[k] += start[k - 1]
    for m in range(n):
        k = int((_along(place, direction, m) - low) / step)
        turn[start[k]] = m
        start[k] += 1


# What follows goes through the nine ranges around a candidate by address: where an array's index is checked, compilers
# do not look at many candidates at once.


@_jit
def _rows(place):
    """Addresses of the rows x, y, z of `place`, as pointers."""
    first, row = np.int64(place.ctypes.data), np.int64(4 * place.shape[1])
    return pointer_f32(first), pointer_f32(first + row), pointer_f32(first + 2 * row)


@_jit
def _gains(x, y, z, best, radius2, m, cx, cy, cz):
    """Whether candidate m is uncovered and within the radius of a place."""
    dx, dy, dz = x[m] - cx, y[m] - cy, z[m] - cz
    return (best[m] > radius2) & (dx * dx + dy * dy + dz * dz <= radius2)


@_jit
def _count(first, end, x, y, z, best, radius2, c):
    """How many of first..end candidate c would gain."""
    cx, cy, cz = x[c], y[c], z[c]
    count = np.int32(0)
    for m in range(first, end):
        count += np.int32(_gains(x, y, z, best, radius2, m, cx, cy, cz))
    return np.int64(count)


@_jit
def _which(first, end, x, y, z, best, radius2, c, number):
    """The one of those that `_count` counts that has this number."""
    cx, cy, cz = x[c], y[c], z[c]
    for m in range(first, end):
        if _gains(x, y, z, best, radius2, m, cx, cy, cz):
            if number == 0:
                return m
            number -= 1
    return c


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc"})
def _gain(first, end, x, y, z, weight, best, radius2, c):
    """Sum of the weights of those of first..end that candidate c would gain."""
    cx, cy, cz = x[c], y[c], z[c]
    gain = np.float32(0)
    for m in range(first, end):
        gain += weight[m] if _gains(x, y, z, best, radius2, m, cx, cy, cz) else np.float32(0)
    return gain


@_jit
def _cover(first, end, x, y, z, best, owner, c, sample):
    """Give those of first..end that lie nearer to candidate c than to any sample before it to `sample`."""
    cx, cy, cz = x[c], y[c], z[c]
    for m in range(first, end):
        dx, dy, dz = x[m] - cx, y[m] - cy, z[m] - cz
        d2, before = dx * dx + dy * dy + dz * dz, best[m]
        owner[m] = sample if d2 < before else owner[m]
        best[m] = d2 if d2 < before else before


@_jit
def _best_near(ranges, cell, x, y, z, weight, best, radius2, c, tries, key, counts):
    """Of `tries` of the uncovered candidates within the radius of c that which covers most; counts: room for 9."""
    around = ranges[cell[c]]
    total = np.int64(0)
    for row in range(9):
        counts[row] = _count(np.int64(around[row, 0]), np.int64(around[row, 1]), x, y, z, best, radius2, c)
        total += counts[row]
    if total < 2:
        return c
    tries = min(tries, total)
    chosen, most = c, np.float32(-1)
    row, before = 0, np.int64(0)
    for k in range(tries):
        # one of each of `tries` equal parts of them: numbers that rise
        number = min(np.int64((k + uniform(key, c * 8 + k)) / tries * total), total - 1) - before
        while number >= counts[row]:
            number -= counts[row]
            before += counts[row]
            row += 1
        tried = _which(np.int64(around[row, 0]), np.int64(around[row, 1]), x, y, z, best, radius2, c, number)
        gain = np.float32(0)
        other = ranges[cell[tried]]
        for n in range(9):
            gain += _gain(np.int64(other[n, 0]), np.int64(other[n, 1]), x, y, z, weight, best, radius2, tried)
        if gain > most:
            chosen, most = tried, gain
    return chosen


@_jit
def _eliminate(ranges, cell, place, weights, turn, radius2, tries, key, nearest, owners, chosen):
    """Write the samples to chosen, and to owners the nearest; how many. nearest (C,): squared distance to it, at first
    inf.

    All arrays are in the order of the cells; turn: the order in which the candidates are looked at.
    """
    x, y, z = _rows(place)
    weight, best = pointer_f32(np.int64(weights.ctypes.data)), pointer_f32(np.int64(nearest.ctypes.data))
    owner = pointer_i32(np.int64(owners.ctypes.data))
    found = np.empty(9, np.int64)
    count = 0
    for k in range(len(turn)):
        c = np.int64(turn[k])
        if best[c] <= radius2:
            continue
        if tries > 1:
            c = _best_near(ranges, cell, x, y, z, weight, best, radius2, c, tries, key, found)
        around = ranges[cell[c]]
        for row in range(9):
            _cover(
                np.int64(around[row, 0]), np.int64(around[row, 1]), x, y, z, best, owner, c, np.int32(count)
            )
        chosen[count] = c
        count += 1
    return count
