"""Nearest points: a balanced k-d tree without pointers, and searches in it that start from a guess."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.numerics.jit import device

_jit = njit(cache=True, nogil=True, error_model="numpy")

LEAF = 8  # points that are not divided further
STACK = 64  # deep enough for 2^31 points


class PointTree(NamedTuple):
    """N points in the order of the tree; node k has the children 2k + 1 and 2k + 2 and half of its points in each."""

    point: np.ndarray  # (N, 3) float64
    index: np.ndarray  # (N,) int32, place of each in the array that the tree was built from
    plane: np.ndarray  # (M,) float64, coordinate that divides the node's points
    axis: np.ndarray  # (M,) int8


def build_tree(points: np.ndarray) -> PointTree:
    """The k-d tree of points (N, 3), all finite."""
    point = np.array(points, np.float64, ndmin=2).reshape(-1, 3)
    n = len(point)
    depth = 0 if n <= LEAF else math.ceil(math.log2(n / LEAF))
    nodes = 2**depth
    tree = PointTree(point, np.arange(n, dtype=np.int32), np.zeros(nodes), np.zeros(nodes, np.int8))
    _build(tree, np.empty((STACK, 3), np.int64))
    return tree


@_jit
def _swap(tree, i, j):
    for k in range(3):
        tree.point[i, k], tree.point[j, k] = tree.point[j, k], tree.point[i, k]
    tree.index[i], tree.index[j] = tree.index[j], tree.index[i]


@_jit
def _divide(tree, low, high, middle, axis):
    """Order the points low..high - 1 so that none before `middle` lies beyond it along the axis (quickselect)."""
    high -= 1
    while low < high:
        a = tree.point[low, axis]
        b = tree.point[(low + high) // 2, axis]
        c = tree.point[high, axis]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while tree.point[i, axis] < pivot:
                i += 1
            while tree.point[j, axis] > pivot:
                j -= 1
            if i <= j:
                _swap(tree, i, j)
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@_jit
def _build(tree, stack):
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, len(tree.point)
    top = 1
    while top > 0:
        top -= 1
        node, low, high = stack[top, 0], stack[top, 1], stack[top, 2]
        if high - low <= LEAF:
            continue
        axis, widest = 0, -1.0
        for k in range(3):
            least, most = np.inf, -np.inf
            for i in range(low, high):
                least = min(least, tree.point[i, k])
                most = max(most, tree.point[i, k])
            if most - least > widest:
                axis, widest = k, most - least
        middle = (low + high) // 2
        _divide(tree, low, high, middle, axis)
        tree.axis[node] = axis
        tree.plane[node] = tree.point[middle, axis]
        stack[top, 0], stack[top, 1], stack[top, 2] = 2 * node + 1, low, middle
        stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = 2 * node + 2, middle, high
        top += 2


@_jit
def squared(tree, i, x, y, z):
    """Squared distance of the tree's point i to (x, y, z)."""
    p, q, r = tree.point[i, 0] - x, tree.point[i, 1] - y, tree.point[i, 2] - z
    return p * p + q * q + r * r


@device
def descend(tree, x, y, z, limit, stack, gap, top):
    """(low, high, top): the leaf below stack[top] on whose side (x, y, z) lies, and the stack's new height.

    What lies on the other sides of the planes, nearer than the squared distance `limit`, is left on the stack.
    """
    node, low, high = stack[top, 0], stack[top, 1], stack[top, 2]
    while high - low > LEAF:
        axis = tree.axis[node]
        d = (x if axis == 0 else (y if axis == 1 else z)) - tree.plane[node]
        middle = (low + high) // 2
        node = 2 * node + 1
        gap[top] = d * d
        if d < 0.0:
            stack[top, 0], stack[top, 1], stack[top, 2] = node + 1, middle, high
            high = middle
        else:
            stack[top, 0], stack[top, 1], stack[top, 2] = node, low, middle
            low = middle
            node += 1
        if gap[top] < limit:
            top += 1
    return low, high, top


@_jit
def nearest(tree, x, y, z, guess, stack, gap):
    """(place in the tree, squared distance) of the point nearest to (x, y, z); place -1 if there is none.

    guess: place of a point that may be near, or -1; stack (STACK, 3) int64, gap (STACK,) float64: room to work in.
    """
    best, best2 = guess, np.inf
    if guess >= 0:
        best2 = squared(tree, guess, x, y, z)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, len(tree.point)
    gap[0] = 0.0
    top = 1
    while top > 0:
        top -= 1
        if gap[top] >= best2:
            continue
        low, high, top = descend(tree, x, y, z, best2, stack, gap, top)
        for i in range(low, high):
            d2 = squared(tree, i, x, y, z)
            if d2 < best2:
                best, best2 = i, d2
    return best, best2


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_each(tree, position, owner, distance2):
    """`nearest` for points (C, 3) float32: owner (C,) int32 in the order the tree was given, distance2 (C,) float64."""
    stack = np.empty((STACK, 3), np.int64)
    gap = np.empty(STACK)
    guess = np.int64(-1)
    for c in range(len(position)):
        guess, d2 = nearest(
            tree,
            np.float64(position[c, 0]),
            np.float64(position[c, 1]),
            np.float64(position[c, 2]),
            guess,
            stack,
            gap,
        )
        distance2[c] = d2
        owner[c] = tree.index[guess] if guess >= 0 else -1
