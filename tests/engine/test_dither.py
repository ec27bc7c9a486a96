"""Orders of ordered dithers: even over the square, each by itself and two of them together."""

import itertools

import numpy as np
import pytest

from pointmr_engine import Group, Instances, Material, Mesh, RenderSettings, Scene, render, uniform_world
from pointmr_engine.numerics.dither import ORDERS, RANKS, SIDE
from pointmr_engine.scene.graph import Graph, Link, Node
from tests.engine.small_scenes import from_above


@pytest.mark.parametrize("order", range(ORDERS))
def test_an_order_has_every_rank_once_and_covers_parts_of_the_square_evenly(order):
    assert sorted(RANKS[order].ravel()) == list(range(SIDE**2))
    for side in (4, 2):
        parts = (
            RANKS[order]
            .reshape(SIDE // side, side, SIDE // side, side)
            .swapaxes(1, 2)
            .reshape(-1, side * side)
        )
        for k in range(side * side):  # each part has as many of each share of the ranks
            assert ((parts * side * side // SIDE**2 == k).sum(1) == 1).all()


def test_two_orders_hide_each_other_as_if_they_were_independent():
    """Layers behind each other: of 64 cells, what both cover is off by 2.25 at most; of one order it is by up to 16."""
    worst, total, count = 0.0, 0.0, 0
    for a, b in itertools.combinations(range(ORDERS), 2):
        for turn_x, turn_y in ((0, 0), (3, 0), (0, 5), (6, 7)):
            y, x = np.mgrid[:SIDE, :SIDE]
            behind = RANKS[b][y ^ turn_y, x ^ turn_x]
            for m, n in itertools.product(range(4, 64, 4), repeat=2):
                off = abs(np.sum((RANKS[a] < m) & (behind < n)) - m * n / 64)
                worst, total, count = max(worst, off), total + off, count + 1
    assert worst < 2.5 and total / count < 0.5
    same = RANKS[0] < 32
    assert abs(np.sum(same & same) - 16) == 16


def pane(n: int, z: float, turn: float, material: Material) -> Mesh:
    """A square of n x n quads four metres wide, turned about the z axis."""
    x, y = np.meshgrid(np.linspace(-2, 2, n + 1), np.linspace(-2, 2, n + 1))
    c, s = np.cos(turn), np.sin(turn)
    corners = np.stack([c * x - s * y, s * x + c * y, np.full_like(x, z)], -1).reshape(-1, 3)
    at = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    triangles = np.concatenate(
        [np.stack([at, at + 1, at + n + 2], 1), np.stack([at, at + n + 2, at + n + 1], 1)]
    )
    return Mesh(f"pane {z}", corners, triangles.astype(np.int32), materials=(material,))


def veil(transparency: float) -> Material:
    """Black where it is not clear."""
    graph = Graph(
        {
            "black": Node("emission", {"color": (0.0, 0.0, 0.0), "strength": 0.0}),
            "clear": Node("transparent", {"color": (1.0, 1.0, 1.0)}),
            "mix": Node("mix_shader", {"fac": transparency, "shader": Link("black", "emission"),
                                       "shader_b": Link("clear", "bsdf")}),
        },
        surface=Link("mix", "shader"),
    )  # fmt: skip
    return Material("pane", graph)


def panes(count: int, transparency: float) -> Scene:
    """Panes before a white sky, each of many triangles, seen from above."""
    parts = [pane(24, 0.05 * k, 0.3 * k, veil(transparency)) for k in range(count)]
    return Scene(Group("root", parts), from_above(3.0), [], uniform_world((1.0, 1.0, 1.0)))


@pytest.mark.parametrize(("method", "noise"), [("raytrace", 0.05), ("forward", 0.1)])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_panes_behind_each_other_let_through_what_each_does(method, noise, count):
    frame = render(panes(count, 0.6), RenderSettings(32, 24, method=method))
    middle = frame.passes["combined"][6:18, 8:24, 0]
    assert middle.mean() == pytest.approx(0.6**count, abs=0.02)
    assert middle.std() < noise


@pytest.mark.parametrize(("method", "noise"), [("raytrace", 0.07), ("forward", 0.1)])
def test_placements_of_one_pane_behind_each_other_let_through_what_each_does(method, noise):
    """Leaves are placements of one leaf: of a common order what is behind two was seen as behind one."""
    one = Group("pane", [pane(6, 0.0, 0.0, veil(0.6))])
    places = np.repeat(np.eye(3, 4)[None], 3, 0)
    places[:, 2, 3] = 0.0, 0.05, 0.1
    for count in (1, 2, 3):
        root = Group("root", instances=[Instances((one,), places[:count])])
        scene = Scene(root, from_above(3.0), [], uniform_world((1.0, 1.0, 1.0)))
        middle = render(scene, RenderSettings(32, 24, method=method)).passes["combined"][6:18, 8:24, 0]
        assert middle.mean() == pytest.approx(0.6**count, abs=0.02)
        assert middle.std() < noise
