"""Pieces: triangles cut until none is longer than a given size, each with the exact moments of its own surface.

The pieces are the candidates from which the sampling strategies choose: they sum exactly to the surface that they were
cut from, which no number of random candidates does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.scene.errors import SceneError

_jit = njit(cache=True, nogil=True, error_model="numpy")

_STACK = 256  # parts of one triangle that wait: a sliver is halved at most ~60 times in each of its edges
_SLIVER = 4.0  # a triangle is halved, not divided regularly, while it is this many times as long as high
_MOST = 2**31 - 1


class Pieces(NamedTuple):
    """C flat triangular pieces, in the order of the triangles that they are parts of, and in their space."""

    triangle: np.ndarray  # (C,) int32, index of the triangle
    position: np.ndarray  # (C, 3) float32, centroid
    u: np.ndarray  # (C,) float32, the centroid is (1 - u - v) a + u b + v c in triangle (a, b, c)
    v: np.ndarray  # (C,) float32
    area: np.ndarray  # (C,) float32
    # (C, 6) float32: xx, xy, xz, yy, yz, zz of the points of the piece about its centroid
    covariance: np.ndarray
    radius: np.ndarray  # (C,) float32, largest distance from the centroid to a vertex


def as_triangles(triangles: np.ndarray) -> np.ndarray:
    """(T, 3, 3) float64, contiguous. Raises SceneError for any other shape."""
    triangles = np.ascontiguousarray(triangles, np.float64)
    if triangles.ndim != 3 or triangles.shape[1:] != (3, 3):
        raise SceneError(f"triangles are (T, 3, 3) corners, not {triangles.shape}")
    return triangles


def positive(value: float, name: str) -> float:
    """A length or probability as float. Raises SceneError unless it is finite and greater than 0."""
    value = float(value)
    if not (math.isfinite(value) and value > 0.0):
        raise SceneError(f"{name} must be finite and greater than 0, not {value}")
    return value


def cut(triangles: np.ndarray, size: float) -> Pieces:
    """Cut triangles (T, 3, 3) into pieces whose longest edge is at most `size` (both in one space).

    Compact triangles are divided into k^2 congruent ones; slivers are halved across their longest edge first.
    A triangle without area, or with a coordinate that is not finite, has no piece. Raises SceneError for a size that is
    not positive and for more pieces than 2^31.
    """
    triangles = as_triangles(triangles)
    size = positive(size, "size of a piece")
    stack = np.empty((_STACK, 6))
    count = np.zeros(len(triangles), np.int64)
    _count(triangles, size, stack, count)
    first = np.zeros(len(triangles) + 1, np.int64)
    np.cumsum(count, out=first[1:])
    total = int(first[-1])
    if total > _MOST or (count < 0).any():
        raise SceneError(f"triangles of this extent have too many pieces of size {size:g}")
    pieces = Pieces(
        np.empty(total, np.int32),
        np.empty((total, 3), np.float32),
        np.empty(total, np.float32),
        np.empty(total, np.float32),
        np.empty(total, np.float32),
        np.empty((total, 6), np.float32),
        np.empty(total, np.float32),
    )
    _fill(triangles, size, stack, first, pieces)
    return pieces


@_jit
def measure(triangles, t):
    """(area, longest edge) of triangle t; area 0 if it has none or is not finite."""
    e = triangles[t, 1, 0] - triangles[t, 0, 0]
    f = triangles[t, 1, 1] - triangles[t, 0, 1]
    g = triangles[t, 1, 2] - triangles[t, 0, 2]
    p = triangles[t, 2, 0] - triangles[t, 0, 0]
    q = triangles[t, 2, 1] - triangles[t, 0, 1]
    r = triangles[t, 2, 2] - triangles[t, 0, 2]
    x, y, z = f * r - g * q, g * p - e * r, e * q - f * p
    area = 0.5 * math.sqrt(x * x + y * y + z * z)
    longest = max(e * e + f * f + g * g, p * p + q * q + r * r, (p - e) ** 2 + (q - f) ** 2 + (r - g) ** 2)
    # float32 holds the result: what it cannot tell from nothing or from infinity is left out
    if not (area > 1e-37 and longest < 1e37):
        return 0.0, 0.0
    return area, math.sqrt(longest)


@_jit
def _corner(triangles, t, u, v, k):
    return (1.0 - u - v) * triangles[t, 0, k] + u * triangles[t, 1, k] + v * triangles[t, 2, k]


@_jit
def _edges(triangles, t, stack, top):
    """Squared lengths of the three edges of a part, in the order of `halve`."""
    a = b = c = 0.0
    for k in range(3):
        x = _corner(triangles, t, stack[top, 0], stack[top, 1], k)
        y = _corner(triangles, t, stack[top, 2], stack[top, 3], k)
        z = _corner(triangles, t, stack[top, 4], stack[top, 5], k)
        a += (y - x) * (y - x)
        b += (z - y) * (z - y)
        c += (x - z) * (x - z)
    return a, b, c


@_jit
def whole(part):
    """Make row 0 of part the whole triangle; a row holds u, v of three corners."""
    for k in range(6):
        part[0, k] = 0.0
    part[0, 2] = 1.0
    part[0, 5] = 1.0


@_jit
def halve(part, top, edge):
    """Replace a part by its halves across an edge (0: first to second corner, and so on); then in rows top, top + 1."""
    p, q = 2 * edge, 2 * ((edge + 1) % 3)
    u = 0.5 * (part[top, p] + part[top, q])
    v = 0.5 * (part[top, p + 1] + part[top, q + 1])
    for k in range(6):
        part[top + 1, k] = part[top, k]
    part[top, p], part[top, p + 1] = u, v
    part[top + 1, q], part[top + 1, q + 1] = u, v


@_jit
def _divisions(area, a, b, c, size, room):
    """Into how many parts an edge is divided; 0: the part is a sliver, to be halved."""
    longest = math.sqrt(max(a, max(b, c)))
    if longest <= size:
        return 1
    if room and longest * longest > _SLIVER * 2.0 * area:
        return 0
    return int(math.ceil(longest / size * (1.0 - 1e-12)))


@_jit
def _count(triangles, size, stack, count):
    for t in range(len(triangles)):
        area, longest = measure(triangles, t)
        if area == 0.0:
            continue
        if longest <= size:
            count[t] = 1
            continue
        if longest / size > 1e8:
            count[t] = -1
            continue
        whole(stack)
        top, total, share = 0, 0, 1.0
        while top >= 0:
            a, b, c = _edges(triangles, t, stack, top)
            share = _share(stack, top)
            k = _divisions(area * share, a, b, c, size, top < _STACK - 1)
            if k == 0:
                halve(stack, top, 0 if a >= b and a >= c else (1 if b >= c else 2))
                top += 1
            else:
                total += k * k
                top -= 1
            if total > _MOST:
                total, top = -1, -1
        count[t] = total


@_jit
def _share(stack, top):
    """The part's share of its triangle's area."""
    return abs(
        (stack[top, 2] - stack[top, 0]) * (stack[top, 5] - stack[top, 1])
        - (stack[top, 4] - stack[top, 0]) * (stack[top, 3] - stack[top, 1])
    )


@_jit
def _fill(triangles, size, stack, first, pieces):
    for t in range(len(triangles)):
        at = first[t]
        if first[t + 1] == at:
            continue
        area, longest = measure(triangles, t)
        whole(stack)
        top = 0
        while top >= 0:
            share = _share(stack, top)
            a, b, c = _edges(triangles, t, stack, top)
            k = _divisions(area * share, a, b, c, size, top < _STACK - 1) if longest > size else 1
            if k == 0:
                halve(stack, top, 0 if a >= b and a >= c else (1 if b >= c else 2))
                top += 1
            else:
                at = _divide(triangles, t, stack, top, area * share, k, at, pieces)
                top -= 1


@_jit
def _divide(triangles, t, stack, top, area, k, at, pieces):
    """Write the k^2 congruent pieces of a part from index `at` on; the index after them."""
    inverse = 1.0 / k
    square = inverse * inverse
    u0, v0 = stack[top, 0], stack[top, 1]
    u1, v1 = (stack[top, 2] - u0) * inverse, (stack[top, 3] - v0) * inverse
    u2, v2 = (stack[top, 4] - u0) * inverse, (stack[top, 5] - v0) * inverse
    r0 = r1 = r2 = 0.0
    m = 0
    for i in range(3):
        for j in range(i, 3):
            value = 0.0
            mu = _corner(triangles, t, u0 + k * (u1 + u2) / 3.0, v0 + k * (v1 + v2) / 3.0, i)
            nu = _corner(triangles, t, u0 + k * (u1 + u2) / 3.0, v0 + k * (v1 + v2) / 3.0, j)
            for corner in range(3):
                u, v = stack[top, 2 * corner], stack[top, 2 * corner + 1]
                d = (_corner(triangles, t, u, v, i) - mu) * (_corner(triangles, t, u, v, j) - nu)
                value += d
                if i == j:
                    if corner == 0:
                        r0 += d
                    elif corner == 1:
                        r1 += d
                    else:
                        r2 += d
            pieces.covariance[at, m] = value / 12.0 * square
            m += 1
    radius = math.sqrt(max(r0, max(r1, r2))) * inverse
    start = at
    for i in range(k):
        for j in range(2 * (k - i) - 1):
            # row i holds k - i upright pieces and, between them, k - i - 1 upside down
            third = (1.0 if j % 2 == 0 else 2.0) / 3.0
            x, y = (j // 2) + third, i + third
            u, v = u0 + x * u1 + y * u2, v0 + x * v1 + y * v2
            pieces.triangle[at] = t
            pieces.u[at] = u
            pieces.v[at] = v
            for n in range(3):
                pieces.position[at, n] = _corner(triangles, t, u, v, n)
            pieces.area[at] = area * square
            pieces.radius[at] = radius
            for n in range(6):
                pieces.covariance[at, n] = pieces.covariance[start, n]
            at += 1
    return at
