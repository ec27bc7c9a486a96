"""Pixel filters as importance tables: a pixel's own samples are spread as its filter and all weigh the same.

Pixels then stay independent of each other, so that any tile may be rendered anywhere. The widths mean what they mean in
Cycles: a box is one pixel wide whatever the width, a Gaussian has sigma = width / 4 and ends at 1.5 widths from the
centre, Blackman-Harris reaches one width to either side.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.scene.errors import SceneError

TABLE_SIZE = 1025  # odd, so that u = 0.5 is an entry: the pixel's centre exactly


def filter_extent(kind: str, width: float) -> float:
    """How far the filter reaches from the pixel's centre, in pixels."""
    if kind == "box":
        return 0.5
    if kind == "gaussian":
        return 1.5 * width
    if kind == "blackman_harris":
        return width
    raise SceneError(f"pixel filter '{kind}' is not one of box, gaussian, blackman_harris")


def filter_weight(kind: str, width: float, offset: np.ndarray) -> np.ndarray:
    """The filter's profile along one axis at `offset` pixels from the centre, not normalised."""
    offset = np.asarray(offset, np.float64)
    if kind == "box":
        weight = np.ones_like(offset)
    elif kind == "gaussian":
        weight = np.exp(-8.0 * (offset / width) ** 2)
    else:
        phase = math.pi * (offset / width + 1.0)
        weight = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2 * phase) - 0.01168 * np.cos(3 * phase)
    return np.where(np.abs(offset) <= filter_extent(kind, width), weight, 0.0)


def filter_table(kind: str, width: float) -> np.ndarray:
    """(TABLE_SIZE,) float64: offset from the pixel's centre, in pixels, whose cumulative share is u = i / (size - 1).

    Symmetric; the same table serves both axes, since all filters are products of one profile.
    """
    if kind != "box" and not width > 0.0:
        raise SceneError(f"pixel filter width {width} must be positive")
    extent = filter_extent(kind, width)
    steps = 16 * TABLE_SIZE
    edges = np.linspace(0.0, extent, steps + 1)
    weight = filter_weight(kind, width, 0.5 * (edges[1:] + edges[:-1]))
    share = np.concatenate([[0.0], np.cumsum(np.maximum(weight, 0.0))])
    half = np.interp(np.linspace(0.0, 1.0, TABLE_SIZE // 2 + 1), share / share[-1], edges)
    return np.concatenate([-half[:0:-1], half])


@njit(cache=True, nogil=True, error_model="numpy")
def filter_offset(table, u):
    """Offset from the pixel's centre, in pixels, for u in [0, 1]."""
    x = u * (table.shape[0] - 1)
    i = min(max(int(x), 0), table.shape[0] - 2)
    return table[i] + (x - i) * (table[i + 1] - table[i])
