"""What the views of a lens show of one surface becomes one fragment, whose light all of them then show.

Fragments merge in the cells in which the lens' centre would see them. Of those that every view must ask for itself, for
they reflect more sharply than the lens is wide, one is chosen by chance among what a view shows of a cell, and shows
its light where it was asked, as often as it stands for others: a mean over the cell would blur what is reflected.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.drawing.draw import triangle_to_camera
from pointmr_engine.forward.reconstruction.fragments import Fragments, place_seen
from pointmr_engine.forward.reconstruction.pixel_filter import Slopes
from pointmr_engine.multires.fragments.merge import copy_fragment, join, mergeable, rank_of
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import pixel_seed

MIXED = 32  # bit of a key: its cell is one of the larger ones
VIEW = 33  # first bit of the view in a fragment's key
ROW = 16  # first bit of a cell's row


@device
def _is_chosen(turns, chosen, k, seen, own, key, left, low, seed):
    """Whether k represents what a view shows of a cell, `seen` subpixels, of which k is `own`; not the one so far.

    The one whose turn it is in the cell does, so that the views' places are spread evenly in it; else any, by chance.
    """
    i, j = left + (key & ((1 << ROW) - 1)), low + ((key >> ROW) & ((1 << ROW) - 1))
    turn = np.int64(1) << np.int64(pixel_seed(i, j, seed) & np.uint32(3))
    first, second = np.int64(turns[chosen]), np.int64(turns[k])
    if (first | second) & turn != 0:
        return second & turn != 0
    h = pixel_seed(i, j, seed + second + ((key >> VIEW) << 4))
    return np.int64(h) * seen < np.int64(own) << 32


@device
def _rank_of(f, k, side):
    """merge.rank_of in the cell of `side` subpixels that the fragment's place is in."""
    return rank_of(f, k, (f.x[k] // side + 0.5) * side, (f.y[k] // side + 0.5) * side)


@uncounted
def merge_views(
    order, key, cell, perspective, footprint, f: Fragments, count, into, rank, kept, chosen, times, turns, left, low,
    seed,
):  # fmt: skip
    """Merge fragments 0..count that have the same key and continue each other's surface; returns how many are left.

    order (N,) int64: by key; key (N,) int64: cell, and from bit VIEW on the view where views do not share; cell (N,)
    int64: subpixels per side of it. Where views do not share, one of them represents all, by chance, for what is sharp
    must not be asked in the same places always. The merged ones take the places of their first ones, kept (N,) int64;
    into (N,) int32: the number of what each is part of; rank (N,) float32 and chosen (N,) int64 to work in; times (N,)
    float32: how often each counts. turns (N,) uint8: of deal_out; left, low: the tile's first cell of single views.
    """
    groups, first, last = np.int64(0), np.int64(0), np.int64(-1)
    for n in range(count):
        k = order[n]
        if n == 0 or key[k] != last:
            last = key[k]
            first = groups
        size = footprint
        if perspective:
            size = footprint * f.position[k, 2]
        found = np.int64(-1)
        for g in range(first, groups):
            if mergeable(f, kept[g], k, size):
                found = g
                break
        times[k] = 1.0
        if found >= 0:
            g = kept[found]
            if key[k] >> VIEW == 0:
                own = _rank_of(f, k, cell[k])
                join(f, g, k, own > rank[g])
                rank[g] = max(own, rank[g])
            else:
                own, seen = f.count[k], f.count[g] + f.count[k]
                if _is_chosen(turns, chosen[found], k, seen, own, key[k], left, low, seed):
                    copy_fragment(f, g, k)
                    times[chosen[found]], times[k] = 0.0, np.float32(seen) / own
                    chosen[found] = k
                else:
                    times[chosen[found]] *= np.float32(seen) / f.count[g]
                    times[k] = 0.0
                f.count[g] = seen
            into[k] = found
        else:
            kept[groups] = chosen[groups] = k
            rank[k] = _rank_of(f, k, cell[k])
            into[k] = groups
            groups += 1
    return groups


@uncounted
def place_merged(
    view, left, low, all_corners, transforms, surfel, key, fragments: Fragments, count, corners
):  # fmt: skip
    """Put triangles' fragments 0..count that views share where the lens' centre sees them: there they are shaded.

    They have the place of one of their parts, which is one view's, and not in the middle of what all of them show.
    surfel (E,) int64: of Entries; left, low: of the tile; corners (3, 3) float64 to work in; others: fill_fragments.
    """
    f = fragments
    for k in range(count):
        s = surfel[f.entry[k]]
        if s >= 0 or key[k] >> VIEW != 0:
            continue
        triangle_to_camera(transforms.matrix, np.int64(f.row[k]), all_corners, (-1 - s) >> 1, corners)
        f.place[k, 0], f.place[k, 1] = place_seen(view, corners, left + f.x[k], low + f.y[k])


@uncounted
def light_where_seen(x, y, into, times, light, fragments: Fragments, slopes: Slopes, out):
    """out (N, 3) float32: light of the fragments that merged into others, at their own places, as often as they count.

    x, y (N,) float32: where the lens' centre sees them, subpixels; into, times (N,): of merge_views; light (F, 3)
    float32, slopes: of the merged ones `fragments`.
    """
    for n in range(len(x)):
        k = np.int64(into[n])
        for c in range(3):
            value = light[k, c]
            if len(slopes.x) > 0:
                value += (x[n] - fragments.x[k]) * slopes.x[k, c] + (y[n] - fragments.y[k]) * slopes.y[k, c]
            out[n, c] = times[n] * value
