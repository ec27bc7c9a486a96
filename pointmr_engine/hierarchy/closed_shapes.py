"""Closed shapes: meshes whose surfaces, but for small openings, bound bodies, so that rays meet a back behind a front.

Of leaves and sheets either side may be seen, of bodies the outside alone: what a part of one covers is less.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.disjoint_sets import connected

OPEN = 0.1  # share of edges that may belong to one triangle, as those at the ends of tubes do
NET = 0.1  # of the area, what may be left of it when the normals of each connected piece are summed
EDGES = 100_000  # of larger meshes, about as many edges are looked at


def is_closed(positions: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether connected pieces of triangles (T, 3) int32 of positions (V, 3) are closed, but for small openings.

    Corners are shared by index. Triangles that are not finite count as nothing.
    """
    if not len(triangles) or _open_share(triangles) > OPEN:
        return False
    corner = positions[triangles].astype(np.float64)
    area = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area[~np.isfinite(area).all(1)] = 0.0
    # any two of a triangle's edges connect its corners
    edges = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    piece = connected(edges, triangles[:, 0], len(positions))
    net = np.stack([np.bincount(piece, area[:, k]) for k in range(3)], 1)
    return bool(np.linalg.norm(net, axis=1).sum() <= NET * np.linalg.norm(area, axis=1).sum())


def _open_share(triangles: np.ndarray) -> float:
    """Share of directed edges that no other triangle has the other way round."""
    a, b = triangles.ravel(), np.roll(triangles, -1, 1).ravel()
    every = max(a.size // EDGES, 1)
    if every > 1:
        some = np.minimum(a, b) % every == 0
        a, b = a[some], b[some]
    there, back = (x.astype(np.int64) << 32 | y for x, y in ((a, b), (b, a)))
    return 1.0 - float(np.isin(there, back).mean()) if len(there) else 0.0
