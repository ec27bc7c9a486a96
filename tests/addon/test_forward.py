"""Forward mapping through Blender: its image beside that of many rays, passes, borders, viewport, kept sample sets."""

from __future__ import annotations

import importlib
import json
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from startup_scene import HEIGHT, WIDTH, combined, render, startup_scene

from blender_addon import preferences
from blender_addon.cli import main
from blender_addon.viewport import Refiner, View
from pointmr_engine.image import exr

ENGINE = Path(importlib.import_module("pointmr_engine.render").__file__)


@pytest.fixture
def scene():
    """A cube, a lamp, a camera."""
    scene = startup_scene("FORWARD", 64)
    scene.pointmr.forward_samples_per_pixel = 4.0
    return scene


@pytest.mark.parametrize("sampling", ["STATIC", "DYNAMIC"])
def test_image_is_that_of_many_rays(scene, tmp_path, sampling):
    scene.pointmr.forward_sampling = sampling
    points = combined(render(scene, tmp_path / "points.exr"))
    scene.pointmr.method = "DISTRIBUTED"
    rays = combined(render(scene, tmp_path / "rays.exr"))
    assert points.shape == (HEIGHT, WIDTH, 4) and np.isfinite(points).all()
    assert np.abs(points[..., 3] - rays[..., 3]).mean() < 0.02
    assert points[..., 3].max() <= 1.0
    inside = rays[..., 3] > 0.999
    np.testing.assert_allclose(points[inside].mean(0), rays[inside].mean(0), rtol=0.1)
    # a side of the cube in light, and one in its own shadow
    for column in (0.4, 0.6):
        at = HEIGHT // 2, int(WIDTH * column)
        np.testing.assert_allclose(points[at], rays[at], rtol=0.25)


def test_passes_are_written(scene, tmp_path):
    layer = bpy.context.view_layer
    for name in ("z", "normal", "object_index"):
        setattr(layer, f"use_pass_{name}", True)
    bpy.data.objects["Cube"].pass_index = 7
    channels = render(scene, tmp_path / "passes.exr")
    middle = (HEIGHT // 2, WIDTH // 2)
    distance = (scene.camera.matrix_world.translation - bpy.data.objects["Cube"].location).length
    assert distance - 2 < channels["Depth.Z"][middle] < distance
    assert channels["Depth.Z"][0, 0] == pytest.approx(1e10)
    assert channels["Object Index.X"][middle] == 7
    normal = np.array([channels[f"Normal.{c}"][middle] for c in "XYZ"])
    assert np.linalg.norm(normal) == pytest.approx(1, abs=0.05)


def test_border_shows_the_same_part_of_the_scene(scene, tmp_path):
    whole = combined(render(scene, tmp_path / "whole.exr"))
    border = scene.render
    border.use_border = border.use_crop_to_border = True
    border.border_min_x, border.border_max_x = 0.25, 0.75
    border.border_min_y, border.border_max_y = 0.5, 1.0
    part = combined(render(scene, tmp_path / "part.exr"))
    expected = whole[: HEIGHT // 2, WIDTH // 4 : 3 * WIDTH // 4]
    assert part.shape == expected.shape
    assert np.abs(part - expected).mean() < 0.01  # samples may be others


@pytest.mark.skipif(
    not any(
        "cache_folder" in p.read_text()
        for f in ("forward", "hierarchy")
        for p in (ENGINE.parent / f).rglob("*.py")
    ),
    reason="the engine does not keep sample sets on disk yet",
)
def test_kept_sample_sets_give_the_same_image(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(preferences, "sample_folder", lambda: str(tmp_path / "sets"))
    # the cube is drawn as it is: sets are made of triangles that are smaller than the samples
    bpy.ops.mesh.primitive_uv_sphere_add(segments=128, ring_count=64, radius=0.8, location=(0, 0, 1.5))
    first = combined(render(scene, tmp_path / "first.exr"))
    assert not (tmp_path / "sets").exists()
    scene.pointmr.forward_keep_sets = True
    for name in ("made", "read"):
        again = combined(render(scene, tmp_path / f"{name}.exr"))
        np.testing.assert_array_equal(again, first)
        assert any(p.is_file() for p in (tmp_path / "sets").rglob("*"))


def test_command(scene, tmp_path, capfd):
    blend, output = tmp_path / "scene.blend", tmp_path / "image.exr"
    scene.pointmr.method = "DISTRIBUTED"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    stats = tmp_path / "stats.json"
    arguments = ["render", str(blend), "-o", str(output), "--method", "forward", "--samples", "2"]
    arguments += ["--forward-sampling", "dynamic", "--stats", str(stats)]
    assert main(arguments) == 0
    out, err = capfd.readouterr()
    assert "forward, dynamic, 2 samples per pixel" in out and "Traceback" not in err
    assert exr.read(output)["combined"][..., 3].max() == pytest.approx(1.0, abs=1e-3)
    [frame] = json.loads(stats.read_text())["frames"]
    assert frame["stats"]["method"] == "forward" and "camera_rays" not in frame["stats"]["counters"]
    assert frame["stats"]["settings"]["forward"]["sampling"] == "dynamic"


@pytest.mark.parametrize(("sampling", "samples"), [("STATIC", 4.0), ("DYNAMIC", 12.0)])
def test_viewport_refines_to_the_final_image(scene, tmp_path, sampling, samples):
    """What the viewport ends with, through the camera, is the final render."""
    from blender_addon import sync

    scene.pointmr.forward_sampling = sampling
    final = combined(render(scene, tmp_path / "final.exr"))[::-1]
    depsgraph = bpy.context.evaluated_depsgraph_get()
    camera = scene.camera
    window = camera.calc_matrix_camera(depsgraph, x=WIDTH, y=HEIGHT)
    view = View(
        tuple(map(tuple, camera.matrix_world.inverted())),
        tuple(map(tuple, window)),
        True,
        True,
        WIDTH,
        HEIGHT,
    )
    settings = sync.settings_from_blender(scene)
    settings.samples, settings.passes = 12, ("combined",)
    refiner = Refiner()
    try:
        refiner.start(sync.export(depsgraph), settings, view)
        wait_for(lambda: refiner.picture is not None and refiner.picture.samples > samples - 0.1, refiner)
        assert refiner.picture.scale == 1 and refiner.picture.samples == pytest.approx(samples)
        assert np.abs(refiner.picture.pixels - final).mean() < 0.02
    finally:
        refiner.close()


def wait_for(condition, refiner, seconds=120.0):
    end = time.monotonic() + seconds
    while not condition():
        assert refiner.error is None, refiner.error
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)
