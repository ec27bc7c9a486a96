"""Chunks of sample sets: eight surfels that are neighbours in space, and a ball about them.

Most samples of a set that is drawn lie behind something nearer. A ball tells that of eight at once, before they are
read.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.surfels import COLUMNS, XX, YY, ZZ, X
from pointmr_engine.numerics.simd import WIDTH

CHUNK_OF = WIDTH  # rows; chunks begin at multiples of it in the pool, whatever sets the rows belong to
BALL_REACH = 2.2  # standard deviations that a surfel reaches from its centre: surfel_lanes.REACH


def in_space_order(row: np.ndarray, chosen: np.ndarray, home: np.ndarray, spacing: float) -> np.ndarray:
    """(K,) int64: the order of samples by their nodes, and in each node along a Morton curve.

    row (S, 16) float32 surfels; chosen (K,) int64 rows of the samples; home (K,) int32 their nodes.
    """
    keys = np.empty(len(chosen), np.uint64)
    _keys(row, chosen, home, float(spacing), keys)
    return np.argsort(keys, kind="stable")


@njit(cache=True, nogil=True, error_model="numpy")
def _keys(row, chosen, home, spacing, keys):
    for k in range(len(chosen)):
        code = np.uint64(0)
        for axis in range(3):
            # cells of one spacing, counted modulo 1024: nodes are 8 spacings wide; no border at 0, where much lies
            cell = np.int64(np.floor(np.float64(row[chosen[k], X + axis]) / spacing + 0.37))
            x = cell & np.int64(1023)
            for bit in range(10):
                code |= np.uint64((x >> bit) & 1) << np.uint64(3 * bit + axis)
        keys[k] = (np.uint64(home[k]) << np.uint64(30)) | code


@njit(cache=True, nogil=True, error_model="numpy")
def bound_chunks(row, first, end, out):
    """Fill the chunks of rows first..end, of which the first may have been begun before.

    row (S, 16) float32 surfels; out (C, 16) float32: centres, and in XX the square of the radius over BALL_REACH, so
    that a chunk is placed in the image as a surfel is. Chunks that hold surfels of distant nodes have large balls,
    which are seldom hidden.
    """
    for c in range(first // CHUNK_OF, (end + CHUNK_OF - 1) // CHUNK_OF):
        a, b = c * CHUNK_OF, min((c + 1) * CHUNK_OF, end)
        for q in range(COLUMNS):
            out[c, q] = np.float32(0)
        for axis in range(3):
            low = high = row[a, X + axis]
            for k in range(a + 1, b):
                low, high = min(low, row[k, X + axis]), max(high, row[k, X + axis])
            out[c, X + axis] = np.float32(0.5) * (low + high)
        radius = 0.0
        for k in range(a, b):
            square = 0.0
            for axis in range(3):
                d = np.float64(row[k, X + axis]) - np.float64(out[c, X + axis])
                square += d * d
            spread = np.float64(row[k, XX]) + np.float64(row[k, YY]) + np.float64(row[k, ZZ])
            radius = max(radius, math.sqrt(square) + BALL_REACH * math.sqrt(max(spread, 0.0)))
        out[c, XX] = (radius * (1.0 + 1e-6) / BALL_REACH) ** 2
