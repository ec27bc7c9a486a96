"""Rays through nested instances: the closest hit, and shadow rays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.acceleration import Acceleration
from pointmr_engine.numerics.hashing import combine_seeds, hash_path
from pointmr_engine.numerics.intersect import localize
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.pointers import (
    load_f32,
    load_f64,
    load_i32,
    load_i64,
    load_u8,
    load_u32,
    pointer_f64,
)
from pointmr_engine.numerics.simd import slab_test
from pointmr_engine.numerics.transforms import append_transform, ray_into
from pointmr_engine.raytracing.rays import Hits, Rays
from pointmr_engine.raytracing.walk_shape import BLOCKED, MISS, push_children, walk_shape
from pointmr_engine.raytracing.walk_veils import WALK, Veils, allocate_veils, forget, nearest_veil
from pointmr_engine.scene.group import HOLDOUT, VISIBLE

__all__ = ["BLOCKED", "child_group", "combined_flags", "describe", "intersect", "shadow", "take_veils"]

_EMPTY = -(2**31)
_NO_VEILS = allocate_veils(0, 0)


class ScratchPointers(NamedTuple):
    """Addresses of a call's working memory."""

    stack: int  # int32 children to be visited
    stack_t: int  # float32 distances at which their boxes are met
    entry: int  # (8,) float32
    lanes: int  # (24,) float32


class Levels(NamedTuple):
    """The groups that the walk is inside of, one row per level of nesting."""

    ray: np.ndarray  # (levels, 6) float64: origin and direction in the space of the group above
    state: np.ndarray  # (levels, 3) int64: that group, its flags, the bottom of its stack
    path: np.ndarray  # (levels,) uint64
    chain: np.ndarray  # (levels, 2) int64: the instance records walked down, and their batches
    best_chain: np.ndarray  # (levels, 2) int64: those of the closest hit


@uncounted
def _place(where, batch, i):
    """Index of an optional value of placement i of a batch; negative: it has none."""
    first = load_i64(where, 2 * batch)
    return first + load_i64(where, 2 * batch + 1) * i if first >= 0 else first


@uncounted
def combined_flags(w, batch, i, flags):
    """Visibility and holdout bits of placement i of a batch below a path with `flags`."""
    at = _place(w.visibility, batch, i)
    if at < 0:
        return flags
    own = load_u8(w.visibility_values, at)
    return (flags & own & VISIBLE) | ((flags | own) & HOLDOUT)


@uncounted
def child_group(w, batch, i):
    """Index of the group that placement i of a batch places."""
    at = _place(w.group, batch, i)
    row = load_i32(w.group_first, batch)
    if at >= 0:
        row += load_i32(w.group_values, at)
    return load_i32(w.batch_groups, row)


@uncounted
def describe(w, chain, length, hits, n):
    """Fill what the chain of instance records says about hit n."""
    world = hits.world_from_part[n]
    for r in range(3):
        for c in range(4):
            world[r, c] = 1.0 if r == c else 0.0
    path, seed, index = np.uint64(0), np.uint32(0), np.int64(0)
    named, named_has, flags = np.int64(-1), np.int64(0), np.int64(VISIBLE)
    for k in range(4):
        hits.color[n, k] = np.float32(1)
    for level in range(length):
        record, batch = chain[level, 0], chain[level, 1]
        i = record - load_i64(w.first_record, batch)
        append_transform(world, pointer_f64(load_i64(w.transforms, batch)), 12 * i)
        path = hash_path(path, record)
        has = load_u8(w.has_attributes, batch)
        if has != 0 or named_has == 0:
            named, named_has = record, has
        flags = combined_flags(w, batch, i, flags)
        at = _place(w.seed, batch, i)
        if at >= 0:
            seed = np.uint32(combine_seeds(seed, load_u32(w.seed_values, at)))
        at = _place(w.object_index, batch, i)
        if at >= 0 and load_i32(w.object_index_values, at) >= 0:
            index = load_i32(w.object_index_values, at)
        at = _place(w.color, batch, i)
        if at >= 0:
            for k in range(4):
                hits.color[n, k] = load_f32(w.color_values, 4 * at + k)
    hits.path[n] = path
    hits.seed[n] = seed
    hits.object_index[n] = index
    hits.instance[n] = named
    hits.holdout[n] = (flags & HOLDOUT) != 0


@uncounted
def _enter(levels, level, ox, oy, oz, dx, dy, dz, group, flags, bottom, path):
    """Keep what is needed to come back to a group."""
    ray, state = levels.ray, levels.state
    ray[level, 0] = ox
    ray[level, 1] = oy
    ray[level, 2] = oz
    ray[level, 3] = dx
    ray[level, 4] = dy
    ray[level, 5] = dz
    state[level, 0] = group
    state[level, 1] = flags
    state[level, 2] = bottom
    levels.path[level] = path


@uncounted
def _known_veil(veils, n, hits):
    """Name the next surface of the ray's list in hit n, or nothing where it has none; False: the ray must be walked."""
    row, k = nearest_veil(veils, n)
    hits.t[n], hits.triangle[n] = np.inf, MISS
    if k >= 0:
        hits.t[n], hits.triangle[n] = veils.t[row, k], veils.triangle[row, k]
    return k != WALK


@uncounted
def _trace(w, rays, hits, scratch, levels, start, stop, any_hit, veils):
    """Both kinds of walk over rays[start:stop]."""
    chain, best_chain = levels.chain, levels.best_chain
    for n in range(start, stop):
        ox, oy, oz = rays.origin[n, 0], rays.origin[n, 1], rays.origin[n, 2]
        dx, dy, dz = rays.direction[n, 0], rays.direction[n, 1], rays.direction[n, 2]
        t_min, t_max = rays.t_min[n], rays.t_max[n]
        if any_hit:
            if _known_veil(veils, n, hits):
                continue
            forget(veils, n)
        hits.t[n] = np.inf
        hits.triangle[n] = MISS
        size = dx * dx + dy * dy + dz * dz
        if not (size > 0.0 and np.isfinite(size + ox + oy + oz) and t_min < t_max):
            continue
        wanted = np.int64(rays.visibility[n]) & VISIBLE
        # typed, for a literal 0 would have the kernels below compiled twice
        best, best_t, best_part, best_length = np.int64(MISS), t_max, np.int64(-1), np.int64(0)
        best_u, best_v = np.float32(0), np.float32(0)
        level, sp, bottom = np.int64(0), np.int64(0), np.int64(0)
        group, flags, path = np.int64(w.root), np.int64(VISIBLE), np.uint64(0)
        node = load_i32(w.group_root, group)
        entering, length, shift, pad, last_t = True, 1.0, 0.0, 0.0, np.float32(0)
        while True:
            # a group of several items, from above or from below; what holds one item only needs no test before it
            if entering and (node >= 0 or node == _EMPTY):
                length, shift, pad, _, _, near, scale, shift_near, shift_far = localize(
                    ox - load_f64(w.group_center, 3 * group),
                    oy - load_f64(w.group_center, 3 * group + 1),
                    oz - load_f64(w.group_center, 3 * group + 2),
                    dx, dy, dz,
                    load_f64(w.group_radius, group),
                )  # fmt: skip
                first_t = np.float32(t_min * length - shift - pad)
                last_t = np.float32((t_max if any_hit else best_t) * length - shift + pad)
            entering = False
            if node >= 0:
                mask = slab_test(
                    w.boxes, node, near, scale, shift_near, shift_far, first_t, last_t, scratch.entry
                )
                if mask != 0:
                    node, sp = push_children(
                        mask, node, w.children, scratch.entry, scratch.stack, scratch.stack_t, sp
                    )
                    continue
            elif node != _EMPTY:
                record = load_i32(w.item_record, ~node)
                part, below, below_path = np.int64(-1), level, path
                px, py, pz, qx, qy, qz = ox, oy, oz, dx, dy, dz
                if record < 0:
                    part = ~record
                else:
                    batch = load_i32(w.item_batch, ~node)
                    i = record - load_i64(w.first_record, batch)
                    own = combined_flags(w, batch, i, flags)
                    if (own & wanted) != 0:
                        m = pointer_f64(load_i64(w.transforms, batch))
                        px, py, pz, qx, qy, qz = ray_into(m, 12 * i, ox, oy, oz, dx, dy, dz)
                        child = child_group(w, batch, i)
                        below_path = hash_path(path, record)
                        chain[level, 0] = record
                        chain[level, 1] = batch
                        part, below = load_i32(w.group_part, child), level + 1
                        if part < 0:
                            _enter(levels, level, ox, oy, oz, dx, dy, dz, group, flags, bottom, path)
                            level = below
                            ox, oy, oz, dx, dy, dz = px, py, pz, qx, qy, qz
                            group, flags, path, bottom = child, own, below_path, sp
                            node = load_i32(w.group_root, child)
                            entering = True
                            continue
                if part >= 0:
                    skip = (
                        np.int64(rays.skip_triangle[n]) if rays.skip_path[n] == below_path else np.int64(-1)
                    )
                    limits = (t_max if any_hit else best_t, best_t)
                    triangle, t, u, v = walk_shape(
                        w, part, px, py, pz, qx, qy, qz, t_min, limits, skip, any_hit, scratch, sp, veils, n, chain,
                        below,
                    )  # fmt: skip
                    if triangle == BLOCKED:
                        best, best_t = triangle, t
                        break
                    if any_hit:
                        best_t = min(t_max, veils.farthest[veils.row[n]])
                    if triangle >= 0 and t < best_t:
                        best, best_t, best_part, best_length = triangle, t, part, below
                        best_u, best_v = u, v
                        for k in range(below):
                            best_chain[k, 0] = chain[k, 0]
                            best_chain[k, 1] = chain[k, 1]
                        last_t = np.float32(best_t * length - shift + pad)
            node = np.int64(_EMPTY)
            while sp > bottom:
                sp -= 1
                if load_f32(scratch.stack_t, sp) <= last_t:
                    node = load_i32(scratch.stack, sp)
                    break
            if node == _EMPTY:
                if level == 0:
                    break
                level -= 1
                ox, oy, oz = levels.ray[level, 0], levels.ray[level, 1], levels.ray[level, 2]
                dx, dy, dz = levels.ray[level, 3], levels.ray[level, 4], levels.ray[level, 5]
                group, flags, bottom = levels.state[level, 0], levels.state[level, 1], levels.state[level, 2]
                path = levels.path[level]
                entering = True
        if any_hit and best != BLOCKED:
            _known_veil(veils, n, hits)
            continue
        hits.triangle[n] = best
        if best != MISS:
            hits.t[n] = best_t
        if best >= 0:
            hits.part[n] = best_part
            hits.u[n] = best_u
            hits.v[n] = best_v
            describe(w, best_chain, best_length, hits, n)


def _run(
    acceleration: Acceleration, rays: Rays, hits: Hits, start: int, stop: int | None, veils: Veils | None
) -> None:
    size, depth = acceleration.arrays.stack_size, acceleration.arrays.levels + 1
    memory = (
        np.empty(size, np.int32),
        np.empty(size, np.float32),
        np.empty(8, np.float32),
        np.empty(24, np.float32),
    )
    levels = Levels(
        np.empty((depth, 6)),
        np.empty((depth, 3), np.int64),
        np.empty(depth, np.uint64),
        np.empty((depth, 2), np.int64),
        np.empty((depth, 2), np.int64),
    )
    scratch = ScratchPointers(*(a.ctypes.data for a in memory))
    stop = len(rays.origin) if stop is None else stop
    any_hit = veils is not None
    _trace(acceleration.pointers, rays, hits, scratch, levels, start, stop, any_hit, veils or _NO_VEILS)


def intersect(
    acceleration: Acceleration, rays: Rays, hits: Hits, start: int = 0, stop: int | None = None
) -> None:
    """Closest hits of rays[start:stop] with t_min < t < t_max, written to hits[start:stop].

    Releases the GIL; may run in several threads at once on disjoint ranges. A ray with a direction that is zero or not
    finite hits nothing.
    """
    _run(acceleration, rays, hits, start, stop, None)


def shadow(
    acceleration: Acceleration,
    rays: Rays,
    hits: Hits,
    start: int = 0,
    stop: int | None = None,
    veils: Veils | None = None,
) -> None:
    """Shadow rays: hits.triangle is BLOCKED (-2) where an opaque triangle lies in between, or an opaque cell of one.

    hits.t is about where, then. Otherwise the closest hit on a triangle whose material may be transparent
    (acceleration.set_opaque) and is not known to be clear there (set_micromap), or -1. Only t and triangle are filled.
    veils: lists of the rays, from which `take_veils` takes such surfaces; a ray is walked only where its list does not
    know the next one.
    """
    if veils is None:
        veils = allocate_veils(len(rays.t_min), acceleration.arrays.levels + 1, 1)
    _run(acceleration, rays, hits, start, stop, veils)


def take_veils(
    acceleration: Acceleration, veils: Veils, rays: np.ndarray, most: np.ndarray, hits: Hits
) -> np.ndarray:
    """Take the nearest surfaces of the lists of `rays` (N,) int64, up to `most` (N,) int64 of each, nearest first.

    hits: filled with them, ray after ray; it must have room for the sum of `most`. Returns how many each ray got, (N,)
    int64.
    """
    taken = np.empty(len(rays), np.int64)
    _take(acceleration.pointers, veils, rays, most, np.empty(veils.chain.shape[2:], np.int64), hits, taken)
    return taken


@uncounted
def _take(w, veils, rays, most, chain, hits, taken):
    n = np.int64(0)
    for j in range(len(rays)):
        taken[j] = 0
        while taken[j] < most[j]:
            row, k = nearest_veil(veils, rays[j])
            if k < 0:
                break
            length = np.int64(veils.length[row, k])
            for level in range(length):
                chain[level, 0] = veils.chain[row, k, level, 0]
                chain[level, 1] = veils.chain[row, k, level, 1]
            hits.t[n], hits.triangle[n] = veils.t[row, k], veils.triangle[row, k]
            hits.u[n], hits.v[n] = veils.weights[row, k, 0], veils.weights[row, k, 1]
            hits.part[n] = veils.part[row, k]
            describe(w, chain, length, hits, n)
            veils.t[row, k] = np.inf
            taken[j] += 1
            n += 1
