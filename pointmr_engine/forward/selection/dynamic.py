"""Dynamic selection: one walk through the octrees of all placements for a tile, which draws new random points.

A box is sampled as a whole where its density can be one number: where (z_max / z_min)^2 <= 1 + epsilon, no triangle in
it expects more than `kept` points, and it looks no larger than what culling needs; or where it is smaller than a
fraction of a pixel (talk: "Depth Approximation"). Else its own triangles are drawn as they are, instances continue in
their group's octree, and the walk goes to its children.
Boxes come nearest first; those outside the tile, and those behind what is drawn already, are left out. So are points of
placements inside a box: the way down to their triangle ends where they cannot be seen, long before the last level.
Time O(log tau + h + a log a log n): tau the relative depth range, h the octrees' height, a the surface in pixels.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.drawing.draw import set_constants, triangle_to_camera
from pointmr_engine.forward.drawing.draw_triangles import draw_triangles
from pointmr_engine.forward.drawing.subpixels import Target, View, beyond, clear, mark_drawn
from pointmr_engine.forward.drawing.transforms import box_to_camera, compose, compose_root
from pointmr_engine.forward.selection.box_heap import (
    HIDDEN,
    add_box,
    empty_heap,
    free_slot,
    is_behind,
    nearest,
    stretch_of,
)
from pointmr_engine.forward.selection.point_draws import (
    NO_ENTRY,
    Draws,
    World,
    allocate_pen,
    allocate_placed,
    draw_box,
    faces_away,
)
from pointmr_engine.forward.selection.projection import densest, depth_ratio
from pointmr_engine.forward.selection.walk import (
    DONE,
    ENTRIES_FULL,
    HEAP_FULL,
    SMALL,
    TRANSFORMS_FULL,
    Scratch,
)
from pointmr_engine.hierarchy.nesting import area_scale
from pointmr_engine.numerics.hashing import hash_path
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.pointers import pointer_f64

TRIANGLES, INSTANCES, BOXES = 5, 6, 7
COUNTERS = (
    "nodes", "outside", "hidden", "points_drawn", "points", "triangles", "instances", "boxes", "points_ended",
)  # fmt: skip


class PointScratch(Scratch):
    """One thread's buffers for walking and drawing points."""

    names = COUNTERS

    def __init__(self, target: Target, levels: int):
        super().__init__(target)
        self.counters = np.zeros(len(COUNTERS), np.int64)
        self.pen = allocate_pen(levels)
        self.placed = allocate_placed(len(self.transforms.parent))

    def grow(self, status: int) -> None:
        """As of every walk's buffers; what is known of placements grows with them."""
        super().grow(status)
        if len(self.placed.key) < len(self.transforms.parent):
            self.placed = allocate_placed(len(self.transforms.parent))


def sample_tile(
    view: View,
    world: World,
    camera_from_world: np.ndarray,
    how: Draws,
    seed: int,
    bounds: tuple[int, int, int, int],
    scratch: PointScratch,
    culling: bool = True,
    subpixels: int = 4,
    again: bool = False,
) -> int:
    """Draw the scene's part in a tile into scratch.target; returns the number of entries.

    bounds: x0, y0, x1, y1 of the tile in subpixels of the whole image. culling: leave out boxes that are hidden by what
    is drawn already, which changes nothing but the work. subpixels: per side of a pixel. again: on top of what the
    target, the entries and the transforms hold; else the target must be empty.
    """
    scratch.address[3] = world.corners.ctypes.data
    target, before = scratch.target, scratch.counters.copy()
    if not again:
        scratch.used[:2] = 0
    start = scratch.used[:2].copy()
    key = np.uint64(hash_path(np.uint64(seed & 0xFFFFFFFFFFFFFFFF), np.int64(0)))
    shown = (target.depth.copy(), target.ids.copy()) if again else None
    while True:
        status = _walk(
            view, world, how, key, np.ascontiguousarray(camera_from_world[:3], np.float64),
            *(np.int64(b) for b in bounds), target, scratch.entries, scratch.heap, scratch.transforms, scratch.placed,
            scratch.pen, scratch.box, scratch.bounds, scratch.constants, scratch.lanes, scratch.address, bool(culling),
            np.float32(SMALL * subpixels), scratch.used, scratch.counters,
        )  # fmt: skip
        if status == DONE:
            return int(scratch.used[0])
        scratch.used[:2] = start
        scratch.grow(status)
        scratch.counters[:] = before
        if shown is None:
            clear(target, bounds[2] - bounds[0], beyond(view))
        else:
            target.depth[:], target.ids[:] = shown
            target.stale.fill(1)
            target.farthest.fill(0.0)


@device
def _is_seen(view, world, how, transforms, row, i, corners):
    """Whether item i, a triangle, shows its front, or its back may be seen, too."""
    if not how.backface_culling:
        return True
    triangle_to_camera(transforms.matrix, row, world.corners, i, corners)
    return not faces_away(view, corners, transforms.matrix, row)


@device
def _enter(world, transforms, placed, row, batch, which, new):
    """Fill row `new` for placement `which` of a batch, met inside `row`; returns its group."""
    group = compose(transforms, row, world.octree, world.instances, batch, which, new)
    bound, even = area_scale(pointer_f64(world.instances.transforms[batch]), 12 * which)
    placed.scale[new] = stretch_of(transforms.matrix, new)
    placed.area[new], placed.even[new] = placed.area[row] * bound, placed.even[row] and even
    placed.key[new] = hash_path(placed.key[row], np.int64(-1) - transforms.record[new])
    return group


@uncounted
def _walk(view, world, how, seed, camera_from_world, left, low, right, high, target, entries, heap,
          transforms, placed, pen, box, bounds, constants, lanes, address, culling, small, used,
          counters):  # fmt: skip
    octree, distribution = world.octree, world.distribution
    sums = distribution.sums
    width, height = right - left, high - low
    root = len(octree.group_root) - 1
    if root < 0 or octree.group_root[root] < 0:
        return DONE
    sizes = used[2:5]
    empty_heap(sizes)
    row = used[1]
    if row >= len(placed.scale):
        return TRANSFORMS_FULL
    used[1] += 1
    compose_root(transforms, camera_from_world, octree, root, row)
    placed.scale[row] = stretch_of(transforms.matrix, row)
    placed.area[row], placed.even[row] = area_scale(transforms.matrix[row], np.int64(0))
    placed.key[row] = seed
    add_box(view, octree, heap, sizes, transforms, np.int64(octree.group_root[root]), row, 0.0, box, bounds, left, low,
            width, height, counters, target, culling)  # fmt: skip
    while sizes[0] > 0:
        slot = nearest(heap, sizes)
        node, row = np.int64(heap.node[slot]), np.int64(heap.row[slot])
        x0, y0 = np.float64(heap.bounds[slot, 0]), np.float64(heap.bounds[slot, 1])
        x1, y1 = np.float64(heap.bounds[slot, 2]), np.float64(heap.bounds[slot, 3])
        free_slot(heap, sizes, slot)
        box_to_camera(transforms.matrix, row, octree.box, node, box)
        near, far = max(box[2], view.near), box[5]
        crossing = box[2] <= view.near
        if culling and is_behind(view, target, width, height, x0, y0, x1, y1, near):
            counters[HIDDEN] += 1
            continue
        first, own_end, end = octree.items[node, 0], octree.items[node, 2], octree.items[node, 3]
        # most points that a unit of area may need: at the nearest depth, and as far from the axis as the tile reaches
        density = how.density * placed.area[row] * densest(
            view, near, left + max(x0, 0.0), low + max(y0, 0.0), left + min(x1, width), low + min(y1, height)
        )  # fmt: skip
        shift = distribution.shift[transforms.group[row]]
        expected = (sums[end + shift] - sums[first + shift]) * density
        if expected <= 0.0:
            continue
        leaf = octree.child[node, 1] == 0 and octree.item[first, 0] >= 0
        wide = max(x1 - x0, y1 - y0)
        largest = distribution.largest[node] * density
        even_depth = (
            depth_ratio(view.perspective, near, far) <= how.ratio
            and largest <= how.kept
            and (leaf or wide <= how.wide)
        )
        if not crossing and (wide <= how.tiny or even_depth):
            if wide <= how.tiny:
                expected = min(expected, how.most)
            counters[BOXES] += 1
            before = used[0]
            status = draw_box(
                view, target, width, height, left, low, world, how, pen, transforms, placed, row,
                first, end, expected, hash_path(placed.key[row], node), entries, used, culling, counters,
            )  # fmt: skip
            if status < 0:
                return ENTRIES_FULL if status == NO_ENTRY else TRANSFORMS_FULL
            if used[0] > before:
                mark_drawn(
                    target, width, height, x0 - how.radius, y0 - how.radius, x1 + how.radius, y1 + how.radius
                )
            continue
        i, before, ready = np.int64(first), used[0], False
        while i < own_end:
            part, which = np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1])
            if part < 0:
                new = used[1]
                if new >= len(placed.scale):
                    return TRANSFORMS_FULL
                group = _enter(world, transforms, placed, row, -1 - part, which, new)
                counters[INSTANCES] += 1
                boxes = sizes[0]
                if not add_box(view, octree, heap, sizes, transforms, np.int64(octree.group_root[group]), new, 0.0, box,
                               bounds, left, low, width, height, counters, target, culling):  # fmt: skip
                    return HEAP_FULL
                if sizes[0] > boxes:
                    used[1] += 1
                i += 1
                continue
            last = i + 1
            seen = _is_seen(view, world, how, transforms, row, i, pen.corners)
            while last < own_end and octree.item[last, 0] >= 0:
                if _is_seen(view, world, how, transforms, row, last, pen.corners) != seen:
                    break
                last += 1
            if seen:
                if used[0] + last - i > len(entries.surfel):
                    return ENTRIES_FULL
                if not ready:
                    set_constants(view, width, height, left, low, transforms.matrix, row, placed.scale[row], octree.box,
                                  node,
                                  constants)  # fmt: skip
                    ready = True
                counters[TRIANGLES] += last - i
                used[0] = draw_triangles(
                    view, target, width, height, left, low, constants, lanes, address, transforms, row,
                    octree.item, world.corners, world.cut_outs, i, last, entries, used[0], pen.corners, small,
                )  # fmt: skip
            i = last
        if used[0] > before:
            mark_drawn(
                target, width, height, x0 - how.radius, y0 - how.radius, x1 + how.radius, y1 + how.radius
            )
        for c in range(octree.child[node, 0], octree.child[node, 0] + octree.child[node, 1]):
            if not add_box(view, octree, heap, sizes, transforms, np.int64(c), row, 0.0, box, bounds, left, low, width,
                           height, counters, target, culling):  # fmt: skip
                return HEAP_FULL
    return DONE
