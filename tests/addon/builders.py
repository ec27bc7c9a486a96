"""Small Blender scenes, built in code."""

from __future__ import annotations

import bpy
import numpy as np


def empty_scene() -> bpy.types.Scene:
    """A new file with an empty scene (factory settings, no camera, no light)."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def collection(name: str, parent=None) -> bpy.types.Collection:
    c = bpy.data.collections.new(name)
    if parent is not None:
        parent.children.link(c)
    return c


def add(name: str, data=None, to=None, location=(0, 0, 0), **values) -> bpy.types.Object:
    """A new object in a collection (the scene's by default), with properties by name."""
    ob = bpy.data.objects.new(name, data)
    (to or bpy.context.scene.collection).objects.link(ob)
    ob.location = location
    for key, value in values.items():
        setattr(ob, key, value)
    return ob


def polygon(name: str, sides: int = 4) -> bpy.types.Mesh:
    """A flat polygon of sides - 2 triangles, whose number tells meshes apart."""
    angle = 2 * np.pi * np.arange(sides) / sides
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(float(np.cos(a)), float(np.sin(a)), 0.0) for a in angle], [], [tuple(range(sides))])
    return mesh


def bumpy(name: str, n: int = 3, seed: int = 0) -> bpy.types.Mesh:
    """A grid of n x n quads at random heights, so that every vertex and face points elsewhere."""
    rng = np.random.default_rng(seed)
    points = [(x, y, float(rng.uniform(-0.5, 0.5))) for y in range(n + 1) for x in range(n + 1)]
    w = n + 1
    faces = [(i, i + 1, i + 1 + w, i + w) for y in range(n) for i in range(y * w, y * w + n)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], faces)
    return mesh


def instance_of(name: str, source: bpy.types.Collection, **values) -> bpy.types.Object:
    """An empty that instances a collection."""
    return add(name, None, instance_type="COLLECTION", instance_collection=source, **values)


def node_group(name: str, build) -> bpy.types.NodeTree:
    """A geometry node group; build(tree, geometry in, geometry out) wires it."""
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    start, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    build(tree, start.outputs[0], end.inputs[0])
    return tree


def scatter(tree, points, instance, **inputs):
    """An Instance on Points node; inputs by socket name, underscores for spaces."""
    node = tree.nodes.new("GeometryNodeInstanceOnPoints")
    tree.links.new(points, node.inputs["Points"])
    tree.links.new(instance, node.inputs["Instance"])
    for key, value in inputs.items():
        socket = node.inputs[key.replace("_", " ")]
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, socket)
        else:
            socket.default_value = value
    return node.outputs[0]


def object_info(tree, ob, as_instance: bool = True):
    node = tree.nodes.new("GeometryNodeObjectInfo")
    node.inputs["Object"].default_value = ob
    node.inputs["As Instance"].default_value = as_instance
    return node.outputs["Geometry"]


def collection_info(tree, source, separate: bool = False, reset: bool = False):
    node = tree.nodes.new("GeometryNodeCollectionInfo")
    node.inputs["Collection"].default_value = source
    node.inputs["Separate Children"].default_value = separate
    node.inputs["Reset Children"].default_value = reset
    return node.outputs[0]


def join(tree, *geometries):
    node = tree.nodes.new("GeometryNodeJoinGeometry")
    for g in geometries:
        tree.links.new(g, node.inputs[0])
    return node.outputs[0]


def random_vector(tree, low, high):
    node = tree.nodes.new("FunctionNodeRandomValue")
    node.data_type = "FLOAT_VECTOR"
    node.inputs[0].default_value, node.inputs[1].default_value = low, high
    return node.outputs[0]


def nodes_on(ob, tree) -> None:
    ob.modifiers.new("Nodes", "NODES").node_group = tree
