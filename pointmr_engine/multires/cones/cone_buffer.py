"""The nearest of what a cone meets: a walk through nested instances that fills a depth buffer of 64 sub-rays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.acceleration import EMPTY
from pointmr_engine.multires.cones.cone_space import BOTTOM, FLAGS, KIND, SEED
from pointmr_engine.multires.cones.cone_walk import (
    BLOCKS,
    ENTERED,
    NODES,
    POINTS,
    TRIANGLES,
    begin,
    dithered,
    enter,
    meeting,
    plane_of,
    point_mask,
    push_boxes,
    seen_by,
    triangle_opacity,
)
from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.pointers import load_f32, load_i32
from pointmr_engine.numerics.simd import trailing_zeros
from pointmr_engine.numerics.simd_cone import (
    CONSTANTS,
    DEPTH,
    cone_boxes,
    cone_points,
    cone_triangles,
    triangle_mask,
)
from pointmr_engine.numerics.simd_cover import farthest_row
from pointmr_engine.scene.group import VISIBLE

ENTRIES = 4096  # what may become the nearest somewhere in one cone


class Buffer(NamedTuple):
    """The nearest of what one cone meets."""

    nearness: np.ndarray  # (64,) float32, -t
    address: int
    owner: np.ndarray  # (64,) int32 entry
    # (ENTRIES, 3) int64: 8 * block + lane, or ~(8 * node + lane) of a point; place; part or -1
    entry: np.ndarray
    plane: np.ndarray  # (ENTRIES, 4) float64: normal and offset of a triangle's plane in cone space
    place_matrix: np.ndarray  # (ENTRIES, 12) float64: cone_from_local
    place_chain: np.ndarray  # (ENTRIES, levels, 2) int64
    place_length: np.ndarray  # (ENTRIES,) int64
    level_place: np.ndarray  # (levels,) int64: the place of a level of the walk, or -1
    used: np.ndarray  # (2,) int64: entries, places


def allocate_buffer(depth: int) -> Buffer:
    """Working memory of one call; depth: levels of the walk."""
    nearness = np.empty(64, np.float32)
    return Buffer(
        nearness,
        nearness.ctypes.data,
        np.zeros(64, np.int32),
        np.empty((ENTRIES, 3), np.int64),
        np.zeros((ENTRIES, 4)),
        np.empty((ENTRIES, 12)),
        np.empty((ENTRIES, depth, 2), np.int64),
        np.empty(ENTRIES, np.int64),
        np.full(depth, -1, np.int64),
        np.zeros(2, np.int64),
    )


@device
def _snapshot(levels, level, buffer):
    """Index of the place of a level: its matrix and the instances above, kept."""
    place = buffer.level_place[level]
    if place >= 0:
        return place
    place = buffer.used[1]
    buffer.used[1] += 1
    for k in range(12):
        buffer.place_matrix[place, k] = levels.matrix[level, k]
    length = levels.depth[level]
    for k in range(length):
        buffer.place_chain[place, k, 0] = levels.chain[k, 0]
        buffer.place_chain[place, k, 1] = levels.chain[k, 1]
    buffer.place_length[place] = length
    buffer.level_place[level] = place
    return place


@device
def _record(levels, level, buffer, element):
    """Make an entry; the next one's number is its own until `used` grows."""
    k = buffer.used[0]
    buffer.entry[k, 0] = element
    buffer.entry[k, 1] = _snapshot(levels, level, buffer)
    part = levels.state[level, KIND]
    buffer.entry[k, 2] = part if part >= 0 else -1
    buffer.used[0] += 1


@device
def _draw_point(levels, level, buffer, element, covered, t):
    """A point at one depth into the buffer; returns the sub-rays that it is the nearest of."""
    w = np.float32(-t)
    k, won = np.int32(buffer.used[0]), np.int64(0)
    while covered != 0:
        bit = trailing_zeros(covered)
        covered &= covered - 1
        if w > buffer.nearness[bit]:
            buffer.nearness[bit], buffer.owner[bit] = w, k
            won |= np.int64(1) << bit
    if won != 0:
        _record(levels, level, buffer, element)
    return won


@device
def _draw_triangle(levels, level, buffer, element, covered, plane, cones, n):
    """A triangle into the buffer; returns the sub-rays that it is the nearest of."""
    k, won = buffer.used[0], np.int64(0)
    while covered != 0:
        bit = trailing_zeros(covered)
        covered &= covered - 1
        t = meeting(plane, cones, n, bit)
        if t > cones.t_min[n] and t < cones.t_max[n] and np.float32(-t) > buffer.nearness[bit]:
            buffer.nearness[bit], buffer.owner[bit] = np.float32(-t), np.int32(k)
            won |= np.int64(1) << bit
    if won != 0:
        for c in range(4):
            buffer.plane[k, c] = plane[c]
        _record(levels, level, buffer, element)
    return won


@device
def fill(w, s, cones, n, counters, levels, scratch, style, buffer, most):
    """Fill the buffer for cone n; returns (the sub-rays that meet something, whether that is all).

    It is not where more than `most` boxes, or ENTRIES, would have to be looked at: some rays cost less then.
    """
    stack, fronts, state = scratch.stack, scratch.fronts, levels.state
    mask, wanted = np.int64(0), np.int64(cones.visibility[n]) & VISIBLE
    for bit in range(64):
        buffer.nearness[bit] = -np.float32(np.inf)
    buffer.used[0], buffer.used[1] = 0, 0
    level, sp = np.int64(0), np.int64(0)
    buffer.level_place[0] = -1
    node = begin(w, levels, scratch, cones, n, style)
    last = counters[NODES] + most
    while True:
        if counters[NODES] > last or buffer.used[0] > ENTRIES - 16:
            return mask, False
        if node >= 0:
            counters[NODES] += 1
            at = scratch.constants + 4 * CONSTANTS * level
            offset = levels.offset[level]
            bits = cone_boxes(w.boxes, node, at, scratch.boxes)
            small, bits = bits >> 8, bits & 255
            if s.mixed != 0 and state[level, KIND] < 0:
                bits, every = seen_by(s, node, bits, state[level, FLAGS], wanted)
                small &= every
            if small != 0:
                bits &= ~small
                small &= cone_points(s.points, w.boxes, node, at, scratch.ellipses)
                while small != 0:
                    lane = trailing_zeros(small)
                    small &= small - 1
                    counters[POINTS] += 1
                    element = 8 * node + lane
                    covered, opacity = point_mask(scratch.ellipses, lane)
                    covered = dithered(s, covered, opacity, element + 977 * state[level, SEED])
                    if covered != 0:
                        t = load_f32(scratch.ellipses, 8 * DEPTH + lane) + offset
                        mask |= _draw_point(levels, level, buffer, ~element, covered, t)
            sp = push_boxes(w, s, scratch, node, bits, np.int64(0), offset, sp)
        elif node != EMPTY:
            part = state[level, KIND]
            if part < 0:
                counters[ENTERED] += 1
                above = level
                level, node = enter(w, s, levels, scratch, cones, n, style, level, ~node, wanted, sp)
                if level > above:
                    buffer.level_place[level] = -1
                if node != EMPTY:
                    continue
            else:
                block = ~node
                counters[BLOCKS] += 1
                at = scratch.constants + 4 * CONSTANTS * level
                bits = cone_triangles(w.blocks, block, at, scratch.triangles) & 255
                while bits != 0:
                    lane = trailing_zeros(bits)
                    bits &= bits - 1
                    counters[TRIANGLES] += 1
                    covered = triangle_mask(scratch.triangles, lane)
                    if covered != 0 and s.clear != 0:
                        triangle = load_i32(w.block_triangles, 8 * block + lane)
                        key = triangle + 977 * state[level, SEED]
                        covered = dithered(s, covered, triangle_opacity(w, s, part, triangle), key)
                    if covered != 0:
                        plane = plane_of(w, levels.matrix, level, part, block, lane)
                        mask |= _draw_triangle(
                            levels, level, buffer, 8 * block + lane, covered, plane, cones, n
                        )
        node = np.int64(EMPTY)
        while True:
            if sp > state[level, BOTTOM]:
                sp -= 1
                rays = stack[sp, 1]
                if rays & ~mask == 0:
                    # all that may meet it have met something: is it in front of the farthest of that?
                    low = trailing_zeros(rays) & 56
                    high = 8 + _highest_line(rays)
                    far = farthest_row(np.uint64(buffer.address), low, high - low, np.float32(np.inf))
                    if -fronts[sp] <= far:
                        continue
                node = stack[sp, 0]
                break
            elif level > 0:
                level -= 1
            else:
                break
        if node == EMPTY:
            return mask, True


@device
def _highest_line(rays):
    """8 times the last line that has a bit."""
    line = np.int64(56)
    while line > 0 and (rays >> line) & 255 == 0:
        line -= 8
    return line
