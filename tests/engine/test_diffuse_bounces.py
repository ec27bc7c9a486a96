"""Diffuse light that bounces: method "raytrace" beside many random rays, what it skips, and what fragments share.

A formula for it: "sphere from inside" of test_raytrace_closed_forms; beside Cycles: test_diffuse_bounces_cycles.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.closed_forms import curved_mirror
from benchmarks.forward.scenes import look
from pointmr_engine import (
    Camera,
    Group,
    Light,
    Material,
    RenderSettings,
    Scene,
    instance,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.multires.paths import cone_paths
from pointmr_engine.multires.sharing.light_shares import allocate_shares, take_bounced
from pointmr_engine.multires.sharing.shared_light import numbers_of_equal
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import CAMERA, DIFFUSE, VISIBLE
from pointmr_engine.scene.settings import RaytraceSettings
from tests.engine.test_raytrace_light import DARK, card, image

MATT = {"specular_ior_level": 0.0}
LAMP = Light(
    "AREA", look((0, 0, 1.9), (0, 0, 0)), power=20.0, size_x=0.5, size_y=0.5, visibility=VISIBLE & ~CAMERA
)
SUN = Light("SUN", look((0.5, -3, 1.7), (0, 0, 0.3)), power=4.5, angle=0.02)
SKY = uniform_world((0.5, 0.7, 1.0))
INSIDE = np.s_[4:32, 8:40]  # of images of 48 x 36: no outline of the room


def room(light: Light | None = None, world=DARK, wall: Material | None = None, **values) -> Scene:
    """A box open to the front, red to the left and green to the right, with a ball in it; values: of its materials."""
    white, red, green = (
        principled(name, base_color=color, **(MATT | values))
        for name, color in (("white", (0.8,) * 3), ("red", (0.8, 0.1, 0.1)), ("green", (0.1, 0.8, 0.1)))
    )
    ball = curved_mirror.sphere(24)
    ball = replace(ball, positions=np.float32(0.4 * ball.positions + (0.2, 0.1, 0.41)), materials=(white,))
    meshes = [
        card("floor", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], white),
        card("back", [(-1, 1, 0), (1, 1, 0), (1, 1, 2), (-1, 1, 2)], wall or white),
        card("left", [(-1, 1, 0), (-1, 1, 2), (-1, -1, 2), (-1, -1, 0)], red),
        card("right", [(1, 1, 0), (1, -1, 0), (1, -1, 2), (1, 1, 2)], green),
        card("top", [(-1, -1, 2), (-1, 1, 2), (1, 1, 2), (1, -1, 2)], white),
        ball,
    ]
    camera = Camera(look((0, -4.2, 1.0), (0, 0, 1.0)))
    return Scene(Group("root", meshes), camera, [light] if light else [], world)


def blocks(picture: np.ndarray) -> np.ndarray:
    """Means of 4 x 4 pixels of the room's inside."""
    part = picture[INSIDE]
    return part.reshape(part.shape[0] // 4, 4, part.shape[1] // 4, 4, 3).mean((1, 3))


def counters(scene: Scene, bounces: int) -> dict:
    """What an image at one cone counts."""
    settings = RenderSettings(48, 36, method="raytrace", diffuse_bounces=bounces)
    return render(scene, settings).stats["counters"]


def assert_as_by_random_rays(scene: Scene, rtol: float = 0.02, seeds: int = 6, **settings) -> np.ndarray:
    """Blocks of both agree as far as their noise lets them; returns those by many rays."""
    cache = Cache()
    exact = np.array([
        blocks(image(scene, cache, method="distributed", samples=256, seed=s, **settings)) for s in range(2)
    ])  # fmt: skip
    ours = np.array([blocks(image(scene, cache, seed=s, **settings)) for s in range(seeds)])
    truth = exact.mean(0)
    noise = np.hypot(ours.std(0, ddof=1) / len(ours) ** 0.5, 0.5 * np.abs(exact[0] - exact[1]))
    off = np.abs(ours.mean(0) - truth)
    assert (off <= 3.0 * rtol * truth + 4.0 * noise + 0.003).all()
    assert ours.mean() == pytest.approx(truth.mean(), rel=rtol)
    return truth


@pytest.mark.parametrize(
    "scene",
    [
        room(LAMP),
        room(SUN),
        room(world=SKY),
        room(LAMP, specular_ior_level=0.5, roughness=0.3),
        room(LAMP, diffuse_roughness=1.0, sheen_weight=0.7),
        room(LAMP, transmission_weight=0.3, roughness=0.2),
    ],
    ids=["lamp", "sun", "sky", "gloss", "rough and sheen", "glass"],
)
def test_rooms_are_as_bright_as_by_random_rays(scene):
    direct = blocks(image(scene, Cache(), method="distributed", samples=64))
    truth = assert_as_by_random_rays(scene, diffuse_bounces=3)
    assert truth.mean() > 1.15 * direct.mean()


@pytest.mark.parametrize("settings", [{"secondary": "rays"}, {"visibility": "alpha"}, {"cones": 4}])
def test_other_ways_to_see_are_as_bright(settings):
    chosen = RaytraceSettings(**settings)
    scene, cache = room(LAMP), Cache()
    exact = blocks(image(scene, cache, method="distributed", samples=256, diffuse_bounces=2))
    ours = np.mean(
        [blocks(image(scene, cache, seed=s, raytrace=chosen, diffuse_bounces=2)) for s in range(4)], 0
    )
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.02)


def test_what_is_out_of_focus_bounces_too():
    scene = room(LAMP)
    scene.camera = replace(scene.camera, fstop=0.1, focus_distance=2.0)
    assert_as_by_random_rays(scene, diffuse_bounces=1, seeds=4)


def test_bounces_stop_where_they_are_limited():
    """One more bounce is brighter than one less, and the total counts, too."""
    scene, cache = room(LAMP), Cache()
    direct, once, twice, total = (
        blocks(image(scene, cache, **limits)).mean()
        for limits in (
            {"diffuse_bounces": 0}, {"diffuse_bounces": 1}, {"diffuse_bounces": 2},
            {"diffuse_bounces": 9, "max_bounces": 1},
        )
    )  # fmt: skip
    assert 1.05 * direct < once and 1.03 * once < twice
    assert total == pytest.approx(once, rel=0.01)


def test_no_bounces_send_no_rays():
    scene = room(SUN)
    counts = [counters(scene, bounces) for bounces in (0, 1)]
    assert counts[0].get("lobe_rays", 0) == 0
    assert counts[1]["lobe_rays"] > counts[1]["fragments"]


def test_forward_mapping_knows_direct_light_alone():
    scene = room(LAMP)
    once, none = (image(scene, method="forward", diffuse_bounces=d) for d in (1, 0))
    np.testing.assert_array_equal(once, none)


def test_small_fragments_ask_less_often():
    """Detail does not cost more rays than the image has room for: they go by what is seen of each fragment."""
    rng = np.random.default_rng(1)
    middle = rng.uniform((-0.9, -0.9, 0.1), (0.9, 0.9, 1.9), (4000, 1, 3))
    positions = (middle + 0.04 * rng.normal(size=(4000, 3, 3))).reshape(-1, 3).astype(np.float32)
    leaves = replace(
        card("leaves", [(0, 0, 0)] * 4, principled("leaf", base_color=(0.7,) * 3, **MATT)),
        positions=positions, triangles=np.arange(12000, dtype=np.int32).reshape(-1, 3),
    )  # fmt: skip
    full = room(SUN)
    full.root.meshes.append(leaves)
    plain, dense = (counters(scene, 1) for scene in (room(SUN), full))
    assert dense["fragments"] > 2.0 * plain["fragments"]
    assert dense["lobe_rays"] < 1.3 * plain["lobe_rays"]


def test_materials_are_told_of_diffuse_rays():
    """A wall that is black to them sends nothing to the others, as by random rays."""
    nodes = {
        "ray": Node("light_path"),
        "seen": Node(
            "math", {"value": 1.0, "value_b": Link("ray", "is_diffuse_ray")}, {"operation": "SUBTRACT"}
        ),
        "bsdf": Node("diffuse", {"color": Link("seen", "value"), "roughness": 0.0}),
    }
    wall = Material("told", Graph(nodes, surface=Link("bsdf", "bsdf")))
    scene = room(LAMP, wall=wall)
    assert_as_by_random_rays(scene, diffuse_bounces=2, seeds=4)


def test_what_diffuse_rays_do_not_see_sends_nothing():
    scene = room(LAMP)
    meshes = scene.root.meshes
    group = Group("sides", [m for m in meshes if m.name in ("left", "right")])
    meshes[:] = [m for m in meshes if m.name not in ("left", "right")]
    sides = replace(instance(group, np.eye(4)), visibility=np.uint8([VISIBLE & ~DIFFUSE]))
    scene.root.instances.append(sides)
    assert_as_by_random_rays(scene, diffuse_bounces=2, seeds=4)


def test_neighbours_share_what_diffuse_rays_find():
    """On open walls noise is less than that of as many rays of each pixel alone."""
    scene, cache = room(SUN), Cache()
    wall = np.s_[24:32, 16:32]
    noise = {}
    for name, settings in (
        ("cones", {"diffuse_bounces": 1}),
        ("rays", {"diffuse_bounces": 1, "method": "distributed", "samples": 16}),
    ):
        images = np.array([image(scene, cache, seed=s, **settings)[wall] for s in range(6)])
        noise[name] = images.var(0, ddof=1).mean() ** 0.5 / images.mean()
    assert noise["cones"] < 0.5 * noise["rays"]


def test_where_paths_find_no_room_all_fragments_send_one(monkeypatch):
    """Less room makes noise, and no difference."""
    scene, cache = room(LAMP, specular_ior_level=0.5, roughness=0.3), Cache()
    whole = np.mean([blocks(image(scene, cache, seed=s, diffuse_bounces=1)) for s in range(3)], 0)
    scatter = cone_paths.scatter_lobes

    def crowded(*a):
        n, room_, bounce = a[10], 11, a[8]
        return scatter(*a[:room_], np.int64(2 * n) if bounce == 0 else a[room_], *a[room_ + 1 :])

    monkeypatch.setattr(cone_paths, "scatter_lobes", crowded)
    parts = np.mean([blocks(image(scene, cache, seed=s, diffuse_bounces=1)) for s in range(3)], 0)
    assert parts.mean() == pytest.approx(whole.mean(), rel=0.01)


def test_what_bounces_is_told_with_how_it_turns():
    """The gradient of the light by the normal is that of the cosine with the ray's direction."""
    shares = allocate_shares(2)
    for values in shares:
        values[:] = 0
    shares.albedo[:] = 0.5
    shares.normal[:] = (0.0, 0.0, 1.0)
    direction = np.array([(0.6, 0.0, 0.8), (0.0, 0.0, 0.0)])
    radiance = np.array([(0.2, 0.4, 0.6), (0.1, 0.1, 0.1)])
    take_bounced(radiance, direction, np.int64(0), np.int64(2), shares)
    np.testing.assert_allclose(shares.light, radiance, rtol=1e-6)
    arrived = radiance[0].sum() / 0.5
    np.testing.assert_allclose(shares.turned[0], arrived / 0.8 * direction[0], rtol=1e-6)
    assert not shares.turned[1].any()


@given(st.lists(st.integers(0, 5), max_size=40))
def test_each_of_a_fragments_rays_has_a_number(slots):
    slots = np.sort(np.array(slots, np.int32))
    numbers = numbers_of_equal(slots)
    for slot in np.unique(slots):
        np.testing.assert_array_equal(numbers[slots == slot], np.arange((slots == slot).sum()))
