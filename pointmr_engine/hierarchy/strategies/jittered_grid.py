"""Jittered grid: one random candidate in each occupied cell, whose diagonal is the spacing (talk)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.strategies.cells import sort_into_cells
from pointmr_engine.hierarchy.strategies.selection import Selection, seed_key, uniform, uniforms


def select(position: np.ndarray, area: np.ndarray, spacing: float, seed: int) -> Selection:
    """One candidate per cell of side spacing / sqrt(3), with probability proportional to area; cells own theirs."""
    shift = np.empty(3)
    uniforms(seed_key(seed, 2), shift)
    cells = sort_into_cells(position, spacing / math.sqrt(3.0) * (1.0 - 1e-6), shift)
    chosen = np.full(len(cells.key), -1, np.int32)
    _draw(cells.cell, area, seed_key(seed, 3), chosen, np.full(len(chosen), -np.inf))
    return Selection(position[chosen], chosen, cells.cell)


@njit(cache=True, nogil=True, error_model="numpy")
def _draw(cell, area, key, chosen, best):
    # the least of exponential times, each with its area as rate, comes first with probability proportional to area
    for c in range(len(cell)):
        k = cell[c]
        time = math.log(uniform(key, c)) / area[c]
        if chosen[k] < 0 or time > best[k]:
            chosen[k] = c
            best[k] = time
