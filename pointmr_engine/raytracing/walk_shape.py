"""The walk below one mesh part: boxes and triangles in its own single precision space."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.intersect import (
    edge_met_exactly,
    localize,
    plane_distance,
    point_distance,
    shear_of,
)
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.pointers import (
    load_f32,
    load_f64,
    load_i8,
    load_i32,
    load_i64,
    load_u8,
    prefetch,
    store_f32,
    store_i32,
)
from pointmr_engine.numerics.simd import slab_test, trailing_zeros, triangle_test
from pointmr_engine.raytracing.walk_veils import note

BLOCKED = -2  # Hits.triangle of a shadow ray that an opaque triangle stops
MISS = -1
CLEAR, SOLID = 1, 2  # what is known of a point of a triangle


@uncounted
def push_children(mask, node, children, entry, stack, stack_t, sp):
    """Of the children in `mask` (not 0), the nearest is returned and the others pushed, nearest on top.

    entry[child] is the distance at which its box is met; all arrays by address. Returns (child, the stack's height).
    """
    i = trailing_zeros(mask)
    mask &= mask - 1
    nearest = load_i32(children, 8 * node + i)
    if mask == 0:
        return nearest, sp
    near_t = load_f32(entry, i)
    bottom = sp
    while mask != 0:
        i = trailing_zeros(mask)
        mask &= mask - 1
        child, t = load_i32(children, 8 * node + i), load_f32(entry, i)
        if t < near_t:
            child, nearest = nearest, child
            t, near_t = near_t, t
        j = sp
        while j > bottom:
            above = load_f32(stack_t, j - 1)
            if above >= t:
                break
            store_i32(stack, j, np.int32(load_i32(stack, j - 1)))
            store_f32(stack_t, j, above)
            j -= 1
        store_i32(stack, j, np.int32(child))
        store_f32(stack_t, j, t)
        sp += 1
    return nearest, sp


@uncounted
def is_opaque(w, part, triangle):
    """True where nothing behind this triangle of a part can be seen."""
    whole = load_i8(w.part_opaque, part)
    if whole >= 0:
        return whole == 1
    materials, first = load_i64(w.part_material_index, part), load_i32(w.part_first_triangle, part)
    slot = load_i32(materials, triangle - first)
    slot = min(max(slot, np.int64(0)), load_i32(w.part_slots, part) - 1)
    return load_u8(w.slot_opaque, load_i32(w.part_first_slot, part) + slot) != 0


@uncounted
def known_opacity(w, part, triangle, u, v):
    """Whether all light (CLEAR) or none (SOLID) passes this triangle of a part at weights u, v of vertices 1 and 2.

    0 where that is not known without asking its material.
    """
    if w.cell_side == 0 or load_i64(w.cell_first, part) < 0:
        return np.int64(0)
    own = triangle - load_i32(w.part_first_triangle, part)
    row = load_i32(w.cell_row, load_i64(w.cell_first, part) + own)
    if row < 0:
        return np.int64(0)
    p = min(max(np.int64(u * w.cell_side), np.int64(0)), w.cell_side - 1)
    q = min(max(np.int64(v * w.cell_side), np.int64(0)), w.cell_side - 1)
    clear, solid = load_i64(w.cell_bits, 2 * (row + q)), load_i64(w.cell_bits, 2 * (row + q) + 1)
    return ((clear >> p) & 1) * CLEAR + ((solid >> p) & 1) * SOLID


@uncounted
def _distance(w, block, lane, u, v, ox, oy, oz, dx, dy, dz, length, pad, t_min, t_max):
    """Distance, in float64, of a triangle that a ray meets at weights u, v. pad: what single precision errs by."""
    t = point_distance(w.blocks, block, lane, u, v, ox, oy, oz, dx, dy, dz)
    # the plane's distance is exact for this very ray, unless it grazes and so leaves the triangle within rounding
    plane = plane_distance(w.blocks, block, lane, ox, oy, oz, dx, dy, dz)
    if abs(plane - t) * length <= 8.0 * pad and plane > t_min and plane < t_max:
        return plane
    return t


@uncounted
def walk_shape(
    w, part, ox, oy, oz, dx, dy, dz, t_min, t_max, skip, any_hit, scratch, sp, veils, ray, chain, below
):
    """Closest hit of a ray in the part's own space, nearer than t_max: (triangle or -1, t, u, v).

    `skip` is a triangle that is not hit. With any_hit, (BLOCKED, t, ...) as soon as an opaque triangle is met before
    t_max[0]; the others before t_max[1], but for what is clear, are noted in the ray's veils (veils.note), and -1 is
    returned. Without, t_max[0] = t_max[1]. The stack is free from sp. chain, below: instances walked down so far.
    """
    node = load_i32(w.part_root, part)
    ox -= load_f64(w.part_center, 3 * part)
    oy -= load_f64(w.part_center, 3 * part + 1)
    oz -= load_f64(w.part_center, 3 * part + 2)
    length, shift, pad, origin, direction, near, scale, shift_near, shift_far = localize(
        ox, oy, oz, dx, dy, dz, load_f64(w.part_radius, part)
    )
    axes, o, shear = (np.int64(0), np.int64(1), np.int64(2)), origin, scale
    sheared = False  # most rays that enter small instances meet no triangle's box
    first_t = np.float32(t_min * length - shift - pad)
    last_t = np.float32(t_max[0] * length - shift + pad)
    best_t = np.float32(t_max[1] * length - shift + pad)
    # closer than this to either end of the ray, single precision cannot tell inside from outside
    low_check = first_t + np.float32(2.0 * pad)
    high_check = last_t - np.float32(2.0 * pad)
    best, best_block, best_lane = np.int64(MISS), np.int64(0), np.int64(0)
    best_u, best_v = np.float32(0), np.float32(0)
    bottom, lanes = sp, scratch.lanes
    while True:
        if node >= 0:
            prefetch(w.children + 32 * node)  # else they are waited for after the boxes
            mask = slab_test(
                w.boxes, node, near, scale, shift_near, shift_far, first_t, last_t, scratch.entry
            )
            if mask != 0:
                node, sp = push_children(
                    mask, node, w.children, scratch.entry, scratch.stack, scratch.stack_t, sp
                )
                continue
        else:
            block = ~node
            prefetch(w.block_triangles + 32 * block)
            if not sheared:
                axes, o, shear = shear_of(origin, direction, scale)
                sheared = True
            mask = triangle_test(w.blocks, block, axes, o, shear, first_t, last_t, lanes)
            exact = mask >> 8
            mask &= 255
            while mask != 0:
                lane = trailing_zeros(mask)
                mask &= mask - 1
                t, u, v = load_f32(lanes, lane), load_f32(lanes, lane + 8), load_f32(lanes, lane + 16)
                if (exact >> lane) & 1:
                    hit, t, u, v = edge_met_exactly(w.blocks, block, lane, axes, o, shear)
                    if not (hit and t >= first_t and t <= last_t):
                        continue
                triangle = load_i32(w.block_triangles, 8 * block + lane)
                if triangle == skip:
                    continue
                if t < low_check or t > high_check:
                    exact_t = plane_distance(w.blocks, block, lane, ox, oy, oz, dx, dy, dz)
                    if not (exact_t > t_min and exact_t < t_max[0]):
                        continue
                if any_hit:
                    known = SOLID if is_opaque(w, part, triangle) else known_opacity(w, part, triangle, u, v)
                    if known == SOLID:
                        return np.int64(BLOCKED), (np.float64(t) + shift) / length, u, v
                    if known == CLEAR or t >= best_t:
                        continue
                    t64 = _distance(
                        w, block, lane, u, v, ox, oy, oz, dx, dy, dz, length, pad, t_min, t_max[1]
                    )
                    far = min(note(veils, ray, t64, triangle, u, v, part, chain, below), t_max[1])
                    best_t = np.float32(far * length - shift + pad)
                    continue
                if t <= best_t:
                    best_t = t
                    last_t = t
                else:
                    continue
                best, best_block, best_lane, best_u, best_v = triangle, block, lane, u, v
        found = False
        while sp > bottom:
            sp -= 1
            if load_f32(scratch.stack_t, sp) <= last_t:
                node = load_i32(scratch.stack, sp)
                found = True
                break
        if not found:
            break
    if best < 0:
        return best, np.inf, best_u, best_v
    t64 = _distance(
        w, best_block, best_lane, best_u, best_v, ox, oy, oz, dx, dy, dz, length, pad, t_min, t_max[1]
    )
    return best, t64, best_u, best_v
