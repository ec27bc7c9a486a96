"""Lights that a scene leaves to chance: whoever sends rays meets them, and methods that do not sample them all."""

from dataclasses import replace

import numpy as np
import pytest

from pointmr_engine import Group, Material, Mesh, RenderSettings, Scene, principled, render, uniform_world
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.multires.cone_light import sampled_lights
from pointmr_engine.raytracing.emitter_search import find_emitters
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import CAMERA, DIFFUSE, SHADOW, VISIBLE, Instances, instance
from pointmr_engine.shading.program import compile_graph
from tests.engine.small_scenes import from_above, half_a_sky, quad
from tests.engine.test_raytrace_light import DARK, card, image

GREY = principled(base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0)


def shining(strength: float, sampling: str) -> Material:
    graph = Graph({"e": Node("emission", {"strength": strength})}, surface=Link("e", "emission"))
    return Material("shines", graph, emission_sampling=sampling)


def wall_and_floor(strength: float, sampling: str, turned: bool = False) -> Scene:
    """A shining wall beside a floor that is seen from above."""
    corners = [(-1, 1, 0.1), (1, 1, 0.1), (1, 1, 2), (-1, 1, 2)]
    wall = card("wall", corners[::-1] if turned else corners, shining(strength, sampling))
    return Scene(Group("root", [quad(2.0, material=GREY), wall]), from_above(5.0), [], DARK)


def grid(side: int, material: Material) -> Mesh:
    """A square of side x side cells, two triangles each."""
    y, x = np.mgrid[0 : side + 1, 0 : side + 1].astype(np.float32) / side - 0.5
    corner = np.arange(side)[None, :] + (side + 1) * np.arange(side)[:, None]
    a, b, c, d = corner, corner + 1, corner + side + 2, corner + side + 1
    triangles = (
        np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], -2).reshape(-1, 3).astype(np.int32)
    )
    positions = np.stack([x, y, np.full_like(x, 3.0)], -1).reshape(-1, 3)
    return Mesh("grid", positions, triangles, materials=(material,))


@pytest.mark.parametrize("world", [uniform_world((0.5, 0.7, 1.0)), half_a_sky()])
def test_a_world_that_is_left_to_chance_lights_as_much(world):
    scenes = [
        Scene(Group("root", [quad(2.0, material=GREY)]), from_above(4.0), [], replace(world, sampling=how))
        for how in ("AUTOMATIC", "NONE")
    ]
    sampled, chance = (image(s, cones=4) for s in scenes)
    assert sampled.mean() > 0.1
    np.testing.assert_array_equal(sampled, chance)


@pytest.mark.parametrize(("strength", "sampling"), [(0.4, "AUTO"), (5.0, "NONE")])
@pytest.mark.parametrize("turned", [False, True])
def test_emission_that_is_left_to_chance_lights_as_much(strength, sampling, turned):
    scene = wall_and_floor(strength, sampling, turned)
    exact = image(scene, method="distributed", samples=1024)
    assert exact[:24].mean() > 0.01 * strength
    assert image(scene, cones=4)[:24].mean() == pytest.approx(exact[:24].mean(), rel=0.03)


@pytest.mark.parametrize("turned", [False, True])
def test_sides_that_are_not_sampled_light_as_much(turned):
    ours, both = (image(wall_and_floor(5.0, s, turned), cones=4)[:24].mean() for s in ("FRONT", "FRONT_BACK"))
    assert ours == pytest.approx(both, rel=0.03) and both > 0.05


@pytest.mark.parametrize("bounces", [0, 1])
def test_haze_lights_what_is_near(bounces):
    """What has too many triangles to be a light is found by diffuse rays; nothing else sends any for it."""
    seen = {}
    for side in (64, 128):
        scene = Scene(
            Group("root", [quad(2.0, material=GREY), grid(side, shining(0.4, "NONE"))]),
            from_above(2.0),
            [],
            DARK,
        )
        seen[side] = [image(scene, cones=4, seed=s, diffuse_bounces=bounces).mean() for s in range(2)]
    exact = image(scene, method="distributed", samples=512, diffuse_bounces=bounces)
    assert exact.mean() > 0.005
    assert np.mean(seen[128]) == pytest.approx(exact.mean(), rel=0.03)
    assert np.mean(seen[64]) == pytest.approx(exact.mean(), rel=0.03)


def test_what_is_sampled_is_not_sought_besides():
    for side, rays in ((64, 0), (128, 48 * 36)):
        wall = grid(side, shining(0.4, "NONE"))
        scene = Scene(Group("root", [quad(2.0, material=GREY), wall]), from_above(2.0), [], DARK)
        counters = render(scene, RenderSettings(48, 36, method="raytrace")).stats["counters"]
        assert (counters.get("lobe_rays", 0) > 0) == (rays > 0) and counters.get("lobe_rays", 0) >= rays


def test_haze_is_no_light():
    """What glows faintly and is everywhere would make a light of every leaf; what has few triangles may be a lamp."""
    for side, found in ((64, 2 * 64**2), (128, 0)):
        wall = grid(side, shining(0.2, "NONE"))
        scene = Scene(Group("root", [quad(2.0, material=GREY), wall]), from_above(5.0), [], DARK)
        geometry = compile_geometry(scene)
        programs = [compile_graph(m.graph) for m in geometry.materials]
        assert len(find_emitters(geometry, programs, every=True)[0].path) == found
        assert len(find_emitters(geometry, programs)[0].path) == 0


@pytest.mark.parametrize("times", [1, 3])
def test_a_panel_is_a_light_beside_haze_of_its_material(times):
    """All or none of what a material left to chance was sampled: a glowing floor lost its light to what stood on it."""
    faint = shining(0.2, "AUTO")
    panel, haze = Group("panel", [quad(1.0, 2.0, faint)]), Group("haze", [grid(90, faint)])
    places = np.tile(np.eye(4)[:3], (times, 1, 1))
    root = Group("root", instances=[Instances((haze,), places), Instances((panel,), places)])
    geometry = compile_geometry(Scene(root, from_above(5.0), [], DARK))
    programs = [compile_graph(m.graph) for m in geometry.materials]
    found = len(find_emitters(geometry, programs, every=True)[0].path)
    assert found == (2 * 90**2 + 2 if times == 1 else 2 * times)


def test_a_panel_lights_beside_haze_of_its_material():
    faint = shining(0.4, "AUTO")
    far = instance(
        Group("haze", [grid(128, faint)]), np.array([[1, 0, 0, 400], [0, 1, 0, 0], [0, 0, 1, 0.0]])
    )
    walls = [card("wall", [(-1, 1, 0.1), (1, 1, 0.1), (1, 1, 2), (-1, 1, 2)], faint)]
    scene = Scene(Group("root", [quad(2.0, material=GREY), *walls], [far]), from_above(5.0), [], DARK)
    exact = image(scene, method="distributed", samples=1024)[:24].mean()
    assert exact > 0.004
    assert image(scene, cones=4)[:24].mean() == pytest.approx(exact, rel=0.03)


@pytest.mark.parametrize("sampling", ["AUTO", "NONE"])
def test_a_glow_is_no_light(sampling):
    """Wax that glows by a few hundredths took most of the samples on itself from the flame above it."""
    scene = wall_and_floor(0.05, sampling)
    geometry = compile_geometry(scene)
    programs = [compile_graph(m.graph) for m in geometry.materials]
    assert len(find_emitters(geometry, programs, every=True)[0].path) == 0


def test_lights_are_gathered_once_more_only_where_some_are_left_to_chance():
    for strength, again in ((5.0, False), (0.4, True)):
        cache, scene = Cache(), wall_and_floor(strength, "AUTO")
        image(scene, cache)
        compiled = cache.find(scene, True)
        lights = sampled_lights(scene, compiled.sampler, compiled.lights)
        assert (lights is not compiled.lights) == again == (compiled.sampler.lights is not None)
        assert len(lights.arrays.emitters.path) == 2


@pytest.mark.parametrize("method", ["distributed", "raytrace"])
@pytest.mark.parametrize(("hidden", "blocks"), [(SHADOW, True), (DIFFUSE, False)])
def test_a_world_of_one_colour_is_hidden_by_what_diffuse_rays_meet(method, hidden, blocks):
    """Nobody samples such a world as a light, so that no shadow rays go there."""
    black = principled(base_color=(0.0, 0.0, 0.0), specular_ior_level=0.0)
    lid = instance(Group("lid", [quad(8.0, 0.5, black)]), visibility=VISIBLE & ~CAMERA & ~hidden)
    world = uniform_world((1.0, 1.0, 1.0))
    scene = Scene(Group("root", [quad(2.0, material=GREY)], [lid]), from_above(4.0), [], world)
    light = image(scene, method=method, samples=64)[16:20, 22:26].mean()
    assert light < 0.05 if blocks else light == pytest.approx(0.8, rel=0.01)
