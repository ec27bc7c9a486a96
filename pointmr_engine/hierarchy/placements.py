"""All placements of chosen parts: the instance paths that lead to them, for lights and for tests."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.geometry import Geometry


class Placements(NamedTuple):
    """N placements of parts in the world. Equal to what a ray's Hits would say there."""

    part: np.ndarray  # (N,) int32
    world_from_part: np.ndarray  # (N, 3, 4) float64
    path: np.ndarray  # (N,) uint64
    visibility: np.ndarray  # (N,) uint8, bits of scene.group combined along the path
    object_index: np.ndarray  # (N,) int32
    seed: np.ndarray  # (N,) uint32
    instance: np.ndarray  # (N,) int32 innermost record, -1: none
    color: np.ndarray  # (N, 4) float32


def placements(geometry: Geometry, wanted: np.ndarray, limit: int = 1_000_000) -> Placements:
    """Placements of the parts with wanted[part] (bool), in the order of a depth-first walk from the root.

    Branches without a wanted part are not entered. Stops after `limit`: compare len(result.part) with it.
    """
    raise NotImplementedError
