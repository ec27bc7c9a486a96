"""Light sampling: closed forms, densities that match, and three estimators that agree."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pointmr_engine.numerics import warps
from pointmr_engine.raytracing.lights import (
    LAMP,
    NONE,
    WORLD,
)
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import CAMERA, DIFFUSE, GLOSSY, VISIBLE, Group, instance
from pointmr_engine.scene.light import Light
from pointmr_engine.scene.texture import Image
from pointmr_engine.scene.world import World, uniform_world
from tests.engine.light_estimators import (
    UP,
    all_agree,
    by_lights,
    by_rays,
    form_factor_square,
    lights_of,
    placed,
    points,
    quad,
    sampled,
    uniforms,
)

# closed forms


@pytest.mark.parametrize("soft", [False, True])
def test_point_light_falls_off_with_the_square(soft):
    lights = lights_of([Light("POINT", placed((0.0, 0.0, 2.0)), power=10.0, soft_falloff=soft)])
    out = sampled(lights, (1.5, 0.0, 0.0), n=16)
    d2 = 1.5**2 + 2.0**2
    assert out.radiance[:, 0] / out.pdf == pytest.approx(10.0 / (4.0 * math.pi * d2), rel=1e-6)
    assert out.distance == pytest.approx(math.sqrt(d2))
    assert not out.mis.any()


def test_sphere_above_the_horizon():
    r, d = 0.5, np.array([1.0, 0.0, 2.0])
    radiance = 7.0 / (4.0 * math.pi**2 * r * r)
    light = Light("POINT", placed(d), power=7.0, radius=r, soft_falloff=False)
    expected = math.pi * radiance * r * r / (d @ d) * d[2] / np.linalg.norm(d)
    all_agree(lights_of([light]), (0.0, 0.0, 0.0), expected=expected, rel=0.01)


def test_inside_a_sphere():
    light = Light("POINT", placed((0.1, 0.0, 0.2)), power=7.0, radius=2.0, soft_falloff=False)
    expected = math.pi * 7.0 / (4.0 * math.pi**2 * 4.0)
    all_agree(lights_of([light]), (0.0, 0.0, 0.0), expected=expected, rel=0.01)


def test_disc_on_its_axis():
    r, h = 1.0, 0.7
    light = Light("AREA", placed((0.0, 0.0, h)), power=5.0, shape="DISK", size_x=2.0 * r)
    radiance = 5.0 / (math.pi * math.pi * r * r)
    all_agree(lights_of([light]), (0, 0, 0), expected=math.pi * radiance * r * r / (r * r + h * h), rel=0.01)


@pytest.mark.parametrize("height", [0.1, 1.0, 20.0])
def test_square_over_its_centre(height):
    light = Light("AREA", placed((0.0, 0.0, height)), power=5.0, size_x=2.0)
    expected = 5.0 / (math.pi * 4.0) * math.pi * form_factor_square(1.0, height)
    alone = by_lights(lights_of([light]), (0.0, 0.0, 0.0)).mean(0)
    assert alone == pytest.approx(np.full(3, expected), rel=0.003)
    if height < 10.0:
        all_agree(lights_of([light]), (0.0, 0.0, 0.0), expected=expected, rel=0.01)


@pytest.mark.parametrize("angle", [0.0, 0.01, 1.0])
def test_sun_gives_its_irradiance(angle):
    lights = lights_of([Light("SUN", placed(), power=3.0, angle=angle)])
    assert by_lights(lights, (5.0, 6.0, 7.0)).mean(0) == pytest.approx(np.full(3, 3.0), rel=1e-3)
    if angle == 1.0:
        all_agree(lights, (0.0, 0.0, 0.0), (0.6, 0.0, 0.8), 3.0 * 0.8, rel=0.01)


def test_spot_is_dark_outside_its_cone():
    light = Light("SPOT", placed((0.0, 0.0, 1.0)), power=10.0, spot_angle=math.pi / 2, spot_blend=0.0)
    lights = lights_of([light])
    inside, outside = sampled(lights, (0.99, 0.0, 0.0), n=8), sampled(lights, (1.01, 0.0, 0.0), n=8)
    assert (inside.kind == LAMP).all() and (outside.kind == NONE).all()
    assert inside.radiance[0, 0] == pytest.approx(10.0 / (4.0 * math.pi * (0.99**2 + 1.0)), rel=1e-6)


@pytest.mark.parametrize(
    "light",
    [
        Light(
            "SPOT", placed((0.3, 0.0, 1.0)), radius=0.4, spot_angle=1.4, spot_blend=0.5, soft_falloff=False
        ),
        Light(
            "SPOT", placed((0.3, 0.0, 0.6)), radius=0.5, spot_angle=0.6, spot_blend=0.5, soft_falloff=False
        ),
        Light("SPOT", placed((0.3, 0.0, 1.0)), radius=0.4, spot_angle=1.4, spot_blend=0.5, soft_falloff=True),
        Light("SPOT", placed((0.1, 0.0, 0.2)), radius=0.6, spot_angle=1.4, soft_falloff=False),
        Light("POINT", placed((0.3, 0.0, 0.2)), radius=0.5, soft_falloff=True),
        Light("POINT", placed((0.3, 0.0, 0.2)), radius=0.36, soft_falloff=False),
        Light("AREA", placed((0.5, 0.3, 0.5)), shape="RECTANGLE", size_x=1.0, size_y=2.0, spread=1.0),
        Light("AREA", placed((0.5, 0.3, 0.5)), shape="DISK", size_x=2.0, spread=1.2),
        Light("AREA", placed((0.5, 0.3, 0.5)), shape="ELLIPSE", size_x=2.0, size_y=1.0),
        Light("AREA", placed((0.5, 0.3, 0.5), scale=(2.0, 1.0, 1.0)), size_x=1.0, color=(1.0, 0.5, 0.2)),
        Light("SUN", placed(), angle=2.0),
    ],
    ids=lambda light: f"{light.kind}-{light.shape}-{light.radius}-{light.spread:.1f}",
)
def test_lamps_by_samples_and_by_rays(light):
    lights = lights_of([light])
    for normal in (UP, (0.6, 0.0, 0.8), (-0.8, 0.6, 0.0)):
        alone = by_lights(lights, (0.0, 0.0, 0.0), normal).mean(0)
        rays = by_rays(lights, (0.0, 0.0, 0.0), normal).mean(0)
        both = by_lights(lights, (0, 0, 0), normal, mis=True) + by_rays(lights, (0, 0, 0), normal, mis=True)
        close = 0.03 * alone.max() + 1e-3
        assert rays == pytest.approx(alone, abs=close)
        assert both.mean(0) == pytest.approx(alone, abs=close)


def test_area_light_shines_to_its_front_only():
    up = lights_of([Light("AREA", placed((0.0, 0.0, 1.0), down=False))])
    assert (sampled(up, (0.0, 0.0, 0.0), n=16).kind == NONE).all()
    assert by_rays(up, (0.0, 0.0, 0.0), n=256).max() == 0.0


# the world


def test_uniform_world():
    lights = lights_of(world=uniform_world((0.5, 0.25, 0.125), 2.0))
    value = by_lights(lights, (1.0, 2.0, 3.0))
    assert value.mean(0) == pytest.approx(math.pi * np.array([1.0, 0.5, 0.25]), rel=1e-5)
    assert value.std(0).max() < 1e-3  # chosen by the cosine: no noise at all
    all_agree(lights, (0.0, 0.0, 0.0))
    all_agree(lights.above, (0.0, 0.0, 0.0))
    chance = lights_of(world=replace(uniform_world((0.5, 0.5, 0.5), 2.0), sampling="NONE"))
    assert chance.empty and chance.only_met
    assert by_rays(chance, (0.0, 0.0, 0.0)).mean(0) == pytest.approx(np.full(3, math.pi), rel=1e-5)


def image_world(pixels, **options) -> World:
    image = Image("sky", np.asarray(pixels, np.float32), colorspace="Linear")
    nodes = {
        "sky": Node("environment_texture", params={"image": image}),
        "background": Node("background", {"color": Link("sky", "color"), "strength": 1.0}),
    }
    return World(Graph(nodes, surface=Link("background", "background")), **options)


def test_image_world_by_samples_and_by_rays():
    rng = np.random.default_rng(3)
    pixels = np.ones((32, 64, 4), np.float32)
    pixels[..., :3] = rng.random((32, 64, 3))
    pixels[25, 40, :3] = 200.0  # a small sun
    lights = lights_of(world=image_world(pixels))
    for normal in (UP, (0.0, 0.8, -0.6)):
        alone = by_lights(lights, (0.0, 0.0, 0.0), normal)
        rays = by_rays(lights, (0.0, 0.0, 0.0), normal, n=1 << 16)
        both = by_lights(lights, (0, 0, 0), normal, mis=True) + by_rays(lights, (0, 0, 0), normal, mis=True)
        assert rays.mean(0) == pytest.approx(alone.mean(0), rel=0.05)
        assert both.mean(0) == pytest.approx(alone.mean(0), rel=0.02)
    assert (sampled(lights, (0.0, 0.0, 0.0), n=64).kind == WORLD).all()


def test_world_density_integrates_to_one_and_matches_samples():
    rng = np.random.default_rng(3)
    pixels = rng.random((16, 32, 4)) ** 8
    lights = lights_of(world=image_world(pixels, sampling="MANUAL", map_resolution=128))
    z = (np.arange(512) + 0.5) / 256 - 1.0
    phi = (np.arange(1024) + 0.5) / 1024 * 2.0 * math.pi
    r = np.sqrt(1.0 - z * z)
    d = np.stack([r[:, None] * np.cos(phi), r[:, None] * np.sin(phi), np.repeat(z[:, None], 1024, 1)], -1)
    p, nor, trans = points((0.0, 0.0, 0.0), n=d[..., 0].size)
    assert lights.world_pdf(p, nor, trans, d.reshape(-1, 3)).mean() * 4.0 * math.pi == pytest.approx(
        1.0, abs=0.005
    )
    out = sampled(lights, (0.0, 0.0, 0.0), n=4096)
    again = lights.world_pdf(*points((0.0, 0.0, 0.0), n=4096), out.direction)
    assert (np.abs(again / out.pdf - 1.0) < 1e-5).mean() > 0.998  # but for texel borders


def gradient_world(power: float, sun: float = 1.0) -> World:
    """Brighter towards +z, by a power of the height; one texel of 64 x 128 is `sun` times as bright."""
    pixels = np.ones((64, 128, 4), np.float32)
    z = -np.cos((np.arange(64) + 0.5) * math.pi / 64)
    pixels[..., :3] = (0.2 + (0.5 + 0.5 * z) ** power)[:, None, None]
    pixels[50, 40, :3] *= sun
    return image_world(pixels, sampling="MANUAL", map_resolution=128)


def test_a_sky_that_is_nearly_even_is_sampled_by_the_cosine():
    """By its texels, half of the samples fell below the surface, and the others had a deviation of 0.6 to 2."""
    lights = lights_of(world=gradient_world(1.0))
    assert lights.arrays.world.even == 1.0 and lights.arrays.world.columns.size == 2  # no texels are kept
    for normal in (UP, (0.0, 0.8, -0.6), (0.0, 0.0, -1.0)):
        found = by_lights(lights, (0.0, 0.0, 0.0), normal)
        assert (found[:, 1] > 0.0).all()
        assert found[:, 1].std() < 0.5 * found[:, 1].mean()
        assert by_rays(lights, (0.0, 0.0, 0.0), normal).mean(0) == pytest.approx(found.mean(0), rel=0.02)
        # by its normal, to the first order: exact for what is linear in the height, as here
        world, n = lights.arrays.world, np.array(normal)
        assert world.irradiance + world.towards @ n == pytest.approx(found[:, 1].mean(), rel=0.02)


@pytest.mark.parametrize("power, sun", [(1.0, 3000.0), (6.0, 100.0)])
def test_shares_of_texels_and_cosine_bring_the_same_light(power, sun):
    lights = lights_of(world=gradient_world(power, sun))
    assert lights.arrays.world.even < 1.0
    for normal in (UP, (0.0, 0.8, -0.6)):
        found = by_lights(lights, (0.0, 0.0, 0.0), normal)[:, 1]
        z = (np.arange(1024) + 0.5) / 512 - 1.0
        phi = (np.arange(2048) + 0.5) / 2048 * 2.0 * math.pi
        r = np.sqrt(1.0 - z * z)
        d = np.stack([r[:, None] * np.cos(phi), r[:, None] * np.sin(phi), np.repeat(z[:, None], 2048, 1)], -1)
        cosine = np.maximum(d @ np.array(normal), 0.0).ravel()
        exact = 4.0 * math.pi * (lights.world_radiance(d.reshape(-1, 3), DIFFUSE)[:, 1] * cosine).mean()
        assert found.mean() == pytest.approx(exact, rel=0.02)


def test_sun_of_a_sky_is_sampled_by_itself():
    sky = {"sun_disc": True, "sun_elevation": 0.7, "sun_rotation": 2.0, "sun_size": 0.009512}
    nodes = {
        "sky": Node("sky_texture", params=sky),
        "background": Node("background", {"color": Link("sky", "color"), "strength": 1.0}),
    }
    lights = lights_of(world=World(Graph(nodes, surface=Link("background", "background"))))
    value = by_lights(lights, (0.0, 0.0, 0.0))
    sun = lights.arrays.world.sun
    assert sun[4] > 0.0 and value[:, 1].std() < 1.5 * value[:, 1].mean()
    # just within the disc is far brighter than just outside, all around
    side = np.array(warps.orthonormal_basis(*sun[:3])).reshape(2, 3)
    turn = np.arange(8)[:, None] * math.pi / 4
    rim = np.cos(turn) * side[0] + np.sin(turn) * side[1]
    angle = 0.5 * sky["sun_size"]
    inside = lights.world_radiance(sun[:3] + 0.9 * angle * rim, DIFFUSE)
    outside = lights.world_radiance(sun[:3] + 1.1 * angle * rim, DIFFUSE)
    assert inside.min() > 100.0 * outside.max()
    # light of the disc and of the rest, by quadrature
    z = (np.arange(256) + 0.5) / 128 - 1.0
    phi = (np.arange(512) + 0.5) / 512 * 2.0 * math.pi
    r = np.sqrt(1.0 - z * z)
    d = np.stack(
        [r[:, None] * np.cos(phi), r[:, None] * np.sin(phi), np.repeat(z[:, None], 512, 1)], -1
    ).reshape(-1, 3)
    away = d @ sun[:3] < math.cos(angle)
    rest = (
        (lights.world_radiance(d, DIFFUSE) * (np.maximum(d[:, 2:], 0.0) * away[:, None])).mean(0)
        * 4.0
        * math.pi
    )
    n = 4096
    disc = np.array([warps.uniform_cone(*sun[:3], sun[3], *u) for u in uniforms(n, 2)])[:, :3]
    solid_angle = 2.0 * math.pi * sun[3]
    disc = (lights.world_radiance(disc, DIFFUSE) * disc[:, 2:]).mean(0) * solid_angle
    assert value.mean(0) == pytest.approx(rest + disc, rel=0.02)


def test_world_and_lamps_hide_from_what_may_not_see_them():
    world = uniform_world()
    world.visibility = VISIBLE & ~CAMERA
    light = Light(
        "POINT", placed((0.0, 0.0, 2.0)), radius=0.5, soft_falloff=False, visibility=VISIBLE & ~GLOSSY
    )
    lights = lights_of([light], world)
    up = np.array([[0.0, 0.0, 1.0]])
    assert lights.world_radiance(up, CAMERA).max() == 0.0 and lights.world_radiance(up, DIFFUSE).min() > 0.0
    p, nor, trans = points((0.0, 0.0, 0.0), n=1)
    for bit, seen in ((CAMERA, True), (GLOSSY, False), (DIFFUSE, True)):
        out = np.zeros((1, 3), np.float32)
        lights.seen_lamps(
            p, up, np.zeros(1), np.array([9.0]), np.array([bit], np.uint8), nor, trans, np.array([np.inf]), out,
        )  # fmt: skip
        assert (out[0, 0] > 0.0) == seen
    for begins, ends in ((0.0, 1.4), (1.6, 9.0)):  # something stands before it; it was passed already
        out = np.zeros((1, 3), np.float32)
        lights.seen_lamps(
            p, up, np.array([begins]), np.array([ends]), np.array([CAMERA], np.uint8), nor, trans,
            np.array([np.inf]), out,
        )  # fmt: skip
        assert out.max() == 0.0
    sample = sampled(lights, (0.0, 0.0, 0.0), n=256)
    assert set(np.unique(sample.visibility[sample.kind == LAMP])) == {VISIBLE & ~GLOSSY}


def test_nothing_to_sample():
    lights = lights_of()
    assert lights.empty and not lights.only_met
    assert (sampled(lights, (0.0, 0.0, 0.0), n=4).kind == NONE).all()
    assert by_rays(lights, (0.0, 0.0, 0.0), n=64).max() == 0.0


def test_black_lights_are_left_out():
    lights = lights_of(
        [Light("POINT", power=0.0), Light("AREA", color=(0.0, 0.0, 0.0))], meshes=[quad(radiance=0.0)]
    )
    assert lights.empty and not lights.warnings


def test_lights_that_cannot_shine_are_named():
    bad = [
        Light("AREA", size_x=0.0, name="flat"),
        Light("POINT", placed((math.nan, 0.0, 0.0)), name="lost"),
        Light("SPOT", placed(scale=(0.0, 0.0, 0.0)), name="crushed"),
        Light("AREA", power=math.inf, name="endless"),
        Light("LASER", name="laser"),
    ]
    lights = lights_of([*bad, Light("POINT", placed((0.0, 0.0, 1.0)))])
    for light in bad:
        assert any(light.name in w for w in lights.warnings)
    assert (sampled(lights, (0.0, 0.0, 0.0), n=4).kind == LAMP).all()


@pytest.mark.parametrize("kind", ["POINT", "SPOT", "AREA"])
def test_lights_behind_the_surface(kind):
    lights = lights_of([Light(kind, placed((0.0, 0.0, -1.0), down=False), radius=0.1, spot_angle=2.0)])
    assert (sampled(lights, (0.0, 0.0, 0.0), n=16).kind == NONE).all()
    assert (sampled(lights, (0.0, 0.0, 0.0), n=16, transmissive=True).kind == LAMP).all()


@pytest.mark.parametrize("distance", [1e-6, 1e6])
def test_extreme_distances(distance):
    lamps = [Light("AREA", placed((0.0, 0.0, distance)), power=distance**2, size_x=1.0)]
    lamps += [
        Light("POINT", placed((0.0, 0.0, distance)), power=distance**2, radius=0.5, soft_falloff=s)
        for s in (0, 1)
    ]
    far = Group("far", [quad(radiance=max(1.0, distance**2))])
    lights = lights_of(lamps, instances=[instance(far, placed((0.0, 0.0, distance)))])
    out = sampled(lights, (0.0, 0.0, 0.0), n=1024)
    ok = out.kind != NONE
    assert ok.any() and np.isfinite(out.radiance[ok]).all() and np.isfinite(out.pdf[ok]).all()
    assert np.linalg.norm(out.direction[ok], axis=1) == pytest.approx(1.0)
    if distance > 1.0:
        each = [out.radiance[out.index == i, 0].mean() for i in range(1)]
        area = (out.radiance[:, 0] / out.pdf)[(out.kind == LAMP) & (out.index == 0)]
        assert np.isfinite(each).all() and area.std() < 1e-3 * area.mean()
