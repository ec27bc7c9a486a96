"""Nodes of the dynamic octree: insertion, deletion and random choice of items along one path of the tree."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

SLOTS = 8  # items that a node holds itself
MORE = 8  # the ninth child: a node for further items of the same place and size, told apart by their numbers
ROOM = 2048  # free nodes that the longest insertion may need
_REST = 1e-12  # of the largest coordinate: no cell is smaller


class Nodes(NamedTuple):
    """The tree's nodes; row 0 is never a child."""

    child: np.ndarray  # (N, 9) int32, -1: none; octants (bit 0: upper x, 1: y, 2: z), and MORE
    slot: np.ndarray  # (N, 8) int32 items of its own, -1: free
    parent: np.ndarray  # (N,) int32, -1: the root; in the list of free nodes: the next
    place: np.ndarray  # (N,) int32, which child of its parent
    digits: np.ndarray  # (N,) int32, -1: a cell; else a MORE node this many digits of item numbers deep
    area: np.ndarray  # (N,) float64 of all below
    box: np.ndarray  # (N, 6) float64, of all below


class Items(NamedTuple):
    """The items, by number."""

    row: np.ndarray  # (M, 2) int32, the caller's: as in OctreeArrays.item
    area: np.ndarray  # (M,) float64
    box: np.ndarray  # (M, 6) float64
    size: np.ndarray  # (M,) float64
    node: np.ndarray  # (M,) int32 it lies in; -1: deleted
    next: np.ndarray  # (M,) int32, of the list of free numbers


@njit(cache=True, nogil=True, error_model="numpy")
def new_node(nodes, state, parent, place, digits):
    """An empty node as child `place` of `parent` (-1: a root); returns its row. state: see DynamicOctree."""
    n = state[1]
    if n >= 0:
        state[1] = nodes.parent[n]
    else:
        n = state[2]
        state[2] += 1
    for k in range(9):
        nodes.child[n, k] = -1
    for k in range(8):
        nodes.slot[n, k] = -1
    nodes.parent[n] = parent
    nodes.place[n] = place
    nodes.digits[n] = digits
    nodes.area[n] = 0.0
    for k in range(3):
        nodes.box[n, k] = np.inf
        nodes.box[n, 3 + k] = -np.inf
    if parent >= 0:
        nodes.child[parent, place] = n
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def _refresh(nodes, items, n):
    """Sum and box of one node from what is directly below; returns whether that is anything."""
    area = 0.0
    found = False
    for k in range(3):
        nodes.box[n, k] = np.inf
        nodes.box[n, 3 + k] = -np.inf
    for s in range(SLOTS):
        i = nodes.slot[n, s]
        if i >= 0:
            found = True
            area += items.area[i]
            for k in range(3):
                nodes.box[n, k] = min(nodes.box[n, k], items.box[i, k])
                nodes.box[n, 3 + k] = max(nodes.box[n, 3 + k], items.box[i, 3 + k])
    for s in range(9):
        c = nodes.child[n, s]
        if c >= 0:
            found = True
            area += nodes.area[c]
            for k in range(3):
                nodes.box[n, k] = min(nodes.box[n, k], nodes.box[c, k])
                nodes.box[n, 3 + k] = max(nodes.box[n, 3 + k], nodes.box[c, 3 + k])
    nodes.area[n] = area
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _refresh_up(nodes, items, state, n):
    """Refresh a node and those above it; remove the empty ones, but for the root."""
    while n >= 0:
        state[6] += 1
        found = _refresh(nodes, items, n)
        above = np.int64(nodes.parent[n])
        if not found and above >= 0:
            nodes.child[above, nodes.place[n]] = -1
            nodes.parent[n] = state[1]
            state[1] = n
        n = above


@njit(cache=True, nogil=True, error_model="numpy")
def _take_slot(nodes, items, n, i):
    for s in range(SLOTS):
        if nodes.slot[n, s] < 0:
            nodes.slot[n, s] = i
            items.node[i] = n
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _octant(items, i, x, y, z):
    o = np.int64(0)
    if items.box[i, 0] + items.box[i, 3] >= 2.0 * x:
        o += 1
    if items.box[i, 1] + items.box[i, 4] >= 2.0 * y:
        o += 2
    if items.box[i, 2] + items.box[i, 5] >= 2.0 * z:
        o += 4
    return o


@njit(cache=True, nogil=True, error_model="numpy")
def _split(nodes, items, state, n, x, y, z, side):
    """Send a leaf's items that fit into smaller cells down one level."""
    moved = False
    for s in range(SLOTS):
        i = np.int64(nodes.slot[n, s])
        if 0.5 * side < items.size[i]:
            continue
        o = _octant(items, i, x, y, z)
        if nodes.child[n, o] < 0:
            new_node(nodes, state, n, o, np.int64(-1))
        _take_slot(nodes, items, np.int64(nodes.child[n, o]), i)
        nodes.slot[n, s] = -1
        moved = True
    if moved:
        for o in range(8):
            if nodes.child[n, o] >= 0:
                _refresh(nodes, items, np.int64(nodes.child[n, o]))


@njit(cache=True, nogil=True, error_model="numpy")
def _raise_root(nodes, items, state, cell, i):
    """Double the root's cell until it holds the item's centre."""
    mx, my, mz = (
        0.5 * (items.box[i, 0] + items.box[i, 3]),
        0.5 * (items.box[i, 1] + items.box[i, 4]),
        0.5 * (items.box[i, 2] + items.box[i, 5]),
    )
    if state[5] == 0:
        cell[0] = mx
        cell[1] = my
        cell[2] = mz
        cell[3] = 4.0 * items.size[i]
        return
    while True:
        half = 0.5 * cell[3]
        dx, dy, dz = mx - cell[0], my - cell[1], mz - cell[2]
        if abs(dx) < half and abs(dy) < half and abs(dz) < half:
            return
        state[6] += 1
        old = state[0]
        place = np.int64(0)  # the old cell's octant in the new one
        if dx < 0.0:
            place += 1
        if dy < 0.0:
            place += 2
        if dz < 0.0:
            place += 4
        cell[0] += half if dx >= 0.0 else -half
        cell[1] += half if dy >= 0.0 else -half
        cell[2] += half if dz >= 0.0 else -half
        cell[3] *= 2.0
        new = new_node(nodes, state, np.int64(-1), np.int64(0), np.int64(-1))
        nodes.parent[old] = new
        nodes.place[old] = place
        nodes.child[new, place] = old
        _refresh(nodes, items, new)
        state[0] = new


@njit(cache=True, nogil=True, error_model="numpy")
def _insert(nodes, items, state, cell, i):
    _raise_root(nodes, items, state, cell, i)
    n = state[0]
    x, y, z, side = cell[0], cell[1], cell[2], cell[3]
    while True:
        state[6] += 1
        digits = np.int64(nodes.digits[n])
        if digits >= 0:
            if _take_slot(nodes, items, n, i):
                break
            place = (i >> (3 * digits)) & 7
            if nodes.child[n, place] < 0:
                new_node(nodes, state, n, place, digits + 1)
            n = np.int64(nodes.child[n, place])
            continue
        leaf = True
        for k in range(9):
            leaf = leaf and nodes.child[n, k] < 0
        if leaf:
            if _take_slot(nodes, items, n, i):
                break
            _split(nodes, items, state, n, x, y, z, side)
        if 0.5 * side >= items.size[i]:
            o = _octant(items, i, x, y, z)
            if nodes.child[n, o] < 0:
                new_node(nodes, state, n, o, np.int64(-1))
            n = np.int64(nodes.child[n, o])
            side *= 0.5
            x += 0.5 * side if o & 1 else -0.5 * side
            y += 0.5 * side if o & 2 else -0.5 * side
            z += 0.5 * side if o & 4 else -0.5 * side
        else:
            if _take_slot(nodes, items, n, i):
                break
            if nodes.child[n, MORE] < 0:
                new_node(nodes, state, n, np.int64(MORE), np.int64(0))
            n = np.int64(nodes.child[n, MORE])
    _refresh_up(nodes, items, state, n)
    state[5] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def insert_many(nodes, items, state, cell, rows, areas, boxes, numbers, done):
    """Insert rows[done:] while there is room; returns how many are in."""
    for r in range(done, len(rows)):
        if state[2] + ROOM > len(nodes.area) or (state[3] < 0 and state[4] >= len(items.area)):
            return r
        i = state[3]
        if i >= 0:
            state[3] = items.next[i]
        else:
            i = state[4]
            state[4] += 1
        items.row[i, 0] = rows[r, 0]
        items.row[i, 1] = rows[r, 1]
        items.area[i] = areas[r]
        size, far = 0.0, 0.0
        for k in range(3):
            items.box[i, k] = boxes[r, k]
            items.box[i, 3 + k] = boxes[r, 3 + k]
            size = max(size, boxes[r, 3 + k] - boxes[r, k])
            far = max(far, abs(boxes[r, k]), abs(boxes[r, 3 + k]))
        items.size[i] = max(size, _REST * far, 1e-300)
        _insert(nodes, items, state, cell, i)
        numbers[r] = i
    return len(rows)


@njit(cache=True, nogil=True, error_model="numpy")
def delete_many(nodes, items, state, numbers):
    """Delete items that are there."""
    for r in range(len(numbers)):
        i = numbers[r]
        n = np.int64(items.node[i])
        for s in range(SLOTS):
            if nodes.slot[n, s] == i:
                nodes.slot[n, s] = -1
        items.node[i] = -1
        items.next[i] = state[3]
        state[3] = i
        state[5] -= 1
        _refresh_up(nodes, items, state, n)


@njit(cache=True, nogil=True, error_model="numpy")
def sample_many(nodes, items, state, us, out):
    """out[k] = number of the item that us[k] in [0, 1) falls on, by area."""
    for r in range(len(us)):
        n = state[0]
        x = us[r] * nodes.area[n]
        while n >= 0:
            state[6] += 1
            below, last, chosen = np.int64(-1), np.int64(-1), np.int64(-1)
            for s in range(SLOTS):
                i = np.int64(nodes.slot[n, s])
                if i >= 0 and chosen < 0:
                    last = i
                    if x < items.area[i]:
                        chosen = i
                    else:
                        x -= items.area[i]
            for s in range(9):
                c = np.int64(nodes.child[n, s])
                if c >= 0 and chosen < 0:
                    if x < nodes.area[c]:
                        below = c
                        break
                    x -= nodes.area[c]
                    last = -1 - c
            if chosen < 0 and below < 0:  # x was rounded up past the end
                if last >= 0:
                    chosen = last
                else:
                    below = -1 - last
                    x = nodes.area[below]
            if chosen >= 0:
                out[r] = chosen
                break
            n = below
