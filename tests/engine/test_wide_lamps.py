"""Wide lamps in method "raytrace": what their shadows show of surfaces that let light through, and their edges."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.forward.scenes import look
from pointmr_engine import Camera, Group, Light, Material, Mesh, Scene, principled
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import CAMERA, VISIBLE, instance
from tests.engine.instanced import sphere
from tests.engine.small_scenes import from_above, quad
from tests.engine.test_cut_outs import leaf, leaves
from tests.engine.test_raytrace_glass import ball
from tests.engine.test_raytrace_light import DARK, card, image

GREY = principled(base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0)
AREA = Light("AREA", look((0, 0, 4), (0, 0, 0)), power=100.0, size_x=1.0)


def under(sheet: Mesh, light: Light, camera=None) -> Scene:
    """A floor below a sheet that the camera does not see."""
    above = instance(Group("above", [sheet]), visibility=VISIBLE & ~CAMERA)
    return Scene(Group("root", [quad(6.0, material=GREY)], [above]), camera or from_above(5.0), [light], DARK)


def both(scene: Scene, samples: int = 256, cones: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Images by random rays, and by cones."""
    cache = Cache()
    return image(scene, cache, method="distributed", samples=samples), image(scene, cache, cones=cones)


def tinted(color) -> Material:
    return Material("film", Graph({"t": Node("transparent", {"color": color})}, surface=Link("t", "bsdf")))


def test_shadows_of_films_have_their_colour():
    exact, ours = both(under(quad(1.5, z=1.0, material=tinted((0.9, 0.3, 0.1))), AREA))
    middle = np.s_[16:20, 22:26]
    np.testing.assert_allclose(ours[middle].mean((0, 1)), exact[middle].mean((0, 1)), rtol=0.02)
    assert exact[middle].mean((0, 1))[0] > 5 * exact[middle].mean((0, 1))[2]  # there is a colour to be lost
    assert np.abs(ours - exact).mean() < 0.02 * exact.mean()


def test_shadows_of_cards_have_the_shape_of_their_leaves():
    material = leaf()
    mesh = leaves(1, material)
    mesh = replace(mesh, positions=(mesh.positions + (0, 0, 0.4)).astype(np.float32))
    exact, ours = both(under(mesh, replace(AREA, size_x=0.6), from_above(2.5)))
    shadow = exact.mean(2) / exact.max()
    assert shadow.min() < 0.3 and np.median(shadow) > 0.6  # stems, not a square
    assert np.abs(ours - exact).mean() < 0.03 * exact.mean()


@pytest.mark.parametrize("cones", [1, 4])
def test_opaque_scenes_send_no_rays_to_wide_lamps(cones):
    from pointmr_engine import RaytraceSettings, RenderSettings, render

    scene = under(quad(1.5, z=1.0, material=GREY), AREA)
    settings = RenderSettings(24, 24, method="raytrace", raytrace=RaytraceSettings(cones=cones))
    counters = render(scene, settings).stats["counters"]
    assert counters["lamp_cones"] > 0 and counters.get("shadow_rays", 0) == 0


BEAMS = {
    "spread": Light("AREA", look((0, 0, 3), (0, 0, 0)), power=100.0, size_x=0.5, spread=0.7),
    "spot": Light(
        "SPOT", look((0, 0, 3), (0, 0, 0)), power=300.0, radius=0.4, spot_angle=0.8, spot_blend=0.3
    ),
}


@pytest.mark.parametrize("name", list(BEAMS))
def test_beams_have_soft_edges(name):
    scene = Scene(Group("root", [quad(6.0, material=GREY)]), from_above(5.0), [BEAMS[name]], DARK)
    exact, ours = both(scene, cones=16)
    assert exact.max() > 0.1 and (exact == 0).mean() > 0.1
    assert np.abs(ours - exact).mean() < 0.03 * exact.mean()


@pytest.mark.parametrize("sides", [(3.5, 0.3), (0.3, 3.5), (1.0, 1.0)])
@pytest.mark.parametrize("place", [(0, 0.2, 3), (0, 0, 3), (0, -0.4, 3), (1.5, -0.1, 1.5)])
def test_a_surface_that_sees_a_part_of_a_lamp_is_lit_by_it(place, sides):
    wall = card("wall", [(-0.5, 0, 0), (0.5, 0, 0), (0.5, 0, 1), (-0.5, 0, 1)], GREY)
    lamp = Light(
        "AREA", look(place, (0, 0, 0.5)), power=100.0, shape="RECTANGLE", size_x=sides[0], size_y=sides[1]
    )
    scene = Scene(Group("root", [wall]), Camera(look((0, -4, 0.5), (0, 0, 0.5))), [lamp], DARK)
    exact, ours = (a[16:20, 22:26].mean() for a in both(scene))
    assert ours == pytest.approx(exact, rel=0.02, abs=0.001)


@pytest.mark.parametrize("method", ["raytrace", "forward"])
@pytest.mark.parametrize(("shape", "height"), [("RECTANGLE", 1.0), ("ELLIPSE", 2.0)])
@pytest.mark.parametrize("turn", [False, True])
def test_long_lamps_light_what_is_near_them(shape, height, turn, method):
    """A tube is more points along than across: of two by two, it was 1.3 % too bright here, or 5 % too dark."""
    sides = (0.3, 3.5) if turn else (3.5, 0.3)
    lamp = Light(
        "AREA", look((0, 0, height), (0, 0, 0)), power=100.0, shape=shape, size_x=sides[0], size_y=sides[1]
    )
    scene = Scene(Group("root", [quad(6.0, material=GREY)]), from_above(5.0), [lamp], DARK)
    cache = Cache()
    exact = image(scene, cache, method="distributed", samples=256)
    ours = image(scene, cache, method=method)
    np.testing.assert_allclose(ours[12:24, 18:30].mean(), exact[12:24, 18:30].mean(), rtol=0.006)
    assert np.abs(ours - exact).mean() < 0.006 * exact.mean()


@pytest.mark.parametrize(
    "light",
    [
        Light("POINT", look((-2, -3, 4), (0, 0, 0)), power=300.0, radius=0.4, cast_shadow=False),
        Light("SPOT", look((-2, -3, 4), (0, 0, 0)), power=300.0, radius=0.4, spot_angle=0.8),
        Light("AREA", look((-2, -3, 4), (0, 0, 0)), power=300.0, size_x=1.2, spread=1.7),
    ],
    ids=["no shadow", "spot", "spread"],
)
def test_highlights_and_shadows_of_beams_have_no_noise(light):
    """By rays, the highlight's light differed by a third from image to image."""
    metal = principled("metal", base_color=(0.8, 0.8, 0.8), metallic=1.0, roughness=0.15)
    floor = quad(6.0, -1.05, GREY, "floor")
    scene = Scene(
        Group("root", [ball(metal), floor]),
        Camera(look((0, -6, 2), (0, 0, 0)), focal_length=70),
        [light],
        DARK,
    )
    cache = Cache()
    exact = np.mean([image(scene, cache, method="distributed", samples=256, seed=s) for s in range(2)], 0)
    ours = np.array([image(scene, cache, seed=s) for s in range(4)])
    assert ours.std(0).mean() < 0.005 * exact.mean()
    assert np.abs(ours.mean(0) - exact).mean() < 0.05 * exact.mean()


TUBE = Light("AREA", look((0, 2, 1), (0, 0, 0)), power=200.0, shape="RECTANGLE", size_x=3.0, size_y=0.1,
             visibility=VISIBLE & ~CAMERA)  # fmt: skip
WIDE_SUN = Light("SUN", look((3, -2, 3.5), (0, 0, 0)), power=3.0, angle=0.5)


def shell(kind: str) -> Mesh:
    """A ball of paper, or half clear."""
    nodes = {
        "d": Node("diffuse", {"color": (0.6, 0.5, 0.3)}),
        "t": Node("transparent", {"color": (1.0, 1.0, 1.0)}),
    }
    nodes["l"] = Node("translucent", {"color": (0.6, 0.5, 0.3)})
    nodes["m"] = Node("mix_shader", {"fac": 0.5, "shader": Link("d", "bsdf"), "shader_b": Link("t", "bsdf")})
    material = Material(kind, Graph(nodes, Link("l", "bsdf") if kind == "paper" else Link("m", "shader")))
    positions, triangles = sphere(24, 48)
    normals = positions.astype(np.float32)
    return Mesh(kind, positions, triangles, normals=normals, materials=(material,), terminator_offset=0.1)


@pytest.mark.parametrize("light", [TUBE, WIDE_SUN], ids=["tube", "sun"])
@pytest.mark.parametrize("kind", ["paper", "half clear"])
def test_shells_are_lit_by_what_of_a_lamp_each_side_of_them_sees(kind, light):
    """Where its plane cuts a lamp, paper was lit by what of it is on the viewer's side alone (it had 0.75 of the sun's
    light); and a ray to a place of the lamp below the horizon told that nothing arrives (0.87 of the tube's).
    """
    eye = Camera(look((0, -0.9, -0.2), (0, 0.5, 0.3)) if kind == "paper" else look((0, -5, 2), (0, 0, 0)))
    exact, ours = both(Scene(Group("root", [shell(kind)]), eye, [light], DARK), cones=1)
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.01 if kind == "paper" else 0.03)
