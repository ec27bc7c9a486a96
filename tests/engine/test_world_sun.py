"""The world's sun as a lamp: found where there is one, of its own light, and seen in metal as in the world itself."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from benchmarks.forward.scenes import look
from pointmr_engine import Camera, Group, Scene, World, principled
from pointmr_engine.raytracing.environment import Environment
from pointmr_engine.raytracing.world_sun import WIDEST, bright_disc
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import CAMERA, DIFFUSE, GLOSSY
from tests.engine.small_scenes import quad, sky_with_a_sun
from tests.engine.test_raytrace_glass import ball
from tests.engine.test_raytrace_light import image

HEIGHT = 512
ANGLE = (np.arange(HEIGHT) + 0.5) * (math.pi / HEIGHT)
SOLID_ANGLE = np.diff(-np.cos(np.linspace(0.0, math.pi, HEIGHT + 1))) * (math.pi / HEIGHT)


def directions() -> np.ndarray:
    """(HEIGHT, 2 HEIGHT, 3) of a world map's texels."""
    azimuth = (np.arange(2 * HEIGHT) + 0.5) * (math.pi / HEIGHT) - math.pi
    a, z = np.meshgrid(azimuth, ANGLE)
    return np.stack([np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), -np.cos(z)], -1)


def discs(sky: float, *suns: tuple[np.ndarray, float, float]) -> np.ndarray:
    """Texels of a sky with discs: (direction, half angle, share of the sky's light)."""
    weight = np.full((HEIGHT, 2 * HEIGHT), sky)
    for direction, half, share in suns:
        weight[directions() @ direction > math.cos(half)] += share * 2.0 * sky / (1.0 - math.cos(half))
    return weight.astype(np.float32)


def unit(z: float, azimuth: float) -> np.ndarray:
    flat = math.sqrt(max(1.0 - z * z, 0.0))
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), z])


def sky_texture(**values) -> World:
    nodes = {
        "sky": Node("sky_texture", params={"sun_elevation": 0.6, "sun_rotation": 2.4} | values),
        "b": Node("background", {"color": Link("sky", "color"), "strength": 0.05}),
    }
    return World(Graph(nodes, surface=Link("b", "background")))


@settings(deadline=None, max_examples=30)
@given(st.floats(-1.0, 1.0), st.floats(0.0, 6.28), st.floats(0.01, 0.04), st.floats(0.5, 20.0))
@example(0.99952, 0.0, 0.03125, 1.0)  # beside the pole, where texels are small
def test_discs_are_found_wherever_they_stand(z, azimuth, half, share):
    direction = unit(z, azimuth)
    found = bright_disc(discs(1.0, (direction, half, share)), SOLID_ANGLE)
    assert found is not None
    middle, reach = found
    step = math.pi / HEIGHT
    assert np.linalg.norm(middle - direction) < step
    assert half - step < reach < half + 3.0 * step


def test_what_is_no_sun_is_none():
    """An even sky; a disc of little light; one among many; one whose shape mirrors would show."""
    up = unit(0.7, 1.0)
    assert bright_disc(discs(1.0), SOLID_ANGLE) is None
    assert bright_disc(discs(1.0, (up, 0.02, 0.05)), SOLID_ANGLE) is None
    many = [(unit(0.5, a), 0.02, 1.0) for a in range(6)]
    assert bright_disc(discs(1.0, *many), SOLID_ANGLE) is None
    assert bright_disc(discs(1.0, (up, 2.0 * WIDEST, 5.0)), SOLID_ANGLE) is None


@pytest.mark.parametrize(
    "world",
    [
        sky_texture(sun_size=0.02),
        sky_texture(sky_type="SINGLE_SCATTERING"),
        sky_with_a_sun(0.9995, 600.0, 0.3, "x"),
    ],
)
def test_a_world_without_its_sun_and_the_lamp_are_the_world(world):
    """The disc's light, limb darkening and all, is the lamp's; its place has the radiance around; cameras see it."""
    environment = Environment(world)
    sun, without = environment.sun, environment.without_sun()
    half = math.acos(1.0 - sun.reach)
    rng = np.random.default_rng(4)
    away, turn = half * np.sqrt(rng.random(40000)), 2.0 * math.pi * rng.random(40000)
    side = np.cross(sun.direction, (0.3, 0.5, -0.8))
    side /= np.linalg.norm(side)
    flat = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(sun.direction, side)
    d = np.cos(away)[:, None] * sun.direction + np.sin(away)[:, None] * flat
    more = (environment.radiance(d, GLOSSY) - without.radiance(d, GLOSSY)).astype(np.float64)
    irradiance = more.mean(0) * math.pi * math.sin(half) ** 2
    assert np.array(sun.light.color) * sun.light.power == pytest.approx(irradiance, rel=0.02)
    assert np.ptp(without.radiance(d, DIFFUSE), 0).max() < 0.05 * without.radiance(d, DIFFUSE).mean()
    np.testing.assert_array_equal(without.radiance(d, CAMERA), environment.radiance(d, CAMERA))
    assert without.sun is None and without.map.sun[4] == 0.0
    assert without.map.irradiance < environment.map.irradiance - 0.1 * irradiance.mean()


def test_worlds_that_differ_from_ray_to_ray_keep_their_sun():
    """What glossy rays see without a sun must not have one by a lamp."""
    world = sky_texture(sun_size=0.02)
    nodes = world.graph.nodes
    nodes["path"] = Node("light_path")
    nodes["b"] = Node(
        "background", {"color": Link("sky", "color"), "strength": Link("path", "is_glossy_ray")}
    )
    assert Environment(world).sun is None


@pytest.mark.parametrize("roughness", [0.15, 0.4])
def test_metal_shows_the_sun_of_a_sky(roughness):
    """It was lost, and with it seven tenths of a ball's light."""
    metal = principled("metal", base_color=(0.8, 0.8, 0.8), metallic=1.0, roughness=roughness)
    floor = quad(12.0, -1.05, principled("floor", base_color=(0.5, 0.5, 0.5), roughness=0.9), "floor")
    scene = Scene(
        Group("root", [ball(metal), floor]), Camera(look((0, -6, 2), (0, 0, -0.2))), [], sky_texture()
    )
    cache = Cache()
    exact = np.mean([image(scene, cache, method="distributed", samples=256, seed=s) for s in range(2)], 0)
    ours = np.mean([image(scene, cache, seed=s) for s in range(4)], 0)
    ball_of, floor_of = np.s_[12:26, 16:32], np.s_[2:10]
    assert ours[ball_of].mean() == pytest.approx(exact[ball_of].mean(), rel=0.03)
    assert ours[floor_of].mean() == pytest.approx(exact[floor_of].mean(), rel=0.01)
    assert np.abs(ours - exact)[floor_of].mean() < 0.02 * exact[floor_of].mean()
