"""Lamps of fragments, those whose nodes decide about their light among them: these are shaded one at a time."""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.shading.lobe_light import shade_lamps
from pointmr_engine.raytracing.lamp_nodes import lamp_nodes
from pointmr_engine.raytracing.lamps import Lamps
from pointmr_engine.scene.light import Light


class SplitLamps:
    """L lamps, those that vary behind the others. Threads may share it.

    even: the others. nodes: of those that vary, by their index. alone: each lamp by itself.
    """

    def __init__(self, lights: list[Light], lamps: Lamps) -> None:
        self.nodes = lamp_nodes(lights, lamps)
        count = len(lamps.shape)
        self.alone = [rows_of(lamps, k, k + 1) for k in range(count)]
        self.even = rows_of(lamps, 0, count - len(self.nodes))

    def shade(
        self, lobes, incoming, position, flat, alpha, gaps, share, beneath, first: int, n: int, out
    ) -> None:
        """`lobe_light.shade_lamps` of all the lamps."""
        view = lobes, incoming, position, flat, alpha, gaps
        even = len(self.even.shape)
        if even:
            shade_lamps(*view, self.even, share[:even], beneath[:even], np.int64(first), np.int64(n), out)
        for k, nodes in self.nodes.items():
            own = np.zeros((n, 3), np.float32)
            arrives = share[k : k + 1], beneath[k : k + 1]
            shade_lamps(*view, self.alone[k], *arrives, np.int64(first), np.int64(n), own)
            rows = np.flatnonzero(own.any(1))
            if len(rows):
                out[rows] += own[rows] * nodes.mean(position[rows], lobes.normal[rows])


def rows_of(lamps: Lamps, first: int, end: int) -> Lamps:
    """Lamps first..end."""
    return Lamps(*(column[first:end] for column in lamps))
