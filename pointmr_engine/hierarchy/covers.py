"""Boxes that stand for a group when its placements are bounded: a few small ones, not one large one.

The box of a turned box is up to twice as large as what is in it, and so at every level of nesting. Of the boxes that
together hold a group's surface, each turned by itself, the union stays tight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.bvh_build import EMPTY

BOXES = 64  # of a group
ROOM = 1 << 22  # boxes of all placements of a group that may be looked at, but for FEWEST of each
FEWEST = 8
OPENED = 8  # items of a group that are opened one by one, rather than by the nodes above them
BITS = 10  # of a place along an axis


class Covers(NamedTuple):
    """Rows first..first + count of the boxes are a group's, in its own space. count is 0 where there is nothing."""

    first: np.ndarray  # (G,) int64
    count: np.ndarray  # (G,) int64
    middle: np.ndarray  # (K, 3) float64
    half: np.ndarray  # (K, 3) float64


def allocate_covers(groups: int) -> Covers:
    """Room for all groups' boxes; untouched pages cost nothing."""
    rows = groups * BOXES
    return Covers(
        np.zeros(groups, np.int64),
        np.zeros(groups, np.int64),
        np.empty((rows, 3)),
        np.empty((rows, 3)),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def placed_box(m, at, covers, group, box):
    """box (6,): lower and upper corner of a group's cover under the transform at m[at]."""
    for k in range(3):
        x, y, z, shift = m[at + 4 * k], m[at + 4 * k + 1], m[at + 4 * k + 2], m[at + 4 * k + 3]
        ax, ay, az = abs(x), abs(y), abs(z)
        low, high = np.inf, -np.inf
        for row in range(covers.first[group], covers.first[group] + covers.count[group]):
            middle = x * covers.middle[row, 0] + y * covers.middle[row, 1] + z * covers.middle[row, 2]
            half = ax * covers.half[row, 0] + ay * covers.half[row, 1] + az * covers.half[row, 2]
            low = min(low, middle - half)
            high = max(high, middle + half)
        box[k], box[3 + k] = low + shift, high + shift


@njit(cache=True, nogil=True, error_model="numpy")
def top_boxes(boxes, children, root, center, limit, out):
    """out (limit, 6): middles and halves of boxes that hold an eight-wide hierarchy, largest opened first; how many.

    center (3,): of the hierarchy's coordinates.
    """
    of = np.empty(limit, np.int64)  # the node that a box is of, negative: of a leaf
    size = np.empty(limit)
    n = np.int64(0)
    node = np.int64(root)
    while True:
        for c in range(8):
            child = np.int64(children[node, c])
            if child == EMPTY:
                continue
            area, before = 0.0, 0.0
            for k in range(3):
                low, high = np.float64(boxes[node, 8 * k + c]), np.float64(boxes[node, 24 + 8 * k + c])
                out[n, k] = center[k] + 0.5 * (low + high)
                out[n, 3 + k] = 0.5 * (high - low)
                area += out[n, 3 + k] * before
                before = out[n, 3 + k]
            area += out[n, 5] * out[n, 3]
            of[n], size[n] = child, area
            n += 1
        if n + 7 > limit:
            return n
        largest = np.int64(-1)
        for i in range(n):
            if of[i] >= 0 and (largest < 0 or size[i] > size[largest]):
                largest = np.int64(i)
        if largest < 0:
            return n
        node = of[largest]
        n -= 1
        of[largest], size[largest] = of[n], size[n]
        for k in range(6):
            out[largest, k] = out[n, k]


def turned(rows: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Boxes (K, 6), middles and halves, that hold boxes `rows` under a transform (3, 4)."""
    out = np.empty_like(rows)
    out[:, :3] = (matrix[:, :3] * rows[:, None, :3]).sum(2) + matrix[:, 3]
    out[:, 3:] = (np.abs(matrix[:, :3]) * rows[:, None, 3:]).sum(2)
    return out


def fewer(rows: np.ndarray, limit: int) -> np.ndarray:
    """At most `limit` boxes (K, 6) that hold boxes `rows`: runs of neighbours along a Morton curve become one."""
    if len(rows) <= limit:
        return rows
    low, high = rows[:, :3] - rows[:, 3:], rows[:, :3] + rows[:, 3:]
    extent = max(float((high.max(0) - low.min(0)).max()), 1e-300)
    cell = ((rows[:, :3] - low.min(0)) * (0.999 * 2**BITS / extent)).astype(np.int64)
    bit = np.arange(BITS)
    key = (((cell[:, :, None] >> bit) & 1) << (3 * bit + np.arange(3)[:, None])).sum((1, 2))
    order = np.argsort(key, kind="stable")
    first = np.arange(limit) * len(rows) // limit
    low, high = np.minimum.reduceat(low[order], first), np.maximum.reduceat(high[order], first)
    return np.concatenate([(low + high) / 2, (high - low) / 2], 1)
