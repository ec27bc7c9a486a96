"""Lobes of first surfaces by cones: what a mirror of any roughness, bumps among it, shows of a square that shines."""

import math

import numpy as np
import pytest

from benchmarks.forward.scenes import look
from pointmr_engine import (
    Camera,
    Group,
    Light,
    Material,
    Mesh,
    RaytraceSettings,
    RenderSettings,
    Scene,
    emission,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.texture import Image
from tests.engine.small_scenes import quad, sky_with_a_sun
from tests.engine.test_raytrace_light import card, image

ANGLE = math.radians(40)
INNER = np.s_[12:36, 16:48, :3]
BLACK = (0.0, 0.0, 0.0)


def glossy(roughness=0.0, distribution="ggx", height: Node | None = None, distance=0.0) -> Material:
    """Of roughness^2 as its alpha; bent by a height."""
    inputs = {"color": (0.8, 0.8, 0.8), "roughness": roughness}
    nodes = {"g": Node("glossy", inputs, {"distribution": distribution})}
    if height is not None:
        inputs["normal"] = Link("b", "normal")
        output = "color" if height.kind == "image_texture" else "fac"
        nodes |= {
            "c": Node("texture_coordinate"),
            "t": height,
            "b": Node("bump", {"height": Link("t", output), "distance": distance}),
        }
        if height.kind == "image_texture":
            scale = height.inputs.pop("scale")
            nodes["m"] = Node("mapping", {"vector": Link("c", "object"), "scale": (scale,) * 3})
            height.inputs["vector"] = Link("m", "vector")
    return Material("glossy", Graph(nodes, surface=Link("g", "bsdf")))


def below_a_lamp(material: Material, size: float) -> Scene:
    """A floor that mirrors a square of `size` towards the camera, 6 m away."""
    c, s = math.cos(ANGLE), math.sin(ANGLE)
    eye = np.eye(4)
    eye[:3, :3] = [[1, 0, 0], [0, c, -s], [0, s, c]]
    eye[:3, 3] = 12.0 * eye[:3, 2]
    plain = quad(size, material=emission("lamp", strength=1.0))
    corners = plain.positions @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) + [0, 6 * s, 6 * c]
    lamp = Mesh(
        "lamp", corners.astype(np.float32), plain.triangles[:, ::-1].copy(), materials=plain.materials
    )
    floor = quad(4.0, material=material)
    return Scene(Group("root", [floor, lamp]), Camera(eye, focal_length=80.0), [], uniform_world(BLACK))


def mirrored(scene: Scene, **settings) -> float:
    """Mean light of the middle of the image."""
    images = [render(scene, RenderSettings(64, 48, seed=k, **settings)).passes["combined"] for k in range(2)]
    return float(np.mean(images, 0)[INNER].mean())


@pytest.mark.parametrize("size", [3.0, 8.0])
@pytest.mark.parametrize("alpha", [0.06, 0.14, 0.28])
@pytest.mark.parametrize(
    ("distribution", "off"), [("beckmann", 0.015), ("ashikhmin_shirley", 0.03), ("ggx", 0.025)]
)
def test_rough_mirrors_show_as_much_of_a_lamp_as_their_distribution_sends(distribution, off, alpha, size):
    """Cones weighed all lobes by GGX's slopes: others were 8 to 14 % too dark.

    GGX's tails, taken at the middle of their cells, were less than they are: what is in the middle was 4 % too bright.
    """
    scene = below_a_lamp(glossy(math.sqrt(alpha), distribution), size)
    exact = mirrored(scene, method="distributed", samples=64)
    assert mirrored(scene, method="raytrace") == pytest.approx(exact, rel=off)


def grain() -> Image:
    pixels = np.ones((256, 256, 4), np.float32)
    pixels[..., :3] = np.random.default_rng(0).random((256, 256, 1))
    return Image("grain", pixels, "Linear")


@pytest.mark.parametrize(
    ("scale", "distance", "off"),
    [(0.2, 0.005, 0.1), (0.1, 0.01, 0.03), (0.05, 0.02, 0.03), (0.02, 0.05, 0.03)],
)
def test_mirrors_that_images_bend_are_as_rough_as_what_a_fragment_shows_of_them(scale, distance, off):
    """From texels half as large as a fragment to five times: filtered flat, the smallest showed 30 % too much."""
    height = Node("image_texture", {"scale": scale}, {"image": grain()})
    scene = below_a_lamp(glossy(height=height, distance=distance), 3.0)
    exact = mirrored(scene, method="distributed", samples=128)
    assert 0.35 < exact < 0.45  # of 0.58 of a flat mirror
    assert mirrored(scene, method="raytrace") == pytest.approx(exact, rel=off)
    fine = RaytraceSettings(cones=4)
    assert mirrored(scene, method="raytrace", raytrace=fine) == pytest.approx(exact, rel=0.03)


@pytest.mark.parametrize(("scale", "distance"), [(40.0, 0.02), (100.0, 0.01)])
def test_light_samples_look_for_lamps_in_mirrors_that_bumps_make_rough(scale, distance):
    """Lobes wide enough for rays share lamps with light samples, which took mirrors for mirrors: half was missing."""
    noise = Node("noise_texture", {"vector": Link("c", "object"), "scale": scale, "detail": 2.0})
    scene = below_a_lamp(glossy(height=noise, distance=distance), 8.0)
    exact = mirrored(scene, method="distributed", samples=128)
    assert mirrored(scene, method="raytrace") == pytest.approx(exact, rel=0.06)


def test_gloss_shows_what_a_sun_and_a_sky_light_without_a_choice_between_them():
    """One of both was chosen by chance wherever a ray ended: nearly three times the noise that each brings."""
    floor = quad(4.0, material=glossy(0.45))
    corners = np.array([[-99, 2, 0], [99, 2, 0], [99, 2, 99], [-99, 2, 99]], np.float32)
    matte = Graph({"d": Node("diffuse", {"color": (0.8, 0.8, 0.8)})}, surface=Link("d", "bsdf"))
    wall = Mesh("wall", corners, floor.triangles, materials=(Material("wall", matte),))
    camera = Camera(look((0, -6, 3), (0, 0, 0)), focal_length=80.0)
    sun = Light("SUN", look((0, -4, 6), (0, 2, 2)), power=4.0, angle=0.01)

    def noise(lamps, world):
        scene = Scene(Group("root", [floor, wall]), camera, lamps, world)
        images = [
            render(scene, RenderSettings(64, 48, seed=k, method="raytrace")).passes["combined"]
            for k in range(4)
        ]
        return float(np.var(images, 0)[INNER].mean())

    sky = uniform_world((1.0, 1.0, 1.0))
    both, by_sun, by_sky = noise([sun], sky), noise([sun], uniform_world(BLACK)), noise([], sky)
    assert both < 1.7 * (by_sun + by_sky)


@pytest.mark.parametrize(("roughness", "least"), [(0.3, 0.97), (0.5, 0.94), (0.7, 0.94)])
def test_rough_metal_shows_a_sun_of_the_sky_as_bright_as_by_random_rays(roughness, least):
    """What rays within lobes see of it is blurred, but has no tails besides those that the rays were drawn from."""
    metal = principled("metal", base_color=(0.2, 0.2, 0.2), roughness=roughness, metallic=1.0)
    wall = card("wall", [(0, -9, -9), (0, 9, -9), (0, 9, 9), (0, -9, 9)], metal)
    camera = Camera(look((5, 0, 0), (0, 0, 0)))
    scene, cache = Scene(Group("root", [wall]), camera, [], sky_with_a_sun(0.9, 10.0, 0.5, "x")), Cache()
    exact = image(scene, cache, method="distributed", samples=1024).mean()
    ours = np.mean([image(scene, cache, seed=s).mean() for s in range(4)])
    assert least < ours / exact < 1.02


@pytest.mark.parametrize("rotation", [0.0, 0.25])
def test_brushed_metal_is_no_round_lobe(rotation):
    """It takes rays, for cones are round: one as rough as its mean was off by 34 to 82 %."""

    def floor(anisotropic: float) -> Scene:
        metal = principled(
            base_color=(0.8, 0.8, 0.8), metallic=1.0, roughness=0.3, anisotropic=anisotropic,
            anisotropic_rotation=rotation,
        )  # fmt: skip
        return below_a_lamp(metal, 3.0)

    size, cache = (64, 48), Cache()
    exact = image(floor(0.9), cache, size, method="distributed", samples=1024)
    ours = np.mean([image(floor(0.9), cache, size, seed=k) for k in range(8)], 0)
    even = image(floor(0.0), Cache(), size, method="distributed", samples=256)
    assert np.abs(even - exact).mean() > 0.2 * exact.mean()
    assert np.abs(ours - exact).mean() < 0.1 * exact.mean()
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.02)
