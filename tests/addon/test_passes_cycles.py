"""Every pass laid over Cycles': what is averaged, what comes from the pixel's centre, what exposure and alpha touch."""

import numpy as np
import pytest

from pointmr_engine.image import exr

bpy = pytest.importorskip("bpy")
SIZE = (48, 36)


def material(name: str, color, alpha=1.0, emission=0.0, index=0):
    m = bpy.data.materials.new(name)
    if not m.node_tree:
        m.use_nodes = True
    bsdf = m.node_tree.nodes["Principled BSDF"]
    bsdf.inputs["Base Color"].default_value = (*color, 1.0)
    bsdf.inputs["Alpha"].default_value = alpha
    bsdf.inputs["Emission Color"].default_value = (1.0, 0.5, 0.25, 1.0)
    bsdf.inputs["Emission Strength"].default_value = emission
    bsdf.inputs["Roughness"].default_value = 0.8
    m.pass_index = index
    return m


def build(transparent: bool):
    """Shapes behind each other: opaque, glowing, and two panes, one hardly there, one beyond the alpha threshold."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=12, location=(-1.2, 0, 0), radius=1.0)
    bpy.context.object.data.shade_smooth()
    bpy.context.object.data.materials.append(material("red", (0.8, 0.1, 0.1), index=3))
    bpy.context.object.pass_index = 1
    bpy.ops.mesh.primitive_cube_add(location=(1.3, 0.4, -0.1), rotation=(0.3, 0.4, 0.5), size=1.3)
    bpy.context.object.data.materials.append(material("glow", (0.2, 0.3, 0.4), emission=1.5, index=4))
    bpy.context.object.pass_index = 2
    for i, (x, alpha) in enumerate(((-1.8, 0.02), (0.9, 0.7))):
        bpy.ops.mesh.primitive_plane_add(location=(x, -2.0, 0.5), rotation=(np.pi / 2, 0, 0.2), size=1.3)
        bpy.context.object.data.materials.append(
            material(f"pane {i}", (0.1, 0.7, 0.2), alpha=alpha, index=5 + i)
        )
        bpy.context.object.pass_index = 3 + i
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (0.3, -8.0, 0.8), (1.48, 0.0, 0.04)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.data.angle, sun.rotation_euler = 2.0, 0.0, (0.6, 0.3, 0.0)
    for ob in (camera, sun):
        scene.collection.objects.link(ob)
    scene.camera = camera
    world = bpy.data.worlds.new("World")
    scene.world = world
    if not world.node_tree:
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.05, 0.1, 0.2, 1.0)
    scene.render.film_transparent = transparent
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100
    layer = bpy.context.view_layer
    for name in ("z", "position", "normal", "object_index", "material_index", "diffuse_color", "emit"):
        setattr(layer, f"use_pass_{name}", True)
    image = scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    return scene


def render(scene, path) -> dict[str, np.ndarray]:
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return exr.read(path)


@pytest.fixture(scope="module", params=[False, True], ids=["opaque film", "transparent film"])
def pair(request, tmp_path_factory):
    """Passes of Cycles and of ours, each through Blender's own result and file; exposure 2."""
    import blender_addon

    blender_addon.register()
    folder = tmp_path_factory.mktemp("passes")
    scene = build(request.param)
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = (
        "CPU",
        256,
        False,
        False,
    )
    cycles.film_exposure, cycles.diffuse_bounces, cycles.light_sampling_threshold = 2.0, 0, 0.0
    cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
    theirs = render(scene, folder / "cycles.exr")
    scene.render.engine = "POINTMR"
    scene.pointmr.method, scene.pointmr.samples, scene.pointmr.film_exposure = "DISTRIBUTED", 256, 2.0
    ours = render(scene, folder / "pointmr.exr")
    return ours, theirs


@pytest.mark.parametrize("name", ["depth", "position", "object_index", "material_index"])
def test_unfiltered_passes_agree(pair, name):
    """All but a few pixels whose centre lies on an edge."""
    ours, theirs = (p[name] for p in pair)
    different = (np.abs(ours - theirs) > 1e-3 * np.maximum(np.abs(theirs), 1.0)).any(-1)
    assert different.mean() < 0.005
    assert len(np.unique(theirs)) > 3


@pytest.mark.parametrize("name, limit", [("normal", 0.02), ("diffuse_color", 0.02), ("emission", 0.03)])
def test_averaged_passes_agree(pair, name, limit):
    ours, theirs = (p[name] for p in pair)
    assert np.abs(theirs).max() > 0.3
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < limit
    assert np.abs((ours - theirs).mean(axis=(0, 1))).max() < 0.1 * limit


def test_combined_agrees(pair):
    ours, theirs = (p["combined"] for p in pair)
    relative = np.mean((ours[..., :3] - theirs[..., :3]) ** 2 / (theirs[..., :3] ** 2 + 0.01))
    assert relative < 0.01
    assert np.sqrt(np.mean((ours[..., 3] - theirs[..., 3]) ** 2)) < 0.02
    assert np.abs((ours - theirs).mean(axis=(0, 1))).max() < 0.01
