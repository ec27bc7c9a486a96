"""Light of method "raytrace" where samples meet distributions: clumps, shadows' edges, lobes beside light samples."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.forward.scenes import forest, look
from pointmr_engine import (
    Camera,
    Group,
    Light,
    Material,
    Mesh,
    RenderSettings,
    Scene,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.forward.drawing.subpixel_places import subpixel_places
from pointmr_engine.multires.fragments.merge import choose_seen
from pointmr_engine.multires.lobes.lobe_cones import lobe_pdf
from pointmr_engine.multires.lobes.lobe_rays import MOST, rays_of
from pointmr_engine.multires.paths.shadow_edges import LARGE, find_edges
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.settings import RaytraceSettings
from tests.engine.small_scenes import from_above, lit_floor, quad

PLACES = subpixel_places(8)
DARK = uniform_world((0.0, 0.0, 0.0))
SUN = Light("SUN", look((-2, -3, 7), (0, 0, 0)), power=4.5, angle=0.0)


def image(scene, cache=None, size=(48, 36), cones=1, **settings) -> np.ndarray:
    """(height, width, 3) float64."""
    chosen = RenderSettings(
        *size, **{"method": "raytrace", "raytrace": RaytraceSettings(cones=cones)} | settings
    )
    return render(scene, chosen, cache=cache).passes["combined"][..., :3].astype(float)


def card(name: str, corners, material) -> Mesh:
    """Two triangles between four corners."""
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
    return Mesh(name, np.array(corners, np.float32), triangles, materials=(material,))


# Clumps


@pytest.mark.parametrize("angle", [0.0, 0.2])
def test_suns_on_far_foliage_bring_as_much_as_in_the_exact_image(angle):
    """A wide sun's shadow and the normals of leaves do not vary by themselves: their means' product is 1.3 times it."""
    flight = forest(400)
    scene = Scene(flight.root, flight.cameras[5], [replace(SUN, angle=angle)], DARK)
    cache = Cache()
    exact = image(scene, cache, method="distributed", samples=256)
    ours = np.mean([image(scene, cache, seed=s) for s in range(4)], 0)
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.05)


@given(st.integers(1, 5), st.integers(0, 1000), st.integers(0, 1000))
def test_the_subpixel_that_stands_for_a_fragment_shows_it(count, left, low):
    rng = np.random.default_rng(count)
    ids = rng.integers(-1, count, (12, 16)).astype(np.int32)
    seen, times = np.full((count, 2), -1, np.float32), np.empty(count, np.int32)
    choose_seen(
        ids, np.int64(16), np.int64(12), np.int64(left), np.int64(low), PLACES, np.int64(count), times, seen
    )
    for k in range(count):
        if (ids == k).any():
            x, y = int(seen[k, 0]), int(seen[k, 1])
            assert ids[y, x] == k
            assert seen[k].tolist() == [x + 0.5 + PLACES[1, y & 7], y + 0.5 + PLACES[0, x & 7]]


def test_all_subpixels_of_a_fragment_may_stand_for_it():
    ids, chosen = np.zeros((4, 4), np.int32), np.zeros((4, 4))
    seen, times = np.empty((1, 2), np.float32), np.empty(1, np.int32)
    for left in range(0, 8000, 4):
        choose_seen(
            ids, np.int64(4), np.int64(4), np.int64(left), np.int64(0), PLACES, np.int64(1), times, seen
        )
        chosen[int(seen[0, 1]), int(seen[0, 0])] += 1
    assert abs(chosen - 125.0).max() < 5.0 * math.sqrt(125.0)


# Edges of shadows


def edges(
    light, pixel=(0, 1, 5), open_light=(1.0, 1.0, 1.0), subpixels=(64, 64, 64), beam=False
) -> list[bool]:
    """Of three fragments in a tile of 1 x 6 pixels."""
    edge, low, high = np.empty(3, np.bool_), np.empty((1, 6)), np.empty((1, 6))
    find_edges(
        np.array(pixel), (1, 6), np.array(open_light), np.array(light), np.array(subpixels), beam, np.int64(3), low,
        high, edge,
    )  # fmt: skip
    return edge.tolist()


def test_edges_lie_between_neighbours_that_differ():
    assert edges((1.0, 0.0, 0.0)) == [True, True, False]  # the third has no neighbour
    assert edges((1.0, 1.0, 0.0)) == [False, False, False]
    assert edges((1.0, 0.0, 0.0), pixel=(0, 5, 5)) == [False, False, False]
    assert edges((1.0, 0.0, 0.0), subpixels=(64, LARGE - 1, 64)) == [True, False, False]
    assert edges((1.0, 0.0, 0.0), open_light=(1.0, 0.0, 1.0)) == [False, False, False]  # it faces away


def test_what_a_beam_missed_by_chance_lies_at_an_edge_as_what_it_met():
    met, missed = (1.0, 0.0, 0.0), (1.0, 1.0, 0.0)
    found = edges(met, pixel=(0, 1, 1), open_light=missed, beam=True)
    assert found == [True, True, True]
    assert edges(met, pixel=(0, 1, 1), open_light=missed) == [True, True, False]


@pytest.mark.parametrize("shape", ["DISK", "SQUARE"])
def test_shadows_in_a_beam_are_as_bright_as_by_random_rays(shape):
    """A part of the lamp shines on each point of a floor under bars: the rim of its light, and shadows in it."""
    lamp = Light("AREA", look((0, 0, 4), (0, 0, 0)), shape=shape, size_x=0.8, size_y=0.8, power=100.0,
                 spread=math.radians(25))  # fmt: skip
    scene = replace(fence(), lights=[lamp])
    exact = image(scene, method="distributed", samples=512)
    ours = np.mean([image(scene, seed=s) for s in range(8)], 0)
    rim = (exact.mean(-1) < 0.3 * exact.max()) & (exact.mean(-1) > 0.01 * exact.max())
    assert rim.sum() > 50
    assert ours[rim].mean() == pytest.approx(exact[rim].mean(), rel=0.03)


def fence() -> Scene:
    """A floor in the shadow of bars far thinner than what a pixel shows of it."""
    dark = principled("bar", base_color=(0.1, 0.1, 0.1), specular_ior_level=0.0)
    bars = [
        card("bar", [(x, -9, 2), (x + 0.05, -9, 2), (x + 0.05, 9, 2), (x, 9, 2)], dark)
        for x in np.arange(-6.0, 6.0, 0.1)
    ]
    floor = quad(6.0, material=principled("floor", base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0))
    return Scene(Group("root", [floor, *bars]), Camera(look((0, -7, 1.5), (0, 0, 0))), [SUN], DARK)


def test_thin_shadows_are_met_by_more_rays_where_they_are():
    scene, cache = fence(), Cache()
    exact = image(scene, cache, method="distributed", samples=256)
    ours = image(scene, cache)
    lit = exact[:18].mean()  # rows of the floor
    assert ours[:18].mean() == pytest.approx(lit, rel=0.03)
    assert math.sqrt(((ours - exact)[:18] ** 2).mean()) < 0.2 * lit  # four rays a pixel would have 0.28
    settings = RenderSettings(48, 36, method="raytrace")
    assert render(scene, settings, cache=cache).stats["counters"]["edge_rays"] > 0


def test_without_edges_no_more_rays_are_sent():
    plain = replace(lit_floor(), lights=[SUN])
    found = render(plain, RenderSettings(48, 36, method="raytrace")).stats["counters"]
    assert found["shadow_rays"] > 0 and found.get("edge_rays", 0) == 0


# Lobes and light samples

density = lobe_pdf.py_func  # kernels call it, Python cannot


@given(st.floats(0.02, 1.0), st.floats(0.0, 1.5), st.floats(0.0, 1.5))
def test_a_lobes_density_is_positive_above_the_surface_alone(alpha, incoming, outgoing):
    wi = (math.sin(incoming), 0.0, math.cos(incoming))
    above = (math.sin(outgoing) * 0.6, math.sin(outgoing) * 0.8, math.cos(outgoing))
    below = (above[0], above[1], -max(above[2], 1e-3))
    assert density(alpha * alpha, (0.0, 0.0, 1.0), wi, above) > 0.0
    assert density(alpha * alpha, (0.0, 0.0, 1.0), wi, below) == 0.0


@pytest.mark.parametrize("alpha", [0.1, 0.3, 0.7])
def test_a_lobes_density_integrates_to_what_it_sends_up(alpha):
    """Seen along the normal: of the microfacets' area, those steeper than 45 degrees reflect below the horizon."""
    n = 400
    u, v = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n)
    z, phi = u.ravel() ** 4, 2.0 * math.pi * v.ravel()  # dense towards the horizon's other end
    z = 1.0 - z
    r = np.sqrt(1.0 - z * z)
    total = sum(
        density(alpha * alpha, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (a, b, c)) * w
        for a, b, c, w in zip(r * np.cos(phi), r * np.sin(phi), z, 4.0 * u.ravel() ** 3, strict=True)
    )
    total *= 2.0 * math.pi / n**2
    # tan h < 1 of GGX: 1 / (1 + alpha^2)
    assert total == pytest.approx(1.0 / (1.0 + alpha * alpha), rel=0.01)


def flame(roughness: float, side: float) -> Scene:
    """A glossy floor below a small square that shines, which it mirrors."""
    shining = principled("flame", emission_color=(1.0, 0.5, 0.2), emission_strength=40.0 / side**2)
    floor = quad(8.0, material=principled("floor", base_color=(0.2, 0.2, 0.2), roughness=roughness))
    corners = [(-side, 2, 1 - side), (side, 2, 1 - side), (side, 2, 1 + side), (-side, 2, 1 + side)]
    lamp = card("flame", corners, shining)
    return Scene(Group("root", [floor, lamp]), Camera(look((0, -4, 1.2), (0, 0, 0.2))), [], DARK)


@pytest.mark.parametrize("roughness", [0.3, 0.5, 0.8])
@pytest.mark.parametrize("side", [0.03, 0.4])
def test_what_shines_is_counted_once(roughness, side):
    """Lobes meet a lamp, and light samples find it: together they bring what each would bring alone."""
    scene, cache = flame(roughness, side), Cache()
    exact = np.mean([image(scene, cache, method="distributed", samples=256, seed=s) for s in range(2)], 0)
    ours = np.mean([image(scene, cache, seed=s) for s in range(6)], 0)
    floor = np.s_[:14]
    assert ours[floor].mean() == pytest.approx(exact[floor].mean(), rel=0.03)


def test_small_flames_do_not_glitter():
    """The brightest pixel of a rough floor is hardly brighter than in the exact image."""
    scene, cache = flame(0.5, 0.03), Cache()
    exact = image(scene, cache, method="distributed", samples=512)[:14]
    ours = np.stack([image(scene, cache, seed=s)[:14] for s in range(4)])
    assert ours.max() < 2.0 * exact.max()


def test_rough_metal_is_as_dark_as_what_it_faces():
    """A wall of car paint over a dark floor, under lamps that shine and a bright sky: wide lobes see all of them."""
    paint = principled("paint", base_color=(0.8, 0.1, 0.03), metallic=1.0, roughness=0.55)
    dark = principled("dark", base_color=(0.02, 0.02, 0.02), specular_ior_level=0.0)
    shining = principled("shining", emission_color=(1.0, 1.0, 1.0), emission_strength=5.0)
    wall = card("wall", [(-2, 0, 0), (2, 0, 0), (2, 0, 2), (-2, 0, 2)], paint)
    lamps = [
        card(f"lamp {k}", [(x, -3, 5), (x + 1.5, -3, 5), (x + 1.5, 1, 5), (x, 1, 5)], shining)
        for k, x in enumerate((-4.0, -1.0, 2.0))
    ]
    camera = Camera(look((0, -4, 1.5), (0, 0, 0.9)))
    scene = Scene(
        Group("root", [quad(20.0, material=dark), wall, *lamps]), camera, [], uniform_world((0.4, 0.4, 0.5))
    )
    cache = Cache()
    exact = np.mean([image(scene, cache, method="distributed", samples=256, seed=s) for s in range(2)], 0)
    ours = np.mean([image(scene, cache, seed=s) for s in range(4)], 0)
    low, high = np.s_[10:16, 10:-10], np.s_[22:28, 10:-10]
    for part in (low, high):
        assert ours[part].mean() == pytest.approx(exact[part].mean(), rel=0.04)


@pytest.mark.parametrize("count", [1, 5])  # a cone for each, and rays to one of many
def test_metal_shows_the_lamps_of_a_mirror(count):
    """Behind a lobe's cone or ray a mirror is a narrow lobe, whose lamps light samples find as well."""
    mirror = principled("mirror", base_color=(0.95, 0.95, 0.95), metallic=1.0, roughness=0.0)
    metal = principled("metal", base_color=(0.8, 0.8, 0.8), metallic=1.0, roughness=0.15)
    wall = card("wall", [(-3, 2, -1), (3, 2, -1), (3, 2, 3), (-3, 2, 3)], mirror)
    lamps = [
        Light("AREA", look((x, -3, 1.5), (x, 2, -0.6)), power=20.0, size_x=0.3, size_y=0.3)
        for x in np.linspace(-2.0, 2.0, count) * (count > 1)
    ]
    camera = Camera(look((0, -1.5, 0.8), (0, 2, -0.2)))
    scene = Scene(Group("root", [quad(8.0, -0.1, metal, "floor"), wall]), camera, lamps, DARK)
    cache, floor = Cache(), slice(12, 20)
    exact = np.mean([image(scene, cache, method="distributed", samples=512, seed=s) for s in range(2)], 0)
    ours = np.mean([image(scene, cache, seed=s) for s in range(16)], 0)  # each is off by a tenth
    assert ours[floor].mean() == pytest.approx(exact[floor].mean(), rel=0.08)


# Rays of lobes


def test_lobes_that_carry_much_take_several_rays_and_small_fragments_one():
    assert [rays_of.py_func(np.float64(t), False) for t in (0.001, 0.04, 0.9)] == [1, 2, MOST]
    assert rays_of.py_func(np.float64(0.9), True) == 1


def test_rays_of_a_lobe_share_what_it_carries():
    """A rough metal floor under a sky that shines on one side: as bright as by random rays, at four rays each."""
    metal = principled("metal", base_color=(0.9, 0.9, 0.9), metallic=1.0, roughness=0.6)
    shining = principled("shining", emission_strength=3.0, emission_color=(1.0, 1.0, 1.0))
    wall = card("wall", [(-6, 3, 0), (6, 3, 0), (6, 3, 6), (-6, 3, 6)], shining)
    camera = Camera(look((0, -3, 2), (0, 0, 0)))
    scene = Scene(Group("root", [quad(5.0, material=metal), wall]), camera, [], DARK)
    cache = Cache()
    exact = image(scene, cache, method="distributed", samples=256)
    frame = render(scene, RenderSettings(48, 36, method="raytrace"), cache=cache)
    sent = frame.stats["counters"]
    assert sent["lobe_rays"] > 2 * sent["fragments"]
    ours = np.mean([image(scene, cache, seed=s) for s in range(6)], 0)
    floor = np.s_[4:20, 8:-8]
    assert ours[floor].mean() == pytest.approx(exact[floor].mean(), rel=0.02)


# Diffuse light behind glossy lobes


@pytest.mark.parametrize("glass", [0.0, 0.65])
def test_glossy_paths_carry_as_much_diffuse_light_as_random_ones(glass):
    """Walls of a corner see each other by their gloss alone, but what it brings is reflected diffusely, too."""
    wall = principled("wall", base_color=(0.2, 0.8, 0.3), roughness=0.5, transmission_weight=glass)
    corner = [
        card("left", [(0, 0, -1), (0, 0, 1), (-1, -1, 1), (-1, -1, -1)], wall),
        card("right", [(0, 0, -1), (1, -1, -1), (1, -1, 1), (0, 0, 1)], wall),
    ]
    camera = Camera(look((0.0, -4.0, 0.0), (0.0, 0.0, 0.0)))
    scene = Scene(Group("root", corner), camera, [replace(SUN, cast_shadow=False)], DARK)
    cache = Cache()
    exact = np.mean(
        [image(scene, cache, method="distributed", samples=256, seed=s) for s in range(2)], 0
    ).mean((0, 1))
    ours = np.mean([image(scene, cache, seed=s) for s in range(8)], 0).mean((0, 1))
    np.testing.assert_allclose(ours, exact, rtol=0.004)


# What passes leaves


def leaf(color, z: float, size: float = 40.0) -> Mesh:
    """A sheet that scatters light through, and nothing back."""
    node = Node("translucent", {"color": color})
    return quad(size, z, Material("leaf", Graph({"t": node}, surface=Link("t", "bsdf"))), f"leaf at {z}")


@pytest.mark.parametrize("leaves", [1, 2])
def test_light_from_the_floor_shines_through_leaves(leaves):
    """A lamp below leaves lights the floor, which lights them from below: that counts as transmission, and bounces."""
    below = np.eye(4)
    below[2, 3] = -0.5
    lamp = Light("SPOT", below, power=100.0, spot_angle=2.0, radius=0.1)
    floor = quad(20.0, -2.0, principled("floor", base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0))
    sheets = [leaf((0.3, 0.6, 0.1), 0.25 * k) for k in range(leaves)]
    scene = Scene(Group("root", [floor, *sheets]), from_above(), [lamp], DARK)
    exact = image(scene, method="distributed", samples=1024).mean((0, 1))
    ours = np.mean([image(scene, seed=s) for s in range(8)], (0, 1, 2))
    assert exact.min() > 0.0
    np.testing.assert_allclose(ours, exact, rtol=0.05)


def test_the_world_shines_through_a_leaf_once():
    """Light samples find it: the rays that go on do not."""
    scene = Scene(
        Group("root", [leaf((0.3, 0.6, 0.1), 0.0, 2.0)]), from_above(), [], uniform_world((1.0, 1.0, 1.0))
    )
    mean = np.mean([image(scene, seed=s)[12:-12, 18:-18] for s in range(4)], (0, 1, 2))
    np.testing.assert_allclose(mean, (0.3, 0.6, 0.1), rtol=0.02)
