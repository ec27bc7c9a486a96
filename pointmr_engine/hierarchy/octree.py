"""Octrees over the items of every group - its triangles and its instances - built once per group.

An item lies in the node that its centre falls in, at the level whose cells fit its size: large triangles stay near the
root, and a box bounds everything below it (a loose octree). Items are stored in depth-first order, so that a node is an
interval of them; that is what distribution lists and sample sets stand on (talk: "Dynamic Sampling Data Structure",
"Static Sampling"). O(n) memory, O(n log n) time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.hierarchy.leaves import skipped_placements
from pointmr_engine.numerics.pointers import pointer_f64
from pointmr_engine.numerics.transforms import is_singular
from pointmr_engine.scene.group import CAMERA

CHAIN = 3  # levels above the cell that fits a group: what a group is drawn from when it is smaller than its samples
DIVISIONS = 19  # of that cell: 19 * 3 bits of position and 5 of level fill a sort key
MAX_LEVEL = CHAIN + DIVISIONS
LEAF_TRIANGLES = 8  # nodes of this many triangles and no instance are not split, nor are nodes of one item
SPACING = 0.125  # of a cell's side: the distance of its samples
# of the side of an instance's cell: what it counts as, so that sample sets stand for several instances
INSTANCE_SIZE = 0.25
KEPT_POINTS = 3.0  # a triangle of more samples than this is kept as it is (talk: "say > 3 points")
LIMIT = np.float32(1e12)
PAD = np.float32(1e-6)  # of a box's largest coordinate: what rounding to float32 may cost


class OctreeArrays(NamedTuple):
    """Nodes and items of all groups' octrees. Boxes are in the group's space, relative to `group_center`."""

    box: np.ndarray  # (N, 6) float32: lower x, y, z, upper x, y, z of all that lies below
    side: np.ndarray  # (N,) float32, of the node's cell
    level: np.ndarray  # (N,) int32, 0: the group's root, CHAIN: the cell that fits the group
    # (N, 2) int32: first child, number of children (they are neighbours); 0 children: a leaf
    child: np.ndarray
    # (N, 4) int32: first item; end of the own items that are large for this level; end of the own items; end of the
    # items of the whole subtree
    items: np.ndarray
    item: np.ndarray  # (M, 2) int32: part and triangle in its shape; or -1 - batch and placement in the batch
    item_level: np.ndarray  # (M,) int32: level whose cells fit the item
    group_root: np.ndarray  # (G,) int32 node, -1: nothing in the group
    group_center: np.ndarray  # (G, 3) float64
    # (G,) float64: side of the cell that fits the group; the root's is 2**CHAIN times it
    group_side: np.ndarray
    part_offset: np.ndarray  # (P, 3) float64: where stored positions are zero, in the mesh's space


@dataclass(eq=False)
class Octree:
    """The octrees of a Geometry's groups. lower, upper: (G, 3) float64 bounds of each group in its own space."""

    geometry: Geometry
    arrays: OctreeArrays
    lower: np.ndarray
    upper: np.ndarray

    def bytes_per_triangle(self) -> float:
        """Memory of the hierarchy, per unique triangle."""
        total = sum(a.nbytes for a in self.arrays)
        return total / max(1, self.geometry.unique_triangles)


def build_octree(geometry: Geometry, progress: Callable[[float], object] | None = None) -> Octree:
    """Octrees over all groups of `geometry`, children before parents. progress(fraction) may raise to cancel.

    Broken triangles, and instances with a singular matrix or that no camera sees, are left out.
    """
    count = len(geometry.groups)
    lower, upper = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    center, side = np.zeros((count, 3)), np.zeros(count)
    root = np.full(count, -1, np.int32)
    nodes: list[tuple] = []
    item_rows, item_levels = [], []
    first_node = first_item = 0
    for g in range(count):
        rows, centers, boxes, size = _group_items(geometry, g, lower, upper, side)
        if len(rows):
            low, high = boxes[:, :3].min(0), boxes[:, 3:].max(0)
            lower[g], upper[g] = low, high
            center[g] = 0.5 * (low + high)
            side[g] = float((high - low).max()) * (1 + 1e-6) or 1e-30
            relative = np.empty((len(rows), 6), np.float32)
            _relative_boxes(boxes, center[g], relative)
            built, order, levels = _build_group(rows, centers - center[g], relative, size, side[g])
            box, sides, level, child, items = built
            root[g] = first_node
            child[child[:, 1] > 0, 0] += first_node
            items += first_item
            nodes.append((box, sides, level, child, items))
            item_rows.append(rows[order])
            item_levels.append(levels)
            first_node += len(box)
            first_item += len(rows)
        if progress is not None:
            progress((g + 1) / count)
    if not nodes:
        nodes.append(
            tuple(
                np.zeros((0, *s), d)
                for s, d in (((6,), "f4"), ((), "f4"), ((), "i4"), ((2,), "i4"), ((4,), "i4"))
            )
        )
        item_rows.append(np.zeros((0, 2), np.int32))
        item_levels.append(np.zeros(0, np.int32))
    columns = [np.ascontiguousarray(np.concatenate(c)) for c in zip(*nodes, strict=True)]
    offset = np.array([geometry.shapes[s].center for s in geometry.tables.shape]).reshape(-1, 3)
    arrays = OctreeArrays(
        *columns, np.concatenate(item_rows), np.concatenate(item_levels), root, center, side, offset
    )
    return Octree(geometry, arrays, lower, upper)


def triangle_corners(octree: Octree) -> np.ndarray:
    """(M + 8, 9) float32: corners of the triangles among the items, relative to their group's centre; in the items'
    order.

    36 bytes a triangle, for those who draw them in large numbers; instances have no corners. The last eight rows are
    padding.
    """
    geometry, a = octree.geometry, octree.arrays
    corners = np.zeros((len(a.item) + 8, 9), np.float32)
    for g, root in enumerate(a.group_root):
        if root < 0:
            continue
        first, end = int(a.items[root, 0]), int(a.items[root, 3])
        part = a.item[first:end, 0]
        for p in np.unique(part[part >= 0]):
            shape = geometry.shapes[geometry.tables.shape[p]]
            rows = first + np.flatnonzero(part == p)
            shift = a.part_offset[p] - a.group_center[g]
            chosen = shape.positions[shape.triangles[a.item[rows, 1]]]
            corners[rows] = (chosen + shift if shift.any() else chosen).reshape(-1, 9)
    return corners


def _group_items(geometry: Geometry, g: int, lower, upper, side):
    """(rows (M, 2) int32, centres (M, 3), boxes (M, 6), size (M,)), float64 in the group's space."""
    rows, boxes, sizes = [], [], []
    for p in geometry.group_parts[g]:
        shape = geometry.shapes[geometry.tables.shape[p]]
        n = len(shape.triangles)
        row, box, size = np.empty((n, 2), np.int32), np.empty((n, 6)), np.empty(n)
        used = _triangle_items(shape.positions, shape.triangles, shape.center, np.int64(p), row, box, size)
        rows.append(row[:used])
        boxes.append(box[:used])
        sizes.append(size[:used])
    tables = geometry.instances
    for b in geometry.group_batches[g]:
        batch = geometry.batches[b]
        n = len(batch)
        if not n:
            continue
        first = int(tables.group_first[b])
        groups = tables.batch_groups[first : first + len(batch.groups)]
        index = (
            np.zeros(1, np.int32)
            if batch.group_index is None
            else np.ascontiguousarray(batch.group_index, np.int32)
        )
        seen = (
            np.full(1, CAMERA, np.uint8)
            if batch.visibility is None
            else np.asarray(batch.visibility, np.uint8)
        )
        row, box, size = np.empty((n, 2), np.int32), np.empty((n, 6)), np.empty(n)
        used, bad, number = _instance_items(
            np.uint64(tables.transforms[b]), np.int64(n), index, groups, seen, lower, upper, side,
            np.int64(b), row, box, size,
        )  # fmt: skip
        if bad:
            geometry.warnings.append(skipped_placements(batch, geometry.groups[g], bad, number))
        rows.append(row[:used])
        boxes.append(box[:used])
        sizes.append(size[:used])
    if not rows:
        return np.zeros((0, 2), np.int32), np.zeros((0, 3)), np.zeros((0, 6)), np.zeros(0)
    boxes = np.concatenate(boxes)
    return np.concatenate(rows), 0.5 * (boxes[:, :3] + boxes[:, 3:]), boxes, np.concatenate(sizes)


@njit(cache=True, nogil=True, error_model="numpy")
def _triangle_items(positions, triangles, offset, part, rows, boxes, sizes):
    """Boxes and sizes of the finite triangles that have an extent; returns how many."""
    n = 0
    for i in range(len(triangles)):
        a, b, c = triangles[i, 0], triangles[i, 1], triangles[i, 2]
        usable, longest = True, 0.0
        ux = uy = uz = vx = vy = vz = 0.0
        for k in range(3):
            x, y, z = float(positions[a, k]), float(positions[b, k]), float(positions[c, k])
            usable = usable and abs(x) <= LIMIT and abs(y) <= LIMIT and abs(z) <= LIMIT
            low, high = min(x, y, z), max(x, y, z)
            boxes[n, k] = low + offset[k]
            boxes[n, 3 + k] = high + offset[k]
            longest = max(longest, high - low)
            if k == 0:
                ux, vx = y - x, z - x
            elif k == 1:
                uy, vy = y - x, z - x
            else:
                uz, vz = y - x, z - x
        if not usable or longest <= 0.0:
            continue
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        area = 0.5 * np.sqrt(nx * nx + ny * ny + nz * nz)
        # the cell whose samples it would have KEPT_POINTS of; a sliver counts by its length
        sizes[n] = max(np.sqrt(area / KEPT_POINTS) / SPACING, 0.5 * longest)
        rows[n, 0] = part
        rows[n, 1] = i
        n += 1
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def _instance_items(address, count, index, groups, seen, lower, upper, side, batch, rows, boxes, sizes):
    m = pointer_f64(address)
    n = bad = 0
    number = -1
    for i in range(count):
        g = groups[index[i if len(index) > 1 else 0]]
        at = 12 * i
        if not lower[g, 0] <= upper[g, 0]:
            continue
        if is_singular(m, at):
            number = i if bad == 0 else number
            bad += 1
            continue
        if seen[i if len(seen) > 1 else 0] & CAMERA == 0:
            continue
        scale = 0.0
        for k in range(3):
            middle, half, column = m[at + 4 * k + 3], 0.0, 0.0
            for c in range(3):
                middle += m[at + 4 * k + c] * 0.5 * (lower[g, c] + upper[g, c])
                half += abs(m[at + 4 * k + c]) * 0.5 * (upper[g, c] - lower[g, c])
                column += m[at + 4 * c + k] * m[at + 4 * c + k]
            scale = max(scale, column)
            boxes[n, k] = middle - half
            boxes[n, 3 + k] = middle + half
        sizes[n] = side[g] * np.sqrt(scale) * INSTANCE_SIZE
        rows[n, 0] = -1 - batch
        rows[n, 1] = i
        n += 1
    return n, bad, number


@njit(cache=True, nogil=True, error_model="numpy")
def _relative_boxes(boxes, center, out):
    for i in range(len(boxes)):
        pad = np.float32(0)
        for k in range(6):
            out[i, k] = np.float32(boxes[i, k] - center[k % 3])
            pad = max(pad, abs(out[i, k]))
        for k in range(3):
            out[i, k] -= pad * PAD
            out[i, 3 + k] += pad * PAD


def _build_group(rows, centers, boxes, size, side: float):
    """((box, side, level, child, items) of the nodes, order of the items, their levels)."""
    keys = np.empty(len(rows), np.uint64)
    levels = np.empty(len(rows), np.int32)
    _sort_keys(centers, size, side, keys, levels)
    order = np.argsort(keys, kind="stable")
    keys, levels = keys[order], levels[order]
    is_instance = rows[order, 0] < 0
    instances = np.concatenate([[0], np.cumsum(is_instance)])
    capacity = 64
    while True:
        ints, used = np.empty((capacity, 7), np.int32), np.int64(0)
        used = _split(keys, levels, instances, ints)
        if used >= 0:
            break
        capacity *= 2 if capacity > len(rows) else 8
    ints = ints[:used]
    for a, b in _leaves_to_sort(ints):
        by_level = np.argsort(levels[a:b], kind="stable")
        order[a:b], levels[a:b] = order[a:b][by_level], levels[a:b][by_level]
    _large_ends(ints, levels)
    box = np.empty((used, 6), np.float32)
    _bound(ints, order, boxes, box)
    sides = np.ldexp(np.float32(side), CHAIN - ints[:, 0]).astype(np.float32)
    return (box, sides, ints[:, 0].copy(), ints[:, 1:3].copy(), ints[:, 3:7].copy()), order, levels


@njit(cache=True, nogil=True, error_model="numpy")
def _spread(x):
    """The bits of a 21-bit number, three apart."""
    x = (x | (x << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    x = (x | (x << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (x | (x << np.uint64(2))) & np.uint64(0x1249249249249249)


@njit(cache=True, nogil=True, error_model="numpy")
def _sort_keys(centers, size, side, keys, levels):
    cells = np.float64(1 << DIVISIONS)
    for i in range(len(keys)):
        level = MAX_LEVEL
        if size[i] > 0.0:
            level = min(MAX_LEVEL, max(0, CHAIN + int(np.floor(np.log2(side / size[i])))))
        code = np.uint64(0)
        for k in range(3):
            x = (centers[i, k] / side + 0.5) * cells
            x = min(max(x, 0.0), cells - 1.0)
            code |= _spread(np.uint64(x)) << np.uint64(k)
        down = np.uint64(3 * (MAX_LEVEL - max(level, CHAIN)))
        code = (code >> down) << down
        keys[i] = (code << np.uint64(5)) | np.uint64(level)
        levels[i] = level


@njit(cache=True, nogil=True, error_model="numpy")
def _split(keys, levels, instances, out):
    """Nodes as rows level, first child, children, first item, (0), own end, end; -1 when `out` is too short."""
    out[0, 0] = 0
    out[0, 3] = 0
    out[0, 6] = len(keys)
    used, node = 1, 0
    while node < used:  # breadth first: children come after their parents, side by side
        level, first, end = out[node, 0], out[node, 3], out[node, 6]
        own = first
        few = end - first <= LEAF_TRIANGLES and instances[end] == instances[first]
        whole = level == MAX_LEVEL or end - first == 1 or few
        if whole:
            own = end
        else:
            while own < end and levels[own] <= level:
                own += 1
        out[node, 1] = used if own < end else 0
        children = 0
        at = own
        while at < end:
            shift = np.uint64(3 * (MAX_LEVEL - level - 1) + 5)
            digit = keys[at] >> shift
            low, high = at + 1, end  # first item past this child's cell, by bisection
            if level < CHAIN:
                low = end
            while low < high:
                middle = (low + high) // 2
                if keys[middle] >> shift == digit:
                    low = middle + 1
                else:
                    high = middle
            if used >= len(out):
                return -1
            out[used, 0] = level + 1
            out[used, 3] = at
            out[used, 6] = low
            used += 1
            children += 1
            at = low
        out[node, 2] = children
        out[node, 5] = own
        node += 1
    return used


def _leaves_to_sort(ints: np.ndarray) -> np.ndarray:
    """Item intervals of leaves that hold more than one item."""
    leaf = (ints[:, 2] == 0) & (ints[:, 5] - ints[:, 3] > 1)
    return ints[leaf][:, [3, 5]]


@njit(cache=True, nogil=True, error_model="numpy")
def _large_ends(nodes, levels):
    for n in range(len(nodes)):
        at = nodes[n, 3]
        while at < nodes[n, 5] and levels[at] <= nodes[n, 0]:
            at += 1
        nodes[n, 4] = at


@njit(cache=True, nogil=True, error_model="numpy")
def _bound(nodes, order, boxes, out):
    for n in range(len(nodes) - 1, -1, -1):
        for k in range(3):
            out[n, k] = np.inf
            out[n, 3 + k] = -np.inf
        for i in range(nodes[n, 3], nodes[n, 5]):
            for k in range(3):
                out[n, k] = min(out[n, k], boxes[order[i], k])
                out[n, 3 + k] = max(out[n, 3 + k], boxes[order[i], 3 + k])
        for c in range(nodes[n, 1], nodes[n, 1] + nodes[n, 2]):
            for k in range(3):
                out[n, k] = min(out[n, k], out[c, k])
                out[n, 3 + k] = max(out[n, 3 + k], out[c, 3 + k])
