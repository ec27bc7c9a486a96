"""Instances: what an export shows, and where, is what Blender's own expansion shows."""

from __future__ import annotations

import bpy
import builders as b
import numpy as np
import placements
import pytest

from blender_addon import sync
from pointmr_engine.scene import group as groups


@pytest.fixture
def scene():
    return b.empty_scene()


def export():
    """(engine scene, messages, what Blender shows)."""

    def action(depsgraph):
        said = []
        result = sync.export(depsgraph, report=lambda level, text: said.append((level, text)))
        return result, said, placements.by_blender(depsgraph)

    return placements.with_depsgraph(action)


def check(count: int | None = None):
    """Export, compare with Blender, and give back (engine scene, messages, what ours shows)."""
    result, said, theirs = export()
    ours = placements.by_engine(result.root)
    assert placements.differences(ours, theirs) == ""
    _, instanced, _ = groups.count_triangles(result.root)
    assert instanced == sum(s.triangles for s in theirs)
    if count is not None:
        assert len(ours) == count, placements.names(ours)
    return result, said, ours


def seeds_agree(ours, theirs) -> None:
    """Every placement that Blender gives a random id has it, where one level of instancing made it."""

    def key(s):
        return (s.triangles, *np.round(s.matrix, 3).ravel())

    expected = {}
    for s in theirs:
        expected.setdefault(key(s), set()).add(s.seed)
    for s in ours:
        assert s.seed in expected[key(s)], s.name


# Objects


def test_shared_mesh_is_one_group(scene):
    mesh = b.polygon("shared", 5)
    for i in range(4):
        b.add(f"o{i}", mesh, location=(i, 0, 0), scale=(1, -1 if i % 2 else 1, 1 + i))
    result, _, ours = check(4)
    unique, instanced, depth = groups.count_triangles(result.root)
    assert (unique, instanced, depth) == (3, 12, 1)
    assert len({id(g) for inst in result.root.instances for g in inst.groups}) == 1


def test_object_linked_materials_share_arrays(scene):
    mesh = b.polygon("shared", 5)
    mesh.materials.append(bpy.data.materials.new("data"))
    b.add("a", mesh)
    other = b.add("b", mesh)
    other.material_slots[0].link = "OBJECT"
    other.material_slots[0].material = bpy.data.materials.new("own")
    result, _, _ = check(2)
    a, c = [g.meshes[0] for g in result.root.instances[0].groups]
    assert a.positions is c.positions and a.triangles is c.triangles
    assert {a.materials[0].name, c.materials[0].name} == {"data", "own"}


def test_hidden_objects_and_collections(scene):
    hidden = b.collection("hidden", scene.collection)
    b.add("in hidden", b.polygon("p"), hidden)
    hidden.hide_render = True
    excluded = b.collection("excluded", scene.collection)
    b.add("in excluded", b.polygon("p"), excluded)
    both = b.add("in both", b.polygon("p", 6), excluded)
    scene.collection.objects.link(both)
    b.add("hidden", b.polygon("p"), hide_render=True)
    b.add("shown", b.polygon("p", 5), hide_viewport=True)
    scene.view_layers[0].layer_collection.children["excluded"].exclude = True
    result, _, ours = check(2)
    assert sorted(s.triangles for s in ours) == [3, 4]


def test_animated_visibility(scene):
    ob = b.add("o", b.polygon("p"))
    ob.hide_render = False
    ob.keyframe_insert("hide_render", frame=1)
    ob.hide_render = True
    ob.keyframe_insert("hide_render", frame=2)
    for frame, count in ((1, 1), (2, 0), (1, 1)):
        scene.frame_set(frame)
        check(count)


def test_background_scene(scene):
    other = bpy.data.scenes.new("set")
    b.add("in set", b.polygon("p", 6), other.collection, location=(1, 0, 0))
    b.add("hidden in set", b.polygon("p", 7), other.collection, hide_render=True)
    b.add("own", b.polygon("p", 5))
    scene.background_set = other
    check(2)


def test_view_layer_flags_and_ray_visibility(scene):
    held, indirect = b.collection("held", scene.collection), b.collection("indirect", scene.collection)
    b.add("held out", b.polygon("p", 4), held)
    b.add("indirect", b.polygon("p", 5), indirect)
    b.add("own holdout", b.polygon("p", 6), is_holdout=True)
    b.add("no shadow", b.polygon("p", 7), visible_shadow=False, visible_glossy=False)
    b.add("nowhere", b.polygon("p", 8), **{f"visible_{n}": False for n in RAYS})
    layer = scene.view_layers[0].layer_collection.children
    layer["held"].holdout = True
    layer["indirect"].indirect_only = True
    result, _, _ = export()
    seen = {s.triangles: s.visibility for s in placements.by_engine(result.root)}
    every = groups.VISIBLE
    assert seen == {
        2: every | groups.HOLDOUT,
        3: every & ~groups.CAMERA,
        4: every | groups.HOLDOUT,
        5: every & ~groups.SHADOW & ~groups.GLOSSY,
    }


RAYS = ("camera", "diffuse", "glossy", "transmission", "shadow", "volume_scatter")


def test_visibility_of_instancer_and_instanced(scene):
    c = b.collection("c")
    b.add("a", b.polygon("p", 4), c, visible_glossy=False)
    b.add("b", b.polygon("p", 5), c, is_holdout=True)
    b.instance_of("e", c, visible_shadow=False)
    b.instance_of("held", c, location=(5, 0, 0), is_holdout=True)
    result, _, _ = export()
    every = groups.VISIBLE
    seen = {(s.triangles, s.matrix[0, 3]): s.visibility for s in placements.by_engine(result.root)}
    assert seen == {
        (2, 0.0): every & ~groups.GLOSSY & ~groups.SHADOW,
        (3, 0.0): every & ~groups.SHADOW,  # an instanced object's own holdout does not count in Blender
        (2, 5.0): every & ~groups.GLOSSY | groups.HOLDOUT,
        (3, 5.0): every | groups.HOLDOUT,
    }


def test_shadow_catchers_are_objects_and_what_their_instancers_place(scene):
    c = b.collection("c")
    b.add("a", b.polygon("p", 4), c, is_shadow_catcher=True)
    b.add("b", b.polygon("p", 5), c)
    b.add("c", b.polygon("p", 6), is_shadow_catcher=True, visible_shadow=False)
    b.instance_of("plain", c)
    b.instance_of("catching", c, location=(5, 0, 0), is_shadow_catcher=True)
    result, _, _ = export()
    every, caught = groups.VISIBLE, groups.VISIBLE | groups.SHADOW_CATCHER
    found = [
        sorted(int(v) for batch in group.instances for v in np.broadcast_to(batch.visibility, len(batch)))
        for group in (
            result.root,
            next(c for batch in result.root.instances for c in batch.groups if c.instances),
        )
    ]
    assert found == [sorted([every, caught, caught & ~groups.SHADOW]), sorted([every, caught])]


def test_object_index_color_and_seed(scene):
    c = b.collection("c")
    b.add("a", b.polygon("p", 4), c, pass_index=3, color=(1, 0, 0, 1))
    b.add("b", b.polygon("p", 5), c, pass_index=4)
    b.instance_of("e", c, pass_index=9)
    b.add("plain", b.polygon("p", 6), pass_index=5, color=(0, 0.5, 0, 1))
    result, _, ours = check(3)
    assert {s.triangles: s.object_index for s in ours} == {2: 3, 3: 4, 4: 5}
    from blender_addon.sync.seeds import object_seed

    assert [s.seed for s in ours if s.triangles == 4] == [object_seed("plain")]
    colors = {tuple(np.round(row, 3)) for inst in result.root.instances for row in inst.color}
    assert (0.0, 0.5, 0.0, 1.0) in colors


# Collections


def test_nested_collections_with_offsets(scene):
    inner, outer = b.collection("inner"), b.collection("outer")
    inner.instance_offset = (1, 2, 3)
    b.add("a", b.polygon("p", 4), inner, location=(0, 0, 1), rotation_euler=(0.3, 0.2, 0.1))
    b.add("b", b.polygon("p", 5), inner, scale=(2, 1, -1))
    child = b.collection("child", inner)
    b.add("c", b.polygon("p", 6), child)
    no = b.collection("no", inner)
    b.add("d", b.polygon("p", 7), no)
    no.hide_render = True
    b.add("e", b.polygon("p", 8), inner, hide_render=True)
    outer.instance_offset = (0, 0, -2)
    for i in range(3):
        e = b.instance_of(f"in{i}", inner, location=(4 * i, 0, 0), rotation_euler=(0, 0, i))
        scene.collection.objects.unlink(e)
        outer.objects.link(e)
    for i in range(2):
        b.instance_of(f"out{i}", outer, location=(0, 20 * i, 0), scale=(-1, 1, 1 + i))
    result, _, _ = check(2 * 3 * 3)
    unique, instanced, depth = groups.count_triangles(result.root)
    assert depth == 3 and unique == 2 + 3 + 4


def test_hidden_instanced_collection_and_hidden_instancer(scene):
    c, gone = b.collection("c"), b.collection("gone")
    b.add("a", b.polygon("p", 4), c)
    b.add("b", b.polygon("p", 5), gone)
    gone.hide_render = True
    b.instance_of("e", c)
    b.instance_of("gone", gone)
    b.instance_of("off", c, hide_render=True)
    b.instance_of("self hidden", c, location=(1, 0, 0), show_instancer_for_render=False)
    check(2)


def test_deeper_than_blender_goes(scene):
    """Blender stops at eight levels; this goes on."""
    below = b.collection("c0")
    b.add("leaf", b.polygon("p", 4), below)
    for level in range(1, 12):
        c = b.collection(f"c{level}")
        for i in range(2):
            e = b.instance_of(f"e{level}.{i}", below, location=(0, 0, i * 2.0**level))
            scene.collection.objects.unlink(e)
            c.objects.link(e)
        below = c
    b.instance_of("top", below)
    result, _, _ = export()
    assert groups.count_triangles(result.root)[1] == 2 * 2**11


def test_lamps_in_instances(scene):
    c = b.collection("c")
    lamp = b.add("lamp", bpy.data.lights.new("l", "POINT"), c, location=(0, 0, 1), visible_glossy=False)
    lamp.visible_camera = True  # lights are born invisible to the camera
    lamp.data.energy = 7
    b.add("a", b.polygon("p"), c)
    for i in range(3):
        b.instance_of(f"e{i}", c, location=(i, 0, 0), visible_camera=i != 1)
    b.add("sun", bpy.data.lights.new("s", "SUN"))
    b.add("hidden", bpy.data.lights.new("s", "SUN"), hide_render=True)
    result, _, _ = check(3)
    points = sorted((x for x in result.lights if x.kind == "POINT"), key=lambda x: x.world_from_light[0, 3])
    assert [tuple(x.world_from_light[:3, 3]) for x in points] == [(0, 0, 1), (1, 0, 1), (2, 0, 1)]
    assert {x.power for x in points} == {7.0}
    every = groups.VISIBLE & ~groups.GLOSSY
    assert [x.visibility for x in points] == [every, every & ~groups.CAMERA, every]
    assert sum(x.kind == "SUN" for x in result.lights) == 1


def test_too_many_lamps_are_cut_with_a_warning(scene, monkeypatch):
    from blender_addon.sync import lights

    monkeypatch.setattr(lights, "MAX_LAMPS", 5)
    c = b.collection("c")
    b.add("lamp", bpy.data.lights.new("l", "POINT"), c)
    points = b.add("points", b.bumpy("m"), instance_type="VERTS")
    b.instance_of("e", c).parent = points
    result, said, _ = export()
    assert len(result.lights) == 5
    assert any(text.startswith("16 lamps") for _, text in said)


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


# Other kinds of objects


def test_curves_text_and_metaballs(scene):
    curve = bpy.data.curves.new("cu", "CURVE")
    spline = curve.splines.new("BEZIER")
    spline.bezier_points.add(1)
    spline.bezier_points[1].co = (1, 1, 1)
    curve.bevel_depth, curve.dimensions = 0.1, "3D"
    text = bpy.data.curves.new("tx", "FONT")
    text.body, text.extrude = "Mr", 0.1
    surface = bpy.data.curves.new("su", "SURFACE")
    spline = surface.splines.new("NURBS")
    spline.points.add(3)
    bare = bpy.data.curves.new("bare", "CURVE")
    bare.splines.new("POLY").points.add(1)
    b.add("bare", bare)
    c = b.collection("c")
    for name, data in (("cu", curve), ("tx", text), ("cu too", curve)):
        b.add(name, data, location=(len(bpy.data.objects), 0, 0))
        b.add(f"{name} in c", data, c)
    for i in range(2):
        ball = bpy.data.metaballs.new("mb")
        ball.elements.new()
        b.add("ball" if i == 0 else "ball.001", ball, location=(i, 0, 5))
    b.instance_of("e", c, location=(0, 5, 0))
    result, _, _ = check(3 + 3 + 1)
    meshes = [m for g in groups.unique_groups(result.root) for m in g.meshes]
    assert len([m for m in meshes if m.name.startswith("cu")]) == 1, (
        "curves that share their data share the mesh"
    )


def test_flat_and_singular_placements_are_named(scene):
    b.add("flat", b.polygon("p"), scale=(1, 1, 0))
    c = b.collection("c")
    b.add("a", b.polygon("p", 5), c)
    b.add("b", b.polygon("p", 6), c)
    b.instance_of("vanished", c, scale=(0, 0, 0))
    b.add("good", b.polygon("p", 7))
    result, said, _ = export()
    assert [s.triangles for s in placements.by_engine(result.root)] == [5]
    text = " ".join(t for _, t in said)
    assert "singular" in text and "'flat'" in text


def test_hair_and_points_are_visible(scene):
    ob = b.add("hairy", b.bumpy("m"))
    ob.modifiers.new("p", "PARTICLE_SYSTEM")
    settings = ob.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length, settings.render_step = "HAIR", 12, 2.0, 2
    hair = bpy.data.hair_curves.new("curves")
    hair.add_curves([3, 4])
    hair.points.foreach_set("position", np.arange(21, dtype=np.float32))
    b.add("curves", hair)
    cloud = bpy.data.pointclouds.new("cloud")
    b.add("cloud", cloud, location=(0, 0, 5))

    def build(tree, start, end):
        tree.links.new(tree.nodes.new("GeometryNodePoints").outputs[0], end)

    points = b.node_group("points", build)
    points.nodes["Points"].inputs["Count"].default_value = 7
    b.nodes_on(bpy.data.objects["cloud"], points)
    result, said, _ = export()
    shown = placements.by_engine(result.root)
    by_name = {s.name: s.triangles for s in shown}
    assert by_name["curves"] == (2 + 3) * 8
    assert by_name[f"hairy/{ob.particle_systems[0].name}"] == 12 * 4 * 8
    assert sum(s.name == "cloud" for s in shown) == 7
    assert not [t for level, t in said if level == "ERROR"]


def test_hair_of_a_hidden_emitter_and_of_a_layer_without_surfaces(scene):
    ob = b.add("hairy", b.bumpy("m"))
    ob.modifiers.new("p", "PARTICLE_SYSTEM")
    settings = ob.particle_systems[0].settings
    settings.type, settings.count, settings.render_step = "HAIR", 5, 1
    ob.show_instancer_for_render = False

    def shown():
        return sorted(s.triangles for s in placements.by_engine(export()[0].root))

    assert shown() == [5 * 2 * 8]
    ob.show_instancer_for_render = True
    assert shown() == [18, 5 * 2 * 8]
    layer = scene.view_layers[0]
    layer.use_solid = False
    assert shown() == [5 * 2 * 8]
    layer.use_solid, layer.use_strand = True, False
    assert shown() == [18]


def test_missing_libraries_are_named(scene, tmp_path):
    library = tmp_path / "library.blend"
    c = b.collection("linked collection")
    b.add("in c", b.polygon("p"), c)
    linked = b.add("linked object", b.polygon("linked mesh"))
    bpy.data.libraries.write(str(library), {c, linked})
    scene = b.empty_scene()
    with bpy.data.libraries.load(str(library), link=True) as (_, into):
        into.collections, into.objects = ["linked collection"], ["linked object"]
    b.instance_of("e", into.collections[0])
    b.add("o", into.objects[0].data)
    scene.collection.objects.link(into.objects[0])
    b.add("good", b.polygon("p", 5))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    library.unlink()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))
    result, said, _ = export()
    assert [s.triangles for s in placements.by_engine(result.root)] == [3]
    text = "\n".join(t for _, t in said)
    assert "'linked collection': its library file is missing" in text
    assert "'linked object': its library file is missing" in text


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


def test_cancel_stops_the_export(scene):
    for i in range(50):
        b.add(f"o{i}", b.bumpy("m", 20))

    def action(depsgraph):
        with pytest.raises(sync.Cancelled):
            sync.export(depsgraph, cancel=lambda: True)
        return True

    assert placements.with_depsgraph(action)


@pytest.mark.parametrize("name", ["objects", "nested", "faces", "nodes", "particles"])
def test_without_geometry_sets_instances_are_expanded(scene, monkeypatch, name):
    """As in Blender before 4.5."""
    from blender_addon.sync import expanded
    from blender_addon.sync.geometry import GeometrySync

    monkeypatch.setattr(expanded, "has_geometry_sets", lambda: False)
    monkeypatch.setattr(GeometrySync, "geometry_set", lambda self, ob: None)
    if name == "objects":
        test_shared_mesh_is_one_group(scene)
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
