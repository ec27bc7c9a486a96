"""Mirrors, clear glass and cloth whose normals are not those of their surfaces: no cone begins below these."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from benchmarks.forward.scenes import look
from pointmr_engine import Camera, Group, Material, Scene, World, uniform_world
from pointmr_engine.multires.cones.cones import allocate_cones, set_axes, sub_rays
from pointmr_engine.multires.lobes.lobe_paths import begin_cone
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing.path_arrays import allocate_paths
from pointmr_engine.scene.graph import Graph, Link, Node
from tests.engine.small_scenes import quad
from tests.engine.test_raytrace_light import image

angles = st.tuples(st.floats(0.0, 1.45), st.floats(-math.pi, math.pi))


@uncounted
def begin_one(cones, out, d, normal, outward, start, spread, bent):
    set_axes(cones, np.int64(0), normal[0], normal[1], normal[2], d[0], d[1], d[2])
    begin_cone(cones, np.int64(0), out, normal, outward, start[0], start[1], spread[0], spread[1], bent)


def direction(angle) -> np.ndarray:
    """A unit vector by its angle from z, and about z."""
    return np.array(
        [math.sin(angle[0]) * math.cos(angle[1]), math.sin(angle[0]) * math.sin(angle[1]), math.cos(angle[0])]
    )


@given(angles, angles, st.tuples(*[st.floats(0.0, 1.0)] * 2), st.tuples(*[st.floats(-0.5, 0.5)] * 2))
def test_no_sub_ray_begins_below_the_surface(leaves, tilted, start, spread):
    """Nor goes below it from where it begins, unless the cone is a point that sees below it by itself."""
    d, normal = direction(leaves), direction(tilted)
    assume(d @ normal > 0.05)
    paths, cones = allocate_paths(1), allocate_cones(1)
    paths.rays.origin[0], paths.rays.t_min[0], paths.rays.t_max[0] = 0.0, 0.0, np.inf
    paths.rays.visibility[0] = 255
    paths.state.width[0] = 1.0
    begin_one(cones, paths, tuple(d), tuple(normal), (0.0, 0.0, 1.0), start, spread, 0.0)
    origin, along, stretch = sub_rays(cones)
    heights = (origin + (cones.t_min[0] * stretch)[..., None] * along)[..., 2]
    if cones.start.any():
        assert heights.min() > -1e-6 and along[..., 2].min() > -1e-6
    else:
        assert not origin.any()


def all_directions() -> World:
    """A world whose colour tells the direction."""
    nodes = {
        "way": Node("texture_coordinate"),
        "half": Node("vector_math", {"vector": Link("way", "generated"), "vector_b": (0.5, 0.5, 0.5),
                                     "vector_c": (0.5, 0.5, 0.5)}, {"operation": "MULTIPLY_ADD"}),
        "b": Node("background", {"color": Link("half", "vector")}),
    }  # fmt: skip
    return World(Graph(nodes, surface=Link("b", "background")))


def tilted_pane(kind: str, tilt: float) -> Material:
    """Sharp, with one normal all over that is tilted along x."""
    colour = (0.5 + 0.5 * math.sin(tilt), 0.5, 0.5 + 0.5 * math.cos(tilt))
    nodes = {
        "n": Node("normal_map", {"color": colour}, {"space": "WORLD"}),
        "b": Node(kind, {"color": (1.0, 1.0, 1.0), "normal": Link("n", "normal")}),
    }
    if kind not in ("diffuse", "translucent"):
        nodes["b"].inputs["roughness"] = 0.0
    return Material(kind, Graph(nodes, Link("b", "bsdf")))


@pytest.mark.parametrize("view", [0.2, 1.0])
@pytest.mark.parametrize("tilt", [-0.8, 0.2, 0.5, 0.8])
@pytest.mark.parametrize("kind", ["glossy", "refraction"])
def test_tilted_panes_show_what_rays_see(kind, tilt, view):
    """They saw themselves: up to 0.4 of the directions' colours too dark or bright."""
    eye = Camera(look((6 * math.sin(view), 0.0, 6 * math.cos(view)), (0.0, 0.0, 0.0)))
    scene = Scene(Group("root", [quad(40.0, material=tilted_pane(kind, tilt))]), eye, [], all_directions())
    exact = image(scene, size=(24, 18), method="distributed", samples=16)
    for cones in (1, 4):
        assert np.abs(image(scene, size=(24, 18), cones=cones) - exact).max() < 0.02


def cloth(kind: str, tilt: float, even: bool = True) -> Scene:
    """Seen from straight above, under a white world or all_directions."""
    eye = Camera(look((0.0, 0.0, 6.0), (0.0, 0.0, 0.0)))
    world = uniform_world((1.0, 1.0, 1.0)) if even else all_directions()
    return Scene(Group("root", [quad(40.0, material=tilted_pane(kind, tilt))]), eye, [], world)


@pytest.mark.parametrize("tilt", [-0.6, 0.4])
@pytest.mark.parametrize("even", [True, False])
def test_light_through_tilted_cloth_is_what_rays_find(even, tilt):
    """Of a cosine lobe, (1 + cos) / 2 goes through the surface: softened as for samples of lights, it was up to a
    sixth too dark."""
    scene = cloth("translucent", tilt, even)
    exact = image(scene, size=(48, 36), method="distributed", samples=64).mean((0, 1))
    if even:
        assert exact == pytest.approx(0.5 + 0.5 * math.cos(tilt), rel=0.01)
    for cones in (1, 4):
        assert image(scene, size=(48, 36), cones=cones).mean((0, 1)) == pytest.approx(exact, abs=0.012)


@pytest.mark.parametrize(("tilt", "noise"), [(0.0, 1e-6), (0.5, 0.06)])
def test_light_that_cloth_lets_through_is_looked_for_behind_it(tilt, noise):
    """Looked for by the cosine to its surface, on both sides of it, an even world's light varied by 13 and 22 %."""
    light = image(cloth("translucent", tilt), size=(48, 36))[..., 0]
    assert light.std() < noise * light.mean()


@pytest.mark.parametrize("kind", ["diffuse", "translucent"])
@pytest.mark.parametrize("tilt", [-0.6, 0.2, 0.6])
@pytest.mark.parametrize("even", [True, False])
def test_forward_shows_nothing_of_the_world_below_tilted_cloth(even, tilt, kind):
    """It was up to 1.24 times as bright as it is."""
    scene = cloth(kind, tilt, even)
    exact = image(scene, size=(48, 36), method="distributed", samples=64).mean((0, 1))
    ours = image(scene, size=(48, 36), method="forward").mean((0, 1))
    assert ours == pytest.approx(exact, abs=0.03)
