"""Fine textures at one cone a pixel, beside what the pixel filter makes of them: checks, stripes, pixel art."""

from dataclasses import replace

import numpy as np
import pytest

from pointmr_engine import Camera, Material, Mesh, RenderSettings, Scene, render, uniform_world
from pointmr_engine.image.filters import filter_extent, filter_weight
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import Group
from pointmr_engine.scene.texture import Image
from pointmr_engine.shading.program import compile_graph
from tests.engine.small_scenes import from_above, quad
from tests.engine.test_footprint_mean import BLACK, checkered, striped

SIDE = 48


def looked_at(side: float, method: str, camera=None, **settings) -> np.ndarray:
    """Glowing checks, `side` pixels large if seen from above."""
    floor = quad(200.0, material=Material("checks", checkered(1.0 / side)))
    camera = camera or from_above(kind="ORTHOGRAPHIC", ortho_scale=float(SIDE))
    scene = Scene(Group("root", [floor]), camera, [], uniform_world(BLACK))
    return render(scene, RenderSettings(SIDE, SIDE, method=method, **settings)).passes["combined"][..., 0]


@pytest.mark.parametrize("side, rms", [(6.3, 0.005), (1.7, 0.01), (1.1, 0.015), (0.6, 0.02), (0.27, 0.04)])
def test_checks_of_one_cone_a_pixel_are_as_the_pixel_filter_makes_them(side, rms):
    """Both are separable: 0.025 to 0.037 off, and 0.085 for the smallest, by means alone over turned footprints."""
    reach = filter_extent("blackman_harris", 1.5)
    offset = np.linspace(-reach, reach, 2001)
    weight = filter_weight("blackman_harris", 1.5, offset)
    x = np.arange(SIDE) + 0.5 - SIDE / 2
    stripes = (1.0 - 2.0 * (np.floor((x[:, None] + offset) / side) % 2)) @ (weight / weight.sum())
    exact = 0.5 - 0.5 * stripes[:, None] * stripes
    found = looked_at(side, "raytrace")
    assert min(np.sqrt(((found - e) ** 2).mean()) for e in (exact, 1.0 - exact)) < rms


def floors_differ(material: Material) -> float:
    """Root mean square difference of one cone a pixel from the exact image of a floor seen from above."""
    floor = quad(300.0, material=material)
    camera = from_above(kind="ORTHOGRAPHIC", ortho_scale=float(SIDE))
    scene = Scene(Group("root", [floor]), camera, [], uniform_world(BLACK))
    exact, found = (
        render(scene, RenderSettings(SIDE, SIDE, method=method, samples=1024)).passes["combined"][..., 0]
        for method in ("distributed", "raytrace")
    )
    assert exact.std() > 0.2
    return float(np.sqrt(((found - exact) ** 2).mean()))


MATH = [
    Node("math", {"value": Link("x", "x")}, {"operation": "FRACT"}),
    Node("math", {"value": Link("n", "value"), "value_b": 0.5}, {"operation": "GREATER_THAN"}),
]


RAMP = Node(
    "color_ramp",
    {"fac": Link("n", "value")},
    {"table": np.repeat([[1.0] * 4, [0.0] * 4], 128, 0), "interpolate": False},
)


@pytest.mark.parametrize("last", [MATH[1], RAMP], ids=["math", "ramp"])
def test_stripes_that_nodes_cut_out_of_coordinates_have_smooth_edges(last):
    """2.6 pixels wide: 0.027 off where a fragment showed one place."""
    nodes = {
        "c": Node("texture_coordinate"),
        "m": Node(
            "mapping", {"vector": Link("c", "object"), "rotation": (0.0, 0.0, 0.4), "scale": (1 / 5.2,) * 3}
        ),
        "x": Node("separate_xyz", {"vector": Link("m", "vector")}),
        "n": MATH[0],
        "t": last,
        "e": Node("emission", {"color": Link("t", "value" if last.kind == "math" else "color")}),
    }
    graph = Graph(nodes, surface=Link("e", "emission"))
    assert compile_graph(graph).fine_needs
    assert floors_differ(Material("stripes", graph)) < 0.01
    # what is one number a mesh is no texture
    nodes["x"] = Node("object_info")
    nodes["n"] = Node("math", {"value": Link("x", "random")}, {"operation": "FRACT"})
    assert not compile_graph(Graph(nodes, surface=Link("e", "emission"))).fine_needs


@pytest.mark.parametrize("side", [6.3, 1.7, 0.9])
def test_texels_that_are_not_interpolated_have_smooth_edges(side):
    """Pixel art, texels `side` pixels large: 0.046 to 0.089 off where a fragment showed one texel."""
    pixels = np.ones((64, 64, 4), np.float32)
    pixels[..., :3] = np.random.default_rng(1).integers(0, 2, (64, 64, 1))
    graph = striped()
    graph.nodes["m"].inputs["scale"] = (1 / (64 * side),) * 3
    graph.nodes["t"].params.update(image=Image("texels", pixels, "Linear"), interpolation="Closest")
    graph.nodes["d"] = Node("emission", {"color": Link("t", "color")})
    graph.surface = Link("d", "emission")
    assert floors_differ(Material("pixel art", graph)) < 0.01


def grid(side: float, size: float, material: Material) -> Mesh:
    """A square of triangles that are `size` long, facing up."""
    n = int(side / size) + 1
    x = np.linspace(-side / 2, side / 2, n + 1)
    positions = np.stack([*np.meshgrid(x, x), np.zeros((n + 1, n + 1))], -1).reshape(-1, 3)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    triangles = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    return Mesh("grid", positions.astype(np.float32), triangles.astype(np.int32), materials=(material,))


def threads(width: float) -> Material:
    """A glowing weave, image texels `width` pixels wide, interpolated."""
    rng, n = np.random.default_rng(3), 64
    pixels = np.ones((n, n, 4), np.float32)
    pixels[..., :3] = (rng.random((n, 1)) * rng.random((1, n)))[..., None]
    graph = striped()
    graph.nodes["m"].inputs["scale"] = (1 / (n * width),) * 3
    graph.nodes["t"].params.update(image=Image("threads", pixels, "Linear"))
    graph.nodes["d"] = Node("emission", {"color": Link("t", "color")})
    graph.surface = Link("d", "emission")
    return Material("threads", graph)


@pytest.mark.parametrize(
    "size, lens, rms",
    [(0.9, False, 0.001), (0.4, False, 0.01), (0.15, False, 0.01), (0.9, True, 0.005), (0.4, True, 0.007)],
)
def test_textures_of_dense_meshes_are_as_those_of_one_square(size, lens, rms):
    """Triangles `size` pixels large: 0.005 to 0.018 off where a part of a cone was read at one of its fragments."""
    material, camera = threads(1.0), from_above(kind="ORTHOGRAPHIC", ortho_scale=float(SIDE))
    if lens:
        camera = replace(camera, fstop=0.25, focus_distance=4.0)  # one pixel out of focus
    settings = RenderSettings(SIDE, SIDE, method="raytrace")
    dense, whole = (
        render(Scene(Group("root", [mesh]), camera, [], uniform_world(BLACK)), settings).passes["combined"][
            ..., 0
        ]
        for mesh in (grid(1.2 * SIDE, size, material), quad(1.2 * SIDE, material=material))
    )
    assert whole.std() > 0.03
    assert np.sqrt(((dense - whole) ** 2).mean()) < rms


def test_what_is_far_out_of_focus_is_read_over_all_of_its_larger_cells():
    """Threads of half a pixel, four pixels out of focus: 0.019 off where half of each cell was read."""
    camera = from_above(kind="ORTHOGRAPHIC", ortho_scale=float(SIDE), fstop=0.25, focus_distance=2.5)
    floor = quad(1.2 * SIDE, material=threads(0.5))
    scene = Scene(Group("root", [floor]), camera, [], uniform_world(BLACK))
    exact, found = (
        render(scene, RenderSettings(SIDE, SIDE, method=method, samples=1024)).passes["combined"][..., 0]
        for method in ("distributed", "raytrace")
    )
    assert np.sqrt(((found - exact) ** 2).mean()) < 0.014


def test_footprints_lie_in_the_image_as_its_cells_do():
    """Checks seen obliquely by a camera that is rolled: 0.014 off where sides of footprints went by the view alone."""
    tilt, roll = 0.7, 0.78
    c, s = np.cos(tilt), np.sin(tilt)
    turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    m = np.eye(4)
    m[:3, :3] = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ turn
    m[:3, 3] = m[:3, 2] * 40.0
    camera = Camera(m, kind="ORTHOGRAPHIC", ortho_scale=float(SIDE))
    exact = looked_at(3.3, "distributed", camera, samples=1024)
    assert np.sqrt(((looked_at(3.3, "raytrace", camera) - exact) ** 2).mean()) < 0.0105
