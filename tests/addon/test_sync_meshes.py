"""Meshes and their attributes: arrays in the engine's layout, with Blender's values."""

from __future__ import annotations

import bpy
import builders as b
import numpy as np
import placements
import pytest

from blender_addon import sync
from pointmr_engine.scene.group import unique_groups
from pointmr_engine.scene.mesh import GENERATED


@pytest.fixture
def scene():
    return b.empty_scene()


def export_meshes(**options):
    """(meshes by object name, messages)."""
    said = []
    result = placements.with_depsgraph(
        lambda d: sync.export(d, report=lambda level, text: said.append((level, text)), **options)
    )
    meshes = {m.name.split("/")[0]: m for g in unique_groups(result.root) for m in g.meshes}
    for m in meshes.values():
        m.validate()
    return meshes, said


def material(name: str, *nodes) -> bpy.types.Material:
    """A material with nodes given as (type, {property: value})."""
    m = bpy.data.materials.new(name)
    if m.node_tree is None:
        m.use_nodes = True
    for kind, values in nodes:
        node = m.node_tree.nodes.new(kind)
        for key, value in values.items():
            setattr(node, key, value)
    return m


def test_triangles_of_polygons(scene):
    b.add("o", b.polygon("five", 5))
    meshes, _ = export_meshes()
    m = meshes["o"]
    assert (m.positions.dtype, m.triangles.dtype, m.triangles.shape) == (np.float32, np.int32, (3, 3))
    p = m.positions[m.triangles].astype(float)
    area = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum()
    assert area == pytest.approx(5 / 2 * np.sin(2 * np.pi / 5), rel=1e-6)


def test_normals_flat_smooth_and_mixed(scene):
    for name in ("flat", "smooth", "mixed"):
        mesh = b.bumpy(name)
        for i, face in enumerate(mesh.polygons):
            face.use_smooth = name == "smooth" or (name == "mixed" and i % 2 == 0)
        b.add(name, mesh)
    meshes, _ = export_meshes()
    assert meshes["flat"].normals is None
    assert meshes["smooth"].normals.shape == (16, 3)
    m = meshes["mixed"]
    assert m.normals.shape == (18, 3, 3)
    assert np.allclose(np.linalg.norm(m.normals, axis=2), 1, atol=1e-5)
    p = m.positions[m.triangles]
    across = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    flat = np.abs(m.normals - across[:, None]).max((1, 2)) < 1e-6
    assert flat.sum() == 2 * 4  # the odd ones of nine quads


def test_terminator_offsets_are_the_objects(scene):
    """Objects that share a mesh share its arrays, whatever their offsets."""
    mesh = b.bumpy("shared")
    for name, offset in (("a", None), ("b", 0.0), ("c", 0.4)):
        ob = b.add(name, mesh)
        if offset is not None:
            ob.shadow_terminator_geometry_offset = offset
    result = placements.with_depsgraph(lambda d: sync.export(d))
    meshes = [m for g in unique_groups(result.root) for m in g.meshes]
    assert sorted(m.terminator_offset for m in meshes) == pytest.approx([0.0, 0.1, 0.4])
    assert len({id(m.positions) for m in meshes}) == 1


def test_material_slots_and_indices(scene):
    mesh = b.bumpy("m", 2)
    for name in ("one", "two"):
        mesh.materials.append(material(name))
    for face, index in zip(mesh.polygons, (0, 1, 1, 0), strict=True):
        face.material_index = index
    b.add("a", mesh)
    own = b.add("b", mesh)
    own.material_slots[1].link, own.material_slots[1].material = "OBJECT", material("three")
    too_few = mesh.copy()
    too_few.materials.pop()
    b.add("c", too_few)
    b.add("d", b.polygon("bare"))
    result = placements.with_depsgraph(sync.export)
    pair = [m for g in unique_groups(result.root) for m in g.meshes if len(m.triangles) == 8]
    assert {tuple(x.name for x in m.materials) for m in pair} == {("one", "two"), ("one", "three"), ("one",)}
    a = next(m for m in pair if m.materials[-1].name == "two")
    assert a.material_index.tolist() == [0, 0, 1, 1, 1, 1, 0, 0]
    meshes, _ = export_meshes()
    c = meshes["c"]
    assert c.material_index is None or c.material_index.max() < len(c.materials)
    assert len(meshes["d"].materials) == 1 and meshes["d"].material_index is None


def test_material_override(scene):
    mesh = b.bumpy("m", 2)
    mesh.materials.append(material("one"))
    b.add("a", mesh)
    scene.view_layers[0].material_override = material("clay")
    meshes, _ = export_meshes()
    assert [m.name for m in meshes["a"].materials] == ["clay"]


def test_uv_layers(scene):
    mesh = b.bumpy("m", 2)
    for name in ("first", "second", "unused"):
        layer = mesh.uv_layers.new(name=name)
        layer.uv.foreach_set("vector", np.arange(32, dtype=np.float32) + len(name))
    mesh.uv_layers["second"].active_render = True
    mesh.materials.append(material("m", ("ShaderNodeUVMap", {"uv_map": "first"})))
    b.add("o", mesh)
    meshes, _ = export_meshes()
    m = meshes["o"]
    assert m.active_uv == "second" and set(m.uvs) == {"first", "second"}
    mesh.calc_loop_triangles()
    loops = np.array([t.loops[:] for t in mesh.loop_triangles])
    assert np.array_equal(m.uvs["second"], (2 * loops[..., None] + [0, 1] + 6).astype(np.float32))


@pytest.mark.parametrize(
    ("kind", "domain", "channels"),
    [
        ("FLOAT", "POINT", 1),
        ("INT", "FACE", 1),
        ("BOOLEAN", "FACE", 1),
        ("FLOAT2", "CORNER", 2),
        ("FLOAT_VECTOR", "POINT", 3),
        ("FLOAT_COLOR", "CORNER", 4),
    ],
)
def test_attributes_that_materials_read(scene, kind, domain, channels):
    mesh = b.bumpy("m", 2)
    attribute = mesh.attributes.new("mine", kind, domain)
    n = len(attribute.data)
    from blender_addon.sync.attributes import LAYOUTS

    _, prop, dtype = LAYOUTS[kind]
    values = (np.arange(n * channels) % 7).astype(dtype)
    attribute.data.foreach_set(prop, values)
    mesh.attributes.new("not asked for", "FLOAT", "POINT")
    mesh.materials.append(material("m", ("ShaderNodeAttribute", {"attribute_name": "mine"})))
    b.add("o", mesh)
    meshes, _ = export_meshes()
    m = meshes["o"]
    assert (
        set(m.attributes) == ({"mine"} if kind != "FLOAT2" else set()) and "not asked for" not in m.attributes
    )
    if kind == "FLOAT2":  # a UV layer is such an attribute
        assert m.uvs["mine"].shape == (8, 3, 2)
        return
    a = m.attributes["mine"]
    assert a.values.dtype == np.float32
    values = values.reshape(n, channels).astype(np.float32)
    mesh.calc_loop_triangles()
    if domain == "POINT":
        assert a.domain == "vertex" and np.array_equal(a.values, values)
    elif domain == "CORNER":
        loops = np.array([t.loops[:] for t in mesh.loop_triangles]).ravel()
        assert a.domain == "corner" and np.array_equal(a.values, values[loops])
    else:
        faces = np.array([t.polygon_index for t in mesh.loop_triangles])
        assert a.domain == "face" and np.array_equal(a.values, values[faces])


def test_byte_colors_are_linear_and_the_active_one_is_known(scene):
    mesh = b.bumpy("m", 2)
    attribute = mesh.color_attributes.new("Col", "BYTE_COLOR", "POINT")
    for element in attribute.data:
        element.color_srgb = (0.5, 1, 0, 1)
    mesh.materials.append(material("m", ("ShaderNodeVertexColor", {})))
    b.add("o", mesh)
    meshes, _ = export_meshes()
    values = meshes["o"].attributes[""].values
    assert np.allclose(values, [((0.5 + 0.055) / 1.055) ** 2.4, 1, 0, 1], atol=4e-3)


def test_attributes_that_cannot_be_read_are_named(scene):
    mesh = b.bumpy("m", 2)
    mesh.attributes.new("rim", "FLOAT", "EDGE")
    mesh.materials.append(material("m", ("ShaderNodeAttribute", {"attribute_name": "rim"})))
    b.add("o", mesh)
    _, said = export_meshes()
    assert any("'o'" in text and "'rim'" in text for level, text in said if level == "WARNING")


def test_generated_coordinates(scene):
    """The texture space's box; of a deformed mesh, where its vertices were before."""
    for name, deform in (("still", False), ("bent", True)):
        mesh = b.bumpy(name, 2)
        mesh.materials.append(material("m", ("ShaderNodeTexNoise", {})))
        ob = b.add(name, mesh)
        if deform:
            ob.modifiers.new("bend", "SIMPLE_DEFORM").angle = 1
    meshes, _ = export_meshes()
    box = meshes["still"].generated
    assert np.allclose(box, [meshes["still"].positions.min(0), meshes["still"].positions.max(0)], atol=1e-5)
    assert GENERATED not in meshes["still"].attributes
    rest = meshes["bent"].attributes[GENERATED].values
    still = meshes["still"].positions
    assert rest.shape == (9, 3)
    assert np.allclose(rest, (still - box[0]) / (box[1] - box[0]), atol=1e-5)


def test_texture_space_set_by_hand(scene):
    mesh = b.bumpy("m")
    mesh.use_auto_texspace = False
    mesh.texspace_location, mesh.texspace_size = (1, 2, 3), (4, 5, 6)
    b.add("o", mesh)
    meshes, _ = export_meshes()
    assert np.allclose(meshes["o"].generated, [[-3, -3, -3], [5, 7, 9]])


def test_modifiers_are_applied(scene):
    ob = b.add("o", b.bumpy("m", 2))
    ob.modifiers.new("s", "SUBSURF").render_levels = 2
    ob.modifiers["s"].levels = 0
    other = b.add("p", ob.data)
    meshes, _ = export_meshes()
    assert len(meshes["o"].triangles) == 2 * 4 * 16 and len(meshes["p"].triangles) == 8
    assert other.data is ob.data


def test_bad_meshes_are_named_and_the_rest_is_rendered(scene):
    nan = b.bumpy("nan")
    nan.vertices[5].co.x = float("nan")
    b.add("broken", nan)
    b.add("nothing", bpy.data.meshes.new("nothing"))
    line = bpy.data.meshes.new("line")
    line.from_pydata([(0, 0, 0), (1, 0, 0)], [(0, 1)], [])
    b.add("line", line)
    b.add("no data volume", bpy.data.volumes.new("v"))
    b.add("good", b.polygon("p"))
    meshes, said = export_meshes()
    assert set(meshes) == {"broken", "good"}
    warnings = {level: [t for lv, t in said if lv == level] for level, _ in said}
    text = "\n".join(warnings["WARNING"])
    for part in ("'broken'", "vertex 5 is not finite", "'nothing'", "'line'", "volumes are not supported"):
        assert part in text
    assert "ERROR" not in warnings


def test_viewport_depsgraph_uses_viewport_settings(scene):
    ob = b.add("o", b.bumpy("m", 2))
    ob.modifiers.new("s", "SUBSURF").levels = 1
    ob.modifiers["s"].render_levels = 2
    b.add("hidden", b.polygon("p", 5), hide_viewport=True)
    b.add("eye", b.polygon("p", 6)).hide_set(True)
    b.add("shown", b.polygon("p", 7), hide_render=True)
    result = sync.export(bpy.context.evaluated_depsgraph_get())
    counts = sorted(len(m.triangles) for g in unique_groups(result.root) for m in g.meshes)
    assert counts == [5, 2 * 4 * 4]
