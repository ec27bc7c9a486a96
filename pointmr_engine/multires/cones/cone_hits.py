"""What cones meet: a depth buffer of 64 sub-rays a cone, its fragments, and for each a hit that can be shaded.

Fragments are the sub-rays that meet one surface: the same triangle or point, or neighbours in depth that face the same
way. The hit of a fragment is that of one of its sub-rays, chosen by a hash, so that its mean over many cones is right
whatever was merged. Where that sub-ray met a prefiltered point, one exact ray finds what it sees (a point does not know
which of its triangles hide which), and if it slips through, the hit is one of the triangles that the point stands for.
Where cones would have to look at too many boxes, a few of their sub-rays are walked instead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.acceleration import Acceleration
from pointmr_engine.hierarchy.prefilter import Prefiltered
from pointmr_engine.multires.cones.cone_buffer import allocate_buffer, fill
from pointmr_engine.multires.cones.cone_choice import allocate_choice, begin_sub_ray, choose
from pointmr_engine.multires.cones.cone_space import Style, allocate, scene_of
from pointmr_engine.multires.cones.cone_walk import COUNTERS, usable
from pointmr_engine.multires.cones.cones import Cones, sub_ray
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import R1
from pointmr_engine.numerics.simd import trailing_zeros
from pointmr_engine.raytracing.rays import Hits, Rays, allocate_hits
from pointmr_engine.raytracing.walk import describe, intersect

FACING = 0.8  # least cosine between the normals of triangles that make one fragment
MOST = 64
BOXES = 512  # of a cone; those of some sub-rays cost less than more of them
ASKED = -1  # Output.length of a sub-ray that is walked instead of its cone
_NO_WEIGHTS, _NO_CHANCES = np.empty((0, 64), np.float32), np.empty(0)
# sub-rays along a Morton curve: numbers that lie close together choose such that do
_CURVE = np.array(
    [b & 1 | b >> 1 & 2 | b >> 2 & 4 | (b >> 1 & 1 | b >> 2 & 2 | b >> 3 & 4) << 3 for b in range(64)]
)


class Merging(NamedTuple):
    """What makes one fragment of several elements."""

    most: int = 8  # fragments a cone; more join the one that is nearest in depth
    gap: float = 1.0  # half-widths of the cone that neighbours may differ in depth
    exact: bool = True  # rays find what is seen of points; else it is one of their triangles, seen or not
    boxes: int = BOXES  # most that a cone looks at
    seed: int = 0
    # (N,) float64 in [0, 1), by which cones choose among their sub-rays; none: by a hash of seed and cone
    chances: np.ndarray = _NO_CHANCES


class Fragments(NamedTuple):
    """F fragments: what the sub-rays `mask` of a cone meet."""

    cone: np.ndarray  # (F,) int32
    mask: np.ndarray  # (F,) uint64
    depth: np.ndarray  # (F, 2) float64: least and most t along the cone's axis


class Groups(NamedTuple):
    """The fragments of one cone while they are made."""

    entry: np.ndarray  # (MOST,) int64: the first one's
    mask: np.ndarray  # (MOST,) int64
    depth: np.ndarray  # (MOST, 2) float64
    own_mask: np.ndarray  # (MOST,) int64: of one entry
    own_entry: np.ndarray  # (MOST,) int64


class Output(NamedTuple):
    """Rows that are filled, fragment by fragment, and what `describe` needs for the rest of Hits."""

    fragments: Fragments
    rays: Rays
    hits: Hits
    chain: np.ndarray  # (F, levels, 2) int64
    length: np.ndarray  # (F,) int64, or ASKED
    bit: np.ndarray  # (F,) int64: the sub-ray that was chosen, ~bit if it met a point


def allocate_fragments(n: int) -> Fragments:
    """Room for n fragments."""
    return Fragments(np.empty(n, np.int32), np.empty(n, np.uint64), np.empty((n, 2)))


@device
def _alike(buffer, a, b):
    """Whether two elements may be one surface."""
    if buffer.entry[a, 2] != buffer.entry[b, 2]:
        return False
    if buffer.entry[a, 0] < 0 or buffer.entry[b, 0] < 0:
        return True
    p, q = buffer.plane[a], buffer.plane[b]
    dot = p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    sizes = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]) * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    return dot > 0.0 and dot * dot > FACING * FACING * sizes


@device
def _group(buffer, groups, mask, cones, n, merging):
    """Fragments of what is in the buffer at the bits of `mask`; returns how many."""
    own, rest = np.int64(0), mask
    while rest != 0:
        bit = trailing_zeros(rest)
        rest &= rest - 1
        k = buffer.owner[bit]
        g = np.int64(0)
        while g < own and groups.own_entry[g] != k:
            g += 1
        if g == own:
            groups.own_entry[g], groups.own_mask[g] = k, 0
            own += 1
        groups.own_mask[g] |= np.int64(1) << bit
    count = np.int64(0)
    for e in range(own):
        k, near, far = groups.own_entry[e], np.inf, -np.inf
        rest = groups.own_mask[e]
        while rest != 0:
            bit = trailing_zeros(rest)
            rest &= rest - 1
            t = -np.float64(buffer.nearness[bit])
            near, far = min(near, t), max(far, t)
        half = max(
            abs(cones.start[n, 0] + cones.spread[n, 0] * near),
            abs(cones.start[n, 1] + cones.spread[n, 1] * near),
        )
        best, least = np.int64(-1), np.inf
        for g in range(count):
            apart = max(near - groups.depth[g, 1], groups.depth[g, 0] - far, 0.0)
            joined = apart <= merging.gap * half and _alike(buffer, groups.entry[g], k)
            if joined or count >= merging.most:
                distance = apart if joined else apart + 1e6 * half
                if distance < least:
                    best, least = g, distance
        if best < 0:
            best = count
            count += 1
            groups.entry[best], groups.mask[best] = k, 0
            groups.depth[best, 0], groups.depth[best, 1] = near, far
        groups.mask[best] |= groups.own_mask[e]
        groups.depth[best, 0], groups.depth[best, 1] = (
            min(groups.depth[best, 0], near),
            max(groups.depth[best, 1], far),
        )
    return count


@device
def choose_bit(mask, weights, n, chance):
    """One of the set bits, by the weights that the sub-rays of cone n have, or where there are none by equal ones."""
    known = len(weights) > 0
    total, rest = 0.0, mask
    while rest != 0:
        bit = trailing_zeros(rest)
        rest &= rest - 1
        total += np.float64(weights[n, bit]) if known else 1.0
    target, chosen = chance * total, trailing_zeros(mask)
    for i in range(64):
        bit = _CURVE[i]
        weight = np.float64(weights[n, bit]) if known else 1.0
        if (mask >> bit) & 1 and weight > 0.0:
            chosen = bit
            if target < weight:
                break
            target -= weight
    return chosen


@device
def _fraction(merging, n, g):
    """A number in [0, 1) for fragment g of cone n."""
    if len(merging.chances) > 0:
        return (merging.chances[n] + R1 * g) % 1.0
    return (_chance(merging.seed, n, g) & 0xFFFF) / 65536.0


@device
def _chance(seed, n, g):
    """A hash for fragment g of cone n."""
    h = ((seed * 0x9E3779B1 + n * 0x85EBCA6B + g * 0xC2B2AE35) & 0x7FFFFFFF) + 1
    h = ((h ^ (h >> 15)) * 0x2C1B3C6D) & 0xFFFFFFFF
    h = ((h ^ (h >> 12)) * 0x297A2D39) & 0xFFFFFFFF
    return h ^ (h >> 15)


@device
def _ask_some(cones, weights, n, merging, out, row):
    """Rows from `row` on: sub-rays of cone n, one of each part of it, which are yet to be walked; returns the next."""
    for g in range(merging.most):
        first, last = 64 * g // merging.most, 64 * (g + 1) // merging.most
        bits = np.int64(0)
        for bit in range(first, last):
            if len(weights) == 0 or weights[n, bit] > 0.0:
                bits |= np.int64(1) << bit
        if bits == 0:
            continue
        bit = choose_bit(bits, weights, n, _fraction(merging, n, g))
        begin_sub_ray(cones, n, bit, out, row)
        out.hits.triangle[row] = -1
        out.length[row], out.bit[row] = ASKED, ~bit
        out.fragments.cone[row], out.fragments.mask[row] = n, np.uint64(bits)
        row += 1
    return row


@uncounted
def _fragments(w, s, cones, weights, escaped, counters, levels, scratch, style, buffer, groups, merging, choice, out,
               start, stop):  # fmt: skip
    """Fragments of cones[start:stop] in rows 0, 1, ...; returns how many."""
    row = np.int64(0)
    for n in range(start, stop):
        mask, whole = np.int64(0), True
        if usable(cones, n):
            mask, whole = fill(w, s, cones, n, counters, levels, scratch, style, buffer, merging.boxes)
        if not whole:
            escaped[n] = 0
            row = _ask_some(cones, weights, n, merging, out, row)
            continue
        escaped[n] = ~mask
        if mask == 0:
            continue
        count = _group(buffer, groups, mask, cones, n, merging)
        for g in range(count):
            bits = groups.mask[g]
            h = _chance(merging.seed, n, g)
            bit = choose_bit(bits, weights, n, _fraction(merging, n, g))
            k = np.int64(buffer.owner[bit])
            choose(w, s, cones, n, bit, buffer.entry[k], buffer.place_matrix, buffer.place_chain, buffer.place_length,
                   h, choice, out, row)  # fmt: skip
            out.fragments.cone[row] = n
            out.fragments.mask[row] = np.uint64(bits)
            out.fragments.depth[row, 0], out.fragments.depth[row, 1] = groups.depth[g, 0], groups.depth[g, 1]
            row += 1
    return row


@uncounted
def _describe(w, out, first, stop):
    for row in range(first, stop):
        describe(w, out.chain[row], out.length[row], out.hits, row)


def gather(
    acceleration: Acceleration,
    prefiltered: Prefiltered,
    cones: Cones,
    fragments: Fragments,
    rays: Rays,
    hits: Hits,
    escaped: np.ndarray,
    counters: np.ndarray | None = None,
    start: int = 0,
    stop: int | None = None,
    style: Style = Style(),  # noqa: B008  (immutable)
    merging: Merging = Merging(),  # noqa: B008
    weights: np.ndarray = _NO_WEIGHTS,
) -> int:
    """What cones[start:stop] meet first, as fragments 0, 1, ... in the order of the cones; returns how many.

    fragments, rays, hits: room for merging.most * (stop - start) rows, of which that many are written: the ray from the
    cone's beginning to the point that stands for a fragment, and its hit as walk.intersect would give it. escaped (N,)
    uint64: rows start to stop become the sub-rays that meet nothing. weights (N, 64) float32: how likely each sub-ray
    is to be the one that is taken for a fragment; none: all the same. counters (COUNTERS,) int64, added to. Where
    materials may be transparent and hits are shaded as such, `prefiltered` must be without opacity. Releases the GIL.
    """
    levels, scratch = allocate(acceleration)
    counters = np.zeros(COUNTERS, np.int64) if counters is None else counters
    stop = len(cones.origin) if stop is None else stop
    merging = merging._replace(most=max(1, min(merging.most, MOST)))
    room, depth = merging.most * (stop - start), len(levels.depth)
    if min(len(fragments.cone), len(rays.origin), len(hits.t)) < room:
        raise ValueError(f"{stop - start} cones need room for {room} fragments")
    buffer = allocate_buffer(depth)
    groups = Groups(
        np.zeros(MOST, np.int64),
        np.zeros(MOST, np.int64),
        np.zeros((MOST, 2)),
        np.zeros(MOST, np.int64),
        np.zeros(MOST, np.int64),
    )
    out = Output(
        fragments,
        rays,
        hits,
        np.zeros((room, depth, 2), np.int64),
        np.zeros(room, np.int64),
        np.zeros(room, np.int64),
    )
    w = acceleration.pointers
    count = _fragments(
        w, scene_of(prefiltered), cones, weights, escaped.view(np.int64), counters, levels, scratch, style, buffer,
        groups, merging, allocate_choice(depth), out, start, stop,
    )  # fmt: skip
    _describe(w, out, 0, count)
    return _look(acceleration, cones, out, count, escaped, merging.exact)


def _look(acceleration: Acceleration, cones: Cones, out: Output, count: int, escaped, exact: bool) -> int:
    """Exact hits for the fragments whose sub-ray met a point, if it meets anything, and for those that were only asked;
    returns how many fragments are left. exact: for the former.
    """
    asked = out.length[:count] == ASKED
    rows = np.flatnonzero(out.bit[:count] < 0 if exact else asked)
    if not len(rows):
        return count
    index = out.fragments.cone[rows]
    direction, stretch = sub_ray(cones, index, ~out.bit[rows])
    rays = Rays(*(column[rows] for column in out.rays))._replace(
        direction=direction, t_min=cones.t_min[index] * stretch, t_max=cones.t_max[index] * stretch
    )
    hits = allocate_hits(len(rows))
    intersect(acceleration, rays, hits)
    met = np.flatnonzero(hits.triangle >= 0)
    out.rays.direction[rows[met]] = direction[met]
    for column, found in zip(out.hits, hits, strict=True):
        column[rows[met]] = found[met]
    asked = np.flatnonzero(asked[rows])
    if not len(asked):
        return count
    out.fragments.depth[rows[asked]] = (hits.t[asked] / stretch[asked])[:, None]
    lost = rows[asked[hits.triangle[asked] < 0]]
    np.bitwise_or.at(escaped, out.fragments.cone[lost], out.fragments.mask[lost])
    kept = np.ones(count, np.bool_)
    kept[lost] = False
    for column in (*out.fragments, *out.rays, *out.hits):
        column[: count - len(lost)] = column[:count][kept]
    return count - len(lost)
