"""Triangles with holes that are seen large, or reach behind the camera: their outlines, colours and lattices."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.forward.scenes import look
from pointmr_engine import Camera, Group, Light, Material, Mesh, RenderSettings, Scene, principled
from pointmr_engine.forward import method as forward
from pointmr_engine.forward.drawing.cut_outs import FINEST, lattices
from pointmr_engine.forward.selection.near_cut_outs import CELL, LARGEST, ROOM, largest_in_view, lattice_sides
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.raytracing.camera import compile_camera
from pointmr_engine.raytracing.environment import Environment
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import instance
from pointmr_engine.scene.settings import RaytraceSettings
from pointmr_engine.scene.texture import Image
from pointmr_engine.shading.program import compile_graph
from tests.engine.small_scenes import at, from_above, quad
from tests.engine.test_cut_outs import leaf, leaves
from tests.engine.test_raytrace_light import DARK, image

SUN = Light("SUN", look((1, 1, 4), (0, 0, 0)), power=3.0, angle=0.0)
GREY = principled(base_color=(0.3, 0.3, 0.3), specular_ior_level=0.0)
METHODS = ["raytrace", "forward"]


def scaled(mesh: Mesh, by: float) -> Mesh:
    return replace(mesh, positions=(mesh.positions * by).astype(np.float32))


def over_ground(mesh: Mesh, camera: Camera) -> Scene:
    return Scene(Group("root", [mesh, quad(60.0, z=-2.0, material=GREY)]), camera, [SUN], DARK)


@pytest.mark.parametrize("method", METHODS)
def test_a_card_that_fills_the_image_has_the_outline_of_its_picture(method):
    """128 cells along its edge are seen: they were ragged, and off by three times as much."""
    scene = over_ground(leaves(1, leaf()), from_above(0.8))
    size, cache = (320, 240), Cache()
    exact = image(scene, cache, size, method="distributed", samples=256)
    ours = image(scene, cache, size, method=method)
    assert exact.std() > 0.2 * exact.mean()
    assert np.abs(ours - exact).mean() < 0.006 * exact.mean()


@pytest.mark.parametrize("method", METHODS)
def test_ground_with_holes_that_reaches_behind_the_camera_has_them(method):
    """What the near plane cuts was drawn whole."""
    camera = Camera(look((0, -1.5, 1.0), (0, 4, 0)))
    scene, cache = over_ground(scaled(leaves(1, leaf()), 8.0), camera), Cache()
    exact = image(scene, cache, (64, 48), method="distributed", samples=256)
    ours = image(scene, cache, (64, 48), method=method)
    assert np.abs(ours - exact).mean() < 0.01 * exact.mean()
    assert np.ptp(exact[:12], (0, 1)).max() > 0.2  # leaf and holes, near by


@pytest.mark.parametrize("visibility", ["masks", "alpha"])
def test_both_kinds_of_visibility_clip_at_the_near_plane(visibility):
    camera = Camera(look((0, -1.5, 1.0), (0, 4, 0)))
    scene, cache = over_ground(scaled(leaves(1, leaf()), 8.0), camera), Cache()
    exact = image(scene, cache, method="distributed", samples=256)
    ours = image(scene, cache, raytrace=RaytraceSettings(visibility=visibility))
    assert np.abs(ours - exact).mean() < 0.02 * exact.mean()


def soft() -> Material:
    """A picture whose colour changes where its alpha does."""
    y, x = np.mgrid[0:32, 0:32] / 31.0
    alpha = np.clip(1.3 - 6.0 * ((x - 0.5) ** 2 + (y - 0.5) ** 2), 0.0, 1.0)
    picture = np.dstack([x, 0.3 + 0 * x, 1 - y, alpha]).astype(np.float32)
    nodes = {
        "place": Node("attribute", {}, {"name": "place"}),
        "image": Node(
            "image_texture", {"vector": Link("place", "vector")}, {"image": Image("soft", picture, "Linear")}
        ),
        "bsdf": Node("principled", {
            "base_color": Link("image", "color"), "alpha": Link("image", "alpha"), "specular_ior_level": 0.0,
        }),
    }  # fmt: skip
    return Material("soft", Graph(nodes, surface=Link("bsdf", "bsdf")))


@pytest.mark.parametrize("method", METHODS)
def test_what_is_half_transparent_keeps_its_colour(method):
    """It had that of the nearest opaque place."""
    scene, cache = over_ground(leaves(1, soft()), from_above(1.6)), Cache()
    exact = image(scene, cache, method="distributed", samples=256)
    ours = image(scene, cache, method=method)
    assert np.abs(ours - exact).mean() < 0.015 * exact.mean()


def prepared(scene: Scene, sampler=None, width: int = 160) -> forward.Image:
    """An image of forward mapping whose tiles could be drawn; sampler: of an image of the same scene."""
    settings = RenderSettings(width, width * 3 // 4, method="forward")
    if sampler is None:
        geometry = compile_geometry(scene)
        programs = [compile_graph(m.graph) for m in geometry.materials]
        sampler = forward.Sampler(geometry, programs, Environment(scene.world))
    image = forward.Image(sampler, scene, compile_camera(scene.camera, settings), settings)
    image.prepare(lambda: None)
    return image


def test_a_flight_keeps_what_its_views_share():
    """Views near by sample nothing anew; one to which all is small has what every view has, and keeps nothing."""
    scene = over_ground(leaves(1, leaf()), from_above(0.8))
    near = prepared(scene)
    kept = dict(near.sampler.near_cut_outs.kept)
    assert kept and (near.cut_outs.side > FINEST).all()
    prepared(replace(scene, camera=from_above(0.79)), near.sampler)
    beside = near.sampler.near_cut_outs.kept
    assert beside.keys() == kept.keys() and all(beside[key] is kept[key] for key in kept)
    far = prepared(replace(scene, camera=from_above(9.0)), near.sampler)
    assert far.cut_outs is near.sampler.cut_outs and not near.sampler.near_cut_outs.kept


def test_finer_lattices_are_of_the_same_picture():
    scene = over_ground(leaves(1, leaf()), from_above(0.8))
    image = prepared(scene)
    coarse, fine = image.sampler.cut_outs, image.cut_outs
    np.testing.assert_array_equal(fine.cells[: len(coarse.cells)], coarse.cells)
    for row in range(len(fine.side)):
        side = fine.side[row]
        own = fine.cells[fine.start[row] :][: side * side].reshape(side, side)
        assert abs(own.mean() - lattices(coarse)[row].mean()) < 2.0
        blocks = own.reshape(FINEST, side // FINEST, FINEST, side // FINEST).mean((1, 3))
        assert np.abs(blocks - lattices(coarse)[row]).mean() < 8.0


@pytest.mark.parametrize("ortho", [False, True])
def test_the_largest_triangles_in_view_count(ortho):
    """Cards as instances at several heights, the nearest of them beside the view or behind it."""
    cards = Group("cards", [scaled(leaves(1, leaf()), 0.5)])
    places = [(0, 0, 0), (0.3, 0.2, 1.0), (-0.4, 0.1, 2.0), (9.0, 0, 3.0), (0, 0, 5.5)]
    camera = from_above(4.0, kind="ORTHOGRAPHIC", ortho_scale=4.0) if ortho else from_above(4.0)
    scene = Scene(Group("root", [], [instance(cards, at(*place)) for place in places]), camera, [SUN], DARK)
    image = prepared(scene)
    size = 4.0 * np.array((160, 120))
    found = largest_in_view(image.view, image.hierarchy(), image.camera.camera_from_world, size, 2, 1.0)
    edge = 0.5 * 2**0.5  # the diagonal
    expected = edge * image.view.scale_x / (1.0 if ortho else 2.0)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    none = largest_in_view(
        image.view, image.hierarchy(), image.camera.camera_from_world, size, 2, 1.01 * expected * 2**0.5
    )
    assert (none == 0).all()


@given(st.lists(st.floats(1.0, 1e7), min_size=1, max_size=40), st.integers(2, 128))
def test_lattices_are_fine_and_fit(edges, coarse):
    edges = np.array(edges)
    sides = lattice_sides(edges, coarse)
    assert (sides >= coarse).all() and (sides <= LARGEST).all()
    assert (sides**2).sum() <= max(ROOM, len(edges) * coarse**2)
    if (np.clip(2 * edges / CELL, coarse, LARGEST) ** 2).sum() <= ROOM:
        assert (edges <= CELL * sides * (1 + 1e-9))[edges <= CELL * LARGEST].all()
