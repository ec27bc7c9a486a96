"""Acceleration structures over a Geometry: one per unique mesh shape, one per unique group, joined by instances."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy import bvh_build, leaves
from pointmr_engine.hierarchy.geometry import BatchTables, Geometry, PartTables
from pointmr_engine.numerics.pointers import address_of
from pointmr_engine.numerics.simd import BLOCK_FLOATS, NODE_FLOATS

EMPTY = int(bvh_build.EMPTY)
LEAF_TRIANGLES = 8


class WalkArrays(NamedTuple):
    """All hierarchies, for kernels. A child is a node, ~leaf (a block of triangles or an item), or EMPTY."""

    boxes: np.ndarray  # (nodes, 48) float32: lower x, y, z, upper x, y, z of eight children
    children: np.ndarray  # (nodes, 8) int32
    # (leaves of shapes, 72) float32: three vertices' x, y, z of eight triangles, about the centre
    blocks: np.ndarray
    block_triangles: np.ndarray  # (leaves of shapes, 8) int32, scene-wide
    item_record: np.ndarray  # (items of groups,) int32: an instance record, or ~part
    item_batch: np.ndarray  # (items of groups,) int32
    shape_root: np.ndarray  # (shapes,) int32
    group_root: np.ndarray  # (groups,) int32
    group_part: np.ndarray  # (groups,) int32: the part that is all there is in the group, or -1
    group_center: np.ndarray  # (groups, 3) float64
    group_radius: np.ndarray  # (groups,) float64
    part_root: np.ndarray  # (parts,) int32: that of the part's shape
    part_opaque: np.ndarray  # (parts,) int8: 1 all of it blocks light, 0 nothing, -1 look at the slot
    slot_opaque: np.ndarray  # (slots,) bool
    cell_first: np.ndarray  # (parts,) int64: row of a part's triangle 0 in cell_row, -1: it has none
    cell_row: np.ndarray  # (K,) int32: first row of a triangle's cells in cell_bits, -1: it has none
    cell_bits: np.ndarray  # (rows, 2) int64: cells of a row that let all light through | none
    cell_side: int  # cells along a triangle's edge, 64 at most; 0: no triangle has any
    parts: PartTables
    instances: BatchTables
    stack_size: int  # entries that a walk may need
    levels: int  # nested groups that a walk may need


class WalkPointers(NamedTuple):
    """Addresses of what the walk's kernels read.

    Arrays handed down through kernels cost: references to all of them are counted at every call that is not inlined
    (it halved the rate, and threads would wait for each other), and each array is seven arguments to compile.
    """

    root: int  # the root group's index, not an address
    boxes: int
    children: int
    blocks: int
    block_triangles: int
    item_record: int
    item_batch: int
    group_root: int
    group_part: int
    group_center: int
    group_radius: int
    part_root: int
    part_center: int
    part_radius: int
    part_first_triangle: int
    part_material_index: int
    part_first_slot: int
    part_slots: int
    part_opaque: int
    slot_opaque: int
    cell_first: int
    cell_row: int
    cell_bits: int
    cell_side: int  # a number, not an address
    first_record: int
    has_attributes: int
    transforms: int
    group_first: int
    batch_groups: int
    group: int
    visibility: int
    object_index: int
    seed: int
    color: int
    group_values: int
    visibility_values: int
    object_index_values: int
    seed_values: int
    color_values: int


def _pointers(arrays: WalkArrays) -> WalkPointers:
    found = {}
    for name in WalkPointers._fields[1:]:
        if name == "cell_side":
            continue
        if hasattr(arrays, name):
            array = getattr(arrays, name)
        elif name.startswith("part_"):
            array = getattr(arrays.parts, name.removeprefix("part_"))
        else:
            array = getattr(arrays.instances, name)
        found[name] = address_of(array)
    return WalkPointers(root=len(arrays.group_root) - 1, cell_side=arrays.cell_side, **found)


class Acceleration:
    """What the walk needs. It keeps the geometry alive, whose arrays its kernels borrow."""

    def __init__(self, geometry: Geometry, arrays: WalkArrays, warnings: list[str]):
        self.geometry = geometry
        self.arrays = arrays
        self.pointers = _pointers(arrays)
        self.warnings = warnings


class _Pool:
    """Arrays that grow: nodes of all hierarchies, and leaves of those being built."""

    def __init__(self, nodes: int):
        self.boxes = np.empty((nodes, NODE_FLOATS), np.float32)
        self.children = np.empty((nodes, 8), np.int32)
        self.used = 0

    def reserve(self, nodes: int) -> None:
        wanted = self.used + nodes
        if wanted > len(self.boxes):
            size = max(wanted, len(self.boxes) * 3 // 2)
            for name in ("boxes", "children"):
                old = getattr(self, name)
                new = np.empty((size, old.shape[1]), old.dtype)
                new[: self.used] = old[: self.used]
                setattr(self, name, new)

    def build(self, prims: np.ndarray, leaf_size: int) -> tuple[int, np.ndarray, int]:
        """(root, leaves (L, 2) int64 ranges of prims, depth); leaves are numbered from 0 in the children."""
        n = len(prims)
        # fully occupied nodes and leaves are not to be had: twice that nearly always suffices
        nodes, leaf_room = n // (4 * leaf_size) + 16, (n if leaf_size == 1 else n // 2 + 16)
        while True:
            self.reserve(nodes)
            ranges = np.empty((leaf_room, 2), np.int32)
            boxes, children = self.boxes, self.children
            made, n_leaves, depth = bvh_build.build_wide(
                prims, leaf_size, self.used, 0, boxes, children, ranges
            )
            if made >= 0:
                break
            nodes, leaf_room = nodes * 2, n
        root = self.used
        self.used += made
        return root, ranges[:n_leaves], depth


def aligned_empty(shape: tuple[int, ...], dtype) -> np.ndarray:
    """An array whose first value lies on a cache line."""
    count = int(np.prod(shape)) * np.dtype(dtype).itemsize
    raw = np.empty(count + 64, np.uint8)
    start = -raw.ctypes.data % 64
    return raw[start : start + count].view(dtype).reshape(shape)


def build_acceleration(geometry: Geometry, progress: Callable[[float], None] | None = None) -> Acceleration:
    """Build all hierarchies, children before parents. `progress(fraction)` may raise to cancel.

    Warnings (singular placements) go to the result's `warnings` and to `geometry.warnings`.
    """
    total = geometry.unique_triangles + sum(len(b) for b in geometry.batches) + 1
    done = 0

    def advance(n: int) -> None:
        nonlocal done
        done += n
        if progress is not None:
            progress(min(done / total, 1.0))

    pool = _Pool(total // 20 + 2 * len(geometry.shapes) + 2 * len(geometry.groups) + 16)
    warnings: list[str] = []
    n_shapes, n_groups = len(geometry.shapes), len(geometry.groups)
    shape_root = np.full(n_shapes, EMPTY, np.int32)
    shape_depth = np.zeros(n_shapes, np.int64)
    blocks: list[np.ndarray] = []
    block_triangles: list[np.ndarray] = []
    n_blocks = 0
    for s, shape in enumerate(geometry.shapes):
        prims = leaves.triangle_boxes(shape.positions, shape.triangles)
        if len(prims):
            root, ranges, depth = pool.build(prims, LEAF_TRIANGLES)
            shift_leaves(pool.children, root, pool.used, n_blocks)
            data = leaves.triangle_blocks(
                prims, ranges, shape.positions, shape.triangles, shape.first_triangle
            )
            blocks.append(data[0])
            block_triangles.append(data[1])
            n_blocks += len(ranges)
            shape_root[s], shape_depth[s] = root, depth
        del prims
        advance(len(shape.triangles))

    groups = leaves.GroupBuilder(geometry, shape_root, warnings)
    group_root = np.full(n_groups, EMPTY, np.int32)
    group_stack = np.zeros(n_groups, np.int64)
    group_levels = np.zeros(n_groups, np.int64)
    item_record: list[np.ndarray] = []
    item_batch: list[np.ndarray] = []
    n_items = 0
    for g in range(n_groups):
        built = groups.boxes(g)
        if built is not None:
            prims, records, batch = built
            if len(prims) == 1:
                group_root[g] = ~n_items
                order, depth = np.zeros(1, np.int32), 0
            else:
                root, ranges, depth = pool.build(prims, 1)
                shift_leaves(pool.children, root, pool.used, n_items)
                group_root[g] = root
                order = prims.view(np.int32)[ranges[:, 0], bvh_build.NUMBER]
                del ranges
            groups.cover(g, records, batch, pool.boxes, pool.children, group_root[g])
            del prims, built
            item_record.append(records[order])
            item_batch.append(batch[order])
            n_items += len(order)
            below = [group_stack[c] for c in groups.children[g]]
            below += [7 * shape_depth[geometry.tables.shape[p]] + 8 for p in geometry.group_parts[g]]
            group_stack[g] = 7 * depth + 8 + max(below, default=0)
            group_levels[g] = 1 + max([group_levels[c] for c in groups.children[g]], default=0)
        advance(sum(len(geometry.batches[b]) for b in geometry.group_batches[g]))

    def joined(arrays: list[np.ndarray], width: tuple[int, ...], dtype) -> np.ndarray:
        result = aligned_empty((sum(len(a) for a in arrays), *width), dtype)
        at = 0
        while arrays:
            a = arrays.pop(0)
            result[at : at + len(a)] = a
            at += len(a)
        return result

    arrays = WalkArrays(
        boxes=_trimmed(pool.boxes, pool.used),
        children=_trimmed(pool.children, pool.used),
        blocks=joined(blocks, (BLOCK_FLOATS,), np.float32),
        block_triangles=joined(block_triangles, (8,), np.int32),
        item_record=joined(item_record, (), np.int32),
        item_batch=joined(item_batch, (), np.int32),
        shape_root=shape_root,
        group_root=group_root,
        group_part=groups.only_part,
        group_center=groups.center,
        group_radius=groups.radius,
        part_root=shape_root[geometry.tables.shape],
        part_opaque=np.ones(len(geometry.parts), np.int8),
        slot_opaque=np.ones(len(geometry.tables.slot_material), np.bool_),
        cell_first=np.full(len(geometry.parts), -1, np.int64),
        cell_row=np.zeros(0, np.int32),
        cell_bits=np.zeros((0, 2), np.int64),
        cell_side=0,
        parts=geometry.tables,
        instances=geometry.instances,
        stack_size=int(group_stack.max(initial=0)) + 8,
        levels=int(group_levels.max(initial=0)) + 1,
    )
    geometry.warnings += warnings
    return Acceleration(geometry, arrays, warnings)


def shift_leaves(children: np.ndarray, first: int, stop: int, by: int) -> None:
    """Number the leaves of nodes[first:stop] from `by` instead of from 0."""
    if by:
        c = children[first:stop]
        leaf = (c < 0) & (c != EMPTY)
        c[leaf] -= by


def _trimmed(array: np.ndarray, used: int) -> np.ndarray:
    if array.nbytes > 1 << 24 and used * 2 > len(array):
        return array[:used]  # untouched pages cost nothing; a copy of something this large would
    result = aligned_empty((used, array.shape[1]), array.dtype)
    result[:] = array[:used]
    return result


def set_opaque(acceleration: Acceleration, opaque: np.ndarray) -> Acceleration:
    """The same structure (shared, not copied) with `opaque` (len(geometry.materials),) bool for `walk.shadow`."""
    parts = acceleration.geometry.tables
    opaque = np.asarray(opaque, np.bool_)
    if opaque.shape != (len(acceleration.geometry.materials),):
        raise ValueError(
            f"opaque has shape {opaque.shape}, expected ({len(acceleration.geometry.materials)},)"
        )
    slots = opaque[parts.slot_material]
    part = np.full(len(parts.shape), -1, np.int8)
    for p, (first, count) in enumerate(zip(parts.first_slot, parts.slots, strict=True)):
        used = slots[first : first + count] if parts.material_index[p] else slots[first : first + 1]
        if used.all() or not used.any():
            part[p] = used[0]
    arrays = acceleration.arrays._replace(slot_opaque=slots, part_opaque=part)
    return Acceleration(acceleration.geometry, arrays, acceleration.warnings)


def set_micromap(
    acceleration: Acceleration, first: np.ndarray, row: np.ndarray, bits: np.ndarray, side: int
) -> Acceleration:
    """The same structure (shared, not copied), whose `walk.shadow` knows clear and opaque cells of triangles.

    As WalkArrays has them: first (parts,) int64, row (K,) int32, bits (rows, 2) int64; side: cells along an edge. Bit p
    of row q is the cell at barycentric weights (p..p + 1) / side of vertex 1 and (q..q + 1) / side of vertex 2.
    """
    arrays = acceleration.arrays._replace(cell_first=first, cell_row=row, cell_bits=bits, cell_side=int(side))
    return Acceleration(acceleration.geometry, arrays, acceleration.warnings)
