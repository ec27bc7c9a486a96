"""Acceleration structures over a Geometry: one per unique mesh shape, one per unique group, joined by instances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pointmr_engine.hierarchy.geometry import Geometry


@dataclass(eq=False)
class Acceleration:
    """What the walk needs. `arrays` is a NamedTuple for kernels; `geometry` owns what they borrow."""

    geometry: Geometry


def build_acceleration(geometry: Geometry, progress: Callable[[float], None] | None = None) -> Acceleration:
    """Build all hierarchies, children before parents. `progress(fraction)` may raise to cancel."""
    raise NotImplementedError


def set_opaque(acceleration: Acceleration, opaque: np.ndarray) -> Acceleration:
    """The same structure (shared, not copied) with `opaque` (len(geometry.materials),) bool for `walk.shadow`."""
    raise NotImplementedError
