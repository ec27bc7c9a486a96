"""Quantised grid: the centre of each occupied cell, within reach of all of it (talk: up to 7.1 times the area)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.strategies.cells import BITS, Cells, sort_into_cells
from pointmr_engine.hierarchy.strategies.selection import Selection, seed_key, uniforms


def select(position: np.ndarray, area: np.ndarray, spacing: float, seed: int) -> Selection:
    """The centres of occupied cells of side 2 spacing / sqrt(3); cells own theirs, the most central stands for it."""
    shift = np.empty(3)
    uniforms(seed_key(seed, 2), shift)
    cells = sort_into_cells(position, 2.0 * spacing / math.sqrt(3.0) * (1.0 - 1e-6), shift)
    centre = _centres(cells)
    chosen = np.full(len(cells.key), -1, np.int32)
    _stand(cells.cell, position, centre, chosen, np.full(len(chosen), np.inf))
    return Selection(centre, chosen, cells.cell)


def _centres(cells: Cells) -> np.ndarray:
    mask = np.uint64(2**BITS - 1)
    index = np.stack([(cells.key >> np.uint64(BITS * k)) & mask for k in range(3)], axis=1)
    return (cells.origin + (index.astype(np.float64) + 0.5) * cells.side).astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _stand(cell, position, centre, chosen, best):
    for c in range(len(cell)):
        k = cell[c]
        d2 = 0.0
        for i in range(3):
            d = np.float64(position[c, i]) - centre[k, i]
            d2 += d * d
        if chosen[k] < 0 or d2 < best[k]:
            chosen[k] = c
            best[k] = d2
