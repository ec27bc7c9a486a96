"""Attributes with one value all over each triangle: textures of nothing else have nothing to be averaged."""

import numpy as np
import pytest

from pointmr_engine import Camera, Material, RenderSettings, Scene, render, uniform_world
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.hierarchy.layers import even_layers
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import Group
from pointmr_engine.scene.mesh import Attribute, Mesh
from pointmr_engine.shading.program import Program, compile_graph
from tests.engine.small_scenes import from_above

WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
SIDE = 6  # squares along an edge
NEED = "attribute:leaf"


def checks() -> Graph:
    """An emission of checks that look up an attribute instead of a place."""
    nodes = {
        "a": Node("attribute", params={"name": "leaf"}),
        "t": Node(
            "checker_texture", {"vector": Link("a", "vector"), "scale": 1.0, "color1": WHITE, "color2": BLACK}
        ),
        "e": Node("emission", {"color": Link("t", "color")}),
    }
    return Graph(nodes, surface=Link("e", "emission"))


def leaves(domain="corner", material=None, change=None, second=None) -> Mesh:
    """Squares of two triangles each, a number and some for each of them; change: (row, value) of one more."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(SIDE), np.arange(SIDE)))
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    positions = np.zeros((SIDE * SIDE, 4, 3), np.float32)
    positions[..., :2] = np.stack([x, y], 1)[:, None] + corners - SIDE / 2
    first = 4 * np.arange(SIDE * SIDE)
    triangles = (first[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3).astype(np.int32)
    of_squares = np.stack([0.5 + x, 0.5 + y, np.full(len(x), 0.5)], 1).astype(np.float32)
    each = {"vertex": 4, "corner": 6, "face": 2, "constant": 0}[domain]
    values = np.repeat(of_squares, each, 0) if each else of_squares[:1]
    if change is not None:
        values[change[0]] = change[1]
    slots = (material,) if second is None else (material, second)
    index = None if second is None else np.repeat(np.arange(SIDE * SIDE) % 2, 2).astype(np.int32)
    return Mesh(
        "leaves", positions.reshape(-1, 3), triangles, materials=slots, material_index=index,
        attributes={"leaf": Attribute(values, domain)},
    )  # fmt: skip


def even(*meshes: Mesh, material=0, needs=(NEED, "position", "uv:")) -> frozenset[str]:
    camera = Camera(np.eye(4))
    return even_layers(compile_geometry(Scene(Group("root", list(meshes)), camera)), material, needs)


@pytest.mark.parametrize("domain", ["vertex", "corner", "face", "constant"])
def test_values_that_triangles_have_as_a_whole_are_even(domain):
    assert even(leaves(domain)) == {NEED}


@pytest.mark.parametrize("domain", ["vertex", "corner"])
@pytest.mark.parametrize("value", [7.0, np.nan])
@pytest.mark.parametrize("row", [0, -1])
def test_one_corner_that_differs_is_enough(domain, value, row):
    changed = leaves(domain, change=(row, value))
    assert even(changed) == frozenset()
    # in any mesh of the material
    assert even(leaves(domain), changed) == frozenset()


def test_a_missing_layer_is_even_and_places_are_not():
    mesh = leaves()
    mesh.uvs["leaf_uv"] = np.random.default_rng(1).random((len(mesh.triangles), 3, 2), np.float32)
    needs = ("attribute:none", "attribute:leaf_uv", "uv:leaf_uv", "position")
    assert even(mesh, needs=needs) == {"attribute:none"}


def test_only_the_materials_own_triangles_count():
    a, b = Material("a", checks()), Material("b", checks())
    scene = Scene(Group("root", [leaves(material=a, second=b, change=(0, 9.0))]), Camera(np.eye(4)))
    geometry = compile_geometry(scene)
    found = {m.name: even_layers(geometry, k, [NEED]) for k, m in enumerate(geometry.materials)}
    assert found == {"a": frozenset(), "b": {NEED}}


def test_textures_of_what_is_even_are_not_fine():
    assert compile_graph(checks()).fine_needs
    assert compile_graph(checks(), even=frozenset({NEED})).fine_needs == frozenset()
    # but those of places besides are
    graph = checks()
    graph.nodes["c"] = Node("texture_coordinate")
    graph.nodes["t"].inputs["scale"] = Link("c", "object")
    assert compile_graph(graph, even=frozenset({NEED})).fine_needs
    # nor are those of an object's own values
    graph = checks()
    graph.nodes["i"] = Node("object_info")
    graph.nodes["t"].inputs["vector"] = Link("i", "random")
    assert compile_graph(graph).fine_needs == frozenset()


def test_images_of_even_attributes_ask_once_a_fragment(monkeypatch):
    asked = []
    run = Program.fine_values
    monkeypatch.setattr(
        Program, "fine_values", lambda self, points: asked.append(points.count) or run(self, points)
    )
    settings = RenderSettings(60, 60, method="raytrace", passes=("combined",), threads=1)

    def image(**change):
        mesh = leaves(material=Material("checks", checks()), **change)
        scene = Scene(Group("root", [mesh]), from_above(9.0), [], uniform_world(BLACK))
        return render(scene, settings).passes["combined"][..., 0]

    shown = image()
    assert not asked
    assert set(shown.round(3).ravel()) >= {0.0, 1.0}
    image(change=(0, 0.7))
    assert asked
