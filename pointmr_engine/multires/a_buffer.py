"""Visibility by alpha: lists of what each cell of a tile shows, by coverages and not by subpixels (talk: ray A-buffer).

A cell weighs what it sees by a Gaussian. Fragments whose ranges of depth overlap are one surface, and their coverages
add (the areas of surfels and triangles are exact, so that a surface's sum to 1); surfaces hide each other as if they
were independent of each other, front to back. Where one faces the other way than what is before it, both are taken for
the sides of one body: their edges lie behind each other, and it covers what the larger covers (science: aligned edges).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.subpixels import BLOCK, EMPTY
from pointmr_engine.forward.surfel_lanes import REACH
from pointmr_engine.forward.targets import put_cut_out, put_ellipse, put_triangle, puts
from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.simd import WIDTH

ROOM = 24  # fragments of a cell; of more, those that are nearest to each other become one
SIGMA = 0.3  # cells: of a cell's Gaussian
CUT = 2.5  # standard deviations at which Gaussians end
KEPT = 1.0 - math.exp(-0.5 * CUT * CUT)  # of their integral
EDGE = (
    math.sqrt(5.0) * SIGMA
)  # half the width of the parabola of equal variance, which weighs triangles along rows
LEAST = 1.0 / 512.0  # coverage, and weight of a surface, that counts
FULL = 1.0 / 64.0
CHECK = 0.95  # coverage after which a cell may be full
APART = 0.35  # cells: surfaces no farther apart in depth are one
FIRM = 0.25  # by so much grows what surfels cover beyond a half: their sums are right to a few per cent only
PLACES = (
    -1.5424,
    -0.7522,
    -0.2347,
    0.2347,
    0.7522,
    1.5424,
)  # middles of sixths of a distribution of variance 1
LINES = len(PLACES)
NEAR, HALF, COVER, AT_X, AT_Y, SOLID, SIDE = range(7)
COLUMNS = 7


class Layers(NamedTuple):
    """A tile's cells. The first five are what forward.subpixels.Target has, for the walk to see what is hidden."""

    depth: np.ndarray  # (H, W + 8) float32 nearness of the farthest that matters in a full cell; 0: not full
    ids: np.ndarray  # (H, W + 8) int32: number of a cell's last fragment, EMPTY: none
    farthest: np.ndarray
    stale: np.ndarray
    address: np.ndarray
    entry: np.ndarray  # (H, W, ROOM) int32
    part: np.ndarray  # (H, W, ROOM, COLUMNS) float32: see below
    load: np.ndarray  # (H, W) float32: coverage since the cell was last looked through
    apart: np.ndarray  # (2,) float32: nearness between what is one surface, in parts of it, and as it is
    lines: np.ndarray  # (2, LINES) float64 to work in


def allocate_layers(width: int, height: int, apart: tuple[float, float]) -> Layers:
    """Lists for width x height cells, rounded up to whole blocks."""
    width, height = -(-width // BLOCK) * BLOCK, -(-height // BLOCK) * BLOCK
    depth = np.zeros((height, width + WIDTH), np.float32)
    ids = np.full((height, width + WIDTH), EMPTY, np.int32)
    blocks = (height // BLOCK, width // BLOCK)
    f = np.float32
    return Layers(
        depth, ids, np.zeros(blocks, f), np.zeros(blocks, np.uint8),
        np.array([a.ctypes.data for a in (depth, ids)], np.uint64), np.empty((height, width, ROOM), np.int32),
        np.empty((height, width, ROOM, COLUMNS), f), np.zeros((height, width), f), np.array(apart, f),
        np.zeros((2, LINES)),
    )  # fmt: skip


@device
def _move(target, j, i, source, to):
    target.entry[j, i, to] = target.entry[j, i, source]
    for c in range(COLUMNS):
        target.part[j, i, to, c] = target.part[j, i, source, c]


@device
def sort_cell(target, j, i, n):
    """Put a cell's n fragments in order, the nearest first."""
    part = target.part
    for k in range(1, n):
        if part[j, i, k, NEAR] <= part[j, i, k - 1, NEAR]:
            continue
        entry = target.entry[j, i, k]
        a, b, c = part[j, i, k, 0], part[j, i, k, 1], part[j, i, k, 2]
        d, e, f, g = part[j, i, k, 3], part[j, i, k, 4], part[j, i, k, 5], part[j, i, k, 6]
        m = k
        while m > 0 and part[j, i, m - 1, NEAR] < a:
            _move(target, j, i, m - 1, m)
            m -= 1
        target.entry[j, i, m] = entry
        part[j, i, m, 0], part[j, i, m, 1], part[j, i, m, 2] = a, b, c
        part[j, i, m, 3], part[j, i, m, 4], part[j, i, m, 5], part[j, i, m, 6] = d, e, f, g


@device
def next_surface(target, j, i, first, n):
    """The surface that begins with a cell's fragment `first` of n, in order: (end, coverage, farthest nearness, side,
    parts).

    side: 1 or -1, which way most of it faces, 0 if it is of clumps. parts: by how much to multiply coverages of what
    faces ways 1 and -1; the rest is hidden by the other side.
    """
    part = target.part
    total = solid = near = half = front = back = nearer = 0.0
    k = first
    while k < n:
        w, h, c = (
            np.float64(part[j, i, k, NEAR]),
            np.float64(part[j, i, k, HALF]),
            np.float64(part[j, i, k, COVER]),
        )
        if k > first and (near - total * w) > half + total * h:
            break
        total += c
        near += c * w
        half += c * h
        solid += c * np.float64(part[j, i, k, SOLID])
        side = part[j, i, k, SIDE]
        if side > 0:
            front += c
        elif side < 0:
            back += c
        if nearer == 0.0:
            nearer = np.float64(side)
        k += 1
    one, other = 1.0, 1.0
    if front > 0.0 and back > 0.0:
        if nearer > 0.0:
            other = max(back - front, 0.0) / back
        else:
            one = max(front - back, 0.0) / front
    cover = total - front - back + one * front + other * back
    cover += FIRM * max(cover - 0.5, 0.0) * solid / total
    side = 0.0
    if front + back > 0.5 * total:
        side = 1.0 if front > back else -1.0
    return k, min(cover, 1.0), (near - half) / total, side, one, other


@device
def put_behind(clear, cover, side, before, last, last_side):
    """What a surface shows behind another: (share of the cell, what is clear then).

    clear: in front of it; before: in front of the surface before it, whose coverage and side are last, last_side.
    """
    if side * last_side < 0.0:
        rest = before * (1.0 - max(cover, last))
        return clear - rest, rest
    return clear * cover, clear * (1.0 - cover)


@device
def _look_through(target, j, i):
    """Sort a cell, drop what is hidden in it, and note whether it is full; returns the number of its fragments."""
    n = np.int64(target.ids[j, i]) + 1
    sort_cell(target, j, i, n)
    clear, k = 1.0, np.int64(0)
    before, last, last_side = 1.0, 0.0, 0.0
    target.load[j, i] = np.float32(0.5)
    while k < n:
        k, cover, far, side, _, _ = next_surface(target, j, i, k, n)
        front = clear
        _, clear = put_behind(clear, cover, side, before, last, last_side)
        before, last, last_side = front, cover, side
        if clear < FULL:
            target.depth[j, i] = max(np.float32(far), target.depth[j, i])
            target.load[j, i] = np.float32(0)
            n = k
    target.ids[j, i] = n - 1
    return n


@device
def _make_room(target, j, i, n):
    """Join those of a cell's n fragments, in order, that are nearest to each other; returns how many are left."""
    part = target.part
    limit = np.float32(0.25) * (part[j, i, 0, NEAR] - part[j, i, n - 1, NEAR]) / np.float32(n - 1)
    enough = n - n // 4
    for attempt in range(3):  # farther apart the second time, and the third time whichever way they face
        k = to = np.int64(0)
        while k < n:
            if k != to:
                _move(target, j, i, k, to)
            k += 1
            if k < n and part[j, i, to, NEAR] - part[j, i, k, NEAR] <= limit:
                if attempt == 2 or part[j, i, to, SIDE] == part[j, i, k, SIDE]:
                    _join(target, j, i, to, k)
                    k += 1
            to += 1
        n = to
        if n <= enough:
            break
        limit *= np.float32(4)
    return min(n, ROOM - 1)


@device
def _join(target, j, i, k, m):
    """Add a cell's fragment m to its fragment k."""
    part = target.part
    c, d = part[j, i, k, COVER], part[j, i, m, COVER]
    near = (c * part[j, i, k, NEAR] + d * part[j, i, m, NEAR]) / (c + d)
    half = max(part[j, i, k, HALF], part[j, i, m, HALF])
    if d > c:
        _move(target, j, i, m, k)
    part[j, i, k, NEAR], part[j, i, k, HALF], part[j, i, k, COVER] = near, half, c + d


@device
def _insert(target, j, i, entry, near, half, cover, x, y, solid, side):
    """Put a fragment into a cell's list; False: it is hidden."""
    near = np.float32(near)
    half = np.float32(half) + np.float32(0.5) * (target.apart[0] * near + target.apart[1])
    if near + half <= target.depth[j, i] or not near > np.float32(0):
        return False
    n = np.int64(target.ids[j, i]) + 1
    if n == 0:
        target.load[j, i] = np.float32(0)
    if n == ROOM:
        n = _look_through(target, j, i)
        if n == ROOM:
            n = _make_room(target, j, i, n)
    target.entry[j, i, n] = entry
    part = target.part
    part[j, i, n, NEAR], part[j, i, n, HALF], part[j, i, n, COVER] = near, half, min(cover, 1.0)
    part[j, i, n, AT_X] = min(max(x, i + 0.05), i + 0.95)
    part[j, i, n, AT_Y] = min(max(y, j + 0.05), j + 0.95)
    part[j, i, n, SOLID], part[j, i, n, SIDE] = solid, side
    target.ids[j, i] = n
    target.load[j, i] += np.float32(cover)
    if target.load[j, i] >= np.float32(CHECK):
        _look_through(target, j, i)
    return True


@device
def layer_ellipse(target, width, height, x, y, a, b, c, nearness, slope_x, slope_y, entry, area, solid, side):
    """Put an ellipse into the lists, as a Gaussian of its covariance and `area` cells."""
    x, y, nearness, slope_x, slope_y = (
        np.float64(x), np.float64(y), np.float64(nearness), np.float64(slope_x), np.float64(slope_y)
    )  # fmt: skip
    scale = 1.0 / (REACH * REACH)
    own_x, own_y = max(a * scale, 0.0), max(c * scale, 0.0)
    a, b, c = own_x + SIGMA * SIGMA, b * scale, own_y + SIGMA * SIGMA
    det = max(a * c - b * b, 1e-12)
    inverse = 1.0 / det
    gain = area / (2.0 * math.pi * math.sqrt(det) * KEPT)
    if not gain > LEAST:
        return False
    wide, high = CUT * math.sqrt(a), CUT * math.sqrt(c)
    if not (x + wide > 0.0 and y + high > 0.0):
        return False
    x0, y0 = np.int64(max(min(x - wide + 0.5, width), 0.0)), np.int64(max(min(y - high + 0.5, height), 0.0))
    x1, y1 = np.int64(min(x + wide - 0.5, width - 1.0)), np.int64(min(y + high - 0.5, height - 1.0))
    # its range of depth in a cell: no larger than the piece, or the cell
    half = 0.5 * (
        abs(slope_x) * min(1.0, 3.0 * math.sqrt(own_x)) + abs(slope_y) * min(1.0, 3.0 * math.sqrt(own_y))
    )
    pull_x, pull_y = SIGMA * SIGMA / a, SIGMA * SIGMA / c
    most = -2.0 * math.log(LEAST / gain)
    most = min(most, CUT * CUT)
    written = False
    for j in range(y0, y1 + 1):
        dy = j + 0.5 - y
        for i in range(x0, x1 + 1):
            dx = i + 0.5 - x
            square = (c * dx * dx - 2.0 * b * dx * dy + a * dy * dy) * inverse
            if square > most:
                continue
            if _insert(
                target, np.int64(j), np.int64(i), entry, nearness + slope_x * dx + slope_y * dy, half,
                gain * math.exp(-0.5 * square), i + 0.5 - pull_x * dx, j + 0.5 - pull_y * dy, solid, side,
            ):  # fmt: skip
                written = True
    return written


@device
def _share(t):
    """Integral of a parabola over -1..1 up to t, 1 in all."""
    u = min(max(0.5 * t + 0.5, 0.0), 1.0)
    return u * u * (3.0 - 2.0 * u)


@device
def _chords(target, x, y, j):
    """Where the lines of row j of cells cross a triangle, to target.lines; returns how many do."""
    found = np.int64(0)
    for n in range(LINES):
        at = j + 0.5 + SIGMA * PLACES[n]
        left, right = math.inf, -math.inf
        for k in range(3):
            m = k + 1 if k < 2 else 0
            if (y[k] <= at) != (y[m] <= at):
                # from the lower end, whatever triangle the edge belongs to
                p, q = (k, m) if y[k] < y[m] else (m, k)
                cross = x[p] + (at - y[p]) * ((x[q] - x[p]) / (y[q] - y[p]))
                left, right = min(left, cross), max(right, cross)
        target.lines[0, n], target.lines[1, n] = left, right
        if right >= left:
            found += 1
    return found


@device
def _slopes(x, y, w, area):
    """Growth of nearness per cell over a triangle."""
    slope_x = ((w[1] - w[0]) * (y[2] - y[0]) - (w[2] - w[0]) * (y[1] - y[0])) / area
    slope_y = ((w[2] - w[0]) * (x[1] - x[0]) - (w[1] - w[0]) * (x[2] - x[0])) / area
    return slope_x, slope_y


@device
def layer_triangle(target, width, height, x, y, w, entry):
    """Put a triangle into the lists: exact along six lines a row, so that triangles that share an edge sum up."""
    area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    left, right = min(x[0], x[1], x[2]), max(x[0], x[1], x[2])
    low, high = min(y[0], y[1], y[2]), max(y[0], y[1], y[2])
    if area == 0.0 or not (
        right + EDGE > 0.0 and high + EDGE > 0.0 and left < width + EDGE and low < height + EDGE
    ):
        return False
    slope_x, slope_y = _slopes(x, y, w, area)
    least, most = min(w[0], w[1], w[2]), max(w[0], w[1], w[2])
    if high - low < 0.5:  # it may lie between the lines
        mx, my, mw = (x[0] + x[1] + x[2]) / 3.0, (y[0] + y[1] + y[2]) / 3.0, (w[0] + w[1] + w[2]) / 3.0
        a = b = c = 0.0
        for k in range(3):
            dx, dy = x[k] - mx, y[k] - my
            a, b, c = a + dx * dx, b + dx * dy, c + dy * dy
        scale = REACH * REACH / 12.0
        room = 1.0 / max(
            (abs(slope_x) * (right - left) + abs(slope_y) * (high - low)) / max(most - least, 1e-30), 1.0
        )
        return layer_ellipse(
            target, width, height, mx, my, a * scale, b * scale, c * scale, mw, slope_x * room, slope_y * room, entry,
            0.5 * abs(area), np.float32(0), np.float32(1) if area > 0.0 else np.float32(-1),
        )  # fmt: skip
    half = 0.5 * min(abs(slope_x) + abs(slope_y), most - least)
    y0 = np.int64(max(math.ceil(low - EDGE - 0.5), 0.0))
    y1 = np.int64(min(math.floor(high + EDGE - 0.5), height - 1.0))
    side = np.float32(1) if area > 0.0 else np.float32(-1)
    written = False
    for j in range(y0, y1 + 1):
        crossed = _chords(target, x, y, np.int64(j))
        if crossed == 0:
            continue
        begin, end, inner_begin, inner_end = math.inf, -math.inf, -math.inf, math.inf
        for n in range(LINES):
            if target.lines[1, n] >= target.lines[0, n]:
                begin, end = min(begin, target.lines[0, n]), max(end, target.lines[1, n])
                inner_begin, inner_end = (
                    max(inner_begin, target.lines[0, n]),
                    min(inner_end, target.lines[1, n]),
                )
        x0 = np.int64(max(math.ceil(max(begin, -1.0) - EDGE - 0.5), 0.0))
        x1 = np.int64(min(math.floor(min(end, width + 1.0) + EDGE - 0.5), width - 1.0))
        for i in range(x0, x1 + 1):
            centre = i + 0.5
            cover, at = np.float64(crossed) / LINES, centre
            if centre - EDGE < inner_begin or centre + EDGE > inner_end:
                cover = at = 0.0
                for n in range(LINES):
                    p, q = target.lines[0, n], target.lines[1, n]
                    if q >= p:
                        c = _share((q - centre) / EDGE) - _share((p - centre) / EDGE)
                        cover += c
                        at += c * 0.5 * (max(p, centre - 0.5) + min(q, centre + 0.5))
                if not cover > LEAST * LINES:
                    continue
                at /= cover
                cover /= LINES
            near = w[0] + slope_x * (centre - x[0]) + slope_y * (j + 0.5 - y[0])
            if _insert(
                target, np.int64(j), np.int64(i), entry, min(max(near, least), most), half, cover, at,
                min(max(j + 0.5, low), high), np.float32(0), side,
            ):  # fmt: skip
                written = True
    return written


@device
def layer_cut_out(target, width, height, perspective, x, y, w, entry, opacity, mask):
    """Put a triangle with holes into the lists: its mean opacity over 6 x 6 points of each cell."""
    area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    if area == 0.0 or not (max(x[0], x[1], x[2]) + EDGE > 0.0 and min(x[0], x[1], x[2]) < width + EDGE):
        return False
    inverse, side = 1.0 / area, opacity.shape[1]
    slope_x, slope_y = _slopes(x, y, w, area)
    least, most = min(w[0], w[1], w[2]), max(w[0], w[1], w[2])
    half = 0.5 * min(abs(slope_x) + abs(slope_y), most - least)
    y0 = np.int64(max(math.ceil(min(y[0], y[1], y[2]) - EDGE - 0.5), 0.0))
    y1 = np.int64(min(math.floor(max(y[0], y[1], y[2]) + EDGE - 0.5), height - 1.0))
    x0 = np.int64(max(math.ceil(max(min(x[0], x[1], x[2]), -1.0) - EDGE - 0.5), 0.0))
    x1 = np.int64(min(math.floor(min(max(x[0], x[1], x[2]), width + 1.0) + EDGE - 0.5), width - 1.0))
    written = False
    for j in range(y0, y1 + 1):
        for i in range(x0, x1 + 1):
            cover = at_x = at_y = 0.0
            for n in range(LINES):
                yc = j + 0.5 + SIGMA * PLACES[n]
                for m in range(LINES):
                    xc = i + 0.5 + SIGMA * PLACES[m]
                    b1 = ((xc - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (yc - y[0])) * inverse
                    b2 = ((x[1] - x[0]) * (yc - y[0]) - (xc - x[0]) * (y[1] - y[0])) * inverse
                    if b1 < 0.0 or b2 < 0.0 or b1 + b2 > 1.0:
                        continue
                    u, v = b1, b2
                    if perspective:
                        nearness = w[0] + b1 * (w[1] - w[0]) + b2 * (w[2] - w[0])
                        u, v = b1 * w[1] / nearness, b2 * w[2] / nearness
                    p = min(max(np.int64(u * side), np.int64(0)), side - 1)
                    q = min(max(np.int64(v * side), np.int64(0)), side - 1)
                    share = np.float64(opacity[mask, q, p])
                    cover += share
                    at_x += share * xc
                    at_y += share * yc
            if not cover > LEAST * 255.0 * LINES * LINES:
                continue
            near = w[0] + slope_x * (i + 0.5 - x[0]) + slope_y * (j + 0.5 - y[0])
            if _insert(
                target, np.int64(j), np.int64(i), entry, min(max(near, least), most), half,
                cover / (255.0 * LINES * LINES), at_x / cover, at_y / cover, np.float32(0), np.float32(0),
            ):  # fmt: skip
                written = True
    return written


@puts(put_ellipse, Layers)
def _ellipse():
    def draw(target, width, height, x, y, a, b, c, nearness, slope_x, slope_y, entry, opacity, area, phase):
        solid, side = np.float32(1), np.float32(1) if area > np.float32(0) else np.float32(-1)
        if opacity < np.float32(1):
            solid = side = np.float32(0)
        return layer_ellipse(
            target, width, height, np.float64(x), np.float64(y), np.float64(a), np.float64(b), np.float64(c),
            np.float64(nearness), np.float64(slope_x), np.float64(slope_y), entry, np.float64(abs(area)), solid, side,
        )  # fmt: skip

    return draw


@puts(put_triangle, Layers)
def _triangle():
    def draw(target, width, height, x, y, w, entry):
        return layer_triangle(target, width, height, x, y, w, entry)

    return draw


@puts(put_cut_out, Layers)
def _cut_out():
    def draw(target, width, height, perspective, x, y, w, entry, opacity, mask, phase):
        return layer_cut_out(target, width, height, perspective, x, y, w, entry, opacity, mask)

    return draw
