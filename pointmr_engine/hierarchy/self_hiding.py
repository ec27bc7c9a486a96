"""How much of a sample's pieces is hidden behind others of them: needles have backs, and leaves overlap.

A sample of clutter covers what its pieces cover together, which is less than the sum of what they cover each. By chance
alone the share is not to be told: the sides of a thin body hide each other always, leaves of one twig hardly ever.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.set_chunks import BALL_REACH
from pointmr_engine.hierarchy.surfels import FLAT, NX, NY, NZ, ROUND, XX, XY, XZ, YY, YZ, ZZ, X, Y, Z
from pointmr_engine.numerics.rng import pixel_seed

PLACES = 16  # of a sample's pieces, at whose middles it is looked at, at most
# pieces hide as much more than their area as closes the gaps between their ellipses: tubes, stacks and clutter come out
# right (tests/engine/test_self_hiding.py)
GAPS = 1.2
MOST = BALL_REACH**2  # square of the standard deviations that a piece reaches at most

# three orthogonal directions that lie along no axis, where meshes have their planes
AXES = np.array([[2.0, 2.0, 1.0], [-2.0, 1.0, 2.0], [1.0, -2.0, 2.0]]) / 3.0

_jit = njit(cache=True, nogil=True, error_model="numpy")


def seen_share(row: np.ndarray, area: np.ndarray, owner: np.ndarray, count: int) -> np.ndarray:
    """(count,) float64: the share of its pieces' projected areas that a sample covers, 1 where none hides another.

    row (C, 16) float32 candidates, area (C,) float32 of each, in place of what the rows say; owner (C,) int32 the
    sample of each, -1: none.
    """
    first, order = _by_owner(owner, np.int64(count))
    share = np.ones(count)
    _measure(row, area, first, order, AXES, share)
    return share


@_jit
def _by_owner(owner, count):
    """(first (count + 1,), order): candidates order[first[k] : first[k + 1]] are those of sample k."""
    first = np.zeros(count + 1, np.int64)
    for c in range(len(owner)):
        if owner[c] >= 0:
            first[owner[c] + 1] += 1
    for k in range(count):
        first[k + 1] += first[k]
    at = first[:-1].copy()
    order = np.empty(first[count], np.int64)
    for c in range(len(owner)):
        if owner[c] >= 0:
            order[at[owner[c]]] = c
            at[owner[c]] += 1
    return first, order


@_jit
def _is_surface(row, area, members):
    """Whether the normals of members, all taken to one side, are nearly one: a surface's pieces lie side by side."""
    r = members[0]
    for c in members:
        if area[c] > area[r]:
            r = c
    x = y = z = total = 0.0
    for c in members:
        side = row[c, NX] * row[r, NX] + row[c, NY] * row[r, NY] + row[c, NZ] * row[r, NZ]
        w = np.float64(-area[c] if side < 0.0 else area[c])
        x += w * row[c, NX]
        y += w * row[c, NY]
        z += w * row[c, NZ]
        total += area[c]
    return x * x + y * y + z * z > (FLAT * total) ** 2


@_jit
def _project(row, area, c, axes, turn, out):
    """out (8,): place across direction `turn` of axes, depth along it, inverse of the ellipse, projected area, opacity.

    An ellipse d^T [[a, b], [b, c]] d <= 1 as large as what the piece covers, or, of a clump, half transparent.
    """
    p, q, w = axes[(turn + 1) % 3], axes[(turn + 2) % 3], axes[turn]
    x, y, z = np.float64(row[c, X]), np.float64(row[c, Y]), np.float64(row[c, Z])
    out[0], out[1], out[2] = (
        p[0] * x + p[1] * y + p[2] * z,
        q[0] * x + q[1] * y + q[2] * z,
        w[0] * x + w[1] * y + w[2] * z,
    )
    xx, xy, xz = np.float64(row[c, XX]), np.float64(row[c, XY]), np.float64(row[c, XZ])
    yy, yz, zz = np.float64(row[c, YY]), np.float64(row[c, YZ]), np.float64(row[c, ZZ])
    px, py, pz = (
        xx * p[0] + xy * p[1] + xz * p[2],
        xy * p[0] + yy * p[1] + yz * p[2],
        xz * p[0] + yz * p[1] + zz * p[2],
    )
    qx, qy, qz = (
        xx * q[0] + xy * q[1] + xz * q[2],
        xy * q[0] + yy * q[1] + yz * q[2],
        xz * q[0] + yz * q[1] + zz * q[2],
    )
    a, b, d = (
        p[0] * px + p[1] * py + p[2] * pz,
        q[0] * px + q[1] * py + q[2] * pz,
        q[0] * qx + q[1] * qy + q[2] * qz,
    )
    length = math.sqrt(row[c, NX] ** 2 + row[c, NY] ** 2 + row[c, NZ] ** 2)
    facing = abs(row[c, NX] * w[0] + row[c, NY] * w[1] + row[c, NZ] * w[2])
    flat = min(max((length - ROUND) / (FLAT - ROUND), 0.0), 1.0)
    seen = area[c] * (flat * facing + (1.0 - flat) * 0.5)
    det = max(a * d - b * b, 1e-60)
    root = math.sqrt(det)
    reach = min(GAPS * seen / (math.pi * root), MOST)
    out[3], out[4], out[5] = d / (det * reach), -b / (det * reach), a / (det * reach)
    out[6] = seen
    out[7] = min(seen / (math.pi * root * MOST), 1.0) if reach == MOST else 1.0


@_jit
def _measure(row, area, first, order, axes, share):
    most = 0
    for k in range(len(share)):
        most = max(most, first[k + 1] - first[k])
    shape = np.empty((most, 8))
    for k in range(len(share)):
        members = order[first[k] : first[k + 1]]
        n = len(members)
        if n < 2 or _is_surface(row, area, members):
            continue
        places = min(n, PLACES)
        total = seen = 0.0
        for turn in range(3):
            for i in range(n):
                _project(row, area, members[i], axes, turn, shape[i])
            for place in range(places):
                i = np.int64(place)
                if n > PLACES:  # by chance: at even steps a mesh's order would show
                    i = np.int64(pixel_seed(np.int64(k), i, np.int64(turn))) % n
                x, y, depth = shape[i, 0], shape[i, 1], shape[i, 2]
                through = 1.0
                for j in range(n):
                    if shape[j, 2] > depth:
                        u, v = x - shape[j, 0], y - shape[j, 1]
                        if shape[j, 3] * u * u + 2.0 * shape[j, 4] * u * v + shape[j, 5] * v * v < 1.0:
                            through *= 1.0 - shape[j, 7]
                total += shape[i, 6]
                seen += shape[i, 6] * through
        if total > 0.0:
            share[k] = seen / total
