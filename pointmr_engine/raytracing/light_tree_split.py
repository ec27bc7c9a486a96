"""Clusters of the light tree: splits by brightness, extent and orientation, then their cones from the leaves up."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.raytracing.light_tree_nodes import (
    AX,
    BEHIND,
    COLUMNS,
    COS_O,
    COS_OE,
    CX,
    ENERGY,
    HX,
    KIND,
    RADIUS,
    SIN_O,
)

_BINS = 12
BUCKET = 8  # lights that are not divided further
# columns of a bin: lower and upper corner, sum of energy-weighted axes, energy, number of lights
_LOW, _HIGH, _AXIS, _SUM, _COUNT = 0, 3, 6, 9, 10

_jit = njit(cache=True, nogil=True, error_model="numpy")


def split(values: np.ndarray):
    """Divide n lights into buckets of at most BUCKET: (order (n,), span (C, 2), parent (C,), first_child (C,)).

    Cluster k, a child after its parent, holds the lights order[span[k, 0] : span[k, 1]]; first_child -1: a bucket.
    """
    n = len(values)
    order = np.arange(n, dtype=np.int32)
    span = np.zeros((2 * n, 2), np.int32)
    parent = np.full(2 * n, -1, np.int32)
    child = np.full(2 * n, -1, np.int32)
    count = _split(
        values, order, np.empty(n, np.int32), span, parent, child, np.empty((4, _BINS, 11)), np.empty(6)
    )
    return order, span[:count].copy(), parent[:count].copy(), child[:count].copy()


def gather(lights: np.ndarray, span: np.ndarray, first_child: np.ndarray) -> np.ndarray:
    """(C, COLUMNS) values of the clusters over `lights`, which are in the order of the tree."""
    out = np.zeros((len(span), COLUMNS))
    _gather(out, lights, span, first_child)
    return out


@_jit
def _clear(bins):
    for k in range(3):
        for b in range(_BINS):
            for c in range(11):
                bins[k, b, c] = math.inf if c < _HIGH else (-math.inf if c < _AXIS else 0.0)


@_jit
def _copy(into, other):
    for k in range(11):
        into[k] = other[k]


@_jit
def _merge(into, other):
    for k in range(3):
        into[_LOW + k] = min(into[_LOW + k], other[_LOW + k])
        into[_HIGH + k] = max(into[_HIGH + k], other[_HIGH + k])
    for k in range(_AXIS, 11):
        into[k] += other[k]


@_jit
def _cost(side):
    """Energy times surface times how far the lights' axes differ."""
    if side[_COUNT] == 0.0:
        return 0.0
    x, y, z = side[_HIGH] - side[_LOW], side[_HIGH + 1] - side[_LOW + 1], side[_HIGH + 2] - side[_LOW + 2]
    size = math.sqrt(side[_AXIS] ** 2 + side[_AXIS + 1] ** 2 + side[_AXIS + 2] ** 2)
    spread = 1.0 - min(1.0, size / max(side[_SUM], 1e-300))
    return side[_SUM] * (x * y + y * z + z * x + 1e-4 * (x * x + y * y + z * z)) * (1.0 + 3.0 * spread)


@_jit
def _best_split(values, order, first, last, bins, bounds):
    """(axis, bin, lower bound, width) of the cheapest split; axis -1 if all centres coincide."""
    best, best_axis, best_bin, best_low, best_width = math.inf, -1, 0, 0.0, 1.0
    low, high = bounds[:3], bounds[3:]
    for k in range(3):
        low[k], high[k] = math.inf, -math.inf
    for i in range(first, last):
        v = values[order[i]]
        for k in range(3):
            low[k] = min(low[k], v[CX + k])
            high[k] = max(high[k], v[CX + k])
    widest = max(high[0] - low[0], high[1] - low[1], high[2] - low[2])
    if not widest > 0.0:
        return -1, 0, 0.0, 1.0
    _clear(bins)
    reference = values[order[first]]
    for i in range(first, last):
        v = values[order[i]]
        turn = 1.0
        if v[BEHIND] == 1.0 and v[COS_O] > 0.0:
            # what shines to both sides has no sign: turn it like the first
            dot = v[AX] * reference[AX] + v[AX + 1] * reference[AX + 1] + v[AX + 2] * reference[AX + 2]
            turn = math.copysign(1.0, dot)
        weight = turn * v[ENERGY] * (1.0 if v[COS_O] > 0.0 else 0.0)
        for k in range(3):
            width = high[k] - low[k]
            if not width > 0.0:
                continue
            b = bins[k, min(_BINS - 1, int((v[CX + k] - low[k]) / width * _BINS))]
            for j in range(3):
                b[_LOW + j] = min(b[_LOW + j], v[CX + j] - v[HX + j])
                b[_HIGH + j] = max(b[_HIGH + j], v[CX + j] + v[HX + j])
                b[_AXIS + j] += weight * v[AX + j]
            b[_SUM] += v[ENERGY]
            b[_COUNT] += 1.0
    side, right = bins[3, 0], bins[3, 1:, 0]
    for k in range(3):
        width = high[k] - low[k]
        if not width > 0.0:
            continue
        stretch = widest / width  # thin boxes are costly to split along their thin side
        _copy(side, bins[k, _BINS - 1])
        right[_BINS - 2] = _cost(side)
        for b in range(_BINS - 2, 0, -1):
            _merge(side, bins[k, b])
            right[b - 1] = _cost(side)
        _copy(side, bins[k, 0])
        for b in range(1, _BINS):
            cost = stretch * (_cost(side) + right[b - 1])
            if cost < best:
                best, best_axis, best_bin, best_low, best_width = cost, k, b, low[k], width
            _merge(side, bins[k, b])
    return best_axis, best_bin, best_low, best_width


@_jit
def _split(values, order, spare, span, parent, first_child, bins, bounds):
    span[0, 0], span[0, 1] = 0, len(order)
    count = 1
    node = 0
    while node < count:
        first, last = span[node, 0], span[node, 1]
        if last - first > BUCKET:
            middle = first
            axis, border, low, width = _best_split(values, order, first, last, bins, bounds)
            if axis >= 0:
                high = 0
                for i in range(first, last):
                    light = order[i]
                    if min(_BINS - 1, int((values[light, CX + axis] - low) / width * _BINS)) < border:
                        order[middle] = light
                        middle += 1
                    else:
                        spare[high] = light
                        high += 1
                for i in range(high):
                    order[middle + i] = spare[i]
            if middle == first or middle == last:
                middle = (first + last) // 2
            first_child[node] = count
            for k in range(2):
                span[count + k, 0] = first if k == 0 else middle
                span[count + k, 1] = middle if k == 0 else last
                parent[count + k] = node
            count += 2
        node += 1
    return count


@_jit
def _union_cone(out, a, b):
    """Cone of axes around those of two nodes; `out` may be one of them."""
    behind_a, behind_b = a[BEHIND], b[BEHIND]
    out_cos, out_sin, out_oe = -1.0, 0.0, -1.0
    x, y, z = 0.0, 0.0, 1.0
    if a[COS_O] > -1.0 and b[COS_O] > -1.0:
        angle_a, angle_b = math.acos(min(1.0, a[COS_O])), math.acos(min(1.0, b[COS_O]))
        emission_a = math.acos(max(-1.0, min(1.0, a[COS_OE]))) - angle_a
        emission_b = math.acos(max(-1.0, min(1.0, b[COS_OE]))) - angle_b
        dot = a[AX] * b[AX] + a[AX + 1] * b[AX + 1] + a[AX + 2] * b[AX + 2]
        turn = 1.0
        if dot < 0.0 and behind_a == 1.0 and behind_b == 1.0:
            turn, dot = -1.0, -dot
        between = math.acos(max(-1.0, min(1.0, dot)))
        angle = max(angle_a, angle_b)
        share_a, share_b = (1.0, 0.0) if angle_a >= angle_b else (0.0, 1.0)
        if between + min(angle_a, angle_b) > angle:
            # turn a's axis towards b's so that both cones touch the new one's border
            angle = 0.5 * (angle_a + between + angle_b)
            if between < 3.1415:
                share_a = math.sin(between - (angle - angle_a)) / math.sin(between)
                share_b = turn * math.sin(angle - angle_a) / math.sin(between)
            else:
                angle = math.pi
        angle += 1e-6  # rounding must not leave an axis outside
        if angle < math.pi:
            x = share_a * a[AX] + share_b * b[AX]
            y = share_a * a[AX + 1] + share_b * b[AX + 1]
            z = share_a * a[AX + 2] + share_b * b[AX + 2]
            out_cos, out_sin = math.cos(angle), math.sin(angle)
            out_oe = math.cos(min(math.pi, angle + max(emission_a, emission_b) + 1e-6))
    out[BEHIND] = max(behind_a, behind_b)
    out[COS_O], out[SIN_O], out[COS_OE] = out_cos, out_sin, out_oe
    out[AX], out[AX + 1], out[AX + 2] = x, y, z


@_jit
def _unite(out, a, b):
    """Box, energy and cone of two nodes; `out` may be one of them."""
    box = 0.0
    _union_cone(out, a, b)
    for k in range(3):
        low = min(a[CX + k] - a[HX + k], b[CX + k] - b[HX + k])
        high = max(a[CX + k] + a[HX + k], b[CX + k] + b[HX + k])
        out[CX + k] = 0.5 * (low + high)
        out[HX + k] = 0.5 * (high - low)
        box += out[HX + k] * out[HX + k]
    out[RADIUS] = math.sqrt(box)
    out[ENERGY] = a[ENERGY] + b[ENERGY]


@_jit
def _gather(clusters, lights, span, first_child):
    """From the last cluster, so children before parents."""
    for node in range(len(first_child) - 1, -1, -1):
        child = first_child[node]
        if child >= 0:
            _unite(clusters[node], clusters[child], clusters[child + 1])
            continue
        for c in range(COLUMNS):
            clusters[node, c] = lights[span[node, 0], c]
        for light in range(span[node, 0] + 1, span[node, 1]):
            _unite(clusters[node], clusters[node], lights[light])
        clusters[node, KIND] = 0.0
