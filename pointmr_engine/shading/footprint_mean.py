"""Means over rays' footprints of what no pyramid filters: procedural textures, sampled at places of each footprint.

A checker or a noise has no stored levels as an image has. Seen from afar, one point of it stands for nothing: what a
material takes from it is evaluated at several points of the footprint, in the plane of the surface, and averaged
before shading, as prefiltered texels are.

Pyramids of images filter squares. Where a surface is seen obliquely, its footprint is longer than wide: images are read
at places along it, as wide as it is wide.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pointmr_engine.shading.differentials import moved_points, tangent_axes
from pointmr_engine.shading.points import SurfacePoints
from pointmr_engine.shading.values import cross, dot

NEEDS = frozenset({"moved", "footprint", "geometric_normal", "incoming", "position"})
GRAZING = 0.05  # cosine below which footprints on a surface grow no further
ALIKE = 0.1  # of their mean: largest difference between the first places' values that needs no others
FAINT = 0.01  # added to that mean
FIRST, ALL = 4, 16  # places of a footprint
OBLIQUE = 0.6  # cosine below which images are read at several places
FAR = 0.2  # ... and at all of them, where the first ones differ
OF_FEW = FIRST / (FIRST - 1)  # times the variance about the mean of so few

# the first points of Sobol's sequence: any 4 and all 16 are stratified
_U = np.array([0, 8, 12, 4, 6, 14, 10, 2, 3, 11, 15, 7, 5, 13, 9, 1], np.float64) / ALL
_V = np.array([0, 8, 4, 12, 6, 14, 2, 10, 5, 13, 1, 9, 3, 11, 7, 15], np.float64) / ALL


def footprint_means(
    run: Callable[[SurfacePoints], dict],
    gather: Callable[[np.ndarray], SurfacePoints],
    rows: np.ndarray,
    needs: frozenset[str],
    seed: int = 0,
    few: frozenset = frozenset(),
    rest: Callable[[SurfacePoints], dict] | None = None,
) -> dict:
    """Values by name, each (n,) or (n, 3) float32: the means over the footprints of points `rows` (n,).

    run(points): the values at points, by name; needs: what it reads. gather(rows): the points with these fields, and
    with NEEDS. seed: another one has other places. few: names of values for which the first places are enough;
    rest(points): the others.
    """
    first = _at_places(run, gather, rows, needs, seed, 0, FIRST)
    mean = {name: v.mean(0) for name, v in first.items()}
    more = np.flatnonzero(_differs(first, mean, first.keys() - few))
    if len(more):
        others = _at_places(rest or run, gather, rows[more], needs, seed, FIRST, ALL)
        for name, v in others.items():
            mean[name][more] = (mean[name][more] * FIRST + v.sum(0)) / np.float32(ALL)
    return mean


def stretched_means(
    run: Callable[[SurfacePoints], dict],
    gather: Callable[[np.ndarray], SurfacePoints],
    rows: np.ndarray,
    needs: frozenset[str],
    cosine: np.ndarray,
) -> dict:
    """`footprint_means` of what images decide, along footprints: at each place they are filtered over a square.

    cosine (n,): to the viewers, all below OBLIQUE.
    """

    def along(index: np.ndarray, count: int) -> dict:
        points = gather(rows[index])
        _, b = _axes(points)
        steep = np.maximum(cosine[index], GRAZING).astype(np.float64)
        places = np.linspace(-0.5, 0.5, count)[:, None, None]
        # places have their own width, which is that of the whole footprint across the view
        return _values_at(run, points, places * ((1.0 - steep)[:, None] * b), needs, np.sqrt(steep))

    first = along(np.arange(len(rows)), FIRST)
    mean = {name: v.mean(0) for name, v in first.items()}
    more = np.flatnonzero((cosine < FAR) & _differs(first, mean, first.keys()))
    if len(more):
        for name, v in along(more, ALL).items():
            mean[name][more] = v.mean(0)
    return mean


def _differs(first: dict, mean: dict, names) -> np.ndarray:
    """(n,) bool: whether the first places' values (FIRST, n, ...) differ, of any of the names."""
    differs = np.zeros(len(next(iter(mean.values()))), np.bool_)
    for name in names:
        v = first[name]
        apart = v.max(0) - v.min(0) > ALIKE * (np.abs(mean[name]) + FAINT)
        differs |= apart if apart.ndim == 1 else apart.any(1)
    return differs


def slope_variance(means: list[np.ndarray]) -> np.ndarray:
    """(n,) float32 variance of slopes along one axis, of unit normals of which means (n, 3) of FIRST places are given;
    of several, the largest (Toksvig 2005, "Mipmapping Normal Maps").
    """
    length = np.sqrt(np.min([dot(m, m) for m in means], axis=0))
    return np.maximum(1.0 / np.maximum(length, 0.1) - 1.0, 0.0).astype(np.float32) * np.float32(OF_FEW)


def _at_places(run, gather, rows: np.ndarray, needs, seed: int, begin: int, end: int) -> dict:
    """Values (end - begin, n, ...) at places begin..end of the footprints of points `rows`, all in one batch."""
    points = gather(rows)
    a, b = _axes(points)
    u, v = _turns(points.position, seed)
    u = (u + _U[begin:end, None]) % 1 - 0.5
    v = (v + _V[begin:end, None]) % 1 - 0.5
    return _values_at(run, points, u[..., None] * a + v[..., None] * b, needs)


def _values_at(run, points: SurfacePoints, offset: np.ndarray, needs, narrower=None) -> dict:
    """Values (count, n, ...) at the n points moved by offset (count, n, 3), all in one batch.

    narrower (n,): of the footprints of UVs, which are as large as those on the oblique surface.
    """
    count, n = offset.shape[:2]
    moved = moved_points(points, offset.reshape(-1, 3), needs)
    if narrower is not None:
        scale = np.tile(narrower.astype(np.float32), count)
        moved.uv_footprints = {k: v * scale for k, v in moved.uv_footprints.items()}
    # far outside a triangle its normals go anywhere; how the surface itself bends is not a matter of textures
    for name in ("normal", "smooth_normal"):
        if getattr(moved, name) is not None:
            setattr(moved, name, np.tile(getattr(points, name), (count, 1)))
    moved.tangents = {k: np.tile(points.tangents[k], (count, 1)) for k in moved.tangents}
    values = run(moved)
    return {
        name: np.broadcast_to(x, (count * n, *x.shape[1:])).reshape(count, n, *x.shape[1:])
        for name, x in values.items()
    }


def _axes(points: SurfacePoints) -> tuple[np.ndarray, np.ndarray]:
    """Sides (n, 3) float64 of the footprints on their surfaces, world space, metres: across the view and along it."""
    n = points.geometric_normal.astype(np.float64)
    across = cross(n, points.incoming.astype(np.float64))
    length = np.sqrt(dot(across, across))
    facing = length < 1e-6
    if facing.any():
        across[facing], length[facing] = tangent_axes(n[facing])[0], 1.0
    across /= length[:, None]
    width = points.footprint.astype(np.float64)
    cosine = np.maximum(np.abs(dot(n, points.incoming)), GRAZING)
    return width[:, None] * across, (width / cosine)[:, None] * cross(across, n)


def _turns(position: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two numbers (n,) in 0..1 for each position (n, 3) float64: where the places of its footprint begin."""
    h = np.full(len(position), np.uint64(0x9E3779B97F4A7C15 * (2 * seed + 1) & 0xFFFFFFFFFFFFFFFF))
    for c in range(3):
        h = (h ^ np.ascontiguousarray(position[:, c]).view(np.uint64)) * np.uint64(0xBF58476D1CE4E5B9)
        h ^= h >> np.uint64(29)
    return (h >> np.uint64(40)) / 2.0**24, (h & np.uint64(0xFFFFFF)) / 2.0**24
