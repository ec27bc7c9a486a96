"""Normals that bumps bend within a footprint: how they differ, and what they show beside random rays."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.forward.scenes import look
from pointmr_engine import (
    Light,
    Material,
    RaytraceSettings,
    RenderSettings,
    Scene,
    render,
    uniform_world,
)
from pointmr_engine.scene.graph import Link, Node
from pointmr_engine.scene.group import Group
from pointmr_engine.scene.texture import Image
from pointmr_engine.shading.bsdf.albedo_tables import load_tables
from pointmr_engine.shading.bsdf.layout import ALPHA_X, BECKMANN, SINGULAR_LOBE, View
from pointmr_engine.shading.bsdf.widening import widen_lobes
from pointmr_engine.shading.footprint_mean import FIRST, normals_at_places, slope_variance
from pointmr_engine.shading.leaves import GLOSSY, Leaf
from pointmr_engine.shading.lobes import allocate, append, reset
from pointmr_engine.shading.program import compile_graph
from tests.engine.small_scenes import from_above, half_a_sky, quad
from tests.engine.test_footprint_mean import BLACK, WHITE, bumpy, plane_points, striped


@given(st.floats(0.01, 0.2), st.integers(0, 100))
def test_the_length_of_mean_normals_tells_how_slopes_vary(deviation, seed):
    slopes = np.random.default_rng(seed).normal(0.0, deviation, (FIRST, 4000, 2))
    normals = np.concatenate([-slopes, np.ones((FIRST, 4000, 1))], 2)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    found = slope_variance(normals.mean(0))
    assert found.mean() == pytest.approx(deviation**2, rel=0.12)


def test_even_normals_have_no_variance():
    assert (slope_variance(np.tile(np.array([[0, 0.6, 0.8]], np.float32), (5, 1))) < 1e-6).all()


# of squared roughness 0.0481 and 0.696, 0.0081 and 0.656 are the lobes' own: so many of them keep their tails
@pytest.mark.parametrize(
    ("roughness", "chance", "beckmann"),
    [(0.0, 0.0, True), (0.3, 0.16, False), (0.3, 0.18, True), (0.9, 0.93, False), (0.9, 0.96, True)],
)
def test_lobes_are_as_wide_as_slopes_vary(roughness, chance, beckmann):
    """Of what is hardly rough itself the normals' distribution is left on most points, which has no long tails."""
    up = np.tile(np.array([[0, 0, 1]], np.float32), (3, 1))
    view = View(up, up, up, np.zeros(3, np.bool_), np.zeros(3, np.bool_))
    out = allocate(3, 1)
    reset(out, view)
    block = np.array([(1, 1, 1, roughness, 0, 0, 0, 0, 0)], np.float32)
    append(out, Leaf(GLOSSY, block), np.arange(3), view, load_tables())
    before, kinds = out.data[:, 0, ALPHA_X].copy(), out.kind[:, 0].copy()
    below, none, chance = np.array([0.02, 0.0], np.float32), np.zeros(2, np.float32), np.full(2, chance)
    widen_lobes(out, np.array([0, 2]), np.zeros(2, np.int32), below, none, chance)
    widen_lobes(out, np.array([0, 2]), np.ones(2, np.int32), below, none, chance)  # of leaves before: no lobe
    assert out.data[0, 0, ALPHA_X] == pytest.approx(np.sqrt(before[0] ** 2 + 0.04), rel=1e-5)
    assert bool(out.kind[0, 0] & BECKMANN) == beckmann and not out.kind[0, 0] & SINGULAR_LOBE
    for k in (1, 2):  # not asked for, and even
        assert out.data[k, 0, ALPHA_X] == before[k] and out.kind[k, 0] == kinds[k]


def test_far_waves_blur_what_they_mirror():
    """A lake under a sky that is white on one side, seen so far that a pixel has many waves: no pixel is one wave's."""
    mirror = Material("waves", bumpy(Node("glossy", {"roughness": 0.02}), scale=10.0))
    scene = Scene(Group("root", [quad(100.0, material=mirror)]), from_above(20.0), [], half_a_sky())
    ours = render(scene, RenderSettings(24, 18, method="raytrace")).passes["combined"][..., 0].astype(float)
    chosen = RenderSettings(24, 18, method="distributed", samples=256)
    exact = render(scene, chosen).passes["combined"][..., 0].astype(float)
    assert 0.2 < exact.mean() < 0.8 and exact.std() > 0.15
    assert ours.mean() == pytest.approx(exact.mean(), abs=0.02)
    assert np.sqrt(((ours - exact) ** 2).mean()) < 0.06  # 0.082 with one wave's normal a fragment


@pytest.mark.parametrize("roughness", [0.05, 0.2])
def test_jagged_ground_is_as_bright_as_its_facets(roughness):
    """Of steep bumps no lobe about the mean normal is like theirs, a part of which ends below the ground."""
    graph = bumpy(Node("glossy", {"roughness": roughness}), scale=25.0, distance=1.0)
    ground = quad(100.0, material=Material("jagged", graph))
    scene = Scene(Group("root", [ground]), from_above(20.0), [], half_a_sky())
    ours = render(scene, RenderSettings(24, 18, method="raytrace")).passes["combined"][..., 0]
    chosen = RenderSettings(24, 18, method="distributed", samples=256)
    exact = render(scene, chosen).passes["combined"][..., 0]
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.06)


@pytest.mark.parametrize(("distance", "roughness", "tilt"), [(0.05, 0.1, 0.6), (0.1, 0.3, 1.2)])
def test_bumps_do_not_show_small_lamps_where_no_bump_mirrors_them(distance, roughness, tilt):
    """Slopes of bumps end: tails of one lobe for all of them were 36 and 55 % too bright there."""
    waves = bumpy(Node("glossy", {"roughness": roughness}), scale=10.0, distance=distance)
    sun = Light("SUN", look((0, -math.sin(tilt), math.cos(tilt)), (0, 0, 0)), power=3.0, angle=0.1)
    floor = quad(100.0, material=Material("waves", waves))
    scene = Scene(Group("root", [floor]), from_above(20.0), [sun], uniform_world(BLACK))

    def brightness(**values) -> float:
        return render(scene, RenderSettings(48, 36, **values)).passes["combined"][..., 0].mean()

    exact = brightness(method="distributed", samples=512)
    assert brightness(method="raytrace") == pytest.approx(exact, rel=0.25)


@pytest.mark.parametrize("cones", [1, 4])
@pytest.mark.parametrize(
    ("shader", "distance", "bound"),
    [(Node("diffuse"), 0.02, 0.04), (Node("glossy", {"roughness": 0.2}), 0.005, 0.12)],
)
def test_steep_bumps_of_images_shade_the_ground_as_they_are(shader, distance, bound, cones):
    """The pyramid's mean of the heights is flat: matt ground was 10 % too bright under a high sun.

    Slopes from heights at a point to such means lean, and are less steep: what is glossy was 16 % too bright.
    """
    heights = np.random.default_rng(8).random((64, 64, 1)) * np.ones(4)
    rough = striped(("b", Node("bump", {"height": Link("t", "color"), "distance": distance})))
    rough.nodes["t"].params["image"] = Image("heights", heights.astype(np.float32), "Linear")
    rough.nodes["d"] = dataclasses.replace(
        shader, inputs=shader.inputs | {"color": WHITE, "normal": Link("b", "normal")}
    )
    sun = Light("SUN", look((0, -1, 4), (0, 0, 0)), power=3.0)
    ground = quad(100.0, material=Material("rough", rough))
    scene = Scene(Group("root", [ground]), from_above(20.0), [sun], uniform_world(BLACK))

    def brightness(**values) -> float:
        return render(scene, RenderSettings(96, 72, **values)).passes["combined"][..., 0].mean()

    exact = brightness(method="distributed", samples=64)
    assert brightness(method="raytrace", raytrace=RaytraceSettings(cones=cones)) == pytest.approx(
        exact, rel=bound
    )


def test_places_beyond_a_triangle_have_the_normal_of_its_middle():
    """Normals of a smooth triangle go on anywhere outside it: a car's coarse shell was taken for a rough one."""
    points, seen = plane_points(np.random.default_rng(6).random((50, 2)), 0.1), []
    points.normal = points.smooth_normal = points.geometric_normal
    points.tangents = {"": np.tile(np.array([[1, 0, 0, 1]], np.float32), (50, 1))}

    def moved(offset, needs, narrower, bump):
        there = points.repeated(len(offset) // 50)
        astray = np.random.default_rng(7).normal(size=(len(offset), 3)).astype(np.float32)
        there.normal = there.smooth_normal = astray
        there.tangents = {"": np.concatenate([astray, astray[:, :1]], 1)}
        return there

    points.moved = moved

    def run(there):
        seen.append((there.normal, there.smooth_normal, there.tangents[""]))
        return {"normal": there.normal}

    normals_at_places(run, lambda rows: points, np.arange(50), frozenset({"normal"}))
    for found, own in zip(seen[0], (points.normal, points.normal, points.tangents[""]), strict=True):
        np.testing.assert_array_equal(found, np.tile(own, (FIRST, 1)))


@pytest.mark.parametrize("cones", [1, 16])
def test_bumps_are_differenced_over_a_pixel_whatever_a_cone_is(cones):
    """As Cycles does it: steps of a cone's width would bring out waves that its step passes over."""
    program = compile_graph(bumpy(Node("glossy", {"roughness": 0.1}), scale=4.0))
    points = plane_points(np.random.default_rng(5).random((200, 2)), 0.1)
    points.normal = points.geometric_normal
    wide = program.normal_values(points).popitem()[1]
    narrow = plane_points(points.position[:, :2], 0.1 / cones)
    narrow.normal, narrow.footprints = narrow.geometric_normal, float(cones)
    np.testing.assert_allclose(program.normal_values(narrow).popitem()[1], wide, atol=1e-4)


@pytest.mark.parametrize("anisotropy", [0.0, 0.6])
@pytest.mark.parametrize("distance", [0.01, 0.05])
def test_bumps_keep_the_tails_of_their_gloss(anisotropy, distance):
    """A sun far from where it is mirrored shines in them, however what bends the normals blurs the peak."""
    gloss = Node("glossy", {"roughness": 0.3, "anisotropy": anisotropy})
    ground = quad(100.0, material=Material("bumps", bumpy(gloss, scale=10.0, distance=distance)))
    sun = Light("SUN", look((0, -math.sqrt(0.75), 0.5), (0, 0, 0)), power=3.0)
    scene = Scene(Group("root", [ground]), from_above(20.0), [sun], uniform_world(BLACK))

    def light(method: str) -> float:
        return (
            render(scene, RenderSettings(48, 36, method=method, samples=64)).passes["combined"][..., 0].mean()
        )

    assert light("raytrace") == pytest.approx(light("distributed"), rel=0.08)


def test_a_hole_elsewhere_leaves_fine_bumps_as_they_are():
    """Materials with holes are read at single places where these are, and averaged as others everywhere else."""

    def light(holed: bool) -> float:
        graph = bumpy(Node("glossy", {"roughness": 0.2}), scale=60.0, distance=0.05)
        if holed:
            graph.nodes |= {
                "there": Node("geometry"),
                "axes": Node("separate_xyz", {"vector": Link("there", "position")}),
                "hole": Node(
                    "math", {"value": Link("axes", "x"), "value_b": 25.0}, {"operation": "GREATER_THAN"}
                ),
                "clear": Node("transparent"),
                "mix": Node(
                    "mix_shader",
                    {
                        "fac": Link("hole", "value"),
                        "shader": graph.surface,
                        "shader_b": Link("clear", "bsdf"),
                    },
                ),
            }
            graph.surface = Link("mix", "shader")
        ground = quad(100.0, material=Material("bumps", graph))
        sun = Light("SUN", look((0, -math.sqrt(0.5), math.sqrt(0.5)), (0, 0, 0)), power=3.0)
        scene = Scene(Group("root", [ground]), from_above(20.0), [sun], uniform_world(BLACK))
        return render(scene, RenderSettings(48, 36, method="raytrace")).passes["combined"][..., 0].mean()

    assert light(True) == pytest.approx(light(False), rel=0.02)
