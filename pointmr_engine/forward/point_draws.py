"""Random points of the selected boxes, through a 64-bit depth buffer: what is hidden is never stored.

All boxes, from front to back, lie side by side on one line, each as long as the number of points that it expects. A
block is a piece of that line; its positions are a function of seed and block alone:
random - a fixed number of independent positions for the whole line, shared out among the blocks by the multinomial
distribution; poisson - an independent, Poisson-distributed number in each block (so each box has one, too);
stratified - one position in each unit of length. Each cell of the buffer keeps the largest (inverse depth, number of
the draw), so the outcome does not depend on who draws what when; the winners alone are drawn a second time, with all
that belongs to them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.box_selection import Selection
from pointmr_engine.forward.cut_out_cover import cut_out_of, opacity_at
from pointmr_engine.forward.projection import inverse_depth
from pointmr_engine.forward.transforms import Transforms
from pointmr_engine.hierarchy.distribution import Chain, draw, uniform
from pointmr_engine.numerics.atomics import atomic_max_u64
from pointmr_engine.numerics.hashing import hash_path
from pointmr_engine.numerics.jit import merged, uncounted
from pointmr_engine.numerics.pointers import pointer_f32, pointer_i32

BLOCK = 256  # units of length in a block
PER_BLOCK = 4096  # positions that one can hold: numbers of draws are block * PER_BLOCK + position
MAX_BLOCKS = 1 << 20  # of which 32 bits have room
RANDOM, STRATIFIED = 0, 1
_OPACITY = np.int64(1 << 40)  # number of the random number that decides about transparency
_TAKEN = np.uint64(0xFFFFFFFF)


class World(NamedTuple):
    """What draws read of the scene."""

    octree: NamedTuple  # OctreeArrays
    distribution: NamedTuple  # Distribution
    tables: NamedTuple  # PartTables
    instances: NamedTuple  # BatchTables
    cut_outs: NamedTuple  # CutOuts: points in holes are refused


class Line(NamedTuple):
    """The boxes' places on the line."""

    ends: np.ndarray  # (K + 1,) float64: box k is ends[k]..ends[k + 1]
    counts: np.ndarray  # (B,) int32 positions of each block; unused if stratified
    kind: int  # RANDOM or STRATIFIED
    key: int  # uint64 of the seed
    culling: int  # int64: 1: boxes hidden by what was drawn before are left out


class Scratch(NamedTuple):
    """A thread's working memory."""

    at: np.ndarray  # (PER_BLOCK + 1,) float64
    chain: Chain
    weights: np.ndarray  # (2,) float64
    point: np.ndarray  # (3,) float64: x, y in pixels, inverse depth
    rows: np.ndarray  # (L,) int64


class Points(NamedTuple):
    """Columns of a PointSet while it is made, with the rows of transforms that it adds."""

    x: np.ndarray  # (N,) float32
    y: np.ndarray
    inverse_depth: np.ndarray
    part: np.ndarray  # (N,) int32
    triangle: np.ndarray
    u: np.ndarray  # (N,) float32
    v: np.ndarray
    transform: np.ndarray  # (N,) int32; from `first_new` on: rows of `added`
    added: Transforms


@uncounted
def positions(line: Line, block, at):
    """Fill `at` with a block's positions, rising; returns how many. Past the line's end: infinite."""
    key = hash_path(np.uint64(line.key), block)
    low = np.float64(block) * BLOCK
    total = line.ends[len(line.ends) - 1]
    if line.kind == STRATIFIED:
        n = np.int64(BLOCK)
        for i in range(n):
            x = low + i + uniform(key, np.int64(i))
            at[i] = x if x < total else np.inf
        return n
    n = np.int64(line.counts[block])
    length = min(np.float64(BLOCK), total - low)
    # gaps of an exponential distribution: independent uniform positions, in order
    total = 0.0
    for i in range(n + 1):
        total -= np.log(1.0 - uniform(key, np.int64(i)))
        at[i] = total
    for i in range(n):
        at[i] = min(low + length * (at[i] / total), np.nextafter(low + length, 0.0))
    return n


@uncounted
def _box_at(ends, x, k):
    """The box whose interval holds x, from box k on; k = -1: search."""
    if k < 0:
        low, high = np.int64(0), np.int64(len(ends) - 1)
        while high - low > 1:
            middle = (low + high) >> 1
            if ends[middle] <= x:
                low = middle
            else:
                high = middle
        return low
    while ends[k + 1] <= x:
        k += 1
    return k


@uncounted
def _enter_box(selection, scratch, k):
    chain = scratch.chain
    row = np.int64(selection.boxes.row[k])
    for c in range(12):
        chain.matrix[0, c] = selection.transforms.matrix[row, c]
    chain.group[0] = selection.transforms.group[row]
    chain.scale[0] = selection.scale[row]
    chain.uniform[0] = selection.uniform[row]
    chain.item[0] = -1


@merged
def _draw_point(world, selection, line, scratch, k, x, key):
    """One point of box k: its level in the chain, and scratch.point; -1: refused, clipped or outside the region."""
    octree, view, chain = world.octree, selection.eye, scratch.chain
    camera, weights = view.camera, scratch.weights
    boxes = selection.boxes
    u = (x - line.ends[k]) / (line.ends[k + 1] - line.ends[k])
    level = draw(
        octree, world.distribution, world.tables, world.instances,
        np.int64(boxes.interval[k, 0]), np.int64(boxes.interval[k, 1]), u, key, chain, weights,
    )  # fmt: skip
    if level < 0:
        return level
    i, group = chain.item[level], chain.group[level]
    part, triangle = np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1])
    p, t = pointer_f32(world.tables.positions[part]), pointer_i32(world.tables.triangles[part])
    i0, i1 = 3 * np.int64(t[3 * triangle]), 3 * np.int64(t[3 * triangle + 1])
    i2 = 3 * np.int64(t[3 * triangle + 2])
    w1, w2 = weights[0], weights[1]
    hole = cut_out_of(world.cut_outs, part, triangle)
    if hole >= 0 and uniform(key, _OPACITY) * 255.0 >= opacity_at(world.cut_outs, hole, w1, w2):
        return np.int64(-1)
    w0 = 1.0 - w1 - w2
    a = w0 * p[i0] + w1 * p[i1] + w2 * p[i2]
    b = w0 * p[i0 + 1] + w1 * p[i1 + 1] + w2 * p[i2 + 1]
    c = w0 * p[i0 + 2] + w1 * p[i1 + 2] + w2 * p[i2 + 2]
    a += octree.part_offset[part, 0] - octree.group_center[group, 0]
    b += octree.part_offset[part, 1] - octree.group_center[group, 1]
    c += octree.part_offset[part, 2] - octree.group_center[group, 2]
    m = chain.matrix
    z = m[level, 8] * a + m[level, 9] * b + m[level, 10] * c + m[level, 11]
    if z < camera.clip[0] or z > camera.clip[1] or (camera.perspective[0] and z <= 0.0):
        return np.int64(-1)
    px = m[level, 0] * a + m[level, 1] * b + m[level, 2] * c + m[level, 3]
    py = m[level, 4] * a + m[level, 5] * b + m[level, 6] * c + m[level, 7]
    if camera.perspective[0]:
        px /= z
        py /= z
    px = (px - camera.plane[0, 0]) / camera.plane[1, 0]
    py = (py - camera.plane[0, 1]) / camera.plane[1, 1]
    # as it will be stored: rounding must not carry the only point of a pixel into the next
    px, py = np.float64(np.float32(px)), np.float64(np.float32(py))
    region = view.region
    if not (region[0] <= px < region[2] and region[1] <= py < region[3]):
        return np.int64(-1)
    if view.limits[4] != 0.0 and _faces_away(m, level, p, i0, i1, i2, a, b, c, camera.perspective[0]):
        return np.int64(-1)
    scratch.point[0] = px
    scratch.point[1] = py
    scratch.point[2] = inverse_depth(camera, z)
    return level


@uncounted
def _faces_away(m, row, p, i0, i1, i2, a, b, c, perspective):
    """Whether a triangle, (a, b, c) a point of it in its group, shows its back."""
    ux, uy, uz = p[i1] - p[i0], p[i1 + 1] - p[i0 + 1], p[i1 + 2] - p[i0 + 2]
    vx, vy, vz = p[i2] - p[i0], p[i2 + 1] - p[i0 + 1], p[i2 + 2] - p[i0 + 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    # the view's direction in the group: the eye solves m * eye = 0, and n * (p - eye) = n * inverse(m) * (m p)
    m00, m01, m02 = m[row, 0], m[row, 1], m[row, 2]
    m10, m11, m12 = m[row, 4], m[row, 5], m[row, 6]
    m20, m21, m22 = m[row, 8], m[row, 9], m[row, 10]
    c00, c01, c02 = m11 * m22 - m12 * m21, m12 * m20 - m10 * m22, m10 * m21 - m11 * m20
    c10, c11, c12 = m21 * m02 - m22 * m01, m22 * m00 - m20 * m02, m20 * m01 - m21 * m00
    c20, c21, c22 = m01 * m12 - m02 * m11, m02 * m10 - m00 * m12, m00 * m11 - m01 * m10
    # the normal in camera space, times the determinant
    x = c00 * nx + c01 * ny + c02 * nz
    y = c10 * nx + c11 * ny + c12 * nz
    z = c20 * nx + c21 * ny + c22 * nz
    det = m00 * c00 + m01 * c01 + m02 * c02
    toward = z
    if perspective:
        toward = x * (m00 * a + m01 * b + m02 * c + m[row, 3])
        toward += y * (m10 * a + m11 * b + m12 * c + m[row, 7])
        toward += z * (m20 * a + m21 * b + m22 * c + m[row, 11])
    return toward * det >= 0.0


@uncounted
def _cell(view, cells, px, py):
    """Cell of a point in the buffer, rows from the bottom."""
    width = (view.region[2] - view.region[0]) * cells
    cx = min(np.int64((px - view.region[0]) * cells), width - 1)
    cy = min(np.int64((py - view.region[1]) * cells), (view.region[3] - view.region[1]) * cells - 1)
    return cy * width + cx


@uncounted
def _hidden(selection, cells, buffer, k):
    """Whether all cells that box k may touch hold something nearer than all of it."""
    rectangle, region = selection.boxes.rectangle, selection.eye.region
    width = (region[2] - region[0]) * cells
    nearest = np.uint64(np.float32(selection.boxes.nearest[k]).view(np.uint32))
    x0, x1 = (rectangle[k, 0] - region[0]) * cells, (rectangle[k, 2] - region[0]) * cells
    for y in range((rectangle[k, 1] - region[1]) * cells, (rectangle[k, 3] - region[1]) * cells):
        for cell in range(y * width + x0, y * width + x1):
            if buffer[cell] >> np.uint64(32) <= nearest:
                return False
    return True


@uncounted
def draw_blocks(
    world: World, selection: Selection, line: Line, cells, buffer, address, scratch: Scratch, start, stop
):
    """Draw the blocks start..stop into `buffer`; returns the number of points drawn.

    buffer: (cells,) uint64, rows from the bottom, at `address`: the bits of the largest inverse depth, and below them
    those of the draw's number, inverted; `cells` of them to a pixel's side. Threads share it: updates are atomic, and a
    box is left out when what happens to be there already hides it, which changes nothing but the work.
    """
    drawn = np.int64(0)
    for block in range(start, stop):
        n = positions(line, np.int64(block), scratch.at)
        key = hash_path(np.uint64(line.key), np.int64(-2 - block))
        k, entered, hidden = np.int64(-1), np.int64(-1), False
        for i in range(n):
            x = scratch.at[i]
            if x == np.inf:
                break
            k = _box_at(line.ends, x, k)
            if k != entered:
                entered = k
                hidden = line.culling != 0 and _hidden(selection, cells, buffer, k)
                if not hidden:
                    _enter_box(selection, scratch, k)
            if hidden:
                continue
            drawn += 1
            if _draw_point(world, selection, line, scratch, k, x, hash_path(key, np.int64(i))) < 0:
                continue
            cell = _cell(selection.eye, cells, scratch.point[0], scratch.point[1])
            bits = np.float32(scratch.point[2]).view(np.uint32)
            number = _TAKEN - np.uint64(block * PER_BLOCK + i + 1)
            value = (np.uint64(bits) << np.uint64(32)) | number
            if value > buffer[cell]:
                atomic_max_u64(address, cell, value)
    return drawn


@uncounted
def resolve(world, selection, line, numbers, start, stop, scratch: Scratch, out: Points):
    """Draw the winners numbers[start:stop] (rising int64) again and fill rows 0.. of `out`; returns the rows added.

    Transforms of placements inside boxes are added to out.added, numbered from the number of the selection's rows on.
    """
    chain = scratch.chain
    known = np.int64(len(selection.scale))
    rows, block, count = np.int64(0), np.int64(-1), np.int64(0)
    depth, key = (
        np.int64(0),
        np.uint64(0),
    )  # depth: levels of the last point's chain, whose rows are in scratch.rows
    for n in range(start, stop):
        at = n - start
        if numbers[n] // PER_BLOCK != block:
            block = numbers[n] // PER_BLOCK
            count = positions(line, block, scratch.at)
            key = hash_path(np.uint64(line.key), -2 - block)
        i = numbers[n] - block * PER_BLOCK
        if i >= count:
            return np.int64(-1)
        x = scratch.at[i]
        k = _box_at(line.ends, x, np.int64(-1))
        # unlike the drawing, each point begins anew: rows must be those of its own chain
        _enter_box(selection, scratch, k)
        level = _draw_point(world, selection, line, scratch, k, x, hash_path(key, i))
        row = np.int64(selection.boxes.row[k])
        for d in range(level):
            item = chain.item[d]
            record = (
                world.instances.first_record[-1 - world.octree.item[item, 0]] + world.octree.item[item, 1]
            )
            if d < depth:  # neighbours mostly come through the same placements
                last = scratch.rows[d]
                if out.added.record[last] == record and out.added.parent[last] == row:
                    row = known + last
                    continue
            for c in range(12):
                out.added.matrix[rows, c] = chain.matrix[d + 1, c]
            out.added.parent[rows] = row
            out.added.record[rows] = record
            out.added.group[rows] = chain.group[d + 1]
            scratch.rows[d] = rows
            depth = d + 1
            row = known + rows
            rows += 1
        item = chain.item[level]
        out.x[at] = scratch.point[0]
        out.y[at] = scratch.point[1]
        out.inverse_depth[at] = scratch.point[2]
        out.part[at] = world.octree.item[item, 0]
        out.triangle[at] = world.octree.item[item, 1]
        out.u[at] = scratch.weights[0]
        out.v[at] = scratch.weights[1]
        out.transform[at] = row
    return rows
