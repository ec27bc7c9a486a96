"""Every way in which Blender repeats an object."""

from __future__ import annotations

import bpy
import numpy as np

from benchmarks.features.registry import feature
from benchmarks.features.stage import (
    BLUE,
    CREAM,
    GREEN,
    RED,
    SAND,
    cube,
    link,
    material,
    matte,
    mesh_object,
    monkey,
    node,
    sphere,
    studio,
    torus,
)


def _collection(name: str, *items) -> bpy.types.Collection:
    """Move objects out of the scene into a collection of their own, which only instances show."""
    group = bpy.data.collections.new(name)
    for item in items:
        for user in list(item.users_collection):
            user.objects.unlink(item)
        group.objects.link(item)
    return group


def _instance(group, at=(0, 0, 0), scale=(1, 1, 1), turn=0.0) -> bpy.types.Object:
    """An empty that shows a collection; it is not linked to anything yet."""
    item = bpy.data.objects.new(group.name, None)
    item.instance_type, item.instance_collection = "COLLECTION", group
    item.location, item.scale, item.rotation_euler = at, scale, (0, 0, turn)
    return item


def _toy(name="Toy") -> bpy.types.Collection:
    """A monkey head on a drum, as a collection."""
    drum = cube(matte(SAND), (0, 0, 0.25), 0.5, 0.05, 0.3)
    drum.scale = (1.4, 1.4, 1.0)
    return _collection(name, drum, monkey(matte(CREAM), (0, 0, 0.85), 0.5, 0.3))


@feature()
def instance_collection():
    """Collection instances with rotation and uneven scale, and a collection offset."""
    studio(fill=0.3)
    toy = _toy()
    toy.instance_offset = (0.2, 0, 0)
    link(_instance(toy, (-2.0, 0, 0), (1.2, 1.2, 1.2), -0.4))
    link(_instance(toy, (0.2, -0.6, 0), (1, 1, 1), 0.5))
    link(_instance(toy, (2.2, 0, 0), (0.8, 0.8, 1.7), 1.0))


@feature()
def instance_nested():
    """Collections of instances of collections, three deep, each level turned and scaled."""
    studio(fill=0.3)
    ball = _collection("Ball", sphere(matte(RED), (0, 0, 0.2), 0.2, segments=24))
    ring = bpy.data.collections.new("Ring")
    for i in range(6):
        a = i * np.pi / 3
        ring.objects.link(
            _instance(ball, (0.75 * np.cos(a), 0.75 * np.sin(a), 0.08 * i), (1, 1, 1 + 0.2 * i), a)
        )
    pair = bpy.data.collections.new("Pair")
    pair.objects.link(_instance(ring, (0, 0, 0)))
    pair.objects.link(_instance(ring, (0, 0, 0.7), (0.7, 0.7, 0.7), 0.3))
    for i, x in enumerate((-2.1, 0, 2.1)):
        link(_instance(pair, (x, 0.3 * i, 0), (1 + 0.2 * i,) * 3, 0.2 * i))


@feature()
def instance_mirrored():
    """Mirrored and strongly stretched instances: normals and shading stay right."""
    studio(fill=0.3)
    toy = _toy()
    link(_instance(toy, (-1.4, 0, 0), (1.6, 1.6, 1.6), 0.3))
    link(_instance(toy, (1.4, 0, 0), (-1.6, 1.6, 1.6), -0.3))
    link(_instance(toy, (0, 1.8, 0), (1.2, -3.0, 0.6), 0.0))


@feature()
def instance_vertices():
    """Children repeated on the vertices of a mesh, aligned to its normals."""
    studio(fill=0.3)
    parent = sphere(None, (0, 0, 1.1), 0.95, segments=10)
    child = cube(matte(BLUE), (0, 0, 0), 0.28, 0.03, 0.0)
    child.parent = parent
    parent.instance_type, parent.use_instance_vertices_rotation = "VERTS", True
    parent.show_instancer_for_render = False


@feature()
def instance_faces():
    """Children repeated on faces, scaled by face size; the instancer shows too."""
    studio(fill=0.3)
    parent = torus(matte(CREAM), (0, 0, 0.9), 1.1, 0.4)
    bpy.data.objects.remove(parent)
    bpy.ops.mesh.primitive_torus_add(
        location=(0, 0, 0.8), major_segments=14, minor_segments=6, major_radius=1.2, minor_radius=0.45
    )
    parent = bpy.context.object
    parent.data.materials.append(matte(CREAM))
    child = sphere(matte(GREEN), (0, 0, 0), 0.35, segments=24)
    child.parent = parent
    parent.instance_type, parent.use_instance_faces_scale, parent.instance_faces_scale = "FACES", True, 1.0
    parent.show_instancer_for_render = True


def _scatter(group, density=1.2) -> bpy.types.NodeTree:
    """Geometry nodes that scatter a collection over a surface with random scale and rotation."""
    tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    start, end = node(tree, "NodeGroupInput"), node(tree, "NodeGroupOutput")
    points = node(tree, "GeometryNodeDistributePointsOnFaces", {"Mesh": start.outputs[0], "Density": density})
    parts = node(tree, "GeometryNodeCollectionInfo", transform_space="RELATIVE")
    parts.inputs["Collection"].default_value = group
    parts.inputs["Separate Children"].default_value = True
    parts.inputs["Reset Children"].default_value = True
    scale = node(tree, "FunctionNodeRandomValue", data_type="FLOAT")
    scale.inputs[2].default_value, scale.inputs[3].default_value = 0.4, 1.3
    turn = node(tree, "FunctionNodeRandomValue", data_type="FLOAT_VECTOR")
    turn.inputs[0].default_value, turn.inputs[1].default_value = (0, 0, 0), (0.4, 0.4, 6.28)
    placed = node(
        tree,
        "GeometryNodeInstanceOnPoints",
        {
            "Points": points.outputs[0],
            "Instance": parts.outputs[0],
            "Pick Instance": True,
            "Rotation": turn.outputs[0],
            "Scale": scale.outputs[1],
        },
    )
    joined = node(tree, "GeometryNodeJoinGeometry")
    tree.links.new(start.outputs[0], joined.inputs[0])
    tree.links.new(placed.outputs[0], joined.inputs[0])
    tree.links.new(joined.outputs[0], end.inputs[0])
    return tree


@feature()
def instance_geometry_nodes():
    """Geometry nodes scatter two kinds of objects over the floor, with random turn and scale."""
    studio(fill=0.3)
    parts = _collection(
        "Parts", cube(matte(RED), (0, 0, 0), 0.4, 0.04, 0), sphere(matte(GREEN), (0, 0, 0), 0.25, segments=24)
    )
    ground = mesh_object(
        "Ground",
        [(-3, -2, 0.01), (3, -2, 0.01), (3, 2.5, 0.01), (-3, 2.5, 0.01)],
        [(0, 1, 2, 3)],
        matte(SAND),
    )
    ground.modifiers.new("Scatter", "NODES").node_group = _scatter(parts, 2.0)


@feature()
def instance_geometry_nodes_attribute():
    """A colour attribute on geometry-nodes instances, read through the Attribute node (Instancer)."""
    studio(fill=0.3)

    def surface(tree):
        tint = node(tree, "ShaderNodeAttribute", attribute_name="tint", attribute_type="INSTANCER")
        return node(tree, "ShaderNodeBsdfDiffuse", {"Color": tint.outputs["Color"]}).outputs[0]

    parts = _collection("Parts", cube(material("Tint", surface), (0, 0, 0), 0.5, 0.05, 0))
    tree = _scatter(parts, 1.5)
    placed = next(n for n in tree.nodes if n.bl_idname == "GeometryNodeInstanceOnPoints")
    joined = next(n for n in tree.nodes if n.bl_idname == "GeometryNodeJoinGeometry")
    index = node(tree, "FunctionNodeRandomValue", data_type="FLOAT_VECTOR")
    store = node(
        tree,
        "GeometryNodeStoreNamedAttribute",
        {"Geometry": placed.outputs[0], "Name": "tint"},
        data_type="FLOAT_COLOR",
        domain="INSTANCE",
    )
    value = next(s for s in store.inputs if s.type == "RGBA" and s.enabled)
    tree.links.new(index.outputs[0], value)
    for old in list(joined.inputs[0].links):
        if old.from_node == placed:
            tree.links.remove(old)
    tree.links.new(store.outputs[0], joined.inputs[0])
    ground = mesh_object(
        "Ground",
        [(-3, -2, 0.01), (3, -2, 0.01), (3, 2.5, 0.01), (-3, 2.5, 0.01)],
        [(0, 1, 2, 3)],
        matte(SAND),
    )
    ground.modifiers.new("Scatter", "NODES").node_group = tree


@feature()
def instance_particles():
    """A particle system (hair) that shows an object on each strand."""
    studio(fill=0.3)
    leaf = cube(matte(GREEN), (0, 0, -50), 1.0, 0.0, 0.0)
    leaf.scale = (1.0, 0.35, 0.1)
    ball = sphere(matte(SAND), (0, 0, 1.2), 0.9, segments=18)
    system = ball.modifiers.new("Leaves", "PARTICLE_SYSTEM").particle_system
    settings = system.settings
    settings.type, settings.count, settings.hair_length = "HAIR", 146, 0.8
    settings.render_type, settings.instance_object, settings.particle_size = "OBJECT", leaf, 1.0
    settings.use_advanced_hair, settings.use_rotations = True, True
    settings.rotation_mode, settings.phase_factor, settings.rotation_factor_random = "NOR", 0.3, 0.0
    # Blender's random draws differ from run to run here: strands on the vertices, in order, do not.
    settings.emit_from, settings.use_emit_random = "VERT", False
    system.seed = 3


@feature()
def instance_random():
    """Object Info: Random gives each instance its own shade, the same in every renderer."""
    studio(fill=0.3)

    def surface(tree):
        value = node(tree, "ShaderNodeObjectInfo").outputs["Random"]
        ramp = node(tree, "ShaderNodeValToRGB", {"Fac": value})
        ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = (
            (0.6, 0.05, 0.03, 1),
            (0.9, 0.8, 0.4, 1),
        )
        return node(tree, "ShaderNodeBsdfDiffuse", {"Color": ramp.outputs[0]}).outputs[0]

    block = _collection("Block", cube(material("Random", surface), (0, 0, 0.3), 0.6, 0.05, 0.0))
    for i in range(15):
        link(
            _instance(
                block, (-2.6 + 1.3 * (i % 5), -0.8 + 1.2 * (i // 5), 0), (1, 1, 1 + 0.3 * (i % 3)), 0.3 * i
            )
        )


@feature()
def instance_object_types():
    """Curves with bevel, text, metaballs and a NURBS surface: evaluated to meshes like any other object."""
    studio(fill=0.3)
    curve = bpy.data.curves.new("Curve", "CURVE")
    curve.dimensions, curve.bevel_depth, curve.bevel_resolution = "3D", 0.14, 4
    spline = curve.splines.new("BEZIER")
    spline.bezier_points.add(2)
    for point, at in zip(
        spline.bezier_points, ((-2.6, 0, 0.2), (-1.9, 0.3, 1.8), (-1.2, 0, 0.3)), strict=True
    ):
        point.co, point.handle_left_type, point.handle_right_type = at, "AUTO", "AUTO"
    curve.materials.append(matte(RED))
    link(bpy.data.objects.new("Curve", curve))
    text = bpy.data.curves.new("Text", "FONT")
    text.body, text.extrude, text.size, text.align_x = "mr", 0.12, 1.5, "CENTER"
    text.materials.append(matte(CREAM))
    item = link(bpy.data.objects.new("Text", text))
    item.location, item.rotation_euler = (0.2, 0, 0.1), (1.4, 0, 0.2)
    ball = bpy.data.metaballs.new("Meta")
    ball.render_resolution = 0.08
    for x in (0, 0.55):
        element = ball.elements.new()
        element.co, element.radius = (x, 0, 0.3 * x), 0.7
    ball.materials.append(matte(BLUE))
    link(bpy.data.objects.new("Meta", ball)).location = (1.9, 0, 0.6)
