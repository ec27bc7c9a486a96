"""PointMR's own instancer: what it places, what it keeps from being expanded, and its conversion."""

from __future__ import annotations

import time

import bpy
import builders as b
import numpy as np
import placements
import pytest
from mathutils import Euler, Matrix, Quaternion

import blender_addon
from blender_addon import sync
from pointmr_engine.scene import group as groups


@pytest.fixture
def scene():
    blender_addon.register()
    yield b.empty_scene()
    blender_addon.unregister()


def export():
    """(engine scene, messages, what ours shows, what Blender shows)."""

    def action(depsgraph):
        said = []
        result = sync.export(depsgraph, report=lambda level, text: said.append((level, text)))
        return result, said, placements.by_engine(result.root), placements.by_blender(depsgraph)

    return placements.with_depsgraph(action)


def place(name: str, source, on: str = "ORIGIN", data=None, to=None, **values):
    """An object that is a PointMR instancer."""
    ob = b.add(name, data, to, **values)
    ob.pointmr.instance_collection, ob.pointmr.instance_on = source, on
    return ob


def points(name: str, positions, **attributes) -> bpy.types.Mesh:
    """A mesh of points with attributes given as (type, values)."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(positions, [], [])
    for key, (kind, values) in attributes.items():
        prop = "vector" if kind == "FLOAT_VECTOR" else "value"
        mesh.attributes.new(key, kind, "POINT").data.foreach_set(prop, np.array(values).ravel())
    return mesh


def matrices(shown) -> np.ndarray:
    """(N, 4, 4), sorted by place."""
    m = np.array([s.matrix for s in shown])
    return m[np.lexsort(np.round(m[:, :3, 3], 3).T)]


def test_origin_is_like_a_collection_instance(scene):
    c, inner = b.collection("c"), b.collection("inner")
    c.instance_offset = (1, 2, 3)
    b.add("a", b.polygon("p", 4), c, location=(0, 0, 1), rotation_euler=(0.3, 0, 0))
    b.add("hidden", b.polygon("p", 5), c, hide_render=True)
    b.add("b", b.polygon("p", 6), inner)
    place("in c", inner, to=c, location=(5, 0, 0))
    b.instance_of("native in c", inner, location=(7, 0, 0))
    for i in range(3):
        place(f"e{i}", c, location=(0, 9 * i, 0), scale=(-1, 2, 1))
    _, _, ours, theirs = export()
    assert len(theirs) == 1  # what Blender expands: the native one only
    for ob in list(bpy.data.objects):
        if ob.pointmr.instance_collection:
            ob.instance_type, ob.instance_collection = "COLLECTION", ob.pointmr.instance_collection
            ob.pointmr.instance_collection = None
    _, _, _, native = export()
    assert placements.differences(ours, native) == "" and len(ours) == 1 + 3 * 2


def test_points_with_rotation_scale_and_index(scene):
    c = b.collection("c")
    b.add("a", b.polygon("p", 4), c, location=(1, 0, 0))
    b.add("b", b.polygon("p", 5), c, location=(0, 1, 0))
    positions = [(0, 0, 0), (10, 0, 0), (20, 0, 0), (30, 0, 0)]
    turns = [Quaternion((0.9, 0.1 * i, 0.3, 0.1)).normalized() for i in range(4)]
    sizes = [(1, 1, 1), (2, 2, 2), (1, 2, 3), (-1, 1, 1)]
    mesh = points(
        "m", positions,
        rotation=("QUATERNION", [q[:] for q in turns]),
        scale=("FLOAT_VECTOR", sizes),
        index=("INT", [0, 1, -1, 0]),
    )  # fmt: skip
    world = Matrix.LocRotScale((1, 2, 3), Euler((0.1, 0.2, 0.3)), (1, 1, 2))
    ob = place("o", c, "POINTS", mesh)
    ob.matrix_world = world
    _, said, ours, _ = export()
    assert not said

    def at(i, local=None):
        frame = world @ Matrix.LocRotScale(positions[i], turns[i], sizes[i])
        return np.array(frame if local is None else frame @ Matrix.Translation(local))

    expected = [(2, at(0)), (3, at(1)), (2, at(2, (1, 0, 0))), (3, at(2, (0, 1, 0))), (2, at(3))]
    wanted = [placements.Shown(n, m, 0, 0, 0) for n, m in expected]
    assert placements.differences(ours, wanted) == ""
    ob.pointmr.reset_children = False
    _, _, ours, _ = export()
    expected[0], expected[1], expected[4] = (
        (2, at(0, (1, 0, 0))),
        (3, at(1, (0, 1, 0))),
        (2, at(3, (1, 0, 0))),
    )
    assert placements.differences(ours, [placements.Shown(n, m, 0, 0, 0) for n, m in expected]) == ""


def test_euler_rotation_and_single_scale(scene):
    c = b.collection("c")
    b.add("a", b.polygon("p"), c)
    angles = [(0.1, 0.7, -0.4), (1, 2, 3)]
    mesh = points("m", [(0, 0, 0), (5, 0, 0)], rotation=("FLOAT_VECTOR", angles), scale=("FLOAT", [2, 3]))
    place("o", c, "POINTS", mesh)
    _, _, ours, _ = export()
    for got, place_x, angle, size in zip(matrices(ours), (0, 5), angles, (2, 3), strict=True):
        assert np.allclose(got, Matrix.LocRotScale((place_x, 0, 0), Euler(angle), (size,) * 3), atol=1e-5)


def test_normals_turn_instances(scene):
    c = b.collection("c")
    b.add("a", b.polygon("p"), c)
    ob = place("o", c, "POINTS", b.bumpy("m"), show_instancer_for_render=False)
    ob.pointmr.rotation_from = "NORMAL"
    _, _, ours, _ = export()
    assert len(ours) == 16
    normals = {tuple(np.round(v.co[:2])): v.normal[:] for v in ob.data.vertices}
    for s in ours:
        assert np.allclose(s.matrix[:3, 2], normals[tuple(np.round(s.matrix[:2, 3]))], atol=1e-4)


def test_points_of_evaluated_geometry(scene):
    """Modifiers of the instancer and of what it places are applied."""
    c = b.collection("c")
    b.add("a", b.bumpy("p", 1), c).modifiers.new("s", "SUBSURF").render_levels = 1
    ob = place("o", c, "POINTS", points("m", [(0, 0, 0)]))
    array = ob.modifiers.new("a", "ARRAY")
    array.count, array.use_relative_offset, array.use_constant_offset = 5, False, True
    array.constant_offset_displace = (3, 0, 0)
    _, _, ours, _ = export()
    assert matrices(ours)[:, 0, 3].tolist() == [0, 3, 6, 9, 12]
    assert {s.triangles for s in ours} == {8}


def test_shown_with_its_own_geometry_only_if_asked(scene):
    c = b.collection("c")
    b.add("a", b.polygon("p", 4), c)
    ob = place("o", c, "POINTS", b.polygon("q", 5))
    assert sorted(s.triangles for s in export()[2]) == [2] * 5 + [3]
    ob.show_instancer_for_render = False
    assert sorted(s.triangles for s in export()[2]) == [2] * 5


def test_deep_nesting_is_never_expanded(scene):
    """Five levels of a hundred: 10^10 placements, of which Blender and the sync see 500."""
    below = b.collection("leaf")
    b.add("leaf", b.polygon("p", 4), below)
    for level in range(5):
        c = b.collection(f"level {level}")
        x, y = np.meshgrid(np.arange(10), np.arange(10))
        grid = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1) * 2.0 * 10.0**level
        place(f"points {level}", below, "POINTS", points("m", grid.tolist()), to=c)
        below = c
    place("top", below)
    start = time.process_time()
    result = placements.with_depsgraph(sync.export)
    assert time.process_time() - start < 10
    unique, instanced, _ = groups.count_triangles(result.root)
    assert (unique, instanced) == (2, 2 * 10**10)


def test_a_million_points(scene):
    c = b.collection("c")
    b.add("a", b.polygon("p"), c)
    mesh = bpy.data.meshes.new("m")
    mesh.vertices.add(1_000_000)
    mesh.attributes.new("rotation", "QUATERNION", "POINT")
    place("o", c, "POINTS", mesh)
    result = placements.with_depsgraph(sync.export)
    assert groups.count_triangles(result.root)[1] == 2_000_000


def test_cycles_are_named_and_left_out(scene):
    a, c = b.collection("a"), b.collection("c")
    b.add("in a", b.polygon("p", 4), a)
    b.add("in c", b.polygon("p", 5), c)
    place("a places c", c, to=a, location=(1, 0, 0))
    place("c places a", a, to=c, location=(2, 0, 0))
    place("top", a)
    result, said, ours, _ = export()
    groups.unique_groups(result.root)
    assert sorted(s.triangles for s in ours) == [2, 3]
    (text,) = [t for level, t in said if "instances itself" in t]
    assert "'a'" in text and "a -> a places c -> c -> c places a -> a" in text


def test_bad_points_are_named(scene):
    c = b.collection("c")
    b.add("a", b.polygon("p"), c)
    mesh = points("m", [(0, 0, 0), (float("nan"), 0, 0), (2, 0, 0)], scale=("FLOAT", [1, 1, 0]))
    place("o", c, "POINTS", mesh)
    place("empty points", c, "POINTS")
    wrong = points("m", [(9, 0, 0)], rotation=("FLOAT", [1]), index=("INT", [7]))
    place("wrong", c, "POINTS", wrong)
    _, said, ours, _ = export()
    text = "\n".join(t for _, t in said)
    assert matrices(ours)[:, 0, 3].tolist() == [0, 9]
    assert "2 placements have a singular or non-finite matrix" in text
    assert "'empty points': it has no points" in text
    assert "'rotation' must be" in text and "1 points ask for children" in text


def test_lamps_in_pointmr_instances(scene):
    c = b.collection("c")
    b.add("lamp", bpy.data.lights.new("l", "POINT"), c, location=(0, 0, 1))
    place("o", c, "POINTS", points("m", [(0, 0, 0), (5, 0, 0)]), location=(0, 1, 0))
    result, _, _, _ = export()
    assert sorted(tuple(x.world_from_light[:3, 3]) for x in result.lights) == [(0, 1, 1), (5, 1, 1)]


def test_edits_reach_the_viewport_at_once(scene):
    """A collection that no scene shows is evaluated as soon as it is chosen; so are edits of the settings."""
    c, other = b.collection("c"), b.collection("other")
    b.add("a", b.polygon("p", 4), c)
    b.add("b", b.polygon("p", 5), other).modifiers.new("s", "SUBSURF").levels = 1
    ob = b.add("o", points("m", [(0, 0, 0), (1, 0, 0)]))

    def shown():
        result = sync.export(bpy.context.evaluated_depsgraph_get())
        return sorted(s.triangles for s in placements.by_engine(result.root))

    assert shown() == []
    ob.pointmr.instance_collection = c
    assert shown() == [2]
    ob.pointmr.instance_collection = other
    assert shown() == [10]
    ob.pointmr.instance_on = "POINTS"
    assert shown() == [10, 10]


# Conversion


def convert(operator, ob):
    bpy.context.view_layer.update()
    with bpy.context.temp_override(object=ob, active_object=ob, selected_objects=[ob]):
        return operator()


def both_ways(ob):
    """Convert to PointMR's instancer and back, comparing what is shown; returns what it is in between."""
    _, _, _, native = export()
    names = set(bpy.data.objects.keys())
    assert convert(bpy.ops.pointmr.instancer_from_native, ob) == {"FINISHED"}
    made = [o for o in bpy.data.objects if o.name not in names]
    middle = made[0] if made else ob
    _, said, ours, expanded = export()
    assert placements.differences(ours, native, 1e-3) == ""
    assert len(expanded) < len(native)
    assert convert(bpy.ops.pointmr.instancer_to_native, middle) == {"FINISHED"}
    _, _, ours, again = export()
    assert placements.differences(again, native) == "" and placements.differences(ours, native) == ""
    assert set(bpy.data.objects.keys()) == names


def test_convert_collection_instance(scene):
    c = b.collection("c")
    c.instance_offset = (1, 0, 0)
    b.add("a", b.polygon("p", 4), c)
    both_ways(b.instance_of("e", c, location=(0, 0, 3), scale=(1, 2, 1)))


@pytest.mark.parametrize("kind", ["VERTS", "FACES"])
@pytest.mark.parametrize("turn", [False, True])
def test_convert_vertex_and_face_instances(scene, kind, turn):
    ob = b.add("points", b.bumpy("m"), location=(1, 2, 3), rotation_euler=(0.3, 0, 1), instance_type=kind)
    ob.use_instance_vertices_rotation = ob.use_instance_faces_scale = turn
    for i in range(2):
        b.add(f"child{i}", b.polygon("p", 5 + i), location=(i, 0, 1), rotation_euler=(0.5, 0, 0)).parent = ob
    both_ways(ob)


def test_convert_geometry_nodes(scene):
    source = b.add("source", b.polygon("p", 5), location=(3, 3, 3))
    c = b.collection("c")
    b.add("in c", b.polygon("p", 6), c, location=(0, 0, 1))
    b.add("in c too", b.polygon("p", 7), c)

    def build(tree, start, end):
        turn = b.random_vector(tree, (0, 0, 0), (3, 3, 3))
        size = b.random_vector(tree, (-1, 0.5, 0.5), (-0.5, 2, 2))
        one = b.scatter(tree, start, b.object_info(tree, source), Rotation=turn, Scale=size)
        two = b.scatter(tree, start, b.collection_info(tree, c), Rotation=turn)
        tree.links.new(b.join(tree, one, two), end)

    ob = b.add("gn", b.bumpy("m"), location=(0, 1, 2))
    ob.show_instancer_for_render = False
    b.nodes_on(ob, b.node_group("tree", build))
    both_ways(ob)


def test_convert_own_points_to_nodes_and_back(scene):
    c = b.collection("c")
    b.add("a", b.polygon("p", 5), c, location=(1, 0, 0))
    b.add("b", b.polygon("p", 6), c)
    mesh = points(
        "m", [(0, 0, 0), (5, 0, 0), (9, 0, 0)],
        rotation=("FLOAT_VECTOR", [(0, 0, 1), (1, 0, 0), (0.2, 1, 0)]),
        scale=("FLOAT", [1, 2, 3]),
        index=("INT", [0, 1, 0]),
    )  # fmt: skip
    ob = place("o", c, "POINTS", mesh)
    _, _, ours, _ = export()
    assert convert(bpy.ops.pointmr.instancer_to_native, ob) == {"FINISHED"}
    _, _, again, native = export()
    assert len(native) == 3
    assert placements.differences(again, native) == "" and placements.differences(ours, native) == ""
    assert convert(bpy.ops.pointmr.instancer_from_native, ob) == {"FINISHED"}
    _, _, again, native = export()
    assert native == [] and placements.differences(again, ours) == ""


def test_what_cannot_be_converted_says_why(scene):
    def build(tree, start, end):
        cube = tree.nodes.new("GeometryNodeMeshCube").outputs[0]
        tree.links.new(b.scatter(tree, start, cube), end)

    ob = b.add("gn", b.bumpy("m"))
    b.nodes_on(ob, b.node_group("tree", build))
    with pytest.raises(RuntimeError, match="'gn' is not converted: its nodes instance geometry"):
        convert(bpy.ops.pointmr.instancer_from_native, ob)
    plain = b.add("plain", b.bumpy("m"))
    with pytest.raises(RuntimeError, match="makes no instances"):
        convert(bpy.ops.pointmr.instancer_from_native, plain)
    with pytest.raises(RuntimeError, match="no PointMR instancer"):
        convert(bpy.ops.pointmr.instancer_to_native, plain)


# Viewport


def test_bounds(scene):
    """Boxes around what is placed, nested instancers included."""
    from blender_addon.instancer import bounds

    leaf, tree = b.collection("leaf"), b.collection("tree")
    b.add("a", b.bumpy("p", 2), leaf, location=(0, 0, 1))
    place("in tree", leaf, "POINTS", points("m", [(0, 0, 0), (10, 0, 0)]), to=tree)
    ob = place("o", tree, location=(0, 0, 100))
    bpy.context.view_layer.update()
    lines = bounds.box_lines(bpy.context.evaluated_depsgraph_get(), [ob])
    assert lines.shape == (24, 3) and lines.dtype == np.float32
    assert np.allclose(lines.min(0)[:2], (0, 0)) and np.allclose(lines.max(0)[:2], (12, 2))
    assert 100.4 < lines[:, 2].min() < lines[:, 2].max() < 101.6
