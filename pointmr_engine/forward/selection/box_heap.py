"""Boxes that a walk of a tile has yet to visit, nearest first; those outside it or behind what is drawn are left out.

Both walks stand on it: that of sample sets (`walk`) and that of random points (`dynamic`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.drawing.draw import box_is_behind, open_share
from pointmr_engine.forward.drawing.subpixels import is_hidden
from pointmr_engine.forward.drawing.transforms import box_to_camera
from pointmr_engine.numerics.jit import device

FINE = 2048  # subpixels: bounds up to this size are compared with every depth, larger ones with blocks
COUNTED = 1 << 14  # subpixels: in bounds up to this size it is counted how much of them is open
NODES, OUTSIDE, HIDDEN = 0, 1, 2  # counters of a walk: boxes looked at, and of these left out


class Heap(NamedTuple):
    """Boxes to visit, the nearest at the top; what is known of each lies in a slot, which the next box takes over.

    A walk's `sizes` (3,) int64: boxes on the heap, slots used so far, and the first free one of them, -1: none.
    """

    key: np.ndarray  # (H,) float32: smallest depth
    slot: np.ndarray  # (H,) int32
    node: np.ndarray  # (S,) int32; of a free slot the next free one
    row: np.ndarray  # (S,) int32 of the transforms
    bounds: np.ndarray  # (S, 4) float32 subpixels in the tile


def allocate_heap(n: int) -> Heap:
    """Room for n boxes."""
    i, f = np.int32, np.float32
    return Heap(np.empty(n, f), np.empty(n, i), np.empty(n, i), np.empty(n, i), np.empty((n, 4), f))


@device
def push(heap, size, key, slot):
    """Put a slot on the heap. size: before."""
    at = size
    while at > 0:
        up = (at - 1) >> 1
        if heap.key[up] <= key:
            break
        heap.key[at], heap.slot[at] = heap.key[up], heap.slot[up]
        at = up
    heap.key[at], heap.slot[at] = key, slot


@device
def pop(heap, size):
    """Take the top away; its values must have been read. size: before."""
    last = size - 1
    key, slot = heap.key[last], heap.slot[last]
    at = np.int64(0)
    while True:
        child = 2 * at + 1
        if child >= last:
            break
        if child + 1 < last and heap.key[child + 1] < heap.key[child]:
            child += 1
        if heap.key[child] >= key:
            break
        heap.key[at], heap.slot[at] = heap.key[child], heap.slot[child]
        at = child
    heap.key[at], heap.slot[at] = key, slot


@device
def empty_heap(sizes):
    """Begin with no box and no slot."""
    sizes[0], sizes[1], sizes[2] = 0, 0, -1


@device
def nearest(heap, sizes):
    """Take the nearest box away: its slot, whose values must be read before the next box is added."""
    slot = np.int64(heap.slot[0])
    pop(heap, sizes[0])
    sizes[0] -= 1
    return slot


@device
def free_slot(heap, sizes, slot):
    """Give a slot away whose values have been read."""
    heap.node[slot] = sizes[2]
    sizes[2] = slot


@device
def bound_in_tile(view, box, pad, left, low, width, height, out):
    """Subpixel bounds (x0, y0, x1, y1) in the tile of a camera-space box, grown by `pad`; False: outside the tile."""
    x0, y0, z0 = box[0] - pad, box[1] - pad, box[2] - pad
    x1, y1, z1 = box[3] + pad, box[4] + pad, box[5] + pad
    if z1 <= view.near or z0 >= view.far:
        return False
    if not view.perspective:
        out[0] = x0 * view.scale_x + view.shift_x - left
        out[1] = y0 * view.scale_y + view.shift_y - low
        out[2] = x1 * view.scale_x + view.shift_x - left
        out[3] = y1 * view.scale_y + view.shift_y - low
        return out[2] >= 0.0 and out[3] >= 0.0 and out[0] <= width and out[1] <= height
    if z0 > view.near:
        near, far = 1.0 / z0, 1.0 / z1
        out[0] = x0 * (near if x0 < 0.0 else far) * view.scale_x + view.shift_x - left
        out[1] = y0 * (near if y0 < 0.0 else far) * view.scale_y + view.shift_y - low
        out[2] = x1 * (near if x1 > 0.0 else far) * view.scale_x + view.shift_x - left
        out[3] = y1 * (near if y1 > 0.0 else far) * view.scale_y + view.shift_y - low
        return out[2] >= 0.0 and out[3] >= 0.0 and out[0] <= width and out[1] <= height
    # it reaches behind the near plane: only the tile's side planes can leave it out
    z0 = view.near
    a, b = (left - view.shift_x) / view.scale_x, (left + width - view.shift_x) / view.scale_x
    c, d = (low - view.shift_y) / view.scale_y, (low + height - view.shift_y) / view.scale_y
    if x1 < min(a * z0, a * z1) or x0 > max(b * z0, b * z1):
        return False
    if y1 < min(c * z0, c * z1) or y0 > max(d * z0, d * z1):
        return False
    out[0], out[1], out[2], out[3] = 0.0, 0.0, width, height
    return True


@device
def is_behind(view, target, width, height, x0, y0, x1, y1, front):
    """Whether something nearer than depth `front` is drawn everywhere between these subpixels of the tile."""
    w = view.depth_shift - front * view.depth_scale
    if view.perspective:
        if front <= view.near:
            return False
        w = 1.0 / front
    if (x1 - x0) * (y1 - y0) < FINE:
        f = np.float32
        return box_is_behind(target, f(width), f(height), f(x0), f(y0), f(x1), f(y1), f(w))
    return is_hidden(target, width, height, x0, y0, x1, y1, w)


@device
def open_part(view, target, width, height, x0, y0, x1, y1, front, most):
    """Share of these subpixels in which something at depth `front` could be seen; 1 where it is more than `most`."""
    if (x1 - x0) * (y1 - y0) > COUNTED:
        hidden = is_behind(view, target, width, height, x0, y0, x1, y1, front)
        return np.float32(0) if hidden else np.float32(1)
    w = view.depth_shift - front * view.depth_scale
    if view.perspective:
        if front <= view.near:
            return np.float32(1)
        w = 1.0 / front
    f = np.float32
    return open_share(target, f(width), f(height), f(x0), f(y0), f(x1), f(y1), f(w), most)


@device
def add_box(view, octree, heap, sizes, transforms, node, row, pad, box, bounds, left, low, width, height, counters,
         target, culling):  # fmt: skip
    """Put a node on the heap if it can be seen. sizes: see Heap; False: no room."""
    box_to_camera(transforms.matrix, row, octree.box, node, box)
    counters[NODES] += 1
    if not bound_in_tile(view, box, pad, left, low, width, height, bounds):
        counters[OUTSIDE] += 1
        return True
    if culling and is_behind(
        view, target, width, height, bounds[0], bounds[1], bounds[2], bounds[3], box[2] - pad
    ):
        counters[HIDDEN] += 1
        return True
    slot = sizes[2]
    if slot >= 0:
        sizes[2] = heap.node[slot]
    elif sizes[1] < len(heap.key):
        slot = sizes[1]
        sizes[1] += 1
    else:
        return False
    heap.node[slot] = node
    heap.row[slot] = row
    for k in range(4):
        heap.bounds[slot, k] = bounds[k]
    push(heap, sizes[0], np.float32(box[2]), np.int32(slot))
    sizes[0] += 1
    return True


@device
def stretch_of(matrix, row):
    """The largest length of the matrix's columns: how much it stretches, within a factor of sqrt(3)."""
    most = 0.0
    for c in range(3):
        a, b, d = matrix[row, c], matrix[row, 4 + c], matrix[row, 8 + c]
        most = max(most, a * a + b * b + d * d)
    return math.sqrt(most)
