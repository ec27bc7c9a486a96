"""Surfaces that their materials move."""

from __future__ import annotations

import bpy

from benchmarks.features.registry import feature
from benchmarks.features.stage import cube, diffuse, node, sphere, studio


def displace(surface: bpy.types.Material, method: str, **inputs) -> None:
    """Give a material a Displacement node with these inputs; method: "DISPLACEMENT", "BUMP" or "BOTH"."""
    tree = surface.node_tree
    height = node(tree, "ShaderNodeDisplacement", inputs)
    end = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(height.outputs[0], end.inputs["Displacement"])
    surface.displacement_method = method


def _displaced(method: str, scale: float) -> bpy.types.Material:
    """A diffuse material, displaced by a noise."""
    item = diffuse(method, lambda t: node(t, "ShaderNodeRGB").outputs[0])
    noise = node(item.node_tree, "ShaderNodeTexNoise", {"Scale": 3.0, "Detail": 1.0})
    displace(item, method, Height=noise.outputs[0], Scale=scale)
    return item


@feature()
def texture_displacement():
    """Material displacement that moves the surface: alone, with bump, and of an object that is stretched and flat."""
    studio(fill=0.3)
    for method, x, smooth in (
        ("DISPLACEMENT", -1.9, True),
        ("BOTH", 0.0, True),
        ("DISPLACEMENT", 1.9, False),
    ):
        item = _displaced(method, 0.6)
        ball = sphere(item, (x, 0, 1.0), 0.8, smooth)
        if not smooth:
            ball.scale = (0.8, 0.8, 1.3)


@feature()
def texture_displaced_bump():
    """Material displacement, bump only: a height texture shades as bump without moving the surface."""
    studio(fill=0.3)
    item = _displaced("BUMP", 0.4)
    color = next(n for n in item.node_tree.nodes if n.bl_idname == "ShaderNodeRGB")
    color.outputs[0].default_value = (0.6, 0.5, 0.4, 1)
    sphere(item, (-1.2, 0, 1.0), 1.0)
    cube(item, (1.2, 0, 0.8))
