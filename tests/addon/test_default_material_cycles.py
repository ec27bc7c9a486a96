"""Objects that have no material, or an empty slot, as Cycles shows them."""

import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
sys.path.insert(0, str(Path(__file__).parent))

import builders as b  # noqa: E402
import node_planes  # noqa: E402

import blender_addon  # noqa: E402

SIZE = 16


def build(strength: float, power: float) -> None:
    """Two planes in a row, one without slots and one with an empty slot, seen and lit aslant."""
    scene = b.empty_scene()
    scene.world = bpy.data.worlds.new("world")
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = strength
    for x in (-2.0, 2.0):
        bpy.ops.mesh.primitive_plane_add(size=4.0, location=(x, 0, 0))
    bpy.context.object.data.materials.append(None)
    sun = b.add("sun", bpy.data.lights.new("sun", "SUN"), rotation_euler=(1.2, 0.0, 0.0))
    sun.data.energy, sun.data.angle = power, 0.0
    camera = bpy.data.cameras.new("camera")
    scene.camera = b.add("camera", camera, location=(0.0, -5.0, 3.0), rotation_euler=(1.03, 0.0, 0.0))
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100


def middle(picture: np.ndarray) -> np.ndarray:
    """(2, 3) mean colours of what shows the planes alone: left, right."""
    rows = picture[SIZE // 2 - 2 : SIZE // 2, :, :3]
    return np.stack([rows[:, 3:7].mean((0, 1)), rows[:, 9:13].mean((0, 1))])


@pytest.mark.parametrize(("strength", "power"), [(0.0, 3.0), (1.0, 0.0)], ids=["sun", "sky"])
def test_surfaces_without_material_are_as_cycles_shows_them(tmp_path, strength, power):
    build(strength, power)
    theirs = middle(node_planes.render(tmp_path / "cycles.exr", 256, bounces=4))
    blender_addon.register()
    try:
        scene = bpy.context.scene
        scene.render.engine = "POINTMR"
        scene.pointmr.method, scene.pointmr.samples = "DISTRIBUTED", 256
        scene.pointmr.pixel_filter_type, scene.pointmr.filter_width = "BOX", 1.0
        ours = middle(node_planes.written(tmp_path / "ours.exr"))
    finally:
        bpy.context.scene.render.engine = "CYCLES"
        blender_addon.unregister()
    assert theirs.min() > 0.01
    np.testing.assert_allclose(ours, theirs, rtol=0.01)
