"""A scene with parts of its light switched off, so that errors of one kind are seen alone."""

from __future__ import annotations

import colorsys
from dataclasses import replace

from benchmarks.sources import Source, text_hash

ABOUT = {
    "coverage": "every material shines in one colour: what is seen, and how much of it",
    "silhouettes": "every material is black: how much of what shines behind is hidden",
    "shading": "lamps without shadows under a black world: what surfaces reflect",
    "shadows": "lamps with their shadows under a black world: what of it arrives",
    "all": "the scene as it is: the world's light and its occlusion, too",
}


def variant(source: Source, kind: str) -> Source:
    """The source of the scene `kind`, of ABOUT, of another source. Raises KeyError for an unknown kind."""
    changes = {"coverage": shine, "silhouettes": blacken, "shading": unshadow, "shadows": darken, "all": None}
    change = changes[kind]
    if change is None:
        return source

    def load() -> None:
        source.load()
        change()

    return replace(source, name=f"{source.name}:{kind}", load=load, content=text_hash(source.content, kind))


def on_surfaces(source: Source) -> Source:
    """The scene without light that goes below surfaces: the engine has it as diffuse reflection, Cycles follows it."""

    def load() -> None:
        import bpy

        source.load()
        for material in bpy.data.materials:
            for node in material.node_tree.nodes if material.node_tree else ():
                if node.bl_idname == "ShaderNodeBsdfPrincipled":
                    node.inputs["Subsurface Weight"].default_value = 0.0

    return replace(source, load=load, content=text_hash(source.content, "on surfaces"))


def blacken() -> None:
    """Every material is black; lamps are gone."""
    shine(0.0)


def shine(value: float = 0.6) -> None:
    """Every material emits a colour of its own, as bright as `value`, and lights nothing; lamps are gone."""
    import bpy

    for item in [o for o in bpy.context.scene.objects if o.type == "LIGHT"]:
        bpy.data.objects.remove(item)
    for k, material in enumerate(sorted(bpy.data.materials, key=lambda m: m.name)):
        if not material.use_nodes or material.node_tree is None:
            continue
        tree = material.node_tree
        tree.nodes.clear()
        emission = tree.nodes.new("ShaderNodeEmission")
        emission.inputs["Color"].default_value = (*colorsys.hsv_to_rgb(0.381966 * k % 1.0, 0.7, value), 1.0)
        output = tree.nodes.new("ShaderNodeOutputMaterial")
        tree.links.new(emission.outputs[0], output.inputs["Surface"])
        material.cycles.emission_sampling = "NONE"


def darken() -> None:
    """The world becomes black."""
    import bpy

    for world in bpy.data.worlds:
        world.use_nodes = True
        world.node_tree.nodes.clear()
        background = world.node_tree.nodes.new("ShaderNodeBackground")
        background.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
        output = world.node_tree.nodes.new("ShaderNodeOutputWorld")
        world.node_tree.links.new(background.outputs[0], output.inputs["Surface"])


def unshadow() -> None:
    """The world becomes black, and lamps cast no shadows."""
    import bpy

    darken()
    for light in bpy.data.lights:
        light.use_shadow = False
