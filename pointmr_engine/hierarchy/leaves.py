"""What hierarchies are built over: boxes of triangles and of instances, and leaf blocks of triangles."""

from __future__ import annotations

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.bvh_build import NUMBER
from pointmr_engine.hierarchy.covers import (
    BOXES,
    FEWEST,
    OPENED,
    ROOM,
    allocate_covers,
    fewer,
    placed_box,
    top_boxes,
    turned,
)
from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.numerics.pointers import pointer_f64
from pointmr_engine.numerics.transforms import is_singular
from pointmr_engine.scene.group import HOLDOUT, Group, Instances

LIMIT = np.float32(1e12)


@njit(cache=True, nogil=True, error_model="numpy")
def _triangle_boxes(positions, triangles, prims, numbers):
    n = 0
    for i in range(len(triangles)):
        a, b, c = triangles[i, 0], triangles[i, 1], triangles[i, 2]
        usable = True
        for k in range(3):
            x, y, z = positions[a, k], positions[b, k], positions[c, k]
            if not (abs(x) <= LIMIT and abs(y) <= LIMIT and abs(z) <= LIMIT):
                usable = False
            prims[n, k] = min(x, y, z)
            prims[n, 4 + k] = -max(x, y, z)
        same = True  # a triangle that repeats a vertex has no area and is never hit
        for k in range(3):
            same = same and (positions[a, k] == positions[b, k])
        if not same:
            same = True
            for k in range(3):
                same = same and (positions[a, k] == positions[c, k])
        if not same:
            same = True
            for k in range(3):
                same = same and (positions[b, k] == positions[c, k])
        if usable and not same:
            prims[n, 7] = np.float32(0)
            numbers[n, NUMBER] = i
            n += 1
    return n


def triangle_boxes(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Primitives (N, 8) of bvh_build for all triangles with finite corners and not all too equal ones."""
    prims = np.empty((len(triangles) + 1, 8), np.float32)
    n = _triangle_boxes(positions, triangles, prims, prims.view(np.int32))
    return prims[:n]


@njit(cache=True, nogil=True, error_model="numpy")
def _triangle_blocks(numbers, ranges, positions, triangles, first_triangle, blocks, ids):
    for leaf in range(len(ranges)):
        for lane in range(8):
            row = ranges[leaf, 0] + lane
            if row < ranges[leaf, 1]:
                i = numbers[row, NUMBER]
                ids[leaf, lane] = first_triangle + i
                for vertex in range(3):
                    for k in range(3):
                        blocks[leaf, (vertex * 3 + k) * 8 + lane] = positions[triangles[i, vertex], k]
            else:
                ids[leaf, lane] = -1
                for k in range(9):
                    blocks[leaf, k * 8 + lane] = np.nan


def triangle_blocks(prims, ranges, positions, triangles, first_triangle) -> tuple[np.ndarray, np.ndarray]:
    """(blocks (leaves, 72) float32, triangles (leaves, 8) int32) of the leaves; unused lanes NaN and -1."""
    blocks = np.empty((len(ranges), 72), np.float32)
    ids = np.empty((len(ranges), 8), np.int32)
    _triangle_blocks(prims.view(np.int32), ranges, positions, triangles, first_triangle, blocks, ids)
    return blocks, ids


@njit(cache=True, nogil=True, error_model="numpy")
def _instance_bounds(address, count, group_index, groups, covers, lo, hi):
    """Unite the boxes of a batch's placements into lo, hi; returns (singular or broken placements, the first)."""
    m = pointer_f64(address)
    bad, first = 0, -1
    box = np.empty(6)
    for i in range(count):
        g = groups[group_index[i if len(group_index) > 1 else 0] if len(group_index) else 0]
        if covers.count[g] == 0:
            continue
        if is_singular(m, 12 * i):
            if bad == 0:
                first = i
            bad += 1
            continue
        placed_box(m, 12 * i, covers, g, box)
        for k in range(3):
            lo[k] = min(lo[k], box[k])
            hi[k] = max(hi[k], box[3 + k])
    return bad, first


@njit(cache=True, nogil=True, error_model="numpy")
def _instance_boxes(address, count, group_index, groups, covers, center, slack, visibility, n, prims, numbers,
                    records, batches, first_record, batch):  # fmt: skip
    m = pointer_f64(address)
    box = np.empty(6)
    for i in range(count):
        g = groups[group_index[i if len(group_index) > 1 else 0] if len(group_index) else 0]
        if covers.count[g] == 0 or is_singular(m, 12 * i):
            continue
        if len(visibility) and visibility[i if len(visibility) > 1 else 0] & np.uint8(63) == 0:
            continue
        placed_box(m, 12 * i, covers, g, box)
        for k in range(3):
            prims[n, k] = np.float32(box[k] - center[k] - slack)
            prims[n, 4 + k] = -np.float32(box[3 + k] - center[k] + slack)
        prims[n, 7] = np.float32(0)
        numbers[n, NUMBER] = n
        records[n] = first_record + i
        batches[n] = batch
        n += 1
    return n


def skipped_placements(batch: Instances, group: Group, bad: int, first: int) -> str:
    """The warning about placements whose matrix cannot be used."""
    return (
        f"instances '{batch.name}' in group '{group.name}': {bad} of {len(batch)} placements "
        f"have a singular or infinite matrix and are skipped (the first is number {first})"
    )


class GroupBuilder:
    """Boxes of what groups hold, children before parents; keeps every group's cover (covers.py) in its own space."""

    def __init__(self, geometry: Geometry, shape_root: np.ndarray, warnings: list[str]):
        n = len(geometry.groups)
        self.geometry, self.warnings, self.shape_root = geometry, warnings, shape_root
        self.covers, self.covered = allocate_covers(n), 0
        self.placed = np.zeros(n, np.int64)  # how often each group is placed, at most
        for batch, first in zip(geometry.batches, geometry.instances.group_first, strict=True):
            self.placed[geometry.instances.batch_groups[first : first + len(batch.groups)]] += len(batch)
        self.center, self.radius = np.zeros((n, 3)), np.zeros(n)
        self.only_part = np.full(n, -1, np.int32)
        self.children: list[list[int]] = [[] for _ in range(n)]
        self._has_triangles = shape_root != -(2**31)
        self._reported: set[int] = set()

    def boxes(self, g: int) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """(primitives (N, 8), records (N,) int32, batches (N,) int32) of group g; None when there is nothing in it."""
        geometry, tables = self.geometry, self.geometry.instances
        parts = [p for p in geometry.group_parts[g] if self._has_triangles[geometry.tables.shape[p]]]
        lo, hi = np.full(3, np.inf), np.full(3, -np.inf)
        for p in parts:
            shape = geometry.shapes[geometry.tables.shape[p]]
            lo, hi = np.minimum(lo, shape.lower), np.maximum(hi, shape.upper)
        batches = geometry.group_batches[g]
        count = len(parts)
        for b in batches:
            batch = geometry.batches[b]
            bad, first = _instance_bounds(*self._placed(b), lo, hi)
            count += len(batch)
            if bad and b not in self._reported:
                self._reported.add(b)
                self.warnings.append(skipped_placements(batch, geometry.groups[g], bad, first))
        if not (lo <= hi).all():
            return None
        self.center[g] = (lo + hi) / 2
        self.radius[g] = np.maximum(hi - lo, 0).max() / 2
        # boxes are stored in single precision about the centre: round outwards, whatever the rounding mode
        slack = self.radius[g] * 2.0**-22 + np.abs(self.center[g]).max() * 2.0**-50
        self.radius[g] += slack
        prims = np.empty((count, 8), np.float32)
        records, item_batch = np.empty(count, np.int32), np.full(count, -1, np.int32)
        for n, p in enumerate(parts):
            shape = geometry.shapes[geometry.tables.shape[p]]
            prims[n, :3] = shape.lower - self.center[g] - slack
            prims[n, 4:7] = -(shape.upper - self.center[g] + slack)
            prims[n, 7] = 0
            prims.view(np.int32)[n, NUMBER] = n
            records[n] = ~p
        n = len(parts)
        numbers = prims.view(np.int32)
        for b in batches:
            address, size, index, groups, *_ = self._placed(b)
            visibility = geometry.batches[b].visibility
            visibility = (
                np.zeros(0, np.uint8) if visibility is None else np.ascontiguousarray(visibility, np.uint8)
            )
            n = _instance_boxes(
                address, size, index, groups, self.covers, self.center[g], slack, visibility,
                n, prims, numbers, records, item_batch, tables.first_record[b], b,
            )  # fmt: skip
            self.children[g] += sorted({int(c) for c in groups})
        if n == 0:
            return None
        if n == 1 and len(parts) == 1:
            self.only_part[g] = parts[0]
        return prims[:n], records[:n], item_batch[:n]

    def cover(self, g: int, records: np.ndarray, batches: np.ndarray, boxes, children, root: int) -> None:
        """Choose the boxes that stand for group g: of its items (as `boxes` gave them), or of the nodes from `root`."""
        limit = min(max(ROOM // max(int(self.placed[g]), 1), FEWEST), BOXES)
        if len(records) > OPENED:
            rows = np.empty((limit, 6))
            rows = rows[: top_boxes(boxes, children, root, self.center[g], limit, rows)]
        else:
            items = [self._item(r, b, boxes, children) for r, b in zip(records, batches, strict=True)]
            rows = fewer(np.concatenate(items), limit)
        covers, end = self.covers, self.covered + len(rows)
        covers.first[g], covers.count[g] = self.covered, len(rows)
        covers.middle[self.covered : end], covers.half[self.covered : end] = rows[:, :3], rows[:, 3:]
        self.covered = end

    def _item(self, record: int, b: int, boxes, children) -> np.ndarray:
        """(K, 6) boxes of an item of a group, in the group's space."""
        tables, instances = self.geometry.tables, self.geometry.instances
        if record < 0:
            shape, rows = tables.shape[~record], np.empty((BOXES, 6))
            root = self.shape_root[shape]
            return rows[: top_boxes(boxes, children, root, tables.center[~record], BOXES, rows)]
        i = int(record - instances.first_record[b])
        _, _, index, groups, covers = self._placed(b)
        child = groups[index[i if len(index) > 1 else 0] if len(index) else 0]
        at = np.s_[covers.first[child] : covers.first[child] + covers.count[child]]
        rows = np.concatenate([covers.middle[at], covers.half[at]], 1)
        return turned(rows, np.asarray(self.geometry.batches[b].transforms[i], float))

    def _placed(self, b: int):
        tables, batch = self.geometry.instances, self.geometry.batches[b]
        first = tables.group_first[b]
        groups = tables.batch_groups[first : first + len(batch.groups)]
        where, step = tables.group[b]
        index = (
            tables.group_values[:0]
            if where < 0
            else tables.group_values[where : where + (len(batch) if step else 1)]
        )
        return tables.transforms[b], len(batch), index, groups, self.covers


assert HOLDOUT == 64  # the bits below it are ray visibility
