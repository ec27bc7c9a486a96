"""Paths that wait for others: what goes on from one batch of fragments is too little to be worth a bounce of its own.

A bounce costs as much for ten paths as for a thousand (materials are evaluated by array operations), and the paths of
a batch become few long before they are none.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.multires.cones.cones import allocate_cones
from pointmr_engine.multires.lobes.lobe_cones import LobeCones, allocate_lobe_cones
from pointmr_engine.raytracing.path_arrays import Paths, allocate_paths


def _columns(paths: Paths, cones: LobeCones | None) -> list[np.ndarray]:
    """The arrays that have a row for each path; the weights of sub-rays are not known yet."""
    columns = [*paths.rays, *paths.state._replace(camera_from_world=None), *paths[2:]]
    if cones is not None:
        columns += [*cones.cones, *cones._replace(cones=None, weights=None)]
    return [c for c in columns if c is not None]


class PathPool:
    """Up to `room` paths at the same bounce or earlier, with their lobes' cones if `cones`."""

    def __init__(self, room: int, cones: bool):
        self.count = self.bounce = 0
        own = allocate_lobe_cones(room, allocate_cones(room)) if cones else None
        self._own = _columns(allocate_paths(room), own)
        self._part = own.part if cones else np.zeros(room, np.int8)

    def empty(self) -> None:
        self.count = self.bounce = 0

    def take(self, paths: Paths, cones: LobeCones | None, n: int, bounce: int) -> None:
        """Keep the paths 0..n, whose next bounce is `bounce`. There must be room."""
        for own, other in zip(self._own, _columns(paths, cones), strict=True):
            own[self.count : self.count + n] = other[:n]
        self.count += n
        self.bounce = max(self.bounce, bounce)

    def give(self, paths: Paths, cones: LobeCones | None, most: int | None = None) -> tuple[int, int]:
        """Move all to the first rows of paths and cones, or the last `most`, or one more.

        Returns how many, and their next bounce.
        """
        first, part = 0 if most is None else max(self.count - most, 0), self._part
        if 0 < first < self.count and part[first] == 2:  # what lies around a lobe's core stays with it
            first -= 1
        given = self.count - first, self.bounce
        for own, other in zip(self._own, _columns(paths, cones), strict=True):
            other[: given[0]] = own[first : self.count]
        self.count = first
        self.bounce = self.bounce if first else 0
        return given
