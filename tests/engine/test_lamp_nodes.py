"""Lamps whose nodes decide about their light: closed forms, and every method against random rays."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.forward.scenes import look
from pointmr_engine import Group, Light, RenderSettings, Scene, principled, render
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import instance
from tests.engine.light_estimators import lights_of, sampled
from tests.engine.small_scenes import at, from_above, quad
from tests.engine.test_raytrace_glass import ball
from tests.engine.test_raytrace_light import DARK
from tests.engine.test_wide_lamps import GREY, both, tinted, under

POLISHED = principled(base_color=(0.9, 0.8, 0.7), metallic=1.0, roughness=0.15)


def shining(strength: Link, **nodes: Node) -> Graph:
    emission = Node("emission", {"color": (1.0, 0.8, 0.5), "strength": strength})
    return Graph({**nodes, "emission": emission}, surface=Link("emission", "emission"))


def falloff(output: str, strength: float = 1.0) -> Graph:
    return shining(Link("falloff", output), falloff=Node("light_falloff", {"strength": strength}))


def striped() -> Graph:
    """One half of a lamp shines, by its own coordinates."""
    return shining(
        Link("half", "value"),
        place=Node("texture_coordinate"),
        axes=Node("separate_xyz", {"vector": Link("place", "uv")}),
        half=Node("math", {"value": Link("axes", "x"), "value_b": 0.5}, {"operation": "GREATER_THAN"}),
    )


@pytest.mark.parametrize("output, power", [("quadratic", 0), ("linear", 1), ("constant", 2)])
@pytest.mark.parametrize("distance", [0.5, 3.0])
def test_falloffs_are_powers_of_the_distance(output, power, distance):
    light = Light("POINT", at(0, 0, distance), power=4.0 * math.pi, graph=falloff(output, 2.0))
    found = sampled(lights_of([light]), (0, 0, 0), n=4)
    np.testing.assert_allclose(found.radiance[:, 0], 2.0 * distance ** (power - 2), rtol=1e-5)
    np.testing.assert_allclose(found.radiance[:, 1], 0.8 * found.radiance[:, 0], rtol=1e-5)


def test_lamps_that_vary_are_chosen_by_what_they_send():
    """Two lamps of one power, one of which its nodes make a hundred times as bright."""
    lamps = [Light("POINT", at(x, 0, 3), graph=falloff("linear", s)) for x, s in ((-1, 100.0), (1, 1.0))]
    index = sampled(lights_of(lamps), (0, 0, 0)).index
    assert (index == 0).mean() > 0.97


LAMPS = {
    "falloff": Light("AREA", look((0.5, 0, 2.5), (0, 0, 0)), power=30.0, size_x=1.0, graph=falloff("linear")),
    "stripes": Light("AREA", look((0, 0, 2.5), (0, 0, 0)), power=60.0, size_x=1.0, graph=striped()),
    "spot": Light(
        "SPOT", look((0, 0, 3), (0, 0, 0)), power=200.0, radius=0.1, spot_angle=1.2, graph=striped()
    ),
    "sun": Light("SUN", look((2, 0, 3), (0, 0, 0)), power=3.0, angle=0.3, graph=striped()),
}


@pytest.mark.parametrize("name", LAMPS)
@pytest.mark.parametrize("lamps", [1, 3])
def test_cones_see_them_as_random_rays_do(name, lamps):
    """On a floor and on polished metal; three wide ones share rays with the world."""
    light = LAMPS[name]
    more = [replace(light, world_from_light=at(x, 0.3, 0) @ light.world_from_light) for x in range(lamps)]
    metal = instance(Group("ball", [ball(POLISHED)]), at(-0.8, 0, 0.6) @ np.diag([0.5, 0.5, 0.5, 1.0]))
    group = Group("root", [quad(6.0, material=GREY)], [metal])
    exact, ours = both(Scene(group, from_above(5.0), more, DARK), cones=16)
    assert exact.max() > 0.05
    assert ours.mean((0, 1)) == pytest.approx(exact.mean((0, 1)), rel=0.02)
    assert np.abs(ours - exact).mean() < 0.05 * exact.mean()


def test_films_keep_what_nodes_make_of_a_lamp():
    light = replace(LAMPS["falloff"], graph=falloff("constant"))
    film = tinted((0.9, 0.3, 0.1))
    exact, ours = both(under(quad(1.5, z=1.0, material=film), light))
    middle = np.s_[16:20, 22:26]
    np.testing.assert_allclose(ours[middle].mean((0, 1)), exact[middle].mean((0, 1)), rtol=0.03)
    assert np.abs(ours - exact).mean() < 0.03 * exact.mean()


def test_cameras_see_the_stripes():
    """A lamp before the camera shows its bright half alone, in every method that sees lamps."""
    up = at(0, 0, 1) @ np.diag([1.0, -1.0, -1.0, 1.0])
    light = Light("AREA", up, power=math.pi, size_x=1.0, graph=striped())
    scene = Scene(Group("root", [quad(0.1, z=-9.0, material=GREY)]), from_above(4.0), [light], DARK)
    for method in ("distributed", "raytrace"):
        image = render(scene, RenderSettings(48, 36, method=method, samples=16)).passes["combined"]
        lit = image[..., 0] > 0.5
        assert 0 < lit.sum() < 0.2 * lit.size
        columns = np.flatnonzero(lit.any(0))
        assert columns.min() >= 23 or columns.max() <= 24
