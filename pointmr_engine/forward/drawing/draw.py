"""What a walk draws: sample sets as ellipses, and triangles as they are, through a placement's transform."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.drawing.near_clip import at_place, clip, corners_of_piece
from pointmr_engine.forward.drawing.surfel_lanes import (
    COFACTORS,
    DEPTH_SCALE,
    DEPTH_SHIFT,
    FAR,
    FOCAL_X,
    FOCAL_Y,
    FRONT,
    GROW,
    HEIGHT_OF_TILE,
    MATRIX,
    MIDDLE,
    NEAR,
    NEARNESS,
    OPACITY,
    PERSPECTIVE,
    PZ,
    RADIUS,
    SEEN,
    SHIFT_X,
    SHIFT_Y,
    SLOPE_X,
    SLOPE_Y,
    STRETCH,
    SX,
    SY,
    WIDTH_OF_TILE,
    A,
    B,
    C,
    place_eight,
    shape_eight,
)
from pointmr_engine.forward.drawing.targets import put_ellipse, put_triangle
from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.simd import WIDTH, trailing_zeros
from pointmr_engine.numerics.simd_cover import count_open, is_open, is_open_in_eight

GAPPY = 0.7  # of an ellipse's subpixels: what is drawn at fewer is told from what has no gaps
FEW = 2  # chunks: a set of no more is drawn without a look at their balls
DRAWN = 8  # of the walk's counters: surfels whose ellipse was drawn


class Entries(NamedTuple):
    """What was drawn into a tile and was the nearest somewhere, in the order of drawing."""

    # (E,) int64: 2 * row of the surfels, + 1 where it is drawn with gaps (GAPPY); for a triangle -1 - (2 * item of the
    # octree, + 1 where it is small)
    surfel: np.ndarray
    row: np.ndarray  # (E,) int32 row of the transforms


@device
def to_target(view, x, y, z):
    """(subpixel x, subpixel y, nearness) of a camera-space point in front of the camera."""
    if view.perspective:
        w = 1.0 / z
        return x * w * view.scale_x + view.shift_x, y * w * view.scale_y + view.shift_y, w
    return (
        x * view.scale_x + view.shift_x,
        y * view.scale_y + view.shift_y,
        view.depth_shift - z * view.depth_scale,
    )


@device
def set_constants(view, width, height, left, low, matrix, row, scale, box, node, out):
    """Fill `out` with what surfel_lanes reads of a placement, about the middle of the node's box."""
    for k in range(3):
        out[MIDDLE + k] = np.float32(0.5 * (np.float64(box[node, k]) + np.float64(box[node, 3 + k])))
    for r in range(3):
        at = 4 * r
        moved = matrix[row, at + 3]
        for c in range(3):
            moved += matrix[row, at + c] * np.float64(out[MIDDLE + c])
            out[MATRIX + at + c] = matrix[row, at + c]
        out[MATRIX + at + 3] = moved
    grow = 0.0
    for r in range(3):
        for c in range(3):
            r1, r2, c1, c2 = (r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3
            value = (
                matrix[row, 4 * r1 + c1] * matrix[row, 4 * r2 + c2]
                - matrix[row, 4 * r1 + c2] * matrix[row, 4 * r2 + c1]
            )
            out[COFACTORS + 3 * r + c] = value
            grow += value * value
    out[GROW] = math.sqrt(grow / 3.0)  # how much areas grow that face all directions
    out[FOCAL_X], out[FOCAL_Y] = view.scale_x, view.scale_y
    out[SHIFT_X], out[SHIFT_Y] = view.shift_x - left, view.shift_y - low
    out[WIDTH_OF_TILE], out[HEIGHT_OF_TILE] = width, height
    out[NEAR], out[FAR] = view.near, min(view.far, 3e38)
    out[PERSPECTIVE] = np.float32(1) if view.perspective else np.float32(0)
    out[DEPTH_SHIFT], out[DEPTH_SCALE] = view.depth_shift, view.depth_scale
    out[STRETCH] = scale


@device
def box_is_behind(target, width, height, x0, y0, x1, y1, w):
    """Whether what is drawn already is nearer than w everywhere in these bounds.

    Exact, not sampled: a gap of a single subpixel that stayed open would keep everything behind it from being culled.
    """
    zero, one = np.float32(0), np.float32(1)
    i0, i1 = np.int64(max(x0, zero)), np.int64(min(x1, width - one))
    j0, j1 = np.int64(max(y0, zero)), np.int64(min(y1, height - one))
    return j0 > j1 or cells_are_behind(target, i0, j0, i1 + 1 - i0, j1 + 1 - j0, w)


@device
def cells_are_behind(target, i, j, columns, rows, w):
    """Whether what is drawn already is nearer than w in all subpixels from (i, j) on; rows: at least 1."""
    start, stride = target.address[0], np.int64(target.depth.shape[1])
    at = j * stride + i
    if columns <= WIDTH and rows <= WIDTH:
        return is_open_in_eight(start, at, stride, rows, columns, w) == 0
    for k in range(0, columns, WIDTH):
        if is_open(start, at + k, stride, rows, min(np.int64(WIDTH), columns - k), w) != 0:
            return False
    return True


@device
def open_share(target, width, height, x0, y0, x1, y1, w, most):
    """Share of these bounds in which nothing nearer than w is drawn; 1 if it is more than `most`."""
    zero, one = np.float32(0), np.float32(1)
    i0, i1 = np.int64(max(x0, zero)), np.int64(min(x1, width - one))
    j0, j1 = np.int64(max(y0, zero)), np.int64(min(y1, height - one))
    stride = np.int64(target.depth.shape[1])
    if j0 > j1 or i0 > i1:
        return zero
    start, rows = target.address[0], j1 + 1 - j0
    area = np.float32(rows * (i1 + 1 - i0))
    found, limit = np.int64(0), np.int64(most * area)
    for i in range(i0, i1 + 1, WIDTH):
        found += count_open(start, j0 * stride + i, stride, rows, min(np.int64(WIDTH), i1 + 1 - i), w)
        if found > limit:
            return one
    return np.float32(found) / area


@device
def draw_set(
    target, width, height, constants, lanes, address, node, row, first, count, entries, used, counters,
):  # fmt: skip
    """Draw surfels first..first + count; returns the number of entries then used.

    width, height: subpixels of the tile. constants: as set_constants left them; lanes (LANE_ROWS, 8) float32; address
    (5,) uint64: of the surfels' rows, of `constants`, of `lanes`, and, last, of the chunks of rows. Entries must have
    room for `count` more.
    """
    end = first + count
    begin, stop = first // WIDTH, (end + WIDTH - 1) // WIDTH
    if stop - begin <= FEW:
        for chunk in range(begin, stop):
            used = _draw_chunk(
                target, width, height, lanes, address, node, row, chunk, first, end, entries, used, counters
            )
        return used
    fw, fh = np.float32(width), np.float32(height)
    for group in range(begin, stop, WIDTH):
        place_eight(address[4], group, address[1], address[2])
        seen = np.int64(0)
        for k in range(min(np.int64(WIDTH), stop - group)):
            if _ball_shows(target, fw, fh, constants, lanes, k):
                seen |= np.int64(1) << k
        while seen != 0:
            k = trailing_zeros(seen)
            seen &= seen - 1
            used = _draw_chunk(
                target, width, height, lanes, address, node, row, group + k, first, end, entries, used, counters,
            )  # fmt: skip
    return used


@device
def _ball_shows(target, width, height, constants, lanes, k):
    """Whether something of the ball in lane k may be seen in the tile."""
    # about the camera, or so near that its outline is not nearly round: as it may hold samples of distant nodes
    if constants[PERSPECTIVE] > 0.5 and not (
        lanes[PZ, k] > 0.0 and lanes[NEARNESS, k] > np.float32(0.9) * lanes[FRONT, k]
    ):
        return True
    x, y, radius = lanes[SX, k], lanes[SY, k], lanes[RADIUS, k] * np.float32(1.01)
    x0, y0, x1, y1 = x - radius, y - radius, x + radius, y + radius
    if not (x1 > 0.0 and y1 > 0.0 and x0 < width and y0 < height):
        return False
    return not box_is_behind(target, width, height, x0, y0, x1, y1, lanes[FRONT, k])


@device
def _draw_chunk(target, width, height, lanes, address, node, row, chunk, first, end, entries, used, counters):
    """Draw those of eight surfels that lie in first..end; as draw_set."""
    fw, fh = np.float32(width), np.float32(height)
    start = chunk * WIDTH
    mask = place_eight(address[0], start, address[1], address[2])
    mask &= (np.int64(1) << min(np.int64(WIDTH), end - start)) - 1
    mask &= -(np.int64(1) << max(first - start, np.int64(0)))
    seen = np.int64(0)
    while mask != 0:
        k = trailing_zeros(mask)
        mask &= mask - 1
        x, y, radius = lanes[SX, k], lanes[SY, k], lanes[RADIUS, k]
        if not box_is_behind(target, fw, fh, x - radius, y - radius, x + radius, y + radius, lanes[FRONT, k]):
            seen |= np.int64(1) << k
    if seen == 0:
        return used
    shape_eight(address[0], start, address[1], address[2])
    while seen != 0:
        k = trailing_zeros(seen)
        seen &= seen - 1
        # by node and place in its set, so that a sample more elsewhere changes nothing here
        phase = ((61 * node + start + k - first) * np.int64(40503)) >> np.int64(7)
        counters[DRAWN] += 1
        if put_ellipse(
            target, width, height, lanes[SX, k], lanes[SY, k], lanes[A, k], lanes[B, k], lanes[C, k],
            lanes[NEARNESS, k], lanes[SLOPE_X, k], lanes[SLOPE_Y, k], used, lanes[OPACITY, k], lanes[SEEN, k],
            phase & np.int64(511),
        ):  # fmt: skip
            entries.surfel[used] = 2 * (start + k) + (
                np.int64(1) if lanes[OPACITY, k] < np.float32(GAPPY) else np.int64(0)
            )
            entries.row[used] = row
            used += 1
    return used


@device
def triangle_to_camera(matrix, row, corners, item, out):
    """Corners (3, 3) in camera space of an item's triangle."""
    for v in range(3):
        x = np.float64(corners[item, 3 * v])
        y = np.float64(corners[item, 3 * v + 1])
        z = np.float64(corners[item, 3 * v + 2])
        for r in range(3):
            at = 4 * r
            out[v, r] = (
                matrix[row, at] * x + matrix[row, at + 1] * y + matrix[row, at + 2] * z + matrix[row, at + 3]
            )


@device
def plane_of(corners):
    """Cross product of the edges from a triangle's first corner, corners (3, 3)."""
    ax, ay, az = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    bx, by, bz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@device
def piece_to_tile(view, corners, at, left, low):
    """(x, y, nearness), three each, in subpixels of the tile: corners `at` of a piece of a triangle (near_clip)."""
    a, b, c = at
    ax, ay, aw = to_target(view, *at_place(corners, view.near, a))
    bx, by, bw = to_target(view, *at_place(corners, view.near, b))
    cx, cy, cw = to_target(view, *at_place(corners, view.near, c))
    return (ax - left, bx - left, cx - left), (ay - low, by - low, cy - low), (aw, bw, cw)


@device
def draw_triangle(view, target, width, height, left, low, corners, entry):
    """Draw the triangle with corners (3, 3) in camera space, clipped at the near plane; whether it was written."""
    written = False
    pieces, k, s, t = clip(corners, view.near)
    for piece in range(pieces):
        at = corners_of_piece(piece, pieces, k, s, t)
        x, y, w = piece_to_tile(view, corners, at, left, low)
        if put_triangle(target, width, height, x, y, w, entry):
            written = True
    return written
