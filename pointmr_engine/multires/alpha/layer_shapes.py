"""What a walk draws into the lists of `a_buffer`: ellipses, triangles, and triangles with holes, as coverages of cells.

Registered with forward.targets: a walk whose target is a_buffer.Layers draws with these.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.drawing.cut_out_cover import cell_of, place_in
from pointmr_engine.forward.drawing.surfel_lanes import REACH
from pointmr_engine.forward.drawing.targets import put_cut_out, put_ellipse, put_triangle, puts
from pointmr_engine.multires.alpha.a_buffer import LEAST, LINES, Layers, insert
from pointmr_engine.numerics.jit import device

SIGMA = 0.3  # cells: of a cell's Gaussian
CUT = 2.5  # standard deviations at which Gaussians end
KEPT = 1.0 - math.exp(-0.5 * CUT * CUT)  # of their integral
EDGE = math.sqrt(5.0) * SIGMA  # half a parabola of equal variance, which weighs triangles along rows
# middles of sixths of a normal distribution, spread to its variance
PLACES = (-1.5424, -0.7522, -0.2347, 0.2347, 0.7522, 1.5424)


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
            if insert(
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
            if insert(
                target, np.int64(j), np.int64(i), entry, min(max(near, least), most), half, cover, at,
                min(max(j + 0.5, low), high), np.float32(0), side,
            ):  # fmt: skip
                written = True
    return written


@device
def layer_cut_out(target, width, height, perspective, x, y, w, at, entry, cells, start, side):
    """Put a triangle with holes into the lists: its mean opacity over 6 x 6 points of each cell."""
    area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    if area == 0.0 or not (max(x[0], x[1], x[2]) + EDGE > 0.0 and min(x[0], x[1], x[2]) < width + EDGE):
        return False
    inverse = 1.0 / area
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
                    nearness = w[0] + b1 * (w[1] - w[0]) + b2 * (w[2] - w[0])
                    u, v = place_in(at, w, b1, b2, nearness if perspective else 0.0)
                    p, q = cell_of(u, v, side)
                    share = np.float64(cells[start + q * side + p])
                    cover += share
                    at_x += share * xc
                    at_y += share * yc
            if not cover > LEAST * 255.0 * LINES * LINES:
                continue
            near = w[0] + slope_x * (i + 0.5 - x[0]) + slope_y * (j + 0.5 - y[0])
            if insert(
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
    def draw(target, width, height, perspective, x, y, w, at, entry, cells, start, side, key):
        return layer_cut_out(target, width, height, perspective, x, y, w, at, entry, cells, start, side)

    return draw
