"""Static selection: one walk through the octrees of all placements for a tile, nearest boxes first.

A node is drawn from its sample set when the set is dense enough in the image at the box's nearest depth, which splits
space into depth classes that double (talk: "Depth Approximation"); else the walk goes to its children. Large
triangles are drawn as the walk passes them, instances continue in their group's octree. Boxes outside the tile, and
boxes behind what is drawn already, are left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.drawing.draw import Entries, draw_set, set_constants
from pointmr_engine.forward.drawing.draw_triangles import draw_triangles
from pointmr_engine.forward.drawing.subpixels import Target, View, beyond, clear, mark_drawn
from pointmr_engine.forward.drawing.surfel_lanes import CONSTANTS, LANE_ROWS
from pointmr_engine.forward.drawing.transforms import (
    allocate_transforms,
    box_to_camera,
    compose,
    compose_root,
    grow_transforms,
)
from pointmr_engine.forward.selection.box_heap import (
    HIDDEN,
    add_box,
    allocate_heap,
    empty_heap,
    free_slot,
    nearest,
    open_part,
    stretch_of,
)
from pointmr_engine.forward.selection.projection import widest_distortion
from pointmr_engine.hierarchy.octree import CHAIN, SPACING
from pointmr_engine.hierarchy.sample_sets import NOT_YET
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.simd import WIDTH

# of a box: when no more of it can be seen, samples twice as far apart will do for moving images
HARDLY = 1 / 8
SMALL = 1.5  # cells: triangles no larger are shaded once, not in every cell
PATIENCE = 1 << 14  # boxes whose sets are not built, until a walk ends
DONE, ENTRIES_FULL, HEAP_FULL, TRANSFORMS_FULL = 0, 1, 2, 3
COUNTERS = (
    "nodes", "outside", "hidden", "sets", "surfels", "triangles", "instances", "waiting", "drawn",
)  # fmt: skip
WAITING = COUNTERS.index("waiting")


class Hierarchy(NamedTuple):
    """What a walk reads of the scene."""

    octree: NamedTuple  # OctreeArrays
    sets: NamedTuple  # SetArrays
    corners: np.ndarray  # (M, 9) float32 of the octree's items: octree.triangle_corners
    parts: NamedTuple  # PartTables
    instances: NamedTuple  # BatchTables
    cut_outs: NamedTuple  # CutOuts


class Scratch:
    """One thread's buffers for walking; they grow as needed."""

    names = COUNTERS

    def __init__(self, target: Target):
        self.target = target
        self.entries = Entries(np.empty(1 << 16, np.int64), np.empty(1 << 16, np.int32))
        self.heap = allocate_heap(1 << 14)
        self.transforms = allocate_transforms(1 << 12)
        self.scale = np.empty(1 << 12)
        self.counters = np.zeros(len(COUNTERS), np.int64)
        self.used = np.zeros(5, np.int64)  # entries, transforms; while walking: sizes of the heap
        self.box = np.empty(6)
        self.bounds = np.empty(4)
        self.corners = np.empty((3, 3))
        self.constants = np.zeros(CONSTANTS, np.float32)
        self.lanes = np.zeros((LANE_ROWS, WIDTH), np.float32)
        self.address = np.array([0, self.constants.ctypes.data, self.lanes.ctypes.data, 0, 0], np.uint64)

    def grow(self, status: int) -> None:
        """Twice the room of what ran short; entries and transforms keep those that are used."""
        entries, rows = (int(n) for n in self.used[:2])
        if status == ENTRIES_FULL:
            old = self.entries
            self.entries = Entries(*(np.empty(2 * len(a), a.dtype) for a in old))
            for new, a in zip(self.entries, old, strict=True):
                new[:entries] = a[:entries]
        elif status == HEAP_FULL:
            self.heap = allocate_heap(2 * len(self.heap.key))
        else:
            self.transforms = grow_transforms(self.transforms, rows, 2 * len(self.transforms.parent))
            self.scale = np.empty(len(self.transforms.parent))


def walk(
    view: View,
    hierarchy: Hierarchy,
    camera_from_world: np.ndarray,
    spacing: float,
    bounds: tuple[int, int, int, int],
    scratch: Scratch,
    wanted: np.ndarray,
    culling: bool = True,
    cell: int = 4,
    hardly: float = 0.0,
) -> int:
    """Draw the scene's part in a tile into scratch.target, which is empty; returns the number of entries.

    spacing: of samples, in subpixels, at most. bounds: x0, y0, x1, y1 of the tile in subpixels of the whole image.
    wanted (nodes,) uint8: 1 is written where a set is needed that is not built; such nodes are not drawn. The walk ends
    where too many have been met: nothing hides what lies behind them, and most of that will not be wanted.
    culling: leave out boxes that are hidden by what is drawn already. cell: subpixels per side of what is shaded by
    itself. hardly: boxes of which at most this share is open are drawn from samples twice as far apart.
    """
    before = scratch.counters.copy()
    scratch.address[0] = hierarchy.sets.row.ctypes.data
    scratch.address[3] = hierarchy.corners.ctypes.data
    scratch.address[4] = hierarchy.sets.chunk.ctypes.data
    while True:
        status = _walk(
            view, hierarchy, np.ascontiguousarray(camera_from_world[:3], np.float64), float(spacing),
            *(np.int64(b) for b in bounds), scratch.target, scratch.entries, scratch.heap, scratch.transforms,
            scratch.scale, scratch.box, scratch.bounds, scratch.corners, scratch.constants, scratch.lanes,
            scratch.address, wanted, before[WAITING] + PATIENCE, bool(culling), np.float32(SMALL * cell),
            np.float32(hardly), scratch.used, scratch.counters,
        )  # fmt: skip
        if status == DONE:
            return int(scratch.used[0])
        scratch.grow(status)
        clear(scratch.target, bounds[2] - bounds[0], beyond(view))
        scratch.counters[:] = before


@device
def _entrance(octree, matrix, row, factor, group, view, box):
    """The node at which the walk enters a group: its root, or as far down the levels above its cell as will be needed.

    factor: by which a spacing in the group may be multiplied to have the depth from which on it is dense enough.
    """
    node = np.int64(octree.group_root[group])
    box_to_camera(matrix, row, octree.box, node, box)
    near = box[2] if view.perspective else 1.0
    while octree.level[node] < CHAIN:
        coarse = octree.side[node] * SPACING * factor > near
        if not coarse or octree.items[node, 2] > octree.items[node, 0] or octree.child[node, 1] != 1:
            break
        node = np.int64(octree.child[node, 0])
    return node


@uncounted
def _walk(view, hierarchy, camera_from_world, spacing, left, low, right, high, target, entries, heap, transforms,
          scale, box, bounds, corners, constants, lanes, address, wanted, patience, culling, small,
          hardly, used, counters):  # fmt: skip
    octree, sets = hierarchy.octree, hierarchy.sets
    width, height = right - left, high - low
    root = len(octree.group_root) - 1
    sizes = used[2:5]
    used[0] = used[1] = 0
    empty_heap(sizes)
    if root < 0 or octree.group_root[root] < 0:
        return DONE
    focal = max(view.scale_x, view.scale_y)
    compose_root(transforms, camera_from_world, octree, root, np.int64(0))
    scale[0] = stretch_of(transforms.matrix, np.int64(0))
    rows = np.int64(1)
    count = np.int64(0)
    unculled = culling and count > 0  # a bool like `culling`, not a literal, which would compile _add twice
    top = np.int64(octree.group_root[root])
    add_box(view, octree, heap, sizes, transforms, top, np.int64(0), octree.side[top] * SPACING * scale[0],
         box, bounds, left, low, width, height, counters, target, unculled)  # fmt: skip
    while sizes[0] > 0 and counters[WAITING] < patience:
        near = np.float64(heap.key[0])
        slot = nearest(heap, sizes)
        node, row = np.int64(heap.node[slot]), np.int64(heap.row[slot])
        x0, y0 = np.float64(heap.bounds[slot, 0]), np.float64(heap.bounds[slot, 1])
        x1, y1 = np.float64(heap.bounds[slot, 2]), np.float64(heap.bounds[slot, 3])
        free_slot(heap, sizes, slot)
        apart = octree.side[node] * SPACING * scale[row]
        enough = spacing
        if culling and count > 0:
            share = open_part(view, target, width, height, x0, y0, x1, y1, near - apart, hardly)
            if share == 0.0:
                counters[HIDDEN] += 1
                continue
            if share <= hardly:
                enough *= 2.0
        own, large, own_end = octree.items[node, 0], octree.items[node, 1], octree.items[node, 2]
        projected = apart * focal * widest_distortion(view, left + x0, low + y0, left + x1, low + y1)
        dense = projected <= enough
        if view.perspective:
            dense = near > 0.0 and projected <= enough * near
        first = sets.sets[node, 0]
        drawn = large
        before = count
        if dense and first == NOT_YET:
            wanted[node] = 1
            counters[WAITING] += 1
        elif dense and first >= 0:
            n = sets.sets[node, 1]
            if count + n > len(entries.surfel):
                return ENTRIES_FULL
            set_constants(
                view, width, height, left, low, transforms.matrix, row, scale[row], octree.box, node, constants,
            )  # fmt: skip
            count = draw_set(
                target,
                width,
                height,
                constants,
                lanes,
                address,
                node,
                row,
                first,
                n,
                entries,
                count,
                counters,
            )
            counters[3] += 1
            counters[4] += n
        else:
            drawn = own_end
            for c in range(octree.child[node, 0], octree.child[node, 0] + octree.child[node, 1]):
                if not add_box(view, octree, heap, sizes, transforms, np.int64(c), row, 0.5 * apart, box, bounds,
                            left, low, width, height, counters, target, unculled):  # fmt: skip
                    return HEAP_FULL
        i, ready = np.int64(own), dense and first >= 0
        while i < drawn:
            part, which = np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1])
            if part < 0:
                if rows >= len(scale):
                    return TRANSFORMS_FULL
                group = compose(transforms, row, octree, hierarchy.instances, -1 - part, which, rows)
                counters[6] += 1
                scale[rows] = stretch_of(transforms.matrix, rows)
                boxes = sizes[0]
                start = _entrance(
                    octree, transforms.matrix, rows, scale[rows] * focal / spacing, group, view, box
                )
                if not add_box(view, octree, heap, sizes, transforms, start, rows,
                            octree.side[start] * SPACING * scale[rows], box, bounds, left, low, width, height,
                            counters, target, culling):  # fmt: skip
                    return HEAP_FULL
                if sizes[0] > boxes:
                    rows += 1
                i += 1
                continue
            last = i + 1
            while last < drawn and octree.item[last, 0] >= 0:
                last += 1
            if count + last - i > len(entries.surfel):
                return ENTRIES_FULL
            if not ready:
                set_constants(
                    view, width, height, left, low, transforms.matrix, row, scale[row], octree.box, node, constants,
                )  # fmt: skip
                ready = True
            counters[5] += last - i
            count = draw_triangles(
                view, target, width, height, left, low, constants, lanes, address, transforms, row,
                octree.item, hierarchy.corners, hierarchy.cut_outs, i, last, entries, count, corners, small,
            )  # fmt: skip
            i = last
        if count > before:
            mark_drawn(target, width, height, x0, y0, x1, y1)
    used[0] = count
    used[1] = rows
    return DONE
