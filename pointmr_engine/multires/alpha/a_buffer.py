"""Visibility by alpha: lists of what each cell of a tile shows, by coverages and not by subpixels (talk: ray A-buffer).

A cell weighs what it sees by a Gaussian. Fragments whose ranges of depth overlap are one surface, and their coverages
add (the areas of surfels and triangles are exact, so that a surface's sum to 1); surfaces hide each other as if they
were independent of each other, front to back. Where one faces the other way than what is before it, both are taken for
the sides of one body: their edges lie behind each other, and it covers what the larger covers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.drawing.subpixels import BLOCK, EMPTY
from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.simd import WIDTH

ROOM = 24  # fragments of a cell; of more, those that are nearest to each other become one
LEAST = 1.0 / 512.0  # coverage, and weight of a surface, that counts
FULL = 1.0 / 64.0  # a cell that lets less through is full
LINES = 6  # along which triangles are exact in a row of cells
CHECK = 0.95  # coverage after which a cell may be full
APART = 0.35  # cells: surfaces no farther apart in depth are one
# surfels that cover more grow, for their sums are right to some per cent only: what is beyond ...
WHOLE = 0.7
FIRM = 1.5  # ... counts so much more
# of a fragment: nearness at the cell's middle, half its range, coverage, place in the tile, 1 for surfels that are
# surfaces, and which way it faces: 1, -1, 0 for clumps
NEAR, HALF, COVER, AT_X, AT_Y, SOLID, SIDE = range(7)
COLUMNS = 7


class Layers(NamedTuple):
    """A tile's cells. The first five are what drawing.subpixels.Target has, for the walk to see what is hidden."""

    depth: np.ndarray  # (H, W + 8) float32 nearness of the farthest that matters in a full cell; 0: not full
    ids: np.ndarray  # (H, W + 8) int32: number of a cell's last fragment, EMPTY: none
    farthest: np.ndarray
    stale: np.ndarray
    address: np.ndarray
    entry: np.ndarray  # (H, W, ROOM) int32
    part: np.ndarray  # (H, W, ROOM, COLUMNS) float32
    load: np.ndarray  # (H, W) float32: coverage since the cell was last looked through
    apart: np.ndarray  # (2,) float32: nearness between what is one surface, in parts of it, and as it is
    lines: np.ndarray  # (2, LINES) float64 to work in


def allocate_layers(width: int, height: int, apart: tuple[float, float]) -> Layers:
    """Lists for width x height cells, rounded up to whole blocks."""
    width, height = -(-width // BLOCK) * BLOCK, -(-height // BLOCK) * BLOCK
    depth = np.zeros((height, width + WIDTH), np.float32)
    ids = np.full((height, width + WIDTH), EMPTY, np.int32)
    blocks = (height // BLOCK, width // BLOCK)
    f = np.float32
    return Layers(
        depth, ids, np.zeros(blocks, f), np.zeros(blocks, np.uint8),
        np.array([a.ctypes.data for a in (depth, ids)], np.uint64), np.empty((height, width, ROOM), np.int32),
        np.empty((height, width, ROOM, COLUMNS), f), np.zeros((height, width), f), np.array(apart, f),
        np.zeros((2, LINES)),
    )  # fmt: skip


@device
def _move(target, j, i, source, to):
    target.entry[j, i, to] = target.entry[j, i, source]
    for c in range(COLUMNS):
        target.part[j, i, to, c] = target.part[j, i, source, c]


@device
def sort_cell(target, j, i, n):
    """Put a cell's n fragments in order, the nearest first."""
    part = target.part
    for k in range(1, n):
        if part[j, i, k, NEAR] <= part[j, i, k - 1, NEAR]:
            continue
        entry = target.entry[j, i, k]
        a, b, c = part[j, i, k, 0], part[j, i, k, 1], part[j, i, k, 2]
        d, e, f, g = part[j, i, k, 3], part[j, i, k, 4], part[j, i, k, 5], part[j, i, k, 6]
        m = k
        while m > 0 and part[j, i, m - 1, NEAR] < a:
            _move(target, j, i, m - 1, m)
            m -= 1
        target.entry[j, i, m] = entry
        part[j, i, m, 0], part[j, i, m, 1], part[j, i, m, 2] = a, b, c
        part[j, i, m, 3], part[j, i, m, 4], part[j, i, m, 5], part[j, i, m, 6] = d, e, f, g


@device
def next_surface(target, j, i, first, n):
    """The surface that begins with a cell's fragment `first` of n, in order: (end, coverage, farthest nearness, side,
    parts).

    side: 1 or -1, which way most of it faces, 0 if it is of clumps. parts: by how much to multiply coverages of what
    faces ways 1 and -1; the rest is hidden by the other side.
    """
    part = target.part
    total = solid = near = half = front = back = nearer = 0.0
    k = first
    while k < n:
        w, h, c = (
            np.float64(part[j, i, k, NEAR]),
            np.float64(part[j, i, k, HALF]),
            np.float64(part[j, i, k, COVER]),
        )
        if k > first and (near - total * w) > half + total * h:
            break
        total += c
        near += c * w
        half += c * h
        solid += c * np.float64(part[j, i, k, SOLID])
        side = part[j, i, k, SIDE]
        if side > 0:
            front += c
        elif side < 0:
            back += c
        if nearer == 0.0:
            nearer = np.float64(side)
        k += 1
    one, other = 1.0, 1.0
    if front > 0.0 and back > 0.0:
        if nearer > 0.0:
            other = max(back - front, 0.0) / back
        else:
            one = max(front - back, 0.0) / front
    cover = total - front - back + one * front + other * back
    cover += FIRM * max(cover - WHOLE, 0.0) * solid / total
    side = 0.0
    if front + back > 0.5 * total:
        side = 1.0 if front > back else -1.0
    return k, min(cover, 1.0), (near - half) / total, side, one, other


@device
def put_behind(clear, cover, side, before, last, last_side):
    """What a surface shows behind another: (share of the cell, what is clear then).

    clear: in front of it; before: in front of the surface before it, whose coverage and side are last, last_side.
    """
    if side * last_side < 0.0:
        rest = before * (1.0 - max(cover, last))
        return clear - rest, rest
    return clear * cover, clear * (1.0 - cover)


@device
def _look_through(target, j, i):
    """Sort a cell, drop what is hidden in it, and note whether it is full; returns the number of its fragments."""
    n = np.int64(target.ids[j, i]) + 1
    sort_cell(target, j, i, n)
    clear, k = 1.0, np.int64(0)
    before, last, last_side = 1.0, 0.0, 0.0
    target.load[j, i] = np.float32(0.5)
    while k < n:
        k, cover, far, side, _, _ = next_surface(target, j, i, k, n)
        front = clear
        _, clear = put_behind(clear, cover, side, before, last, last_side)
        before, last, last_side = front, cover, side
        if clear < FULL:
            target.depth[j, i] = max(np.float32(far), target.depth[j, i])
            target.load[j, i] = np.float32(0)
            n = k
    target.ids[j, i] = n - 1
    return n


@device
def _make_room(target, j, i, n):
    """Join those of a cell's n fragments, in order, that are nearest to each other; returns how many are left."""
    part = target.part
    limit = np.float32(0.25) * (part[j, i, 0, NEAR] - part[j, i, n - 1, NEAR]) / np.float32(n - 1)
    enough = n - n // 4
    for attempt in range(3):  # farther apart the second time, and the third time whichever way they face
        k = to = np.int64(0)
        while k < n:
            if k != to:
                _move(target, j, i, k, to)
            k += 1
            if k < n and part[j, i, to, NEAR] - part[j, i, k, NEAR] <= limit:
                if attempt == 2 or part[j, i, to, SIDE] == part[j, i, k, SIDE]:
                    _join(target, j, i, to, k)
                    k += 1
            to += 1
        n = to
        if n <= enough:
            break
        limit *= np.float32(4)
    return min(n, ROOM - 1)


@device
def _join(target, j, i, k, m):
    """Add a cell's fragment m to its fragment k."""
    part = target.part
    c, d = part[j, i, k, COVER], part[j, i, m, COVER]
    near = (c * part[j, i, k, NEAR] + d * part[j, i, m, NEAR]) / (c + d)
    half = max(part[j, i, k, HALF], part[j, i, m, HALF])
    if d > c:
        _move(target, j, i, m, k)
    part[j, i, k, NEAR], part[j, i, k, HALF], part[j, i, k, COVER] = near, half, c + d


@device
def insert(target, j, i, entry, near, half, cover, x, y, solid, side):
    """Put a fragment into a cell's list; False: it is hidden."""
    near = np.float32(near)
    half = np.float32(half) + np.float32(0.5) * (target.apart[0] * near + target.apart[1])
    if near + half <= target.depth[j, i] or not near > np.float32(0):
        return False
    n = np.int64(target.ids[j, i]) + 1
    if n == 0:
        target.load[j, i] = np.float32(0)
    if n == ROOM:
        n = _look_through(target, j, i)
        if n == ROOM:
            n = _make_room(target, j, i, n)
    target.entry[j, i, n] = entry
    part = target.part
    part[j, i, n, NEAR], part[j, i, n, HALF], part[j, i, n, COVER] = near, half, min(cover, 1.0)
    part[j, i, n, AT_X] = min(max(x, i + 0.05), i + 0.95)
    part[j, i, n, AT_Y] = min(max(y, j + 0.05), j + 0.95)
    part[j, i, n, SOLID], part[j, i, n, SIDE] = solid, side
    target.ids[j, i] = n
    target.load[j, i] += np.float32(cover)
    if target.load[j, i] >= np.float32(CHECK):
        _look_through(target, j, i)
    return True
