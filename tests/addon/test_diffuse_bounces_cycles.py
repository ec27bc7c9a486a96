"""Diffuse light that bounces, beside Cycles: a box with coloured walls under a lamp, and under a sky."""

import numpy as np
import pytest
from builders import add, empty_scene

from pointmr_engine.image import exr

bpy = pytest.importorskip("bpy")
SIZE = (48, 36)
INSIDE = np.s_[4:32, 8:40]
WALLS = {
    "floor": ([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], (0.8, 0.8, 0.8)),
    "back": ([(-1, 1, 0), (1, 1, 0), (1, 1, 2), (-1, 1, 2)], (0.8, 0.8, 0.8)),
    "left": ([(-1, 1, 0), (-1, 1, 2), (-1, -1, 2), (-1, -1, 0)], (0.8, 0.1, 0.1)),
    "right": ([(1, 1, 0), (1, -1, 0), (1, -1, 2), (1, 1, 2)], (0.1, 0.8, 0.1)),
    "top": ([(-1, -1, 2), (-1, 1, 2), (1, 1, 2), (1, -1, 2)], (0.8, 0.8, 0.8)),
}


def build(lit_by: str):
    """The box, open to the camera, with a block of the default material in it."""
    scene = empty_scene()
    for name, (corners, color) in WALLS.items():
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
        material = bpy.data.materials.new(name)
        if not material.node_tree:
            material.use_nodes = True
        values = material.node_tree.nodes["Principled BSDF"].inputs
        values["Base Color"].default_value = (*color, 1.0)
        values["Specular IOR Level"].default_value = 0.0
        mesh.materials.append(material)
        add(name, mesh)
    bpy.ops.mesh.primitive_cube_add(size=0.7, location=(0.2, 0.2, 0.35), rotation=(0, 0, 0.4))
    scene.world = bpy.data.worlds.new("World")
    if not scene.world.node_tree:
        scene.world.use_nodes = True
    strength = scene.world.node_tree.nodes["Background"].inputs["Strength"]
    strength.default_value = 1.0 if lit_by == "sky" else 0.0
    if lit_by == "lamp":
        lamp = bpy.data.lights.new("lamp", "AREA")
        lamp.energy, lamp.size = 20.0, 0.5
        add("lamp", lamp, location=(0, 0, 1.9))
    scene.camera = add("Camera", bpy.data.cameras.new("Camera"), location=(0, -4.2, 1.0))
    scene.camera.rotation_euler = (np.pi / 2, 0, 0)
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = *SIZE, 100
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.max_bounces = "CPU", 512, 12
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
    image = scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    return scene


def picture(scene, engine: str, path) -> np.ndarray:
    """Means (7, 8, 3) of 4 x 4 pixels of the box' inside."""
    scene.render.engine, scene.render.filepath = engine, str(path)
    bpy.ops.render.render(write_still=True)
    part = exr.read(path)["combined"][..., :3][INSIDE].astype(float)
    return part.reshape(7, 4, 8, 4, 3).mean((1, 3))


@pytest.mark.parametrize("lit_by", ["lamp", "sky"])
def test_walls_light_each_other_as_in_cycles(lit_by, tmp_path):
    import blender_addon

    blender_addon.register()
    scene = build(lit_by)
    own = scene.pointmr
    scene.cycles.diffuse_bounces = 0
    direct = picture(scene, "CYCLES", tmp_path / "direct.exr")
    for bounces in (1, 3):
        scene.cycles.diffuse_bounces = own.diffuse_bounces = bounces
        truth = picture(scene, "CYCLES", tmp_path / "cycles.exr")
        assert truth.mean() > 1.1 * direct.mean()
        for method in ("DISTRIBUTED", "RAYTRACE"):
            own.method, own.samples, own.raytrace_cones = method, 256, "16"
            found = picture(scene, "POINTMR", tmp_path / "ours.exr")
            assert found.mean() == pytest.approx(truth.mean(), rel=0.01)
            assert np.sqrt((((found - truth) / truth.mean((0, 1))) ** 2).mean()) < 0.02, method
