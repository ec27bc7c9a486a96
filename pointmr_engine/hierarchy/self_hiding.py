"""How much of a sample's pieces is hidden behind others of them: needles have backs, and leaves overlap.

A sample of clutter covers what its pieces cover together, which is less than the sum of what they cover each. By chance
alone the share is not to be told: the sides of a thin body hide each other always, leaves of one twig hardly ever.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.set_chunks import BALL_REACH
from pointmr_engine.hierarchy.surfels import FLAT, NX, NY, NZ, ROUND, XX, X
from pointmr_engine.numerics.pointers import pointer_f32, pointer_f64
from pointmr_engine.numerics.rng import pixel_seed

PLACES = 16  # of a sample's pieces, at whose middles it is looked at, at most
# pieces hide as much more than their area as closes the gaps between their ellipses: tubes, stacks and clutter come out
# right (tests/engine/test_self_hiding.py)
GAPS = 1.2
MOST = BALL_REACH**2  # square of the standard deviations that a piece reaches at most

# pieces lie in blocks of columns of LANES numbers: compilers can work at many at once when they know how far columns
# are from each other
LANES, COLUMN, SHAPE = 64, 13, 8

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
    most = -(-int(np.diff(first).max(initial=0)) // LANES) * LANES
    # made here, for a kernel does not keep alive what it has only the address of
    pieces, shapes = np.empty(most * COLUMN), np.empty(most * SHAPE, np.float32)
    _measure(row, area, first, order, AXES, pieces, shapes, share)
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
def _take(row, area, members, piece):
    """Place from the first one's, covariance, normal and area of the members, to `piece`: see `_project`."""
    r = members[0]
    for i in range(len(members)):
        c = members[i]
        at = i // LANES * (COLUMN * LANES) + i % LANES
        for k in range(3):
            piece[at + LANES * k] = np.float64(row[c, X + k]) - np.float64(row[r, X + k])
            piece[at + LANES * (9 + k)] = row[c, NX + k]
        for k in range(6):
            piece[at + LANES * (3 + k)] = row[c, XX + k]
        piece[at + LANES * 12] = area[c]


@_jit
def _project(piece, count, axes, turn, shape):
    """shape, blocks of (SHAPE, LANES) float32: place across direction `turn` of axes, depth along it, inverse of the
    ellipse, projected area, and the share of light that goes through.

    An ellipse a u^2 + b u v + c v^2 <= 1 as large as what the piece covers, or, of a clump, half transparent. piece,
    blocks of (COLUMN, LANES) float64: place, covariance, normal, area.
    """
    px, py, pz = axes[(turn + 1) % 3, 0], axes[(turn + 1) % 3, 1], axes[(turn + 1) % 3, 2]
    qx, qy, qz = axes[(turn + 2) % 3, 0], axes[(turn + 2) % 3, 1], axes[(turn + 2) % 3, 2]
    wx, wy, wz = axes[turn, 0], axes[turn, 1], axes[turn, 2]
    for block in range((count + LANES - 1) // LANES):
        o, s = block * (COLUMN * LANES), block * (SHAPE * LANES)
        for i in range(min(count - block * LANES, LANES)):
            x, y, z = piece[o + i], piece[o + LANES + i], piece[o + 2 * LANES + i]
            xx, xy, xz = piece[o + 3 * LANES + i], piece[o + 4 * LANES + i], piece[o + 5 * LANES + i]
            yy, yz, zz = piece[o + 6 * LANES + i], piece[o + 7 * LANES + i], piece[o + 8 * LANES + i]
            nx, ny, nz = piece[o + 9 * LANES + i], piece[o + 10 * LANES + i], piece[o + 11 * LANES + i]
            area = piece[o + 12 * LANES + i]
            sx, sy, sz = xx * px + xy * py + xz * pz, xy * px + yy * py + yz * pz, xz * px + yz * py + zz * pz
            tx, ty, tz = xx * qx + xy * qy + xz * qz, xy * qx + yy * qy + yz * qz, xz * qx + yz * qy + zz * qz
            a, b, d = px * sx + py * sy + pz * sz, qx * sx + qy * sy + qz * sz, qx * tx + qy * ty + qz * tz
            flat = (math.sqrt(nx * nx + ny * ny + nz * nz) - ROUND) / (FLAT - ROUND)
            flat = flat if flat > 0.0 else 0.0
            flat = flat if flat < 1.0 else 1.0
            seen = area * (flat * abs(nx * wx + ny * wy + nz * wz) + (1.0 - flat) * 0.5)
            det = a * d - b * b
            det = det if det > 1e-60 else 1e-60
            covered = seen / (math.pi * math.sqrt(det))
            reach = GAPS * covered
            share = covered / MOST if covered < MOST else 1.0
            through = 1.0 - share if reach >= MOST else 0.0
            scale = 1.0 / (det * (reach if reach < MOST else MOST))
            shape[s + i] = px * x + py * y + pz * z
            shape[s + LANES + i] = qx * x + qy * y + qz * z
            shape[s + 2 * LANES + i] = wx * x + wy * y + wz * z
            shape[s + 3 * LANES + i] = d * scale
            shape[s + 4 * LANES + i] = -2.0 * b * scale
            shape[s + 5 * LANES + i] = a * scale
            shape[s + 6 * LANES + i] = seen
            shape[s + 7 * LANES + i] = through


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc"})
def _through(shape, count, x, y, depth):
    """What share of light reaches a place past all that is before it."""
    through = np.float32(1)
    for block in range((count + LANES - 1) // LANES):
        s = block * (SHAPE * LANES)
        for j in range(min(count - block * LANES, LANES)):
            u, v = x - shape[s + j], y - shape[s + LANES + j]
            a, b, c = shape[s + 3 * LANES + j], shape[s + 4 * LANES + j], shape[s + 5 * LANES + j]
            before = (shape[s + 2 * LANES + j] > depth) & (a * u * u + b * u * v + c * v * v < np.float32(1))
            through *= shape[s + 7 * LANES + j] if before else np.float32(1)
    return through


@_jit
def _measure(row, area, first, order, axes, pieces, shapes, share):
    piece, shape = pointer_f64(np.int64(pieces.ctypes.data)), pointer_f32(np.int64(shapes.ctypes.data))
    for k in range(len(share)):
        members = order[first[k] : first[k + 1]]
        count = len(members)
        if count < 2 or _is_surface(row, area, members):
            continue
        _take(row, area, members, piece)
        total = seen = 0.0
        for turn in range(3):
            _project(piece, count, axes, turn, shape)
            for place in range(min(count, PLACES)):
                i = np.int64(place)
                if count > PLACES:  # by chance: at even steps a mesh's order would show
                    i = np.int64(pixel_seed(np.int64(k), i, np.int64(turn))) % count
                at = i // LANES * (SHAPE * LANES) + i % LANES
                through = _through(shape, count, shape[at], shape[at + LANES], shape[at + 2 * LANES])
                total += shape[at + 6 * LANES]
                seen += shape[at + 6 * LANES] * through
        if total > 0.0:
            share[k] = seen / total
