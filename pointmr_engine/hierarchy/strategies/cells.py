"""Cells: candidates sorted into the occupied cells of a cubic grid, so that neighbours lie in few contiguous ranges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.numerics.jit import device
from pointmr_engine.scene.errors import SceneError

_jit = njit(cache=True, nogil=True, error_model="numpy")

BITS = 21  # a key holds three cell coordinates of 21 bits
_LIMIT = 2**BITS - 4


class Cells(NamedTuple):
    """C candidates in M occupied cells, which are numbered by z, then y, then x."""

    cell: np.ndarray  # (C,) int32, cell of each candidate
    start: np.ndarray  # (M + 1,) int32: cell k holds the candidates member[start[k] : start[k + 1]]
    member: np.ndarray  # (C,) int32, in rising order in each cell
    key: np.ndarray  # (M,) uint64, the cells' packed coordinates, rising
    origin: np.ndarray  # (3,) float64, corner of cell (0, 0, 0)
    side: float


def sort_into_cells(position: np.ndarray, side: float, shift: np.ndarray | None = None) -> Cells:
    """Sort position (C, 3) float32 into cells of a side; shift (3,) in [0, 1) moves the grid by parts of a cell.

    Raises SceneError if the side is so small against the extent that float32 positions could not tell the cells apart.
    """
    n = len(position)
    low, high = np.zeros(3, np.float32), np.zeros(3, np.float32)
    for k in range(3 if n else 0):  # numpy takes ten times as long along the first axis
        low[k], high[k] = position[:, k].min(), position[:, k].max()
    origin = low.astype(np.float64) - side * (2.0 + (np.zeros(3) if shift is None else shift))
    if (high.astype(np.float64) - origin).max() / side > _LIMIT:
        raise SceneError(f"a spacing of {side:g} is too fine for points {(high - low).max():g} apart")
    size = 64
    while size < 2 * n:
        size *= 2
    cell = np.empty(n, np.int32)
    key = np.empty(n, np.uint64)
    slot_key = np.zeros(size, np.uint64)  # hash table: key + 1, or 0 where it is empty
    slot_cell = np.empty(size, np.int32)
    count = _number(position, origin, 1.0 / side, cell, key, slot_key, slot_cell)
    order = np.argsort(key[:count])  # keys differ: any sort gives the same
    rank = np.empty(count, np.int32)
    rank[order] = np.arange(count, dtype=np.int32)
    cell = rank[cell]
    start = np.zeros(count + 1, np.int32)
    member = np.empty(n, np.int32)
    _group(cell, start, member)
    return Cells(cell, start, member, key[order], origin, float(side))


@device
def _slot(key, mask):
    """Where the search for a key begins: cells of one 2x2x2 block lie side by side, blocks anywhere."""
    one = np.uint64(1)
    block = key & ~(one | (one << np.uint64(BITS)) | (one << np.uint64(2 * BITS)))
    within = (
        (key & one)
        | ((key >> np.uint64(BITS - 1)) & np.uint64(2))
        | ((key >> np.uint64(2 * BITS - 2)) & np.uint64(4))
    )
    h = block * np.uint64(0x9E3779B97F4A7C15)
    h ^= h >> np.uint64(32)
    h = h * np.uint64(0xD1B54A32D192ED03)
    h ^= h >> np.uint64(29)
    return ((h << np.uint64(3)) | within) & mask


@_jit
def _number(position, origin, inverse, cell, key, slot_key, slot_cell):
    mask = np.uint64(len(slot_key) - 1)
    one = np.uint64(1)
    count = 0
    last, last_cell = np.uint64(0), 0  # neighbours in the array mostly share a cell
    for c in range(len(position)):
        x = np.uint64(np.int64((position[c, 0] - origin[0]) * inverse))
        y = np.uint64(np.int64((position[c, 1] - origin[1]) * inverse))
        z = np.uint64(np.int64((position[c, 2] - origin[2]) * inverse))
        k = (((z << np.uint64(BITS)) | y) << np.uint64(BITS)) | x
        if k + one != last:
            slot = _slot(k, mask)
            while slot_key[slot] != 0 and slot_key[slot] != k + one:
                slot = (slot + one) & mask
            if slot_key[slot] == 0:
                slot_key[slot] = k + one
                slot_cell[slot] = count
                key[count] = k
                count += 1
            last, last_cell = k + one, slot_cell[slot]
        cell[c] = last_cell
    return count


@_jit
def _group(cell, start, member):
    for c in range(len(cell)):
        start[cell[c] + 1] += 1
    for k in range(1, len(start)):
        start[k] += start[k - 1]
    # `start` runs ahead while the members are placed, and is set back after
    for c in range(len(cell)):
        member[start[cell[c]]] = c
        start[cell[c]] += 1
    for k in range(len(start) - 1, 0, -1):
        start[k] = start[k - 1]
    start[0] = 0


def neighbour_ranges(cells: Cells) -> np.ndarray:
    """(M, 9, 2) int32: the members of a cell and the 26 around it, as ranges of `member`, one per row along x."""
    ranges = np.empty((len(cells.key), 9, 2), np.int32)
    _ranges(cells.key, cells.start, ranges)
    return ranges


@_jit
def _ranges(key, start, ranges):
    one = np.uint64(1)
    for row in range(9):
        dy, dz = np.uint64(row % 3), np.uint64(row // 3)
        first = 0
        for k in range(len(key)):
            # the cell at x - 1 in this row; as keys rise, so does it: one sweep over the keys finds all
            want = key[k] + (((dz << np.uint64(BITS)) + dy) << np.uint64(BITS))
            want -= (((one << np.uint64(BITS)) + one) << np.uint64(BITS)) + one
            while first < len(key) and key[first] < want:
                first += 1
            last = first
            while last < len(key) and key[last] <= want + np.uint64(2):
                last += 1
            ranges[k, row, 0] = start[first]
            ranges[k, row, 1] = start[last]
