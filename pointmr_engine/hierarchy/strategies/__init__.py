"""Sampling strategies: which candidates of a surface stand for all of it.

From the talk's comparison for static sampling, by how many samples each takes to cover a surface, N pi d^2 / A:
random points (grows with ln A), one point anywhere in each cell of a grid (up to 28.3), the centre of each occupied
cell (7.1), greedy removal of covered neighbours (2.2 for a random order; 1.21 is the optimum in the plane).
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.hierarchy.pieces import positive
from pointmr_engine.hierarchy.strategies import jittered_grid, neighbourhood, quantised_grid, random_points
from pointmr_engine.hierarchy.strategies.selection import Selection
from pointmr_engine.scene.errors import SceneError

STRATEGIES = ("random", "jittered_grid", "quantised_grid", "neighbourhood")


def select(
    strategy: str, position: np.ndarray, area: np.ndarray, spacing: float, seed: int, failure: float = 1e-3
) -> Selection:
    """Choose samples so that every candidate lies within `spacing` of one (`random`: unless it fails).

    position (C, 3) and area (C,) float32 of the candidates, spacing in their unit; failure: the probability with which
    `random` may leave a patch of area spacing^2 empty. The same seed gives the same samples. Raises SceneError for an
    unknown strategy and for values that no strategy can work with.
    """
    if strategy not in STRATEGIES:
        raise SceneError(f"unknown sampling strategy '{strategy}': one of {', '.join(STRATEGIES)}")
    spacing = positive(spacing, "spacing")
    position = np.ascontiguousarray(position, np.float32).reshape(-1, 3)
    area = np.ascontiguousarray(area, np.float32)
    if len(area) != len(position):
        raise SceneError(f"{len(position)} candidates, but {len(area)} areas")
    if not (np.isfinite(position).all() and np.isfinite(area).all() and (area >= 0).all()):
        raise SceneError("candidates for sampling must be finite, with areas that are not negative")
    if strategy == "random":
        return random_points.select(position, area, spacing, seed, positive(failure, "failure"))
    if strategy == "jittered_grid":
        return jittered_grid.select(position, area, spacing, seed)
    if strategy == "quantised_grid":
        return quantised_grid.select(position, area, spacing, seed)
    return neighbourhood.select(position, area, spacing, seed)
