"""Lamps in Blender's units: the light that Cycles puts on a diffuse plane equals the irradiance of our samples."""

import math

import numpy as np
import pytest

from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.raytracing.lights import allocate_light_samples, build_lights
from pointmr_engine.scene.group import Group
from pointmr_engine.scene.light import Light
from pointmr_engine.scene.scene import Scene

bpy = pytest.importorskip("bpy", reason="the bpy wheel is not installed")

SIZE, EXTENT, ALBEDO = 16, 4.0, 0.8

TILTED = ((1.0, 0.0, 2.0), (0.3, 0.4, 0.2))  # location, Euler rotation
ABOVE = ((0.4, 0.2, 1.5), (0.0, 0.0, 0.5))
LOW = ((0.2, 0.1, 0.3), (0.2, 0.0, 0.3))

CASES = {
    "point delta": dict(kind="POINT", place=ABOVE),
    "point sphere": dict(kind="POINT", place=LOW, radius=0.25, soft_falloff=False),
    "point disc": dict(kind="POINT", place=LOW, radius=0.25, soft_falloff=True),
    "point inside": dict(kind="POINT", place=LOW, radius=0.8, soft_falloff=False),
    "point disc through the plane": dict(kind="POINT", place=LOW, radius=0.8, soft_falloff=True),
    "point not normalized": dict(kind="POINT", place=ABOVE, radius=0.3, soft_falloff=False, normalize=False),
    "point delta not normalized": dict(kind="POINT", place=ABOVE, normalize=False),
    "point exposure": dict(kind="POINT", place=ABOVE, exposure=1.5, color=(1.0, 0.5, 0.25)),
    "point scaled": dict(kind="POINT", place=LOW, radius=0.1, soft_falloff=False, scale=(2.0, 2.0, 2.0)),
    "spot delta": dict(kind="SPOT", place=TILTED, spot_angle=1.0, spot_blend=0.3),
    "spot sharp": dict(kind="SPOT", place=TILTED, spot_angle=1.0, spot_blend=0.0),
    "spot sphere": dict(
        kind="SPOT", place=TILTED, spot_angle=0.9, spot_blend=1.0, radius=0.5, soft_falloff=False
    ),
    "spot disc": dict(
        kind="SPOT", place=TILTED, spot_angle=0.9, spot_blend=0.5, radius=0.5, soft_falloff=True
    ),
    "spot wide": dict(
        kind="SPOT", place=TILTED, spot_angle=math.pi, spot_blend=0.2, radius=0.1, soft_falloff=False
    ),
    "spot scaled": dict(
        kind="SPOT", place=TILTED, spot_angle=0.7, spot_blend=0.4, radius=0.1, scale=(2.0, 1.0, 1.0)
    ),
    "sun delta": dict(kind="SUN", place=TILTED, angle=0.0, power=3.0),
    "sun small": dict(kind="SUN", place=TILTED, angle=0.01, power=3.0),
    "sun wide": dict(kind="SUN", place=TILTED, angle=1.5, power=3.0),
    "sun half the sky": dict(kind="SUN", place=TILTED, angle=math.pi, power=3.0),
    "sun not normalized": dict(kind="SUN", place=TILTED, angle=0.8, power=3.0, normalize=False),
    "area square": dict(kind="AREA", place=TILTED, size_x=1.0),
    "area rectangle": dict(kind="AREA", place=LOW, shape="RECTANGLE", size_x=2.0, size_y=0.3),
    "area disk": dict(kind="AREA", place=TILTED, shape="DISK", size_x=1.5),
    "area ellipse": dict(kind="AREA", place=TILTED, shape="ELLIPSE", size_x=2.0, size_y=0.7),
    "area scaled": dict(kind="AREA", place=TILTED, size_x=0.5, scale=(3.0, 1.0, 2.0)),
    "area not normalized": dict(kind="AREA", place=TILTED, size_x=1.5, normalize=False, power=20.0),
    "area spread": dict(kind="AREA", place=TILTED, size_x=1.0, spread=1.2),
    "area disk spread": dict(kind="AREA", place=TILTED, shape="DISK", size_x=1.0, spread=0.8),
    "area ellipse spread": dict(
        kind="AREA", place=TILTED, shape="ELLIPSE", size_x=2.0, size_y=0.5, spread=0.8
    ),
    "area narrow spread": dict(kind="AREA", place=TILTED, size_x=1.2, spread=0.05),
    "area no spread": dict(kind="AREA", place=TILTED, size_x=1.2, spread=0.0),
    "area spread not normalized": dict(kind="AREA", place=TILTED, size_x=1.0, spread=1.0, normalize=False),
}


@pytest.fixture(scope="module")
def plane():
    """A scene that looks straight down at a white plane, without world or bounces."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=100.0)
    material = bpy.data.materials.new("white")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    diffuse, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (ALBEDO, ALBEDO, ALBEDO, 1.0)
    tree.links.new(diffuse.outputs[0], output.inputs[0])
    bpy.context.object.data.materials.append(material)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", EXTENT, (0.0, 0.0, 0.01)
    camera.data.clip_start = 0.001
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.view_settings.view_transform = "Raw"
    cycles = scene.cycles
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = 256, False, False
    cycles.max_bounces, cycles.pixel_filter_type = 0, "BOX"
    cycles.light_sampling_threshold = cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    return scene


def add_lamp(scene, case: dict):
    """The case's lamp in Blender, hidden from the camera, and ours."""
    names = {"radius": "shadow_soft_size", "spot_angle": "spot_size", "soft_falloff": "use_soft_falloff"}
    names |= {"size_x": "size", "size_y": "size_y", "power": "energy"}
    place, scale = case["place"], case.get("scale", (1.0, 1.0, 1.0))
    settings = {"power": 50.0, "radius": 0.0} | {
        k: v for k, v in case.items() if k not in ("place", "scale", "kind")
    }
    if case["kind"] in ("SUN", "AREA"):
        del settings["radius"]
    data = bpy.data.lights.new("lamp", case["kind"])
    for name, value in settings.items():
        setattr(data, names.get(name, name), value)
    lamp = bpy.data.objects.new("lamp", data)
    lamp.location, lamp.rotation_euler, lamp.scale = *place, scale
    lamp.visible_camera = False
    scene.collection.objects.link(lamp)
    bpy.context.view_layer.update()
    return lamp, Light(case["kind"], np.array(lamp.matrix_world), **settings)


def render(scene, path) -> np.ndarray:
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    pixels = np.array(image.pixels[:], np.float32).reshape(SIZE, SIZE, 4)[..., :3]
    bpy.data.images.remove(image)
    return pixels


def irradiance(light: Light, samples: int = 256) -> np.ndarray:
    """(SIZE, SIZE, 3) mean irradiance of each pixel of the plane."""
    lights = build_lights(Scene(Group("root"), lights=[light]), Geometry(), [])
    rng = np.random.default_rng(7)
    n = SIZE * SIZE * samples
    grid = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)), -1).reshape(-1, 1, 2)
    position = np.zeros((n, 3))
    position[:, :2] = ((grid + rng.random((SIZE * SIZE, samples, 2))) / SIZE - 0.5).reshape(-1, 2) * EXTENT
    out = allocate_light_samples(n)
    normal = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (n, 1))
    u = rng.random((n, 3))
    # strata over the light, so that few samples suffice
    side = math.isqrt(samples)
    cell = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)
    order = np.argsort(rng.random((SIZE * SIZE, samples)), axis=1)
    u[:, 1:] = (cell[order].reshape(-1, 2) + u[:, 1:]) / side
    lights.sample(position, normal, np.zeros(n, np.bool_), u, out)
    ok = out.kind != 0
    value = np.zeros((n, 3))
    cosine = np.maximum(out.direction[ok, 2], 0.0)
    value[ok] = out.radiance[ok] * (cosine / out.pdf[ok])[:, None]
    return value.reshape(SIZE, SIZE, samples, 3).mean(2)


@pytest.mark.parametrize("name", CASES)
def test_lamp_lights_as_in_cycles(plane, tmp_path, name):
    lamp, light = add_lamp(plane, CASES[name])
    try:
        expected = render(plane, tmp_path / "cycles.exr")
    finally:
        data = lamp.data
        bpy.data.objects.remove(lamp)
        bpy.data.lights.remove(data)
    ours = irradiance(light) * ALBEDO / math.pi
    assert expected.max() > 0.0
    # the whole picture, then each pixel within the noise of both
    assert ours.mean((0, 1)) == pytest.approx(expected.mean((0, 1)), rel=0.01)
    error = np.abs(ours - expected)
    assert error.mean() < 0.03 * expected.mean()
    assert error.max() < 0.25 * expected.max()
