"""What Blender places for its user, on vertices, by nodes and as particles, is where Blender shows it."""

from __future__ import annotations

import bpy
import builders as b
import numpy as np
import placements
import pytest
from placements import check, export, seeds_agree

from blender_addon import sync
from pointmr_engine.scene import group as groups


@pytest.fixture
def scene():
    return b.empty_scene()


# Vertices and faces


@pytest.mark.parametrize("kind", ["VERTS", "FACES"])
@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize("shown", [False, True])
def test_children_on_vertices_and_faces(scene, kind, turn, shown):
    ob = b.add(
        "points",
        b.bumpy("m"),
        location=(1, 2, 3),
        rotation_euler=(0.4, 0.1, 0.9),
        scale=(1, 2, 1.5),
        instance_type=kind,
        show_instancer_for_render=shown,
    )
    ob.use_instance_vertices_rotation = ob.use_instance_faces_scale = turn
    ob.instance_faces_scale = 0.7
    c = b.collection("c")
    c.instance_offset = (0, 1, 0)
    b.add("in c", b.polygon("p", 7), c)
    b.add("in c too", b.polygon("p", 8), c, location=(0, 0, 1))
    axes = (("POS_Y", "Z"), ("NEG_X", "Z"), ("POS_Z", "X"))
    for i, (track, up) in enumerate(axes):
        child = b.add(
            f"child{i}", b.polygon("p", 4 + i), location=(i, 0, 1), rotation_euler=(0.2 * i, 0, 0.5)
        )
        child.parent, child.track_axis, child.up_axis = ob, track, up
        if i == 1:
            child.matrix_parent_inverse = ob.matrix_basis.inverted()
    b.instance_of("instancing child", c, location=(0, 0, 2)).parent = ob
    b.add("grandchild", b.polygon("p", 9), location=(0, 1, 0)).parent = bpy.data.objects["child0"]
    n = len(ob.data.vertices) if kind == "VERTS" else len(ob.data.polygons)
    result, _, ours = check(n * (3 + 2 + 1) + 1 + shown)
    unique, _, depth = groups.count_triangles(result.root)
    assert unique == 2 + 3 + 4 + 5 + 6 + 7 + 18 * shown


@pytest.mark.parametrize("kind", ["VERTS", "FACES"])
def test_children_on_vertices_within_a_collection(scene, kind):
    c = b.collection("c")
    ob = b.add(
        "points", b.bumpy("m"), c, location=(1, 0, 0), instance_type=kind, show_instancer_for_render=False
    )
    b.add("child", b.polygon("p", 5), c, location=(0, 0, 1)).parent = ob
    b.add("hidden", b.polygon("p", 6), c, hide_render=True).parent = ob
    b.add("not in c", b.polygon("p", 7)).parent = ob
    for i in range(2):
        b.instance_of(f"e{i}", c, location=(0, 9 * i, 0), rotation_euler=(1, 0, i))
    check(2 * (16 if kind == "VERTS" else 9))


def test_vertex_seeds(scene):
    ob = b.add("points", b.bumpy("m"), instance_type="VERTS", show_instancer_for_render=False)
    b.add("child", b.polygon("p", 5)).parent = ob
    result, _, theirs = export()
    seeds_agree(placements.by_engine(result.root), theirs)


# Geometry nodes


def nodes_scene(build, mesh=None):
    ob = b.add("gn", mesh or b.bumpy("m"), location=(0, 1, 2), rotation_euler=(0.1, 0.5, 0))
    b.nodes_on(ob, b.node_group("tree", build))
    return ob


def test_nodes_instance_objects_collections_and_geometry(scene):
    source = b.add("source", b.polygon("p", 5), location=(3, 3, 3))
    c = b.collection("c")
    c.instance_offset = (0, 0, 1)
    b.add("in c", b.polygon("p", 6), c)
    b.add("in c too", b.polygon("p", 7), c, location=(1, 0, 0))

    def build(tree, start, end):
        cube = tree.nodes.new("GeometryNodeMeshCube").outputs[0]
        turn = b.random_vector(tree, (0, 0, 0), (3, 3, 3))
        size = b.random_vector(tree, (-1, 0.5, 0.5), (-0.5, 2, 2))
        tree.links.new(
            b.join(
                tree,
                start,
                b.scatter(tree, start, b.object_info(tree, source), Rotation=turn),
                b.scatter(tree, start, b.collection_info(tree, c), Scale=size),
                b.scatter(tree, start, cube, Scale=(0.1, 0.1, 0.1)),
            ),
            end,
        )

    ob = nodes_scene(build)
    result, _, _ = check(16 * (1 + 2 + 1) + 2)
    assert groups.count_triangles(result.root)[0] == 18 + 3 + 4 + 5 + 12
    ob.show_instancer_for_render = False
    check(16 * (1 + 2 + 1) + 1)


def test_nodes_pick_children_of_a_collection(scene):
    c = b.collection("c")
    for i in range(3):
        b.add(f"in c{i}", b.polygon("p", 5 + i), c, location=(i, 0, 0))
    sub = b.collection("sub", c)
    b.add("in sub", b.polygon("p", 9), sub)
    b.add("in sub too", b.polygon("p", 10), sub, location=(0, 0, 1))

    def build(tree, start, end):
        info = b.collection_info(tree, c, separate=True, reset=True)
        tree.links.new(b.scatter(tree, start, info, Pick_Instance=True), end)

    nodes_scene(build)
    result, _, theirs = export()
    ours = placements.by_engine(result.root)
    assert placements.differences(ours, theirs) == ""
    assert {s.triangles for s in ours} == {3, 4, 5, 7, 8}


def test_nested_nodes_stay_nested(scene):
    leaf = b.add("leaf", b.polygon("p", 5), hide_render=True)

    def twig(tree, start, end):
        tree.links.new(b.scatter(tree, start, b.object_info(tree, leaf), Scale=(0.1, 0.1, 0.1)), end)

    branch = b.add("branch", b.bumpy("m1"), location=(9, 9, 9), hide_render=False)
    b.nodes_on(branch, b.node_group("twig", twig))

    def crown(tree, start, end):
        tree.links.new(b.scatter(tree, start, b.object_info(tree, branch), Rotation=(0.5, 0, 0)), end)

    inner = b.add("crown", b.bumpy("m2", 4))
    b.nodes_on(inner, b.node_group("crown", crown))

    def nested(tree, start, end):
        first = b.scatter(tree, start, b.object_info(tree, leaf))
        grid = tree.nodes.new("GeometryNodeMeshGrid").outputs[0]
        tree.links.new(b.scatter(tree, grid, first), end)

    b.nodes_on(b.add("nested", b.bumpy("m3"), location=(0, 0, 50)), b.node_group("nested", nested))
    result, _, _ = check(16 + 25 * 16 + 9 * 16)
    assert groups.count_triangles(result.root) == (3, 3 * (16 + 400 + 144), 3)


def test_nodes_within_a_collection_instance(scene):
    c = b.collection("c")
    source = b.add("source", b.polygon("p", 5), hide_render=True)

    def build(tree, start, end):
        tree.links.new(b.join(tree, start, b.scatter(tree, start, b.object_info(tree, source))), end)

    ob = b.add("gn", b.bumpy("m"), c, location=(1, 1, 1))
    b.nodes_on(ob, b.node_group("tree", build))
    for i in range(2):
        b.instance_of(f"e{i}", c, location=(0, 0, 7 * i), scale=(1, 1, -1))
    check(2 * 17)


def test_nodes_seeds(scene):
    source = b.add("source", b.polygon("p", 5))

    def build(tree, start, end):
        cube = tree.nodes.new("GeometryNodeMeshCube").outputs[0]
        tree.links.new(
            b.join(
                tree,
                b.scatter(tree, start, b.object_info(tree, source)),
                b.scatter(tree, start, cube, Scale=(0.1, 0.1, 0.1)),
            ),
            end,
        )

    nodes_scene(build)
    scene.collection.objects.unlink(source)
    result, _, theirs = export()
    seeds_agree(placements.by_engine(result.root), theirs)


def test_instance_attributes_that_a_material_reads(scene):
    source = b.add("source", b.polygon("p", 5), hide_render=True)
    source["wetness"] = 0.25
    material = bpy.data.materials.new("m")
    material.use_nodes = True
    for kind, name in (("INSTANCER", "tint"), ("OBJECT", "wetness")):
        node = material.node_tree.nodes.new("ShaderNodeAttribute")
        node.attribute_type, node.attribute_name = kind, name
    source.data.materials.append(material)

    def build(tree, start, end):
        store = tree.nodes.new("GeometryNodeStoreNamedAttribute")
        store.data_type, store.domain = "FLOAT_VECTOR", "INSTANCE"
        store.inputs["Name"].default_value = "tint"
        tree.links.new(tree.nodes.new("GeometryNodeInputPosition").outputs[0], store.inputs["Value"])
        tree.links.new(b.scatter(tree, start, b.object_info(tree, source)), store.inputs["Geometry"])
        tree.links.new(store.outputs[0], end)

    nodes_scene(build)
    result, _, _ = check(16)
    inner = result.root.instances[0].groups[0].instances[0]
    assert np.allclose(inner.attributes["tint"], inner.transforms[:, :, 3])
    assert np.allclose(inner.attributes["wetness"], 0.25) and len(inner.attributes["wetness"]) == 16


# Particles


@pytest.mark.parametrize("render_type", ["OBJECT", "COLLECTION"])
@pytest.mark.parametrize("hair", [False, True])
def test_particles(scene, render_type, hair):
    source = b.add(
        "source", b.polygon("p", 5), location=(3, 0, 0), rotation_euler=(0.3, 0, 0), scale=(1, 2, 1)
    )
    c = b.collection("c")
    b.add("in c", b.polygon("p", 6), c, location=(0, 0, 1))
    b.add("in c too", b.polygon("p", 7), c)
    ob = b.add("emitter", b.bumpy("m"), location=(0, 1, 2), rotation_euler=(0.1, 0.5, 0))
    ob.modifiers.new("p", "PARTICLE_SYSTEM")
    settings = ob.particle_systems[0].settings
    settings.type = "HAIR" if hair else "EMITTER"
    settings.count, settings.render_type, settings.particle_size = 20, render_type, 0.3
    settings.instance_object, settings.instance_collection = source, c
    settings.use_advanced_hair, settings.use_rotations = True, True
    if not hair:
        settings.frame_start, settings.frame_end, settings.lifetime = 1, 10, 4
        for frame in range(1, 9):
            scene.frame_set(frame)
    result, _, ours = check()
    assert sum(s.triangles != 18 for s in ours) >= (21 if hair else 6)
    within = b.collection("within")
    scene.collection.objects.unlink(ob)
    within.objects.link(ob)
    b.instance_of("e", within, location=(0, 0, 9))
    check()


# All of them


def test_hair_of_a_hidden_emitter_and_of_a_layer_without_surfaces(scene):
    ob = b.add("hairy", b.bumpy("m"))
    ob.modifiers.new("p", "PARTICLE_SYSTEM")
    settings = ob.particle_systems[0].settings
    settings.type, settings.count, settings.render_step = "HAIR", 5, 1
    ob.show_instancer_for_render = False

    def shown():
        return sorted(s.triangles for s in placements.by_engine(export()[0].root))

    (hair,) = shown()
    assert hair % 16 == 0 and hair >= 5 * 2 * 16
    ob.show_instancer_for_render = True
    assert shown() == [18, hair]
    layer = scene.view_layers[0]
    layer.use_solid = False
    assert shown() == [hair]
    layer.use_solid, layer.use_strand = True, False
    assert shown() == [18]


def test_million_vertex_instances(scene):
    """A million native instances come in arrays: no Python per instance."""
    import time

    n = 1_000_000
    mesh = bpy.data.meshes.new("points")
    mesh.vertices.add(n)
    mesh.vertices.foreach_set("co", np.random.default_rng(0).random(3 * n, np.float32))
    ob = b.add("points", mesh, instance_type="VERTS", show_instancer_for_render=False)
    b.add("child", b.polygon("p", 5)).parent = ob

    def action(depsgraph):
        start = time.process_time()
        result = sync.export(depsgraph)
        exported = time.process_time() - start
        start = time.process_time()
        sum(1 for _ in depsgraph.object_instances)
        return result, exported, time.process_time() - start

    result, exported, iterated = placements.with_depsgraph(action)
    assert groups.count_triangles(result.root)[1] == 3 * n
    assert exported < 2 * iterated + 0.5


@pytest.mark.parametrize("name", ["objects", "nested", "faces", "nodes", "particles"])
def test_without_geometry_sets_instances_are_expanded(scene, monkeypatch, name):
    """As in Blender before 4.5."""
    from blender_addon.sync import expanded
    from blender_addon.sync.geometry import GeometrySync

    monkeypatch.setattr(expanded, "has_geometry_sets", lambda: False)
    monkeypatch.setattr(GeometrySync, "geometry_set", lambda self, ob: None)
    if name == "objects":
        mesh = b.polygon("shared", 5)
        for i in range(4):
            b.add(f"o{i}", mesh, location=(i, 0, 0), scale=(1, -1 if i % 2 else 1, 1 + i))
        check(4)
    elif name == "nested":
        test_nested_sets_with_own_geometry(scene)
    elif name == "faces":
        test_children_on_vertices_and_faces(scene, "FACES", True, True)
    elif name == "nodes":
        test_nodes_within_a_collection_instance(scene)
    else:
        test_particles(scene, "COLLECTION", False)


def test_nested_sets_with_own_geometry(scene):
    leaf = b.add("leaf", b.polygon("p", 5), hide_render=True)

    def nested(tree, start, end):
        first = b.scatter(tree, start, b.object_info(tree, leaf))
        grid = tree.nodes.new("GeometryNodeMeshGrid").outputs[0]
        tree.links.new(b.join(tree, start, b.scatter(tree, grid, first)), end)

    b.nodes_on(b.add("nested", b.bumpy("m3"), location=(0, 0, 50)), b.node_group("nested", nested))
    check(9 * 16 + 1)
