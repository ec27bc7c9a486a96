"""Background renders through Blender: results, passes, borders, layers, errors, cancelling; parts without Blender."""

from __future__ import annotations

import importlib
import threading
import time

import bpy
import numpy as np
import OpenEXR
import pytest

import blender_addon
from blender_addon import observer
from blender_addon.headless import CommandError, FrameObserver, run_render
from blender_addon.job import RenderJob
from blender_addon.refinement import ForwardPace
from blender_addon.report import Reporter
from blender_addon.viewport import Refiner, View, camera_from_view
from pointmr_engine.scene.camera import Camera
from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.group import Group
from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.settings import ForwardSettings, RaytraceSettings, RenderSettings

WIDTH, HEIGHT = 64, 48


@pytest.fixture
def scene():
    """Blender's start-up scene, small, with PointMR: a cube, a lamp, a camera."""
    bpy.ops.wm.read_factory_settings(use_empty=False)
    blender_addon.register()
    scene = bpy.context.scene
    render = scene.render
    render.engine = "POINTMR"
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.pointmr.method, scene.pointmr.samples = "DISTRIBUTED", 4
    settings = render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    yield scene
    observer.follow(None)


def render(scene, path) -> dict[str, np.ndarray]:
    """Render to `path` (EXR); channels by name, top row first."""
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: c.pixels for part in file.parts for name, c in part.channels.items()}


def engine_module():
    """The module pointmr_engine.render (the package's attribute of that name is the function)."""
    return importlib.import_module("pointmr_engine.render")


def combined(channels, layer="ViewLayer") -> np.ndarray:
    return np.stack([channels[f"{layer}.Combined.{c}"] for c in "RGBA"], -1)


def test_cube_is_rendered(scene, tmp_path):
    pixels = combined(render(scene, tmp_path / "cube.exr"))
    assert pixels.shape == (HEIGHT, WIDTH, 4)
    assert np.isfinite(pixels).all()
    # The lamp is in front, above: the cube in the middle is brighter than the grey world around it.
    assert pixels[HEIGHT // 2 - 4 : HEIGHT // 2, WIDTH // 2, :3].mean() > 2 * pixels[:4, :4, :3].mean() > 0


def test_right_way_up(scene, tmp_path):
    """The cube is moved to the upper left of the picture."""
    camera = scene.camera
    camera.data.shift_x, camera.data.shift_y = 0.3, -0.2
    scene.render.film_transparent = True
    alpha = combined(render(scene, tmp_path / "moved.exr"))[..., 3]
    rows, columns = np.nonzero(alpha > 0.5)
    assert rows.mean() < HEIGHT / 2 and columns.mean() < WIDTH / 2


def test_every_pass_is_written(scene, tmp_path):
    layer = bpy.context.view_layer
    for name in ("z", "position", "normal", "object_index", "material_index", "diffuse_color", "emit"):
        setattr(layer, f"use_pass_{name}", True)
    layer.pointmr.pass_debug_sample_count = True
    bpy.data.objects["Cube"].pass_index = 7
    channels = render(scene, tmp_path / "passes.exr")
    middle = (HEIGHT // 2, WIDTH // 2)
    prefix = "ViewLayer."
    distance = (scene.camera.matrix_world.translation - bpy.data.objects["Cube"].location).length
    depth = channels[prefix + "Depth.Z"]
    assert distance - 2 < depth[middle] < distance
    assert depth[0, 0] == pytest.approx(1e10)
    assert channels[prefix + "Object Index.X"][middle] == 7
    assert channels[prefix + "Debug Sample Count.X"][middle] == 4
    normal = np.array([channels[f"{prefix}Normal.{c}"][middle] for c in "XYZ"])
    assert np.linalg.norm(normal) == pytest.approx(1, abs=0.05)
    position = np.array([channels[f"{prefix}Position.{c}"][middle] for c in "XYZ"])
    assert np.abs(position).max() == pytest.approx(1, abs=0.01)
    assert channels[prefix + "Diffuse Color.R"][middle] == pytest.approx(0.8, abs=0.05)
    assert prefix + "Emission.R" in channels and prefix + "Material Index.X" in channels


@pytest.mark.parametrize("crop", [False, True])
def test_border_is_the_same_part_of_the_image(scene, tmp_path, crop):
    scene.pointmr.method = "CONVENTIONAL"
    whole = combined(render(scene, tmp_path / "whole.exr"))
    border = scene.render
    border.use_border, border.use_crop_to_border = True, crop
    border.border_min_x, border.border_max_x = 0.25, 0.75
    border.border_min_y, border.border_max_y = 0.5, 1.0
    part = combined(render(scene, tmp_path / "part.exr"))
    expected = whole[: HEIGHT // 2, WIDTH // 4 : 3 * WIDTH // 4]
    if not crop:
        assert part.shape == whole.shape
        assert (part[HEIGHT // 2 :] == 0).all()
        part = part[: HEIGHT // 2, WIDTH // 4 : 3 * WIDTH // 4]
    np.testing.assert_allclose(part, expected, rtol=1e-5, atol=1e-6)


def test_view_layers_show_their_own_collections(scene, tmp_path):
    scene.render.film_transparent = True
    empty = scene.view_layers.new("Empty")
    empty.layer_collection.children["Collection"].exclude = True
    channels = render(scene, tmp_path / "layers.exr")
    assert combined(channels)[..., 3].max() == 1
    assert combined(channels, "Empty")[..., 3].max() == 0


def test_stamp_says_method_samples_and_triangles(scene, tmp_path):
    path = tmp_path / "stamp.exr"
    render(scene, path)
    with OpenEXR.File(str(path)) as file:
        header = dict(file.header())
    assert header["PointMR method"] == "distributed"
    assert header["PointMR samples"] == "4"
    assert header["PointMR triangles"] == "12"


def test_error_of_the_engine_names_the_object(scene, monkeypatch):

    def fail(*_, **__):
        raise SceneError("mesh 'Broken': triangle 3 refers to a vertex outside 0..7")

    monkeypatch.setattr(engine_module(), "render", fail)
    with pytest.raises(RuntimeError, match="mesh 'Broken': triangle 3"):
        bpy.ops.render.render()


def test_a_camera_that_is_not_supported_is_one_error(scene):
    """It was said to be missing, too."""
    scene.camera.data.type = "PANO"
    watch = FrameObserver()
    with pytest.raises(
        CommandError, match=f"camera '{scene.camera.name}': panoramic cameras are not supported"
    ):
        run_render(watch)
    assert len(watch.errors) == 1


def test_a_bug_in_the_export_is_an_error_not_a_crash(scene, monkeypatch, capsys):
    from blender_addon import sync

    monkeypatch.setattr(sync, "export", lambda *_, **__: 1 / 0)
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        bpy.ops.render.render()


class Stopper(observer.Observer):
    """Stops a render `delay` seconds after it began, and remembers when."""

    def __init__(self, delay: float):
        self.delay, self.began, self.stopped_at = delay, None, None

    def exported(self, layer, scene, settings):
        self.began = time.monotonic()

    def stopped(self):
        if self.began is None or time.monotonic() - self.began < self.delay:
            return False
        self.stopped_at = self.stopped_at or time.monotonic()
        return True


def test_cancel_ends_within_a_second(scene, tmp_path):
    render(scene, tmp_path / "warm.exr")
    scene.render.resolution_x, scene.render.resolution_y = 1024, 768
    scene.pointmr.samples = 1 << 16
    stopper = Stopper(1.0)
    observer.follow(stopper)
    bpy.ops.render.render()
    assert time.monotonic() - stopper.stopped_at < 1.0


def test_tiles_appear_while_rendering(scene, tmp_path, monkeypatch):
    """The engine's tiles reach the result before the render is done."""
    from blender_addon import engine

    shown = []
    original = engine.show_tiles
    monkeypatch.setattr(engine, "SHOW_SECONDS", 0.05)
    monkeypatch.setattr(
        engine,
        "show_tiles",
        lambda target, tiles, *rest: shown.extend(tiles) or original(target, tiles, *rest),
    )
    scene.render.resolution_x, scene.render.resolution_y = 256, 192
    scene.pointmr.samples = 64
    final = combined(render(scene, tmp_path / "tiles.exr"))[::-1]
    assert shown
    tile = shown[0]
    h, w = tile.pixels.shape[:2]
    assert np.isfinite(tile.pixels).all() and 0 <= tile.x < 256 and 0 <= tile.y < 192
    part = final[tile.y : tile.y + h, tile.x : tile.x + w]
    np.testing.assert_allclose(part.mean((0, 1)), tile.pixels.mean((0, 1)), rtol=0.2, atol=0.02)


# Without Blender


def test_messages_are_sent_once_and_floods_are_cut():
    sent = []
    reporter = Reporter(lambda level, text: sent.append((min(level), text)))
    for _ in range(3):
        reporter("WARNING", "object 'A' is empty")
    for i in range(2 * Reporter.LIMIT):
        reporter("WARNING", f"object {i}")
    assert sent == []  # only flush talks to Blender
    reporter.close()
    assert sent.count(("WARNING", "object 'A' is empty")) == 1
    assert len(sent) == Reporter.LIMIT + 1
    assert sent[-1][1] == f"and {Reporter.LIMIT + 1} more warnings"


@pytest.fixture
def fake_render(monkeypatch):
    """The engine's render, replaced by a record of its calls: each takes `seconds` and returns its seed as a colour."""
    from pointmr_engine.image.frame import Frame

    calls = []

    def render(scene, settings, progress=None, **_):
        calls.append(settings)
        end = time.monotonic() + render.seconds
        while time.monotonic() < end:
            if progress(0.5, render.phase):
                return None
            time.sleep(0.005)
        value = float(len(calls))
        pixels = np.full((settings.height, settings.width, 4), value, np.float32)
        return Frame(settings.width, settings.height, {"combined": pixels})

    render.seconds, render.phase, render.calls = 0.02, "sampling", calls
    monkeypatch.setattr(engine_module(), "render", render)
    return render


def test_job_stops_when_cancelled(fake_render):
    fake_render.seconds = 60
    job = RenderJob(Scene(Group("root"), Camera()), RenderSettings(8, 8))
    while job.fraction == 0:
        assert not job.wait(0.01)
    assert job.text == "sampling"
    job.cancel()
    assert job.wait(1.0)
    assert job.frame is None and job.error is None


def wait_for(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


VIEW = View(
    tuple(map(tuple, np.eye(4))),
    ((2, 0, 0, 0), (0, 2, 0, 0), (0, 0, -1.002, -0.2002), (0, 0, -1, 0)),
    True,
    False,
    61,
    40,
)


def test_viewport_goes_from_coarse_to_fine_and_averages(fake_render):
    fake_render.seconds = 0.05
    refiner = Refiner()
    scene = Scene(Group("root"), Camera())
    refiner.start(scene, RenderSettings(method="distributed", samples=5, passes=("combined",)), VIEW)
    wait_for(
        lambda: refiner.picture is not None and refiner.picture.scale == 1 and refiner.picture.samples == 5
    )
    sizes = [(c.width, c.height) for c in fake_render.calls]
    assert sizes == [(16, 10), (31, 20), (61, 40), (61, 40), (61, 40), (61, 40)][: len(sizes)]
    full = [c for c in fake_render.calls if c.width == 61]
    assert sum(c.samples for c in full) == 5
    assert len({c.seed for c in full}) == len(full)
    first = len(fake_render.calls) - len(full) + 1
    expected = sum(c.samples * (first + i) for i, c in enumerate(full)) / 5
    assert refiner.picture.pixels[0, 0, 0] == pytest.approx(expected)
    refiner.close()


def test_viewport_refines_forward_mapping(fake_render):
    """Few samples first, one a pixel next, then passes of equal density, whose mean alone stays."""
    refiner = Refiner()
    scene = Scene(Group("root"), Camera())
    dynamic = ForwardSettings(sampling="dynamic")
    settings = RenderSettings(method="forward", forward=dynamic, samples=10, passes=("combined",))
    refiner.start(scene, settings, VIEW)
    wait_for(lambda: refiner.picture is not None and refiner.picture.samples > 9.9)
    calls = [(c.width, c.height, c.forward.samples_per_pixel) for c in fake_render.calls]
    assert calls[:2] == [(16, 10, 0.25), (61, 40, 1.0)]
    assert [c[:2] for c in calls[2:]] == [(61, 40)] * 3
    assert sum(c[2] for c in calls[2:]) == pytest.approx(10) and max(c[2] for c in calls) <= 4
    assert len({c.seed for c in fake_render.calls[2:]}) == 3
    assert refiner.picture.pixels[0, 0, 0] == pytest.approx((3 + 4 + 5) / 3)
    assert settings.forward.samples_per_pixel == 1.0
    wait_for(lambda: refiner.text == "")
    # The scene is known, its pictures were quick: another view's first one has full pixels.
    refiner.start(scene, settings, VIEW._replace(width=100))
    wait_for(lambda: len(fake_render.calls) > 5)
    assert (fake_render.calls[5].width, fake_render.calls[5].forward.samples_per_pixel) == (100, 0.25)
    refiner.close()


def test_viewport_does_not_average_what_does_not_change(fake_render):
    """Static samples are the same for all seeds: one pass, as dense as the final image."""
    for final, samples, expected in (
        (1.0, 32, [0.25, 1, 4]),
        (16.0, 32, [0.25, 1, 16]),
        (16.0, 2, [0.25, 1, 2]),
    ):
        fake_render.calls.clear()
        refiner = Refiner()
        forward = ForwardSettings(samples_per_pixel=final)
        settings = RenderSettings(method="forward", forward=forward, samples=samples)
        refiner.start(Scene(Group("root"), Camera()), settings, VIEW)
        wait_for(lambda r=refiner: r.picture is not None and r.text == "")
        refiner.close()
        assert [c.forward.samples_per_pixel for c in fake_render.calls] == expected


def test_viewport_sketches_then_raytraces(fake_render):
    """Forward mapping with simple shading first, then one cone a pixel, then ever more; nothing is averaged."""
    refiner = Refiner()
    scene = Scene(Group("root"), Camera())
    asked = RaytraceSettings(cones=16, footprint=0.5, cache_folder="sets")
    settings = RenderSettings(method="raytrace", raytrace=asked, passes=("combined",))
    refiner.start(scene, settings, VIEW)
    wait_for(lambda: refiner.picture is not None and refiner.picture.samples == 16 and refiner.text == "")
    sketch, *cones = fake_render.calls
    assert (sketch.method, sketch.width, sketch.forward.shading) == ("forward", 16, "simple")
    assert sketch.forward.samples_per_pixel < 1 and sketch.forward.cache_folder == "sets"
    assert [(c.method, c.width, c.raytrace.cones) for c in cones] == [
        ("raytrace", 31, 1),
        ("raytrace", 61, 1),
        ("raytrace", 61, 4),
        ("raytrace", 61, 16),
    ]
    assert {c.raytrace.footprint for c in cones} == {0.5} and settings.raytrace is asked and asked.cones == 16
    assert refiner.picture.pixels[0, 0, 0] == len(fake_render.calls)
    # The second view's sketch shows how quick they are: the third one's is finer, and no coarse cones follow it.
    for number, expected in (
        (5, [("forward", 25), ("raytrace", 50)]),
        (10, [("forward", 50), ("raytrace", 100)]),
    ):
        refiner.start(scene, settings, VIEW._replace(width=100, height=40 + number))
        wait_for(lambda n=number: len(fake_render.calls) >= n + 4 and refiner.text == "")
        assert [(c.method, c.width) for c in fake_render.calls[number : number + 2]] == expected
    refiner.close()


def test_viewport_ends_with_as_many_cones_as_asked_for(fake_render):
    for cones, expected in ((1, [1, 1]), (4, [1, 1, 4])):
        fake_render.calls.clear()
        refiner = Refiner()
        settings = RenderSettings(method="raytrace", raytrace=RaytraceSettings(cones=cones))
        refiner.start(Scene(Group("root"), Camera()), settings, VIEW)
        wait_for(lambda r=refiner: r.picture is not None and r.text == "")
        refiner.close()
        assert [c.raytrace.cones for c in fake_render.calls if c.method == "raytrace"] == expected


def test_forward_mappings_first_picture_is_as_fine_as_it_was_quick():
    def first(pace, scene, *seconds, pixel_size=1):
        steps = pace.steps(scene, ForwardSettings(), 1, pixel_size)
        step = next(steps)
        for s in seconds:
            steps.send(s)
        return step.scale

    pace, scene = ForwardPace(), object()
    assert first(pace, scene, 60.0) == 4  # nothing known yet; this one also built the hierarchies
    assert first(pace, scene, 0.03) == 4  # 0.48 s for full pixels, at most
    assert first(pace, scene, 0.01) == 2
    assert first(pace, scene, 0.02) == 1
    assert first(pace, scene, 1.0) == 1  # a view that takes long
    assert first(pace, scene) == 4
    assert first(pace, object(), 60.0) == 4
    assert first(pace, scene, pixel_size=8) == 8
    steps = pace.steps(object(), ForwardSettings(), 4, 1)
    slow = [next(steps), *(steps.send(s) for s in (0.5, 2.0, 8.0))]
    assert [(step.scale, step.samples) for step in slow] == [(4, 0.25), (2, 1.0), (1, 1.0), (1, 4.0)]


def test_viewport_starts_again_on_a_change_and_ends_when_closed(fake_render):
    fake_render.seconds = 60
    refiner = Refiner()
    scene = Scene(Group("root"), Camera())
    refiner.start(scene, RenderSettings(method="distributed", samples=1), VIEW)
    wait_for(lambda: len(fake_render.calls) == 1)
    fake_render.seconds = 0.01
    refiner.start(scene, RenderSettings(method="distributed", samples=1), VIEW._replace(width=100))
    wait_for(lambda: refiner.picture is not None and refiner.picture.scale == 1)
    assert refiner.picture.pixels.shape == (40, 100, 4)
    refiner.close()
    wait_for(lambda: not any(t.name == "PointMR viewport" for t in threading.enumerate()))


def test_viewport_does_not_build_anew_for_another_view(fake_render):
    """Moving while hierarchies are built lets that go on; a new scene ends it."""
    fake_render.seconds, fake_render.phase = 60, "building hierarchies"
    refiner = Refiner()
    scene = Scene(Group("root"), Camera())
    refiner.start(scene, RenderSettings(method="distributed", samples=1), VIEW)
    wait_for(lambda: len(fake_render.calls) == 1)
    refiner.start(scene, RenderSettings(method="distributed", samples=1), VIEW._replace(width=100))
    time.sleep(0.1)
    assert len(fake_render.calls) == 1
    fake_render.seconds = 0.01
    refiner.start(
        Scene(Group("root"), Camera()),
        RenderSettings(method="distributed", samples=1),
        VIEW._replace(width=100),
    )
    wait_for(lambda: refiner.picture is not None and refiner.picture.scale == 1)
    refiner.close()


def test_viewport_keeps_the_error_for_the_user(monkeypatch):

    def fail(*_, **__):
        raise SceneError("light 'Lamp': power is not finite")

    monkeypatch.setattr(engine_module(), "render", fail)
    refiner = Refiner()
    refiner.start(Scene(Group("root"), Camera()), RenderSettings(method="distributed", samples=1), VIEW)
    wait_for(lambda: refiner.error is not None)
    assert "light 'Lamp'" in str(refiner.error)
    refiner.close()


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("scale", [1, 4])
def test_viewport_camera_sees_what_blenders_projection_says(scene, kind, scale):
    """World points land on the pixels where Blender's view and window matrices put them."""
    from pointmr_engine.raytracing.camera import compile_camera

    width, height = 101, 67
    camera = scene.camera
    camera.data.type, camera.data.ortho_scale = kind, 9
    camera.data.shift_x, camera.data.shift_y = 0.13, -0.07
    depsgraph = bpy.context.evaluated_depsgraph_get()
    window = np.array(camera.calc_matrix_camera(depsgraph, x=width, y=height))
    view = np.array(camera.matrix_world.inverted())
    ours = camera_from_view(
        View(tuple(map(tuple, view)), tuple(map(tuple, window)), kind == "PERSP", True, width, height), scale
    )
    wide, high = -(-width // scale), -(-height // scale)
    arrays = compile_camera(ours, RenderSettings(wide, high))
    for point in np.random.default_rng(1).uniform(-2, 2, (20, 3)):
        clip = window @ view @ np.append(point, 1)
        expected = (clip[:2] / clip[3] + 1) / 2 * (width, height) / scale
        p = arrays.camera_from_world @ np.append(point, 1)
        on_plane = p[:2] / p[2] if kind == "PERSP" else p[:2]
        raster = (on_plane - arrays.plane[0]) / arrays.plane[1]
        np.testing.assert_allclose(raster, expected, atol=2e-3)
        assert arrays.clip[0] <= p[2] <= arrays.clip[1]
