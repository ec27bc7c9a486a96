"""The triangles of a scene that a rectangle of the image may show, listed one by one through nested instances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.drawing.draw import triangle_to_camera
from pointmr_engine.forward.drawing.subpixels import View
from pointmr_engine.forward.drawing.transforms import (
    Transforms,
    allocate_transforms,
    box_to_camera,
    compose,
    compose_root,
    grow_transforms,
)
from pointmr_engine.forward.selection.box_heap import bound_in_tile
from pointmr_engine.forward.selection.walk import Hierarchy
from pointmr_engine.numerics.jit import uncounted


class ViewTriangles(NamedTuple):
    """T triangles."""

    item: np.ndarray  # (T,) int32 of the octree
    row: np.ndarray  # (T,) int32 of the transforms
    corners: np.ndarray  # (T, 3, 3) float64, camera space


def view_triangles(
    view: View, hierarchy: Hierarchy, camera_from_world: np.ndarray, bounds, most: int
) -> tuple[ViewTriangles, Transforms]:
    """List what may be seen between bounds (x0, y0, x1, y1), subpixels of the whole image: `most` + 1 at most."""
    found = ViewTriangles(
        np.empty(most + 1, np.int32), np.empty(most + 1, np.int32), np.empty((most + 1, 3, 3))
    )
    transforms, stack = allocate_transforms(1 << 10), np.empty((1 << 12, 2), np.int32)
    used, box, where = np.zeros(3, np.int64), np.empty(6), np.empty(4)
    x0, y0, x1, y1 = (float(b) for b in bounds)
    while not _list(
        view, hierarchy, np.ascontiguousarray(camera_from_world[:3], np.float64), x0, y0, x1 - x0, y1 - y0, found,
        transforms, stack, used, box, where,
    ):  # fmt: skip
        transforms = grow_transforms(transforms, 0, 2 * len(transforms.parent))
        stack = np.empty((2 * len(stack), 2), np.int32)
    _, rows, triangles = (int(n) for n in used)
    return ViewTriangles(*(a[:triangles] for a in found)), Transforms(*(a[:rows] for a in transforms))


@uncounted
def _list(
    view, hierarchy, camera_from_world, left, low, width, height, found, transforms, stack, used, box, where
):
    """Fill `found` and `transforms`; False: no room. used (3,) int64: of the stack, rows, triangles."""
    octree = hierarchy.octree
    root = len(octree.group_root) - 1
    used[:] = 0
    if root < 0 or octree.group_root[root] < 0:
        return True
    compose_root(transforms, camera_from_world, octree, root, np.int64(0))
    stack[0, 0], stack[0, 1] = octree.group_root[root], 0
    used[0] = used[1] = 1
    while used[0] > 0 and used[2] < len(found.item):
        used[0] -= 1
        node, row = np.int64(stack[used[0], 0]), np.int64(stack[used[0], 1])
        box_to_camera(transforms.matrix, row, octree.box, node, box)
        if not bound_in_tile(view, box, 0.0, left, low, width, height, where):
            continue
        first, own_end = np.int64(octree.items[node, 0]), np.int64(octree.items[node, 2])
        need = own_end - first + octree.child[node, 1]
        if used[0] + need > len(stack) or used[1] + need > len(transforms.parent):
            return False
        for i in range(first, own_end):
            part = np.int64(octree.item[i, 0])
            if part < 0:
                group = compose(transforms, row, octree, hierarchy.instances, -1 - part, np.int64(octree.item[i, 1]),
                                used[1])  # fmt: skip
                stack[used[0], 0], stack[used[0], 1] = octree.group_root[group], used[1]
                used[0] += 1
                used[1] += 1
                continue
            t = used[2]
            if t == len(found.item):
                break
            triangle_to_camera(transforms.matrix, row, hierarchy.corners, i, found.corners[t])
            for r in range(3):
                a, b, c = found.corners[t, 0, r], found.corners[t, 1, r], found.corners[t, 2, r]
                box[r], box[3 + r] = min(a, b, c), max(a, b, c)
            if bound_in_tile(view, box, 0.0, left, low, width, height, where):
                found.item[t], found.row[t] = i, row
                used[2] += 1
        for c in range(octree.child[node, 0], octree.child[node, 0] + octree.child[node, 1]):
            stack[used[0], 0], stack[used[0], 1] = c, row
            used[0] += 1
    return True
