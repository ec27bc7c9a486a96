"""The world around the scene: a background that also lights it."""

from __future__ import annotations

from dataclasses import dataclass, field

from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import VISIBLE


@dataclass(eq=False)
class World:
    """Background radiance as a node graph over directions. An empty graph is black.

    sampling "AUTOMATIC", "NONE" or "MANUAL" with map_resolution (the importance map's width in pixels).
    """

    graph: Graph = field(default_factory=Graph)
    sampling: str = "AUTOMATIC"
    map_resolution: int = 1024
    visibility: int = VISIBLE
    name: str = "World"


def uniform_world(color=(0.05, 0.05, 0.05), strength: float = 1.0) -> World:
    """A world of one radiance, color * strength in W/(m^2 sr)."""
    graph = Graph(
        {"background": Node("background", {"color": color, "strength": strength})},
        surface=Link("background", "background"),
    )
    return World(graph)
