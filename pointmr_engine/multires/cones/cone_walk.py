"""What of cones is blocked: a walk through nested instances that leaves a mask of 64 sub-rays.

Triangles larger than the cells between sub-rays are met exactly; what is smaller is drawn as prefiltered points.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.hierarchy.acceleration import EMPTY, Acceleration
from pointmr_engine.hierarchy.prefilter import Prefiltered
from pointmr_engine.multires.cones.cone_space import (
    BOTTOM,
    FLAGS,
    KIND,
    LEVELS,
    SEED,
    Style,
    allocate,
    append,
    scene_of,
    set_cone,
    set_constants,
)
from pointmr_engine.multires.cones.cones import Cones
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.pointers import load_f32, load_f64, load_i32, load_i64, load_u8
from pointmr_engine.numerics.simd import BLOCK_FLOATS, trailing_zeros
from pointmr_engine.numerics.simd_cone import (
    COLUMNS,
    CONSTANTS,
    FRONT,
    LINES,
    OPACITY,
    cone_boxes,
    cone_points,
    cone_triangles,
    ellipse_mask,
    patch_mask,
    triangle_mask,
)
from pointmr_engine.raytracing.walk import child_group, combined_flags
from pointmr_engine.scene.group import VISIBLE

ALL = np.int64(-1)
# counters
NODES, POINTS, BLOCKS, TRIANGLES, ENTERED, COUNTERS = 0, 1, 2, 3, 4, 5


@device
def point_mask(ellipses, lane):
    """(sub-rays that a point may cover, the share of these that it does cover).

    Of a surface those that meet its piece of plane, else those in its ellipse.
    """
    opacity = load_f32(ellipses, 8 * OPACITY + lane)
    if opacity > np.float32(1.5):
        return patch_mask(ellipses, lane), opacity - np.float32(2)
    return ellipse_mask(ellipses, lane), opacity


@device
def dithered(s, covered, opacity, key):
    """The share `opacity` of the sub-rays `covered`, chosen by `key`."""
    if opacity >= np.float32(1):
        return covered
    h = (key * 0x9E3779B1) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 0x85EBCA6B) & 0xFFFFFFFF
    h ^= h >> 13
    level = np.int64(opacity * np.float32(LEVELS) + np.float32(h & 0xFFFF) * np.float32(1.0 / 65536.0))
    return covered & load_i64(s.dither, ((h >> 16) & 63) * (LEVELS + 1) + level)


@device
def seen_by(s, node, bits, flags, wanted):
    """Of the children in `bits` of a group's node, (those that have something to show, those that show all)."""
    some, every = np.int64(0), np.int64(0)
    while bits != 0:
        lane = trailing_zeros(bits)
        bits &= bits - 1
        if (load_u8(s.some, 8 * node + lane) & flags & wanted) != 0:
            some |= np.int64(1) << lane
            if (load_u8(s.every, 8 * node + lane) & flags & wanted) != 0:
                every |= np.int64(1) << lane
    return some, every


@device
def triangle_opacity(w, s, part, triangle):
    """Opacity of a triangle of a part, from its material."""
    whole = load_f32(s.part_opacity, part)
    if whole >= np.float32(0):
        return whole
    materials, first = load_i64(w.part_material_index, part), load_i32(w.part_first_triangle, part)
    slot = load_i32(materials, triangle - first)
    slot = min(max(slot, np.int64(0)), load_i32(w.part_slots, part) - 1)
    return load_f32(s.slot_opacity, load_i32(w.part_first_slot, part) + slot)


@device
def corner(w, matrix, level, part, at):
    """Corner of a triangle, in cone space and double precision; at: of its x in the blocks."""
    x = np.float64(load_f32(w.blocks, at)) + load_f64(w.part_center, 3 * part)
    y = np.float64(load_f32(w.blocks, at + 8)) + load_f64(w.part_center, 3 * part + 1)
    z = np.float64(load_f32(w.blocks, at + 16)) + load_f64(w.part_center, 3 * part + 2)
    return (
        matrix[level, 0] * x + matrix[level, 1] * y + matrix[level, 2] * z + matrix[level, 3],
        matrix[level, 4] * x + matrix[level, 5] * y + matrix[level, 6] * z + matrix[level, 7],
        matrix[level, 8] * x + matrix[level, 9] * y + matrix[level, 10] * z + matrix[level, 11],
    )


@device
def plane_of(w, matrix, level, part, block, lane):
    """(normal x, y, z, offset) of a triangle's plane in cone space."""
    at = BLOCK_FLOATS * block + lane
    ax, ay, az = corner(w, matrix, level, part, at)
    bx, by, bz = corner(w, matrix, level, part, at + 24)
    cx, cy, cz = corner(w, matrix, level, part, at + 48)
    bx, by, bz, cx, cy, cz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    return nx, ny, nz, nx * ax + ny * ay + nz * az


@device
def meeting(plane, cones, n, bit):
    """t at which sub-ray `bit` of cone n meets a plane of cone space."""
    u, v = ((bit & 7) + 0.5) * 0.25 - 1.0, ((bit >> 3) + 0.5) * 0.25 - 1.0
    along = plane[0] * u * cones.spread[n, 0] + plane[1] * v * cones.spread[n, 1] + plane[2]
    return (plane[3] - plane[0] * u * cones.start[n, 0] - plane[1] * v * cones.start[n, 1]) / along


@device
def between_ends(plane, cones, n, bits):
    """Of the sub-rays in `bits`, those that meet a plane between t_min and t_max."""
    kept = np.int64(0)
    while bits != 0:
        bit = trailing_zeros(bits)
        bits &= bits - 1
        t = meeting(plane, cones, n, bit)
        if t > cones.t_min[n] and t < cones.t_max[n]:
            kept |= np.int64(1) << bit
    return kept


@device
def enter(w, s, levels, scratch, cones, n, style, level, item, wanted, sp):
    """Step into an item of the group at `level`: (the level that the walk is at now, a node to be visited or EMPTY)."""
    state, depth = levels.state, levels.depth
    group = ~state[level, KIND]
    record = load_i32(w.item_record, item)
    flags, below, seed = state[level, FLAGS], depth[level], state[level, SEED]
    part = np.int64(-1)
    if record < 0:
        part = ~record
        for k in range(12):
            levels.matrix[level + 1, k] = levels.matrix[level, k]
    else:
        batch = load_i32(w.item_batch, item)
        i = record - load_i64(w.first_record, batch)
        flags = combined_flags(w, batch, i, flags)
        if (flags & wanted) == 0:
            return level, np.int64(EMPTY)
        append(levels, level, load_i64(w.transforms, batch), i)
        group = child_group(w, batch, i)
        part = load_i32(w.group_part, group)
        levels.chain[below, 0] = record
        levels.chain[below, 1] = batch
        below += 1
        seed = (seed * 31 + record + 1) & 0xFFFFFF
    level += 1
    state[level, FLAGS], state[level, BOTTOM], state[level, SEED], depth[level] = flags, sp, seed, below
    if part >= 0:
        state[level, KIND] = part
        node = load_i32(w.part_root, part)
        if node >= 0:
            set_constants(
                levels, level, scratch.constants, w.part_center, w.part_radius, part, cones, n, style
            )
        return level, node
    state[level, KIND] = ~group
    node = load_i32(w.group_root, group)
    if node >= 0:
        set_constants(
            levels, level, scratch.constants, w.group_center, w.group_radius, group, cones, n, style
        )
    return level, node


@device
def usable(cones, n):
    """False for a cone that has values that are not finite, or that ends before it begins."""
    total = 0.0
    for k in range(3):
        total += cones.origin[n, k]
        for r in range(3):
            total += cones.axes[n, r, k]
    total += cones.start[n, 0] + cones.start[n, 1] + cones.spread[n, 0] + cones.spread[n, 1]
    return np.isfinite(total) and cones.t_min[n] < cones.t_max[n]


@device
def begin(w, levels, scratch, cones, n, style):
    """Set level 0 to the root group for cone n; returns the group's first node."""
    state, group = levels.state, np.int64(w.root)
    set_cone(levels, cones, n)
    state[0, KIND], state[0, FLAGS], state[0, BOTTOM], state[0, SEED] = ~group, VISIBLE, 0, 0
    levels.depth[0] = 0
    node = load_i32(w.group_root, group)
    if node >= 0:
        set_constants(
            levels, np.int64(0), scratch.constants, w.group_center, w.group_radius, group, cones, n, style
        )
    return node


@device
def push_boxes(w, s, scratch, node, bits, done, offset, sp):
    """Push the children `bits` of a node that sub-rays other than `done` may meet, the nearest on top; returns sp.

    offset: t of what the boxes' fronts, in scratch.boxes, are about.
    """
    stack, fronts, first = scratch.stack, scratch.fronts, sp
    while bits != 0:
        lane = trailing_zeros(bits)
        bits &= bits - 1
        columns = np.int64(load_f32(scratch.boxes, 8 * COLUMNS + lane))
        lines = np.int64(load_f32(scratch.boxes, 8 * LINES + lane))
        rays = load_i64(s.columns, columns) & load_i64(s.lines, lines)
        if rays & ~done == 0:
            continue
        front = np.float32(load_f32(scratch.boxes, 8 * FRONT + lane) + offset)
        j = sp
        while j > first and fronts[j - 1] < front:
            stack[j, 0], stack[j, 1], fronts[j] = stack[j - 1, 0], stack[j - 1, 1], fronts[j - 1]
            j -= 1
        stack[j, 0] = load_i32(w.children, 8 * node + lane)
        stack[j, 1] = rays
        fronts[j] = front
        sp += 1
    return sp


@uncounted
def _visible(w, s, cones, masks, counters, levels, scratch, style, start, stop):
    """The walk for cones[start:stop]; masks: int64."""
    stack, state = scratch.stack, levels.state
    for n in range(start, stop):
        masks[n] = 0
        if not usable(cones, n):
            continue
        mask, wanted = np.int64(0), np.int64(cones.visibility[n]) & VISIBLE
        level, sp = np.int64(0), np.int64(0)
        node = begin(w, levels, scratch, cones, n, style)
        while True:
            if node >= 0:
                counters[NODES] += 1
                at = scratch.constants + 4 * CONSTANTS * level
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
                        covered, opacity = point_mask(scratch.ellipses, lane)
                        covered &= ~mask
                        if covered != 0:
                            mask |= dithered(s, covered, opacity, 8 * node + lane + 977 * state[level, SEED])
                sp = push_boxes(w, s, scratch, node, bits, mask, 0.0, sp)
            elif node != EMPTY:
                part = state[level, KIND]
                if part < 0:
                    counters[ENTERED] += 1
                    level, node = enter(w, s, levels, scratch, cones, n, style, level, ~node, wanted, sp)
                    if node != EMPTY:
                        continue
                else:
                    block = ~node
                    counters[BLOCKS] += 1
                    at = scratch.constants + 4 * CONSTANTS * level
                    bits = cone_triangles(w.blocks, block, at, scratch.triangles)
                    beyond, bits = bits >> 8, bits & 255
                    while bits != 0:
                        lane = trailing_zeros(bits)
                        bits &= bits - 1
                        counters[TRIANGLES] += 1
                        covered = triangle_mask(scratch.triangles, lane) & ~mask
                        if covered != 0 and (beyond >> lane) & 1 != 0:
                            plane = plane_of(w, levels.matrix, level, part, block, lane)
                            covered = between_ends(plane, cones, n, covered)
                        if covered != 0 and s.clear != 0:
                            triangle = load_i32(w.block_triangles, 8 * block + lane)
                            key = triangle + 977 * state[level, SEED]
                            covered = dithered(s, covered, triangle_opacity(w, s, part, triangle), key)
                        mask |= covered
            if mask == ALL:
                break
            node = np.int64(EMPTY)
            while True:
                if sp > state[level, BOTTOM]:
                    sp -= 1
                    if stack[sp, 1] & ~mask != 0:
                        node = stack[sp, 0]
                        break
                elif level > 0:
                    level -= 1
                else:
                    break
            if node == EMPTY:
                break
        masks[n] = mask


def visible(
    acceleration: Acceleration,
    prefiltered: Prefiltered,
    cones: Cones,
    masks: np.ndarray,
    counters: np.ndarray | None = None,
    start: int = 0,
    stop: int | None = None,
    style: Style = Style(),  # noqa: B008  (immutable)
) -> None:
    """masks[start:stop] = the sub-rays of cones[start:stop] that are blocked between t_min and t_max, as bits.

    masks (N,) uint64; counters (COUNTERS,) int64, added to. Releases the GIL; may run in several threads at once on
    disjoint ranges (with counters of their own). A cone that is not finite, or empty, is not blocked.
    """
    levels, scratch = allocate(acceleration)
    counters = np.zeros(COUNTERS, np.int64) if counters is None else counters
    stop = len(cones.origin) if stop is None else stop
    _visible(
        acceleration.pointers, scene_of(prefiltered), cones, masks.view(np.int64), counters, levels, scratch, style,
        start, stop,
    )  # fmt: skip
