"""Materials, images, worlds and lights of Blender as the engine gets them."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
sys.path.insert(0, str(Path(__file__).parent))

import node_planes  # noqa: E402

from blender_addon.sync.images import ImageSync  # noqa: E402
from blender_addon.sync.materials import MaterialSync  # noqa: E402
from pointmr_engine.scene.graph import Link  # noqa: E402
from pointmr_engine.shading.leaves import COLUMNS  # noqa: E402
from pointmr_engine.shading.points import SurfacePoints, add_missing_layers  # noqa: E402
from pointmr_engine.shading.program import compile_graph  # noqa: E402


@pytest.fixture
def empty():
    bpy.ops.wm.read_factory_settings(use_empty=True)


@pytest.fixture
def sync(empty):
    reports = []
    found = MaterialSync(lambda level, message: reports.append((level, message)))
    found.reports = reports
    return found


def material(name="Material"):
    found = bpy.data.materials.new(name)
    return found


def nodes_of(found):
    tree = found.node_tree
    return tree, tree.nodes, tree.links


def test_materials_are_translated_once(sync):
    m = material()
    m.pass_index = 5
    m.cycles.emission_sampling = "FRONT"
    first = sync.get(m)
    assert sync.get(m) is first and first.pass_index == 5 and first.emission_sampling == "FRONT"
    assert sync.get(None) is sync.get(None)
    leaf = compile_graph(sync.get(None).graph).evaluate(SurfacePoints(1))[0]
    grey = COLUMNS[leaf.kind].index("base_color_r") if bpy.app.version >= (5, 0, 0) else 0
    assert leaf.block[0, grey : grey + 3] == pytest.approx(0.8)


def test_the_output_that_cycles_shows_is_used(sync):
    m = material()
    tree, nodes, links = nodes_of(m)
    for target, strength, active in (("EEVEE", 1.0, True), ("CYCLES", 2.0, False), ("ALL", 3.0, True)):
        output, emission = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeEmission")
        output.target, output.is_active_output = target, active
        emission.inputs["Strength"].default_value = strength
        links.new(emission.outputs[0], output.inputs[0])
    expected = tree.get_output_node("CYCLES").inputs[0].links[0].from_node.inputs["Strength"].default_value
    assert compile_graph(sync.get(m).graph).constant_emission == pytest.approx((expected,) * 3)


def test_unsupported_nodes_are_named_once(sync):
    m = material("Brass")
    _, nodes, links = nodes_of(m)
    script = nodes.new("ShaderNodeWireframe")
    bsdf = nodes["Principled BSDF"]
    bsdf.inputs["Roughness"].default_value = 0.375
    links.new(script.outputs[0], bsdf.inputs["Roughness"])
    links.new(script.outputs[0], bsdf.inputs["Metallic"])
    graph = sync.get(m).graph
    # the unlinked value is the default
    node = graph.nodes[graph.surface.node]
    assert node.inputs["roughness"] == pytest.approx(0.375)
    assert len(sync.reports) == 1 and "Brass" in sync.reports[0][1] and "Wireframe" in sync.reports[0][1]


def test_nothing_connected_is_black_and_volumes_leave_no_surface(sync):
    m = material()
    _, nodes, links = nodes_of(m)
    nodes.remove(nodes["Principled BSDF"])
    assert compile_graph(sync.get(m).graph).leaves == ()
    fog = material("Fog")
    _, nodes, links = nodes_of(fog)
    nodes.remove(nodes["Principled BSDF"])
    volume = nodes.new("ShaderNodeVolumeScatter")
    links.new(volume.outputs[0], nodes["Material Output"].inputs["Volume"])
    program = compile_graph(sync.get(fog).graph)
    assert program.transparency(SurfacePoints(1)).tolist() == [[1, 1, 1]]
    assert any("Fog" in message and "volume" in message for _, message in sync.reports)


def test_missing_images_are_magenta_and_named(sync):
    m = material("Poster")
    _, nodes, links = nodes_of(m)
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("lost.png", 4, 4)
    texture.image.source = "FILE"
    texture.image.filepath = "//not/there.png"
    links.new(texture.outputs[0], nodes["Principled BSDF"].inputs["Base Color"])
    program = compile_graph(sync.get(m).graph)
    points = SurfacePoints(
        1, uvs={"": np.zeros((1, 2), np.float32)}, uv_footprints={"": np.zeros(1, np.float32)}
    )
    assert program.evaluate(points)[0].block[0, 3:6].tolist() == [1, 0, 1]
    assert any("lost.png" in message and "there.png" in message for _, message in sync.reports)


def test_images_keep_bytes_and_floats(empty, tmp_path):
    sync = ImageSync(lambda level, message: pytest.fail(message))
    rng = np.random.default_rng(1)
    byte = bpy.data.images.new("byte", 5, 3, alpha=True)
    values = rng.integers(0, 256, (3, 5, 4)).astype(np.float32)
    byte.pixels.foreach_set((values / 255).ravel())
    found = sync.get(byte)
    assert found.pixels.dtype == np.uint8 and np.array_equal(found.pixels, values.astype(np.uint8))
    assert found.colorspace == "sRGB" and found.alpha == "STRAIGHT" and sync.get(byte) is found
    wide = bpy.data.images.new("float", 5, 3, float_buffer=True)
    wide.pixels.foreach_set((rng.random((3, 5, 4)) * 10).astype(np.float32).ravel())
    found = sync.get(wide)
    assert found.pixels.dtype == np.float32 and found.pixels.max() > 5 and found.colorspace == "Linear"
    data = bpy.data.images.new("data", 4, 4)
    data.colorspace_settings.name = "Non-Color"
    assert sync.get(data).colorspace == "Non-Color"
    generated = bpy.data.images.new("grid", 64, 64)
    generated.generated_type = "COLOR_GRID"
    assert sync.get(generated).pixels.std() > 10


def test_images_of_files_are_read_and_let_go(empty, tmp_path):
    made = bpy.data.images.new("made", 6, 4)
    values = np.linspace(0, 1, 96, dtype=np.float32)
    values[3::4] = 1
    made.pixels.foreach_set(values)
    made.filepath_raw, made.file_format = str(tmp_path / "made.png"), "PNG"
    made.save()
    loaded = bpy.data.images.load(str(tmp_path / "made.png"))
    found = ImageSync(lambda level, message: pytest.fail(message)).get(loaded)
    assert found.pixels.shape == (4, 6, 4) and found.pixels[0, 1, 2] == round(255 * 6 / 95)
    assert not loaded.has_data


def test_worlds_and_plain_worlds(sync):
    world = bpy.data.worlds.new("World")
    background = next(n for n in world.node_tree.nodes if n.bl_idname == "ShaderNodeBackground")
    background.inputs["Color"].default_value = (0.1, 0.2, 0.3, 1)
    background.inputs["Strength"].default_value = 2
    program = compile_graph(sync.world_graph(world), "background")
    assert program.constant_emission == pytest.approx((0.2, 0.4, 0.6))
    assert sync.world_graph(None).surface is None


def test_light_graphs_only_where_they_matter(sync):
    light = bpy.data.lights.new("lamp", "POINT")
    light.use_nodes = True
    assert sync.light_graph(light) is None
    _, nodes, links = nodes_of(light)
    falloff = nodes.new("ShaderNodeLightFalloff")
    falloff.inputs["Strength"].default_value = 2
    falloff.inputs["Smooth"].default_value = 4
    links.new(falloff.outputs["Linear"], nodes["Emission"].inputs["Strength"])
    program = compile_graph(sync.light_graph(light), "light")
    assert program.needs == {"ray_length"}
    lengths = np.array([1.0, 2.0], np.float32)
    found = program.emission(SurfacePoints(2, ray_length=lengths))[:, 0]
    assert found == pytest.approx(2 * lengths * lengths**2 / (4 + lengths**2))


def test_quadratic_falloff_is_a_strength(sync):
    """It is the inverse-square law, as lamps have it: a constant, but where it is smoothed."""
    light = bpy.data.lights.new("lamp", "POINT")
    light.use_nodes = True
    _, nodes, links = nodes_of(light)
    falloff = nodes.new("ShaderNodeLightFalloff")
    falloff.inputs["Strength"].default_value = 2.5
    links.new(falloff.outputs["Quadratic"], nodes["Emission"].inputs["Strength"])
    assert compile_graph(sync.light_graph(light), "light").constant_emission == pytest.approx((2.5,) * 3)
    falloff.inputs["Smooth"].default_value = 1.0
    assert compile_graph(sync.light_graph(light), "light").constant_emission is None


def test_conductors_by_index_become_tints(sync):
    m = material()
    _, nodes, links = nodes_of(m)
    metal = nodes.new("ShaderNodeBsdfMetallic")
    metal.fresnel_type = "PHYSICAL_CONDUCTOR"
    links.new(metal.outputs[0], nodes["Material Output"].inputs[0])
    n, k = (
        np.array(next(s for s in metal.inputs if s.identifier == i).default_value)
        for i in ("IOR", "Extinction")
    )
    (leaf,) = compile_graph(sync.get(m).graph).evaluate(SurfacePoints(1))
    expected = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    assert leaf.block[0, 3:6] == pytest.approx(expected, rel=1e-4)


ALL_NODES = sorted(
    n for n in dir(bpy.types) if n.startswith("ShaderNode") and hasattr(getattr(bpy.types, n), "bl_rna")
)


@pytest.mark.parametrize("kind", ALL_NODES)
def test_no_node_stops_a_material(sync, kind):
    """Every kind of node that Blender can add, as it comes, on a colour or as the surface."""
    objects = node_planes.build({"any": lambda tree: tree.node("RGB").outputs[0]})
    m = objects["any"].data.materials[0]
    _, nodes, links = nodes_of(m)
    try:
        node = nodes.new(kind)
    except RuntimeError:
        pytest.skip(f"{kind} is not a node that can be added")
    emission = next(n for n in nodes if n.bl_idname == "ShaderNodeEmission")
    output = next(n for n in nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    for socket in node.outputs:
        links.new(socket, output.inputs[0] if socket.type == "SHADER" else emission.inputs[0])
        program = compile_graph(sync.get(m).graph)
        points = node_planes.points_of(objects["any"])
        add_missing_layers(points, program.needs)  # of strands
        for leaf in program.evaluate(points):
            assert np.isfinite(leaf.block).all() and len(leaf.block) in (1, points.count)
        assert np.isfinite(program.emission(points)).all() and np.isfinite(program.transparency(points)).all()
        sync._materials.clear()
    assert not [text for level, text in sync.reports if level == "ERROR"]


@pytest.mark.skipif(
    not hasattr(bpy.types, "InlineShaderNodes"), reason="zones of shader nodes came with Blender 5"
)
def test_repeat_zones_are_unrolled(sync):
    m = material()
    _, nodes, links = nodes_of(m)
    first, last = nodes.new("GeometryNodeRepeatInput"), nodes.new("GeometryNodeRepeatOutput")
    first.pair_with_output(last)
    last.repeat_items.clear()
    last.repeat_items.new("FLOAT", "x")
    first.inputs["Iterations"].default_value = 4
    first.inputs["x"].default_value = 0.2
    add = nodes.new("ShaderNodeMath")
    add.inputs[1].default_value = 0.1
    links.new(first.outputs["x"], add.inputs[0])
    links.new(add.outputs[0], last.inputs["x"])
    links.new(last.outputs["x"], nodes["Principled BSDF"].inputs["Roughness"])
    (leaf,) = compile_graph(sync.get(m).graph).evaluate(SurfacePoints(1))
    assert leaf.block[0, 7] == pytest.approx(0.6)


def test_a_broken_tree_is_reported_and_the_rest_renders(sync, monkeypatch):
    monkeypatch.setattr("blender_addon.sync.materials.translate", lambda *a: 1 / 0)
    m = material("Cursed")
    m.diffuse_color = (0.25, 0.5, 0.75, 1)
    graph = sync.get(m).graph
    assert isinstance(graph.surface, Link)
    assert sync.reports[0][0] == "ERROR" and "Cursed" in sync.reports[0][1]


SCENES = os.environ.get("POINTMR_SCENES")
FILES = sorted(Path(SCENES).rglob("*.blend")) if SCENES else []


@pytest.mark.skipif(not SCENES, reason="POINTMR_SCENES is not set: no scenes to read")
@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_every_material_of_real_scenes_compiles(path):
    """No error, and no node that the table does not know but for those of vanished add-ons."""
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
    reports = []
    sync = MaterialSync(lambda level, message: reports.append((level, message)))
    for m in bpy.data.materials:
        program = compile_graph(sync.get(m).graph)
        assert not program.warnings, (m.name, program.warnings)
    for world in bpy.data.worlds:
        assert not compile_graph(sync.world_graph(world), "background").warnings
    assert not [text for level, text in reports if level == "ERROR"]
    assert not [text for _, text in reports if "not supported" in text and "Undefined" not in text]
