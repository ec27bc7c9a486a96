"""Shadow catchers through Blender, beside Cycles': alone, in collections, and by instancers that are catchers."""

import numpy as np
import pytest

from pointmr_engine.image import exr

bpy = pytest.importorskip("bpy")
SIZE = (48, 36)


def build(how: str):
    """A cube over a floor that catches, lit by a lamp that counts for it and by one that does not."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=12)
    floor = bpy.context.object
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 0.8))
    cube = bpy.context.object
    if how == "object":
        floor.is_shadow_catcher = True
    else:
        inner = bpy.data.collections.new("inner")
        for ob in (floor, cube) if how == "in a collection" else (floor,):
            scene.collection.objects.unlink(ob)
            inner.objects.link(ob)
        empty = bpy.data.objects.new("empty", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", inner
        scene.collection.objects.link(empty)
        (floor if how == "in a collection" else empty).is_shadow_catcher = True
    for k, (place, own) in enumerate((((2.5, -1.0, 4.0), True), ((-3.0, -2.0, 3.0), False))):
        lamp = bpy.data.objects.new(f"lamp {k}", bpy.data.lights.new("lamp", "POINT"))
        lamp.data.energy, lamp.data.shadow_soft_size = (400.0, 50.0)[k], 0.3
        lamp.location, lamp.is_shadow_catcher = place, own
        scene.collection.objects.link(lamp)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler = (0.0, -8.0, 5.0), (1.0, 0.0, 0.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.world = world = bpy.data.worlds.new("World")
    if not world.node_tree:
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.2, 0.25, 0.3, 1.0)
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = *SIZE, 100
    scene.cycles.samples, scene.cycles.diffuse_bounces = 256, 0
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    image = scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    return scene


def picture(scene, engine: str, path) -> np.ndarray:
    scene.render.engine, scene.render.filepath = engine, str(path)
    bpy.ops.render.render(write_still=True)
    return exr.read(path)["combined"]


@pytest.mark.parametrize("how", ["object", "in a collection", "instancer"])
def test_shadows_are_those_of_cycles(how, tmp_path):
    import blender_addon

    truth = picture(build(how), "CYCLES", tmp_path / "cycles.exr")
    assert truth[..., 3].min() < 0.05 and 0.03 < truth[..., 3].mean() < 0.6
    scene = build(how)
    blender_addon.register()
    scene.pointmr.raytrace_cones = "4"
    found = picture(scene, "POINTMR", tmp_path / "ours.exr")
    error = found - truth
    assert np.sqrt((error**2).mean()) < 0.02
    assert abs(error.mean()) < 0.003
