"""Mirrors that show mirrors: footprints grow from one to the next, and lamps in them are neither dots nor lost."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.closed_forms import curved_mirror
from benchmarks.forward.scenes import look
from pointmr_engine import Camera, Group, Instances, Light, Mesh, Scene, principled, uniform_world
from pointmr_engine.hierarchy.acceleration import build_acceleration
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.multires.lobes.mirror_chains import (
    BLUR,
    CHAOTIC,
    MOST_BLUR,
    OF_GROWTH,
    ROUGHEST,
    WIDE,
    follow_footprints,
)
from pointmr_engine.raytracing.path_arrays import allocate_paths
from pointmr_engine.raytracing.rays import allocate_hits
from pointmr_engine.raytracing.walk import intersect
from pointmr_engine.render import Cache
from pointmr_engine.shading.bsdf.layout import GLASS, LAMBERT, REFLECTION
from pointmr_engine.shading.lobes import allocate
from tests.engine.instanced import sphere
from tests.engine.small_scenes import quad
from tests.engine.test_raytrace_glass import ball
from tests.engine.test_raytrace_light import DARK, image

SIZE = (96, 72)
POLISHED = principled("polished", base_color=(0.9, 0.9, 0.9), roughness=0.0, metallic=1.0)
DULL = principled("dull", base_color=(0.3, 0.3, 0.3), roughness=0.0, metallic=1.0)
PLACE = (-2, -3, 5)  # of what shines


def bulb(radius: float, strength: float) -> Mesh:
    positions, triangles = sphere(12, 24)
    shining = principled(
        "bulb", base_color=(0.0, 0.0, 0.0), emission_color=(1.0, 1.0, 1.0), emission_strength=strength
    )
    return Mesh("bulb", np.float32(radius * positions + np.float32(PLACE)), triangles, materials=(shining,))


def balls(lights, *more: Mesh) -> Scene:
    """Nine polished balls that show each other, on a matt floor."""
    placed = np.tile(np.eye(4)[:3], (9, 1, 1))
    placed[:, :, 3] = [((i % 3 - 1) * 2.2, (i // 3) * 2.2 - 1.0, -0.2) for i in range(9)]
    matt = principled("floor", base_color=(0.6, 0.6, 0.6), roughness=1.0, specular_ior_level=0.0)
    root = Group(
        "root",
        [quad(20.0, -1.2, matt, "floor"), *more],
        [Instances((Group("ball", [ball(POLISHED)]),), placed)],
    )
    return Scene(root, Camera(look((0, -9, 4), (0, 0, -0.2))), lights, uniform_world((0.3, 0.3, 0.3)))


def exact_and_ours(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    cache = Cache()
    exact = [image(scene, cache, SIZE, method="distributed", samples=512, seed=s) for s in range(4)]
    return np.mean(exact, 0), np.array([image(scene, cache, SIZE, seed=s) for s in range(8)])


def error(exact, ours) -> float:
    return float(((ours - exact) ** 2 / (exact**2 + 0.01)).mean())


def test_the_sun_in_mirrors_of_mirrors_is_no_dot():
    exact, ours = exact_and_ours(balls([Light("SUN", look((-2, -3, 7), (0, 0, 0)), power=3.0, angle=0.06)]))
    assert error(exact, ours) < 0.3
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.015)


def test_a_bulb_in_mirrors_of_mirrors_is_no_dot():
    exact, ours = exact_and_ours(balls([], bulb(0.15, 400.0)))
    assert error(exact, ours) < 0.06
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.04)


def test_a_narrow_sun_in_mirrors_of_mirrors_is_neither_lost_nor_a_dot():
    """It takes no cone: light samples alone find it, in mirrors that are as rough as what a path stands for."""
    exact, ours = exact_and_ours(balls([Light("SUN", look((-2, -3, 7), (0, 0, 0)), power=3.0, angle=0.02)]))
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.015)
    assert np.quantile(ours / ours.mean(0), 0.9999) < 5.0


@pytest.mark.parametrize("material", [POLISHED, DULL], ids=["polished", "dull"])
def test_a_curved_mirror_shows_a_bulb_as_bright_as_it_is(material):
    """Where the lobe shares what shines with light samples, these ask the mirror, too."""
    rng, cache = np.random.default_rng(1), Cache()
    root, ratios = Group("root", [ball(material), bulb(0.6, 400.0)]), []
    for _ in range(6):
        eye = tuple(np.array([0.0, -9.0, 4.0]) + rng.uniform(-0.3, 0.3, 3))
        scene = Scene(root, Camera(look(eye, (0, 0, -0.2))), [], DARK)
        exact = np.mean(
            [image(scene, cache, SIZE, method="distributed", samples=256, seed=s).mean() for s in (0, 1)]
        )
        ratios.append(np.mean([image(scene, cache, SIZE, seed=s).mean() for s in (0, 1)]) / exact)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.06)


def followed(
    material_kind: int, radius: float, width: float, growth: float, smooth=True
) -> tuple[float, float, float]:
    """(turned, variance added, blur with 16 cones a pixel) where a path of that width and growth meets a ball.

    It has one lobe, of that kind.
    """
    mesh = ball(POLISHED) if smooth else replace(ball(POLISHED), normals=None)
    placed = np.concatenate([radius * np.eye(3), np.zeros((3, 1))], 1)
    geometry = compile_geometry(
        Scene(
            Group("root", [], [Instances((Group("ball", [mesh]),), placed[None])]),
            curved_mirror.cases()[0].view.camera(),
            [],
            DARK,
        )
    )
    paths, hits, lobes = allocate_paths(1), allocate_hits(1), allocate(1, 1)
    paths.rays.origin[0], paths.rays.direction[0] = (0.0, -3.0 * radius, 0.01), (0.0, 1.0, 0.0)
    paths.rays.t_min[0], paths.rays.t_max[0], paths.rays.visibility[0] = 0.0, np.inf, 255
    paths.rays.skip_triangle[0] = -1
    intersect(build_acceleration(geometry), paths.rays, hits)
    assert hits.triangle[0] >= 0
    paths.state.width[0], paths.state.spread[0] = width - growth * hits.t[0], growth
    lobes.count[0], lobes.kind[0, 0] = 1, material_kind
    turned, chaos, spread = np.zeros((3, 1), np.float32)
    follow_footprints(
        geometry.tables, paths, hits, np.float32([[0.0, -1.0, 0.0]]), lobes, np.ones(1, np.bool_), np.int64(1), 0.5,
        turned, chaos, spread, np.empty((1, 6), np.float32), np.empty((3, 3)),
    )  # fmt: skip
    return float(turned[0]), float(spread[0]), float(chaos[0])


@settings(max_examples=15)
@given(st.floats(0.2, 5.0), st.floats(1e-3, 0.2), st.floats(0.0, 0.3))
def test_mirrors_are_as_rough_as_their_footprints_grow(radius, width, growth):
    turned, added, blur = followed(REFLECTION, radius, width * radius, growth)
    assert blur == 0.0
    assert turned == pytest.approx(width, rel=0.03)
    after = growth + 2.0 * turned
    assert added == pytest.approx(min(OF_GROWTH * after**2, ROUGHEST) if after > WIDE else 0.0, rel=1e-4)


def test_what_shows_nothing_or_does_not_bend_stays():
    assert followed(LAMBERT, 1.0, 0.1, 0.1) == (0.0, 0.0, 0.0)
    assert followed(REFLECTION, 1.0, 0.1, 0.0, smooth=False) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("growth", [0.05, 0.2, 2.0])
def test_glass_stays_clear_and_blurs_lamps_where_it_is_chaotic(growth):
    turned, added, blur = followed(GLASS, 1.0, 0.1, growth)
    assert turned == pytest.approx(0.1, rel=0.03)
    assert added == 0.0
    after = growth + 2.0 * turned
    assert blur == pytest.approx(0.5 * min(BLUR * after, MOST_BLUR) if after > CHAOTIC else 0.0, rel=1e-4)
