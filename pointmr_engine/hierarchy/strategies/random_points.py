"""Random points: so many that a patch of the surface stays empty only with a given probability (talk, dynamic sampling)."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.hierarchy.nearest import build_tree, nearest_each
from pointmr_engine.hierarchy.strategies.selection import Selection, seed_key, uniforms


def count(area: float, spacing: float, failure: float) -> int:
    """How many random points hit each of a = area / spacing^2 patches but with probability `failure`: a (ln a + ln 1/f).

    From P(some patch is empty) <= a (1 - 1/a)^k <= a exp(-k/a). At least one.
    """
    a = area / spacing**2
    return max(1, math.ceil(a * (math.log(max(a, 1.0)) + math.log(1.0 / min(failure, 1.0)))))


def draw(area: np.ndarray, number: int, seed: int) -> np.ndarray:
    """Indices (number,) int64, in rising order, drawn with replacement and with probability proportional to area (C,)."""
    total = np.cumsum(area, dtype=np.float64)
    u = np.empty(number)
    uniforms(seed_key(seed, 1), u)
    u.sort()
    return np.minimum(np.searchsorted(total, u * total[-1], side="right"), len(area) - 1)


def select(position: np.ndarray, area: np.ndarray, spacing: float, seed: int, failure: float) -> Selection:
    """Draw `count` candidates with probability proportional to area; what is drawn twice is kept once.

    A candidate is missed with probability at most exp(-b (ln a + ln 1/f)), spacing^2 b being the surface within `spacing` of
    it: below f where b >= 1 (inside a surface b is about pi; at the tip of a lone spike it may be anything).
    """
    if len(position) == 0 or not area.any():
        return Selection(
            np.empty((0, 3), np.float32), np.empty(0, np.int32), np.full(len(area), -1, np.int32)
        )
    chosen = np.unique(draw(area, count(float(area.sum(dtype=np.float64)), spacing, failure), seed))
    samples = position[chosen]
    owner = np.empty(len(position), np.int32)
    nearest_each(build_tree(samples), position, owner, np.empty(len(position)))
    return Selection(samples, chosen.astype(np.int32), owner)
