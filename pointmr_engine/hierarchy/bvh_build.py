"""Building eight-wide bounding volume hierarchies: binned surface area heuristic, straight to wide nodes."""

from __future__ import annotations

import numpy as np
from numba import njit

from pointmr_engine.numerics.simd import minimum_into

# A primitive is a row of eight float32: lower x, y, z, its number (as int32 bits), minus upper x, y, z, unused.
# With the upper side negated, the union of boxes is one eight-wide minimum.
NUMBER = 3
BINS = 16
EMPTY = np.int32(-(2**31))  # child of no content
FAR = np.float32(np.inf)
MEDIAN_DEPTH = 40  # deeper than this only halving splits are made: bounds the depth for any input


@njit(cache=True, nogil=True, error_model="numpy")
def half_area(bounds, row):
    """Half the surface of the box in bounds[row], a row as of primitives."""
    x = -bounds[row, 4] - bounds[row, 0]
    y = -bounds[row, 5] - bounds[row, 1]
    z = -bounds[row, 6] - bounds[row, 2]
    return x * y + y * z + z * x if x >= np.float32(0) else np.float32(0)


@njit(cache=True, nogil=True, error_model="numpy")
def _bin_range(prims, start, stop, low, scale, bins, counts, n_bins):
    for axis in range(3):
        for b in range(n_bins):
            counts[axis, b] = 0
            for k in range(8):
                bins[axis * BINS + b, k] = FAR
    last = np.int64(n_bins - 1)
    for i in range(start, stop):
        for axis in range(3):
            b = np.int64((prims[i, axis] - prims[i, 4 + axis] - low[axis]) * scale[axis])
            b = min(max(b, np.int64(0)), last)
            counts[axis, b] += 1
            minimum_into(bins, np.int64(axis * BINS) + b, prims, np.int64(i))


@njit(cache=True, nogil=True, error_model="numpy")
def _best_plane(bins, counts, n_bins, leaf_size, sweep, right):
    """(axis, last bin of the lower side) of the cheapest split; axis -1 where nothing separates."""
    best = np.inf
    best_axis, best_bin = -1, -1
    for axis in range(3):
        for k in range(8):
            sweep[0, k] = FAR
        n = 0
        for b in range(n_bins - 1, 0, -1):
            minimum_into(sweep, np.int64(0), bins, np.int64(axis * BINS + b))
            n += counts[axis, b]
            # in units of full leaves, for a leaf costs the same however full it is
            right[b] = half_area(sweep, np.int64(0)) * ((n + leaf_size - 1) // leaf_size) if n > 0 else np.inf
        for k in range(8):
            sweep[0, k] = FAR
        n = 0
        for b in range(n_bins - 1):
            minimum_into(sweep, np.int64(0), bins, np.int64(axis * BINS + b))
            n += counts[axis, b]
            if n > 0:
                cost = half_area(sweep, np.int64(0)) * ((n + leaf_size - 1) // leaf_size) + right[b + 1]
                if cost < best:
                    best, best_axis, best_bin = cost, axis, b
    return best_axis, best_bin


@njit(cache=True, nogil=True, error_model="numpy")
def _partition(prims, start, stop, axis, low, scale, plane, last):
    """Rows whose bin is at most `plane` first; returns where the others begin."""
    i, j = start, stop - 1
    while True:
        while i <= j:
            b = np.int64((prims[i, axis] - prims[i, 4 + axis] - low) * scale)
            if min(max(b, np.int64(0)), last) > plane:
                break
            i += 1
        while i <= j:
            b = np.int64((prims[j, axis] - prims[j, 4 + axis] - low) * scale)
            if min(max(b, np.int64(0)), last) <= plane:
                break
            j -= 1
        if i >= j:
            return i
        for k in range(8):
            a = prims[i, k]
            prims[i, k] = prims[j, k]
            prims[j, k] = a
        i += 1
        j -= 1


@njit(cache=True, nogil=True, error_model="numpy")
def _bounds_of(prims, start, stop, bounds, row):
    for k in range(8):
        bounds[row, k] = FAR
    for i in range(start, stop):
        minimum_into(bounds, np.int64(row), prims, np.int64(i))


@njit(cache=True, nogil=True, error_model="numpy")
def _split(prims, start, stop, leaf_size, median, bins, counts, low, scale, sweep, right):
    """Where the range is cut in two, both sides not empty."""
    middle = (start + stop) // 2
    if median:
        return middle
    n = stop - start
    n_bins = min(BINS, 4 + n // 8)
    for axis in range(3):
        lo, hi = FAR, -FAR
        for i in range(start, stop):
            c = prims[i, axis] - prims[i, 4 + axis]
            lo = min(lo, c)
            hi = max(hi, c)
        low[axis] = lo
        width = hi - lo
        scale[axis] = np.float32(n_bins * 0.99999) / width if width > np.float32(1e-30) else np.float32(0)
    _bin_range(prims, start, stop, low, scale, bins, counts, n_bins)
    axis, plane = _best_plane(bins, counts, n_bins, leaf_size, sweep, right)
    if axis < 0:
        return middle
    cut = _partition(prims, start, stop, axis, low[axis], scale[axis], np.int64(plane), np.int64(n_bins - 1))
    return middle if cut <= start or cut >= stop else cut


@njit(cache=True, nogil=True, error_model="numpy")
def _push(work, n, node, start, stop, depth):
    work[n, 0] = node
    work[n, 1] = start
    work[n, 2] = stop
    work[n, 3] = depth
    return n + 1


@njit(cache=True, nogil=True, error_model="numpy")
def build_wide(prims, leaf_size, first_node, first_leaf, boxes, children, leaves):
    """Build over `prims` (N, 8) float32 (reordered in place), at least one.

    Writes nodes from `first_node` on: boxes[node, 6 * 8] (lower x, y, z, upper x, y, z of eight children) and
    children[node, 8] (node, or ~leaf, or EMPTY); leaves from `first_leaf` on: leaves[leaf] = (start, stop), rows of
    prims.
    Returns (nodes, leaves, depth); nodes = -1 when boxes or leaves are too few.
    """
    bins = np.empty((3 * BINS, 8), np.float32)
    counts = np.empty((3, BINS), np.int64)
    low = np.empty(3, np.float32)
    scale = np.empty(3, np.float32)
    sweep = np.empty((1, 8), np.float32)
    right = np.empty(BINS, np.float64)
    bounds = np.empty((8, 8), np.float32)
    begin = np.empty(8, np.int64)
    end = np.empty(8, np.int64)
    # node, start, stop, depth: seven per level, and the depth is bounded
    work = np.empty((1024, 4), np.int64)
    n_work = _push(work, np.int64(0), np.int64(first_node), np.int64(0), np.int64(len(prims)), np.int64(1))
    n_nodes, n_leaves = first_node + 1, first_leaf
    deepest = 1
    if n_nodes > len(boxes):
        return -1, 0, 0
    while n_work > 0:
        n_work -= 1
        node, start, stop, depth = work[n_work, 0], work[n_work, 1], work[n_work, 2], work[n_work, 3]
        deepest = max(deepest, depth)
        begin[0], end[0] = start, stop
        _bounds_of(prims, start, stop, bounds, np.int64(0))
        n = np.int64(1)
        while n < 8:
            widest, area = np.int64(-1), np.float32(-1)
            for c in range(n):
                if end[c] - begin[c] > leaf_size:
                    a = half_area(bounds, np.int64(c))
                    if a > area or widest < 0:
                        widest, area = c, a
            if widest < 0:
                break
            s, e = begin[widest], end[widest]
            cut = _split(prims, s, e, leaf_size, depth > MEDIAN_DEPTH, bins, counts, low, scale, sweep, right)
            end[widest] = cut
            begin[n], end[n] = cut, e
            _bounds_of(prims, s, cut, bounds, widest)
            _bounds_of(prims, cut, e, bounds, n)
            n += 1
        for c in range(8):
            for axis in range(3):
                boxes[node, axis * 8 + c] = bounds[c, axis] if c < n else FAR
                boxes[node, 24 + axis * 8 + c] = -bounds[c, 4 + axis] if c < n else -FAR
            children[node, c] = EMPTY
        for c in range(n):
            if end[c] - begin[c] <= leaf_size:
                if n_leaves >= len(leaves):
                    return -1, 0, 0
                leaves[n_leaves, 0] = begin[c]
                leaves[n_leaves, 1] = end[c]
                children[node, c] = ~np.int32(n_leaves)
                n_leaves += 1
            else:
                if n_nodes >= len(boxes):
                    return -1, 0, 0
                children[node, c] = n_nodes
                n_work = _push(work, n_work, np.int64(n_nodes), begin[c], end[c], depth + 1)
                n_nodes += 1
    return n_nodes - first_node, n_leaves - first_leaf, deepest
