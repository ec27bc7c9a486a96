"""Triangles that the near plane cuts: pieces that lie in front of it, by places in the triangle.

A place is a pair (u, v) of barycentric weights of vertices 1 and 2.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import device

WHOLE = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))  # a triangle's own corners


@device
def clip(corners, near):
    """(number of pieces of the triangle with corners (3, 3) in camera space, the vertex that is alone on its side, the
    shares of the edges from it to the next two that lie on its side); -1 and 0 for the last of one that is not cut."""
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        z, za, zb = corners[k, 2], corners[a, 2], corners[b, 2]
        front = z >= near
        if (za >= near) != front and (zb >= near) != front:
            return np.int64(1 if front else 2), np.int64(k), (near - z) / (za - z), (near - z) / (zb - z)
    return np.int64(1 if corners[0, 2] >= near else 0), np.int64(-1), 0.0, 0.0


@device
def _on_edge(k, n, t):
    """The place at t of the way from vertex k to vertex n."""
    u = (1.0 - t if k == 1 else 0.0) + (t if n == 1 else 0.0)
    return u, (1.0 - t if k == 2 else 0.0) + (t if n == 2 else 0.0)


@device
def corners_of_piece(piece, pieces, k, s, t):
    """Places of the corners of a piece; pieces, k, s, t: as clip returns them."""
    if k < 0:
        return WHOLE
    n, m = (k + 1) % 3, (k + 2) % 3
    if pieces == 1:
        return _on_edge(k, k, 0.0), _on_edge(k, n, s), _on_edge(k, m, t)
    if piece == 0:
        return _on_edge(k, n, s), _on_edge(n, n, 0.0), _on_edge(m, m, 0.0)
    return _on_edge(k, n, s), _on_edge(m, m, 0.0), _on_edge(k, m, t)


@device
def at_place(corners, near, at):
    """(x, y, z) in camera space of a place that does not lie behind the near plane."""
    u, v = at
    t = 1.0 - u - v
    x = t * corners[0, 0] + u * corners[1, 0] + v * corners[2, 0]
    y = t * corners[0, 1] + u * corners[1, 1] + v * corners[2, 1]
    return x, y, max(t * corners[0, 2] + u * corners[1, 2] + v * corners[2, 2], near)
