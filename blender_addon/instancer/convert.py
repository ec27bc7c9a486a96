"""Operators that turn Blender's instancers into PointMR's, and back."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.types import Operator

from ..sync import children as child_instancing
from ..sync import instances
from ..sync.geometry import has_nodes
from ..sync.transforms import matrix

TREE_MARK = "pointmr_instances"  # custom property of node groups that `to_native` made


class ConversionError(ValueError):
    """An instancer that cannot be converted; the message says why."""


def from_native(ob, context) -> bpy.types.Object:
    """Turn a native instancer into PointMR's; returns the object that is the instancer now.

    A collection instance changes in place, and so does geometry that `to_native` gave a modifier. Instances on vertices
    and faces and of geometry nodes become a new object of points; the old one stays, without its instances (and without
    the nodes that made them), hidden if it showed nothing else.
    """
    if ob.pointmr.instance_collection is not None:
        raise ConversionError("it is a PointMR instancer already")
    for modifier in ob.modifiers:
        if modifier.type == "NODES" and modifier.node_group is not None and TREE_MARK in modifier.node_group:
            return restore_points(ob, modifier)
    if ob.instance_type == "COLLECTION" and ob.instance_collection is not None:
        ob.pointmr.instance_collection = ob.instance_collection
        ob.pointmr.instance_on = "ORIGIN"
        ob.instance_type = "NONE"
        ob.instance_collection = None
        return ob
    return bake_points(ob, context)


def to_native(ob, context) -> bpy.types.Object:
    """Turn PointMR's instancer into a native one; returns the object that is the instancer now.

    At the origin: a collection instance (of a new empty, where the object is none). On points: what `from_native` made
    becomes the native instancer that it was; other points get a geometry-nodes modifier.
    """
    settings = ob.pointmr
    collection = settings.instance_collection
    if collection is None:
        raise ConversionError("it is no PointMR instancer")
    if settings.instance_on == "ORIGIN":
        target = ob
        if ob.type != "EMPTY":
            target = bpy.data.objects.new(f"{ob.name} instance", None)
            for c in ob.users_collection:
                c.objects.link(target)
            target.parent = ob
        target.instance_type = "COLLECTION"
        target.instance_collection = collection
        settings.instance_collection = None
        return target
    if settings.native_source is not None:
        return unbake_points(ob)
    add_modifier(ob, context)
    settings.instance_collection = None
    return ob


# Native instances to points


def bake_points(ob, context) -> bpy.types.Object:
    """A new object whose points stand for the native instances of `ob`."""
    depsgraph = context.evaluated_depsgraph_get()
    evaluated = ob.evaluated_get(depsgraph)
    at, choice, sources = native_instances(evaluated, ob, depsgraph)
    if not len(at):
        raise ConversionError("it makes no instances")
    collection = bpy.data.collections.new(f"{ob.name} sources")
    for source in sources:
        members = collection.children if isinstance(source, bpy.types.Collection) else collection.objects
        members.link(source)
    # the index counts child collections, then objects, each by name
    ordered = sorted(collection.children, key=lambda c: c.name) + sorted(
        collection.objects, key=lambda o: o.name
    )
    number = np.array([ordered.index(s) for s in sources], np.int32)
    points = bpy.data.objects.new(f"{ob.name} points", point_mesh(f"{ob.name} points", at, number[choice]))
    for c in ob.users_collection:
        c.objects.link(points)
    points.matrix_world = ob.matrix_world
    settings = points.pointmr
    settings.instance_collection = collection
    settings.instance_on = "POINTS"
    settings.native_source = ob
    points["pointmr_instance_type"] = ob.instance_type
    points["pointmr_modifiers"] = [m.name for m in ob.modifiers if m.type == "NODES" and m.show_render]
    for m in ob.modifiers:
        if m.type == "NODES":
            m.show_render = m.show_viewport = False
    if ob.instance_type in {"VERTS", "FACES"}:
        for source in sources:  # in their own place they were hidden, and stay so
            for c in source.users_collection:
                if c != collection:
                    c.objects.unlink(source)
    own = evaluated.data
    points["pointmr_hid_source"] = not ob.hide_render and not (
        ob.show_instancer_for_render and len(getattr(own, "polygons", ()))
    )
    if points["pointmr_hid_source"]:  # it showed only its instances
        ob.hide_render = True
    ob.instance_type = "NONE"
    return points


def unbake_points(ob) -> bpy.types.Object:
    """The native instancer behind an object of points that `bake_points` made; the points are removed."""
    source, collection = ob.pointmr.native_source, ob.pointmr.instance_collection
    kind = ob.get("pointmr_instance_type", "NONE")
    source.instance_type = kind
    if ob.get("pointmr_hid_source"):
        source.hide_render = False
    for name in ob.get("pointmr_modifiers", ()):
        if name in source.modifiers:
            source.modifiers[name].show_render = source.modifiers[name].show_viewport = True
    if kind in {"VERTS", "FACES"}:
        for child in list(collection.objects):
            for c in source.users_collection:
                if child.name not in c.objects:
                    c.objects.link(child)
    mesh = ob.data
    bpy.data.objects.remove(ob)
    bpy.data.meshes.remove(mesh)
    if collection.users == 0:
        bpy.data.collections.remove(collection)
    return source


def native_instances(evaluated, ob, depsgraph):
    """(object_from_instance (N, 3, 4), source of each (N,), sources: original objects and collections)."""
    if evaluated.instance_type in {"VERTS", "FACES"} and not has_nodes(ob):
        children = [c for c in ob.children_recursive if c.type != "META"]
        return child_instances(evaluated, children, depsgraph)
    if not hasattr(evaluated, "evaluated_geometry"):
        raise ConversionError("this version of Blender cannot say what geometry nodes instance")
    gs = evaluated.evaluated_geometry()
    cloud = gs.instances_pointcloud()
    if cloud is None or not len(cloud.points):
        return np.empty((0, 3, 4)), np.empty(0, np.int32), []
    at = instances.read_transforms(cloud)
    choice = np.zeros(len(at), np.int32)
    cloud.attributes[".reference_index"].data.foreach_get("value", choice)
    sources: list = []
    number, moves = np.zeros(len(gs.instance_references()), np.int32), []
    for i, reference in enumerate(gs.instance_references()):
        source, move = plain_reference(reference)
        if source not in sources:
            sources.append(source)
        number[i] = sources.index(source)
        moves.append(move)
    moves = np.stack(moves)[choice]
    moved = at[:, :, :3] @ moves[:, :3, :]
    moved[:, :, 3] += at[:, :, 3]
    return moved, number[choice], sources


def plain_reference(reference):
    """(original object or collection, (4, 4) transform) of an instance reference."""
    if reference is None:
        raise ConversionError("it instances nothing at some points")
    if not hasattr(reference, "instance_references"):
        return reference.original, np.eye(4)
    cloud = reference.instances_pointcloud()
    own = reference.mesh or reference.pointcloud or reference.curves or reference.volume
    if own is not None or cloud is None or len(cloud.points) != 1:
        raise ConversionError("its nodes instance geometry that is no object or collection of its own")
    source, move = plain_reference(reference.instance_references()[0])
    return source, np.vstack([instances.read_transforms(cloud)[0], [0, 0, 0, 1]]) @ move


def child_instances(evaluated, children, depsgraph):
    """`native_instances` of children on vertices or faces."""
    mesh = evaluated.data
    linear, positions = child_instancing.dupli_frames(evaluated, mesh)
    to_object = np.linalg.inv(matrix(evaluated.matrix_world))
    at, choice = [], []
    for i, child in enumerate(children):
        relative = to_object @ matrix(child.evaluated_get(depsgraph).matrix_world)
        at.append(child_instancing.child_transforms(evaluated, child, relative, linear, positions))
        choice.append(np.full(len(positions), i, np.int32))
    if not children:
        return np.empty((0, 3, 4)), np.empty(0, np.int32), []
    return np.concatenate(at), np.concatenate(choice), list(children)


def point_mesh(name: str, at: np.ndarray, index: np.ndarray) -> bpy.types.Mesh:
    """A mesh of points that carry transforms (N, 3, 4) as attributes rotation, scale and index.

    Raises ConversionError where a transform shears, which these cannot say.
    """
    size = np.sqrt((at[:, :, :3] ** 2).sum(1))
    size *= np.where(np.linalg.det(at[:, :, :3]) < 0, -1.0, 1.0)[:, None]
    rotation = at[:, :, :3] / np.where(size == 0, 1, size)[:, None, :]
    skew = np.abs(rotation.transpose(0, 2, 1) @ rotation - np.eye(3)).max(initial=0)
    if skew > 1e-3:
        raise ConversionError("its instances are sheared or flat")
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(at))
    mesh.vertices.foreach_set("co", at[:, :, 3].astype(np.float32).ravel())
    for attribute, kind, prop, values in (
        ("rotation", "QUATERNION", "value", quaternions(rotation).astype(np.float32)),
        ("scale", "FLOAT_VECTOR", "vector", size.astype(np.float32)),
        ("index", "INT", "value", index.astype(np.int32)),
    ):
        mesh.attributes.new(attribute, kind, "POINT").data.foreach_set(
            prop, np.ascontiguousarray(values).ravel()
        )
    mesh.update()
    return mesh


def quaternions(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4), w first, of rotations (N, 3, 3), by the largest of their components."""
    m = rotation
    trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    # 4 times each component squared
    squares = np.stack([trace, *(2 * m[:, i, i] - trace for i in range(3))], 1) + 1
    x, y, z = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    w2, x2, y2, z2 = squares.T
    table = np.array([[w2, x, y, z], [x, x2, xy, xz], [y, xy, y2, yz], [z, xz, yz, z2]])
    q = table[np.argmax(squares, 1), :, np.arange(len(m))]
    return q / np.sqrt((q * q).sum(1, keepdims=True))


# Points to a geometry-nodes modifier


def add_modifier(ob, context) -> None:
    """Give a PointMR instancer on points the geometry nodes that instance the same natively."""
    evaluated = ob.evaluated_get(context.evaluated_depsgraph_get())
    settings, data = ob.pointmr, evaluated.data
    kinds = {a.name: a.data_type for a in getattr(data, "attributes", ())}
    tree = bpy.data.node_groups.new(f"{ob.name} instances", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes, links = tree.nodes, tree.links
    start, end = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    info, place = nodes.new("GeometryNodeCollectionInfo"), nodes.new("GeometryNodeInstanceOnPoints")
    info.inputs["Collection"].default_value = settings.instance_collection
    by_index = settings.index_attribute in kinds
    info.inputs["Separate Children"].default_value = by_index
    info.inputs["Reset Children"].default_value = by_index and settings.reset_children
    place.inputs["Pick Instance"].default_value = by_index
    links.new(start.outputs[0], place.inputs["Points"])
    links.new(info.outputs[0], place.inputs["Instance"])
    if by_index:
        links.new(named(nodes, settings.index_attribute, "INT"), place.inputs["Instance Index"])
    rotation = kinds.get(settings.rotation_attribute)
    if settings.rotation_from == "NORMAL":
        align = nodes.new("FunctionNodeAlignRotationToVector")
        align.axis = "Z"
        links.new(nodes.new("GeometryNodeInputNormal").outputs[0], align.inputs["Vector"])
        links.new(align.outputs[0], place.inputs["Rotation"])
    elif settings.rotation_from == "ATTRIBUTE" and rotation in {"QUATERNION", "FLOAT_VECTOR"}:
        # a vector becomes a rotation by its Euler angles
        links.new(named(nodes, settings.rotation_attribute, rotation), place.inputs["Rotation"])
    if settings.scale_attribute in kinds:
        kind = kinds[settings.scale_attribute]
        links.new(named(nodes, settings.scale_attribute, kind), place.inputs["Scale"])
    result = place.outputs[0]
    if ob.show_instancer_for_render:
        join = nodes.new("GeometryNodeJoinGeometry")
        links.new(start.outputs[0], join.inputs[0])
        links.new(result, join.inputs[0])
        result = join.outputs[0]
    links.new(result, end.inputs[0])
    tree[TREE_MARK] = {"rotation_from": settings.rotation_from}
    ob.modifiers.new("Instances", "NODES").node_group = tree


def named(nodes, name: str, kind: str):
    """The output of a Named Attribute node."""
    node = nodes.new("GeometryNodeInputNamedAttribute")
    node.data_type = kind
    node.inputs["Name"].default_value = name
    return node.outputs["Attribute"]


def restore_points(ob, modifier) -> bpy.types.Object:
    """Undo `add_modifier`: the object is PointMR's instancer again."""
    tree = modifier.node_group
    info = next(n for n in tree.nodes if n.bl_idname == "GeometryNodeCollectionInfo")
    ob.pointmr.instance_collection = info.inputs["Collection"].default_value
    ob.pointmr.instance_on = "POINTS"
    ob.pointmr.rotation_from = tree[TREE_MARK]["rotation_from"]
    ob.modifiers.remove(modifier)
    if tree.users == 0:
        bpy.data.node_groups.remove(tree)
    return ob


# Operators


class InstancerOperator:
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return context.mode == "OBJECT" and bool(context.selected_objects or context.object)

    def execute(self, context):
        objects = list(context.selected_objects) or [context.object]
        done = 0
        for ob in objects:
            name = ob.name
            try:
                type(self).convert(ob, context)
                done += 1
            except ConversionError as error:
                level = "ERROR" if len(objects) == 1 else "WARNING"
                self.report({level}, f"object '{name}' is not converted: {error}")
        if done:
            self.report({"INFO"}, f"{done} of {len(objects)} instancers converted")
        return {"FINISHED"} if done else {"CANCELLED"}


class InstancerFromNative(InstancerOperator, Operator):
    """Turn the selected objects' instances into PointMR's, which Blender does not expand"""

    bl_idname = "pointmr.instancer_from_native"
    bl_label = "Make PointMR Instancer"
    convert = staticmethod(from_native)


class InstancerToNative(InstancerOperator, Operator):
    """Turn the selected objects' PointMR instances into Blender's own"""

    bl_idname = "pointmr.instancer_to_native"
    bl_label = "Make Native Instancer"
    convert = staticmethod(to_native)


register, unregister = bpy.utils.register_classes_factory((InstancerFromNative, InstancerToNative))
