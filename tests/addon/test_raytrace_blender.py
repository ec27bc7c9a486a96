"""Multi-resolution raytracing through Blender: its image beside that of many rays, passes, command, viewport."""

from __future__ import annotations

import json
import time

import bpy
import numpy as np
import OpenEXR
import pytest
from startup_scene import HEIGHT, WIDTH, combined, render, startup_scene

import blender_addon
from blender_addon import preferences
from blender_addon.cli import main
from blender_addon.job import RenderJob
from blender_addon.viewport import Refiner, View
from pointmr_engine.image import exr


@pytest.fixture
def scene():
    """A cube, a lamp, a camera; and a ball of triangles smaller than a pixel."""
    scene = startup_scene("RAYTRACE", 256)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=96, ring_count=48, radius=0.8, location=(0, 0, 1.8))
    return scene


def relative_mse(image, truth) -> float:
    """Mean square error of the colours against the truth's mean square."""
    return float(np.mean((image[..., :3] - truth[..., :3]) ** 2) / np.mean(truth[..., :3] ** 2))


def test_image_is_that_of_many_rays(scene, tmp_path):
    """One cone a pixel is near it, and the edges of four are nearer."""
    own = scene.pointmr
    cones = {}
    for count in ("1", "4"):
        own.raytrace_cones = count
        cones[count] = combined(render(scene, tmp_path / f"{count}.exr"))
    own.method = "DISTRIBUTED"
    rays = combined(render(scene, tmp_path / "rays.exr"))
    for image in cones.values():
        assert image.shape == (HEIGHT, WIDTH, 4) and np.isfinite(image).all()
        assert image[..., 3].max() <= 1.0 + 1e-5 and image.min() >= 0.0
        inside = rays[..., 3] > 0.999
        np.testing.assert_allclose(image[inside].mean(0), rays[inside].mean(0), rtol=0.05)
        assert relative_mse(image, rays) < 0.005
    coverage = [np.abs(image[..., 3] - rays[..., 3]).mean() for image in cones.values()]
    assert coverage[1] < coverage[0] < 1e-3


@pytest.mark.parametrize(
    ("name", "value"), [("footprint", 4.0), ("secondary", "RAYS"), ("visibility", "ALPHA")]
)
def test_settings_change_the_image_a_little(scene, tmp_path, name, value):
    before = combined(render(scene, tmp_path / "before.exr"))
    setattr(scene.pointmr, f"raytrace_{name}", value)
    after = combined(render(scene, tmp_path / "after.exr"))
    assert 0.0 < relative_mse(after, before) < 0.1


def test_passes_are_written(scene, tmp_path):
    layer = bpy.context.view_layer
    names = ("z", "position", "normal", "object_index", "material_index", "diffuse_color", "emit")
    for name in names:
        setattr(layer, f"use_pass_{name}", True)
    cube = bpy.data.objects["Cube"]
    cube.pass_index = 7
    channels = render(scene, tmp_path / "passes.exr")
    on_cube = channels["Object Index.X"] == 7
    assert (
        set(np.unique(channels["Object Index.X"])) == {0.0, 7.0} and 100 < on_cube.sum() < WIDTH * HEIGHT / 2
    )
    distance = (scene.camera.matrix_world.translation - cube.location).length
    depth = channels["Depth.Z"]
    assert (np.abs(depth[on_cube] - distance) < 2).all() and depth[0, 0] == pytest.approx(1e10)
    lengths = np.linalg.norm([channels[f"Normal.{c}"][on_cube] for c in "XYZ"], axis=0)
    assert (
        np.abs(lengths - 1) < 0.05
    ).mean() > 0.7 and lengths.max() < 1.01  # but for pixels at the cube's edges
    position = np.array([channels[f"Position.{c}"][on_cube] for c in "XYZ"])
    assert np.median(np.abs(position).max(0)) == pytest.approx(1, abs=0.02)
    assert np.median(channels["Diffuse Color.R"][on_cube]) == pytest.approx(0.8, abs=0.05)
    assert "Emission.R" in channels and "Material Index.X" in channels


@pytest.mark.parametrize("crop", [False, True])
def test_border_shows_the_same_part_of_the_scene(scene, tmp_path, crop):
    whole = combined(render(scene, tmp_path / "whole.exr"))
    border = scene.render
    border.use_border, border.use_crop_to_border = True, crop
    border.border_min_x, border.border_max_x = 0.25, 0.75
    border.border_min_y, border.border_max_y = 0.5, 1.0
    part = combined(render(scene, tmp_path / "part.exr"))
    if not crop:
        assert part.shape == whole.shape and (part[HEIGHT // 2 :] == 0).all()
        part = part[: HEIGHT // 2, WIDTH // 4 : 3 * WIDTH // 4]
    expected = whole[: HEIGHT // 2, WIDTH // 4 : 3 * WIDTH // 4]
    assert part.shape == expected.shape
    assert np.abs(part - expected).mean() < 0.01 * expected[..., :3].mean()


def test_stamp_says_cones(scene, tmp_path):
    scene.pointmr.raytrace_cones = "4"
    render(scene, tmp_path / "stamp.exr")
    with OpenEXR.File(str(tmp_path / "stamp.exr")) as file:
        header = dict(file.header())
    assert header["PointMR method"] == "raytrace" and header["PointMR cones"] == "4"
    assert "PointMR samples" not in header


def test_kept_sample_sets_give_the_same_image(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(preferences, "sample_folder", lambda: str(tmp_path / "sets"))
    first = combined(render(scene, tmp_path / "first.exr"))
    assert not (tmp_path / "sets").exists()
    scene.pointmr.raytrace_keep_sets = True
    for name in ("made", "read"):
        again = combined(render(scene, tmp_path / f"{name}.exr"))
        np.testing.assert_array_equal(again, first)
        assert any(p.is_file() for p in (tmp_path / "sets").rglob("*"))


def test_files_keep_their_method(tmp_path):
    """A file stores the method's number; that of a scene whose method was never chosen is the default."""
    bpy.ops.wm.read_factory_settings(use_empty=False)
    blender_addon.register()
    for method in ("RAYTRACE", "FORWARD", "CONVENTIONAL", "DISTRIBUTED"):
        own = bpy.context.scene.pointmr
        own.method, own.raytrace_cones, own.raytrace_footprint, own.raytrace_secondary = (
            method,
            "16",
            0.5,
            "RAYS",
        )
        path = str(tmp_path / f"{method}.blend")
        bpy.ops.wm.save_as_mainfile(filepath=path)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.wm.open_mainfile(filepath=path)
        own = bpy.context.scene.pointmr
        assert own.method == method
        assert (own.raytrace_cones, own.raytrace_footprint, own.raytrace_secondary) == ("16", 0.5, "RAYS")
    bpy.ops.wm.read_factory_settings(use_empty=False)
    assert bpy.context.scene.pointmr.method == "RAYTRACE"


def test_command(scene, tmp_path, capfd):
    blend, output, stats = tmp_path / "scene.blend", tmp_path / "image.exr", tmp_path / "stats.json"
    scene.pointmr.method = "DISTRIBUTED"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    arguments = ["render", str(blend), "-o", str(output), "--method", "raytrace", "--cones", "4"]
    arguments += ["--footprint", "0.5", "--secondary", "rays", "--stats", str(stats)]
    assert main(arguments) == 0
    out, err = capfd.readouterr()
    assert "raytrace, 4 cones per pixel, footprint 0.5, secondary rays" in out and "Traceback" not in err
    assert "  needed: " in out
    assert exr.read(output)["combined"][..., 3].max() == pytest.approx(1.0, abs=1e-3)
    [frame] = json.loads(stats.read_text())["frames"]
    assert frame["stats"]["method"] == "raytrace" and frame["stats"]["needs"]
    asked = frame["stats"]["settings"]["raytrace"]
    assert (asked["cones"], asked["footprint"], asked["secondary"]) == (4, 0.5, "rays")


def view_through(camera, width: int, height: int) -> View:
    """A viewport of this size that looks through the camera."""
    window = camera.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=width, y=height)
    world = camera.matrix_world.inverted()
    return View(tuple(map(tuple, world)), tuple(map(tuple, window)), True, True, width, height)


def test_viewport_refines_to_the_final_image(scene, tmp_path):
    """What the viewport ends with, through the camera, is the final render; a sketch comes first."""
    from blender_addon import sync

    scene.pointmr.raytrace_cones = "4"
    final = combined(render(scene, tmp_path / "final.exr"))[::-1]
    settings = sync.settings_from_blender(scene)
    settings.passes = ("combined",)
    refiner = Refiner()
    try:
        exported = sync.export(bpy.context.evaluated_depsgraph_get())
        refiner.start(exported, settings, view_through(scene.camera, WIDTH, HEIGHT))
        wait_for(lambda: refiner.picture is not None and refiner.picture.samples == 4, refiner)
        assert refiner.picture.scale == 1 and refiner.picture.version >= 3  # a sketch, one cone, four cones
        assert relative_mse(refiner.picture.pixels, final) < 5e-3
    finally:
        refiner.close()


def test_cancelling_ends_the_render(scene):
    """At its next word: no frame, no error, and the thread is gone."""
    from blender_addon import sync

    settings = sync.settings_from_blender(scene)
    settings.width, settings.height, settings.raytrace.cones = 1280, 960, 64
    job = RenderJob(sync.export(bpy.context.evaluated_depsgraph_get()), settings)
    end = time.monotonic() + 300.0
    while job.text != "rendering" or job.fraction == 0.0:
        assert not job.wait(0.01), job.error
        assert time.monotonic() < end, "waited in vain"
    job.cancel()
    assert job.wait(30.0)
    assert job.frame is None and job.error is None


def wait_for(condition, refiner, seconds=300.0):
    end = time.monotonic() + seconds
    while not condition():
        assert refiner.error is None, refiner.error
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)
