"""Blender's materials to engine materials, each once."""

from __future__ import annotations

from pointmr_engine.scene.graph import Graph
from pointmr_engine.scene.material import Material


class MaterialSync:
    """Translates materials and keeps them, so that equal slots share one engine Material.

    report(level, message): level "INFO", "WARNING" or "ERROR".
    """

    def __init__(self, report) -> None:
        raise NotImplementedError

    def get(self, material) -> Material:
        """The engine's material for a bpy Material, or for None the default grey one."""
        raise NotImplementedError

    def light_graph(self, light) -> Graph | None:
        """The node graph of a bpy Light, or None where it has no nodes that change its emission."""
        raise NotImplementedError

    def world_graph(self, world) -> Graph:
        """The background graph of a bpy World; empty (black) for None."""
        raise NotImplementedError
