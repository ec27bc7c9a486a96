"""Images from points, one value per pixel (talk: "Image Reconstruction").

Occlusion first: of a pixel the nearest point counts, and points that lie behind their neighbours are dropped, since a
surface in front may have missed their very pixel. Then the attributes of what is left are interpolated: those of the
nearest point of each pixel, or a normalised sum of Gaussians. Images have rows from the bottom.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.forward.dynamic import PointSet
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing.camera import CameraArrays

SIGMA = 0.6  # pixels, of the Gaussian
STEEP = 4.0  # depth over width of the steepest surface that does not hide itself
_WINDOW_POINTS = 7.0  # a window that expects so many points stays empty with probability e^-7
_REACH = 3.0  # sigmas


def nearest_points(points: PointSet, region) -> np.ndarray:
    """(height, width) int32: the nearest point of each pixel of region (x0, y0, x1, y1); -1: none."""
    x0, y0, x1, y1 = (int(n) for n in region)
    buffer = np.zeros((y1 - y0, x1 - x0), np.uint64)
    _nearest(points.x, points.y, points.inverse_depth, np.int64(x0), np.int64(y0), buffer)
    index = np.int64(0xFFFFFFFF) - (buffer & np.uint64(0xFFFFFFFF)).astype(np.int64)
    return np.where(buffer > 0, index, -1).astype(np.int32)


def depth_image(points: PointSet, nearest: np.ndarray) -> np.ndarray:
    """(height, width) float32 inverse depths of `nearest_points`; 0: nothing there."""
    if not len(points.x):
        return np.zeros(nearest.shape, np.float32)
    return np.where(nearest >= 0, points.inverse_depth[nearest], np.float32(0))


def window(points_per_pixel: float) -> int:
    """Side of the smallest odd window of pixels that expects enough points to hide what is behind."""
    side = 1
    while side * side * points_per_pixel < _WINDOW_POINTS:
        side += 2
    return side


def depth_slack(camera: CameraArrays, pixels: float) -> tuple[float, float]:
    """(factor, offset): a surface of inverse depth i may reach back to i * factor - offset within `pixels` pixels."""
    pixel = STEEP * pixels * math.sqrt(camera.plane[1, 0] * camera.plane[1, 1])
    if camera.perspective[0]:
        return max(0.0, 1.0 - pixel), 0.0
    return 1.0, pixel / float(camera.clip[1] - camera.clip[0])


def visible_points(
    points: PointSet, depth: np.ndarray, region, camera: CameraArrays, side: int
) -> np.ndarray:
    """(N,) bool: points that do not lie behind their neighbours in windows of side x side pixels.

    depth: `depth_image`, or one that has other surfaces, too. What lies behind the steepest surface through the nearest
    point in the window is behind.
    """
    factor, offset = depth_slack(camera, float(side))
    front = _window_nearest(np.ascontiguousarray(depth, np.float32), np.int64(side // 2))
    x = np.clip((points.x - region[0]).astype(np.int64), 0, depth.shape[1] - 1)
    y = np.clip((points.y - region[1]).astype(np.int64), 0, depth.shape[0] - 1)
    return points.inverse_depth >= front[y, x].astype(np.float64) * factor - offset


def interpolate_nearest(nearest: np.ndarray, keep: np.ndarray, attributes: np.ndarray) -> np.ndarray:
    """(height, width, channels) float32: attributes (N, channels) of each pixel's point; 0 where none is kept."""
    out = np.zeros((*nearest.shape, attributes.shape[1]), np.float32)
    there = nearest >= 0
    there[there] = keep[nearest[there]]
    out[there] = attributes[nearest[there]]
    return out


def interpolate_gaussian(
    points: PointSet, keep: np.ndarray, attributes: np.ndarray, region, sigma: float = SIGMA
):
    """(image (height, width, channels) float32, weight (height, width) float32) of attributes (N, channels).

    Normalised sums of Gaussians of the kept points, at the pixels' centres; 0 where no point is within three sigmas.
    """
    x0, y0, x1, y1 = (int(n) for n in region)
    total = np.zeros((y1 - y0, x1 - x0, attributes.shape[1]))
    weight = np.zeros((y1 - y0, x1 - x0))
    _splat(
        points.x, points.y, keep, np.ascontiguousarray(attributes, np.float32), np.float64(sigma), np.int64(x0),
        np.int64(y0), total, weight,
    )  # fmt: skip
    out = np.zeros(total.shape, np.float32)
    np.divide(total, weight[:, :, None], out=out, where=weight[:, :, None] > 0.0, casting="unsafe")
    return out, weight.astype(np.float32)


def holes(depth: np.ndarray, camera: CameraArrays) -> np.ndarray:
    """(height, width) bool: pixels that are empty, or deeper than the surface around them: to be drawn again.

    A pixel counts if two neighbours on opposite sides both lie in front of it by more than a steep surface could; so
    pixels beyond a silhouette, with something in front on one side alone, do not.
    """
    factor, offset = depth_slack(camera, 2.0)
    return _holes(np.ascontiguousarray(depth, np.float32), np.float64(factor), np.float64(offset))


@uncounted
def _nearest(x, y, inverse_depth, x0, y0, buffer):
    for i in range(len(x)):
        px, py = np.int64(math.floor(x[i])) - x0, np.int64(math.floor(y[i])) - y0
        if px < 0 or py < 0 or px >= buffer.shape[1] or py >= buffer.shape[0]:
            continue
        bits = np.uint64(np.float32(inverse_depth[i]).view(np.uint32))
        value = (bits << np.uint64(32)) | (np.uint64(0xFFFFFFFF) - np.uint64(i))
        buffer[py, px] = max(buffer[py, px], value)


@njit(cache=True, nogil=True, error_model="numpy")
def _window_nearest(depth, reach):
    rows = np.empty_like(depth)
    out = np.empty_like(depth)
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            best = depth[y, x]
            for k in range(max(0, x - reach), min(width, x + reach + 1)):
                best = max(best, depth[y, k])
            rows[y, x] = best
    for y in range(height):
        for x in range(width):
            best = rows[y, x]
            for k in range(max(0, y - reach), min(height, y + reach + 1)):
                best = max(best, rows[k, x])
            out[y, x] = best
    return out


@uncounted
def _splat(x, y, keep, attributes, sigma, x0, y0, total, weight):
    reach = _REACH * sigma
    scale = -0.5 / (sigma * sigma)
    height, width = weight.shape
    for i in range(len(x)):
        if not keep[i]:
            continue
        px, py = x[i] - x0 - 0.5, y[i] - y0 - 0.5  # pixel centres at whole numbers
        for r in range(max(0, math.ceil(py - reach)), min(height - 1, math.floor(py + reach)) + 1):
            for c in range(max(0, math.ceil(px - reach)), min(width - 1, math.floor(px + reach)) + 1):
                d = (c - px) * (c - px) + (r - py) * (r - py)
                g = math.exp(scale * d)
                weight[r, c] += g
                for k in range(attributes.shape[1]):
                    total[r, c, k] += g * attributes[i, k]


@njit(cache=True, nogil=True, error_model="numpy")
def _holes(depth, factor, offset):
    height, width = depth.shape
    out = np.zeros(depth.shape, np.bool_)
    for y in range(height):
        for x in range(width):
            for k in range(4):  # the pairs: left and right, below and above, both diagonals
                dx, dy = (1, 0) if k == 0 else ((0, 1) if k == 1 else ((1, 1) if k == 2 else (1, -1)))
                if x < dx or x + dx >= width or y < abs(dy) or y + abs(dy) >= height:
                    continue
                front = min(depth[y - dy, x - dx], depth[y + dy, x + dx])
                if front > 0.0 and depth[y, x] < front * factor - offset:
                    out[y, x] = True
    return out
