"""Samples of a surface: cut it into pieces, choose some, fill holes, give each sample the moments of its own pieces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.coverage import fill_uncovered
from pointmr_engine.hierarchy.moments import merge_moments
from pointmr_engine.hierarchy.nearest import build_tree, nearest_each
from pointmr_engine.hierarchy.pieces import Pieces, as_triangles, cut, positive
from pointmr_engine.hierarchy.strategies import select
from pointmr_engine.scene.errors import SceneError

PIECES_PER_SPACING = 4.0
# Pieces reach beyond their centres. Rather than fill a sliver beside every sample, neighbourhood-based sampling covers
# the centres a little more closely: measured, 0.95 of the spacing (4 pieces per spacing) takes 15 % fewer than 1.
_CLOSER = 0.2


class SurfaceSamples(NamedTuple):
    """K samples of a surface, and what each owns of it; space and units of the triangles."""

    position: np.ndarray  # (K, 3) float32: on the surface, for quantised_grid near it
    triangle: np.ndarray  # (K,) int32, a triangle on which it lies (quantised_grid: nearest to it)
    u: np.ndarray  # (K,) float32, the place on that triangle, (1 - u - v) a + u b + v c
    v: np.ndarray  # (K,) float32
    area: np.ndarray  # (K,) float32, of its own pieces; their sum is the surface's
    centroid: np.ndarray  # (K, 3) float32
    covariance: np.ndarray  # (K, 6) float32: xx, xy, xz, yy, yz, zz about the centroid, per area


def sample_triangles(
    triangles: np.ndarray,
    spacing: float,
    strategy: str = "neighbourhood",
    seed: int = 0,
    failure: float = 1e-3,
    pieces_per_spacing: float = PIECES_PER_SPACING,
) -> SurfaceSamples:
    """Samples of triangles (T, 3, 3) such that every point of them lies within `spacing` of one.

    strategy: one of strategies.STRATEGIES; `random` may leave holes instead, with a probability that `failure` sets.
    Candidates are pieces of size spacing / pieces_per_spacing. A sample without area owns no piece, but is needed to
    cover. Raises SceneError for values out of range.
    """
    triangles = as_triangles(triangles)
    spacing = positive(spacing, "spacing")
    finer = positive(pieces_per_spacing, "pieces_per_spacing")
    if finer < 2.0:
        # else a sample that is added to fill a hole could lie farther from its own piece's centre than others do
        raise SceneError(f"pieces_per_spacing must be at least 2, not {finer:g}")
    pieces = cut(triangles, spacing / finer)
    closer = 1.0 - _CLOSER / finer if strategy == "neighbourhood" else 1.0
    chosen = select(strategy, pieces.position, pieces.area, spacing * closer, seed, failure)
    position, owner = chosen.position, chosen.owner
    triangle, u, v = (part[chosen.representative] for part in (pieces.triangle, pieces.u, pieces.v))
    if strategy != "random" and len(owner):
        extra = fill_uncovered(triangles, position, spacing)
        if len(extra.triangle):
            owner = _nearer(pieces, position, owner, extra.position)
            position = np.concatenate([position, extra.position])
            triangle = np.concatenate([triangle, extra.triangle])
            u, v = np.concatenate([u, extra.u]), np.concatenate([v, extra.v])
    moments = merge_moments(owner, len(position), pieces.area, pieces.position, pieces.covariance)
    return SurfaceSamples(position, triangle, u, v, *moments)


def _nearer(pieces: Pieces, position: np.ndarray, owner: np.ndarray, extra: np.ndarray) -> np.ndarray:
    """The owners (C,) int32 when pieces that lie nearer to an added sample than to their own go over to it."""
    distance2 = np.empty(len(owner))
    other = np.empty(len(owner), np.int32)
    nearest_each(build_tree(extra), pieces.position, other, distance2)
    own = pieces.position.astype(np.float64) - position[owner]
    closer = distance2 < np.einsum("ck,ck->c", own, own)
    return np.where(closer, other + np.int32(len(position)), owner).astype(np.int32)
