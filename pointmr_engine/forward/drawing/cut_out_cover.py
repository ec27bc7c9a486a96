"""Drawing triangles with holes into a tile's subpixels."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.baked.opacity_lattice import sample_place
from pointmr_engine.forward.drawing.subpixel_places import INNER, place_of
from pointmr_engine.numerics.hashing import hash_u32
from pointmr_engine.numerics.jit import device, uncounted

OPAQUE = 192  # of 255: from here on a sample counts as opaque ...
HOLE = 32  # ... and below, as a hole, whose colour is anybody's guess (CutOuts.seen)
BESIDE = 2  # cells that an outline is wide
FAR = 128  # cells: farther from what is seen no fragment lies
SURE = 0.75  # of a cell's opacity: a place in it that is less opaque lies in a hole between the samples
DITHERED = 64.0  # cells of a dither, so many shares of which can be drawn (numerics.dither)
EDGE = 1e-12  # barycentric: what is so near an edge belongs to the triangles on both sides


@device
def cut_out_of(cut_outs, part, triangle):
    """Row of the opacity of a part's triangle, -1 if it is opaque."""
    first = cut_outs.first[part]
    if first < 0:
        return np.int64(-1)
    return np.int64(cut_outs.mask[first + triangle])


@device
def holes_of(cut_outs, part, triangle):
    """`cut_out_of`, but -1 also if the triangle is as opaque all over: such have no holes."""
    mask = cut_out_of(cut_outs, part, triangle)
    return np.int64(-1) if mask >= 0 and cut_outs.even[mask] else mask


@device
def cell_of(u, v, side):
    """(p, q): the cell of barycentric weights u, v of vertices 1 and 2."""
    p = min(max(np.int64(u * side), np.int64(0)), side - 1)
    return p, min(max(np.int64(v * side), np.int64(0)), side - 1)


@device
def place_in(at, w, b1, b2, nearness):
    """(u, v) where the weights of a drawn piece's corners 1 and 2 are b1 and b2; at, w: see cover_cut_out; nearness:
    there, 0 where nothing is foreshortened."""
    if nearness > 0.0:
        b1, b2 = b1 * w[1] / nearness, b2 * w[2] / nearness
    (u0, v0), (u1, v1), (u2, v2) = at
    return u0 + b1 * (u1 - u0) + b2 * (u2 - u0), v0 + b1 * (v1 - v0) + b2 * (v2 - v0)


@device
def opacity_at(cut_outs, mask, u, v):
    """Opacity, of 255, at barycentric weights u and v of vertices 1 and 2."""
    side = cut_outs.side[mask]
    p, q = cell_of(u, v, side)
    return np.float64(cut_outs.cells[cut_outs.start[mask] + q * side + p])


@device
def _order_at(key, i, j, front):
    """(place of the first row of an order in Target.pattern, what x and y are turned by), of the block of (i, j).

    Chosen anew in every block, lest two triangles that share one do so throughout; never the same for fronts and backs,
    which are the two sides of a pane.
    """
    h = hash_u32(np.uint32(key) ^ hash_u32(np.uint32(((j >> 3) << 16) + (i >> 3))))
    order = np.int64(h >> np.uint32(6)) & 6
    if front:
        order += 1
    return 8 * order, np.int64(h) & 7, np.int64(h >> np.uint32(3)) & 7


@device
def cover_cut_out(target, width, height, perspective, x, y, w, at, entry, cells, start, side, key):
    """Draw a triangle as subpixels.cover_triangle does, but where its cells leave holes; whether anything was written.

    x, y: corners in subpixels of the tile; w: their nearness, 1 / depth in perspective; at: for each its barycentric
    weights (u, v) in the triangle whose opacity the cells are (CutOuts: cells, start, side); key uint32: its, where it
    is placed.
    """
    area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    if area == 0.0 or max(x[0], x[1], x[2]) < 0.0 or min(x[0], x[1], x[2]) > width:
        return False
    inverse = 1.0 / area
    low, high = min(y[0], y[1], y[2]), max(y[0], y[1], y[2])
    left, right = min(x[0], x[1], x[2]), max(x[0], x[1], x[2])
    if high < INNER or right < INNER:
        return False
    y0, x0 = np.int64(max(low + INNER, 0.0)), np.int64(max(left + INNER, 0.0))
    y1, x1 = np.int64(min(high - INNER, height - 1.0)), np.int64(min(right - INNER, width - 1.0))
    written = False
    for j in range(y0, y1 + 1):
        row = turn_x = turn_y = np.int64(0)
        for i in range(x0, x1 + 1):
            if i == x0 or i & 7 == 0:
                row, turn_x, turn_y = _order_at(key, i, j, area > 0.0)
            xc, yc = place_of(target.shift, i, j)
            b1 = ((xc - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (yc - y[0])) * inverse
            b2 = ((x[1] - x[0]) * (yc - y[0]) - (xc - x[0]) * (y[1] - y[0])) * inverse
            if b1 < -EDGE or b2 < -EDGE or b1 + b2 > 1.0 + EDGE:
                continue
            nearness = w[0] + b1 * (w[1] - w[0]) + b2 * (w[2] - w[0])
            if not nearness > target.depth[j, i]:
                continue
            u, v = place_in(at, w, b1, b2, nearness if perspective else 0.0)
            p, q = cell_of(u, v, side)
            if (
                cells[start + q * side + p]
                > 255.0 * target.pattern[row + ((j ^ turn_y) & 7), (i ^ turn_x) & 7]
            ):
                target.depth[j, i] = nearness
                target.ids[j, i] = entry
                written = True
    return written


@device
def nearest_as_opaque(cells, start, side, u, v, least, rings):
    """(p, q): the nearest cell to the place (u, v), in cells, that is at least `least` opaque, of 255; (-1, -1) where
    none of its own and of `rings` squares of cells about that is."""
    i, j = min(np.int64(u), side - 1), min(np.int64(v), side - 1)
    best, bi, bj = math.inf, np.int64(-1), np.int64(-1)
    for ring in range(min(rings + 1, side)):
        if (ring - 1.0) * (ring - 1.0) > best:
            break
        for q in range(max(j - ring, 0), min(j + ring, side - 1) + 1):
            step = 1 if q == j - ring or q == j + ring else 2 * ring
            for p in range(i - ring, i + ring + 1, max(step, 1)):
                if p < 0 or p + q >= side or np.int64(cells[start + q * side + p]) < least:
                    continue
                dx, dy = p + 1.0 / 3.0 - u, q + 1.0 / 3.0 - v
                d = dx * dx + dy * dy
                if d < best:
                    best, bi, bj = d, p, q
    return bi, bj


@device
def _beside_hole(cells, start, side, seen, p, q):
    """Whether one of the cells about (p, q), BESIDE away at most, is a hole."""
    for j in range(max(q - BESIDE, 0), min(q + BESIDE, side - 1) + 1):
        for i in range(max(p - BESIDE, 0), min(p + BESIDE, side - 1 - j) + 1):
            if cells[start + j * side + i] < seen:
                return True
    return False


@uncounted
def move_to_opaque(cut_outs, fragments, first, count):
    """Move the places of fragments first..first + count out of holes: to the sample of the nearest cell in which
    something is seen, and on to an opaque one where an outline lies between, for a cell that it crosses is half a hole.
    What is half transparent has a colour of its own, and stays. fragments: Fragments.
    """
    cells = cut_outs.cells
    for k in range(first, first + count):
        mask = holes_of(cut_outs, np.int64(fragments.part[k]), np.int64(fragments.triangle[k]))
        if mask < 0:
            continue
        start, side, seen = np.int64(cut_outs.start[mask]), np.int64(cut_outs.side[mask]), cut_outs.seen[mask]
        u, v = np.float64(fragments.place[k, 0]), np.float64(fragments.place[k, 1])
        p, q = cell_of(u, v, side)
        if cells[start + q * side + p] >= OPAQUE:
            continue
        u, v = side * u, side * v  # in cells
        moved = cells[start + q * side + p] < seen
        if moved:
            p, q = nearest_as_opaque(cells, start, side, u, v, seen, FAR)
            if p < 0:
                continue
            u, v = p + 1.0 / 3.0, q + 1.0 / 3.0
        if moved or _beside_hole(cells, start, side, seen, p, q):
            i, j = nearest_as_opaque(cells, start, side, u, v, OPAQUE, BESIDE)
            if i >= 0:
                moved, p, q = True, i, j
        if moved:
            fragments.place[k, 0], fragments.place[k, 1] = sample_place(mask, p, q, side)


@uncounted
def with_holes(cut_outs, fragments, first, count, out):
    """Write those of the fragments first..first + count that are of triangles with holes to out (count,); how many."""
    n = np.int64(0)
    for k in range(first, first + count):
        if holes_of(cut_outs, np.int64(fragments.part[k]), np.int64(fragments.triangle[k])) >= 0:
            out[n] = k
            n += 1
    return n


@uncounted
def move_to_samples(cut_outs, fragments, rows, opacity):
    """Move the places of the fragments `rows` (n,) int64 to the samples of their cells, where they are much less opaque
    than these: opacity (n,) at the places, 0..1."""
    for n in range(len(rows)):
        k = rows[n]
        mask = cut_out_of(cut_outs, np.int64(fragments.part[k]), np.int64(fragments.triangle[k]))
        u, v = np.float64(fragments.place[k, 0]), np.float64(fragments.place[k, 1])
        if opacity[n] * 255.0 < SURE * opacity_at(cut_outs, mask, u, v):
            side = np.int64(cut_outs.side[mask])
            p, q = cell_of(u, v, side)
            fragments.place[k, 0], fragments.place[k, 1] = sample_place(mask, p, q, side)


@uncounted
def let_through(cut_outs, fragments, first, count, out):
    """out (N,) float32: the share that coverage lets through at the places of fragments first..first + count.

    Opacity is drawn in steps of a cell of the dither. Who lies in a hole was drawn by a cell beside it.
    """
    for k in range(count):
        f = first + k
        mask = cut_out_of(cut_outs, np.int64(fragments.part[f]), np.int64(fragments.triangle[f]))
        out[k] = 0.0
        if mask >= 0:
            u, v = np.float64(fragments.place[f, 0]), np.float64(fragments.place[f, 1])
            drawn = math.ceil(opacity_at(cut_outs, mask, u, v) * (DITHERED / 255.0) - 0.5)
            out[k] = 1.0 - (drawn if drawn > 0 else HOLE * (DITHERED / 255.0)) / DITHERED
