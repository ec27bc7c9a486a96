"""Bump: the shading normal tilted by a height's differences."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading.differentials import axes_at
from pointmr_engine.shading.nodes.registry import FLOAT, VECTOR, Call, From, node
from pointmr_engine.shading.values import cross, dot, normalize


@node(
    "bump",
    {
        "strength": (FLOAT, 1.0),
        "distance": (FLOAT, 1.0),
        "filter_width": (FLOAT, 0.1),
        "height": (FLOAT, 1.0),
        "normal": (VECTOR, From("normal")),
    },
    {"normal": VECTOR},
    reads=lambda params, wanted: ("moved", "footprint", "geometric_normal"),
    differenced=("height",),
    passes=lambda params, known: "normal" if "height" in known else None,
)
def _bump(c: Call) -> np.ndarray:
    """params: invert; raised, as of scene.graph.Graph.

    The height's gradient is taken over filter_width times the width of a pixel and beneath one normal, as in Cycles:
    how the surface itself bends makes no bumps.
    """
    normal = c["normal"]
    # one width for the batch: it is a constant of the node in practice, and the moved points are shared by it
    width = float(max(np.max(c["filter_width"]), 1e-4)) * c.points.footprints
    size = c.points.footprint[:, None]
    dx, dy = (axis * size for axis in axes_at(c.points))
    center = c["height"]
    slope_x = (c.moved("height", 0, width, one_normal=True) - center)[:, None]
    slope_y = (c.moved("height", 1, width, one_normal=True) - center)[:, None]
    rx, ry = cross(dy, normal), cross(normal, dx)
    determinant = dot(dx, rx)[:, None]
    scale = c.vector("distance") * (-1 if c.params.get("invert") else 1)
    gradient = np.where(determinant < 0, -1, 1) * (slope_x * rx + slope_y * ry)
    bent = normalize(width * np.abs(determinant) * normal - scale * gradient)
    strength = np.maximum(c.vector("strength"), 0)
    blended = normalize(strength * bent + (1 - strength) * normal)
    return np.where((bent == 0).all(1)[:, None] | ~np.isfinite(blended).all(1)[:, None], normal, blended)
