"""Instances: what an export shows, and where, is what Blender's own expansion shows."""

from __future__ import annotations

import bpy
import builders as b
import numpy as np
import placements
import pytest
from placements import check, export

from blender_addon import sync
from pointmr_engine.scene import group as groups


@pytest.fixture
def scene():
    return b.empty_scene()


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
    hair.points.foreach_set("position", np.arange(21, dtype=np.float32))  # straight: a piece a segment
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
    assert by_name["curves"] % 16 == 0 and by_name["curves"] >= (2 + 3) * 16
    assert by_name[f"hairy/{ob.particle_systems[0].name}"] >= 12 * 4 * 16
    assert sum(s.name == "cloud" for s in shown) == 7
    assert not [t for level, t in said if level == "ERROR"]


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


def test_cancel_stops_the_export(scene):
    for i in range(50):
        b.add(f"o{i}", b.bumpy("m", 20))

    def action(depsgraph):
        with pytest.raises(sync.Cancelled):
            sync.export(depsgraph, cancel=lambda: True)
        return True

    assert placements.with_depsgraph(action)
