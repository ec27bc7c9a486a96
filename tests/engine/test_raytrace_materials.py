"""Method "raytrace" against many random rays, for materials drawn by chance: as bright on each of three surfaces."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.closed_forms import curved_mirror
from benchmarks.forward.scenes import look
from pointmr_engine import Camera, Group, Light, Material, Scene, principled, uniform_world
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from tests.engine.small_scenes import half_a_sky, quad
from tests.engine.test_raytrace_light import DARK, card, image

# in images of 48 x 36, bottom row first
PARTS = {
    "floor": np.s_[0:9, 4:44],
    "ball": np.s_[12:24, 18:30],
    "wall": np.s_[27:36, 4:44],
    "image": np.s_[:, :],
}
CHOICES = {
    "roughness": (0.3, 0.5, 0.7, 0.9),
    "metallic": (0.0, 0.0, 1.0, 0.5),
    "transmission_weight": (0.0, 0.0, 0.0, 0.6, 1.0),
    "sheen_weight": (0.0, 0.0, 0.0, 0.7),
    "anisotropic": (0.0, 0.0, 0.6),
    "specular_ior_level": (0.5, 0.5, 0.5, 1.0),
    "alpha": (1.0, 1.0, 1.0, 0.6),
}
SUN = Light("SUN", look((-2, -3, 7), (0, 0, 0)), power=4.5, angle=0.2)
LAMP = Light("POINT", look((-1.5, -2, 4), (0, 0, 0)), power=400.0, radius=0.3)
SKY = uniform_world((0.5, 0.7, 1.0))


def material(rng, name: str) -> Material:
    values = {key: float(rng.choice(of)) for key, of in CHOICES.items()}
    return principled(name, base_color=tuple(rng.uniform(0.1, 0.95, 3).tolist()), **values)


def room(seed: int) -> Scene:
    """A ball above a floor before a wall, under a wide sun, a lamp, or the sky alone."""
    rng = np.random.default_rng(seed)
    body = curved_mirror.sphere(24)
    positions = (0.6 * body.positions + (0.1, 0, 0.6)).astype(np.float32)
    ball = replace(body, positions=positions, materials=(material(rng, "ball"),))
    wall = card("wall", [(-3, 1.2, 0), (3, 1.2, 0), (3, 1.2, 3), (-3, 1.2, 3)], material(rng, "wall"))
    floor = quad(4.0, material=material(rng, "floor"))
    lights, world = [([SUN], DARK), ([LAMP], DARK), ([], SKY), ([LAMP], SKY)][rng.integers(4)]
    return Scene(
        Group("root", [ball, wall, floor]), Camera(look((0, -5, 2.2), (0, 0, 0.6))), list(lights), world
    )


@pytest.mark.parametrize(
    "seed", [*range(4), *(pytest.param(s, marks=pytest.mark.slow) for s in range(4, 24))]
)
def test_chance_materials_are_as_bright_as_by_random_rays(seed):
    scene, cache = room(seed), Cache()
    exact = np.array([image(scene, cache, method="distributed", samples=256, seed=s) for s in range(2)])
    ours = np.array([image(scene, cache, seed=s) for s in range(6)])
    for name, part in PARTS.items():
        a, b = ours[:, part[0], part[1]].mean((1, 2)), exact[:, part[0], part[1]].mean((1, 2))
        noise = np.hypot(a.std(0, ddof=1) / len(a) ** 0.5, 0.5 * np.abs(b[0] - b[1]))
        off = np.abs(a.mean(0) - b.mean(0))
        assert (off <= 0.04 * b.mean(0) + 3.0 * noise + 0.002).all(), (name, a.mean(0) / b.mean(0))


@pytest.mark.parametrize("roughness", [0.1, 0.2, 0.5])
@pytest.mark.parametrize("height", [0.3, 1.0])
def test_edges_of_tinted_metal_are_as_dark_as_by_random_rays(roughness, height):
    """The tint darkens metal at grazing angles, whether its lobes take rays or cones."""
    metal = principled(
        base_color=(0.8, 0.6, 0.3), metallic=1.0, roughness=roughness, specular_tint=(0.0, 0.0, 0.0)
    )
    scene = Scene(
        Group("root", [quad(40.0, material=metal)]),
        Camera(look((0, -3, height), (0, 0, 0))),
        [],
        uniform_world((1, 1, 1)),
    )
    cache = Cache()
    exact, ours = (
        image(scene, cache, method=method, samples=64)[14:20].mean() for method in ("distributed", "raytrace")
    )
    assert exact < 0.5 and ours == pytest.approx(exact, rel=0.1, abs=0.01)


def test_ashikhmin_and_shirleys_gloss_is_as_rough_as_it_says():
    """Its lobes were all taken for 0.3."""
    inputs = {"color": (0.8, 0.8, 0.8), "roughness": 0.1}
    nodes = {"gloss": Node("glossy", inputs, {"distribution": "ashikhmin_shirley"})}
    floor = quad(40.0, material=Material("gloss", Graph(nodes, surface=Link("gloss", "bsdf"))))
    scene = Scene(Group("root", [floor]), Camera(look((0, -3, 2), (0, 0, 0))), [], half_a_sky())
    exact, ours = (image(scene, Cache(), method=m, samples=256) for m in ("distributed", "raytrace"))
    assert exact.std() > 0.1 and np.abs(ours - exact).mean() < 0.04
