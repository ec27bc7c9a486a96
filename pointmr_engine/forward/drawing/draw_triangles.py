"""Triangles that a walk draws as they are: placed eight at a time, then one by one where they can be seen."""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.drawing.cut_out_cover import cut_out_of
from pointmr_engine.forward.drawing.cut_outs import draw_cut_out
from pointmr_engine.forward.drawing.draw import cells_are_behind, draw_triangle, triangle_to_camera
from pointmr_engine.forward.drawing.surfel_lanes import (
    CORNER_FRONT,
    CORNER_SMALL,
    CORNER_W,
    CORNER_X,
    CORNER_Y,
    HIGH,
    LEFT,
    LOW,
    RIGHT,
    corners_eight,
)
from pointmr_engine.forward.drawing.targets import put_triangle
from pointmr_engine.forward.drawing.transforms import hash_placement
from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.simd import WIDTH, trailing_zeros


@device
def draw_triangles(
    view, target, width, height, left, low, constants, lanes, address, transforms, row, items, corners, cut_outs, first,
    last, entries, used, work, small,
):  # fmt: skip
    """Draw triangles first..last (items of the octree, no instances) as they are; returns the number of entries then
    used.

    constants, lanes, address (4,): as for draw.draw_set, and the address of `corners`. items (M, 2) int32 of the
    octree, corners (M, 9) float32 of all items. work (3, 3) float64. small: subpixels; triangles no larger are one
    fragment, wherever they are visible.
    """
    placed = np.uint32(0)  # what tells the placement from others, once it is known
    for start in range(first, last, WIDTH):
        masks = corners_eight(address[3], start, address[1], address[2])
        inside = (np.int64(1) << min(np.int64(WIDTH), last - start)) - 1
        cut = (masks >> 8) & inside  # by the near plane
        mask = _open_ones(target, lanes, masks & inside) | cut
        while mask != 0:
            k = trailing_zeros(mask)
            mask &= mask - 1
            hole = cut_out_of(cut_outs, np.int64(items[start + k, 0]), np.int64(items[start + k, 1]))
            is_cut = (cut >> k) & 1 != 0
            lump = np.int64(1) if not is_cut and lanes[CORNER_SMALL, k] <= small else np.int64(0)
            if hole >= 0 or is_cut:
                triangle_to_camera(transforms.matrix, row, corners, start + k, work)
            if hole >= 0:
                if placed == 0:
                    placed = hash_placement(transforms, row)
                key = placed ^ np.uint32(start + k)
                written = draw_cut_out(
                    view, target, width, height, left, low, work, used, cut_outs, hole, key
                )
            elif is_cut:
                written = draw_triangle(view, target, width, height, left, low, work, used)
            else:
                written = put_triangle(
                    target,
                    width,
                    height,
                    _three(lanes, CORNER_X, k),
                    _three(lanes, CORNER_Y, k),
                    _three(lanes, CORNER_W, k),
                    used,
                )
            if written:
                entries.surfel[used] = -1 - (2 * (start + k) + lump)
                entries.row[used] = row
                used += 1
    return used


@device
def _three(lanes, first, k):
    """Lane k of three rows, as float64."""
    return np.float64(lanes[first, k]), np.float64(lanes[first + 1, k]), np.float64(lanes[first + 2, k])


@device
def _open_ones(target, lanes, mask):
    """Those in `mask` of the triangles that corners_eight leaves behind which what is drawn does not hide whole."""
    found = np.int64(0)
    while mask != 0:
        k = trailing_zeros(mask)
        mask &= mask - 1
        i, j = np.int64(lanes[LEFT, k]), np.int64(lanes[LOW, k])
        columns, rows = np.int64(lanes[RIGHT, k]) + 1 - i, np.int64(lanes[HIGH, k]) + 1 - j
        if not cells_are_behind(target, i, j, columns, rows, lanes[CORNER_FRONT, k]):
            found |= np.int64(1) << k
    return found
