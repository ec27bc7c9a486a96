"""The shape of the stadium: rows of seats around a rectangle with round corners."""

from __future__ import annotations

import numpy as np
from parts import grid_faces, mesh

ROWS, SECTORS, SEATS = 27, 32, 19  # 27 rows of 32 sectors of 19 seats: 16,416
DEEP, RISE, GANGWAY = 0.82, 0.50, 12  # of a row, in metres; the row behind the gangway
# the bowl: a rectangle's half sides, and how far from it the first row is
CORE_X, CORE_Y, FRONT = 42.0, 24.0, 20.0
REFERENCE = 24.0  # distance at which seats are evenly spaced


# The bowl


def bowl(t, out):
    """(position (N, 2), inward direction (N, 2)) at fractions t of the round, `out` metres from the core rectangle."""
    t, out = np.broadcast_arrays(np.asarray(t, float) % 1, np.asarray(out, float))
    corner = REFERENCE * np.pi / 2
    # starting in the middle of the +x end: half an end, a corner, a side, a corner, an end, ...
    lengths = np.array([CORE_Y, corner, 2 * CORE_X, corner, 2 * CORE_Y, corner, 2 * CORE_X, corner, CORE_Y])
    starts = np.concatenate([[0], np.cumsum(lengths)])
    s = t * starts[-1]
    k = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, 8)
    f = (s - starts[k]) / lengths[k]
    begin = np.array([(CORE_X, 0), (CORE_X, CORE_Y), (CORE_X, CORE_Y), (-CORE_X, CORE_Y), (-CORE_X, CORE_Y),
                      (-CORE_X, -CORE_Y), (-CORE_X, -CORE_Y), (CORE_X, -CORE_Y), (CORE_X, -CORE_Y)])  # fmt: skip
    end = np.roll(begin, -1, axis=0)
    end[8] = (CORE_X, 0)
    end[[1, 3, 5, 7]] = begin[[1, 3, 5, 7]]
    angle = np.array([0, 0, 1, 1, 2, 2, 3, 3, 4])[k] * np.pi / 2 + np.where(k % 2 == 1, f, 0) * np.pi / 2
    normal = np.stack([np.cos(angle), np.sin(angle)], -1)
    return begin[k] + f[..., None] * (end[k] - begin[k]) + normal * out[..., None], -normal


def row_floor(row):
    """(distance from the core, height) of a row's floor, at the feet."""
    row = np.asarray(row, float)
    behind = row >= GANGWAY
    return FRONT + DEEP * row + np.where(behind, 1.6, 0.0), 1.3 + RISE * row + np.where(behind, 1.1, 0.0)


def sweep(name, profile, materials, around=320, smooth=False, part=(0.0, 1.0)):
    """A mesh of (out, z) points swept around the bowl."""
    closed = part == (0.0, 1.0)
    t = np.linspace(*part, around, endpoint=not closed)
    out, z = np.asarray(profile, float).T
    at, _ = bowl(t[None, :], out[:, None])
    points = np.concatenate([at, np.broadcast_to(z[:, None, None], (*at.shape[:2], 1))], -1)
    faces = grid_faces(len(out), around, wrap=closed)
    u, v = np.meshgrid(t, np.linspace(0, 1, len(out)))
    return mesh(name, points.reshape(-1, 3), faces, materials, np.stack([u, v], -1).reshape(-1, 2), smooth)
