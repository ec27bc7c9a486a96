"""Surfaces that let light through or not depending on where they are seen from, against random rays."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.forward.scenes import look
from pointmr_engine import Camera, Group, Light, Material, RenderSettings, Scene, render, uniform_world
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import instance
from pointmr_engine.scene.settings import RaytraceSettings
from tests.engine.small_scenes import quad
from tests.engine.test_wide_lamps import GREY

SETTINGS = RenderSettings(48, 36, samples=128, passes=("combined",))
SKY = uniform_world((0.3, 0.4, 0.6))
SUN = Light("SUN", look((1, 0, 3), (0, 0, 0)), power=2.0, angle=0.0)


MULTIPLIED = {"operation": "MULTIPLY"}


def seen_by(share: Link, view: Node, alpha: float = 1.0) -> Material:
    """Red where `share`, of the nodes "view" and "path", is 0; clear where it is 1. alpha: of the red side."""
    nodes = {
        "view": view,
        "path": Node("light_path"),
        "red": Node("diffuse", {"color": (0.8, 0.1, 0.1)}),
        "clear": Node("transparent", {"color": (1.0, 1.0, 1.0)}),
        "side": Node("mix_shader", {"fac": alpha, "shader": Link("clear", "bsdf"), "shader_b": Link("red", "bsdf")}),
        "both": Node("mix_shader", {"fac": share, "shader": Link("side", "shader"), "shader_b": Link("clear", "bsdf")}),
    }  # fmt: skip
    return Material("by view", Graph(nodes, surface=Link("both", "shader")))


MATERIALS = {
    "clear from behind": seen_by(Link("view", "backfacing"), Node("geometry")),
    "half clear from behind": seen_by(Link("view", "backfacing"), Node("geometry"), alpha=0.5),
    "clear where it faces": seen_by(Link("view", "facing"), Node("layer_weight", {"blend": 0.5})),
    "by Fresnel's law": seen_by(Link("view", "fac"), Node("fresnel", {"ior": 1.6})),
    "by distance": seen_by(
        Link("view", "value"), Node("math", {"value": Link("path", "ray_length"), "value_b": 0.2}, MULTIPLIED)
    ),
    "behind others": seen_by(
        Link("view", "value"),
        Node("math", {"value": Link("path", "transparent_depth"), "value_b": 0.7}, MULTIPLIED),
    ),
    "to shadow rays": seen_by(Link("path", "is_shadow_ray"), Node("light_path")),
    "to scattered rays": seen_by(Link("path", "is_diffuse_ray"), Node("light_path")),
    "to the camera": seen_by(Link("path", "is_camera_ray"), Node("light_path")),
}


def scene(material: Material, turn: float) -> Scene:
    """A floor and a card above it that is turned about x, 0: it faces the camera."""
    c, s = np.cos(turn), np.sin(turn)
    placed = np.eye(4)
    placed[:3, :3] = [[1, 0, 0], [0, c, -s], [0, s, c]]
    placed[2, 3] = 1.5
    pair = [
        quad(1.5, z=0.1 * k, material=material) for k in range(2)
    ]  # of which the second is seen through the first
    card = instance(Group("card", pair), placed)
    eye = np.eye(4)
    eye[2, 3] = 5.0
    return Scene(Group("root", [quad(6.0, material=GREY)], [card]), Camera(eye), [SUN], SKY)


def close(scene: Scene, **values) -> None:
    cache = Cache()
    exact, ours = (
        render(scene, replace(SETTINGS, method=m, **values), cache=cache).passes["combined"].astype(float)
        for m in ("distributed", "raytrace")
    )
    middle = np.s_[14:22, 20:28]  # dithers meet by chance in each pixel
    np.testing.assert_allclose(ours[middle].mean((0, 1)), exact[middle].mean((0, 1)), rtol=0.06, atol=0.01)
    assert np.abs(ours - exact)[..., :3].mean() <= 0.04 * exact[..., :3].mean()


@pytest.mark.parametrize("name", MATERIALS)
@pytest.mark.parametrize("turn", [0.0, 1.0, 2.2, np.pi])
def test_from_all_sides(name, turn):
    close(scene(MATERIALS[name], turn))


@pytest.mark.parametrize("turn", [0.0, np.pi])
def test_by_alpha(turn):
    close(scene(MATERIALS["clear from behind"], turn), raytrace=RaytraceSettings(visibility="alpha"))


@pytest.mark.parametrize("turn", [0.0, np.pi])
def test_on_a_transparent_film(turn):
    whole = scene(MATERIALS["clear from behind"], turn)
    close(whole, film_transparent=True)
    close(replace(whole, root=Group("root", [], whole.root.instances)), film_transparent=True)


@pytest.mark.parametrize("turn", [0.0, np.pi])
def test_through_a_lens(turn):
    whole = scene(MATERIALS["clear from behind"], turn)
    close(replace(whole, camera=Camera(whole.camera.world_from_camera, fstop=0.5, focus_distance=3.5)))


def test_far_away():
    """Where the cards are sampled, and smaller than pixels."""
    material = MATERIALS["clear from behind"]
    rng = np.random.default_rng(1)
    leaf, cards = quad(0.03, material=material), []
    for k in range(900):
        placed = np.eye(4)
        placed[:3, 3] = *rng.uniform(-1.2, 1.2, 2), rng.uniform(0.5, 1.5)
        if k % 2:
            placed[:3, :3] = np.diag([1.0, -1.0, -1.0])
        cards.append(instance(Group("leaf", [leaf]), placed))
    many = Group("many", [], cards)
    eye = np.eye(4)
    eye[2, 3] = 5.0
    close(Scene(Group("root", [quad(6.0, material=GREY)], [instance(many)]), Camera(eye), [SUN], SKY))
