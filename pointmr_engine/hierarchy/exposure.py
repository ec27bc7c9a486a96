"""Exposure: how much of a piece of surface can be seen from outside its group, past all the rest of the group.

What lies inside a group that is merged to a few samples - wood under leaves, rooms in a house - must neither mix into
their colour nor count as area that covers: only the visible may be averaged. Measured by looking at the group along
thirteen axes from both ends, through small depth buffers.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.surfels import AREA, NX, NY, NZ, XX, YY, ZZ, X, Z

CELLS = 256  # of a depth buffer's longer side
THICK = 3.0  # cells: what lies no deeper behind the nearest is seen, too
LEAST = 0.02  # what is hidden keeps this share of its area: it is there, should all before it be missing


def exposure(row: np.ndarray) -> np.ndarray:
    """(S,) float32 in LEAST..1: the share of each surfel that is seen from outside, from the better one of its two
    sides.

    row (S, 16) float32: surfels of one whole group. A surface that nothing covers has 1, whether closed behind or not.
    """
    if len(row) < 2:
        return np.ones(len(row), np.float32)
    low, high = row[:, X : Z + 1].min(0), row[:, X : Z + 1].max(0)
    cell = max(float((high - low).max()) / CELLS, 1e-30)
    middle = 0.5 * (low + high)
    side = int(CELLS * 1.75) + 4  # a cube's diagonal
    seen = np.zeros((len(row), 3))
    for axis in _axes():
        u = np.cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0))
        u /= np.linalg.norm(u)
        frame = np.stack([u, np.cross(axis, u), axis]) / cell
        nearest = np.full((2, side, side), -np.inf, np.float32)
        _look(row, middle.astype(np.float64), frame, cell, nearest, seen)
    share = seen[:, :2].max(1) / np.maximum(seen[:, 2], 1e-30)
    return np.clip(share, LEAST, 1.0).astype(np.float32)


def _axes() -> np.ndarray:
    """(13, 3) unit vectors: one of each pair of a cube's opposite faces, edges and corners."""
    steps = (-1, 0, 1)
    axes = [(x, y, z) for x in steps for y in steps for z in steps if (z, y, x) > (0, 0, 0)]
    return np.array(axes, np.float64) / np.linalg.norm(axes, axis=1, keepdims=True)


@njit(cache=True, nogil=True, error_model="numpy")
def _bounds(row, k, middle, frame, cell, side, out):
    """Cells x0, y0, x1, y1 of a surfel, as large as what it covers; returns its depth in cells."""
    x, y, z = row[k, X] - middle[0], row[k, X + 1] - middle[1], row[k, Z] - middle[2]
    spread = max(row[k, XX] + row[k, YY] + row[k, ZZ], np.float32(0)) * (4.0 / 3.0)
    radius = np.sqrt(min(spread, row[k, AREA] / np.pi)) / cell
    u = frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z + 0.5 * side
    v = frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z + 0.5 * side
    out[0], out[1] = max(int(u - radius), 0), max(int(v - radius), 0)
    out[2], out[3] = min(int(u + radius), side - 1), min(int(v + radius), side - 1)
    return frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z


@njit(cache=True, nogil=True, error_model="numpy")
def _look(row, middle, frame, cell, nearest, seen):
    """Draw all surfels along an axis, seen from both ends; add up what is seen of each on the side that it faces.

    nearest (2, side, side) float32: depths from either end. seen (S, 3): on the side of the normal, on the other,
    looked at.
    """
    side = nearest.shape[1]
    box = np.empty(4, np.int64)
    for k in range(len(row)):
        z = _bounds(row, k, middle, frame, cell, side, box)
        for j in range(box[1], box[3] + 1):
            for i in range(box[0], box[2] + 1):
                nearest[0, j, i] = max(nearest[0, j, i], z)
                nearest[1, j, i] = max(nearest[1, j, i], -z)
    for k in range(len(row)):
        z = _bounds(row, k, middle, frame, cell, side, box)
        front = back = 0.0
        for j in range(box[1], box[3] + 1):
            for i in range(box[0], box[2] + 1):
                if z >= nearest[0, j, i] - THICK:
                    front += 1.0
                if -z >= nearest[1, j, i] - THICK:
                    back += 1.0
        count = max((box[2] - box[0] + 1) * (box[3] - box[1] + 1), 1)
        cosine = (row[k, NX] * frame[2, 0] + row[k, NY] * frame[2, 1] + row[k, NZ] * frame[2, 2]) * cell
        if cosine < 0.0:
            front, back = back, front
        weight = max(abs(cosine), 0.2)  # pieces that face all directions count from everywhere
        seen[k, 0] += weight * front / count
        seen[k, 1] += weight * back / count
        seen[k, 2] += weight
