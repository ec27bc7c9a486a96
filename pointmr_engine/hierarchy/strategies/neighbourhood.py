"""Neighbourhood-based sampling: keep a candidate, delete all that it covers, until none is left (talk: the best strategy)."""

from __future__ import annotations

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.strategies.cells import neighbours, sort_into_cells
from pointmr_engine.hierarchy.strategies.selection import Selection, seed_key, shuffle


def select(position: np.ndarray, area: np.ndarray, spacing: float, seed: int) -> Selection:
    """Accept candidates in random order unless an accepted one lies within `spacing`; each belongs to its nearest sample.

    Samples are more than `spacing` apart and all candidates within `spacing` of one: in the plane at most 3.63 and on average
    2.19 times the area, for random order and dense candidates. Linear in their number: a sample visits the
    candidates of the 27 cells around it once.
    """
    n = len(position)
    cells = sort_into_cells(position, spacing * (1.0 + 1e-6))
    order = np.arange(n, dtype=np.int32)
    shuffle(seed_key(seed, 4), order)
    place = np.empty(n, np.int32)
    place[cells.member] = np.arange(n, dtype=np.int32)
    owner, chosen = np.full(n, -1, np.int32), np.empty(n, np.int32)
    count = _eliminate(
        cells, position[cells.member], place[order], spacing * spacing, np.full(n, np.inf), owner, chosen
    )
    chosen = cells.member[chosen[:count]]
    result = np.empty(n, np.int32)
    result[cells.member] = owner
    return Selection(position[chosen], chosen, result)


@njit(cache=True, nogil=True, error_model="numpy")
def _eliminate(cells, position, order, radius2, best, owner, chosen):
    """Here candidates are in the order of the cells; best (C,): squared distance to the nearest sample so far."""
    around = np.empty(27, np.int64)
    count = 0
    for k in range(len(order)):
        c = order[k]
        if best[c] <= radius2:
            continue
        x, y, z = np.float64(position[c, 0]), np.float64(position[c, 1]), np.float64(position[c, 2])
        found = neighbours(cells, cells.key[cells.cell[cells.member[c]]], around)
        for i in range(found):
            for m in range(cells.start[around[i]], cells.start[around[i] + 1]):
                p, q, r = position[m, 0] - x, position[m, 1] - y, position[m, 2] - z
                d2 = p * p + q * q + r * r
                if d2 < best[m]:
                    best[m] = d2
                    owner[m] = count
        chosen[count] = c
        count += 1
    return count
