"""Triangles with holes: who shares samples of opacity, and what passes them in colour."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine import (
    Group,
    Light,
    Material,
    Mesh,
    RenderSettings,
    Scene,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.forward.drawing.cut_out_cover import nearest_as_opaque
from pointmr_engine.forward.drawing.cut_outs import FINEST, SAMPLES, build_cut_outs, lattices
from pointmr_engine.forward.drawing.part_opacity import PartOpacity
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.render import Cancelled
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import CAMERA, VISIBLE
from pointmr_engine.scene.mesh import Attribute
from pointmr_engine.scene.settings import RaytraceSettings
from pointmr_engine.scene.texture import Image
from pointmr_engine.shading import program
from pointmr_engine.shading.program import compile_graph
from tests.engine.small_scenes import at, from_above, quad

BLACK = uniform_world((0.0, 0.0, 0.0))


def leaf(coloured: bool = False) -> Material:
    """A leaf with two thin lobes on a card; the attribute "tint" is its colour, and that of what may pass it."""
    n = 128
    x, y = np.meshgrid((np.arange(n) + 0.5) / n - 0.5, (np.arange(n) + 0.5) / n - 0.5)
    picture = np.ones((n, n, 4), np.float32)
    picture[..., 3] = (np.abs(x - y) < 0.06) | (np.abs(x + y) < 0.06)
    nodes = {
        "image": Node(
            "image_texture", {"vector": Link("place", "vector")}, {"image": Image("leaf", picture, "Linear")}
        ),
        "place": Node("attribute", {}, {"name": "place"}),
        "tint": Node("attribute", {}, {"name": "tint"}),
        "bsdf": Node("principled", {"base_color": Link("tint", "color"), "specular_ior_level": 0.0}),
        "clear": Node("transparent", {"color": Link("tint", "color") if coloured else (0.0, 0.0, 0.0)}),
        "both": Node("add_shader", {"shader": Link("bsdf", "bsdf"), "shader_b": Link("clear", "bsdf")}),
        "hole": Node("transparent"),
        "card": Node("mix_shader", {
            "fac": Link("image", "alpha"), "shader": Link("hole", "bsdf"), "shader_b": Link("both", "shader"),
        }),
    }  # fmt: skip
    return Material("leaf", Graph(nodes, surface=Link("card", "shader")))


def leaves(count: int, material: Material, sizes=(1.0,)) -> Mesh:
    """Cards side by side, of the same place in the image but for `sizes` in turn, and of other tints each."""
    cards = [quad(1.0) for _ in range(count)]
    rng = np.random.default_rng(1)
    place, tint = [], []
    for k, card in enumerate(cards):
        place.append((card.positions[card.triangles][..., :2] * sizes[k % len(sizes)] + 0.5).reshape(-1, 2))
        tint.append(np.tile(rng.uniform(0.2, 0.6, 3), (6, 1)))
        card.positions[:, 0] += k - 0.5 * (count - 1)
    values = {
        name: Attribute(np.concatenate(a).astype(np.float32))
        for name, a in (("place", place), ("tint", tint))
    }
    return Mesh(
        "leaves", np.concatenate([c.positions for c in cards]),
        np.concatenate([c.triangles + 4 * k for k, c in enumerate(cards)]).astype(np.int32), materials=(material,),
        attributes=values,
    )  # fmt: skip


def cut_outs(mesh: Mesh, threads: int = 0, progress=None):
    scene = Scene(Group("root", [mesh]), from_above(9.0), [], BLACK)
    geometry = compile_geometry(scene)
    programs = [compile_graph(m.graph) for m in geometry.materials]
    return build_cut_outs(PartOpacity(geometry, programs, threads), progress)[:2]


def test_cut_outs_do_not_depend_on_threads_and_tell_how_far_they_are():
    mesh, told = leaves(40, leaf(), np.linspace(0.5, 1.0, 40)), []
    alone, together = cut_outs(mesh, 1, told.append), cut_outs(mesh, 3)
    assert len(alone[0].side) == 80 and alone[0].side[0] == FINEST
    for one, other in zip(alone, together, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)
    assert len(told) > 3 and told == sorted(told) and 0.0 <= told[0] and told[-1] < 1.0


def test_cut_outs_can_be_cancelled():
    def stop(fraction: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        cut_outs(leaves(4, leaf()), progress=stop)


def test_leaves_of_other_colours_share_their_shape():
    mean, _ = cut_outs(leaves(60, leaf()))
    assert len(mean.mask) == 120
    assert len(np.unique(mean.mask)) == len(mean.side) == 2


def test_leaves_of_other_shapes_do_not():
    mean, _ = cut_outs(leaves(60, leaf(), sizes=(1.0, 0.5)))
    assert 4 <= len(mean.side) <= 12  # a look at a border may disagree
    large, small = (lattices(mean)[mean.mask[2 * k : 2 * k + 2]].mean() for k in (0, 1))
    assert small > 1.3 * large  # the card shows the middle of the image, where the lobes meet


def test_what_is_opaque_all_over_shares_one_row():
    """Stems that show other places of their leaves' picture each: all of its middle, where there is no hole."""
    sizes = np.linspace(0.01, 0.05, 60)
    sizes[7] = 1.0  # a leaf
    for found in cut_outs(leaves(60, leaf(), sizes=sizes)):
        assert len(found.side) == 3
        rows = np.delete(found.mask.reshape(60, 2), 7, 0)
        assert (rows == rows[0, 0]).all() and (lattices(found)[rows[0, 0]] == 255).all()
        own = lattices(found)[found.mask[14:16]]
        assert (own == 255).any((1, 2)).all() and (own == 0).any((1, 2)).all()
        assert own.shape[1] == FINEST  # few rows, so each has many samples


def bumpy_sheet(side: int, node: str, output: str) -> Mesh:
    """A smooth sheet of 2 side^2 triangles, as opaque as a node says."""
    steps = np.linspace(-1.0, 1.0, side + 1)
    x, y = (a.ravel() for a in np.meshgrid(steps, steps))
    z = 0.1 * np.sin(3.0 * x) * np.cos(2.0 * y)
    normals = np.stack(
        [-0.3 * np.cos(3.0 * x) * np.cos(2.0 * y), 0.2 * np.sin(3.0 * x) * np.sin(2.0 * y), 1 + 0 * x], 1
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    low = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    triangles = np.stack([low, low + 1, low + side + 2, low, low + side + 2, low + side + 1], 1).reshape(
        -1, 3
    )
    nodes = {"alpha": Node(node), "bsdf": Node("principled", {"alpha": Link("alpha", output)})}
    material = Material("sheet", Graph(nodes, surface=Link("bsdf", "bsdf")))
    positions = np.stack([x, y, z], 1).astype(np.float32)
    normals = normals.astype(np.float32)
    return Mesh("sheet", positions, triangles.astype(np.int32), normals, materials=(material,))


@pytest.mark.parametrize(
    ("node", "output", "looks"),
    [
        ("geometry", "backfacing", 8),  # from two sides, at four points
        ("layer_weight", "facing", 24),  # from six sides
        ("noise_texture", "fac", 0),
    ],
)
def test_many_triangles_are_looked_at_seldom(node, output, looks, monkeypatch):
    """Minutes went by where a mix by Fresnel was looked at 1800 times in each triangle.

    looks: in each triangle, besides as many in all of them as there is room for.
    """
    seen = [0]
    transparency = program.Program.transparency

    def counted(self, points):
        seen[0] += points.count
        return transparency(self, points)

    monkeypatch.setattr(program.Program, "transparency", counted)
    mesh = bumpy_sheet(230, node, output)
    mean, densest = cut_outs(mesh)
    assert (mean.mask >= 0).all()
    assert seen[0] <= looks * len(mesh.triangles) + 1.2 * SAMPLES, seen
    if node == "geometry":
        assert len(mean.side) == 1 and not mean.cells.any() and (densest.cells == 255).all()


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(2, 40), st.floats(0.0, 1.0), st.integers(1, 255))
def test_the_nearest_opaque_cell_is_found(seed, side, share, least):
    rng = np.random.default_rng(seed)
    opacity = np.where(rng.random((1, side, side)) < share, rng.integers(0, 256, (1, side, side)), 0)
    opacity = opacity.astype(np.uint8)
    u, v = np.sort(rng.random(2))
    u, v = u * side, (1.0 - v) * side
    q, p = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    inside = p + q < side
    away = (p + 1 / 3 - u) ** 2 + (q + 1 / 3 - v) ** 2
    enough = inside & (opacity[0] >= least)
    found = nearest_as_opaque.py_func(opacity.ravel(), 0, side, u, v, least, side)
    if not enough.any():
        assert found == (-1, -1)
        return
    assert enough[found[1], found[0]]
    assert away[found[1], found[0]] == pytest.approx(away[enough].min())


def test_what_passes_in_colour_is_a_leaf_s_own():
    """Tints decide how opaque a channel is: leaves share with those alike, and the mean stays what it is."""
    material = leaf(coloured=True)
    mesh = leaves(200, material)
    mean, densest = cut_outs(mesh)
    assert 2 < len(mean.side) < 100
    tint = mesh.attributes["tint"].values.reshape(200, 6, 3)[:, 0]
    for found, true in ((mean, tint.mean(1)), (densest, tint.min(1))):
        inside = np.array([lattices(found)[found.mask[2 * k]].max() / 255.0 for k in range(200)])
        # all of some leaves' few looks miss them
        assert np.quantile(np.abs(inside - (1.0 - true)), 0.9) < 0.17


def stained() -> Scene:
    """Panes of coloured glass without refraction before a bright world."""
    nodes = {"clear": Node("transparent", {"color": (0.9, 0.3, 0.1)})}
    pane = Material("pane", Graph(nodes, surface=Link("clear", "bsdf")))
    root = Group("root", [quad(1.0, 0.0, pane), quad(0.5, 0.3, pane)])
    return Scene(root, from_above(3.0), [], uniform_world((1.0, 1.0, 1.0)))


@pytest.mark.parametrize("secondary", ["cones", "rays"])
def test_first_surfaces_colour_what_is_seen_through_them(secondary):
    chosen = RenderSettings(32, 32, method="raytrace", raytrace=RaytraceSettings(secondary=secondary))
    found = render(stained(), chosen).passes["combined"][..., :3]
    once, twice = np.array((0.9, 0.3, 0.1)), np.array((0.81, 0.09, 0.01))
    np.testing.assert_allclose(found[13:19, 13:19].mean((0, 1)), twice, atol=0.02)
    np.testing.assert_allclose(found[13:19, 9:11].mean((0, 1)), once, atol=0.02)


@pytest.mark.parametrize("secondary", ["cones", "rays"])
def test_wide_lobes_see_through_holes_and_not_through_their_mean(secondary):
    """A third of a sheet over a floor is open, where its picture is over a half: its mean, a third, never is.

    Its stripes are far finer than what is kept of where two such large triangles are opaque.
    """
    picture = np.ones((512, 512, 4), np.float32)
    picture[..., :3] = (np.arange(512) // 4 % 3 == 0)[None, :, None]
    nodes = {
        "place": Node("texture_coordinate"),
        "image": Node("image_texture", {"vector": Link("place", "uv")}, {"image": Image("holes", picture, "Linear")}),
        "open": Node("math", {"value": Link("image", "color"), "value_b": 0.5}, {"operation": "GREATER_THAN"}),
        "clear": Node("transparent", {"color": Link("open", "value")}),
    }  # fmt: skip
    sheet = quad(200.0, 1.0, Material("sheet", Graph(nodes, surface=Link("clear", "bsdf"))))
    sheet.uvs["UVMap"] = sheet.positions[sheet.triangles][..., :2] / np.float32(30.0)
    floor = quad(4.0, 0.0, principled("floor", base_color=(0.5, 0.5, 0.5), roughness=0.7))
    scene = Scene(Group("root", [sheet, floor]), from_above(0.9), [], uniform_world((1.0, 1.0, 1.0)))

    def light(**chosen) -> float:
        images = [
            render(scene, RenderSettings(24, 24, seed=k, **chosen)).passes["combined"] for k in range(4)
        ]
        return float(np.mean(images, axis=0)[..., :3].mean())

    exact = light(method="distributed", samples=64)
    assert exact > 0.1
    found = light(method="raytrace", raytrace=RaytraceSettings(secondary=secondary))
    assert found == pytest.approx(exact, rel=0.05)


@pytest.mark.parametrize("visibility", ["masks", "alpha"])
@pytest.mark.parametrize("secondary", ["cones", "rays"])
def test_a_transparent_film_has_one_opacity_of_all_channels_and_colours_what_lies_behind(
    secondary, visibility
):
    scene = stained()
    pane = scene.root.meshes[0].materials[0]
    glow = Material(
        "glow",
        Graph({"light": Node("emission", {"color": (1.0, 1.0, 1.0)})}, surface=Link("light", "emission")),
    )
    scene.root.meshes[:] = [quad(1.0, 0.0, pane), quad(0.5, -0.3, glow)]
    raytrace = RaytraceSettings(secondary=secondary, visibility=visibility)
    chosen = RenderSettings(32, 32, method="raytrace", film_transparent=True, raytrace=raytrace)
    found = render(scene, chosen).passes["combined"]
    np.testing.assert_allclose(found[14:18, 14:18].mean((0, 1)), (0.9, 0.3, 0.1, 1.0), atol=0.02)
    np.testing.assert_allclose(found[14:18, 9:11].mean((0, 1)), (0.0, 0.0, 0.0, 1.0 - 1.3 / 3), atol=0.02)


def striped(colour: Link | tuple) -> Material:
    """Glowing stripes on a card, with holes between them whose colour is a bright green that nobody should see."""
    n = 512
    picture = np.zeros((n, n, 4), np.float32)
    stripes = (np.arange(n) // 3 % 3 == 0)[None, :, None]
    picture[...] = np.where(stripes, (0.8, 0.2, 0.1, 1.0), (0.0, 9.0, 0.0, 0.0))
    nodes = {
        "place": Node("attribute", {}, {"name": "place"}),
        "image": Node(
            "image_texture", {"vector": Link("place", "vector")}, {"image": Image("stripes", picture, "Linear")}
        ),
        "glow": Node("emission", {"color": colour, "strength": 1.0}),
        "clear": Node("transparent", {}),
        "mix": Node("mix_shader", {
            "fac": Link("image", "alpha"), "shader": Link("clear", "bsdf"), "shader_b": Link("glow", "emission"),
        }),
    }  # fmt: skip
    return Material("striped", Graph(nodes, surface=Link("mix", "shader")), emission_sampling="none")


def seen(material: Material, method: str, samples: int, lamps=(), **more) -> np.ndarray:
    scene = Scene(Group("root", [leaves(8, material)]), from_above(9.0), list(lamps), BLACK)
    chosen = RenderSettings(64, 48, method=method, samples=samples, **more)
    return render(scene, chosen).passes["combined"][..., :3].mean((0, 1))


@pytest.mark.parametrize("method", ["raytrace", "forward"])
@pytest.mark.parametrize("colour", [(0.5, 0.5, 0.5), Link("image", "color")])
def test_surfaces_with_fine_holes_are_shaded_where_they_are_opaque(method, colour):
    material = striped(colour)
    exact = seen(material, "distributed", 64)
    np.testing.assert_allclose(seen(material, method, 1), exact, rtol=0.06)


@pytest.mark.parametrize("scale", [7.0, 23.0])
@pytest.mark.parametrize("opacity", [0.4, 0.8, Link("fresnel", "fac")], ids=["clear", "dense", "fresnel"])
def test_what_is_half_clear_in_places_shines_as_much(opacity, scale):
    """Checks, some of which are dark and half clear: these have a colour of their own, and are no holes."""
    nodes = {
        "place": Node("attribute", {}, {"name": "place"}),
        "checks": Node("checker_texture", {"vector": Link("place", "vector"), "scale": scale}),
        "fresnel": Node("fresnel", {"ior": 1.3}),
        "clear": Node("transparent", {"color": (1.0, 1.0, 1.0)}),
        "dark": Node("diffuse", {"color": (0.2, 0.2, 0.2)}),
        "bright": Node("diffuse", {"color": (0.8, 0.8, 0.8)}),
        "thin": Node("mix_shader", {
            "fac": opacity, "shader": Link("clear", "bsdf"), "shader_b": Link("dark", "bsdf"),
        }),
        "mix": Node("mix_shader", {
            "fac": Link("checks", "fac"), "shader": Link("thin", "shader"), "shader_b": Link("bright", "bsdf"),
        }),
    }  # fmt: skip
    material = Material("half clear", Graph(nodes, surface=Link("mix", "shader")))
    sun = [Light("SUN", at(0.0, 0.0, 5.0), power=3.0, angle=0.0)]
    exact = seen(material, "distributed", 64, sun)
    np.testing.assert_allclose(seen(material, "raytrace", 1, sun), exact, rtol=0.045)
    # one place of a pixel is asked there
    np.testing.assert_allclose(seen(material, "forward", 1, sun), exact, rtol=0.13)


@pytest.mark.parametrize("cones", [1, 16])
@pytest.mark.parametrize("scale", [3.0, 7.0])
def test_what_is_faint_in_places_shines_there(scale, cones):
    """A glow that a tenth of the surface has everywhere: where nothing else hides what is behind it is no hole."""
    nodes = {
        "place": Node("attribute", {}, {"name": "place"}),
        "checks": Node("checker_texture", {"vector": Link("place", "vector"), "scale": scale}),
        "clear": Node("transparent", {"color": (1.0, 1.0, 1.0)}),
        "dark": Node("diffuse", {"color": (0.2, 0.2, 0.2)}),
        "glow": Node("emission", {"color": (0.9, 0.6, 0.3), "strength": 1.5}),
        "share": Node(
            "math", {"value": Link("checks", "fac"), "value_b": 0.6}, {"operation": "MULTIPLY"}
        ),
        "holes": Node("mix_shader", {
            "fac": Link("share", "value"), "shader": Link("clear", "bsdf"), "shader_b": Link("dark", "bsdf"),
        }),
        "mix": Node("mix_shader", {
            "fac": 0.1, "shader": Link("holes", "shader"), "shader_b": Link("glow", "emission"),
        }),
    }  # fmt: skip
    material = Material("faint glow", Graph(nodes, surface=Link("mix", "shader")), emission_sampling="none")
    exact = seen(material, "distributed", 64)
    found = seen(material, "raytrace", 1, raytrace=RaytraceSettings(cones=cones))
    np.testing.assert_allclose(found, exact, rtol=0.05)


@pytest.mark.parametrize("roughness", [0.0, 0.1])
@pytest.mark.parametrize("method", ["distributed", "raytrace"])
def test_a_lamp_before_half_clear_panes_is_met_once(method, roughness):
    """A mirror shows the lamp, and the rays go on through the panes behind it."""
    mirror = principled("mirror", base_color=(1.0, 1.0, 1.0), metallic=1.0, roughness=roughness)
    pane = principled("pane", base_color=(0.0, 0.0, 0.0), specular_ior_level=0.0, alpha=0.2)
    lamp = Light("AREA", at(0.0, 0.0, 4.0), power=50.0, size_x=1.0, size_y=1.0, visibility=VISIBLE & ~CAMERA)

    def brightness(panes: int) -> float:
        sheets = [quad(3.0, 6.0 + k, pane) for k in range(panes)]
        scene = Scene(Group("root", [quad(2.0, 0.0, mirror), *sheets]), from_above(5.0), [lamp], BLACK)
        chosen = RenderSettings(32, 32, method=method, samples=64)
        return render(scene, chosen).passes["combined"][12:20, 12:20, :3].mean()

    assert brightness(3) == pytest.approx(brightness(0), rel=0.02)


@pytest.mark.parametrize("glow", [False, True])
def test_colours_are_averaged_over_what_is_opaque(monkeypatch, glow):
    """Texels of all colours, a few in a pixel, and holes between them: nearer than what one texel tells."""
    n = 512
    picture = np.zeros((n, n, 4), np.float32)
    picture[..., :3] = np.random.default_rng(5).choice([0.05, 0.3, 0.9], (n, n, 1))
    picture[..., 3] = np.arange(n) // 4 % 3 != 0
    material = striped(Link("image", "color"))
    material.graph.nodes["image"].params["image"] = Image("speckles", picture, "Linear")
    if not glow:
        material.graph.nodes["glow"] = Node("diffuse", {"color": Link("image", "color")})
        material.graph.nodes["mix"].inputs["shader_b"] = Link("glow", "bsdf")
    world = BLACK if glow else uniform_world((1.0, 1.0, 1.0))
    scene = Scene(Group("root", [leaves(8, material)]), from_above(9.0), [], world)

    def picture_of(**values) -> np.ndarray:
        return render(scene, RenderSettings(64, 48, **values)).passes["combined"][..., :3]

    exact = picture_of(method="distributed", samples=256)
    errors = []
    for averaged in (True, False):
        if not averaged:
            monkeypatch.setattr(program, "_masked", lambda *_: False)
        ours = picture_of(method="raytrace")
        assert ours.mean() == pytest.approx(exact.mean(), rel=0.03)
        errors.append(np.square(ours - exact).mean())
    assert errors[0] < 0.5 * errors[1]


@pytest.mark.parametrize("kind", ["emission", "diffuse"])
def test_what_is_added_to_holes_does_not_fade_with_them(kind):
    """Coverage knows where the holes are; the rest shines for them, too."""
    material = striped((0.3, 0.3, 0.3))
    nodes = material.graph.nodes
    nodes["holes"] = Node(
        "math", {"value": 1.0, "value_b": Link("image", "alpha")}, {"operation": "SUBTRACT"}
    )
    nodes["clear"] = Node("transparent", {"color": Link("holes", "value")})
    nodes["glow"] = Node(kind, {"color": (0.3, 0.3, 0.3)})
    added = Link("glow", "emission" if kind == "emission" else "bsdf")
    nodes["mix"] = Node("add_shader", {"shader": Link("clear", "bsdf"), "shader_b": added})
    sun = [] if kind == "emission" else [Light("SUN", at(0.0, 0.0, 5.0), power=3.0, angle=0.0)]
    scene = Scene(Group("root", [leaves(1, material)]), from_above(9.0), sun, BLACK)

    def brightness(**values) -> float:
        return render(scene, RenderSettings(64, 48, **values)).passes["combined"][..., :3].mean()

    exact = brightness(method="distributed", samples=64)
    assert exact > 0.0
    assert brightness(method="raytrace") == pytest.approx(exact, rel=0.05)


@pytest.mark.parametrize("film_transparent", [False, True])
@pytest.mark.parametrize("clear", [(0.5, 0.5, 0.5), (0.8, 0.3, 0.5)])
def test_light_that_is_added_to_what_passes_does_not_fade_with_it(clear, film_transparent):
    nodes = {
        "bsdf": Node("diffuse", {"color": (0.6, 0.6, 0.6)}),
        "clear": Node("transparent", {"color": clear}),
        "both": Node("add_shader", {"shader": Link("bsdf", "bsdf"), "shader_b": Link("clear", "bsdf")}),
    }
    veil = Material("veil", Graph(nodes, surface=Link("both", "shader")))
    scene = Scene(Group("root", [quad(1.0, 0.0, veil)]), from_above(3.0), [], uniform_world((1.0, 1.0, 1.0)))
    chosen = RenderSettings(32, 32, method="raytrace", film_transparent=film_transparent)
    found = render(scene, chosen).passes["combined"][13:19, 13:19, :3].mean((0, 1))
    behind = np.zeros(3) if film_transparent else np.array(clear)
    np.testing.assert_allclose(found, 0.6 + behind, atol=0.03)
