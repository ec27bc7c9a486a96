"""The dynamic form of distribution lists: an octree with area sums in its nodes, for scenes that change.

Items (triangles or instances) are inserted, deleted and drawn in O(h), h the height of the tree; nothing is ever
rebuilt. An item goes down to the level whose cells fit its size, or stays higher, in a leaf that has room. Sums are
taken anew from the few things below each node on the way up, so that they do not drift.
Talk: "Dynamic updates (insert, delete triangles): O(h)".
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.hierarchy.dynamic_nodes import (
    ROOM,
    Items,
    Nodes,
    delete_many,
    insert_many,
    new_node,
    sample_many,
)
from pointmr_engine.scene.errors import SceneError


class DynamicOctree:
    """A growing and shrinking set of items with boxes and areas."""

    def __init__(self) -> None:
        self._nodes = _grown(Nodes, None, 2 * ROOM)
        self._items = _grown(Items, None, 1024)
        # root, free node, nodes used, free item, items used, items there, nodes touched
        self._state = np.array([0, -1, 0, -1, 0, 0, 0], np.int64)
        self._cell = np.array([0.0, 0.0, 0.0, -1.0])  # centre and side of the root's cell; -1: nothing yet
        new_node(self._nodes, self._state, np.int64(-1), np.int64(0), np.int64(-1))

    def __len__(self) -> int:
        return int(self._state[5])

    @property
    def nodes(self) -> Nodes:
        """The tree, for walks; its arrays are replaced when they grow."""
        return self._nodes

    @property
    def items(self) -> Items:
        """The items, by number; replaced when they grow."""
        return self._items

    @property
    def root(self) -> int:
        """Row of the root in `nodes`."""
        return int(self._state[0])

    @property
    def area(self) -> float:
        """Area of all items."""
        return float(self._nodes.area[self._state[0]])

    @property
    def touched(self) -> int:
        """Nodes read or changed by the last call."""
        return int(self._state[6])

    def insert(self, rows: np.ndarray, areas: np.ndarray, boxes: np.ndarray) -> np.ndarray:
        """Insert N items; returns their numbers (N,) int32. O(h) each.

        rows (N, 2) int32, kept for the caller; areas (N,) float64 > 0; boxes (N, 6) float64: lower, upper.
        Raises SceneError for an item without a finite box or area, before anything is changed.
        """
        rows = np.ascontiguousarray(rows, np.int32).reshape(-1, 2)
        areas = np.ascontiguousarray(areas, np.float64).reshape(-1)
        boxes = np.ascontiguousarray(boxes, np.float64).reshape(-1, 6)
        if not len(rows) == len(areas) == len(boxes):
            raise SceneError(f"{len(rows)} items with {len(areas)} areas and {len(boxes)} boxes")
        wrong = ~(np.isfinite(boxes).all(1) & np.isfinite(areas) & (areas > 0.0))
        wrong |= (boxes[:, :3] > boxes[:, 3:]).any(1)
        if wrong.any():
            bad = int(np.argmax(wrong))
            raise SceneError(
                f"item {rows[bad].tolist()}: area {areas[bad]} or box {boxes[bad].tolist()} is not usable"
            )
        numbers = np.empty(len(rows), np.int32)
        done = np.int64(0)
        self._state[6] = 0
        while done < len(rows):
            done = insert_many(
                self._nodes, self._items, self._state, self._cell, rows, areas, boxes, numbers, done
            )
            if done < len(rows):
                if self._state[2] + ROOM > len(self._nodes.area):
                    self._nodes = _grown(Nodes, self._nodes, 2 * len(self._nodes.area))
                if self._state[4] + 1 > len(self._items.area):
                    self._items = _grown(Items, self._items, 2 * len(self._items.area))
        return numbers

    def delete(self, numbers: np.ndarray) -> None:
        """Delete items by number. O(h) each. Raises SceneError if one is not there, before anything is changed."""
        numbers = np.ascontiguousarray(numbers, np.int32).reshape(-1)
        known = (numbers >= 0) & (numbers < self._state[4])
        known[known] = self._items.node[numbers[known]] >= 0
        if not known.all() or len(np.unique(numbers)) < len(numbers):
            raise SceneError("items to be deleted: one of them is not there, or named twice")
        self._state[6] = 0
        delete_many(self._nodes, self._items, self._state, numbers)

    def sample(self, us: np.ndarray) -> np.ndarray:
        """Numbers (N,) int32 of items chosen by area for us (N,) in [0, 1). O(h) each. Raises SceneError if empty."""
        if not self._state[5]:
            raise SceneError("an empty octree cannot be sampled")
        us = np.ascontiguousarray(us, np.float64).reshape(-1)
        out = np.empty(len(us), np.int32)
        self._state[6] = 0
        sample_many(self._nodes, self._items, self._state, us, out)
        return out


_COLUMNS = {
    Nodes: (((9,), "i4"), ((8,), "i4"), ((), "i4"), ((), "i4"), ((), "i4"), ((), "f8"), ((6,), "f8")),
    Items: (((2,), "i4"), ((), "f8"), ((6,), "f8"), ((), "f8"), ((), "i4"), ((), "i4")),
}


def _grown(kind, old, capacity: int):
    new = kind(*(np.empty((capacity, *shape), dtype) for shape, dtype in _COLUMNS[kind]))
    if old is not None:
        for a, b in zip(old, new, strict=True):
            b[: len(a)] = a
    return new
