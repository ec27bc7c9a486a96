"""Clumps: fragments of pieces that face many ways, as foliage does from afar.

What a clump's samples know of it, the distribution of its normals, gives the light that would reach it unhindered (B),
without noise. Whether it does is asked at one visible point of each, but the normal there is one of many, and what
hides a point has to do with how it faces. So the two meet as a ratio in each pixel: sum(B) * sum(U V) / sum(U), where U
is the unhindered light of the visible points, and V what arrives of it. That is for light that is scattered
diffusely; of the rest, B is U.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.shading.bsdf.layout import NORMAL

FLATNESS = 0.95  # of a piece, below which it has no normal of its own
MOST = 4.0  # ratio of B to U


class Clumps(NamedTuple):
    """The C clumps among a batch of fragments."""

    row: np.ndarray  # (C,) int64
    normal: np.ndarray  # (C, 3) float32 mean normals of the pieces, world space, unit
    pixel: np.ndarray  # (C,) int64: fragments of the same pixel have the same number
    weight: np.ndarray  # (C,) float64: subpixels that show them


@uncounted
def swap_normals(lobes, incoming, rows, normal, swapped):
    """Give the points `rows` other normals, those of their lobes among them; what they had is kept in `swapped`.

    normal (C, 3) float32, turned to the viewer; incoming (N, 3) float32 to the viewer; swapped (C, L + 2, 3) float32.
    """
    for i in range(len(rows)):
        k = rows[i]
        facing = np.float32(0)
        for a in range(3):
            facing += normal[i, a] * incoming[k, a]
        sign = np.float32(-1) if facing < 0 else np.float32(1)
        for a in range(3):
            value = sign * normal[i, a]
            swapped[i, 0, a], lobes.normal[k, a] = lobes.normal[k, a], value
            swapped[i, 1, a], lobes.geometric_normal[k, a] = lobes.geometric_normal[k, a], value
            for j in range(np.int64(lobes.count[k])):
                swapped[i, 2 + j, a], lobes.data[k, j, NORMAL + a] = lobes.data[k, j, NORMAL + a], value


@uncounted
def restore_normals(lobes, rows, swapped):
    """Undo `swap_normals`."""
    for i in range(len(rows)):
        k = rows[i]
        for a in range(3):
            lobes.normal[k, a] = swapped[i, 0, a]
            lobes.geometric_normal[k, a] = swapped[i, 1, a]
            for j in range(np.int64(lobes.count[k])):
                lobes.data[k, j, NORMAL + a] = swapped[i, 2 + j, a]


def ratios(clumps: Clumps, spread_out: np.ndarray, at_points: np.ndarray, count: int) -> np.ndarray:
    """(count,) float32: sum(B) / sum(U) of each clump's pixel, 1 for what is no clump.

    spread_out: B, at_points: U, both (count, 3) float32. Where no visible point faces the light it is 0, as is what the
    points would receive.
    """
    result = np.ones(count, np.float32)
    b, u = (clumps.weight * a[clumps.row].sum(1) for a in (spread_out, at_points))
    b, u = np.bincount(clumps.pixel, b), np.bincount(clumps.pixel, u)
    ratio = np.divide(b, u, out=np.zeros_like(b), where=u > 0.0)
    result[clumps.row] = np.minimum(ratio, MOST)[clumps.pixel]
    return result
