"""Emission that goes by the kind of the ray: what the camera sees is not what lights, against random rays."""

import numpy as np
import pytest

from pointmr_engine import Group, Material, Mesh, RenderSettings, Scene, principled, render
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import CAMERA, DIFFUSE, SHADOW, VISIBLE, instance
from tests.engine.small_scenes import from_above, quad
from tests.engine.test_raytrace_glass import sphere
from tests.engine.test_raytrace_light import DARK, card, image

GREY = principled(base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0)


def shining_to(kind: str, to: float, others: float) -> Material:
    """Emission of strength `to` where rays of that kind meet it, `others` where others do."""
    nodes = {
        "path": Node("light_path"),
        "strength": Node("mix_float", {"fac": Link("path", kind), "a": others, "b": to}),
        "e": Node("emission", {"strength": Link("strength", "value")}),
    }
    return Material("shines", Graph(nodes, surface=Link("e", "emission")))


def wall_and_floor(material: Material, **visibility) -> Scene:
    corners = [(-1, 1, 0.1), (1, 1, 0.1), (1, 1, 2), (-1, 1, 2)]
    wall = Group("wall", [card("wall", corners, material)])
    return Scene(
        Group("root", [quad(2.0, material=GREY)], [instance(wall, **visibility)]), from_above(5.0), [], DARK
    )


@pytest.mark.parametrize("method", ["distributed", "raytrace"])
def test_what_only_the_camera_sees_lights_nothing(method):
    dark = image(wall_and_floor(shining_to("is_camera_ray", 9.0, 0.0)), method=method, samples=16)
    assert dark[12:18, 20:28].max() == 0.0


@pytest.mark.parametrize("method", ["distributed", "raytrace"])
def test_what_the_camera_does_not_see_lights(method):
    cache = Cache()
    hidden = wall_and_floor(shining_to("is_camera_ray", 0.0, 3.0))
    plain = wall_and_floor(shining_to("is_camera_ray", 3.0, 3.0))
    floor = np.s_[12:24, 16:32]
    found, expected = (
        image(s, c, method=method, samples=128)[floor].mean() for s, c in ((hidden, cache), (plain, Cache()))
    )
    assert expected > 0.05
    assert found == pytest.approx(expected, rel=0.03)


def test_what_is_left_to_chance_is_met_by_scattered_rays():
    """Emission too weak to be sampled shines as diffuse rays see it, as random ones find it."""
    whole = wall_and_floor(shining_to("is_diffuse_ray", 0.45, 0.2))
    whole.root.instances[0].groups[0].meshes[0].materials[0].emission_sampling = "NONE"
    cache, floor = Cache(), np.s_[12:24, 16:32]
    exact = image(whole, cache, method="distributed", samples=1024)[floor].mean()
    assert image(whole, cache, cones=4)[floor].mean() == pytest.approx(exact, rel=0.04)


def test_glows_light_what_is_near_them():
    """Emission too weak to be sampled by any method is met by rays of diffuse surfaces."""
    glow = principled(base_color=(0.0, 0.0, 0.0), specular_ior_level=0.0, emission_strength=0.08)
    whole, cache, floor = wall_and_floor(glow), Cache(), np.s_[12:24, 16:32]
    exact = image(whole, cache, method="distributed", samples=1024)[floor].mean()
    assert exact > 0.005
    assert image(whole, cache, cones=4)[floor].mean() == pytest.approx(exact, rel=0.04)


@pytest.mark.parametrize(("strength", "sent"), [(0.04, False), (0.08, True), (0.2, False)])
def test_rays_look_for_glows_alone(strength, sent):
    """Not for what hardly glows, nor for what light samples find."""
    scene = wall_and_floor(principled(specular_ior_level=0.0, emission_strength=strength))
    counters = render(scene, RenderSettings(48, 36, method="raytrace")).stats["counters"]
    assert (counters.get("lobe_rays", 0) > 0) == sent


@pytest.mark.parametrize("missing", [SHADOW, DIFFUSE])
def test_what_is_left_to_chance_is_hidden_from_scattered_rays(missing):
    """A screen before it that throws no shadow stops the rays that would have met it; one that these do not meet,
    not."""
    nodes = {"e": Node("emission", {"strength": 0.4})}
    whole = wall_and_floor(
        Material("shines", Graph(nodes, surface=Link("e", "emission")), emission_sampling="NONE")
    )
    corners = [(-1.2, 0.9, 0.0), (1.2, 0.9, 0.0), (1.2, 0.9, 2.2), (-1.2, 0.9, 2.2)]
    screen = Group("screen", [card("screen", corners, GREY)])
    whole.root.instances.append(instance(screen, visibility=VISIBLE & ~(CAMERA | missing)))
    cache, floor = Cache(), np.s_[12:22, 16:32]
    exact = image(whole, cache, method="distributed", samples=1024)[floor].mean()
    ours = image(whole, cache, cones=4)[floor].mean()
    assert (exact > 0.01) == (missing == DIFFUSE)
    assert ours == pytest.approx(exact, rel=0.05, abs=1e-3)


def shell_that_shines_within(front: str) -> tuple[Mesh, Scene]:
    """A ball of a diffuse shader of that kind, seen from outside; its inside is a lamp."""
    nodes = {
        "side": Node("geometry"),
        "front": Node(front, {"color": (0.8, 0.8, 0.8)}),
        "back": Node("emission", {"strength": 4.0}),
        "both": Node("mix_shader", {
            "fac": Link("side", "backfacing"), "shader": Link("front", "bsdf"), "shader_b": Link("back", "emission"),
        }),
    }  # fmt: skip
    shell = Material("shell", Graph(nodes, surface=Link("both", "shader")))
    positions, triangles = sphere(160, 320)
    mesh = Mesh("ball", positions, triangles, normals=positions.astype(np.float32), materials=(shell,))
    return mesh, Scene(Group("root", [mesh]), from_above(5.0), [], DARK)


def test_a_closed_paper_surface_is_lit_by_its_inside():
    _, whole = shell_that_shines_within("translucent")
    cache, middle = Cache(), np.s_[12:24, 16:32]
    exact = image(whole, cache, method="distributed", samples=64)[middle].mean()
    assert exact == pytest.approx(0.8 * 4.0, rel=0.02)
    assert image(whole, cache, cones=4)[middle].mean() == pytest.approx(exact, rel=0.06)


@pytest.mark.parametrize("cones", [1, 4])
def test_a_closed_surface_is_not_lit_by_its_inside(cones):
    """Pieces of a ball stand for points that lie below others of them, from where its inside would be seen."""
    mesh, whole = shell_that_shines_within("diffuse")
    cache, triangles = Cache(), mesh.triangles
    exact = image(whole, cache, method="distributed", samples=64)
    assert image(whole, cache, cones=cones).mean() < 2.0 * exact.mean()  # a little, by smooth normals
    mesh.triangles, mesh.normals = triangles[:, ::-1].copy(), -mesh.normals
    assert image(whole, cones=cones)[18, 24].min() > 3.0  # turned inside out, it shines
