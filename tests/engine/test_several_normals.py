"""Materials whose lobes have normals of their own: bumps widen those that they bend, and no others."""

import math

import numpy as np
import pytest

from benchmarks.forward.scenes import look
from pointmr_engine import Camera, Group, Light, Material, Scene
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.texture import Image
from tests.engine.small_scenes import quad
from tests.engine.test_raytrace_light import DARK, image


def noise(scale: float) -> dict[str, Node]:
    """Noise of the object's coordinates at "t"."""
    return {
        "c": Node("texture_coordinate"),
        "t": Node("noise_texture", {"vector": Link("c", "object"), "scale": scale}),
    }


def means(
    nodes: dict[str, Node], displacement: Link | None, view: float, tilt: float, seeds: int = 1
) -> tuple[float, ...]:
    """How bright a plane under a sun is, by `distributed` and by one and four cones; angles from its normal.

    seeds: how many images of one cone, and fewer of four, for bumps that one place of a pixel stands for.
    """
    plane = quad(4.0, material=Material("plane", Graph(nodes, Link("s", "bsdf"), displacement)))
    eye = Camera(look((6 * math.sin(view), 0.3, 6 * math.cos(view)), (0.0, 0.0, 0.0)))
    sun = Light("SUN", look((-math.sin(tilt), 0.0, math.cos(tilt)), (0, 0, 0)), power=3.0, angle=0.05)
    scene = Scene(Group("root", [plane]), eye, [sun], DARK)
    middle = np.s_[10:26, 16:32]
    exact = image(scene, method="distributed", samples=256)[middle].mean()
    counts = {1: seeds, 4: max(seeds // 4, 1)}
    cones = (np.mean([image(scene, cones=n, seed=k)[middle] for k in range(counts[n])]) for n in counts)
    return exact, *cones


@pytest.mark.parametrize("roughness", [0.03, 0.1])
def test_a_smooth_coat_stays_smooth_over_bumps(roughness):
    """It was as wide as the bumps below it, and up to a third too dark near the sun in it."""
    nodes = noise(20.0) | {
        "b": Node("bump", {"height": Link("t", "fac"), "distance": 0.1}),
        "s": Node(
            "principled",
            {"base_color": (0.1, 0.1, 0.1), "metallic": 0.8, "roughness": 0.5, "normal": Link("b", "normal"),
             "coat_weight": 1.0, "coat_roughness": roughness},
        ),
    }  # fmt: skip
    exact, *ours = means(nodes, None, 1.0, 0.9)
    assert ours == pytest.approx([exact, exact], rel=0.15)


def test_a_coat_that_bumps_bend_is_as_wide_as_they_are():
    """The base stays smooth."""
    nodes = noise(60.0) | {
        "b": Node("bump", {"height": Link("t", "fac"), "distance": 0.004}),
        "s": Node(
            "principled",
            {"base_color": (0.1, 0.1, 0.1), "roughness": 0.5, "coat_normal": Link("b", "normal"),
             "coat_weight": 1.0, "coat_roughness": 0.1},
        ),
    }  # fmt: skip
    exact, *ours = means(nodes, None, 1.0, 0.9)
    assert ours == pytest.approx([exact, exact], rel=0.15)


@pytest.mark.parametrize("tilt", [-0.4, 0.4])
@pytest.mark.parametrize("scale", [3.0, 15.0])
def test_normal_maps_are_not_bent_by_displacements(scale, tilt):
    """A displacement that is shown as bumps widened what has its own normal: 0.06 to 1.57 of its light."""
    colour = (0.5 + 0.5 * math.sin(tilt), 0.5, 0.5 + 0.5 * math.cos(tilt))
    nodes = noise(scale) | {
        "d": Node("displacement", {"height": Link("t", "fac"), "scale": 0.09}),
        "n": Node("normal_map", {"color": colour}, {"space": "WORLD"}),
        "s": Node("glossy", {"roughness": 0.3, "normal": Link("n", "normal")}),
    }
    exact, *ours = means(nodes, Link("d", "displacement"), 0.4, 0.9)
    assert ours == pytest.approx([exact, exact], rel=0.1)


def slopes(seed: int = 3) -> Image:
    """A tangent-space normal map of waves of a dozen texels, whose slopes have a deviation of a half."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(64), np.fft.fftfreq(64)))
    height = np.random.default_rng(seed).normal(size=(64, 64))
    height = np.real(np.fft.ifft2(np.fft.fft2(height) * np.exp(-((12 * frequency) ** 2))))
    rise = np.stack(np.gradient(height), -1)
    rise *= 0.5 / rise.std()
    normals = np.concatenate([-rise[..., ::-1], np.ones((64, 64, 1))], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    pixels = np.ones((64, 64, 4), np.float32)
    pixels[..., :3] = 0.5 + 0.5 * normals
    return Image("slopes", pixels, "Non-Color")


@pytest.mark.parametrize("view", [0.4, 1.0])
@pytest.mark.parametrize("roughness", [0.1, 0.3])
def test_normal_maps_are_as_rough_from_afar_as_they_are(roughness, view):
    """A pixel shows twenty texels across. Filtered, they were nearly flat: 1.7 to 2.6 times too bright by the sun."""
    nodes = {
        "c": Node("texture_coordinate"),
        "m": Node("mapping", {"vector": Link("c", "object"), "scale": (3.0, 3.0, 3.0)}),
        "i": Node("image_texture", {"vector": Link("m", "vector")}, {"image": slopes()}),
        "n": Node("normal_map", {"color": Link("i", "color")}, {"space": "WORLD"}),
        "s": Node("glossy", {"roughness": roughness, "normal": Link("n", "normal")}),
    }
    exact, *ours = means(nodes, None, view, 0.9, seeds=32)
    assert ours == pytest.approx([exact, exact], rel=0.2)
