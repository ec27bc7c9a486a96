"""Where the opacity of triangles with holes is sampled: one place in every cell of a lattice over the triangle."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.hashing import hash_u32
from pointmr_engine.numerics.jit import device, uncounted

BATCH = 1 << 18  # samples at once


def batches(triangles: np.ndarray, side: int):
    """Parts of `triangles` whose side x side samples each are few enough to be taken at once."""
    step = max(1, BATCH // side**2)
    for start in range(0, len(triangles), step):
        yield triangles[start : start + step]


@device
def sample_place(row, p, q, side):
    """(u, v): barycentric weights of vertices 1 and 2 of the sample in cell (p, q) of a triangle's side x side cells.

    row: number of the triangle. Places differ from triangle to triangle: what falls between the samples of one does not
    do so for all. Cells that the longest edge crosses have their own in the triangle; those beyond it are those of the
    triangle's other half.
    """
    h = hash_u32(np.uint32(row) ^ hash_u32(np.uint32(q * side + p)))
    u = (p + ((h >> np.uint32(16)) + 0.5) / 65536.0) / side
    v = (q + ((h & np.uint32(0xFFFF)) + 0.5) / 65536.0) / side
    if u + v <= 1.0:
        return u, v
    if p + q < side:
        return (2.0 * p + 1.0) / side - u, (2.0 * q + 1.0) / side - v
    return 1.0 - u, 1.0 - v


def in_triangle(side: int) -> np.ndarray:
    """(side, side) bool, [q, p]: the cells that do not lie beyond the longest edge, which alone are asked for."""
    q, p = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    return p + q < side


def lattice(side: int, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(u, v), both (n, side, side) float32: the places of all samples of triangles number `rows` (n,); [:, q, p]."""
    u = np.empty((len(rows), side, side), np.float32)
    v = np.empty_like(u)
    _fill(np.ascontiguousarray(rows, np.int64), np.int64(side), u, v)
    return u, v


@uncounted
def _fill(rows, side, u, v):
    for k in range(len(rows)):
        for q in range(side):
            for p in range(side):
                u[k, q, p], v[k, q, p] = sample_place(rows[k], p, q, side)
