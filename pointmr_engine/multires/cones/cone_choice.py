"""The hit that stands for what a sub-ray of a cone met: the triangle itself, or one of those that a point stands for.

Triangles of a point are chosen at random by the area that they show to the sub-ray; of a few, the nearest is taken, for
what lies behind is likely hidden.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.acceleration import EMPTY
from pointmr_engine.multires.cones.cone_space import append
from pointmr_engine.multires.cones.cone_walk import corner
from pointmr_engine.multires.cones.cones import origin_of
from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.pointers import load_f32, load_i32, load_i64
from pointmr_engine.numerics.simd import BLOCK_FLOATS
from pointmr_engine.numerics.simd_cone import POINT_ROWS, PP
from pointmr_engine.raytracing.walk import child_group

TRIES = 3


class Choice(NamedTuple):
    """Working memory."""

    matrix: np.ndarray  # (levels, 12) float64: cone_from_local of the instances walked into
    chain: np.ndarray  # (levels, 2) int64
    weight: np.ndarray  # (8,) float64


def allocate_choice(depth: int) -> Choice:
    """Working memory of one call; depth: levels of the walk."""
    return Choice(np.empty((depth + 1, 12)), np.empty((depth + 1, 2), np.int64), np.zeros(8))


@device
def _random(x):
    """(the next state, a number in [0, 1))."""
    x = (x * 1664525 + 1013904223) & 0xFFFFFFFF
    y = ((x ^ (x >> 16)) * 0x45D9F3B) & 0xFFFFFFFF
    return x, ((y ^ (y >> 16)) & 0xFFFFFF) / 16777216.0


@device
def _pick(weight, r):
    """Index chosen in proportion to eight weights; -1 where all are 0."""
    total = 0.0
    for c in range(8):
        total += weight[c]
    r *= total
    last = np.int64(-1)
    for c in range(8):
        if weight[c] > 0.0:
            last = np.int64(c)
            if r < weight[c]:
                return last
            r -= weight[c]
    return last


@device
def _facing(m, level, dx, dy, dz):
    """The covector g of a level's space: |g . area vector| is what is seen along (dx, dy, dz) of cone space."""
    a, b, c = m[level, 0], m[level, 1], m[level, 2]
    d, e, f = m[level, 4], m[level, 5], m[level, 6]
    g, h, i = m[level, 8], m[level, 9], m[level, 10]
    return (
        dx * (e * i - f * h) + dy * (h * c - i * b) + dz * (b * f - c * e),
        dx * (f * g - d * i) + dy * (i * a - g * c) + dz * (c * d - a * f),
        dx * (d * h - e * g) + dy * (g * b - h * a) + dz * (a * e - b * d),
    )


@device
def _seen_children(w, s, node, g, weight):
    """weight = the area that each child of a node shows."""
    for c in range(8):
        at = (node * POINT_ROWS + PP) * 8 + c
        xx, xy, xz = load_f32(s.points, at), load_f32(s.points, at + 8), load_f32(s.points, at + 16)
        yy, yz, zz = load_f32(s.points, at + 24), load_f32(s.points, at + 32), load_f32(s.points, at + 40)
        x, y, z = g
        squared = x * (xx * x + 2.0 * (xy * y + xz * z)) + y * (yy * y + 2.0 * yz * z) + z * zz * z
        weight[c] = np.sqrt(max(squared, 0.0)) if load_i32(w.children, 8 * node + c) != EMPTY else 0.0


@device
def _seen_triangles(w, block, g, weight):
    """weight = the area that each triangle of a block shows."""
    for lane in range(8):
        weight[lane] = 0.0
        if load_i32(w.block_triangles, 8 * block + lane) < 0:
            continue
        at = BLOCK_FLOATS * block + lane
        ax, ay, az = load_f32(w.blocks, at), load_f32(w.blocks, at + 8), load_f32(w.blocks, at + 16)
        bx, by, bz = (
            load_f32(w.blocks, at + 24) - ax,
            load_f32(w.blocks, at + 32) - ay,
            load_f32(w.blocks, at + 40) - az,
        )
        cx, cy, cz = (
            load_f32(w.blocks, at + 48) - ax,
            load_f32(w.blocks, at + 56) - ay,
            load_f32(w.blocks, at + 64) - az,
        )
        weight[lane] = abs(
            g[0] * (by * cz - bz * cy) + g[1] * (bz * cx - bx * cz) + g[2] * (bx * cy - by * cx)
        )


@device
def _descend(w, s, slot, part, length, direction, state, choice):
    """A triangle below child `slot` of a hierarchy: (level of choice.matrix, part, block, lane, length, state)."""
    level, node = np.int64(0), load_i32(w.children, slot)
    g = _facing(choice.matrix, level, direction[0], direction[1], direction[2])
    while True:
        if node >= 0:
            _seen_children(w, s, node, g, choice.weight)
            state, r = _random(state)
            c = _pick(choice.weight, r)
            if c < 0:
                return level, np.int64(-1), node, c, length, state
            node = load_i32(w.children, 8 * node + c)
        elif part < 0:
            item = ~node
            record = load_i32(w.item_record, item)
            if record < 0:
                part = ~record
                node = load_i32(w.part_root, part)
            else:
                batch = load_i32(w.item_batch, item)
                i = record - load_i64(w.first_record, batch)
                append(choice, level, load_i64(w.transforms, batch), i)
                choice.chain[length, 0], choice.chain[length, 1] = record, batch
                level, length = level + 1, length + 1
                group = child_group(w, batch, i)
                part = load_i32(w.group_part, group)
                node = load_i32(w.part_root, part) if part >= 0 else load_i32(w.group_root, group)
                g = _facing(choice.matrix, level, direction[0], direction[1], direction[2])
            if node == EMPTY:
                return level, np.int64(-1), node, np.int64(-1), length, state
        else:
            block = ~node
            _seen_triangles(w, block, g, choice.weight)
            state, r = _random(state)
            lane = max(_pick(choice.weight, r), np.int64(0))
            return level, part, block, lane, length, state


@device
def _exact(w, cones, n, direction, o, place_matrix, place, part, block, lane):
    """(t, u, v) of the triangle at a sub-ray that begins at `o` in cone space."""
    at = BLOCK_FLOATS * block + lane
    ax, ay, az = corner(w, place_matrix, place, part, at)
    bx, by, bz = corner(w, place_matrix, place, part, at + 24)
    cx, cy, cz = corner(w, place_matrix, place, part, at + 48)
    ax, ay, bx, by, cx, cy = ax - o[0], ay - o[1], bx - o[0], by - o[1], cx - o[0], cy - o[1]
    dx, dy, dz = direction
    e0 = dx * (by * cz - bz * cy) + dy * (bz * cx - bx * cz) + dz * (bx * cy - by * cx)
    e1 = dx * (cy * az - cz * ay) + dy * (cz * ax - cx * az) + dz * (cx * ay - cy * ax)
    e2 = dx * (ay * bz - az * by) + dy * (az * bx - ax * bz) + dz * (ax * by - ay * bx)
    total = e0 + e1 + e2
    if total == 0.0:
        return az, 1.0 / 3.0, 1.0 / 3.0
    u = min(max(e1 / total, 0.0), 1.0)
    v = min(max(e2 / total, 0.0), 1.0 - u)
    return az + u * (bz - az) + v * (cz - az), u, v


@device
def begin_sub_ray(cones, n, bit, out, row):
    """Begin the ray of row `row` as sub-ray `bit` of cone n; returns (its beginning, its direction), in cone space."""
    u, v = ((bit & 7) + 0.5) * 0.25 - 1.0, ((bit >> 3) + 0.5) * 0.25 - 1.0
    x, y, rays = u * cones.start[n, 0], v * cones.start[n, 1], out.rays
    rays.origin[row, 0], rays.origin[row, 1], rays.origin[row, 2] = origin_of(cones, n, x, y)
    rays.t_min[row], rays.t_max[row] = cones.t_min[n], np.inf
    rays.visibility[row] = cones.visibility[n]
    return (x, y), (u * cones.spread[n, 0], v * cones.spread[n, 1], 1.0)


@device
def choose(w, s, cones, n, bit, entry, place_matrix, place_chain, place_length, state, choice, out, row):
    """Row `row` of out.rays, out.hits, out.chain and out.length: the hit of sub-ray `bit` of cone n.

    entry: the element that it met, of cone_hits.Buffer; state: a number that decides by chance.
    """
    o, direction = begin_sub_ray(cones, n, bit, out, row)
    element, place = entry[0], entry[1]
    length = place_length[place]
    chain = out.chain[row]
    for k in range(length):
        chain[k, 0], chain[k, 1] = place_chain[place, k, 0], place_chain[place, k, 1]
    part, block, lane = entry[2], element >> 3, element & 7
    best_length = length
    if element >= 0:
        t, p, q = _exact(w, cones, n, direction, o, place_matrix, place, part, block, lane)
        x, y = direction[0] * t, direction[1] * t
    else:
        t, p, q, x, y = np.inf, 0.0, 0.0, 0.0, 0.0
        slot, whole = ~element, part
        for k in range(12):
            choice.matrix[0, k] = place_matrix[place, k]
        for _ in range(TRIES):
            level, some, one, its, deep, state = _descend(w, s, slot, whole, length, direction, state, choice)
            if some < 0:
                continue
            state, a = _random(state)
            state, b = _random(state)
            if a + b > 1.0:
                a, b = 1.0 - a, 1.0 - b
            at = BLOCK_FLOATS * one + its
            ax, ay, az = corner(w, choice.matrix, level, some, at)
            bx, by, bz = corner(w, choice.matrix, level, some, at + 24)
            cx, cy, cz = corner(w, choice.matrix, level, some, at + 48)
            z = az + a * (bz - az) + b * (cz - az)
            if z < t and (z > cones.t_min[n] or t == np.inf):
                t, p, q, part, block, lane, best_length = z, a, b, some, one, its, deep
                x = ax + a * (bx - ax) + b * (cx - ax) - o[0]
                y = ay + a * (by - ay) + b * (cy - ay) - o[1]
                for k in range(length, deep):
                    chain[k, 0], chain[k, 1] = choice.chain[k, 0], choice.chain[k, 1]
    out.length[row] = best_length
    out.bit[row] = bit if element >= 0 else ~bit
    rays, hits = out.rays, out.hits
    size = np.sqrt(x * x + y * y + t * t)
    for k in range(3):
        along = x * cones.axes[n, 0, k] + y * cones.axes[n, 1, k] + t * cones.axes[n, 2, k]
        rays.direction[row, k] = along / size
    hits.t[row] = size
    hits.u[row], hits.v[row] = np.float32(p), np.float32(q)
    hits.part[row] = np.int32(part)
    hits.triangle[row] = (
        np.int32(load_i32(w.block_triangles, 8 * block + lane)) if part >= 0 else np.int32(-1)
    )
