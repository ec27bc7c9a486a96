"""Disjoint sets by union of ranks, with path halving (Tarjan and van Leeuwen 1984)."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import device, uncounted


def connected(edges: np.ndarray, elements: np.ndarray, count: int) -> np.ndarray:
    """(M,) int32: of each of `elements` (M,), one that stands for all that edges (E, 2) connect it with, of `count`.

    Which one does depends on the order of the edges.
    """
    parent, rank = np.arange(count, dtype=np.int32), np.zeros(count, np.int32)
    _join_edges(np.ascontiguousarray(edges, np.int32), parent, rank)
    roots = np.empty(len(elements), np.int32)
    _roots_of(np.ascontiguousarray(elements, np.int32), parent, roots)
    return roots


@device
def _root(parent, x):
    while parent[x] != x:
        parent[x] = parent[parent[x]]
        x = np.int64(parent[x])
    return x


@uncounted
def _join_edges(edges, parent, rank):
    """Join the sets of both ends of each edge (E, 2) int32, in order; of equal rank, the first takes in the second.

    parent (N,) int32: N elements that are their own parents to begin with; rank (N,) int32, 0. Both are changed.
    """
    for e in range(len(edges)):
        x, y = _root(parent, np.int64(edges[e, 0])), _root(parent, np.int64(edges[e, 1]))
        if x == y:
            continue
        if rank[x] < rank[y]:
            x, y = y, x
        parent[y] = x
        if rank[x] == rank[y]:
            rank[x] += 1


@uncounted
def _roots_of(elements, parent, out):
    """out (M,) int32: the element that stands for the set of each of `elements` (M,) int32."""
    for k in range(len(elements)):
        out[k] = _root(parent, np.int64(elements[k]))
