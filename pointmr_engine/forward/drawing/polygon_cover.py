"""Convex polygons clipped by each other, and the exact areas of polygons in the cells of a lattice."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import device, uncounted

CORNERS = 12  # of a clipped triangle, with room to spare: 3, 2 more for the clip planes, 4 for the image
LEAST = 1e-9  # pixels of area: what rounding leaves where polygons touch
TIE = 1e-9  # relative difference of nearness that counts as none
_NOTHING = 1e-9  # of a cell


class Shares(NamedTuple):
    """What of a tile's cells shows which fragment, in the order of fragments."""

    cell: np.ndarray  # (S, 2) int32: x, y
    fragment: np.ndarray  # (S,) int32
    area: np.ndarray  # (S,) float32 of the cell


@device
def _cut(points, n, a, b, c, out):
    """Clip a convex polygon, points[:n] (x, y), to a x + b y + c >= 0, into out; returns its number of corners."""
    count = np.int64(0)
    for k in range(n):
        j = k + 1 if k + 1 < n else 0
        d = a * points[k, 0] + b * points[k, 1] + c
        e = a * points[j, 0] + b * points[j, 1] + c
        if d >= 0.0:
            out[count, 0], out[count, 1] = points[k, 0], points[k, 1]
            count += 1
        if (d > 0.0 and e < 0.0) or (d < 0.0 and e > 0.0):
            t = d / (d - e)
            out[count, 0] = points[k, 0] + t * (points[j, 0] - points[k, 0])
            out[count, 1] = points[k, 1] + t * (points[j, 1] - points[k, 1])
            count += 1
    return count


@device
def _area(points, n):
    total = 0.0
    for k in range(2, n):
        ax, ay = points[k - 1, 0] - points[0, 0], points[k - 1, 1] - points[0, 1]
        total += 0.5 * (ax * (points[k, 1] - points[0, 1]) - ay * (points[k, 0] - points[0, 0]))
    return total


@uncounted
def clip_to_rectangle(polygons, corners, rectangle, work):
    """Clip convex polygons (K, CORNERS, 2), corners (K,) int64 of each, to (x0, y0, x1, y1).

    They run counter-clockwise afterwards; what is smaller than LEAST gets no corners. work (CORNERS + 1, 2).
    """
    for k in range(len(corners)):
        n = corners[k]
        p = polygons[k]
        n = _cut(p, n, 1.0, 0.0, -rectangle[0], work)
        n = _cut(work, n, 0.0, 1.0, -rectangle[1], p)
        n = _cut(p, n, -1.0, 0.0, rectangle[2], work)
        n = _cut(work, n, 0.0, -1.0, rectangle[3], p)
        area = _area(p, n)
        if area < 0.0:
            for i in range(n // 2):
                for c in range(2):
                    p[i, c], p[n - 1 - i, c] = p[n - 1 - i, c], p[i, c]
        corners[k] = n if abs(area) > LEAST else 0


@uncounted
def hiding_pieces(polygons, corners, planes, behind, before, pieces, count, work):
    """For each pair (behind[k], before[k]) the convex piece of polygon `before` that hides `behind`.

    planes (T, 3): nearness = p[0] + p[1] x + p[2] y of each polygon. pieces (K, 2 CORNERS + 1, 2), count (K,) int64:
    filled; 0 corners: hides nothing. work: (2 CORNERS + 1, 2). Of two in one plane, the one listed first is the nearer.
    """
    for k in range(len(behind)):
        i, j = behind[k], before[k]
        out = pieces[k]
        n = corners[j]
        for v in range(n):
            out[v, 0], out[v, 1] = polygons[j, v, 0], polygons[j, v, 1]
        for v in range(corners[i]):
            u = v + 1 if v + 1 < corners[i] else 0
            x, y = polygons[i, v, 0], polygons[i, v, 1]
            a, b = y - polygons[i, u, 1], polygons[i, u, 0] - x  # inside is to the left
            n = _cut(out, n, a, b, -a * x - b * y, work)
            for w in range(n):
                out[w, 0], out[w, 1] = work[w, 0], work[w, 1]
        count[k] = 0
        if n < 3 or _area(out, n) <= LEAST:
            continue
        c = planes[j, 0] - planes[i, 0]
        a, b = planes[j, 1] - planes[i, 1], planes[j, 2] - planes[i, 2]
        most, size = 0.0, 0.0
        for v in range(n):
            most = max(most, abs(a * out[v, 0] + b * out[v, 1] + c))
            size = max(size, abs(planes[i, 0] + planes[i, 1] * out[v, 0] + planes[i, 2] * out[v, 1]))
        if most <= TIE * size:
            count[k] = n if j < i else 0
            continue
        n = _cut(out, n, a, b, c, work)
        for w in range(n):
            out[w, 0], out[w, 1] = work[w, 0], work[w, 1]
        if n >= 3 and _area(out, n) > LEAST:
            count[k] = n


@device
def _add_run(sums, y, xa, xb, d, width):
    """An edge inside row y from xa to xb whose signed height is d: area to its right, as differences along the row."""
    if xa > xb:
        xa, xb = xb, xa
    if xb <= 0.0:
        sums[y, 0] += d
        return
    if xa >= width:
        return
    length = xb - xa
    if xa < 0.0:
        left = d * (-xa / length)
        sums[y, 0] += left
        d -= left
        length = xb
        xa = 0.0
    if xb > width:
        d *= (width - xa) / length
        xb = np.float64(width)
        length = xb - xa
    first, last = np.int64(math.floor(xa)), np.int64(math.floor(xb))
    if first >= width:
        return
    if first == last or length <= 0.0:
        middle = 0.5 * (xa + xb) - first
        sums[y, first] += d * (1.0 - middle)
        sums[y, first + 1] += d * middle
        return
    x = xa
    for i in range(first, last + 1):
        end = min(i + 1.0, xb)
        if end > x:
            part = d * (end - x) / length
            middle = 0.5 * (x + end) - i
            sums[y, i] += part * (1.0 - middle)
            sums[y, i + 1] += part * middle
        x = end


@uncounted
def add_polygon(edges, first, last, left, low, scale, width, height, sums):
    """Add the edges first..last (x0, y0, x1, y1) in pixels, `scale` cells each, to a tile's `sums` (height, width + 2).

    Sums along a row then give the exact area of the polygon in each cell. Outer rings run counter-clockwise, inner ones
    clockwise.
    """
    for k in range(first, last):
        x0, y0 = edges[k, 0] * scale - left, edges[k, 1] * scale - low
        x1, y1 = edges[k, 2] * scale - left, edges[k, 3] * scale - low
        sign = -1.0
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
            sign = 1.0
        if y1 <= 0.0 or y0 >= height or y0 == y1:
            continue
        slope = (x1 - x0) / (y1 - y0)
        for j in range(np.int64(math.floor(max(y0, 0.0))), np.int64(min(math.ceil(y1), np.float64(height)))):
            a, b = max(y0, np.float64(j)), min(y1, j + 1.0)
            if b > a:
                _add_run(sums, j, x0 + (a - y0) * slope, x0 + (b - y0) * slope, sign * (b - a), width)


@uncounted
def show_polygons(
    edges, first_edge, bounds, items, rows, left, low, width, height, cells, sums, target, covered, empty, entries,
    fragments, shares,
):  # fmt: skip
    """Fragments of a tile, one per polygon and pixel: how many, and the numbers of entries and shares (-1: no room).

    edges (E, 4) of polygon t from first_edge[t] on; bounds (T, 4) in pixels; items (T,) int32 of the octree, rows (T,)
    int32 of the transforms. cells: per side of a pixel. sums (height, width + 2) zero; covered (height, width) filled:
    the covered area of each cell; target.ids: the fragment that has most of a cell; empty (rows, columns) uint8: pixels
    that are not covered whole.
    """
    count, used, total = np.int64(0), np.int64(0), np.int64(0)
    for y in range(height):
        for x in range(width):
            covered[y, x] = 0.0
    for t in range(len(rows)):
        x0 = np.int64(max(math.floor(bounds[t, 0] * cells - left), 0.0)) // cells * cells
        y0 = np.int64(max(math.floor(bounds[t, 1] * cells - low), 0.0)) // cells * cells
        x1 = np.int64(min(math.ceil(bounds[t, 2] * cells - left), np.float64(width)))
        y1 = np.int64(min(math.ceil(bounds[t, 3] * cells - low), np.float64(height)))
        if first_edge[t] == first_edge[t + 1] or x0 >= x1 or y0 >= y1:
            continue
        add_polygon(edges, first_edge[t], first_edge[t + 1], left, low, cells, width, height, sums)
        for y in range(y0, y1):
            area = 0.0
            for x in range(x1):
                area += sums[y, x]
                sums[y, x] = area
            sums[y, x1] = sums[y, x1 + 1] = 0.0
        before = count
        for top in range(y0, y1, cells):
            for side in range(x0, x1, cells):
                mean_x = mean_y = weight = 0.0
                for y in range(top, min(top + cells, y1)):
                    for x in range(side, min(side + cells, x1)):
                        area = min(sums[y, x], 1.0)
                        if area <= _NOTHING:
                            continue
                        if total >= len(shares.fragment):
                            return count, used, np.int64(-1)
                        shares.cell[total, 0], shares.cell[total, 1] = x, y
                        shares.fragment[total] = count
                        shares.area[total] = area
                        total += 1
                        weight += area
                        mean_x += area * (x + 0.5)
                        mean_y += area * (y + 0.5)
                        covered[y, x] += area
                        if area > target.depth[y, x]:
                            target.depth[y, x] = area
                            target.ids[y, x] = count
                if weight > 0.0:
                    fragments.entry[count] = used
                    fragments.x[count] = mean_x / weight
                    fragments.y[count] = mean_y / weight
                    fragments.count[count] = 1
                    count += 1
        for y in range(y0, y1):
            for x in range(x1):
                sums[y, x] = 0.0
        if count > before:
            entries.surfel[used] = -1 - 2 * np.int64(items[t])
            entries.row[used] = rows[t]
            used += 1
    for y in range(0, height, cells):
        for x in range(0, width, cells):
            gap = np.uint8(0)
            for j in range(y, y + cells):
                for i in range(x, x + cells):
                    if covered[j, i] < 1.0 - 1e-6:
                        gap = np.uint8(1)
                    if covered[j, i] < 0.5:
                        target.ids[j, i] = -1
            empty[y // cells, x // cells] = gap
    return count, used, total


@device
def _spread(x, y, cells, taps, weight, a, b, c, d, out):
    """Add weight * (a, b, c, d) of a cell to the pixels whose taps reach it."""
    n = len(taps)
    for q in range(max((y - n) // cells + 1, 0), min(y // cells, out.shape[0] - 1) + 1):
        wy = weight * taps[y - q * cells]
        for p in range(max((x - n) // cells + 1, 0), min(x // cells, out.shape[1] - 1) + 1):
            w = wy * taps[x - p * cells]
            out[q, p, 0] += w * a
            out[q, p, 1] += w * b
            out[q, p, 2] += w * c
            out[q, p, 3] += w * d


@uncounted
def filter_shares(shares: Shares, used, values, covered, width, height, background, cells, taps, out):
    """Add to pixels (h, w, 4) float64 shares 0..used with their fragments' values (F, 3), and the background behind."""
    for k in range(used):
        f = shares.fragment[k]
        _spread(
            np.int64(shares.cell[k, 0]), np.int64(shares.cell[k, 1]), cells, taps, np.float64(shares.area[k]),
            np.float64(values[f, 0]), np.float64(values[f, 1]), np.float64(values[f, 2]), 1.0, out,
        )  # fmt: skip
    for y in range(height):
        for x in range(width):
            left = 1.0 - covered[y, x]
            if left > 0.0:
                b = background[y // cells, x // cells]
                _spread(
                    np.int64(x), np.int64(y), cells, taps, left,
                    np.float64(b[0]), np.float64(b[1]), np.float64(b[2]), np.float64(b[3]), out,
                )  # fmt: skip
