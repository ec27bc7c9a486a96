"""Displacement graphs, compiled for vertices: where a material moves the points of its meshes."""

from __future__ import annotations

import numpy as np

from pointmr_engine.scene.graph import Graph
from pointmr_engine.shading.compiler import Builder
from pointmr_engine.shading.nodes.registry import VECTOR
from pointmr_engine.shading.points import SurfacePoints
from pointmr_engine.shading.program import Plan, read


class Displacement:
    """The displacement of a material's graph, which must have one.

    needs: what `offset` reads of SurfacePoints (as Program.needs). warnings: unsupported nodes, each named once.
    """

    def __init__(self, graph: Graph) -> None:
        builder = Builder(graph, "surface", False)
        self._source = builder.value(graph.displacement, VECTOR, (0.0, 0.0, 0.0))
        self._plan = Plan(builder.steps, [self._source])
        self.needs: frozenset[str] = self._plan.needs
        self.warnings: list[str] = builder.warnings

    def offset(self, points: SurfacePoints) -> np.ndarray:
        """(N, 3) float32: how far the points move, in the space of their normals."""
        with np.errstate(all="ignore"):
            memo = self._plan.run(points)
        return np.broadcast_to(read(self._source, memo), (points.count, 3))
