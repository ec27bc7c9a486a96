"""Blender's shader node trees to engine graphs."""

from __future__ import annotations

from pointmr_engine.scene.graph import Graph


def translate(node_tree, report, images) -> Graph:
    """The engine's graph of a material's, world's or light's node tree.

    Groups are inlined, reroutes and muted nodes bypassed, sockets named by table. report(level, message) is told each
    unsupported node once; images is an `images.ImageSync`.
    """
    raise NotImplementedError
