"""Light that is added to what passes a surface (Add Shader with a Transparent BSDF), against random rays."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine import Group, Material, Scene, principled, uniform_world
from pointmr_engine.forward.baked.opacity_classes import _led
from pointmr_engine.forward.baked.opacity_lattice import in_triangle, lattice
from pointmr_engine.forward.drawing.cut_outs import build_cut_outs, lattices, sampled
from pointmr_engine.forward.drawing.part_opacity import LEAST_ADDED, MOST_ADDED, PartOpacity
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.multires.fragments.transparency import close_transparency
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.texture import Image
from pointmr_engine.shading.bsdf.layout import LAMBERT, SAMPLE, WEIGHT
from pointmr_engine.shading.lobes import allocate
from pointmr_engine.shading.program import compile_graph
from tests.engine.small_scenes import from_above, quad
from tests.engine.test_raytrace_light import DARK, image

GREY = principled(base_color=(0.6, 0.6, 0.6), specular_ior_level=0.0)
SKY = uniform_world((0.3, 0.4, 0.6))
MIDDLE = np.s_[15:21, 21:27]


def added(strength: float | Link, kind: str = "emission", clear=(1.0, 1.0, 1.0), **nodes: Node) -> Material:
    """What lets `clear` through and glows, or scatters, besides."""
    colour = {"strength": strength} if kind == "emission" else {}
    nodes |= {
        "clear": Node("transparent", {"color": clear}),
        "glow": Node(kind, {"color": (0.9, 0.5, 0.2), **colour}),
        "both": Node("add_shader", {
            "shader": Link("clear", "bsdf"), "shader_b": Link("glow", "emission" if kind == "emission" else "bsdf"),
        }),
    }  # fmt: skip
    return Material("added", Graph(nodes, surface=Link("both", "shader")), emission_sampling="NONE")


def checked(size: float) -> Material:
    """Glowing checks, and nothing between them."""
    nodes = {
        "place": Node("texture_coordinate"),
        "checks": Node("checker_texture", {"vector": Link("place", "object"), "scale": 1.0 / size}),
    }
    return added(Link("checks", "fac"), **nodes)


def scene(material: Material, world=SKY, floor=True) -> Scene:
    meshes = [quad(1.5, z=1.0, material=material), *([quad(6.0, material=GREY)] if floor else [])]
    return Scene(Group("root", meshes), from_above(5.0), [], world)


@pytest.mark.parametrize("kind", ["emission", "diffuse"])
@pytest.mark.parametrize("clear", [(1.0, 1.0, 1.0), (0.9, 0.7, 0.2)])
@pytest.mark.parametrize("cones", [1, 4])
def test_it_is_seen_and_what_lies_behind_it_too(kind, clear, cones):
    cache, whole = Cache(), scene(added(1.0, kind, clear))
    exact = image(whole, cache, method="distributed", samples=128)
    ours = image(whole, cache, cones=cones)
    # what is matt shares some of its light with the floor below
    rtol = 0.02 if kind == "emission" else 0.04
    np.testing.assert_allclose(ours[MIDDLE].mean((0, 1)), exact[MIDDLE].mean((0, 1)), rtol=rtol)
    assert np.abs(ours - exact).mean() < 0.02 * exact.mean()


@pytest.mark.parametrize("second", [(0.9, 0.9, 0.9), (0.7, 0.5, 0.1)])
@pytest.mark.parametrize("cones", [1, 4])
def test_two_transparencies_brighten_what_lies_behind_them(second, cones):
    """Their sum is more than one: no surface does that, but shaders of holes in holes do, and Cycles shows it."""
    material = added(1.0, "diffuse", (0.8, 0.8, 0.8))
    material.graph.nodes["glow"] = Node("transparent", {"color": second})
    cache, whole = Cache(), scene(material)
    exact = image(whole, cache, method="distributed", samples=128)
    ours = image(whole, cache, cones=cones)
    np.testing.assert_allclose(ours[MIDDLE].mean((0, 1)), exact[MIDDLE].mean((0, 1)), rtol=0.03)
    np.testing.assert_allclose(ours.mean((0, 1)), exact.mean((0, 1)), rtol=0.02)


@pytest.mark.parametrize("size", [0.3, 0.05])
@pytest.mark.parametrize("cones", [1, 4])
def test_what_brightens_in_places_is_drawn_all_over(size, cones):
    """Waves let through 0.6 to 1.6 of what arrives, and reflect. Between places that brighten, drawn whole, others were
    drawn at an eighth: fragments of both took the weight of either, and the mean was up to a tenth off."""
    nodes = {
        "place": Node("texture_coordinate"),
        "wave": Node("wave_texture", {"vector": Link("place", "object"), "scale": 0.3 / size}),
        "more": Node("transparent", {"color": Link("wave", "color")}),
        "shine": Node("add_shader", {"shader": Link("both", "shader"), "shader_b": Link("more", "bsdf")}),
    }
    material = added(1.0, "diffuse", (0.6, 0.6, 0.6), **nodes)
    material.graph.surface = Link("shine", "shader")
    cache, whole = Cache(), scene(material)
    exact = image(whole, cache, method="distributed", samples=128)
    ours = image(whole, cache, cones=cones)
    np.testing.assert_allclose(ours[MIDDLE].mean((0, 1)), exact[MIDDLE].mean((0, 1)), rtol=0.06)
    assert np.abs(ours - exact).mean() < 0.04 * exact.mean()
    assert ours.max() < 1.3 * exact.max()


@pytest.mark.parametrize(("bright", "all_over"), [(0.05, False), (0.5, True)])
def test_outlines_of_leaves_that_brighten_are_no_films(bright, all_over):
    """Where an image's colour is brighter than its alpha, as at the edges of a leaf, more may pass than arrives."""

    def opacity(triangles, u, v):
        n = len(u)
        found = np.zeros((n, 5))
        found[: n // 4, :4] = 1.0
        found[: int(bright * n), 4] = 1.0
        return found

    cells = sampled(opacity, np.zeros(1, np.int64), np.zeros(1, np.int64), 16)[1]
    assert (cells > 0).all() == all_over


def test_outlines_that_brighten_tell_no_leaves_apart():
    rng = np.random.default_rng(3)

    def opacity(triangles, u, v):
        found = np.repeat((u > 0.3).astype(np.float64)[:, None], 5, 1)
        found[:, 4] = rng.random(len(u)) < 0.1
        return found

    first, of = _led(np.arange(20), np.zeros(20, np.int64), opacity)
    assert len(first) == 1 and not of.any()


@given(st.floats(0.1, 1.0), st.tuples(*[st.floats(0.0, 0.6)] * 3), st.tuples(*[st.floats(0.2, 1.0)] * 3))
def test_holes_between_coloured_leaves_are_as_large_as_they_are(leaves, passes, colour):
    """The channel that leaves block most says how often they are drawn; what they send does not go by their share of a
    footprint, which is what all channels tell.
    """
    lobes, own = allocate(1, 1), np.array([passes], np.float32)
    lobes.count[0], lobes.kind[0, 0] = 1, LAMBERT
    lobes.data[0, 0, WEIGHT : WEIGHT + 3] = leaves * np.array(colour)
    lobes.data[0, 0, SAMPLE] = leaves * np.mean(colour)
    lobes.transparency[0] = 1.0 - leaves + leaves * own[0]
    throughput, drawn = np.ones((1, 3), np.float32), 1.0 - min(passes)
    close_transparency(
        lobes, throughput, np.ones(1, np.bool_), np.zeros(1, np.bool_), np.array([1.0 - drawn], np.float32), own,
        np.int64(1),
    )  # fmt: skip
    np.testing.assert_allclose(drawn * leaves * throughput[0], 1.0, rtol=1e-3)


@pytest.mark.parametrize("strength", [0.02, 0.3, 5.0])
def test_it_shines_as_much_however_strong(strength):
    whole = scene(added(strength), DARK, floor=False)
    for method in ("raytrace", "forward"):
        found = image(whole, method=method)[MIDDLE].mean((0, 1))
        np.testing.assert_allclose(found, strength * np.array([0.9, 0.5, 0.2]), rtol=0.02)


@pytest.mark.parametrize("size", [0.4, 0.11])
def test_patterns_of_it_are_as_sharp(size):
    cache, whole = Cache(), scene(checked(size))
    exact = image(whole, cache, method="distributed", samples=128)
    ours = image(whole, cache, cones=4)
    assert np.abs(ours - exact).mean() < 0.03 * exact.mean()
    assert ours.max() < 1.1 * exact.max()  # none of its light is another place's


def test_films_hold_it():
    whole = scene(added(1.0), DARK, floor=False)
    cache = Cache()
    exact = image(whole, cache, method="distributed", samples=64, film_transparent=True)
    ours = image(whole, cache, film_transparent=True)
    np.testing.assert_allclose(ours[MIDDLE].mean((0, 1)), exact[MIDDLE].mean((0, 1)), rtol=0.02)


def test_places_without_it_are_not_drawn():
    """Of a clear card with few glowing checks, only these are."""
    geometry = compile_geometry(scene(checked(0.4), floor=False))
    programs = [compile_graph(m.graph) for m in geometry.materials]
    mean, densest, _ = build_cut_outs(PartOpacity(geometry, programs))
    for cut_outs, share in ((mean, LEAST_ADDED), (densest, MOST_ADDED)):
        assert set(np.unique(lattices(cut_outs))) == {0, round(255 * share)}


def test_mixtures_are_none():
    """Where what is sent and what passes share the light, opacity says all."""
    material = added(1.0)
    material.graph.nodes["both"].kind = "mix_shader"
    assert compile_graph(added(1.0).graph).adds
    assert not compile_graph(material.graph).adds


@given(st.integers(2, 40), st.integers(0, 2**31))
@settings(max_examples=30, deadline=None)
def test_cells_are_looked_at_where_they_are(side, row):
    """Those that the longest edge crosses were looked at in the cell across the diagonal."""
    u, v = lattice(side, np.array([row]))
    q, p = np.nonzero(in_triangle(side))
    own = u[0, q, p], v[0, q, p]
    assert (own[0] + own[1] <= 1.0 + 1e-6).all()
    for found, cell in zip(own, (p, q), strict=True):
        assert (found * side >= cell - 1e-4).all() and (found * side <= cell + 1 + 1e-4).all()


def test_whole_scenes_are_as_without_it_where_nothing_shines():
    """A card that adds nothing is clear."""
    material = added(0.0)
    empty = Scene(Group("root", [quad(6.0, material=GREY)]), from_above(5.0), [], SKY)
    np.testing.assert_allclose(image(scene(material)), image(empty), atol=1e-3)


def test_images_whose_colours_pass_light_are_read_where_leaves_are():
    """The colour of a footprint's leaves passes nothing in its holes."""
    nodes = {
        "image": Node(
            "image_texture", params={"image": Image("leaf", np.ones((4, 4, 4), np.float32), "Linear")}
        ),
        "leaf": Node("principled", {"base_color": Link("image", "color"), "alpha": Link("image", "alpha")}),
        "clear": Node("transparent", {"color": Link("image", "color")}),
        "both": Node("add_shader", {"shader": Link("leaf", "bsdf"), "shader_b": Link("clear", "bsdf")}),
    }
    assert compile_graph(Graph(nodes, surface=Link("leaf", "bsdf"))).masked
    assert not compile_graph(Graph(nodes, surface=Link("both", "shader"))).masked
