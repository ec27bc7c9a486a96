"""Which triangles with holes can share samples of their opacity.

Triangles under one material look the same where what it reads is the same at their corners. What does not vary over a
triangle, such as its leaf's colour, may change how much light it lets through, but seldom its shape: triangles that
differ in nothing else share the samples of one of them, their leader, if some of their own points agree with it. What
agrees with no leader is sampled alone.

What goes by the view alone, as a mix by Fresnel does, is nearly even over small triangles: those that are share their
samples with all others of the same opacity.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pointmr_engine.forward.baked.opacity_lattice import in_triangle, lattice
from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.raytracing.surface import RAY_NEEDS, points_at
from pointmr_engine.shading.points import names_of
from pointmr_engine.shading.program import OF_INSTANCE

LOOKS = 16  # points of a triangle that are compared with its leader's
SIDE = 32  # samples along the edges of leaders while they are compared
TOLERANCE = 0.12  # of opacity
# columns of it that are compared: outlines that brighten what passes, or do not, tell no triangles apart
SHARES = 4
LEADERS = 16  # at most, of triangles that vary alike
EVEN = 0.02  # difference of opacity over a triangle that is even
_QUANTUM = 1.0 / 4096  # of texture coordinates
# the same for all points, or not of their places
_PLACELESS = frozenset({"footprint", "uv_footprint", "geometric_normal", "moved"}) | OF_INSTANCE
_LAYERED = frozenset({"uv", "attribute"})
# what varies over a triangle as smooth normals do, or not at all
_BY_VIEW = frozenset({"incoming", "backfacing", "normal", "smooth_normal"}) | RAY_NEEDS
# where it is looked whether triangles are even: their middle, and near their corners
_MIDDLE_AND_CORNERS = np.array(((1 / 3, 1 / 3), (0.02, 0.02), (0.96, 0.02), (0.02, 0.96)), np.float32)

Opacity = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def opacity_classes(
    geometry: Geometry, part: int, needs: frozenset, triangles: np.ndarray, opacity: Opacity
) -> tuple[np.ndarray, np.ndarray]:
    """(places in `triangles` of those to be sampled, for each triangle its one of these).

    triangles (n,) int64 of a part under one material, which reads `needs`; opacity(triangles, u, v): (n, c), 0..1, at
    one point of each.
    """
    alone = np.arange(len(triangles))
    names = names_of(needs)
    if not names <= _LAYERED | _PLACELESS | _BY_VIEW:
        return alone, alone
    corners = _at_corners(geometry, part, needs, triangles)
    varies = (corners != corners[:, :1]).any((0, 1))
    if not varies.any():
        return _even(triangles, opacity)
    if names & _BY_VIEW:
        return alone, alone
    keys = np.round(corners[:, :, varies] / _QUANTUM).reshape(len(triangles), -1)
    _, first, classes = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return _led(triangles, classes.ravel(), opacity) if len(first) < len(triangles) else (alone, alone)


def _even(triangles: np.ndarray, opacity: Opacity) -> tuple[np.ndarray, np.ndarray]:
    """`opacity_classes` of triangles over which nothing varies but what is seen: by their opacity, where it is even."""
    n = len(triangles)
    found = [opacity(triangles, np.full(n, u), np.full(n, v)) for u, v in _MIDDLE_AND_CORNERS]
    levels = np.round(255.0 * found[0]).astype(np.int64)
    uneven = np.ptp(found, axis=0).max(1) > EVEN
    key = levels @ 256 ** np.arange(levels.shape[1])
    key[uneven] = -1 - np.flatnonzero(uneven)
    _, first, classes = np.unique(key, return_index=True, return_inverse=True)
    return first, classes.ravel()


def _into_triangle(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of the unit square in the triangle u + v <= 1: what lies beyond its edge is turned into it."""
    outside = u + v > 1.0
    return np.where(outside, 1.0 - u, u), np.where(outside, 1.0 - v, v)


def _at_corners(geometry: Geometry, part: int, needs: frozenset, triangles: np.ndarray) -> np.ndarray:
    """(n, 3, C) float32: what is read at the triangles' corners."""
    n = len(triangles)
    read = frozenset(need for need in needs if need.partition(":")[0] in _LAYERED)
    at = np.tile(np.array(((0, 0), (1, 0), (0, 1)), np.float32), (n, 1))
    points = points_at(
        geometry, np.full(3 * n, part, np.int32),
        (geometry.tables.first_triangle[part] + np.repeat(triangles, 3)).astype(np.int32), at[:, 0], at[:, 1],
        np.broadcast_to(np.eye(4)[:3], (3 * n, 3, 4)), read,
    )  # fmt: skip
    columns = [values for kept in (points.uvs, points.attributes) for _, values in sorted(kept.items())]
    return np.concatenate([np.zeros((3 * n, 1), np.float32), *columns], 1).reshape(n, 3, -1)


def _led(triangles: np.ndarray, classes: np.ndarray, opacity: Opacity) -> tuple[np.ndarray, np.ndarray]:
    """`opacity_classes` of triangles that vary alike within their classes: each follows a leader it agrees with."""
    n = len(triangles)
    rng = np.random.default_rng(n)
    u, v = _into_triangle(*rng.random((2, n, LOOKS)))
    own = opacity(np.repeat(triangles, LOOKS), u.ravel(), v.ravel())[:, :SHARES].reshape(n, LOOKS, -1)
    i, j = (np.minimum((a * SIDE).astype(np.int64), SIDE - 1) for a in (u, v))
    leader, todo = np.arange(n), np.arange(n)
    for _ in range(LEADERS):
        members, firsts, which = np.unique(classes[todo], return_index=True, return_inverse=True)
        if len(members) == len(todo):
            break
        heads = todo[firsts]
        least, most = _ranges(triangles[heads], opacity)
        at = which.ravel()[:, None], j[todo], i[todo]
        agrees = (own[todo] >= least[at] - TOLERANCE) & (own[todo] <= most[at] + TOLERANCE)
        agrees = agrees.all((1, 2))
        agrees[firsts] = True
        leader[todo[agrees]] = heads[which.ravel()[agrees]]
        todo = todo[~agrees]
    return np.unique(leader, return_inverse=True)


def _ranges(triangles: np.ndarray, opacity: Opacity) -> tuple[np.ndarray, np.ndarray]:
    """(k, SIDE, SIDE, c) least and most of the opacity of triangles in each cell of a lattice and those around it."""
    k = len(triangles)
    u, v = lattice(SIDE, np.arange(k))
    cells = opacity(np.repeat(triangles, SIDE * SIDE), u.ravel(), v.ravel())
    cells = cells[:, :SHARES].reshape(k, SIDE, SIDE, -1)
    # cells beyond the longest edge lie in the other half, far away: they take their neighbours' values
    cells[:, ~in_triangle(SIDE)] = np.nan
    padded = np.pad(cells, ((0, 0), (1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    near = [padded[:, y : y + SIDE, x : x + SIDE] for y in range(3) for x in range(3)]
    return np.fmin.reduce(near), np.fmax.reduce(near)
