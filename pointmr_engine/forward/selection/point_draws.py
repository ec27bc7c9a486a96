"""Random points of a box, drawn into a tile as discs: what is hidden is never stored.

A node's surface lies on a line, in the octree's order, as long as the number of points that it expects. Points are a
function of the seed, the placement and the node alone, so neighbouring tiles see the same ones. random: a Poisson
process, whose gaps are independent and exponential (a box has a Poisson-distributed number of independent points, and
they come in order: one sweep instead of many searches); stratified: one point in each unit of length. A point is
dropped if something nearer is drawn at its subpixel; else it is a small disc in the plane of its triangle, round in the
image (talk: "Dynamic Sampling").
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.drawing.cut_out_cover import cut_out_of, opacity_at
from pointmr_engine.forward.drawing.draw import plane_of, to_target, triangle_to_camera
from pointmr_engine.forward.drawing.subpixels import cover_ellipse, cover_run
from pointmr_engine.forward.drawing.transforms import box_to_camera
from pointmr_engine.forward.selection.box_heap import bound_in_tile, is_behind
from pointmr_engine.hierarchy.distribution import (
    BELOW_ONE,
    NEW,
    TRIANGLE,
    Chain,
    allocate_chain,
    place,
    step,
    uniform,
)
from pointmr_engine.numerics.hashing import hash_path
from pointmr_engine.numerics.jit import device

CULLED = 128.0  # subpixels: placements whose bounds are no larger are left out where they are hidden
STEEP = 4.0  # depth over width of the steepest disc: triangles seen edge-on would reach to the eye
NO_ENTRY, NO_ROW = -1, -2  # of draw_box: what ran out
INSIDE, ACROSS, OUTSIDE = 0, 1, 2  # of a placement in a tile
# counters: points drawn; those that were the nearest so far; those that ended above a placement which cannot be seen
DRAWN, POINTS, UNSEEN = 3, 4, 8
_OPACITY = np.int64(1 << 40)  # number of the random number that decides about transparency


class World(NamedTuple):
    """What draws read of the scene."""

    octree: NamedTuple  # OctreeArrays
    distribution: NamedTuple  # Distribution
    corners: np.ndarray  # (M, 9) float32 of the octree's items: octree.triangle_corners
    parts: NamedTuple  # PartTables
    instances: NamedTuple  # BatchTables
    cut_outs: NamedTuple  # CutOuts: points in holes are refused


class Draws(NamedTuple):
    """How densely and in which way an image is sampled; lengths in subpixels."""

    density: float  # points per subpixel that a surface covers
    ratio: float  # (z_max / z_min)^2 of a box that is sampled at one density, at most: 1 + epsilon
    kept: float  # points: triangles that expect more are drawn as triangles
    wide: float  # larger boxes are not sampled as a whole, for small ones are hidden as a whole more often
    tiny: float  # a box whose sides look no longer is sampled as a whole whatever its depths ...
    most: float  # ... by so many points at most, however much surface is folded into it
    radius: float  # of a point's disc; 0: the subpixel that it lies in is all that it shows
    stratified: bool  # else random
    backface_culling: bool


class Placed(NamedTuple):
    """What is known of the transforms' rows besides their matrices."""

    scale: np.ndarray  # (R,) float64: how much the matrix stretches at most, nearly
    area: np.ndarray  # (R,) float64: bound of the factor by which it scales areas ...
    even: np.ndarray  # (R,) bool: ... which is exact
    key: np.ndarray  # (R,) uint64: of the random numbers


def allocate_placed(rows: int) -> Placed:
    """Room for so many rows, undefined."""
    return Placed(np.empty(rows), np.empty(rows), np.empty(rows, np.bool_), np.empty(rows, np.uint64))


class Pen(NamedTuple):
    """A thread's working memory."""

    chain: Chain
    weights: np.ndarray  # (2,) float64
    rows: np.ndarray  # (L,) int64 of the transforms, of the placements that the last point lies in
    bounds: np.ndarray  # (L, 5) float64 of these: x0, y0, x1, y1 subpixels of the tile; least depth
    outcome: np.ndarray  # (L,) int64: INSIDE, ACROSS or OUTSIDE, where these bounds lie
    box: np.ndarray  # (6,) float64
    corners: np.ndarray  # (3, 3) float64


def allocate_pen(levels: int) -> Pen:
    """Working memory for groups nested `levels` deep."""
    n = levels + 2
    return Pen(
        allocate_chain(levels), np.empty(2), np.empty(n, np.int64), np.empty((n, 5)), np.empty(n, np.int64),
        np.empty(6), np.empty((3, 3)),
    )  # fmt: skip


@device
def faces_away(view, corners, m, row):
    """Whether the triangle with these corners in camera space, carried there by m[row], shows its back."""
    x, y, z = plane_of(corners)
    toward = x * corners[0, 0] + y * corners[0, 1] + z * corners[0, 2] if view.perspective else z
    # the product has turned over with the matrix (always by the camera's z, which points into the scene)
    det = m[row, 0] * (m[row, 5] * m[row, 10] - m[row, 6] * m[row, 9])
    det -= m[row, 1] * (m[row, 4] * m[row, 10] - m[row, 6] * m[row, 8])
    det += m[row, 2] * (m[row, 4] * m[row, 9] - m[row, 5] * m[row, 8])
    return toward * det >= 0.0


@device
def _slopes(view, corners, x, y, z):
    """Growth of nearness per subpixel of the triangle's plane through (x, y, z), no steeper than STEEP."""
    nx, ny, nz = plane_of(corners)
    if view.perspective:
        d = nx * x + ny * y + nz * z
        most_x, most_y = STEEP / (z * view.scale_x), STEEP / (z * view.scale_y)
    else:
        d = nz / view.depth_scale
        most_x, most_y = STEEP * view.depth_scale / view.scale_x, STEEP * view.depth_scale / view.scale_y
    if d == 0.0:
        return 0.0, 0.0
    a, b = nx / (d * view.scale_x), ny / (d * view.scale_y)
    steep = max(abs(a) / most_x, abs(b) / most_y, 1.0)
    return a / steep, b / steep


@device
def _row_of(pen, octree, instances, transforms, row, level, known, used):
    """The transforms' row of the last draw's placement, `level` levels below `row`; -1: no room.

    Rows are added where the draw before came through other placements, of which `known` are in pen.rows. used (K,)
    int64: the rows are used[1].
    """
    chain = pen.chain
    for d in range(level):
        item = chain.item[d]
        record = instances.first_record[-1 - octree.item[item, 0]] + octree.item[item, 1]
        if d < known:
            last = pen.rows[d]
            if transforms.record[last] == record and transforms.parent[last] == row:
                row = last
                continue
        new = used[1]
        if new >= len(transforms.record):
            return np.int64(-1)
        for c in range(12):
            transforms.matrix[new, c] = chain.matrix[d + 1, c]
        transforms.parent[new] = row
        transforms.record[new] = record
        transforms.group[new] = chain.group[d + 1]
        pen.rows[d] = new
        known = d + 1
        used[1] += 1
        row = new
    return row


@device
def _bound(view, octree, pen, level, left, low, width, height, radius, culling):
    """Note where the placement of a level of the chain lies in the tile, discs about its points included."""
    box_to_camera(
        pen.chain.matrix, level, octree.box, np.int64(octree.group_root[pen.chain.group[level]]), pen.box
    )
    b = pen.bounds[level]
    if not bound_in_tile(
        view, pen.box, 0.0, left - radius, low - radius, width + 2.0 * radius, height + 2.0 * radius, b
    ):
        pen.outcome[level] = OUTSIDE
        return
    for k in range(4):
        b[k] -= radius
    b[4] = pen.box[2]
    inside = b[0] >= 0.0 and b[1] >= 0.0 and b[2] < width and b[3] < height
    # points beside the tile are never hidden, for their discs may reach into it
    pen.outcome[level] = INSIDE if culling and inside and (b[2] - b[0]) * (b[3] - b[1]) <= CULLED else ACROSS


@device
def _descend(view, target, width, height, left, low, world, how, pen, u, key, culling, counters):
    """As distribution.draw, but a draw ends (-1) where the placement that it enters cannot be seen."""
    octree, chain = world.octree, pen.chain
    level, share = np.int64(0), 1.0
    while True:
        met, u, share = step(octree, world.distribution, world.instances, level, u, share, key, chain)
        if met == TRIANGLE:
            break
        level += 1
        if met == NEW:
            _bound(view, octree, pen, level, left, low, width, height, how.radius, culling)
        b, unseen = pen.bounds[level], pen.outcome[level] == OUTSIDE
        if pen.outcome[level] == INSIDE:
            unseen = is_behind(view, target, width, height, b[0], b[1], b[2], b[3], b[4])
        if unseen:
            counters[UNSEEN] += 1
            return np.int64(-1)
    return level if place(octree, world.parts, level, u, key, chain, pen.weights) else np.int64(-1)


@device
def draw_box(
    view, target, width, height, left, low, world, how, pen, transforms, placed, row, first, end, expected, key,
    entries, used, culling, counters,
):  # fmt: skip
    """Draw the points of a node, the items first..end, of which so many are expected.

    key: uint64 of the node in its placement; culling: as of sample_tile. used (K,) int64: entries and rows of the
    transforms, both advanced.
    Returns NO_ENTRY or NO_ROW where there is no more room, else 0.
    """
    octree, chain, weights = world.octree, pen.chain, pen.weights
    m = chain.matrix
    for c in range(12):
        m[0, c] = transforms.matrix[row, c]
    chain.group[0] = transforms.group[row]
    chain.scale[0] = placed.area[row]
    chain.uniform[0] = placed.even[row]
    chain.item[0], chain.items[0, 0], chain.items[0, 1] = -1, first, end
    inverse = 1.0 / expected
    spread = hash_path(key, np.int64(-2))
    number, at, known = np.int64(-1), 0.0, np.int64(0)
    while True:
        number += 1
        if how.stratified:
            at = number + uniform(key, number)
        else:
            at -= math.log(1.0 - uniform(key, number))
        # where the last unit is not whole, a point in it is as probable as it is long
        if at >= expected:
            return np.int64(0)
        counters[DRAWN] += 1
        random = hash_path(spread, number)
        u = min(at * inverse, BELOW_ONE)
        level = _descend(
            view, target, width, height, left, low, world, how, pen, u, random, culling, counters
        )
        if level < 0:
            continue
        i = chain.item[level]
        w1, w2 = weights[0], weights[1]
        w0 = 1.0 - w1 - w2
        p = world.corners
        a = w0 * p[i, 0] + w1 * p[i, 3] + w2 * p[i, 6]
        b = w0 * p[i, 1] + w1 * p[i, 4] + w2 * p[i, 7]
        c = w0 * p[i, 2] + w1 * p[i, 5] + w2 * p[i, 8]
        z = m[level, 8] * a + m[level, 9] * b + m[level, 10] * c + m[level, 11]
        if z < view.near or z > view.far:
            continue
        x = m[level, 0] * a + m[level, 1] * b + m[level, 2] * c + m[level, 3]
        y = m[level, 4] * a + m[level, 5] * b + m[level, 6] * c + m[level, 7]
        px, py, w = to_target(view, x, y, z)
        px -= left
        py -= low
        if px < -how.radius or py < -how.radius or px > width + how.radius or py > height + how.radius:
            continue
        column, line = np.int64(math.floor(px)), np.int64(math.floor(py))
        inside = 0 <= column < width and 0 <= line < height
        if inside and np.float32(w) <= target.depth[line, column]:
            continue
        hole = cut_out_of(world.cut_outs, np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1]))
        if hole >= 0 and uniform(random, _OPACITY) * 255.0 >= opacity_at(world.cut_outs, hole, w1, w2):
            continue
        triangle_to_camera(m, level, world.corners, i, pen.corners)
        if how.backface_culling and faces_away(view, pen.corners, m, level):
            continue
        entry = used[0]
        if entry >= len(entries.surfel):
            return np.int64(NO_ENTRY)
        written = False
        if how.radius > 0.0:
            slope_x, slope_y = _slopes(view, pen.corners, x, y, z)
            square = how.radius * how.radius
            written = cover_ellipse(
                target, width, height, px, py, square, 0.0, square, w, slope_x, slope_y, entry, 2.0, np.int64(0),
            )  # fmt: skip
        if inside and cover_run(target, line, column, column, w, 0.0, entry, 2.0, np.int64(0)):
            written = True
        if written:
            at_row = _row_of(pen, octree, world.instances, transforms, row, level, known, used)
            if at_row < 0:
                return np.int64(NO_ROW)
            known = max(known, level)
            entries.surfel[entry] = -2 - 2 * i  # one fragment, wherever it is visible
            entries.row[entry] = at_row
            used[0] = entry + 1
            counters[POINTS] += 1
