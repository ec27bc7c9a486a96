"""Rays through nested instances: the closest hit, and shadow rays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.acceleration import Acceleration
from pointmr_engine.numerics.hashing import combine_seeds, hash_path
from pointmr_engine.numerics.intersect import (
    edge_met_exactly,
    localize,
    plane_distance,
    point_distance,
    shear_of,
)
from pointmr_engine.numerics.pointers import pointer_f64, pointer_i32
from pointmr_engine.numerics.simd import slab_test, trailing_zeros, triangle_test
from pointmr_engine.numerics.transforms import append_transform, ray_into
from pointmr_engine.raytracing.rays import Hits, Rays
from pointmr_engine.scene.group import HOLDOUT, VISIBLE

BLOCKED = -2  # Hits.triangle of a shadow ray that an opaque triangle stops
_EMPTY = -(2**31)
# Arrays are only borrowed here: without it each call would count references to all of them, one atomic addition each,
# which took half the time of a walk (and would make threads wait for each other).
_KERNEL = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}
_MISS = -1


@njit(**_KERNEL)
def push_children(mask, node, children, entry, stack, stack_t, sp):
    """Of the children in `mask` (not 0), the nearest is returned and the others pushed, nearest on top.

    entry[child] is the distance at which its box is met. Returns (child, new height of the stack).
    """
    i = trailing_zeros(mask)
    mask &= mask - 1
    nearest = children[node, i]
    if mask == 0:
        return nearest, sp
    near_t = entry[i]
    bottom = sp
    while mask != 0:
        i = trailing_zeros(mask)
        mask &= mask - 1
        child, t = children[node, i], entry[i]
        if t < near_t:
            child, nearest = nearest, child
            t, near_t = near_t, t
        j = sp
        while j > bottom and stack_t[j - 1] < t:
            stack[j] = stack[j - 1]
            stack_t[j] = stack_t[j - 1]
            j -= 1
        stack[j] = child
        stack_t[j] = t
        sp += 1
    return nearest, sp


@njit(**_KERNEL)
def _is_opaque(arrays, part, triangle):
    whole = arrays.part_opaque[part]
    if whole >= 0:
        return whole == 1
    slot = pointer_i32(arrays.parts.material_index[part])[triangle - arrays.parts.first_triangle[part]]
    return arrays.slot_opaque[arrays.parts.first_slot[part] + min(max(slot, 0), arrays.parts.slots[part] - 1)]


@njit(**_KERNEL)
def walk_shape(
    arrays, part, ox, oy, oz, dx, dy, dz, t_min, t_max, skip, any_hit, stack, stack_t, sp, entry, lanes
):
    """Closest hit of a ray in the part's own space, nearer than t_max: (triangle or -1, t, u, v).

    `skip` is a triangle that is not hit. With any_hit, (BLOCKED, ...) as soon as an opaque triangle is met before
    t_max[0]; else the closest of the others before t_max[1]. Without, t_max[0] = t_max[1]. The stack is free from sp on.
    """
    shape = arrays.parts.shape[part]
    node = np.int64(arrays.shape_root[shape])
    center = arrays.parts.center[part]
    ox -= center[0]
    oy -= center[1]
    oz -= center[2]
    length, shift, pad, origin, direction, near, scale, shift_near, shift_far = localize(
        ox, oy, oz, dx, dy, dz, arrays.parts.radius[part]
    )
    axes, o, shear = shear_of(origin, direction, scale)
    first_t = np.float32(t_min * length - shift - pad)
    last_t = np.float32(t_max[0] * length - shift + pad)
    best_t = np.float32(t_max[1] * length - shift + pad)
    # closer than this to either end of the ray, single precision cannot tell inside from outside
    low_check = first_t + np.float32(2.0 * pad)
    high_check = last_t - np.float32(2.0 * pad)
    best, best_block, best_lane = np.int64(_MISS), np.int64(0), np.int64(0)
    best_u, best_v = np.float32(0), np.float32(0)
    bottom = sp
    boxes, blocks = arrays.boxes, arrays.blocks
    while True:
        if node >= 0:
            mask = slab_test(boxes, node, near, scale, shift_near, shift_far, first_t, last_t, entry)
            if mask != 0:
                nearest, sp = push_children(mask, node, arrays.children, entry, stack, stack_t, sp)
                node = np.int64(nearest)
                continue
        else:
            block = ~node
            mask = triangle_test(blocks, block, axes, o, shear, first_t, last_t, lanes)
            exact = mask >> 8
            mask &= 255
            while mask != 0:
                lane = trailing_zeros(mask)
                mask &= mask - 1
                t, u, v = lanes[lane], lanes[8 + lane], lanes[16 + lane]
                if (exact >> lane) & 1:
                    hit, t, u, v = edge_met_exactly(blocks, block, lane, axes, o, shear)
                    if not (hit and t >= first_t and t <= last_t):
                        continue
                triangle = np.int64(arrays.block_triangles[block, lane])
                if triangle == skip:
                    continue
                if t < low_check or t > high_check:
                    exact_t = plane_distance(blocks, block, lane, ox, oy, oz, dx, dy, dz)
                    if not (exact_t > t_min and exact_t < t_max[0]):
                        continue
                if any_hit:
                    if _is_opaque(arrays, part, triangle):
                        return np.int64(BLOCKED), 0.0, u, v
                    if t >= best_t:
                        continue
                    best_t = t
                elif t <= best_t:
                    best_t = t
                    last_t = t
                else:
                    continue
                best, best_block, best_lane, best_u, best_v = triangle, block, lane, u, v
        found = False
        while sp > bottom:
            sp -= 1
            if stack_t[sp] <= last_t:
                node = np.int64(stack[sp])
                found = True
                break
        if not found:
            break
    if best < 0:
        return best, np.inf, best_u, best_v
    t64 = point_distance(blocks, best_block, best_lane, best_u, best_v, ox, oy, oz, dx, dy, dz)
    # the plane's distance is exact for this very ray, unless it grazes and so leaves the triangle within rounding
    plane = plane_distance(blocks, best_block, best_lane, ox, oy, oz, dx, dy, dz)
    if abs(plane - t64) * length <= 8.0 * pad and plane > t_min and plane < t_max[1]:
        t64 = plane
    return best, t64, best_u, best_v


@njit(**_KERNEL)
def _value_at(where, i):
    return where[0] + where[1] * i


@njit(**_KERNEL)
def combined_flags(instances, batch, i, flags):
    """Visibility and holdout bits of placement i of a batch below a path with `flags`."""
    where = instances.visibility[batch]
    if where[0] < 0:
        return flags
    own = np.int64(instances.visibility_values[_value_at(where, i)])
    return (flags & own & VISIBLE) | ((flags | own) & HOLDOUT)


@njit(**_KERNEL)
def child_group(instances, batch, i):
    """Index of the group that placement i of a batch places."""
    where = instances.group[batch]
    first = instances.group_first[batch]
    if where[0] >= 0:
        first += instances.group_values[_value_at(where, i)]
    return np.int64(instances.batch_groups[first])


@njit(**_KERNEL)
def _describe(arrays, chain, length, hits, n):
    """Fill what the chain of instance records says about hit n."""
    instances = arrays.instances
    world = hits.world_from_part[n]
    for r in range(3):
        for c in range(4):
            world[r, c] = 1.0 if r == c else 0.0
    path, seed, index, named = np.uint64(0), np.uint32(0), np.int32(0), np.int64(-1)
    flags, named_has = np.int64(VISIBLE), False
    for k in range(4):
        hits.color[n, k] = np.float32(1)
    for level in range(length):
        record, batch = chain[level, 0], chain[level, 1]
        i = record - instances.first_record[batch]
        append_transform(world, pointer_f64(instances.transforms[batch]), 12 * i)
        path = hash_path(path, record)
        if instances.has_attributes[batch] or named < 0 or not named_has:
            named, named_has = record, instances.has_attributes[batch]
        flags = combined_flags(instances, batch, i, flags)
        where = instances.seed[batch]
        if where[0] >= 0:
            seed = np.uint32(combine_seeds(seed, instances.seed_values[_value_at(where, i)]))
        where = instances.object_index[batch]
        if where[0] >= 0 and instances.object_index_values[_value_at(where, i)] >= 0:
            index = instances.object_index_values[_value_at(where, i)]
        where = instances.color[batch]
        if where[0] >= 0:
            for k in range(4):
                hits.color[n, k] = instances.color_values[_value_at(where, i), k]
    hits.path[n] = path
    hits.seed[n] = seed
    hits.object_index[n] = index
    hits.instance[n] = named
    hits.holdout[n] = (flags & HOLDOUT) != 0


@njit(**_KERNEL)
def _trace(arrays, rays, hits, scratch, start, stop, any_hit):
    """Both kinds of walk over rays[start:stop]."""
    stack, stack_t, entry, lanes = scratch.stack, scratch.stack_t, scratch.entry, scratch.lanes
    saved, saved_i, saved_path = scratch.saved, scratch.saved_i, scratch.saved_path
    chain, best_chain = scratch.chain, scratch.best_chain
    root = np.int64(len(arrays.group_root) - 1)
    instances = arrays.instances
    for n in range(start, stop):
        ox, oy, oz = rays.origin[n, 0], rays.origin[n, 1], rays.origin[n, 2]
        dx, dy, dz = rays.direction[n, 0], rays.direction[n, 1], rays.direction[n, 2]
        t_min, t_max = rays.t_min[n], rays.t_max[n]
        hits.t[n] = np.inf
        hits.triangle[n] = _MISS
        size = dx * dx + dy * dy + dz * dz
        if not (size > 0.0 and np.isfinite(size + ox + oy + oz) and t_min < t_max):
            continue
        wanted = np.int64(rays.visibility[n]) & VISIBLE
        best, best_t, best_part, best_length = np.int64(_MISS), t_max, np.int64(-1), np.int64(0)
        best_u, best_v = np.float32(0), np.float32(0)
        # typed, for a literal 0 would have the kernels below compiled twice
        level, sp, bottom = np.int64(0), np.int64(0), np.int64(0)
        group, flags, path = root, np.int64(VISIBLE), np.uint64(0)
        node = np.int64(arrays.group_root[root])
        entering, length, shift, pad, last_t = True, 1.0, 0.0, 0.0, np.float32(0)
        while True:
            if entering and (
                node >= 0 or node == _EMPTY
            ):  # a group of several items, from above or from below
                center = arrays.group_center[group]
                length, shift, pad, _, _, near, scale, shift_near, shift_far = localize(
                    ox - center[0], oy - center[1], oz - center[2], dx, dy, dz, arrays.group_radius[group]
                )
                first_t = np.float32(t_min * length - shift - pad)
                last_t = np.float32((t_max if any_hit else best_t) * length - shift + pad)
            entering = False
            if node >= 0:
                mask = slab_test(
                    arrays.boxes, node, near, scale, shift_near, shift_far, first_t, last_t, entry
                )
                if mask != 0:
                    nearest, sp = push_children(mask, node, arrays.children, entry, stack, stack_t, sp)
                    node = np.int64(nearest)
                    continue
            elif node != _EMPTY:
                record = np.int64(arrays.item_record[~node])
                part, below, below_path = np.int64(-1), level, path
                px, py, pz, qx, qy, qz = ox, oy, oz, dx, dy, dz
                if record < 0:
                    part = ~record
                else:
                    batch = np.int64(arrays.item_batch[~node])
                    i = record - instances.first_record[batch]
                    own = combined_flags(instances, batch, i, flags)
                    if (own & wanted) != 0:
                        m = pointer_f64(instances.transforms[batch])
                        px, py, pz, qx, qy, qz = ray_into(m, 12 * i, ox, oy, oz, dx, dy, dz)
                        child = child_group(instances, batch, i)
                        below_path = hash_path(path, record)
                        chain[level, 0] = record
                        chain[level, 1] = batch
                        part, below = np.int64(arrays.group_part[child]), level + 1
                        if part < 0:
                            saved[level] = (ox, oy, oz, dx, dy, dz)
                            saved_i[level] = (group, flags, bottom)
                            saved_path[level] = path
                            level = below
                            ox, oy, oz, dx, dy, dz = px, py, pz, qx, qy, qz
                            group, flags, path, bottom = child, own, below_path, sp
                            node = np.int64(arrays.group_root[child])
                            entering = True
                            continue
                if part >= 0:
                    skip = (
                        np.int64(rays.skip_triangle[n]) if rays.skip_path[n] == below_path else np.int64(-1)
                    )
                    limits = (t_max if any_hit else best_t, best_t)
                    triangle, t, u, v = walk_shape(
                        arrays, part, px, py, pz, qx, qy, qz, t_min, limits, skip, any_hit, stack, stack_t, sp, entry, lanes
                    )  # fmt: skip
                    if triangle == BLOCKED:
                        best = triangle
                        break
                    if triangle >= 0 and t < best_t:
                        best, best_t, best_part, best_length = triangle, t, part, below
                        best_u, best_v = u, v
                        for k in range(below):
                            best_chain[k, 0] = chain[k, 0]
                            best_chain[k, 1] = chain[k, 1]
                        if not any_hit:
                            last_t = np.float32(best_t * length - shift + pad)
            node = np.int64(_EMPTY)
            while sp > bottom:
                sp -= 1
                if stack_t[sp] <= last_t:
                    node = np.int64(stack[sp])
                    break
            if node == _EMPTY:
                if level == 0:
                    break
                level -= 1
                ox, oy, oz = saved[level, 0], saved[level, 1], saved[level, 2]
                dx, dy, dz = saved[level, 3], saved[level, 4], saved[level, 5]
                group, flags, bottom = saved_i[level, 0], saved_i[level, 1], saved_i[level, 2]
                path = saved_path[level]
                entering = True
        hits.triangle[n] = best
        if best >= 0:
            hits.t[n] = best_t
            hits.part[n] = best_part
            hits.u[n] = best_u
            hits.v[n] = best_v
            _describe(arrays, best_chain, best_length, hits, n)


class Scratch(NamedTuple):
    """Working memory of one call."""

    stack: np.ndarray  # int32
    stack_t: np.ndarray  # float32
    entry: np.ndarray  # (8,) float32
    lanes: np.ndarray  # (24,) float32
    saved: np.ndarray  # (levels, 6) float64: the ray in the spaces of the groups above
    saved_i: np.ndarray  # (levels, 3) int64: group, flags, bottom of the stack
    saved_path: np.ndarray  # (levels,) uint64
    chain: np.ndarray  # (levels, 2) int64: the instance records walked down, and their batches
    best_chain: np.ndarray  # (levels, 2) int64


def _run(
    acceleration: Acceleration, rays: Rays, hits: Hits, start: int, stop: int | None, any_hit: bool
) -> None:
    arrays = acceleration.arrays
    levels = arrays.levels + 1
    scratch = Scratch(
        np.empty(arrays.stack_size, np.int32),
        np.empty(arrays.stack_size, np.float32),
        np.empty(8, np.float32),
        np.empty(24, np.float32),
        np.empty((levels, 6)),
        np.empty((levels, 3), np.int64),
        np.empty(levels, np.uint64),
        np.empty((levels, 2), np.int64),
        np.empty((levels, 2), np.int64),
    )
    _trace(arrays, rays, hits, scratch, start, len(rays.origin) if stop is None else stop, any_hit)


def intersect(
    acceleration: Acceleration, rays: Rays, hits: Hits, start: int = 0, stop: int | None = None
) -> None:
    """Closest hits of rays[start:stop] with t_min < t < t_max, written to hits[start:stop].

    Releases the GIL; may run in several threads at once on disjoint ranges. A ray with a direction that is zero or not
    finite hits nothing.
    """
    _run(acceleration, rays, hits, start, stop, False)


def shadow(
    acceleration: Acceleration, rays: Rays, hits: Hits, start: int = 0, stop: int | None = None
) -> None:
    """Shadow rays: hits.triangle is BLOCKED (-2) where any opaque triangle lies in between (other fields undefined).

    Otherwise the closest hit on a triangle whose material may be transparent (see acceleration.set_opaque), or -1.
    """
    _run(acceleration, rays, hits, start, stop, True)
