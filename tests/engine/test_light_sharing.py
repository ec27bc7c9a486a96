"""Fragments that share what they receive: means where it is the same, nothing where it is not, and no more of it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.closed_forms.stage import look_at
from pointmr_engine import (
    Camera,
    Group,
    Light,
    Material,
    RenderSettings,
    Scene,
    World,
    emission,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.multires.cone_light import ConeLight
from pointmr_engine.multires.sharing.light_shares import (
    allocate_shares,
    count_lobe_rays,
    count_near,
    take_reflected,
    take_turns,
)
from pointmr_engine.multires.sharing.light_sharing import OF_LOBE, OF_WORLD, REACH, share_light
from pointmr_engine.raytracing.environment import Environment
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from tests.engine.small_scenes import at, from_above, half_a_sky, quad, sky_with_a_sun

SUBPIXELS = 8
PIXEL = 3.0 / 48 * 36 / 50  # metres, of images of 48 x 32 by a camera 3 m above


def shares_of(side, rng, spacing=0.1):
    """Fragments on a plane, four a pixel, side x side pixels, their places in the image, and nothing near."""
    n = 4 * side * side
    shares = allocate_shares(n)
    y, x = np.divmod(np.arange(n), 2 * side)
    shares.position[:] = np.stack([x * spacing, y * spacing, np.zeros(n)], 1)
    shares.normal[:] = (0, 0, 1)
    shares.albedo[:] = rng.uniform(0.1, 0.9, (n, 3))
    shares.rays[:] = 2
    shares.nearness[:] = shares.turned[:] = 0
    shares.worth[:] = shares.width[:] = 1
    shares.light[:] = shares.albedo
    places = ((a + 0.5) * SUBPIXELS / 2 for a in (x, y))
    return shares, *(a.astype(np.float32) for a in places)


def shared(shares, x, y, side, change=OF_WORLD, eye=(0.0, 0.0, 0.0)):
    out = np.zeros((len(x), 3), np.float32)
    share_light(x, y, SUBPIXELS, change, shares, len(x), (side, side), np.array(eye), out)
    return out


@given(st.integers(0, 1000))
def test_even_light_stays_what_it_is_whatever_the_colours(seed):
    shares, x, y = shares_of(6, np.random.default_rng(seed))
    np.testing.assert_allclose(shared(shares, x, y, 6), shares.albedo, rtol=1e-5)


def test_noise_falls_in_the_open():
    rng = np.random.default_rng(3)
    shares, x, y = shares_of(16, rng)
    shares.light[:] *= rng.uniform(0.0, 2.0, (len(x), 1))
    before = (shares.light / shares.albedo).var()
    after = (shared(shares, x, y, 16) / shares.albedo).var()
    assert after < before / 20  # 81 fragments lie within reach, fewer at the tile's edge


def test_what_one_fragment_received_fades_with_the_distance():
    side = 2 * REACH + 7
    shares, x, y = shares_of(side, np.random.default_rng(3))
    bright = len(x) // 2 + side
    shares.light[:] = 0
    shares.light[bright] = shares.albedo[bright]
    got = (shared(shares, x, y, side) / shares.albedo)[:, 0]
    cones = np.maximum(*(np.floor(abs(a // SUBPIXELS - a[bright] // SUBPIXELS)) for a in (x, y)))
    of = [got[cones == d].mean() for d in range(REACH + 2)]
    assert (np.diff(of[1:]) < 0).all() and of[REACH] < 0.2 * of[1]
    assert of[REACH + 1] == 0


def test_nearly_alike_fragments_of_a_cone_receive_the_same():
    shares, x, y = shares_of(6, np.random.default_rng(4))
    shares.light[:] *= np.random.default_rng(5).uniform(0.0, 2.0, (len(x), 1))
    got = shared(shares, x, y, 6) / shares.albedo
    cone = (y // SUBPIXELS) * 6 + x // SUBPIXELS
    for c in np.unique(cone):
        np.testing.assert_allclose(got[cone == c], got[cone == c][:1].repeat(4, 0), rtol=1e-5)


def test_what_is_near_keeps_light_apart():
    rng = np.random.default_rng(4)
    shares, x, y = shares_of(8, rng)
    shares.light[:] *= rng.uniform(0.0, 2.0, (len(x), 1))
    shares.nearness[:] = shares.rays * 100.0  # something a centimetre off, fragments ten apart
    np.testing.assert_allclose(shared(shares, x, y, 8), shares.light, rtol=1e-6)


def test_a_few_rays_that_meet_something_at_once_keep_nothing_apart():
    """As in hair: one ray in ten meets a strand beside the one that it leaves."""
    rng = np.random.default_rng(4)
    shares, x, y = shares_of(8, rng)
    n = len(x)
    shares.light[:] *= rng.uniform(0.0, 2.0, (n, 1))
    source, triangle = np.arange(n, dtype=np.int32), np.where(np.arange(n) % 10 == 0, 0, -1)
    count_near(
        source, triangle, np.full(n, 1e-7), np.full(n, 0.1, np.float32), np.int64(n), np.int64(0), shares
    )
    before, after = shares.light / shares.albedo, shared(shares, x, y, 8) / shares.albedo
    assert after.var() < before.var() / 10


@given(st.floats(0.0, 10.0), st.floats(1e-6, 10.0))
def test_nothing_counts_as_nearer_than_the_closest(t, closest):
    rays = np.array([1, 0], np.int64), np.array([t, t]), np.full(2, closest, np.float32)
    shares = shares_of(2, np.random.default_rng(1))[0]
    count_near(np.zeros(2, np.int32), rays[0], rays[1], rays[2], np.int64(2), np.int64(3), shares)
    assert (
        shares.nearness[3] == pytest.approx(2.0 / max(t, closest), rel=1e-5) and not shares.nearness[4:].any()
    )
    lobes, near = np.zeros(4, np.float32), np.zeros(4, np.float32)
    near_of = np.full(4, closest, np.float32)
    count_lobe_rays(np.array([1, 7]), rays[0], rays[1], near_of, np.int64(2), np.int64(4), lobes, near)
    assert lobes.tolist() == [0, 0, 0, 1] and near[3] == pytest.approx(1.0 / max(t, closest), rel=1e-5)


@given(st.floats(-1.0, 1.0), st.floats(0.0, 2.0 * np.pi))
def test_rays_tell_how_half_a_sky_changes_with_the_normal(height, around):
    """A normal n receives (1 + n d) / 2 of the half about d, which changes by (n + d) / 2."""
    n, side = 20000, np.sqrt(1.0 - height * height)
    d = np.array([side * np.cos(around), side * np.sin(around), height])
    u, v = np.random.default_rng(2).uniform(size=(2, n))
    flat = np.sqrt(u)
    rays = np.stack([flat * np.cos(2 * np.pi * v), flat * np.sin(2 * np.pi * v), np.sqrt(1 - u)], 1)
    shares = shares_of(1, np.random.default_rng(1))[0]
    light = np.tile(np.float64(shares.albedo[2]), (n, 1))
    source, met = np.full(n, 1, np.int32), np.where(rays @ d > 0, -1, 0)
    take_turns(light, rays, source, met, np.int64(n), np.int64(1), shares)
    np.testing.assert_allclose(shares.turned[2] / (3.0 * n), (np.array([0, 0, 1]) + d) / 2, atol=0.06)
    assert not shares.turned[[0, 1, 3]].any()


def test_shared_light_is_that_of_each_normal():
    """A surface with ridges under half a sky: what it shares is the mean of neighbours, and what it receives is not."""
    side, d = 12, np.array([0.8, 0.0, 0.6])
    shares, x, y = shares_of(side, np.random.default_rng(6))
    tilt = 0.15 * np.sin(2 * np.pi * x / (6 * SUBPIXELS))
    shares.normal[:] = np.stack([np.sin(tilt), 0 * tilt, np.cos(tilt)], 1)
    arrives = (1.0 + shares.normal @ d) / 2.0
    shares.light[:] = shares.albedo * arrives[:, None]
    flat = shared(shares, x, y, side)[:, 1] / shares.albedo[:, 1] - arrives
    shares.turned[:] = 3.0 * (shares.normal + d) / 2.0
    turned = shared(shares, x, y, side)[:, 1] / shares.albedo[:, 1] - arrives
    assert np.abs(turned).max() < 0.005 and np.abs(flat).max() > 0.02


def test_other_sides_of_an_edge_do_not_share():
    shares, x, y = shares_of(8, np.random.default_rng(5))
    right = x > 4 * SUBPIXELS
    shares.normal[right] = (1, 0, 0)
    shares.light[right] = 0
    result = shared(shares, x, y, 8)
    assert (result[right] == 0).all()
    np.testing.assert_allclose(result[~right], shares.albedo[~right], rtol=1e-5)


def test_channels_that_a_neighbour_does_not_reflect_are_left_to_the_others():
    shares, x, y = shares_of(4, np.random.default_rng(6))
    shares.albedo[::2, 1] = 0
    shares.light[:] = shares.albedo
    np.testing.assert_allclose(shared(shares, x, y, 4), shares.albedo, rtol=1e-5)


@pytest.mark.parametrize("place", [-30.0, 500.0])
def test_places_beyond_the_tile_are_kept(place):
    shares, x, y = shares_of(4, np.random.default_rng(7))
    x[5] = place
    np.testing.assert_allclose(shared(shares, x, y, 4), shares.albedo, rtol=1e-5)


# Lobes


def turned(shares, x, angle):
    """The same fragments on two planes, the right ones turned by `angle`, and dark."""
    right = x > 4 * SUBPIXELS
    shares.normal[right] = (np.sin(angle), 0, np.cos(angle))
    shares.light[right] = 0
    return right


@pytest.mark.parametrize(("width", "mixes"), [(1.0, True), (0.1, False)])
def test_narrow_lobes_share_only_where_normals_agree(width, mixes):
    shares, x, y = shares_of(8, np.random.default_rng(8))
    shares.width[:] = width
    right = turned(shares, x, 0.08)
    result = shared(shares, x, y, 8, OF_LOBE._replace(view=0.0))
    assert bool((result[right] > 0).any()) == mixes


def test_lobes_of_different_width_do_not_share():
    shares, x, y = shares_of(8, np.random.default_rng(9))
    right = turned(shares, x, 0.0)
    shares.width[:] = np.where(right, 0.3, 0.6)
    result = shared(shares, x, y, 8, OF_LOBE._replace(view=0.0))
    assert (result[right] == 0).all()


@pytest.mark.parametrize(("height", "quieter"), [(0.2, False), (100.0, True)])
def test_narrow_lobes_share_only_where_the_view_hardly_turns(height, quieter):
    """They see by how their surface is seen: fragments a tenth of a metre apart, from above their middle."""
    rng = np.random.default_rng(11)
    shares, x, y = shares_of(8, rng)
    shares.width[:] = 0.1
    shares.light[:] *= rng.uniform(0.0, 2.0, (len(x), 1))
    eye = (*shares.position[:, :2].mean(0), height)
    before, after = shares.light / shares.albedo, shared(shares, x, y, 8, OF_LOBE, eye) / shares.albedo
    assert (after.var() < before.var() / 5) == quieter


def test_what_counts_more_decides():
    shares, x, y = shares_of(4, np.random.default_rng(10))
    shares.worth[::2], shares.light[::2] = 9, 0
    share = shared(shares, x, y, 4) / shares.albedo
    assert (share < 0.3).all() and (share > 0).all()


# Light that shadow rays bring


@given(st.integers(0, 1000))
def test_light_is_moved_and_not_made(seed):
    rng = np.random.default_rng(seed)
    shares, n = shares_of(2, rng)[0], 40
    shares.albedo[::3] = 0  # has nothing to share
    shares.light[:] = 0
    light, source = rng.uniform(0, 1, (n, 3)), rng.integers(0, 10, n).astype(np.int32)
    part = light * rng.uniform(0, 1, (n, 3))
    triangle = rng.choice(np.array([-1, 5], np.int64), n)
    left, before = light.copy(), light.sum(0)
    take_reflected(left, part, source, triangle, np.int64(n), np.int64(6), shares)
    np.testing.assert_allclose(left.sum(0) + shares.light.sum(0), before, rtol=1e-5)
    kept = (triangle != -1) | (shares.albedo[6 + source] == 0).all(1)
    np.testing.assert_array_equal(left[kept], light[kept])  # blocked, or not shared
    np.testing.assert_allclose(left[~kept], (light - part)[~kept], atol=1e-12)


def lamps_over_a_floor(**floor) -> Scene:
    """More lamps than take a cone each, and a panel that shines; a card throws shadows on the floor."""
    places = ((-2, 0, 4), (2, 1, 3), (0, 2, 4), (1, -2, 3))
    lamps = [Light("AREA", at(*p), power=40.0, size_x=0.5) for p in places]
    things = [
        quad(20.0, material=principled("floor", **floor)),
        quad(0.6, 0.5, principled("card", base_color=(0.5, 0.2, 0.1)), "card"),
        quad(0.8, 5.5, emission("panel", strength=20.0), "panel"),
    ]
    return Scene(Group("root", things), from_above(), lamps, uniform_world((0, 0, 0)))


@pytest.mark.parametrize(
    ("floor", "quieter"),
    [
        ({"base_color": (0.6, 0.5, 0.4), "specular_ior_level": 0.0}, 2.0),
        ({"base_color": (0.9, 0.8, 0.6), "metallic": 1.0, "roughness": 0.6}, 3.0),
        ({"base_color": (0.6, 0.5, 0.4), "specular_ior_level": 0.0, "sheen_weight": 0.5}, 2.0),
    ],
    ids=["matt", "rough metal", "cloth"],
)
def test_shared_light_of_lamps_is_as_bright_and_quieter(monkeypatch, floor, quieter):
    def images() -> np.ndarray:
        cache, scene = Cache(), lamps_over_a_floor(**floor)
        seeds = (RenderSettings(40, 30, method="raytrace", seed=s) for s in range(6))
        return np.array([render(scene, s, cache=cache).passes["combined"][..., :3] for s in seeds], float)

    shared_, begin = images(), ConeLight.__init__

    def alone(self, *args):
        begin(self, *args)
        self.shares_lamps = self.shares_lobes = False

    monkeypatch.setattr(ConeLight, "__init__", alone)
    single = images()
    assert shared_.mean() == pytest.approx(single.mean(), rel=0.01)
    assert shared_.var(0).mean() * quieter < single.var(0).mean()


@pytest.mark.parametrize("part", [0.02, 0.1, 0.5])
def test_light_of_a_part_of_the_sky_comes_from_as_wide_an_angle(part):
    lit = Environment(sky_with_a_sun(1.0 - 2.0 * part, 3.0)).map.width
    assert lit == pytest.approx(np.sqrt(2.0 * part), rel=0.03)
    assert Environment(sky_with_a_sun(1.0 - 2.0 * part, 3.0, 1.0)).map.width > lit or part == 0.5
    assert Environment(uniform_world((0.5, 0.5, 0.5))).map.width == 1.0


def test_a_sun_in_the_sky_throws_shadows_with_edges():
    """A card's shadow on a floor, of whose light the sun brings two thirds: not blurred by what fragments share."""
    matt = {"specular_ior_level": 0.0}
    floor = quad(20.0, material=principled("floor", base_color=(0.6, 0.5, 0.4), **matt))
    card = quad(1.0, 1.5, principled("card", base_color=(0.2, 0.2, 0.2), **matt), "card")
    camera = Camera(look_at((0, -5, 3), (0, 0, 0.5)))
    scene = Scene(Group("root", [floor, card]), camera, [], sky_with_a_sun(0.998, 500.0, 1.0))
    cache = Cache()

    def picture(**values) -> np.ndarray:
        return render(scene, RenderSettings(48, 32, **values), cache=cache).passes["combined"][..., :3]

    exact = picture(method="distributed", samples=2048)
    ours = np.mean([picture(method="raytrace", seed=s) for s in range(8)], 0)
    assert np.abs(ours - exact).mean() < 0.04 * exact.mean()


@pytest.mark.parametrize("roughness", [0.6, 0.9])
def test_what_rough_glass_lets_through_is_shared_as_bright_and_quieter(monkeypatch, roughness):
    """A frosted pane before a sky of which a half shines, and a floor: every ray sees another part of them."""
    glass = principled(
        "glass", base_color=(1.0, 1.0, 1.0), roughness=roughness, transmission_weight=1.0, ior=1.5
    )
    floor = quad(4.0, -1.5, principled("floor", base_color=(0.7, 0.4, 0.2)), "floor")
    scene = Scene(Group("root", [floor, quad(2.0, material=glass)]), from_above(), [], half_a_sky())

    def images() -> np.ndarray:
        cache = Cache()
        seeds = (RenderSettings(40, 30, method="raytrace", seed=s) for s in range(6))
        return np.array([render(scene, s, cache=cache).passes["combined"][..., :3] for s in seeds], float)

    shared_, begin = images(), ConeLight.__init__

    def alone(self, *args):
        begin(self, *args)
        assert self.shares_refractions
        self.shares_refractions = False

    monkeypatch.setattr(ConeLight, "__init__", alone)
    single = images()
    assert shared_.mean() == pytest.approx(single.mean(), rel=0.01)
    assert shared_.var(0).mean() * 4.0 < single.var(0).mean()


def striped_cloth(width: float) -> Material:
    """Stripes across x, light ones and black ones, under a sheen."""
    nodes = {
        "place": Node("geometry"),
        "axes": Node("separate_xyz", {"vector": Link("place", "position")}),
        "count": Node("math", {"value": Link("axes", "x"), "value_b": 2.0 * width}, {"operation": "DIVIDE"}),
        "phase": Node("math", {"value": Link("count", "value")}, {"operation": "FRACT"}),
        "light": Node("math", {"value": Link("phase", "value"), "value_b": 0.5}, {"operation": "GREATER_THAN"}),
        "cloth": Node("principled", {
            "base_color": Link("light", "value"), "specular_ior_level": 0.0, "sheen_weight": 0.6,
        }),
    }  # fmt: skip
    return Material("cloth", Graph(nodes, surface=Link("cloth", "bsdf")))


def light_from_above() -> World:
    """White for directions within 37 degrees of z: of such light, a sheen reflects less than of all others."""
    sky = half_a_sky()
    sky.graph.nodes["half"] = Node(
        "math", {"value": Link("axes", "z"), "value_b": 0.8}, {"operation": "GREATER_THAN"}
    )
    return sky


def test_stripes_under_a_sheen_keep_their_contrast():
    """Only what matt lobes reflect is shared: black ones show their sheen, and no light of their neighbours."""
    root = Group("root", [quad(6.0, material=striped_cloth(6 * PIXEL))])
    scene = Scene(root, from_above(3.0), [], light_from_above())

    def rows(**values) -> np.ndarray:
        return render(scene, RenderSettings(48, 32, **values)).passes["combined"][4:-4, 4:-4, :3].mean((0, 2))

    ours = np.mean([rows(method="raytrace", seed=s) for s in range(4)], 0)
    exact = rows(method="distributed", samples=512)
    assert exact.max() > 4.0 * exact.min() > 0.0
    np.testing.assert_allclose(ours, exact, rtol=0.04, atol=0.001 * exact.max())


def test_a_sky_behind_a_floor_does_not_wait_for_the_lamps_before_it():
    """Of many lights one is chosen: of a cloth that only what is below it lights, most found nothing."""
    cloth = Node("translucent", {"color": (0.6, 0.6, 0.6)})
    material = Material("cloth", Graph({"t": cloth}, surface=Link("t", "bsdf")))
    lamps = [replace(lamp, power=1000.0) for lamp in four_lamps()]
    scene = Scene(Group("root", [quad(20.0, material=material)]), from_above(), lamps, half_a_sky("z"))
    image = render(scene, RenderSettings(40, 30, method="raytrace")).passes["combined"][..., :3]
    assert image.mean() == pytest.approx(0.6 * 0.8, rel=0.02)
    assert image.std() < 0.15 * image.mean()


def ridged(wave_number: float, height: float) -> Material:
    """Matt, with ridges of so many radians a metre across x that only bump mapping knows."""
    nodes = {
        "place": Node("geometry"),
        "axes": Node("separate_xyz", {"vector": Link("place", "position")}),
        "phase": Node("math", {"value": Link("axes", "x"), "value_b": wave_number}, {"operation": "MULTIPLY"}),
        "sine": Node("math", {"value": Link("phase", "value")}, {"operation": "SINE"}),
        "bump": Node("bump", {"height": Link("sine", "value"), "distance": height}),
        "matt": Node("diffuse", {"normal": Link("bump", "normal")}),
    }  # fmt: skip
    return Material("ridged", Graph(nodes, surface=Link("matt", "bsdf")))


def four_lamps() -> list[Light]:
    return [
        Light("AREA", look_at((-3.0, 0.5 * y, 1.5), (0.0, 0.0, 0.0)), size_x=0.6, power=20.0)
        for y in (-2, -1, 1, 2)
    ]


@pytest.mark.parametrize(
    ("lamps", "world"), [(four_lamps(), uniform_world((0, 0, 0))), ([], half_a_sky())], ids=["lamps", "sky"]
)
def test_bumps_keep_their_contrast(lamps, world):
    """What arrives at one side of a ridge is not what arrives at the other."""
    k = 2 * np.pi / (6 * PIXEL)
    scene = Scene(Group("root", [quad(6.0, material=ridged(k, 0.4 / k))]), from_above(3.0), lamps, world)

    def contrast(**values) -> float:
        rows = render(scene, RenderSettings(48, 32, **values)).passes["combined"][4:-4, 4:-4, 0].mean(0)
        smooth = np.convolve(rows, np.full(6, 1 / 6), "valid")
        return float((rows[3:-2] - smooth).std() / rows.mean())

    assert contrast(method="raytrace") > 0.94 * contrast(method="distributed", samples=64)
