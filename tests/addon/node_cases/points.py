"""Nodes that read what a point knows: coordinates, attributes, geometry, bumps, profiles of lamps."""

from __future__ import annotations

import bpy
from node_planes import Tree

from node_cases.registry import CASES, case, offset

for _output in ("Generated", "Normal", "UV", "Object", "Camera", "Window", "Reflection"):
    CASES[f"coordinates {_output}"] = (
        lambda t, output=_output: offset(t, t.node("TexCoord").outputs[output], 0.05),
        1e-4,
    )


@case("coordinates of an object", 1e-4)
def _object(t: Tree):
    empty = bpy.data.objects.new("empty", None)
    empty.location, empty.rotation_euler, empty.scale = (1, 2, 3), (0.2, 0.5, 0.9), (1.5, 1, 0.7)
    bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    return offset(t, t.node("TexCoord", object=empty).outputs["Object"], 0.05)


GEOMETRY = ("Position", "Normal", "Tangent", "True Normal", "Incoming", "Parametric", "Backfacing")
for _output in (*GEOMETRY, "Pointiness", "Random Per Island"):
    CASES[f"geometry {_output}"] = (
        lambda t, output=_output: offset(t, t.node("NewGeometry").outputs[output], 0.05),
        1e-4,
    )
for _output in ("Location", "Color", "Alpha", "Object Index", "Material Index"):
    CASES[f"object info {_output}"] = (
        lambda t, output=_output: offset(t, t.node("ObjectInfo").outputs[output], 0.05),
        1e-4,
    )
for _output in ("View Vector", "View Z Depth", "View Distance"):
    CASES[f"camera {_output}"] = (
        lambda t, output=_output: offset(t, t.node("CameraData").outputs[output], 0.05),
        1e-4,
    )
for _output in (
    "Is Camera Ray",
    "Is Shadow Ray",
    "Is Diffuse Ray",
    "Ray Length",
    "Ray Depth",
    "Transparent Depth",
):
    CASES[f"light path {_output}"] = (
        lambda t, output=_output: offset(t, t.node("LightPath").outputs[output], 0.05),
        1e-4,
    )
for _name, _kind, _output in (
    ("Col", "GEOMETRY", "Color"),
    ("Col", "GEOMETRY", "Fac"),
    ("Col", "GEOMETRY", "Alpha"),
    ("height", "GEOMETRY", "Fac"),
    ("tint", "OBJECT", "Fac"),
):

    def _attribute(t: Tree, name=_name, kind=_kind, output=_output):
        node = t.node("Attribute", attribute_name=name, attribute_type=kind)
        return next(s for s in node.outputs if s.identifier == output)

    CASES[f"attribute {_name} {_output}"] = (_attribute, 1e-4)


@case("color attribute", 1e-4)
def _color_attribute(t: Tree):
    node = t.node("VertexColor", layer_name="Col")
    return t.node(
        "Mix", {"Factor_Float": node.outputs[1], "A_Color": node.outputs[0]}, data_type="RGBA"
    ).outputs[2]


def _tilted(t: Tree):
    """Unit normals that vary over the plane and lean to the viewer."""
    v = t.node("CombineXYZ", {0: t.ramp(0), 1: t.ramp(1), 2: 0.6}).outputs[0]
    return t.node("VectorMath", {0: v}, operation="NORMALIZE").outputs[0]


@case("fresnel", 1e-4)
def _fresnel(t: Tree):
    return t.node("Fresnel", {0: 1.7, 1: _tilted(t)}).outputs[0]


for _blend in (0.3, 0.5, 0.8):
    for _output in (0, 1):
        CASES[f"layer weight {_blend} {_output}"] = (
            lambda t, blend=_blend, output=_output: t.node("LayerWeight", {0: blend, 1: _tilted(t)}).outputs[
                output
            ],
            1e-4,
        )


@case("normal dot")
def _normal_dot(t: Tree):
    node = t.node("Normal", {0: _tilted(t)})
    node.outputs[0].default_value = (0.3, 0.4, 0.866)
    return node.outputs[1]


for _space in ("TANGENT", "OBJECT", "WORLD", "BLENDER_OBJECT", "BLENDER_WORLD"):

    def _normal_map(t: Tree, space=_space):
        color = t.node("CombineColor", {0: t.ramp(0), 1: t.ramp(1), 2: 0.9}).outputs[0]
        node = t.node("NormalMap", {0: 0.7, 1: color}, space=space)
        if space == "TANGENT":
            node.uv_map = "UVMap"
        return offset(t, node.outputs[0], 0.4)

    CASES[f"normal map {_space}"] = (_normal_map, 2e-3)
for _axis in "XYZ":
    CASES[f"tangent radial {_axis}"] = (
        lambda t, axis=_axis: offset(
            t, t.node("Tangent", direction_type="RADIAL", axis=axis).outputs[0], 0.4
        ),
        1e-3,
    )


@case("tangent uv", 1e-3)
def _tangent_uv(t: Tree):
    return offset(t, t.node("Tangent", direction_type="UV_MAP", uv_map="UVMap").outputs[0], 0.4)


@case("bump of a ramp", 1e-3)
def _bump(t: Tree):
    square = t.node("Math", {0: t.ramp(), 1: t.ramp(1)}, operation="MULTIPLY").outputs[0]
    return offset(t, t.node("Bump", {"Height": square, "Distance": 0.5, "Strength": 0.8}).outputs[0], 0.4)


@case("bump of noise", 2e-2)
def _bump_noise(t: Tree):
    vector = t.node("TexCoord").outputs["Object"]
    noise = t.node("TexNoise", {0: vector, "Scale": 3.0}).outputs[0]
    return offset(t, t.node("Bump", {"Height": noise, "Distance": 0.3}, invert=True).outputs[0], 0.4)


@case("bump on bump", 2e-2)
def _bump_on_bump(t: Tree):
    vector = t.node("TexCoord").outputs["Generated"]
    noise = t.node("TexNoise", {0: vector, "Scale": 3.0}).outputs[0]
    first = t.node("Bump", {"Height": noise, "Distance": 0.3}).outputs[0]
    return offset(t, t.node("Bump", {"Height": t.ramp(1), "Distance": 0.5, "Normal": first}).outputs[0], 0.4)


PHOTOMETRY = """IESNA:LM-63-2002
TILT=NONE
1 1000 1 5 1 1 2 0 0 0
1 1 10
0 30 60 75 90
0
1000 800 500 200 0
"""


@case("ies profile")
def _ies(t: Tree):
    node = t.node("TexIES", {1: 0.01}, mode="INTERNAL")
    node.ies = bpy.data.texts.new("profile")
    node.ies.from_string(PHOTOMETRY)
    uv = t.node("UVMap").outputs["UV"]
    t.tree.links.new(t.node("Mapping", {0: uv, "Location": (0.1, 0.2, -0.9)}).outputs[0], node.inputs[0])
    return node.outputs[0]
