"""Blender's world to the engine's."""

from __future__ import annotations

from pointmr_engine.scene.group import CAMERA, DIFFUSE, GLOSSY, TRANSMISSION, VISIBLE, VOLUME_SCATTER
from pointmr_engine.scene.world import World, uniform_world

from .materials import has_nodes

RAYS = (
    ("camera", CAMERA),
    ("diffuse", DIFFUSE),
    ("glossy", GLOSSY),
    ("transmission", TRANSMISSION),
    ("scatter", VOLUME_SCATTER),
)
SAMPLING = {"AUTOMATIC", "NONE", "MANUAL"}


def world(scene, view_layer, material_sync, watch) -> World:
    """The scene's world (or the view layer's override); black where there is none, or the layer has none."""
    source = getattr(view_layer, "world_override", None) or scene.world
    if source is None or not view_layer.use_sky:
        return World()
    if has_nodes(source):
        result = World(material_sync.world_graph(source))
        if any(
            n.bl_idname == "ShaderNodeOutputWorld" and n.inputs["Volume"].is_linked
            for n in source.node_tree.nodes
        ):
            watch.warn(f"world '{source.name}': its volume is not supported; left out")
    else:
        result = uniform_world(tuple(source.color))
    result.name = source.name
    seen = getattr(source, "cycles_visibility", None)
    if seen is not None:
        for name, bit in RAYS:
            if not getattr(seen, name, True):
                result.visibility &= ~bit & VISIBLE
    own = getattr(source, "cycles", None)
    if own is not None:
        result.sampling = own.sampling_method if own.sampling_method in SAMPLING else "AUTOMATIC"
        result.map_resolution = int(own.sample_map_resolution)
    return result
