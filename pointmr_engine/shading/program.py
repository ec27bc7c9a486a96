"""Node graphs compiled to short numpy programs over batches of surface points.

`compile_graph` removes what nothing reads, folds constants, flattens mix and add shaders into leaves with weights, and
says what the program needs of a point. `Program.evaluate` then runs every remaining node once per batch.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.scene.graph import Graph
from pointmr_engine.shading.leaves import Leaf
from pointmr_engine.shading.points import SurfacePoints


class Program:
    """A compiled graph. It holds no state between calls: threads may share it.

    needs: what `evaluate` reads of SurfacePoints: field names, "uv:NAME" ("uv:" is the active layer),
        "uv_footprint:NAME", "tangent:NAME", "attribute:NAME", "instance_attribute:NAME".
    transparency_needs, emission_needs: the same for `transparency` and `emission`.
    varying_with: subset of {"surface", "view", "ray", "instance"}; surface_only: nothing beyond "surface".
    leaves: tuple of LeafPlan (kind and what each column varies with).
    opaque: light never passes straight through; emissive: it can emit; constant_emission: rgb, (0, 0, 0) if it never
        emits, None where emission varies.
    max_lobes: upper bound of BSDF lobes at a point. warnings: unsupported nodes, each named once.
    """

    needs: frozenset[str]
    transparency_needs: frozenset[str]
    emission_needs: frozenset[str]
    varying_with: frozenset[str]
    surface_only: bool
    leaves: tuple
    opaque: bool
    emissive: bool
    constant_emission: tuple[float, float, float] | None
    max_lobes: int
    warnings: list[str]

    def evaluate(self, points: SurfacePoints) -> list[Leaf]:
        """Leaves of the N points; a leaf's block has N rows, or 1 where nothing in it varies."""
        raise NotImplementedError

    def transparency(self, points: SurfacePoints) -> np.ndarray:
        """(N, 3) float32 share of light that passes straight through, for shadow rays."""
        raise NotImplementedError

    def emission(self, points: SurfacePoints) -> np.ndarray:
        """(N, 3) float32 emitted radiance (background radiance for a world)."""
        raise NotImplementedError


def compile_graph(graph: Graph, kind: str = "surface") -> Program:
    """Compile a material ("surface"), world ("background") or lamp ("light") graph. Never raises for odd nodes."""
    raise NotImplementedError


def evaluate_background(program: Program, directions: np.ndarray, ray_kind: int = 1) -> np.ndarray:
    """Radiance (N, 3) float32 of a world program seen in unit world directions (N, 3), pointing away from the viewer.

    ray_kind: bits RAY_* of shading.points, what the Light Path node sees (a camera ray by default).
    """
    raise NotImplementedError
