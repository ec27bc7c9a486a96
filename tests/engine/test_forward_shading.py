"""Shading of forward mapping: what placements say, materials and lamps against closed forms and many rays, shadows."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pointmr_engine import (
    Camera,
    ForwardSettings,
    Group,
    Instances,
    Light,
    Mesh,
    RenderSettings,
    Scene,
    emission,
    instance,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.forward.drawing.transforms import allocate_transforms, compose, compose_root
from pointmr_engine.forward.shading.placement_values import allocate_placement_values, combine_placements
from pointmr_engine.forward.shading.world_light import WorldLight
from pointmr_engine.hierarchy.octree import build_octree
from pointmr_engine.raytracing.environment import Environment
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import HOLDOUT, VISIBLE
from pointmr_engine.scene.material import Material
from pointmr_engine.scene.texture import Image
from pointmr_engine.scene.world import World
from tests.engine.instanced import accelerate, cast, random_mesh, random_transforms, sphere
from tests.engine.small_scenes import at, from_above, quad, sky_with_a_sun

SIZE = RenderSettings(width=48, height=36, method="forward", samples=64, pixel_filter="box")
DULL = principled("dull", base_color=(0.8, 0.4, 0.2), specular_ior_level=0.0)
BLACK = uniform_world((0.0, 0.0, 0.0))


def image(scene: Scene, name: str = "combined", size=SIZE, method="forward", **forward) -> np.ndarray:
    settings = replace(size, method=method, forward=ForwardSettings(**forward))
    settings = replace(settings, passes=("combined", name) if name != "combined" else ("combined",))
    return render(scene, settings).passes[name]


def sun(x: float, y: float, z: float, **values) -> Light:
    """A sun that shines along (x, y, z)."""
    back = -np.array([x, y, z]) / math.sqrt(x * x + y * y + z * z)
    side = np.cross([0.0, 1.0, 0.0], back)
    side /= np.linalg.norm(side)
    m = np.eye(4)
    m[:3, :3] = np.stack([side, np.cross(back, side), back], 1)
    return Light("SUN", m, **{"power": 3.0, "angle": 0.0, **values})


def ball(material, rings=40, radius=1.0) -> Mesh:
    positions, triangles = sphere(rings, 2 * rings, radius)
    return Mesh("ball", positions, triangles, normals=positions / radius, materials=(material,))


def box(material, low, high) -> Mesh:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    corners = np.asarray(low, np.float32) + corners * (
        np.asarray(high, np.float32) - np.asarray(low, np.float32)
    )
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    return Mesh("box", corners, np.array(triangles, np.int32), materials=(material,))


def difference(scene: Scene, size=SIZE, **forward) -> float:
    """Mean error relative to the mean of many rays' image."""
    found, true = image(scene, size=size, **forward), image(scene, size=size, method="distributed")
    return float(np.abs(found - true)[..., :3].mean() / true[..., :3].mean())


# What placements say


def test_placements_say_what_hits_say():
    rng = np.random.default_rng(5)

    def values(n):
        bits = rng.choice([VISIBLE, VISIBLE | HOLDOUT, VISIBLE & ~2], n).astype(np.uint8)
        return {
            "visibility": bits if rng.random() < 0.6 else bits[:1],
            "object_index": rng.integers(-1, 5, n).astype(np.int32) if rng.random() < 0.6 else None,
            "seed": rng.integers(0, 3, n).astype(np.uint32) if rng.random() < 0.7 else None,
            "color": rng.random((n, 4)).astype(np.float32) if rng.random() < 0.6 else None,
            "attributes": {"a": rng.random((n, 3)).astype(np.float32)} if rng.random() < 0.4 else {},
        }

    groups = [Group(f"leaf {k}", [random_mesh(rng, 12)]) for k in range(3)]
    for level in range(3):
        below = tuple(groups[-3:])
        batches = [
            Instances(below, random_transforms(rng, n), rng.integers(0, 3, n).astype(np.int32), **values(n))
            for n in (4, 0, 3)
        ]
        groups += [Group(f"{level} {k}", [random_mesh(rng, 6)], batches[k % 2 :]) for k in range(3)]
    root = Group(
        "root", [random_mesh(rng, 6)], [Instances((groups[-1],), random_transforms(rng, 2), **values(2))]
    )
    geometry, acceleration = accelerate(root)
    octree = build_octree(geometry)
    transforms = allocate_transforms(1 << 15)
    compose_root(transforms, np.eye(4)[:3], octree.arrays, np.int64(len(geometry.groups) - 1), np.int64(0))
    used = row = 0
    while row <= used:
        for b in geometry.group_batches[int(transforms.group[row])]:
            for i in range(len(geometry.batches[b])):
                used += 1
                compose(
                    transforms, np.int64(row), octree.arrays, geometry.instances, np.int64(b), np.int64(i),
                    np.int64(used),
                )  # fmt: skip
        row += 1
    found = allocate_placement_values(used + 1)
    combine_placements(transforms, geometry.instances, np.int64(used + 1), found)
    row_of = {int(path): k for k, path in enumerate(found.path)}
    assert len(row_of) == used + 1
    direction = rng.normal(size=(4000, 3))
    _, hits = cast(acceleration, 4.0 * rng.normal(size=(4000, 3)), direction)
    seen = np.flatnonzero(hits.triangle >= 0)
    rows = np.array([row_of[int(p)] for p in hits.path[seen]])
    assert len(np.unique(rows)) > 50
    for name in ("seed", "object_index", "instance", "color"):
        np.testing.assert_array_equal(getattr(found, name)[rows], getattr(hits, name)[seen], name)
    np.testing.assert_array_equal((found.flags[rows] & HOLDOUT) != 0, hits.holdout[seen])


def test_instances_colours_random_values_and_indices():
    """An image of Object Info's outputs, and the index passes, are what rays find."""
    nodes = {
        "info": Node("object_info"),
        "shine": Node("emission", {"color": Link("info", "color"), "strength": Link("info", "random")}),
    }
    shine = Material("info", Graph(nodes, surface=Link("shine", "emission")), pass_index=7)
    cell = Group("cell", [quad(0.8, material=shine)])
    n = 12
    transforms = np.tile(np.eye(4)[:3], (n, 1, 1))
    transforms[:, 0, 3], transforms[:, 1, 3] = np.arange(n) % 4 - 1.5, np.arange(n) // 4 - 1.0
    rng = np.random.default_rng(1)
    batch = Instances(
        (cell,), transforms, color=rng.random((n, 4)).astype(np.float32), seed=rng.integers(1, 2**32, n, np.uint32),
        object_index=np.arange(n, dtype=np.int32),
    )  # fmt: skip
    row = Group("row", [], [batch])
    scene = Scene(Group("root", [], [instance(row, seed=9)]), from_above(5.0), [], BLACK)
    for name in ("combined", "object_index", "material_index"):
        found, true = image(scene, name), image(scene, name, method="conventional")
        inside = true[..., 0] > 0
        assert inside.mean() > 0.3
        # at the edges pixels are filtered
        same = np.isclose(found, true, rtol=1e-4, atol=1e-4).all(-1)
        assert same.mean() > (0.75 if name == "combined" else 0.97)
        if name != "combined":
            assert set(np.unique(found)) == set(np.unique(true))


# Materials and lamps


@pytest.mark.parametrize("shading", ["simple", "full"])
def test_lambert_plane_under_sun_and_point(shading):
    plane = Group("root", [quad(20.0, material=DULL)])
    lamps = sun(1.0, 0.5, -1.0), Light("POINT", at(0.0, 0.0, 3.0), power=100.0, radius=0.0)
    irradiance = 3.0 / 1.5, 100.0 / (4.0 * math.pi * 9.0)
    for lamp, e in zip(lamps, irradiance, strict=True):
        found = image(Scene(plane, from_above(), [lamp], BLACK), shading=shading)[18, 24, :3]
        np.testing.assert_allclose(found, np.array((0.8, 0.4, 0.2)) * e / math.pi, rtol=2e-3)


def test_emission_and_world_are_exact():
    lamp = Group("root", [quad(20.0, material=emission(color=(1.0, 0.5, 0.25), strength=2.0))])
    np.testing.assert_allclose(
        image(Scene(lamp, from_above(), [], BLACK))[..., :3].mean((0, 1)), (2, 1, 0.5), rtol=1e-5
    )
    plane = Group("root", [quad(20.0, material=DULL)])
    found = image(Scene(plane, from_above(), [], uniform_world((0.5, 1.0, 2.0))))[18, 24, :3]
    np.testing.assert_allclose(found, (0.4, 0.4, 0.4), rtol=1e-4)


@pytest.mark.parametrize(
    "lamp",
    [
        Light("POINT", at(1.0, -1.0, 4.0), power=300.0, radius=0.3),
        Light("SPOT", at(0.5, 0.0, 4.0), power=300.0, radius=0.1, spot_angle=1.0, spot_blend=0.4),
        Light("AREA", at(0.0, 0.5, 3.0), power=200.0, size_x=2.0),
        Light("AREA", at(0.0, 0.5, 3.0), power=200.0, size_x=1.0, spread=1.5, shape="DISK"),
        sun(1.0, 0.5, -1.0, angle=0.3),
    ],
    ids=["point", "spot", "area", "spread", "sun"],
)
def test_lamps_with_extent_are_close_to_many_rays(lamp):
    glossy = principled("glossy", base_color=(0.6, 0.3, 0.2), roughness=0.4)
    root = Group("root", [quad(20.0, material=DULL), ball(glossy)])
    lamp = replace(lamp, cast_shadow=False)
    assert difference(Scene(root, from_above(6.0), [lamp], BLACK), samples_per_pixel=4.0) < 0.04


@pytest.mark.parametrize("roughness", [0.2, 0.5])
@pytest.mark.parametrize("share", [0.05, 0.3])
@pytest.mark.parametrize("method", ["forward", "raytrace"])
def test_lamps_that_bring_little_bring_what_they_do_alone(method, share, roughness):
    """They are fewer points beside strong ones: of a wall, a part of which each point of a ball sees."""
    wall = Light(
        "AREA", at(1.5, 0, 0) @ sun(-1, 0, 0).world_from_light, power=80.0 * share, size_x=6.0, size_y=6.0
    )
    plastic = principled("plastic", base_color=(0.5, 0.5, 0.5), roughness=roughness)

    def shown(*lights: Light) -> np.ndarray:
        scene = Scene(Group("root", [ball(plastic)]), from_above(4.0), list(lights), BLACK)
        return image(scene, method=method)[..., :3].astype(float)

    strong, weak, both = shown(sun(1, 1, -3)), shown(wall), shown(sun(1, 1, -3), wall)
    assert 0.4 * share < weak.mean() / strong.mean() < 2.5 * share
    difference = np.abs(both - strong - weak)
    assert difference.max() < 0.02 * strong.max() and difference.mean() < 0.002 * strong.mean()


@pytest.mark.parametrize("roughness", [0.1, 0.3])
@pytest.mark.parametrize(("method", "least", "mean"), [("forward", 0.99, 0.9995), ("raytrace", 0.8, 0.998)])
def test_far_metal_is_as_bright_as_what_it_mirrors(method, least, mean, roughness):
    """White balls of two pixels under a white sky are not seen: lobes as wide as a ball's normals lost light, as facets
    of such a roughness do. `forward` had 0.62 of it in a pixel, and `raytrace` 0.9965 in the mean.
    """
    white = principled("white", base_color=(1.0, 1.0, 1.0), metallic=1.0, roughness=roughness)
    places = np.stack(np.meshgrid(*[0.37 * np.arange(-3, 4)] * 2), -1).reshape(-1, 2)
    balls = Instances(
        [Group("ball", [ball(white, 16, 0.05)])], np.array([at(x, y, 0)[:3] for x, y in places])
    )
    scene = Scene(Group("root", [], [balls]), from_above(4.0), [], uniform_world((1.0, 1.0, 1.0)))
    shown = image(scene, method=method)[..., 0].astype(float)
    assert shown.min() > least and shown.mean() == pytest.approx(1.0, abs=1.0 - mean)


@pytest.mark.parametrize("shape", ["flat", "round"])
def test_surfaces_that_shine_light_others(shape):
    """Beside what many rays find, whose shadows and distances agree."""
    glow = emission(color=(1.0, 0.8, 0.5), strength=10.0)
    if shape == "flat":
        shining = quad(1.0, -0.2, glow)
        shining.positions = shining.positions[:, [2, 1, 0]] + np.float32([-2.0, 0.0, 1.5])
    else:
        shining = ball(glow, 12, 0.4)
        shining.positions = shining.positions + np.float32([-2.0, 0.0, 1.5])
    root = Group("root", [quad(20.0, material=DULL), box(DULL, (0.3, -0.5, 0.0), (1.0, 0.5, 0.8)), shining])
    size = replace(SIZE, width=80, height=60, samples=128)
    assert difference(Scene(root, from_above(8.0), [], BLACK), size, samples_per_pixel=4.0) < 0.08


def test_lobes_see_the_world():
    """Diffuse, rough and smooth lobes of a ball under a sky of two halves."""
    nodes = {
        "where": Node("texture_coordinate"),
        "split": Node("separate_xyz", {"vector": Link("where", "generated")}),
        "up": Node("math", {"value": Link("split", "z"), "value_b": 0.0}, {"operation": "GREATER_THAN"}),
        "sky": Node("background", {"color": (1.0, 0.8, 0.6), "strength": Link("up", "value")}),
    }
    world = World(Graph(nodes, surface=Link("sky", "background")))
    for roughness, metallic, limit in ((0.5, 0.0, 0.04), (0.6, 1.0, 0.08), (0.15, 1.0, 0.05)):
        material = principled(base_color=(0.8, 0.8, 0.8), roughness=roughness, metallic=metallic)
        m = np.eye(4)
        m[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # looks along y
        m[1, 3] = -5.0
        scene = Scene(Group("root", [ball(material)]), Camera(m), [], world)
        assert difference(scene, samples_per_pixel=4.0) < limit


@pytest.mark.parametrize("axis", ["x", "z"])
@pytest.mark.parametrize("part", [1e-4, 1e-3, 0.05])
def test_suns_in_the_world_keep_their_light_in_all_maps(axis, part):
    """Discs down to six texels of the sharpest map, at a pole of it or not."""
    environment = Environment(sky_with_a_sun(1.0 - 2.0 * part, 1.0 / part, 1.0, axis))
    environment.sun = None  # else the smallest is a lamp
    light = WorldLight(environment)
    assert light.mean == pytest.approx(1.6, rel=0.04)
    for maps in (light.glossy, light.glossy_rays):
        for m in range(len(maps.alpha)):
            width = int(maps.width[m])
            texels = maps.texels[maps.first[m] :][: width * width // 2].reshape(width // 2, width, 3)
            heights = np.diff(-np.cos(np.linspace(0.0, np.pi, width // 2 + 1)))
            assert (texels.mean((1, 2)) * heights).sum() / 2.0 == pytest.approx(1.6, rel=0.07)


def test_maps_of_a_uniform_world_are_uniform():
    light = WorldLight(Environment(uniform_world((0.2, 0.4, 0.6))))
    np.testing.assert_allclose(light.mean, (0.2, 0.4, 0.6), rtol=1e-6)
    for maps in (light.diffuse, light.glossy, light.transmission):
        np.testing.assert_allclose(
            maps.texels, np.broadcast_to((0.2, 0.4, 0.6), maps.texels.shape), rtol=1e-6
        )


def test_textured_plane_is_filtered():
    """A board of fields smaller than a pixel: the mean of many rays, from one look at the texture."""
    n = 256
    board = np.ones((n, n, 4), np.float32)
    board[..., :3] = ((np.add.outer(np.arange(n) // 2, np.arange(n) // 2) % 2) * 0.8)[..., None]
    board[: n // 2, :, 0] *= 0.25
    nodes = {
        "image": Node(
            "image_texture", {}, {"image": Image("board", board, "Linear"), "interpolation": "Linear"}
        ),
        "bsdf": Node("principled", {"base_color": Link("image", "color"), "specular_ior_level": 0.0}),
    }
    plane = quad(4.0, material=Material("board", Graph(nodes, surface=Link("bsdf", "bsdf"))))
    plane.uvs["UVMap"] = ((plane.positions[plane.triangles][..., :2] + 2.0) / 4.0).astype(np.float32)
    scene = Scene(Group("root", [plane]), from_above(9.0), [sun(0.3, 0.2, -1.0)], BLACK)
    assert difference(scene) < 0.06


def test_cut_outs_show_what_lies_behind_in_the_sky():
    """Triangles that let light through are as transparent as many rays find them."""
    nodes = {
        "clear": Node("transparent", {"color": (1.0, 1.0, 1.0)}),
        "shine": Node("emission", {"color": (1.0, 1.0, 1.0), "strength": 1.0}),
        "mix": Node(
            "mix_shader",
            {"fac": 0.25, "shader": Link("clear", "bsdf"), "shader_b": Link("shine", "emission")},
        ),
    }
    veil = Material("veil", Graph(nodes, surface=Link("mix", "shader")))
    scene = Scene(
        Group("root", [quad(2.0, material=veil)]), from_above(5.0), [], uniform_world((0.0, 0.5, 0.0))
    )
    found, true = image(scene), image(scene, method="distributed")
    inside = np.s_[14:22, 20:28]
    np.testing.assert_allclose(found[inside].mean((0, 1)), true[inside].mean((0, 1)), atol=0.03)
    assert found[inside][..., 0].mean() == pytest.approx(0.25, abs=0.03)


def test_leaves_on_cards_hide_what_lies_behind_them_and_throw_their_shadows():
    """A card with a round leaf, a second one behind it and a floor below: the same as many rays."""
    n = 64
    x, y = np.meshgrid(np.arange(n) + 0.5 - n / 2, np.arange(n) + 0.5 - n / 2)
    picture = np.zeros((n, n, 4), np.float32)
    picture[..., 3] = np.hypot(x, y) < 0.4 * n
    picture[..., :3] = (0.1, 0.7, 0.2)
    nodes = {
        "image": Node("image_texture", {}, {"image": Image("leaf", picture, "Linear"), "interpolation": "Linear"}),
        "bsdf": Node("principled", {
            "base_color": Link("image", "color"), "alpha": Link("image", "alpha"), "specular_ior_level": 0.0,
        }),
    }  # fmt: skip
    leaf = Material("leaf", Graph(nodes, surface=Link("bsdf", "bsdf")))
    cards = [quad(2.0, z, leaf) for z in (1.0, 0.7)]
    for card, shift in zip(cards, (0.0, 0.6), strict=True):
        card.uvs["UVMap"] = ((card.positions[card.triangles][..., :2] + 1.0) / 2.0).astype(np.float32)
        card.positions[:, 0] += shift
    root = Group("root", [quad(20.0, material=DULL), *cards])
    scene = Scene(root, from_above(6.0), [sun(1.0, 0.5, -1.0)], uniform_world((0.0, 0.2, 0.5)))
    size = replace(SIZE, width=96, height=72)
    assert image(scene, size=size)[36, 48, 1] > 1.5 * image(scene, size=size)[36, 48, 0]
    assert difference(scene, size) < 0.12  # the sky is not shadowed here


# Shadows


@pytest.mark.parametrize("shading", ["simple", "full"])
@pytest.mark.parametrize("kind", ["sun", "point"])
def test_shadow_of_a_box_lies_where_it_must(kind, shading):
    """The lamp is beside the box; its shadow has the closed form's area."""
    root = Group("root", [quad(40.0, material=DULL), box(DULL, (-0.5, -0.5, 0.0), (0.5, 0.5, 1.0))])
    camera = from_above(20.0, kind="ORTHOGRAPHIC", ortho_scale=6.0)
    if kind == "sun":
        lamp, length = sun(1.0, 0.0, -1.0), 1.0
        area = length  # a strip as wide as the box
    else:
        lamp = Light("POINT", at(-4.0, 0.0, 3.0), power=2000.0, radius=0.0)
        # the top goes to a square of side 1.5 at x = 2, and the shadow widens from the box's far corners to it
        area = 1.75 * (1.0 + 1.5) / 2.0 + 1.5 * 1.5 - 1.0
    size = replace(SIZE, width=160, height=120)
    lit = image(Scene(root, camera, [replace(lamp, cast_shadow=False)], BLACK), size=size, shading=shading)
    dark = image(Scene(root, camera, [lamp], BLACK), size=size, shading=shading)
    share = dark[..., 0] / lit[..., 0]
    side = 6.0 / 160
    x = (np.arange(160) + 0.5) * side - 3.0
    y = (np.arange(120) + 0.5) * side - 2.25
    xx, yy = np.meshgrid(x, y)
    on_box = (np.abs(xx) < 0.5) & (np.abs(yy) < 0.5)
    assert share[on_box].min() > 0.99  # no acne on its top
    assert (1.0 - share[~on_box]).sum() * side**2 == pytest.approx(area, rel=0.04)
    assert share[xx < -0.55].min() > 0.99  # the side of the lamp
    core = (xx > 0.55) & (xx < 0.5 + 0.9 * length) & (np.abs(yy) < 0.45) if kind == "sun" else None
    if core is not None:
        assert share[core].max() < 0.01  # no light leaks between box and shadow


def test_lamps_without_shadow_and_shadows_switched_off():
    root = Group("root", [quad(40.0, material=DULL), box(DULL, (-0.5, -0.5, 1.0), (0.5, 0.5, 2.0))])
    camera = from_above(20.0, kind="ORTHOGRAPHIC", ortho_scale=6.0)
    lamp = sun(1.0, 0.0, -1.0)
    free = image(Scene(root, camera, [replace(lamp, cast_shadow=False)], BLACK))
    np.testing.assert_array_equal(image(Scene(root, camera, [lamp], BLACK), shadows=False), free)
    assert (image(Scene(root, camera, [lamp], BLACK)) < 0.5 * free)[..., 0].mean() > 0.02


def test_round_surfaces_have_no_acne():
    """A ball's own shadow begins where its light ends: with and without shadow it looks the same."""
    root = Group("root", [ball(DULL, 100)])
    for lamp in (sun(1.0, 0.3, -0.6), Light("POINT", at(3.0, 1.0, 2.0), power=300.0, radius=0.0)):
        size = replace(SIZE, width=96, height=72)
        free = image(Scene(root, from_above(4.0), [replace(lamp, cast_shadow=False)], BLACK), size=size)
        found = image(Scene(root, from_above(4.0), [lamp], BLACK), size=size)
        assert np.abs(found - free)[..., :3].mean() < 0.01 * free[..., :3].mean()


def test_penumbras_are_close_to_many_rays():
    glossy = principled("glossy", base_color=(0.6, 0.3, 0.2), roughness=0.5)
    root = Group("root", [quad(20.0, material=DULL), ball(glossy)])
    for lamp in (sun(1.0, 0.5, -1.0, angle=0.2), Light("AREA", at(2.0, 0.5, 4.0), power=200.0, size_x=0.5)):
        size = replace(SIZE, width=96, height=72)
        assert difference(Scene(root, from_above(7.0), [lamp], BLACK), size, samples_per_pixel=4.0) < 0.05


def test_shading_is_the_same_at_any_thread_count():
    root = Group("root", [quad(20.0, material=DULL), ball(DULL)])
    scene = Scene(root, from_above(6.0), [sun(1.0, 0.5, -1.0, angle=0.1)], uniform_world((0.1, 0.1, 0.2)))
    size = replace(SIZE, width=200, height=150)
    one, many = image(scene, size=replace(size, threads=1)), image(scene, size=replace(size, threads=3))
    np.testing.assert_array_equal(one, many)
