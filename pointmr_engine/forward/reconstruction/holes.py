"""Pixels that may have been missed: empty, or deeper than the surface around them (talk: "Image Reconstruction")."""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.drawing.subpixels import View
from pointmr_engine.forward.selection.point_draws import STEEP
from pointmr_engine.numerics.jit import uncounted

REACH = 2.0  # pixels between the neighbours of a pixel


def holes(depth: np.ndarray, view: View, subpixels: int) -> np.ndarray:
    """(height, width) bool: pixels of depth (height, width) float32 nearness, 0: nothing there, to be drawn again.

    A pixel counts if two neighbours on opposite sides both lie in front of it by more than a steep surface could; so
    pixels beyond a silhouette, with something in front on one side alone, do not. view: in so many subpixels a pixel.
    """
    reach = STEEP * REACH * subpixels / (view.scale_x * view.scale_y) ** 0.5
    factor, offset = (max(0.0, 1.0 - reach), 0.0) if view.perspective else (1.0, reach * view.depth_scale)
    out = np.zeros(depth.shape, np.bool_)
    _holes(np.ascontiguousarray(depth, np.float32), np.float64(factor), np.float64(offset), out)
    return out


@uncounted
def _holes(depth, factor, offset, out):
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            for k in range(4):  # the pairs: left and right, below and above, both diagonals
                dx, dy = (1, 0) if k == 0 else ((0, 1) if k == 1 else ((1, 1) if k == 2 else (1, -1)))
                if x < dx or x + dx >= width or y < abs(dy) or y + abs(dy) >= height:
                    continue
                front = min(depth[y - dy, x - dx], depth[y + dy, x + dx])
                if front > 0.0 and depth[y, x] < front * factor - offset:
                    out[y, x] = True
