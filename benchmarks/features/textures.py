"""Coordinates, and the colour and math nodes between textures and a shader."""

from __future__ import annotations

import bpy
import numpy as np

from benchmarks.features.registry import feature
from benchmarks.features.stage import diffuse, image, monkey, node, panels, plane, row, sphere, studio, tiles


@feature()
def texture_coordinates():
    """Generated, object, normal and UV coordinates shown as colours, on a turned and scaled object."""
    studio(fill=0.3)
    for i, output in enumerate(("Generated", "Object", "Normal", "UV")):

        def color(tree, output=output):
            at = node(tree, "ShaderNodeTexCoord").outputs[output]
            inputs = {0: at, 1: (0.4, 0.4, 0.4), 2: (0.5, 0.5, 0.5)}
            return node(tree, "ShaderNodeVectorMath", inputs, operation="MULTIPLY_ADD").outputs[0]

        item = sphere(diffuse(output, color), (-1.95 + 1.3 * i, 0, 0.7), 0.62)
        item.rotation_euler, item.scale = (0.4, 0.3, 0.6), (1, 0.8, 1.1)


@feature()
def texture_view_coordinates():
    """Camera, window and reflection coordinates, geometry position and incoming direction."""
    studio(fill=0.3)

    def color(kind):
        def build(tree):
            if kind in ("Position", "Incoming"):
                at = node(tree, "ShaderNodeNewGeometry").outputs[kind]
            else:
                at = node(tree, "ShaderNodeTexCoord").outputs[kind]
            scaled = {0: at, 1: (0.3, 0.3, 0.3), 2: (0.5, 0.5, 0.5)}
            return node(tree, "ShaderNodeVectorMath", scaled, operation="MULTIPLY_ADD").outputs[0]

        return diffuse(kind, build)

    row(color, ("Window", "Reflection", "Position", "Incoming"))


@feature()
def texture_color_nodes():
    """Hue/saturation, invert, gamma, bright/contrast and RGB curves on an image."""
    studio(fill=0.3)
    card = image("Card", tiles())

    def color(kind):
        def build(tree):
            value = node(tree, "ShaderNodeTexImage", image=card).outputs[0]
            if kind == "hue":
                inputs = {"Hue": 0.7, "Saturation": 1.4, "Value": 0.9, "Fac": 0.8, "Color": value}
                return node(tree, "ShaderNodeHueSaturation", inputs).outputs[0]
            if kind == "invert":
                return node(tree, "ShaderNodeInvert", {"Fac": 0.75, "Color": value}).outputs[0]
            if kind == "contrast":
                bright = node(
                    tree, "ShaderNodeBrightContrast", {"Color": value, "Bright": 0.05, "Contrast": 0.4}
                )
                return node(tree, "ShaderNodeGamma", {"Color": bright.outputs[0], "Gamma": 1.4}).outputs[0]
            curve = node(tree, "ShaderNodeRGBCurve", {"Color": value})
            curve.mapping.curves[3].points.new(0.3, 0.6)
            curve.mapping.curves[0].points.new(0.5, 0.35)
            curve.mapping.update()
            return curve.outputs[0]

        return diffuse(kind, build)

    panels([color(kind) for kind in ("hue", "invert", "contrast", "curves")])


@feature()
def texture_mix_modes():
    """The mix node's blend modes, one strip each."""
    studio(fill=0.3)
    card = image("Card", tiles())
    modes = (
        "MIX", "MULTIPLY", "ADD", "SUBTRACT", "SCREEN", "OVERLAY", "DARKEN", "LIGHTEN", "DIFFERENCE", "DODGE", "BURN",
        "SOFT_LIGHT", "LINEAR_LIGHT", "DIVIDE", "HUE", "SATURATION", "VALUE", "COLOR",
    )  # fmt: skip
    for i, mode in enumerate(modes):

        def color(tree, mode=mode):
            value = node(tree, "ShaderNodeTexImage", image=card).outputs[0]
            mix = node(tree, "ShaderNodeMix", data_type="RGBA", blend_type=mode)
            mix.inputs[0].default_value = 0.7
            tree.links.new(value, mix.inputs[6])
            mix.inputs[7].default_value = (0.7, 0.45, 0.2, 1)
            return mix.outputs[2]

        plane(diffuse(mode, color), (-2.15 + 0.86 * (i % 6), 0, 0.4 + 0.83 * (i // 6)), 0.78, (1.35, 0, 0))


@feature()
def texture_math():
    """Math, map range, separate and combine, vector math: patterns from arithmetic on coordinates."""
    studio(fill=0.3)

    def stripes(tree):
        at = node(tree, "ShaderNodeTexCoord").outputs["Object"]
        part = node(tree, "ShaderNodeSeparateXYZ", {0: at})
        scaled = node(tree, "ShaderNodeMath", {0: part.outputs[2], 1: 9.0}, operation="MULTIPLY").outputs[0]
        wave = node(tree, "ShaderNodeMath", {0: scaled}, operation="SINE").outputs[0]
        level = node(tree, "ShaderNodeMapRange", {"Value": wave, 1: -1.0, 2: 1.0, 3: 0.1, 4: 0.8})
        red = node(tree, "ShaderNodeMath", {0: part.outputs[0]}, operation="ABSOLUTE").outputs[0]
        inputs = {0: red, 1: level.outputs[0], 2: 0.3}
        return node(tree, "ShaderNodeCombineColor", inputs).outputs[0]

    def rings(tree):
        at = node(tree, "ShaderNodeTexCoord").outputs["Object"]
        length = node(tree, "ShaderNodeVectorMath", {0: at, 1: (0, 0, 1)}, operation="DISTANCE").outputs[
            "Value"
        ]
        ring = node(tree, "ShaderNodeMath", {0: length, 1: 0.25}, operation="PINGPONG").outputs[0]
        step = node(tree, "ShaderNodeMath", {0: ring, 1: 0.12}, operation="GREATER_THAN").outputs[0]
        mix = node(tree, "ShaderNodeMix", data_type="RGBA")
        tree.links.new(step, mix.inputs[0])
        mix.inputs[6].default_value, mix.inputs[7].default_value = (0.6, 0.1, 0.05, 1), (0.8, 0.75, 0.6, 1)
        return mix.outputs[2]

    sphere(diffuse("Stripes", stripes), (-1.2, 0, 1.0), 1.0)
    monkey(diffuse("Rings", rings), (1.3, 0, 1.0), 1.2)


@feature()
def texture_attribute():
    """Vertex colours by name, and a float attribute per face."""
    studio(fill=0.3)
    item = sphere(None, (-1.2, 0, 1.0), 1.0)
    mesh = item.data
    colors = mesh.color_attributes.new("Paint", "FLOAT_COLOR", "POINT")
    at = np.array([v.co[:] for v in mesh.vertices])
    values = np.clip(np.column_stack([at * 0.4 + 0.5, np.ones(len(at))]), 0, 1)
    colors.data.foreach_set("color", values.astype(np.float32).ravel())
    mesh.materials.append(
        diffuse("Paint", lambda t: node(t, "ShaderNodeAttribute", attribute_name="Paint").outputs["Color"])
    )
    other = monkey(None, (1.3, 0, 1.0), 1.2, levels=0)
    face = other.data.attributes.new("shade", "FLOAT", "FACE")
    shades = np.random.default_rng(1).uniform(0.05, 0.9, len(other.data.polygons)).astype(np.float32)
    face.data.foreach_set("value", shades)
    other.data.materials.append(
        diffuse("Shade", lambda t: node(t, "ShaderNodeAttribute", attribute_name="shade").outputs["Fac"])
    )


@feature()
def texture_object_info():
    """Object Info: colour, index and random, and material index, on objects that share one mesh."""
    studio(fill=0.3)

    def color(tree):
        info = node(tree, "ShaderNodeObjectInfo")
        part = node(
            tree, "ShaderNodeMath", {0: info.outputs["Object Index"], 1: 4.0}, operation="DIVIDE"
        ).outputs[0]
        mix = node(tree, "ShaderNodeMix", data_type="RGBA", blend_type="MIX")
        tree.links.new(part, mix.inputs[0])
        tree.links.new(info.outputs["Color"], mix.inputs[6])
        mix.inputs[7].default_value = (0.9, 0.9, 0.9, 1)
        return mix.outputs[2]

    first = sphere(diffuse("Info", color), (-1.95, 0, 0.62), 0.62)
    for i in range(4):
        item = first if i == 0 else bpy.data.objects.new("Copy", first.data)
        if i:
            bpy.context.scene.collection.objects.link(item)
            item.location = (-1.95 + 1.3 * i, 0, 0.62)
        item.pass_index = i
        item.color = (0.8, 0.15 + 0.2 * i, 0.1, 1)


@feature()
def texture_node_group():
    """A node group with inputs, used twice with different values."""
    studio(fill=0.3)
    group = bpy.data.node_groups.new("Stripes", "ShaderNodeTree")
    group.interface.new_socket("Scale", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Tint", in_out="INPUT", socket_type="NodeSocketColor")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    start, end = node(group, "NodeGroupInput"), node(group, "NodeGroupOutput")
    inputs = {"Scale": start.outputs[0], "Color1": start.outputs[1], "Color2": (0.1, 0.1, 0.1)}
    group.links.new(node(group, "ShaderNodeTexChecker", inputs).outputs[0], end.inputs[0])

    def color(settings):
        scale, tint = settings

        def build(tree):
            user = node(tree, "ShaderNodeGroup", node_tree=group)
            user.inputs["Scale"].default_value, user.inputs["Tint"].default_value = scale, (*tint, 1)
            return user.outputs[0]

        return diffuse("Group", build)

    row(color, ((4.3, (0.8, 0.2, 0.1)), (9.7, (0.1, 0.4, 0.8))))
