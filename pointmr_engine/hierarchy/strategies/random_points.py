"""Random points: so many that patches stay empty only with a given probability (talk, dynamic sampling)."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.hierarchy.nearest import build_tree, nearest_each
from pointmr_engine.hierarchy.strategies.selection import Selection, seed_key, uniforms
from pointmr_engine.scene.errors import SceneError


def count(area: float, spacing: float, failure: float) -> int:
    """How many random points leave one of a = area / spacing^2 patches empty with probability f: a (ln a + ln 1/f).

    From P(some patch is empty) <= a (1 - 1/a)^k <= a exp(-k/a). At
    least one. Raises SceneError for more than 2^31.
    """
    a = area / spacing / spacing
    number = a * (math.log(max(a, 1.0)) + math.log(1.0 / min(failure, 1.0)))
    if not number < 2**31:
        raise SceneError(
            f"a surface of area {area:g} needs too many random points for a spacing of {spacing:g}"
        )
    return max(1, math.ceil(number))


def draw(area: np.ndarray, number: int, seed: int) -> np.ndarray:
    """Indices (number,) int64, rising, drawn with replacement, with probability proportional to area (C,)."""
    total = np.cumsum(area, dtype=np.float64)
    u = np.empty(number)
    uniforms(seed_key(seed, 1), u)
    u.sort()
    return np.minimum(np.searchsorted(total, u * total[-1], side="right"), len(area) - 1)


def select(position: np.ndarray, area: np.ndarray, spacing: float, seed: int, failure: float) -> Selection:
    """Draw `count` candidates with probability proportional to area; what is drawn twice is kept once.

    A candidate is missed with probability at most (f / a)^b, spacing^2 b being the surface within `spacing` of it:
    inside a surface b is about pi, but on the tip of a spike or a speck apart it may be anything.
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
