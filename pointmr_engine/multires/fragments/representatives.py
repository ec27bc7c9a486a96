"""Representatives: of the smallest fragments of a cell some are shaded, by chance, and lend the others their light.

Where leaves or needles show a subpixel or two each, light that is found for every one of them costs far more than it
tells: what one lends to RUN subpixels adds less to the error than the time is worth that it saves. A choice in
proportion to what is seen has no bias (stratified sampling, a run of neighbours being a stratum). What shines itself is
never lent, nor does it borrow: a lamp of one subpixel would be three, or none.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.reconstruction.fragments import Fragments, cell_at
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import pixel_seed

CHANCES = 0x3E9A  # apart from other numbers of the same places
RUN = 2  # subpixels that a representative stands for, about: fragments that show as many stand for themselves


@device
def _closes(f: Fragments, a, b, cell, shape):
    """Whether fragment b, in the tile's order, lies in another cell than a."""
    i, j = cell_at(f.x[a], f.y[a], cell, shape)
    p, q = cell_at(f.x[b], f.y[b], cell, shape)
    return i != p or j != q


@uncounted
def choose_representatives(fragments: Fragments, count, shining, cell, shape, left, low, seed, stands):
    """stands (F,) int32: of fragments 0..count of a tile, in the order of its cells, the one that lends each its light.

    That one is as often seen as all for which it stands: `count` is changed. shining (count,) bool: what keeps its own;
    cell: subpixels a side, shape (rows, columns) of the tile in cells; left, low: its first subpixel in the image.
    """
    f, run, last, total = fragments, np.int64(-1), np.int64(-1), np.int64(0)
    for k in range(count):
        stands[k] = k
        seen = np.int64(f.count[k])
        if seen >= RUN or shining[k]:
            continue
        if run < 0 or total >= RUN or _closes(f, last, k, cell, shape):
            run, total = np.int64(k), np.int64(0)
        total += seen
        stands[k] = run
        x, y = np.int64(left + f.x[k]), np.int64(low + f.y[k])
        chance = np.int64(pixel_seed(x, y, np.int64(seed) + CHANCES + k - run))
        # of a run, `stands` of the first has the one chosen so far until the run is complete
        if chance * total < seen << 32:
            stands[run] = k
        last = np.int64(k)
    for k in range(count):
        run = np.int64(stands[k])
        if run < k:
            stands[k] = stands[run]
    for k in range(count):
        g = np.int64(stands[k])
        if g != k:
            f.count[g] += f.count[k]


@device
def _swap(f: Fragments, a, b):
    """Fragments a and b change places."""
    f.entry[a], f.entry[b] = f.entry[b], f.entry[a]
    f.x[a], f.x[b] = f.x[b], f.x[a]
    f.y[a], f.y[b] = f.y[b], f.y[a]
    f.count[a], f.count[b] = f.count[b], f.count[a]
    f.part[a], f.part[b] = f.part[b], f.part[a]
    f.triangle[a], f.triangle[b] = f.triangle[b], f.triangle[a]
    f.row[a], f.row[b] = f.row[b], f.row[a]
    for c in range(2):
        f.place[a, c], f.place[b, c] = f.place[b, c], f.place[a, c]
    for c in range(3):
        f.position[a, c], f.position[b, c] = f.position[b, c], f.position[a, c]
        f.normal[a, c], f.normal[b, c] = f.normal[b, c], f.normal[a, c]
        f.geometric[a, c], f.geometric[b, c] = f.geometric[b, c], f.geometric[a, c]
        f.albedo[a, c], f.albedo[b, c] = f.albedo[b, c], f.albedo[a, c]
        f.emission[a, c], f.emission[b, c] = f.emission[b, c], f.emission[a, c]


@uncounted
def bring_forward(fragments: Fragments, count, stands, into, at):
    """Put those of fragments 0..count that are to be shaded before the others, in their order; returns how many.

    stands: of choose_representatives, then of the new places; into (F,) int32: new places; at (F,) int32 to work in.
    """
    for k in range(count):
        at[k] = k
    kept = np.int64(0)
    for k in range(count):
        if stands[k] == k:
            if kept != k:
                _swap(fragments, kept, np.int64(k))
                at[k], at[kept] = at[kept], k
            kept += 1
    for k in range(count):
        into[at[k]] = k
    for k in range(count):
        at[k] = into[stands[at[k]]]
    for k in range(count):
        stands[k] = at[k]
    return kept


@uncounted
def lend_light(light, stands, first, last):
    """Give the fragments first..last of light (F, 3) that of their representatives."""
    for k in range(first, last):
        for c in range(3):
            light[k, c] = light[stands[k], c]
