"""Veils: surfaces on the way of a shadow ray that may let light through, noted by one walk along the whole ray.

A walk that looks for what blocks a ray passes the ray's other surfaces anyway. The nearest of them are kept in a list,
from which they are taken one after the other, nearest first; the ray is walked again only behind a list that was full.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import device

NOTED = 8  # surfaces of a ray that one walk keeps
NONE, WALK = -1, -2


class Veils(NamedTuple):
    """Lists of N rays; a list stays where it is when its ray moves to another row."""

    row: np.ndarray  # (N,) int64 per ray: its list
    count: np.ndarray  # (N,) int64 per list: surfaces noted; K: there may be more behind; -1: not walked yet
    farthest: np.ndarray  # (N,) float64 of these, where the list is full; else inf
    t: np.ndarray  # (N, K) float64 along the ray; inf: taken
    triangle: np.ndarray  # (N, K) int32; weights, part: as in Hits
    weights: np.ndarray  # (N, K, 2) float32
    part: np.ndarray  # (N, K) int32
    length: np.ndarray  # (N, K) int32: levels of the chain
    chain: np.ndarray  # (N, K, L, 2) int32: instance records walked down, and their batches


def allocate_veils(n: int, levels: int, noted: int = NOTED) -> Veils:
    """Lists of up to `noted` surfaces for n rays, none of them walked, through groups nested `levels` deep."""
    i, f, shape = np.int64, np.float64, (n, noted)
    return Veils(
        np.arange(n, dtype=i), np.full(n, -1, i), np.full(n, np.inf), np.empty(shape, f), np.empty(shape, np.int32),
        np.empty((*shape, 2), np.float32), np.empty(shape, np.int32), np.empty(shape, np.int32),
        np.empty((*shape, levels, 2), np.int32),
    )  # fmt: skip


def begin_veils(veils: Veils, count: int) -> None:
    """Rays 0..count are others: each has the list of its own row, which is not walked yet."""
    veils.row[:count] = np.arange(count)
    veils.count[:count] = -1


@device
def note(veils, ray, t, triangle, u, v, part, chain, length):
    """Keep a surface of a ray; of more than the list takes, the nearest. Returns the farthest that matters from now on.

    chain (L, 2) int64, `length` of it: as in Veils.
    """
    row, most = veils.row[ray], np.int64(veils.t.shape[1])
    at = veils.count[row]
    if at < most:
        veils.count[row] = at + 1
    else:
        at = np.int64(0)
        for k in range(1, most):
            if veils.t[row, k] > veils.t[row, at]:
                at = np.int64(k)
        if not t < veils.t[row, at]:
            return veils.farthest[row]
    veils.t[row, at] = t
    veils.triangle[row, at] = triangle
    veils.weights[row, at, 0], veils.weights[row, at, 1] = u, v
    veils.part[row, at] = part
    veils.length[row, at] = length
    for k in range(length):
        veils.chain[row, at, k, 0] = chain[k, 0]
        veils.chain[row, at, k, 1] = chain[k, 1]
    if veils.count[row] == most:
        far = veils.t[row, 0]
        for k in range(1, most):
            far = max(far, veils.t[row, k])
        veils.farthest[row] = far
    return veils.farthest[row]


@device
def nearest_veil(veils, ray):
    """(list, place) of the nearest surface that a ray's list still has.

    The place is NONE where the list is complete and has no more, WALK where the ray must be walked for them.
    """
    row = veils.row[ray]
    if veils.count[row] < 0:
        return row, np.int64(WALK)
    best, least = np.int64(NONE), np.inf
    for k in range(veils.count[row]):
        if veils.t[row, k] < least:
            best, least = np.int64(k), veils.t[row, k]
    if best < 0 and veils.count[row] == veils.t.shape[1]:
        best = np.int64(WALK)
    return row, best


@device
def forget(veils, ray):
    """Empty a ray's list, for a walk to fill."""
    row = veils.row[ray]
    veils.count[row], veils.farthest[row] = 0, np.inf
