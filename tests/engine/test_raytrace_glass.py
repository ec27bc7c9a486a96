"""Method "raytrace" where light meets what is sharp: clear glass, curved mirrors, and highlights of lamps in them."""

import math

import numpy as np
import pytest

from benchmarks.forward.scenes import look
from pointmr_engine import (
    Camera,
    Group,
    Instances,
    Light,
    Material,
    Mesh,
    RenderSettings,
    Scene,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import instance
from tests.engine.instanced import sphere
from tests.engine.small_scenes import at, half_a_sky, quad
from tests.engine.test_raytrace_light import DARK, card, image

GLASS = principled("glass", base_color=(1.0, 1.0, 1.0), roughness=0.0, transmission_weight=1.0, ior=1.5)
CHROME = principled("chrome", base_color=(0.5, 0.5, 0.5), roughness=0.0, metallic=1.0)
CAMERA = Camera(look((0, -6, 2), (0, 0, -0.2)))
# where CAMERA sees them in images of 48 x 36
BALL, FLOOR = np.s_[..., 12:26, 16:32, :], np.s_[..., 2:10, :, :]


def ball(material) -> Mesh:
    """A sphere with smooth normals about the origin."""
    positions, triangles = sphere(48, 96)
    return Mesh("ball", positions, triangles, normals=positions.astype(np.float32), materials=(material,))


def lamps(count: int) -> list[Light]:
    """Square lamps in a ring above the scene: of more than two, rays look for one of many."""
    angles = np.linspace(0.3, 5.0, count)
    places = [(2.0 * math.cos(a), 1.0 + 2.0 * math.sin(a), 2.5) for a in angles]
    return [Light("AREA", look(p, (0, 0, 0)), shape="SQUARE", size_x=0.8, power=200.0) for p in places]


def floor(**values) -> Mesh:
    return quad(12.0, -1.05, principled("floor", base_color=(0.7, 0.7, 0.7), **values), "floor")


def exact_and_ours(scene: Scene, seeds: int) -> tuple[np.ndarray, np.ndarray]:
    """(image of many random rays, images (seeds, ...) by cones)."""
    cache = Cache()
    exact = np.mean([image(scene, cache, method="distributed", samples=512, seed=s) for s in range(4)], 0)
    return exact, np.array([image(scene, cache, seed=s) for s in range(seeds)])


@pytest.mark.parametrize("material", [CHROME, principled("clay", base_color=(0.8, 0.8, 0.8), roughness=0.9)])
def test_normals_do_not_hang_on_where_a_mesh_has_its_origin(material):
    """Vertices far from the origin are stored about their middle, of which normals between them must know."""
    near = ball(material)
    away = np.float32([2.0, -3.0, 1.0])
    far = Mesh("ball", near.positions + away, near.triangles, normals=near.normals, materials=near.materials)
    back = np.eye(4)[None, :3].copy()
    back[0, :, 3] = -away
    pictures = []
    for root in (Group("near", [near]), Group("far", instances=[Instances((Group("moved", [far]),), back)])):
        pictures.append(image(Scene(root, CAMERA, lamps(2), uniform_world((0.1, 0.1, 0.1)))))
    assert pictures[0][BALL].mean() > 0.1
    assert np.abs(pictures[1] - pictures[0]).mean() < 0.01 * pictures[0].mean()


def test_clear_glass_is_as_bright_as_what_is_about_it():
    """In a world that shines evenly it cannot be seen; at its rim, light leaves by way of total reflection inside."""
    scene = Scene(Group("root", [ball(GLASS)]), CAMERA, [], uniform_world((1.0, 1.0, 1.0)))
    ours = np.sort(np.mean([image(scene, Cache(), seed=s) for s in range(8)], 0).mean(-1).ravel())
    assert ours.mean() == pytest.approx(1.0, abs=2e-3)
    assert ours[1:13].mean() > 0.94  # of the rim


@pytest.mark.parametrize("method", ["raytrace", "distributed"])
@pytest.mark.parametrize("roughness", [0.3, 0.9])
def test_rough_glass_sends_on_what_it_meets(method, roughness):
    """White glass below a world of one radiance: no brighter and no darker, though its lobes say more to lamps."""
    glass = principled("glass", base_color=(1.0, 1.0, 1.0), roughness=roughness, transmission_weight=1.0)
    scene = Scene(Group("root", [quad(4.0, material=glass)]), CAMERA, [], uniform_world((0.7, 0.7, 0.7)))
    seen = image(scene, method=method, samples=128)[8:14, 12:-12]
    assert seen.mean() == pytest.approx(0.7, rel=0.004)


@pytest.mark.parametrize("values", [{}, {"roughness": 0.5, "metallic": 0.5}, {"coat_weight": 1.0}])
def test_what_is_half_transparent_keeps_its_light(values):
    """Glossy lobes weigh one and reflect little: they take nothing of what an opaque surface would send."""
    veil = principled("veil", **{"base_color": (0.5, 0.7, 0.2), "roughness": 0.9, "alpha": 0.6} | values)
    sun = Light("SUN", look((-2, -3, 7), (0, 0, 0)), power=4.5, angle=0.0)
    scene = Scene(Group("root", [quad(4.0, material=veil)]), CAMERA, [sun], DARK)
    exact = image(scene, method="distributed", samples=256)[8:14, 12:-12].mean((0, 1))
    np.testing.assert_allclose(image(scene)[8:14, 12:-12].mean((0, 1)), exact, rtol=0.02)


@pytest.mark.parametrize("count", [5, 8])
def test_curved_mirrors_show_one_of_many_lamps(count):
    exact, ours = exact_and_ours(Scene(Group("root", [ball(CHROME)]), CAMERA, lamps(count), DARK), 6)
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.06)


@pytest.mark.parametrize("roughness", [0.0, 0.05, 0.1])
def test_curved_metal_shows_a_lamp_in_its_shape(roughness):
    """A lamp that takes cones; as many points on it as light the rest would show as dots, or as rings."""
    metal = principled("metal", base_color=(0.5, 0.5, 0.5), roughness=roughness, metallic=1.0)
    scene, cache, size = Scene(Group("root", [ball(metal)]), CAMERA, lamps(2), DARK), Cache(), (96, 72)
    exact = np.mean([image(scene, cache, size, method="distributed", samples=256, seed=s) for s in (0, 1)], 0)
    ours = np.mean([image(scene, cache, size, seed=s) for s in range(4)], 0)
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.03)
    assert np.abs(ours - exact).mean() < 0.07 * exact.mean()


@pytest.mark.parametrize("width", [96, 240])
def test_curved_mirrors_show_the_sun_wherever_it_stands(width):
    """It is smaller than what a footprint reflects: its light must not hang on whether the footprint's middle meets it.

    What a sphere sends on of a sun's light is the same for all roughnesses, but for what grazes.
    """
    found = []
    for place in ((3, -3, 4), (1, -4, 2), (-2, -3, 5), (-3, -4, 1), (2, -5, 3)):
        sun = Light("SUN", look(place, (0, 0, 0)), power=3.0, angle=math.radians(0.5))
        sums = []
        for roughness, seeds in ((0.0, 3), (0.3, 1)):
            metal = principled("metal", base_color=(0.5, 0.5, 0.5), roughness=roughness, metallic=1.0)
            scene, cache = Scene(Group("root", [ball(metal)]), CAMERA, [sun], DARK), Cache()
            size = width, width * 3 // 4
            sums.append(np.mean([image(scene, cache, size, seed=s).mean() for s in range(seeds)]))
        found.append(sums[0] / sums[1])
    assert np.mean(found) == pytest.approx(1.0, abs=0.15)
    assert min(found) > 0.5


@pytest.mark.parametrize("count", [2, 5])
@pytest.mark.parametrize("material", [GLASS, CHROME], ids=["glass", "chrome"])
def test_metal_beside_what_is_sharp_keeps_its_highlights(count, material):
    scene = Scene(
        Group("root", [ball(material), floor(roughness=0.25, metallic=1.0)]), CAMERA, lamps(count), DARK
    )
    exact, ours = exact_and_ours(scene, 24)  # each is off by a sixth
    assert ours[FLOOR].mean() == pytest.approx(exact[FLOOR].mean(), rel=0.08)


@pytest.mark.parametrize(("roughness", "points"), [(0.15, 0), (0.25, 0), (0.15, 1)])
def test_highlights_of_metal_are_right_and_have_little_noise(roughness, points):
    """Narrow lobes, which light samples hardly ever meet, and the tails of wide ones, which cones leave out."""
    more = [Light("POINT", at(0, 3, 1), power=5.0, radius=0.0)] * points  # of which rays meet none
    metal = floor(roughness=roughness, metallic=1.0)
    scene = Scene(Group("root", [metal]), CAMERA, lamps(5) + more, DARK)
    exact, ours = exact_and_ours(scene, 8)
    shown = slice(2, 15)
    assert ours[:, shown].mean() == pytest.approx(exact[shown].mean(), rel=0.07)
    assert ours[:, shown].std(0).mean() < 0.12 * exact[shown].mean()


def test_reflections_at_the_back_of_a_pane_have_no_noise():
    """A lamp of which each face of the pane shows a few per cent: paths go on both ways."""
    corners = [(-3, 0, -1), (3, 0, -1), (3, 0, 3), (-3, 0, 3)]
    front = card("front", corners, GLASS)
    back = card("back", [(x, 0.2, z) for x, _, z in reversed(corners)], GLASS)
    lamp = Light("AREA", look((0, -6.2, 2), (0, 0, 1)), shape="SQUARE", size_x=1.5, power=300.0)
    others = [Light("AREA", look((x, 4, 3), (x, 8, 3)), power=1.0) for x in (-1.0, 0.0, 1.0)]
    scene = Scene(Group("root", [front, back]), Camera(look((0, -6, 1), (0, 0, 1))), [lamp, *others], DARK)
    exact, ours = exact_and_ours(scene, 12)
    bright = exact.mean(-1) > 0.5 * exact.mean(-1).max()
    assert bright.sum() > 20
    assert ours[:, bright].mean() == pytest.approx(exact[bright].mean(), rel=0.02)
    assert ours[:, bright].std(0).mean() < 0.1 * exact[bright].mean()


def test_reflections_at_the_back_of_a_ball_have_no_noise():
    """Its curvature widens what is seen through its front: what is behind is a little rough, and clear all the same."""
    lamp = Light("AREA", look((-3, -3.5, 4.5), (0, 0, 0)), shape="SQUARE", size_x=3.0, power=2000.0)
    exact, ours = exact_and_ours(Scene(Group("root", [ball(GLASS), floor()]), CAMERA, [lamp], DARK), 12)
    assert ours[BALL].mean() == pytest.approx(exact[BALL].mean(), rel=0.02)
    assert ours[BALL].std(0).mean() < 0.1 * exact[BALL].mean()


@pytest.mark.parametrize("ior", [1.33, 1.5, 2.4])
@pytest.mark.parametrize("roughness", [0.15, 0.3, 0.5])
def test_rough_panes_blur_the_sky_as_much_as_by_random_rays(ior, roughness):
    """One surface that refracts, before a sky of which a half shines: its edge is spread by the lobe."""
    pane = Material(
        "pane",
        Graph(
            {"g": Node("refraction", {"color": (1.0, 1.0, 1.0), "roughness": roughness, "ior": ior})},
            surface=Link("g", "bsdf"),
        ),
    )
    scene = Scene(Group("root", [card("pane", [(-9, 0, -9), (9, 0, -9), (9, 0, 9), (-9, 0, 9)], pane)]),
                  Camera(look((0, -3, 0), (0, 0, 0))), [], half_a_sky())  # fmt: skip
    exact = image(scene, method="distributed", samples=1024).mean((0, 2))
    for method, most in (("raytrace", 0.018), ("forward", 0.02)):
        found = np.mean([image(scene, method=method, seed=s) for s in range(4)], 0).mean((0, 2))
        assert np.abs(found - exact).mean() < most, method


def refracting(**values) -> Material:
    """A Refraction BSDF and no reflection: what is lost is seen."""
    node = Node("refraction", values | {"color": (1.0, 1.0, 1.0)}, {"distribution": "beckmann"})
    return Material("refracting", graph=Graph({"b": node}, surface=Link("b", "bsdf")))


@pytest.mark.parametrize("degrees", [0.0, 50.0, 75.0])
def test_rough_slabs_let_light_out_at_their_back(degrees):
    """Their lower sides reflect all that arrives about its mean direction; facets that lean let some of it pass."""
    side = Group("side", [quad(200.0, material=refracting(ior=1.45, roughness=1.0))])
    below = np.diag([1.0, -1.0, -1.0, 1.0])
    below[2, 3] = -0.2
    a = math.radians(degrees)
    camera = Camera(
        look((0, -5 * math.sin(a), 5 * math.cos(a)), (0, 1e-3, 0)), kind="ORTHOGRAPHIC", ortho_scale=0.2
    )
    root = Group("root", instances=[instance(side), instance(side, below)])
    scene, cache = Scene(root, camera, [], uniform_world((0.5, 0.5, 0.5))), Cache()
    exact = image(scene, cache, method="distributed", samples=64).mean()
    assert image(scene, cache, cones=4).mean() == pytest.approx(exact, rel=0.02) and 0.1 < exact < 0.4


def test_what_hardly_bends_light_is_as_bright_as_what_is_about_it():
    """A bubble of an index of nearly 1: its lobe is narrower than directions are told apart."""
    root = Group("root", [ball(refracting(ior=1.02, roughness=0.0))])
    ours = image(Scene(root, CAMERA, [], uniform_world((0.3, 0.3, 0.3))))
    assert ours == pytest.approx(0.3, abs=0.03) and ours.mean() == pytest.approx(0.3, abs=1e-3)


def test_glass_that_lets_shadow_rays_through_throws_a_light_shadow():
    """As Blender's users build it; a wide lamp's cone asks what shadow rays would meet."""
    nodes = {
        "p": Node("light_path"),
        "t": Node("transparent", {"color": (0.9, 0.9, 0.9)}),
        "g": Node(
            "principled", {"base_color": (1.0, 1.0, 1.0), "roughness": 0.0, "transmission_weight": 1.0}
        ),
        "mix": Node(
            "mix_shader",
            {"fac": Link("p", "is_shadow_ray"), "shader": Link("g", "bsdf"), "shader_b": Link("t", "bsdf")},
        ),
    }
    clear = Material("pane", Graph(nodes, surface=Link("mix", "shader")))
    pane = card("pane", [(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)], clear)
    white = principled("floor", base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0)
    lamp = Light("AREA", look((0, 0, 4), (0, 0, 0)), shape="SQUARE", size_x=1.0, power=200.0)
    camera = Camera(look((0, -5, 0.6), (0, 0, 0)))
    exact, ours = exact_and_ours(Scene(Group("root", [quad(8.0, 0.0, white), pane]), camera, [lamp], DARK), 2)
    below = np.s_[..., 15:18, 20:28, :]
    assert ours[below].mean() == pytest.approx(exact[below].mean(), rel=0.05)


def test_shadows_edges_are_found_on_surfels():
    """Balls so far away that they are samples alone, which a low sun lights from the side."""
    rows = [(x, y) for x in np.linspace(-40, 40, 30) for y in np.linspace(-40, 40, 30)]
    places = np.zeros((len(rows), 3, 4))
    places[:, :, :3], places[:, :2, 3] = np.eye(3), rows
    grey = principled("grey", base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0)
    root = Group("root", instances=[Instances((Group("ball", [ball(grey)]),), transforms=places)])
    sun = Light("SUN", look((-5, 0, 1), (0, 0, 0)), power=3.0, angle=0.0)
    scene = Scene(root, Camera(look((0, -110, 40), (0, 0, 0)), clip_end=2000.0), [sun], DARK)
    found = render(scene, RenderSettings(48, 36, method="raytrace")).stats["counters"]
    assert found["surfels"] > 1000 and found["triangles"] == 0 and found["edge_rays"] > 100


@pytest.mark.parametrize("shines", ["sun", "bulb"])
def test_rough_glass_before_a_light_is_no_firefly_in_a_mirror(shines):
    """Where it is seen by way of a metal floor; rays that chance sends to the light itself would be all its light."""
    leaf = principled("leaf", base_color=(1.0, 0.6, 0.6), roughness=0.5, transmission_weight=0.65, ior=1.45)
    parts = [
        floor(metallic=1.0, roughness=0.1),
        card("leaf", [(-3, 2, -1), (3, 2, -1), (3, 2, 3), (-3, 2, 3)], leaf),
    ]
    lights = []
    if shines == "sun":
        lights = [Light("SUN", look((0.5, 6, 3), (0, 0, 0)), power=5.0, angle=math.radians(0.53))]
    else:
        bulb = principled("bulb", emission_color=(1.0, 1.0, 1.0), emission_strength=300.0)
        parts.append(card("bulb", [(-0.1, 6, 2.4), (0.1, 6, 2.4), (0.1, 6, 2.6), (-0.1, 6, 2.6)], bulb))
    camera = Camera(look((0, -4, 1.5), (0, 0, -1)))
    exact, ours = exact_and_ours(Scene(Group("root", parts), camera, lights, DARK), 12)
    seen = slice(0, 16)
    assert ours[:, seen].mean() == pytest.approx(exact[seen].mean(), rel=0.02)
    assert ours[:, seen].max() < 1.4 * exact[seen].max()
    assert ours[:, seen].std(0).mean() < 0.1 * exact[seen].mean()
