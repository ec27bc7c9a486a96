"""Trees of shaders, and groups."""

from __future__ import annotations

import bpy
from node_planes import Tree

from node_cases.registry import LOOSE, case


@case("mix and add shaders")
def _shaders(t: Tree):
    red = t.node("Emission", {0: (1, 0.2, 0.1, 1), 1: 0.7}).outputs[0]
    blue = t.node("Emission", {0: t.color(), 1: 0.4}).outputs[0]
    mixed = t.node("MixShader", {0: t.ramp(), 1: red, 2: blue}).outputs[0]
    camera = t.node("LightPath").outputs["Is Camera Ray"]
    added = t.node("AddShader", {0: mixed, 1: blue}).outputs[0]
    return t.node("MixShader", {0: camera, 1: red, 2: added}).outputs[0]


@case("principled emission")
def _principled(t: Tree):
    inputs = {"Base Color": (0, 0, 0, 1), "IOR": 1.0, "Emission Color": t.color(), "Emission Strength": 0.6}
    return t.node("BsdfPrincipled", inputs).outputs[0]


@case("group, reroute and mute")
def _group(t: Tree):
    group = bpy.data.node_groups.new("tinting", "ShaderNodeTree")
    group.interface.new_socket("Amount", in_out="INPUT", socket_type="NodeSocketFloat").default_value = 0.25
    group.interface.new_socket("Tint", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Result", in_out="OUTPUT", socket_type="NodeSocketColor")
    inside, out = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    tree = Tree(group)
    node = tree.node("Mix", {"B_Color": (0.9, 0.6, 0.1, 1)}, data_type="RGBA")
    reroute = group.nodes.new("NodeReroute")
    group.links.new(inside.outputs[0], reroute.inputs[0])
    group.links.new(reroute.outputs[0], node.inputs[0])
    a = next(s for s in node.inputs if s.identifier == "A_Color")
    # a colour goes through a float socket of a group
    group.links.new(inside.outputs[1], a)
    muted = tree.node("Gamma", {0: next(s for s in node.outputs if s.identifier == "Result_Color"), 1: 4.0})
    muted.mute = True
    group.links.new(muted.outputs[0], out.inputs[0])
    user = t.tree.nodes.new("ShaderNodeGroup")
    user.node_tree = group
    t.tree.links.new(t.color(), user.inputs[1])
    return user.outputs[0]


@case("group with an unlinked vector", LOOSE)
def _group_vector(t: Tree):
    group = bpy.data.node_groups.new("spotted", "ShaderNodeTree")
    group.interface.new_socket("Vector", in_out="INPUT", socket_type="NodeSocketVector")
    group.interface.new_socket("Result", in_out="OUTPUT", socket_type="NodeSocketFloat")
    inside, out = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    noise = Tree(group).node("TexNoise", {0: inside.outputs[0], "Scale": 3.0})
    group.links.new(noise.outputs[0], out.inputs[0])
    user = t.tree.nodes.new("ShaderNodeGroup")
    user.node_tree = group
    return user.outputs[0]
