"""Moments of surface: area, centroid and covariance of the pieces that stand together, by the parallel-axis rule."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

_jit = njit(cache=True, nogil=True, error_model="numpy")


class Moments(NamedTuple):
    """What K samples own of a surface."""

    area: np.ndarray  # (K,) float32
    centroid: np.ndarray  # (K, 3) float32; of nothing (area 0): 0
    # (K, 6) float32: xx, xy, xz, yy, yz, zz of the points about the centroid, per area
    covariance: np.ndarray


def merge_moments(
    owner: np.ndarray, count: int, area: np.ndarray, position: np.ndarray, covariance: np.ndarray
) -> Moments:
    """Moments of `count` samples, each merged from the parts that name it as their owner.

    owner (C,) int32, a negative one drops the part; area (C,), position (C, 3) centroid and covariance (C, 6) of the
    parts, all float32. Summed in float64, in the order of the parts; covariances about the merged centroid, so that
    nothing cancels.
    """
    merged = Moments(
        np.zeros(count, np.float32), np.zeros((count, 3), np.float32), np.zeros((count, 6), np.float32)
    )
    _merge(owner, area, position, covariance, np.zeros((count, 10)), merged)
    return merged


@_jit
def _merge(owner, area, position, covariance, total, merged):
    # columns of total: area, centroid, covariance
    for c in range(len(owner)):
        o = owner[c]
        if o >= 0:
            a = np.float64(area[c])
            total[o, 0] += a
            for k in range(3):
                total[o, 1 + k] += a * position[c, k]
    for o in range(len(total)):
        if total[o, 0] > 0.0:
            for k in range(3):
                total[o, 1 + k] /= total[o, 0]
    for c in range(len(owner)):
        o = owner[c]
        if o < 0:
            continue
        a = np.float64(area[c])
        m = 0
        for i in range(3):
            di = position[c, i] - total[o, 1 + i]
            for j in range(i, 3):
                dj = position[c, j] - total[o, 1 + j]
                total[o, 4 + m] += a * (covariance[c, m] + di * dj)
                m += 1
    for o in range(len(total)):
        merged.area[o] = total[o, 0]
        for k in range(3):
            merged.centroid[o, k] = total[o, 1 + k]
        for k in range(6):
            merged.covariance[o, k] = total[o, 4 + k] / total[o, 0] if total[o, 0] > 0.0 else 0.0
