"""Holes that shadow rays pass unasked, what stops them unasked, and the chance by which faint ones go on."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine import Group, Light, Material, RenderSettings, Scene, principled, render, uniform_world
from pointmr_engine.forward.drawing.cut_outs import build_cut_outs
from pointmr_engine.forward.drawing.part_opacity import PartOpacity
from pointmr_engine.hierarchy.acceleration import build_acceleration, set_micromap, set_opaque
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.multires.cones import opacity_micromap
from pointmr_engine.multires.cones.opacity_micromap import CLEAR, SOLID, build_micromap, surely
from pointmr_engine.raytracing import walk
from pointmr_engine.raytracing.rays import allocate_hits, allocate_rays
from pointmr_engine.raytracing.surface import points_at
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.texture import Image
from pointmr_engine.shading.program import compile_graph
from tests.engine.small_scenes import at, from_above, quad

BLACK = uniform_world((0.0, 0.0, 0.0))


def card(z=1.0, more=None):
    """A card with a round leaf; more: what its alpha is multiplied with, name of a node and its output."""
    n = 64
    x, y = np.meshgrid(np.arange(n) + 0.5 - n / 2, np.arange(n) + 0.5 - n / 2)
    picture = np.ones((n, n, 4), np.float32)
    picture[..., 3] = np.hypot(x, y) < 0.3 * n
    nodes = {
        "image": Node("image_texture", {}, {"image": Image("leaf", picture, "Linear")}),
        "alpha": Node("math", {"value": Link("image", "alpha"), "value_b": 1.0}, {"operation": "MULTIPLY"}),
        "bsdf": Node("principled", {"alpha": Link("alpha", "value"), "specular_ior_level": 0.0}),
    }
    if more is not None:
        nodes["more"] = Node(more[0])
        nodes["alpha"].inputs["value_b"] = Link("more", more[1])
    mesh = quad(2.0, z, Material("leaf", Graph(nodes, surface=Link("bsdf", "bsdf"))))
    mesh.uvs["UVMap"] = ((mesh.positions[mesh.triangles][..., :2] + 1.0) / 2.0).astype(np.float32)
    return mesh


def parts(mesh):
    """(geometry, programs, micromap) of a mesh."""
    geometry = compile_geometry(Scene(Group("root", [mesh]), from_above(), [], BLACK))
    programs = [compile_graph(m.graph) for m in geometry.materials]
    opacity = PartOpacity(geometry, programs)
    return geometry, programs, build_micromap(opacity, build_cut_outs(opacity)[1])


@given(st.integers(2, 12), st.integers(0, 2**32 - 1))
def test_cells_are_clear_with_all_their_neighbours(side, seed):
    clear = np.random.default_rng(seed).random((1, side, side)) < 0.9
    inside = np.add.outer(np.arange(side), np.arange(side)) < side
    found = surely(clear)[0]
    for q, p in np.ndindex(side, side):
        near = np.s_[max(q - 1, 0) : q + 2, max(p - 1, 0) : p + 2]
        assert found[q, p] == bool(inside[q, p] and (clear[0][near] | ~inside[near]).all())


@pytest.mark.parametrize("looks", [opacity_micromap.LOOKS, 1500, 400])  # few: cells are halved
@pytest.mark.parametrize("more", [None, ("hair_info", "is_strand"), ("uv_map", "uv")])
def test_only_holes_and_what_is_opaque_is_known_and_most_of_it(more, looks, monkeypatch):
    monkeypatch.setattr(opacity_micromap, "LOOKS", looks)
    geometry, programs, (first, row, bits, side) = parts(card(more=more))
    rng = np.random.default_rng(2)
    n = 20_000
    u, v = rng.random((2, n), np.float32)
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    triangle = rng.integers(0, 2, n).astype(np.int32)
    points = points_at(
        geometry, np.zeros(n, np.int32), triangle, u, v, np.broadcast_to(np.eye(4)[:3], (n, 3, 4)),
        programs[0].transparency_needs,
    )  # fmt: skip
    share = programs[0].transparency(points)
    at_row = row[first[0] + triangle] + np.minimum((v * side).astype(int), side - 1)
    known = ((bits[at_row] >> np.minimum((u * side).astype(int), side - 1)[:, None]) & 1) != 0
    for found, truth in zip(known.T, (share.min(1) >= CLEAR, share.max(1) <= SOLID), strict=True):
        assert not (found & ~truth).any()
        assert found.sum() >= 0.7 * truth.sum()
    assert (share.min(1) >= CLEAR).any() and (more is not None or (share.max(1) <= SOLID).any())


def test_opaque_triangles_under_a_material_that_may_have_holes_are_known_as_a_whole():
    mesh = card()
    middle = mesh.uvs["UVMap"]
    middle[:] = 0.5 + 0.1 * (middle - 0.5)  # nothing of the leaf's outline is left
    _, _, (_, row, bits, side) = parts(mesh)
    assert side and (row == row[0]).all()  # they share what is known
    assert (bits[row[0] : row[0] + side] == (0, -1)).all()


@pytest.mark.parametrize("node", [("object_info", "random"), ("light_path", "is_shadow_ray")])
def test_what_instances_or_rays_decide_is_asked_for(node):
    assert parts(card(more=node))[-1][-1] == 0


def test_where_no_cell_may_be_known_none_is_looked_at_again():
    mesh = card(more=("white_noise_texture", "color"))
    nodes = mesh.materials[0].graph.nodes
    nodes["where"], alpha = Node("uv_map"), nodes["alpha"]
    nodes["more"].inputs["vector"] = Link("where", "uv")
    # clear at a twentieth of all points, half transparent at others
    alpha.inputs["value"], alpha.inputs["value_b"] = alpha.inputs["value_b"], 0.05
    alpha.params["operation"] = "SUBTRACT"
    assert parts(mesh)[-1][-1] == 0


def test_opaque_scenes_have_no_map():
    assert parts(quad(1.0, 0.0, principled("plain")))[-1][-1] == 0


@given(st.integers(0, 1000))
@settings(max_examples=20)
def test_shadow_rays_pass_holes_and_end_at_leaves(seed):
    geometry, programs, micromap = parts(card())
    plain = set_opaque(build_acceleration(geometry), np.array([p.opaque for p in programs]))
    n = 200
    rays, before, after = allocate_rays(n), allocate_hits(n), allocate_hits(n)
    rays.origin[:] = np.random.default_rng(seed).uniform(-1, 1, (n, 3)) * (1, 1, 0) + (0, 0, 2)
    rays.direction[:] = (0, 0, -1)
    walk.shadow(plain, rays, before)
    walk.shadow(set_micromap(plain, *micromap), rays, after)
    radius = np.hypot(*rays.origin[:, :2].T)
    assert (before.triangle >= 0).all()
    assert (after.triangle[radius < 0.6] != -1).all() and (after.triangle[radius > 0.6] != walk.BLOCKED).all()
    # but for cells of the diagonal
    assert (after.triangle[radius > 0.72] == -1).mean() > 0.9
    assert (after.triangle[radius < 0.48] == walk.BLOCKED).mean() > 0.8


def grove(count=4):
    """Cards above one another, over a floor that the sun lights through their holes."""
    floor = quad(20.0, material=principled("floor", base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0))
    cards = [card(1.0 + 0.2 * k) for k in range(count)]
    return Scene(
        Group("root", [floor, *cards]), from_above(6.0), [Light("SUN", at(0, 0, 3), power=3.0)], BLACK
    )


def test_images_are_the_same_with_fewer_rays(monkeypatch):
    chosen = RenderSettings(48, 48, method="raytrace")
    ours = render(grove(), chosen)
    monkeypatch.setattr(opacity_micromap, "LOOKS", 0)
    asked = render(grove(), chosen)
    a, b = (f.passes["combined"][..., :3] for f in (ours, asked))
    np.testing.assert_allclose(a, b, atol=1e-4 * b.max())
    few, many = (f.stats["counters"]["shadow_rays"] for f in (ours, asked))
    assert few < 0.8 * many


def panes(count, share):
    """Grey panes over a floor, under a sun."""
    grey = Material(
        "pane", Graph({"t": Node("transparent", {"color": (share,) * 3})}, surface=Link("t", "bsdf"))
    )
    floor = quad(2.0, material=principled("floor", base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0))
    stack = [quad(40.0, 20.0 + k, grey) for k in range(count)]
    sun = Light("SUN", at(0, 0, 100), power=100.0)
    return Scene(Group("root", [floor, *stack]), from_above(3.0), [sun], BLACK)


def test_faint_shadow_rays_go_on_by_chance_and_lose_nothing():
    count, share = 6, 0.4
    chosen = RenderSettings(32, 32, method="distributed", samples=64, transparent_max_bounces=16)
    frames = [render(panes(n, share), chosen, cache=Cache()) for n in (0, count)]
    light = [f.passes["combined"][4:-4, 4:-4, :3].mean() for f in frames]
    assert light[1] / light[0] == pytest.approx(share**count, rel=0.1)
    through, rays = (frames[1].stats["counters"][k] for k in ("camera_rays", "shadow_rays"))
    assert rays < 5.5 * through  # of seven legs each


def test_clear_panes_leave_nothing_to_chance():
    chosen = RenderSettings(16, 16, method="distributed", samples=4, transparent_max_bounces=16)
    none, some = (
        render(panes(n, 1.0), chosen, cache=Cache()).passes["combined"][4:-4, 4:-4, :3] for n in (0, 8)
    )
    np.testing.assert_allclose(some, none, rtol=1e-5)
