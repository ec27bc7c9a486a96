"""Camera, lamps, world and settings."""

from __future__ import annotations

import math

import bpy
import builders as b
import numpy as np
import placements
import pytest

import blender_addon
from blender_addon import sync
from pointmr_engine.scene.group import CAMERA, GLOSSY, VISIBLE


@pytest.fixture
def scene():
    result = b.empty_scene()
    result.camera = b.add("cam", bpy.data.cameras.new("cam"))
    return result


def export(**options):
    said = []
    result = placements.with_depsgraph(
        lambda d: sync.export(d, report=lambda level, text: said.append((level, text)), **options)
    )
    return result, said


# Camera


def test_camera(scene):
    ob = scene.camera
    ob.location, ob.rotation_euler, ob.scale = (1, 2, 3), (0.1, 0.2, 0.3), (2, 2, -3)
    data = ob.data
    data.lens, data.sensor_width, data.sensor_height, data.sensor_fit = 35, 30, 20, "VERTICAL"
    data.shift_x, data.shift_y, data.clip_start, data.clip_end = 0.1, -0.2, 0.5, 500
    result, said = export()
    c = result.camera
    assert (c.kind, c.focal_length, c.sensor_width, c.sensor_height, c.sensor_fit) == (
        "PERSPECTIVE", 35, 30, 20, "VERTICAL",
    )  # fmt: skip
    assert np.allclose([c.shift_x, c.shift_y, c.clip_start, c.clip_end], [0.1, -0.2, 0.5, 500])
    assert c.fstop == 0.0 and not said
    assert np.allclose(np.linalg.norm(c.world_from_camera[:3, :3], axis=0), 1)
    assert np.allclose(c.world_from_camera[:3, 3], (1, 2, 3))


def test_camera_focus(scene):
    dof = scene.camera.data.dof
    dof.use_dof, dof.aperture_fstop, dof.aperture_blades = True, 1.4, 6
    dof.aperture_rotation, dof.aperture_ratio, dof.focus_distance = 0.5, 2.0, 7.0
    c = export()[0].camera
    assert np.allclose(
        [c.fstop, c.blades, c.blade_rotation, c.aperture_ratio, c.focus_distance], [1.4, 6, 0.5, 2, 7]
    )
    dof.focus_object = b.add("target", location=(3, 4, -5))
    assert export()[0].camera.focus_distance == pytest.approx(5.0)


def test_orthographic_camera_and_another_camera(scene):
    other = b.add("other", bpy.data.cameras.new("o"), location=(0, 0, 9))
    other.data.type, other.data.ortho_scale = "ORTHO", 4
    assert export()[0].camera.name == "cam"
    c = export(camera=other)[0].camera
    assert (c.kind, c.ortho_scale, c.name) == ("ORTHOGRAPHIC", 4, "other")


def test_cameras_that_cannot_be_rendered_are_named(scene):
    scene.camera.data.type = "PANO"
    result, said = export()
    assert result.camera is None and ("ERROR", "camera 'cam': panoramic cameras are not supported") in said


def test_no_camera(scene):
    scene.camera = None
    said = []
    result = sync.export(bpy.context.evaluated_depsgraph_get(), report=lambda *m: said.append(m))
    assert result.camera is None and ("ERROR", "the scene has no camera") in said


# Lamps


def lamp(kind: str, **values):
    data = bpy.data.lights.new("l", kind)
    for key, value in values.items():
        setattr(data, key, value)
    ob = b.add("lamp", data, location=(1, 2, 3), rotation_euler=(0, 0.5, 0))
    ob.visible_camera = True
    return ob


def test_point_light(scene):
    lamp("POINT", energy=50, exposure=1.5, color=(1, 0.5, 0.25), shadow_soft_size=0.3, use_soft_falloff=False,
         use_shadow=False, normalize=False).visible_glossy = False  # fmt: skip
    (x,) = export()[0].lights
    assert (x.kind, x.power, x.exposure, x.radius) == ("POINT", 50, 1.5, pytest.approx(0.3))
    assert x.color == (1, 0.5, 0.25) and x.visibility == VISIBLE & ~GLOSSY
    assert not (x.soft_falloff or x.cast_shadow or x.normalize)
    assert np.allclose(x.world_from_light[:3, 3], (1, 2, 3))


def test_color_temperature_is_blenders_own(scene):
    ob = lamp("POINT", color=(0.5, 1, 1), use_temperature=True, temperature=3000)
    (x,) = export()[0].lights
    assert np.allclose(x.color, np.array(ob.data.temperature_color) * (0.5, 1, 1))
    assert x.color[0] > 2 * x.color[2]


def test_spot_and_sun(scene):
    lamp("SPOT", spot_size=1.2, spot_blend=0.4, shadow_soft_size=0.1).scale = (2, 2, 2)
    lamp("SUN", energy=3, angle=0.2)
    spot, sun = sorted(export()[0].lights, key=lambda x: x.kind)
    assert (spot.spot_angle, spot.spot_blend) == (pytest.approx(1.2), pytest.approx(0.4))
    assert np.allclose(np.linalg.norm(spot.world_from_light[:3, :3], axis=0), 2)
    assert (sun.kind, sun.power, sun.angle) == ("SUN", 3, pytest.approx(0.2))


@pytest.mark.parametrize(
    ("shape", "sides"), [("SQUARE", (2, 2)), ("RECTANGLE", (2, 0.5)), ("DISK", (2, 2)), ("ELLIPSE", (2, 0.5))]
)
def test_area_light_sides(scene, shape, sides):
    """Sides are those of the light, and scale is in the matrix."""
    lamp("AREA", shape=shape, size=2, size_y=0.5, spread=1.0).scale = (1, 3, 1)
    (x,) = export()[0].lights
    assert (x.shape, x.size_x, x.size_y) == (shape, *sides)
    assert x.spread == pytest.approx(1.0)
    assert np.allclose(np.linalg.norm(x.world_from_light[:3, :3], axis=0), (1, 3, 1))


def test_portals_give_no_light(scene):
    ob = lamp("AREA")
    if not hasattr(ob.data, "cycles"):
        pytest.skip("Cycles is not enabled")
    ob.data.cycles.is_portal = True
    assert export()[0].lights == []


def test_light_nodes(scene):
    ob = lamp("POINT", energy=10)
    if not ob.data.node_tree:
        ob.data.use_nodes = True
    node = next(n for n in ob.data.node_tree.nodes if n.bl_idname == "ShaderNodeEmission")
    node.inputs["Color"].default_value, node.inputs["Strength"].default_value = (0.5, 1, 2, 1), 3
    ob.data.use_nodes = True
    (x,) = export()[0].lights
    assert x.power == 10 and np.allclose(x.color, (1.5, 3, 6))
    noise = ob.data.node_tree.nodes.new("ShaderNodeTexNoise")
    ob.data.node_tree.links.new(noise.outputs[0], node.inputs["Strength"])
    result, said = export()
    (x,) = result.lights
    assert not said and np.allclose(x.color, 1)
    assert {node.kind for node in x.graph.nodes.values()} >= {"emission", "noise_texture"}


def test_lights_that_the_camera_does_not_see(scene):
    lamp("POINT").visible_camera = False
    assert export()[0].lights[0].visibility == VISIBLE & ~CAMERA


# World


def test_world_without_and_with_nodes(scene):
    assert export()[0].world.graph.surface is None
    world = bpy.data.worlds.new("w")
    scene.world = world
    world.use_nodes = True
    background = next(n for n in world.node_tree.nodes if n.bl_idname == "ShaderNodeBackground")
    background.inputs["Color"].default_value = (1, 0.5, 0.25, 1)
    background.inputs["Strength"].default_value = 2
    result = export()[0].world
    from pointmr_engine.shading.program import compile_graph

    assert np.allclose(compile_graph(result.graph).constant_emission, (2, 1, 0.5))
    assert result.name == "w" and result.visibility == VISIBLE and result.sampling == "AUTOMATIC"
    if hasattr(world, "cycles"):
        world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 64
        world.cycles_visibility.camera = False
        result = export()[0].world
        assert (result.sampling, result.map_resolution) == ("MANUAL", 64)
        assert result.visibility == VISIBLE & ~CAMERA


# Settings


@pytest.fixture
def registered(scene):
    blender_addon.register()
    yield bpy.context.scene
    blender_addon.unregister()


def test_settings(registered):
    scene = registered
    render, own = scene.render, scene.pointmr
    render.resolution_x, render.resolution_y, render.resolution_percentage = 641, 480, 50
    render.pixel_aspect_x, render.pixel_aspect_y = 1, 2
    render.film_transparent, render.threads_mode, render.threads = True, "FIXED", 3
    own.method, own.samples, own.seed, own.pixel_filter_type = "CONVENTIONAL", 7, 5, "GAUSSIAN"
    own.filter_width, own.max_bounces, own.glossy_bounces = 2.0, 3, 2
    own.transmission_bounces, own.transparent_max_bounces, own.film_exposure = 1, 4, 1.5
    own.sample_clamp_indirect = 10
    layer = scene.view_layers[0]
    layer.use_pass_normal = layer.use_pass_material_index = layer.use_pass_z = True
    s = sync.settings_from_blender(scene, layer)
    s.validate()
    assert (s.width, s.height, s.pixel_aspect, s.region) == (320, 240, 0.5, None)
    assert (s.method, s.samples, s.seed, s.pixel_filter, s.filter_width) == (
        "conventional",
        7,
        5,
        "gaussian",
        2.0,
    )
    assert (s.max_bounces, s.glossy_bounces, s.transmission_bounces, s.transparent_max_bounces) == (
        3,
        2,
        1,
        4,
    )
    assert (s.film_transparent, s.film_exposure, s.clamp_indirect, s.threads) == (True, 1.5, 10, 3)
    assert s.processes  # there is no window
    assert s.passes == ("combined", "depth", "normal", "material_index")


def test_animated_seed(registered):
    own = registered.pointmr
    own.use_animated_seed = True
    seeds = set()
    for frame in (1, 2, 3):
        registered.frame_set(frame)
        seeds.add(sync.settings_from_blender(registered).seed)
    assert len(seeds) == 3


@pytest.mark.parametrize("border", [(0.25, 0.5, 0.5, 1.0), (0.0, 0.0, 1.0, 1.0), (0.3, 0.3, 0.3, 0.3)])
def test_region_is_blenders(registered, border):
    """The region has the size of the result that Blender itself makes for a cropped render."""
    render = registered.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 101, 77, 100
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_min_y, render.border_max_x, render.border_max_y = border
    s = sync.settings_from_blender(registered)
    s.validate()
    x0, y0, x1, y1 = s.region
    if border[0] == border[2]:
        assert (x1 - x0, y1 - y0) == (1, 1)
        return
    sizes = []

    class Probe(bpy.types.RenderEngine):
        bl_idname, bl_label = "POINTMR_SIZE", "Probe"

        def render(self, depsgraph):
            result = self.get_result()
            sizes.append((result.resolution_x, result.resolution_y))

    bpy.utils.register_class(Probe)
    render.engine = Probe.bl_idname
    bpy.ops.render.render()
    render.engine = "BLENDER_WORKBENCH"
    bpy.utils.unregister_class(Probe)
    assert sizes == [(x1 - x0, y1 - y0)]
    assert x0 == math.floor(border[0] * 101 + 1e-4)
