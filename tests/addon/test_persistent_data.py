"""Persistent Data: frames of an animation and further images are made of what the first one made of the scene."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from benchmarks.features import stage  # noqa: E402
from blender_addon.headless import FrameObserver, run_render  # noqa: E402

pytestmark = pytest.mark.usefixtures("engine")

BUILDING = "building hierarchies"


@pytest.fixture
def scene():
    """A monkey among cubes on a floor. The camera moves in frames 1 to 3, the monkey to 5, and then the sun's light."""
    stage.empty_scene()
    scene = bpy.context.scene
    stage.plane(stage.matte(stage.CREAM), (0, 0, -0.5), 20.0)
    for x in (-1.5, 1.5):
        stage.cube(stage.matte(stage.RED), (x, 0, 0), 0.8)
    monkey = stage.monkey(stage.principled("metal", Metallic=1.0, Roughness=0.2), (0, 0, 0.3), 0.6, levels=1)
    lamp = stage.lamp("SUN", 3.0, (3, -2, 4), (0, 0, 0), angle=0.05)
    stage.camera((0, -5, 2), (0, 0, 0), 40.0)
    for frame, x in ((1, 0.0), (3, 0.5)):
        scene.camera.location.x = x
        scene.camera.keyframe_insert("location", frame=frame)
    for frame, turn in ((3, 0.0), (5, 1.0)):
        monkey.rotation_euler.z = turn
        monkey.keyframe_insert("rotation_euler", frame=frame)
    for frame, energy in ((5, 3.0), (7, 6.0)):
        lamp.data.energy = energy
        lamp.data.keyframe_insert("energy", frame=frame)
    scene.render.engine = "POINTMR"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 48, 32, 100
    return scene


def rendered(scene, frame=None, layer="ViewLayer"):
    """(pixels (h, w, 4), phases of the engine with their seconds) of one more image."""
    if frame is not None:
        scene.frame_current = frame
    observer = FrameObserver()
    run_render(observer)
    found = observer.frames[layer]
    return found.passes["combined"], found.stats["times"]


def alone(scene, frame=None, layer="ViewLayer"):
    """Pixels of the image without what was kept."""
    kept, scene.render.use_persistent_data = scene.render.use_persistent_data, False
    pixels, times = rendered(scene, frame, layer)
    assert BUILDING in times
    scene.render.use_persistent_data = kept
    return pixels


@pytest.mark.parametrize("method", ["RAYTRACE", "FORWARD"])
def test_frames_show_what_they_show_alone(scene, method):
    scene.pointmr.method = method
    exact = [alone(scene, frame) for frame in range(1, 8)]
    assert all(not np.array_equal(a, b) for a, b in zip(exact, exact[1:], strict=False))
    scene.render.use_persistent_data = True
    for frame, expected in enumerate(exact, 1):
        found, times = rendered(scene, frame)
        assert np.array_equal(found, expected), frame
        # what camera and lamps alone change is not built again
        assert (BUILDING in times) == (frame in (1, 4, 5)), frame


def test_what_the_user_changes_shows(scene):
    scene.render.use_persistent_data = True
    first, _ = rendered(scene, 1)
    again, times = rendered(scene)
    assert np.array_equal(first, again) and BUILDING not in times
    cube = next(ob for ob in scene.objects if ob.name.startswith("Cube"))
    cube.material_slots[0].material = stage.matte(stage.BLUE)
    blue, _ = rendered(scene)
    assert not np.array_equal(blue, again) and np.array_equal(blue, alone(scene))
    cube.hide_render = True
    less, _ = rendered(scene)
    assert not np.array_equal(blue, less) and np.array_equal(less, alone(scene))


def test_view_layers_keep_their_own(scene):
    other = scene.view_layers.new("Other")
    first = bpy.data.collections.new("first")
    scene.collection.children.link(first)
    cube = next(ob for ob in scene.objects if ob.name.startswith("Cube"))
    scene.collection.objects.unlink(cube)
    first.objects.link(cube)
    other.layer_collection.children["first"].exclude = True
    exact = [(alone(scene, f), alone(scene, f, "Other")) for f in (1, 2)]
    scene.render.use_persistent_data = True
    for frame, (whole, part) in enumerate(exact, 1):
        scene.frame_current = frame
        observer = FrameObserver()
        run_render(observer)
        # Blender makes the cubes' bevels anew, with other last bits
        assert np.allclose(observer.frames["ViewLayer"].passes["combined"], whole, atol=1e-4)
        assert np.allclose(observer.frames["Other"].passes["combined"], part, atol=1e-4)
        assert all((BUILDING in f.stats["times"]) == (frame == 1) for f in observer.frames.values())


def test_a_render_that_was_stopped_leaves_nothing_half_made(scene):
    scene.render.use_persistent_data = True
    expected, _ = rendered(scene, 1)
    scene.pointmr.raytrace_cones, scene.render.resolution_percentage = "64", 400

    def stop(fraction, text):
        observer.interrupted |= text == "rendering"

    observer = FrameObserver(on_progress=stop)
    with pytest.raises(KeyboardInterrupt):
        run_render(observer)
    scene.pointmr.raytrace_cones, scene.render.resolution_percentage = "1", 100
    found, times = rendered(scene, 1)
    assert np.array_equal(found, expected) and BUILDING in times
