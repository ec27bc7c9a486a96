"""A tile's subpixel depth buffer, and the two shapes that are drawn into it: surfels' ellipses and triangles.

Depth is kept as nearness, which is linear in the image for planes: 1 / z in perspective. Every subpixel remembers its
nearest entry: opaque ellipses in a subpixel depth buffer beat alpha with merged sums in time and error
(docs/benchmarks/visibility.md).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.drawing.subpixel_places import INNER, subpixel_places
from pointmr_engine.numerics.dither import RANKS, SIDE
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.simd import WIDTH
from pointmr_engine.numerics.simd_cover import (
    cover_eight,
    cover_eight_between,
    cover_eight_within,
    farthest_row,
)
from pointmr_engine.raytracing.camera import CameraArrays

BLOCK = 16  # subpixels per side of a block, whose farthest depth occlusion culling reads
EMPTY = -1  # in `ids`
WIDEST_GAP, STEEPEST = 3, 8.0  # subpixels from side to side, and change of depth in one, in its width
SAME = 1e-4  # of their depth: what lies no farther behind its neighbours is one surface with them


class View(NamedTuple):
    """A camera in subpixels. x = raster_x of a camera-space point, times subpixels per pixel; all float64."""

    perspective: bool
    scale_x: float  # subpixels per unit of x / z (perspective) or of x (orthographic)
    scale_y: float
    shift_x: float  # subpixel coordinate of the view axis
    shift_y: float
    near: float
    far: float
    depth_shift: float  # orthographic: nearness = depth_shift - z * depth_scale
    depth_scale: float


class Target(NamedTuple):
    """A tile's buffers. Rows are padded so that eight values can be read anywhere."""

    depth: np.ndarray  # (H, W + 8) float32 nearness of the nearest entry; 0: nothing
    ids: np.ndarray  # (H, W + 8) int32 entry, EMPTY: nothing
    farthest: np.ndarray  # (H / BLOCK, W / BLOCK) float32: lowest nearness in a block, or lower
    stale: np.ndarray  # the same, uint8: something was drawn since `farthest` was taken
    address: np.ndarray  # (4,) uint64: of depth, ids, pattern, shift
    pattern: np.ndarray  # (64, 16) float32: thresholds of eight ordered dithers, each twice side by side
    shift: np.ndarray  # (2, 16) float32: what subpixel_places.place_of adds to the middles of subpixels


def make_view(camera: CameraArrays, subpixels: int, depth_range: tuple[float, float]) -> View:
    """The view for a camera; depth_range: z of the nearest and farthest thing, for orthographic cameras."""
    perspective = bool(camera.perspective[0])
    scale_x, scale_y = (subpixels / camera.plane[1]).tolist()
    low, high = depth_range
    near, far = (float(c) for c in camera.clip)
    low, high = max(low, near), min(high, far)
    span = max(high - low, 1e-6 * max(abs(low), abs(high)), 1e-30)
    return View(
        perspective,
        float(scale_x),
        float(scale_y),
        float(-camera.plane[0, 0] * scale_x),
        float(-camera.plane[0, 1] * scale_y),
        near,
        far,
        (low + 2.0 * span) / span,
        1.0 / span,
    )


def allocate_target(width: int, height: int, subpixels: int = 1) -> Target:
    """Buffers for width x height subpixels, rounded up to whole blocks. subpixels: per side of a pixel."""
    width, height = -(-width // BLOCK) * BLOCK, -(-height // BLOCK) * BLOCK
    depth = np.zeros((height, width + WIDTH), np.float32)
    ids = np.full((height, width + WIDTH), EMPTY, np.int32)
    pattern, shift = thresholds(), subpixel_places(subpixels)
    blocks = (height // BLOCK, width // BLOCK)
    address = np.array([a.ctypes.data for a in (depth, ids, pattern, shift)], np.uint64)
    return Target(
        depth, ids, np.zeros(blocks, np.float32), np.zeros(blocks, np.uint8), address, pattern, shift
    )


def beyond(view: View) -> float:
    """Nearness of the far clipping plane."""
    return 1.0 / view.far if view.perspective else max(view.depth_shift - view.far * view.depth_scale, 0.0)


def clear(target: Target, width: int, far: float = 0.0) -> None:
    """Empty all buffers for a tile that is `width` subpixels wide; what lies beyond hides nothing and shows nothing.

    far: nearness from which on things are drawn.
    """
    target.depth.fill(far)
    target.depth[:, width:] = np.inf
    target.ids.fill(EMPTY)
    target.farthest.fill(0.0)
    target.stale.fill(0)


def thresholds(turn_x: int = 0, turn_y: int = 0) -> np.ndarray:
    """Target.pattern: the orders of numerics.dither, cell (x, y) having the rank of (x ^ turn_x, y ^ turn_y)."""
    x, y = np.arange(SIDE) ^ turn_x, np.arange(SIDE) ^ turn_y
    rows = (RANKS[:, y][:, :, x].reshape(-1, SIDE) + 0.5) / SIDE**2
    return np.ascontiguousarray(np.tile(rows, (1, 2)), np.float32)


@device
def thresholds_from(target, phase, x, y):
    """Address of the thresholds of eight subpixels from (x, y) on. phase: 9 bits, the order and where it begins."""
    row = 8 * (phase >> 6) + ((y ^ (phase >> 3)) & 7)
    return target.address[2] + np.uint64(64 * row + 4 * ((x + (phase & 4)) & 7))


@device
def shifts_from(target, x):
    """Address of what is added to y of eight subpixels from column x on."""
    return target.address[3] + np.uint64(4 * (x & 7))


@device
def cover_run(target, y, first, last, nearness, slope, entry, opacity, phase):
    """Draw entry at the subpixels first..last of row y; nearness at `first`. Returns whether any was written."""
    stride = np.int64(target.depth.shape[1])
    written = np.int64(0)
    limits = thresholds_from(target, phase, first, y)
    x = first
    while x <= last:
        written |= cover_eight(
            target.address[0], target.address[1], y * stride + x, min(np.int64(WIDTH), last - x + 1),
            np.float32(nearness + slope * (x - first)), np.float32(slope), entry, limits, np.float32(opacity),
        )  # fmt: skip
        x += WIDTH
    return written != 0


@device
def cover_ellipse(target, width, height, x, y, a, b, c, nearness, slope_x, slope_y, entry, opacity, phase):
    """Draw the ellipse d^T [[a, b], [b, c]]^-1 d <= 1 about (x, y); returns whether anything was written.

    Subpixels are covered whose places are inside. slope_*: growth of nearness per subpixel.
    """
    f, half, one, inner = np.float32, np.float32(0.5), np.float32(1), np.float32(INNER)
    x, y, nearness, slope_x, slope_y = f(x), f(y), f(nearness), f(slope_x), f(slope_y)
    a, b, c = max(f(a), f(1e-9)), f(b), max(f(c), f(1e-9))
    wide, high = math.sqrt(a), math.sqrt(c)
    # rows and columns whose places the bounds reach; clipped twice, for int64 of what is not finite is below 0
    top, right = y + high - inner, x + wide - inner
    if top < f(0) or right < f(0):
        return False
    y0 = max(np.int64(min(y - high + inner, f(height))), np.int64(0))
    x0 = max(np.int64(min(x - wide + inner, f(width))), np.int64(0))
    y1, x1 = np.int64(min(top, f(height - 1))), np.int64(min(right, f(width - 1)))
    inverse = one / c
    lean = b * inverse
    spread = max(a - b * lean, f(0))
    stride = np.int64(target.depth.shape[1])
    written = np.int64(0)
    for first in range(x0, x1 + 1, WIDTH):
        dx = f(first) + half - x
        shifts = shifts_from(target, first)
        for j in range(y0, y1 + 1):
            limits = thresholds_from(target, phase, first, j)
            written |= cover_eight_within(
                target.address[0], target.address[1], j * stride + first, shifts, dx + target.shift[1, j & 7],
                f(j) + half - y, lean, spread, inverse, (nearness, slope_x, slope_y), entry, limits, f(opacity),
            )  # fmt: skip
    return written != 0


@device
def cover_triangle(target, width, height, x, y, w, entry):
    """Draw a triangle with corners x, y, nearness w (three float64 each, in subpixels); whether anything was written.

    Subpixels whose places are inside, and of those on a shared edge each once: an edge is followed from its lower end,
    whatever triangle it belongs to.
    """
    f = np.float32
    area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    low, high = min(y[0], y[1], y[2]), max(y[0], y[1], y[2])
    left, right = max(min(x[0], x[1], x[2]), 0.0), max(x[0], x[1], x[2])
    y0 = np.int64(max(low + INNER, 0.0))
    y1 = np.int64(min(high - INNER, height - 1.0))
    if area == 0.0 or high < INNER or y0 > y1 or right < 0.0 or left > width:
        return False
    scale = 1.0 / area
    slope_x = ((w[1] - w[0]) * (y[2] - y[0]) - (w[2] - w[0]) * (y[1] - y[0])) * scale
    slope_y = ((w[2] - w[0]) * (x[1] - x[0]) - (w[1] - w[0]) * (x[2] - x[0])) * scale
    # a triangle thinner than rounding: stay between its corners
    bounds = (f(min(w[0], w[1], w[2])), f(max(w[0], w[1], w[2])))
    xa, ya, xb, yb, xc, yc = x[0], y[0], x[1], y[1], x[2], y[2]
    if _is_below(xb, yb, xa, ya):
        xa, ya, xb, yb = xb, yb, xa, ya
    if _is_below(xc, yc, xb, yb):
        xb, yb, xc, yc = xc, yc, xb, yb
    if _is_below(xb, yb, xa, ya):
        xa, ya, xb, yb = xb, yb, xa, ya
    whole, lower, upper = (xc - xa) / (yc - ya), (xb - xa) / (yb - ya), (xc - xb) / (yc - yb)
    corners = (f(ya), f(yb), f(yc))
    stride = np.int64(target.depth.shape[1])
    column = np.int64(left)
    narrow = right - column <= WIDTH
    written = np.int64(0)
    for j in range(y0, y1 + 1):
        at = j + 0.5
        edges = (
            f(xa + (at - ya) * whole), f(whole), f(xa + (at - ya) * lower), f(lower), f(xb + (at - yb) * upper),
            f(upper),
        )  # fmt: skip
        i, last = column, min(right, width)
        if not narrow:
            begin, end = _span(xa, ya, xb, yb, yc, whole, lower, upper, j)
            i, last = max(np.int64(min(begin, width)), np.int64(0)), min(end, width)
        while i < last:
            place = i + 0.5 + target.shift[1, j & 7]
            nearness = w[0] + slope_x * (place - x[0]) + slope_y * (at - y[0])
            written |= cover_eight_between(
                target.address[0], target.address[1], j * stride + i, shifts_from(target, i), f(place), f(at), corners,
                edges, (f(nearness), f(slope_x), f(slope_y)), bounds, entry,
            )  # fmt: skip
            i += WIDTH
    return written != 0


@device
def _span(xa, ya, xb, yb, yc, whole, lower, upper, j):
    """Least and largest x of a triangle in row j; as cover_triangle has its corners and slopes."""
    begin, end = math.inf, -math.inf
    bottom, top = max(ya, np.float64(j)), min(yc, j + 1.0)
    for k in range(2):
        at = bottom if k == 0 else top
        one, other = xa + (at - ya) * whole, xb  # slopes of level edges are infinite
        if at != yb:
            other = xa + (at - ya) * lower if at < yb else xb + (at - yb) * upper
        begin, end = min(begin, one, other), max(end, one, other)
    if bottom < yb and yb < top:
        begin, end = min(begin, xb), max(end, xb)
    return begin, end


@device
def _is_below(xa, ya, xb, yb):
    """An order of points: by y, then by x."""
    return ya < yb or (ya == yb and xa < xb)


@device
def mark_drawn(target, width, height, x0, y0, x1, y1):
    """Note that something may have been drawn between these subpixels (float64, clipped here)."""
    i0, i1 = np.int64(max(x0, 0.0)) // BLOCK, np.int64(min(x1, width - 1.0)) // BLOCK
    j0, j1 = np.int64(max(y0, 0.0)) // BLOCK, np.int64(min(y1, height - 1.0)) // BLOCK
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            target.stale[j, i] = 1


@device
def is_hidden(target, width, height, x0, y0, x1, y1, nearness):
    """Whether all subpixels between x0, y0 and x1, y1 (float64) show something nearer than `nearness`."""
    i0, i1 = np.int64(max(x0, 0.0)) // BLOCK, np.int64(min(x1, width - 1.0)) // BLOCK
    j0, j1 = np.int64(max(y0, 0.0)) // BLOCK, np.int64(min(y1, height - 1.0)) // BLOCK
    stride = np.int64(target.depth.shape[1])
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            if target.farthest[j, i] > nearness:
                continue
            if target.stale[j, i] == 0:
                return False
            least = np.float32(np.inf)
            for k in range(BLOCK):
                row = j * BLOCK + k
                if row < height:
                    least = farthest_row(target.address[0], row * stride + i * BLOCK, np.int64(BLOCK), least)
                    if least <= nearness:
                        return False
            target.farthest[j, i] = least
            target.stale[j, i] = 0
    return True


def gap_limits(view: View, subpixel: float) -> tuple[np.float32, np.float32]:
    """How far in nearness the sides of a gap may be apart: an amount, and a share of their nearness.

    subpixel: its width at depth 1 (perspective) or in metres.
    """
    reach = WIDEST_GAP * STEEPEST * subpixel
    if view.perspective:
        return np.float32(0), np.float32(reach)
    return np.float32(reach * view.depth_scale), np.float32(0)


@uncounted
def close_gaps(target, width, height, surfel, limits):
    """Fill what is open between ellipses of one surface, one or two subpixels wide; returns how many were filled.

    A subpixel is open when what is on all four sides of it lies nearer, left and right as below and above much closer
    to each other in depth than to what it shows, and no farther than a steep surface goes in so many subpixels: what is
    open to one side is a notch of an outline. On two sides there are solid surfels, for triangles and clumps have no
    such gaps. surfel (E,) int64: Entries.surfel; limits: gap_limits.
    """
    depth, ids = target.depth, target.ids
    filled = np.int64(0)
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            w = depth[y, x]
            a, c = depth[y, x - 1], depth[y - 1, x]
            if a <= w or c <= w:
                continue
            right = x + 1 if depth[y, x + 1] > w else min(x + 2, width - 1)
            above = y + 1 if depth[y + 1, x] > w else min(y + 2, height - 1)
            if not (_beside(a, depth[y, right], w, limits) and _beside(c, depth[above, x], w, limits)):
                continue
            left, below = ids[y, x - 1], ids[y - 1, x]
            if _solid(left, ids[y, right], surfel):
                depth[y, x], ids[y, x] = min(a, depth[y, right]), left
            elif _solid(below, ids[above, x], surfel):
                depth[y, x], ids[y, x] = min(c, depth[above, x]), below
            else:
                continue
            filled += 1
    return filled


@device
def _beside(a, b, w, limits):
    """Whether two places at nearness a and b may be of one surface before something at w."""
    gap, apart = min(a, b) - w, abs(a - b)
    if apart * np.float32(4) > gap or gap < np.float32(SAME) * min(a, b):
        return False
    return apart <= limits[0] + limits[1] * min(a, b)


@device
def _solid(left, right, surfel):
    """Whether two entries are solid surfels."""
    s, t = surfel[left], surfel[right]
    return s >= 0 and t >= 0 and (s | t) & 1 == 0
