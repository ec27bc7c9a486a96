"""Distribution lists: areas summed along the octrees' order, so that a random surface point costs a binary search.

A node is an interval of items, its area the difference of two sums. An instance counts with the area of all that it
places, times the most that its transform can enlarge an area; a draw goes on inside it with what is left of its random
number, and where a transform stretches directions unevenly, a triangle is refused as often as the bound was too large.
So accepted points are uniform in true area. Talk: "Distribution lists: random sampling in O(log n)".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.nesting import area_scale, enter, placed_group
from pointmr_engine.hierarchy.octree import Octree
from pointmr_engine.numerics.hashing import hash_path
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.pointers import pointer_f32, pointer_f64, pointer_i32

# of a random number's range: what is left when an item is chosen this narrow is drawn anew
_EXHAUSTED = 2.0**-24
_QUARTERINGS = 3  # of a triangle: finer than the distance of its points, of which it has a few at most
_NEAR = 6  # items that are looked at one by one
BELOW_ONE = 1.0 - 2.0**-53
TRIANGLE, SAME, NEW = 0, 1, 2  # what a step of a draw has met
_INV_2_53 = 2.0**-53
_INV_2_32 = 2.0**-32


class Distribution(NamedTuple):
    """Areas of an Octree's items and nodes, in their group's units; instances by their upper bound."""

    sums: np.ndarray  # (M + G,) float64: sums[i + shift[g]] is the area of group g's items before item i
    shift: np.ndarray  # (G,) int64
    total: np.ndarray  # (G,) float64: area of the whole group
    largest: np.ndarray  # (N,) float64 per node: area of the largest triangle below it


class Chain(NamedTuple):
    """Working memory of draws: the placements that the last one went through, kept while the next goes the same way."""

    # (L, 12) float64: from each level's group (relative to its centre) to the space of the draw
    matrix: np.ndarray
    item: np.ndarray  # (L,) int64: item chosen at each level, the last one a triangle; -1: not yet
    items: np.ndarray  # (L, 2) int64: first and end of those that each level chooses from
    group: np.ndarray  # (L,) int64
    scale: np.ndarray  # (L,) float64: bound of the area scale of `matrix`
    uniform: np.ndarray  # (L,) bool: it is exact


def build_distribution(octree: Octree) -> Distribution:
    """Area sums of all groups. O(n) time; 8 bytes per item and node."""
    arrays, geometry = octree.arrays, octree.geometry
    groups = len(arrays.group_root)
    d = Distribution(
        np.zeros(len(arrays.item) + groups),
        np.zeros(groups, np.int64),
        np.zeros(groups),
        np.zeros(len(arrays.box)),
    )
    end_node = len(arrays.box)
    ends = np.zeros(groups, np.int64)
    for g in range(groups - 1, -1, -1):
        ends[g] = end_node
        if arrays.group_root[g] >= 0:
            end_node = int(arrays.group_root[g])
    first_item = 0
    for g in range(groups):
        root = int(arrays.group_root[g])
        d.shift[g] = g
        d.sums[first_item + g] = 0.0
        if root >= 0:
            largest = np.zeros(arrays.items[root, 3] - arrays.items[root, 0])
            _sum_items(arrays, geometry.tables, geometry.instances, d, np.int64(g), largest)
            _sum_nodes(arrays, d.largest, largest, np.int64(root), ends[g])
            first_item = int(arrays.items[root, 3])
    return d


@uncounted
def triangle_area(tables, part, triangle):
    """Area of a part's triangle in the mesh's space; tables: PartTables."""
    p, t = pointer_f32(tables.positions[part]), pointer_i32(tables.triangles[part])
    a, b, c = (
        3 * np.int64(t[3 * triangle]),
        3 * np.int64(t[3 * triangle + 1]),
        3 * np.int64(t[3 * triangle + 2]),
    )
    ux, uy, uz = float(p[b]) - p[a], float(p[b + 1]) - p[a + 1], float(p[b + 2]) - p[a + 2]
    vx, vy, vz = float(p[c]) - p[a], float(p[c + 1]) - p[a + 1], float(p[c + 2]) - p[a + 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return 0.5 * np.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_items(octree, tables, instances, d, group, largest):
    root = octree.group_root[group]
    first, end = np.int64(octree.items[root, 0]), np.int64(octree.items[root, 3])
    shift = d.shift[group]
    total = 0.0
    for i in range(first, end):
        part, k = np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1])
        if part >= 0:
            area = triangle_area(tables, part, k)
            largest[i - first] = area
        else:
            batch = -1 - part
            child = placed_group(instances, batch, k)
            bound, _ = area_scale(pointer_f64(instances.transforms[batch]), 12 * k)
            area = d.total[child] * bound
            largest[i - first] = d.largest[octree.group_root[child]] * bound
        d.sums[i + shift] = total
        total += area
    d.sums[end + shift] = total
    d.total[group] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_nodes(octree, largest, of_item, root, end):
    first = octree.items[root, 0]
    for n in range(end - 1, root - 1, -1):  # children come after their parents
        best = 0.0
        for i in range(octree.items[n, 0], octree.items[n, 2]):
            best = max(best, of_item[i - first])
        for c in range(octree.child[n, 0], octree.child[n, 0] + octree.child[n, 1]):
            best = max(best, largest[c])
        largest[n] = best


def allocate_chain(levels: int) -> Chain:
    """Working memory for groups nested `levels` deep (Geometry.depth), at the identity."""
    chain = Chain(
        np.zeros((levels + 2, 12)),
        np.full(levels + 2, -1, np.int64),
        np.zeros((levels + 2, 2), np.int64),
        np.zeros(levels + 2, np.int64),
        np.ones(levels + 2),
        np.ones(levels + 2, np.bool_),
    )
    chain.matrix[0, [0, 5, 10]] = 1.0
    return chain


@uncounted
def uniform(key, number):
    """Random number in [0, 1), float64 of 53 bits: a pure function of (key uint64, number int64)."""
    return np.float64(hash_path(key, number) >> np.uint64(11)) * _INV_2_53


@device
def find_item(sums, shift, first, end, start, x):
    """The item i in first..end whose interval of sums holds x; quick if it is not far after `start`."""
    if start < first or start >= end or sums[start + shift] > x:
        start = first
    for _ in range(_NEAR):  # neighbouring draws: no search whose outcome nobody can predict
        if start + 1 >= end or sums[start + 1 + shift] > x:
            break
        start += 1
    step = np.int64(1)
    while start + step < end and sums[start + step + shift] <= x:
        start += step
        step += step
    low, high = start, min(start + step, end)  # sums[low] <= x < sums[high]
    while high - low > 1:
        middle = (low + high) >> 1
        if sums[middle + shift] <= x:
            low = middle
        else:
            high = middle
    while low > first and sums[low + 1 + shift] <= sums[low + shift]:
        low -= 1  # x was rounded up to the end: never an item without area
    return low


@device
def _place(u, bits, weights):
    """Weights of vertices 1 and 2 of a point of a triangle: u in [0, 1) chooses a part of it, bits a point of the part.

    Parts are quarters of quarters, so that u spread evenly are points spread evenly. Basu and Owen, Low discrepancy
    constructions in the triangle (2015).
    """
    r = np.sqrt(np.float64(bits >> np.uint64(32)) * _INV_2_32)
    s = np.float64(bits & np.uint64(0xFFFFFFFF)) * _INV_2_32
    a, b, size = 1.0 / 3.0, 1.0 / 3.0, 1.0  # the part's centroid, and its side; negative: upside down
    for _ in range(_QUARTERINGS):
        u *= 4.0
        part = np.int64(u)
        u -= part
        size *= 0.5
        if part == 0:
            size = -size
        else:
            a += size * ((1.0 if part == 1 else 0.0) - 1.0 / 3.0)
            b += size * ((1.0 if part == 2 else 0.0) - 1.0 / 3.0)
    weights[0] = a + size * (r * (1.0 - s) - 1.0 / 3.0)
    weights[1] = b + size * (r * s - 1.0 / 3.0)


@device
def step(octree, distribution, instances, level, u, share, key, chain):
    """Choose one of the items of a level by u in [0, 1), and enter the placement if it is one: the level below is next.

    share: the range of u that one random number has been narrowed to; key: uint64 of the further ones.
    Returns (TRIANGLE, or SAME or NEW for the placement that the draw before entered or another; u inside it; share).
    """
    sums, group = distribution.sums, chain.group[level]
    shift = distribution.shift[group]
    first, end = chain.items[level, 0], chain.items[level, 1]
    low = sums[first + shift]
    whole = sums[end + shift] - low
    x = low + u * whole
    i = find_item(sums, shift, first, end, chain.item[level], x)
    area = sums[i + 1 + shift] - sums[i + shift]
    u = min(max((x - sums[i + shift]) / area, 0.0), BELOW_ONE)
    same = chain.item[level] == i
    chain.item[level] = i
    if octree.item[i, 0] >= 0:
        return TRIANGLE, u, share
    share *= area / whole
    if share < _EXHAUSTED:
        u = uniform(key, level + 1)
        share = 1.0
    if same:
        return SAME, u, share
    batch, placement, inner = -1 - np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1]), level + 1
    bound, even = area_scale(pointer_f64(instances.transforms[batch]), 12 * placement)
    chain.scale[inner] = chain.scale[level] * bound
    chain.uniform[inner] = chain.uniform[level] and even
    placed = enter(chain.matrix, level, group, octree, instances, batch, placement, inner)
    root = octree.group_root[placed]
    chain.group[inner] = placed
    chain.items[inner, 0], chain.items[inner, 1] = octree.items[root, 0], octree.items[root, 3]
    chain.item[inner] = -1
    return NEW, u, share


@device
def place(octree, tables, level, u, key, chain, weights):
    """A point of the triangle that a level has chosen; False: refused, which keeps the rest uniform in area.

    u in [0, 1), key: as `step` left it. weights (2,) float64: filled with the barycentric weights of vertices 1 and 2.
    """
    i = chain.item[level]
    _place(u, hash_path(key, np.int64(0)), weights)
    if chain.uniform[level]:
        return True
    grown = _area_growth(
        tables, np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1]), chain.matrix, level
    )
    return uniform(key, np.int64(-2)) * chain.scale[level] < grown


@device
def draw(octree, distribution, tables, instances, u, key, chain, weights):
    """One random surface point of the items that level 0 of the chain chooses from; O(levels * log n).

    octree: OctreeArrays; tables, instances: PartTables and BatchTables; u in [0, 1) picks the item, and further random
    numbers are functions of key (uint64). Level 0 of the chain is the caller's: its matrix decides in which space
    the points are uniform in area, chain.item[0] = -1 before the first draw of a new place. Rising u are found quickly.
    Fills chain.item, chain.matrix down to the triangle's group, and weights (2,) float64: see `place`.
    Returns the level of the triangle, or -1: refused.
    """
    level, share, met = np.int64(-1), 1.0, NEW
    while met != TRIANGLE:
        level += 1
        met, u, share = step(octree, distribution, instances, level, u, share, key, chain)
    return level if place(octree, tables, level, u, key, chain, weights) else np.int64(-1)


@uncounted
def _area_growth(tables, part, triangle, m, row):
    """Factor by which m[row] (12,) scales the area of a triangle."""
    p, t = pointer_f32(tables.positions[part]), pointer_i32(tables.triangles[part])
    a, b, c = (
        3 * np.int64(t[3 * triangle]),
        3 * np.int64(t[3 * triangle + 1]),
        3 * np.int64(t[3 * triangle + 2]),
    )
    ux, uy, uz = float(p[b]) - p[a], float(p[b + 1]) - p[a + 1], float(p[b + 2]) - p[a + 2]
    vx, vy, vz = float(p[c]) - p[a], float(p[c + 1]) - p[a + 1], float(p[c + 2]) - p[a + 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    before = x * x + y * y + z * z
    sx = m[row, 0] * ux + m[row, 1] * uy + m[row, 2] * uz
    sy = m[row, 4] * ux + m[row, 5] * uy + m[row, 6] * uz
    sz = m[row, 8] * ux + m[row, 9] * uy + m[row, 10] * uz
    tx = m[row, 0] * vx + m[row, 1] * vy + m[row, 2] * vz
    ty = m[row, 4] * vx + m[row, 5] * vy + m[row, 6] * vz
    tz = m[row, 8] * vx + m[row, 9] * vy + m[row, 10] * vz
    x, y, z = sy * tz - sz * ty, sz * tx - sx * tz, sx * ty - sy * tx
    after = x * x + y * y + z * z
    return np.sqrt(after / before) if before > 0.0 else 0.0


@uncounted
def sorted_uniforms(key, out, n):
    """out[:n]: n independent uniform numbers in [0, 1) in rising order, from the gaps between them; out has n + 1."""
    total = 0.0
    for i in range(n + 1):
        total -= np.log1p(-uniform(key, np.int64(i)))
        out[i] = total
    for i in range(n):
        out[i] = min(out[i] / total, BELOW_ONE)


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_many(octree, distribution, tables, instances, us, key, chain, index, weights):
    """Accepted draws for us (N,): index (N, 3) int64 part, triangle, innermost record or -1; weights (N, 2)."""
    used = 0
    for k in range(len(us)):
        level = draw(
            octree,
            distribution,
            tables,
            instances,
            us[k],
            hash_path(key, np.int64(k)),
            chain,
            weights[used],
        )
        if level < 0:
            continue
        i = chain.item[level]
        index[used, 0] = octree.item[i, 0]
        index[used, 1] = octree.item[i, 1]
        index[used, 2] = -1
        if level > 0:
            i = chain.item[level - 1]
            index[used, 2] = instances.first_record[-1 - octree.item[i, 0]] + octree.item[i, 1]
        used += 1
    return used


def draw_points(
    octree: Octree, distribution: Distribution, node: int, group: int, count: int, seed: int, presorted=True
):
    """Up to `count` independent random points of what lies below a node of `group`, uniform in true area of its space.

    Returns (part (N,), triangle (N,), innermost instance record or -1 (N,), all int64; weights (N, 2) float64 of
    vertices 1 and 2). Fewer than `count` where transforms scale unevenly. presorted: one sweep over sorted numbers,
    else a binary search for each.
    """
    us = np.empty(count + 1)
    if presorted:
        sorted_uniforms(np.uint64(seed), us, np.int64(count))
    else:
        us = np.random.default_rng(seed).random(count + 1)
    chain = allocate_chain(octree.geometry.depth)
    chain.group[0] = group
    chain.items[0] = octree.arrays.items[node, 0], octree.arrays.items[node, 3]
    index, weights = np.empty((count, 3), np.int64), np.empty((count + 1, 2))
    geometry = octree.geometry
    used = _draw_many(
        octree.arrays, distribution, geometry.tables, geometry.instances, us[:count],
        np.uint64(hash_path(np.uint64(seed), np.int64(-3))), chain, index, weights,
    )  # fmt: skip
    return index[:used, 0], index[:used, 1], index[:used, 2], weights[:used]
