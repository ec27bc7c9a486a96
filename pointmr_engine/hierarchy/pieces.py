"""Pieces: triangles cut until none is longer than a given size, each with the exact moments of its own surface.

The pieces are the candidates from which the sampling strategies choose: they sum exactly to the surface that they were
cut from, which no number of random candidates does. Slivers, of which hair and grass are made, are cut across alone:
they have no more pieces than their length asks for.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.scene.errors import SceneError

_jit = njit(cache=True, nogil=True, error_model="numpy")

_SLIVER = 4.0  # a triangle is cut across, not divided regularly, from this many times as long as high
_NARROW = 0.5  # of the size: a needle's base up to which its strips are pieces
_MOST = 2**31 - 1


class Pieces(NamedTuple):
    """C flat pieces of three or four corners, in the order of their triangles, and in these triangles' space."""

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

    Compact triangles are divided into k^2 congruent ones; slivers are cut across into strips, narrow ones of which are
    pieces. A triangle without area, or with a coordinate that is not finite, has no piece. Raises SceneError for a size
    that is not positive and for more pieces than 2^31.
    """
    triangles = as_triangles(triangles)
    size = positive(size, "size of a piece")
    count = np.zeros(len(triangles), np.int64)
    _count(triangles, size, count)
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
    _fill(triangles, size, first, pieces)
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
def _length(triangles, t, du, dv):
    """Of a step in u and v."""
    square = 0.0
    for k in range(3):
        x = triangles[t, 0, k]
        square += (du * (triangles[t, 1, k] - x) + dv * (triangles[t, 2, k] - x)) ** 2
    return math.sqrt(square)


@_jit
def _side(triangles, t, part, row, edge):
    """Length of a part's edge, in the order of `halve`."""
    p, q = 2 * edge, 2 * ((edge + 1) % 3)
    return _length(triangles, t, part[row, q] - part[row, p], part[row, q + 1] - part[row, p + 1])


@_jit
def _divisions(longest, size):
    """Into how many parts an edge is divided."""
    return 1 if longest <= size else int(math.ceil(longest / size * (1.0 - 1e-12)))


@_jit
def _needles(triangles, t, area, part):
    """A triangle as needles in rows of part: tip, and two corners of a base that lies across; how many, 0: compact.

    A sliver is one, or two that meet where its height stands on its longest edge.
    """
    whole(part)
    longest, edge = 0.0, 0
    for k in range(3):
        length = _side(triangles, t, part, 0, k)
        if length > longest:
            longest, edge = length, k
    height = 2.0 * area / longest
    if longest <= _SLIVER * height:
        return 0
    i, j, k = edge, (edge + 1) % 3, (edge + 2) % 3
    along = 0.0
    for c in range(3):
        a = triangles[t, i, c]
        along += (triangles[t, k, c] - a) * (triangles[t, j, c] - a)
    along = min(max(along / longest, 0.0), longest)
    if along <= height:
        _needle(part, 0, j, i, k, 0.0)
        return 1
    if longest - along <= height:
        _needle(part, 0, i, j, k, 0.0)
        return 1
    _needle(part, 0, i, j, k, 1.0 - along / longest)
    _needle(part, 1, j, i, k, along / longest)
    return 2


@_jit
def _needle(part, row, tip, foot, other, back):
    """Write the needle from corner `tip` to corners `foot`, moved `back` to the tip by this share, and `other`."""
    for c in range(2):
        p = 1.0 if tip == c + 1 else 0.0
        q = 1.0 if foot == c + 1 else 0.0
        part[row, c] = p
        part[row, 2 + c] = q + back * (p - q)
        part[row, 4 + c] = 1.0 if other == c + 1 else 0.0


@_jit
def _strips(triangles, t, part, row, size):
    """(number of strips that a needle is cut into, whether each is a piece)."""
    base = _side(triangles, t, part, row, 1)
    longest = max(_side(triangles, t, part, row, 0), _side(triangles, t, part, row, 2))
    if longest <= size:
        return 1, True
    if base > _NARROW * size:
        return int(math.ceil(longest / max(base, size))), False
    m = int(math.ceil(longest / size))
    while _across(triangles, t, part, row, 1.0 - 1.0 / m, 1.0) > size:
        m += 1 + m // 16
    return m, True


@_jit
def _across(triangles, t, part, row, low, high):
    """The longest distance in a strip of a needle, between two shares of the way from its tip to its base."""
    result = high * _side(triangles, t, part, row, 1)
    u, v = part[row, 0], part[row, 1]
    for c in range(2):
        p, q = 2 + 2 * c, 4 - 2 * c
        pu, pv = part[row, p] - u, part[row, p + 1] - v
        qu, qv = part[row, q] - u, part[row, q + 1] - v
        result = max(result, _length(triangles, t, high * pu - low * pu, high * pv - low * pv))
        result = max(result, _length(triangles, t, high * qu - low * pu, high * qv - low * pv))
    return result


@_jit
def _strip_divisions(triangles, t, part, row, i, m, size):
    """Into how many parts the edges of strip i of m of a needle are divided."""
    return _divisions(_across(triangles, t, part, row, i / m, (i + 1.0) / m), size)


@_jit
def _count(triangles, size, count):
    part = np.empty((2, 6))
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
        needles = _needles(triangles, t, area, part)
        total = _divisions(longest, size) ** 2 if needles == 0 else 0
        for n in range(needles):
            m, narrow = _strips(triangles, t, part, n, size)
            if narrow:
                total += m
                continue
            for i in range(m):
                k = _strip_divisions(triangles, t, part, n, i, m, size)
                total += k * k * (2 if i > 0 else 1)
                if total > _MOST:
                    break
        count[t] = total if total <= _MOST else -1


@_jit
def _share(part, row):
    """The part's share of its triangle's area."""
    return abs(
        (part[row, 2] - part[row, 0]) * (part[row, 5] - part[row, 1])
        - (part[row, 4] - part[row, 0]) * (part[row, 3] - part[row, 1])
    )


@_jit
def _fill(triangles, size, first, pieces):
    part = np.empty((2, 6))
    for t in range(len(triangles)):
        at = first[t]
        if first[t + 1] == at:
            continue
        area, longest = measure(triangles, t)
        needles = _needles(triangles, t, area, part) if longest > size else 0
        if needles == 0:
            whole(part)
            _divide(triangles, t, part, 0, area, _divisions(longest, size), at, pieces)
        for n in range(needles):
            m, narrow = _strips(triangles, t, part, n, size)
            if narrow:
                at = _cut_across(triangles, t, part, n, area, m, at, pieces)
            else:
                at = _cut_up(triangles, t, part, n, area, m, size, at, pieces)


@_jit
def _cut_up(triangles, t, part, row, area, m, size, at, pieces):
    """Write the pieces of m strips of a needle, each of two triangles, from index `at` on; the index after them."""
    half = np.empty((1, 6))
    u, v = part[row, 0], part[row, 1]
    for i in range(m):
        low, high = i / m, (i + 1.0) / m
        k = _strip_divisions(triangles, t, part, row, i, m, size)
        for second in range(2 if i > 0 else 1):
            for c in range(3):
                # a near corner and both far ones; then both near ones and the other far one
                share = low if c == 0 or (second == 1 and c == 2) else high
                p = 2 if c == 0 or (second == 0 and c == 1) else 4
                half[0, 2 * c] = u + share * (part[row, p] - u)
                half[0, 2 * c + 1] = v + share * (part[row, p + 1] - v)
            at = _divide(triangles, t, half, 0, area * _share(half, 0), k, at, pieces)
    return at


@_jit
def _cut_across(triangles, t, part, row, area, m, at, pieces):
    """Write m strips of a needle as pieces from index `at` on; the index after them."""
    area = area * _share(part, row)
    u, v = part[row, 0], part[row, 1]
    # from the tip to the middle of the base, and along the base
    eu, ev = 0.5 * (part[row, 2] + part[row, 4]) - u, 0.5 * (part[row, 3] + part[row, 5]) - v
    fu, fv = part[row, 4] - part[row, 2], part[row, 5] - part[row, 3]
    e, f = np.empty(3), np.empty(3)
    for k in range(3):
        x = triangles[t, 0, k]
        y, z = triangles[t, 1, k] - x, triangles[t, 2, k] - x
        e[k], f[k] = eu * y + ev * z, fu * y + fv * z
    for i in range(m):
        # means of the way from the tip, and of its square, over a strip as wide as the way is far
        low, high = i / m, (i + 1.0) / m
        sums = low + high
        mean = (low * low + low * high + high * high) / (1.5 * sums)
        square = 0.5 * (low * low + high * high)
        # mean of squares less the mean's square, without their cancellation
        spread = (high - low) ** 2 * (low * low + 4.0 * low * high + high * high) / (18.0 * sums * sums)
        pieces.triangle[at] = t
        pieces.u[at] = u + mean * eu
        pieces.v[at] = v + mean * ev
        pieces.area[at] = area * (high - low) * sums
        radius = 0.0
        for way in (low - mean, high - mean):
            for side in (-0.5, 0.5):
                reach = 0.0
                for k in range(3):
                    reach += (way * e[k] + side * (mean + way) * f[k]) ** 2
                radius = max(radius, reach)
        pieces.radius[at] = math.sqrt(radius)
        n = 0
        for k in range(3):
            pieces.position[at, k] = _corner(triangles, t, u + mean * eu, v + mean * ev, k)
            for j in range(k, 3):
                pieces.covariance[at, n] = spread * e[k] * e[j] + square / 12.0 * f[k] * f[j]
                n += 1
        at += 1
    return at


@_jit
def _divide(triangles, t, part, row, area, k, at, pieces):
    """Write the k^2 congruent pieces of a part from index `at` on; the index after them."""
    inverse = 1.0 / k
    square = inverse * inverse
    u0, v0 = part[row, 0], part[row, 1]
    u1, v1 = (part[row, 2] - u0) * inverse, (part[row, 3] - v0) * inverse
    u2, v2 = (part[row, 4] - u0) * inverse, (part[row, 5] - v0) * inverse
    r0 = r1 = r2 = 0.0
    m = 0
    for i in range(3):
        for j in range(i, 3):
            value = 0.0
            mu = _corner(triangles, t, u0 + k * (u1 + u2) / 3.0, v0 + k * (v1 + v2) / 3.0, i)
            nu = _corner(triangles, t, u0 + k * (u1 + u2) / 3.0, v0 + k * (v1 + v2) / 3.0, j)
            for corner in range(3):
                u, v = part[row, 2 * corner], part[row, 2 * corner + 1]
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
