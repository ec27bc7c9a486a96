"""Transparency and emission that go by where a part is placed, or by what its instance says, against random rays."""

import numpy as np
import pytest

from benchmarks.forward.scenes import look
from pointmr_engine import Group, Light, Material, Scene, principled, uniform_world
from pointmr_engine.forward.drawing.part_opacity import MOST_PLACEMENTS
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import instance
from tests.engine.small_scenes import at, from_above, quad
from tests.engine.test_raytrace_light import DARK, image

GREY = principled(base_color=(0.6, 0.6, 0.6), specular_ior_level=0.0)
SKY = uniform_world((0.3, 0.4, 0.6))
SUN = Light("SUN", look((1, 0, 3), (0, 0, 0)), power=2.0, angle=0.0)
ABOVE_0 = {"operation": "GREATER_THAN"}
# what tells the three placements apart: nodes, of which "by" has the value
TOLD = {
    "random": {"by": Node("object_info")},
    "alpha": {"by": Node("object_info")},
    "value": {
        "info": Node("object_info"),
        "by": Node("math", {"value": Link("info", "object_index"), "value_b": 0.3}, {"operation": "MULTIPLY"}),
    },
    "place": {
        "place": Node("geometry"),
        "axes": Node("separate_xyz", {"vector": Link("place", "position")}),
        "by": Node("math", {"value": Link("axes", "x"), "value_b": 0.1}, ABOVE_0),
    },
}  # fmt: skip


def told(name: str, shown: str) -> Material:
    """Red and as opaque as told, or shining as much."""
    nodes = dict(TOLD[name])
    value = Link("by", "value" if name == "place" else name)
    if shown == "emission":
        nodes["bsdf"] = Node("emission", {"color": (0.9, 0.3, 0.1), "strength": value})
        return Material("told", Graph(nodes, surface=Link("bsdf", "emission")))
    nodes["bsdf"] = Node(
        "principled", {"base_color": (0.8, 0.1, 0.1), "alpha": value, "specular_ior_level": 0.0}
    )
    return Material("told", Graph(nodes, surface=Link("bsdf", "bsdf")))


def scene(material: Material, lamps, world, count: int = 3) -> Scene:
    """A floor and cards of one mesh above it, each of its own seed, index and colour."""
    card, cards = Group("card", [quad(0.9, material=material)]), []
    for k in range(count):
        colour = (1.0, 1.0, 1.0, (0.2, 0.6, 1.0)[k % 3])
        place = at(1.2 * (k % 3 - 1), 0.0, 1.0 + 0.01 * (k // 3))
        cards.append(
            instance(
                card, place, seed=int((0.9, 0.5, 0.2)[k % 3] * 2**32), object_index=k % 3 + 1, color=colour
            )
        )
    return Scene(Group("root", [quad(8.0, material=GREY)], cards), from_above(5.0), lamps, world)


@pytest.mark.parametrize("name", TOLD)
def test_each_is_as_clear_as_its_placement_says(name):
    cache, whole = Cache(), scene(told(name, "alpha"), [SUN], SKY)
    exact = image(whole, cache, method="distributed", samples=128)
    ours = image(whole, cache, cones=4)
    assert np.abs(ours - exact).mean() < 0.02 * exact.mean()


def test_more_of_them_than_are_looked_at():
    cache, whole = Cache(), scene(told("random", "alpha"), [SUN], SKY, count=3 * MOST_PLACEMENTS)
    exact = image(whole, cache, method="distributed", samples=128)
    ours = image(whole, cache, cones=4)
    assert np.abs(ours - exact).mean() < 0.03 * exact.mean()


def test_forward_draws_a_single_one_as_it_is_placed():
    """Of several, all are drawn by their mean."""
    whole = scene(told("random", "alpha"), [SUN], DARK, count=1)
    whole.root.meshes.clear()
    cache, card = Cache(), np.s_[15:21, 9:13]
    exact = image(whole, cache, method="distributed", samples=64)[card].mean((0, 1))
    assert exact[0] > 0.1
    np.testing.assert_allclose(image(whole, cache, method="forward")[card].mean((0, 1)), exact, rtol=0.03)


@pytest.mark.parametrize("name", ["random", "alpha", "value", "place"])
def test_each_lights_as_much_as_its_placement_says(name):
    cache, whole = Cache(), scene(told(name, "emission"), [], DARK)
    exact = image(whole, cache, method="distributed", samples=256)
    ours = image(whole, cache, cones=4)
    floor = np.s_[:10, :]
    assert exact[floor].mean() > 0.005
    for side in (np.s_[:10, :16], np.s_[:10, 32:]):
        assert ours[side].mean() == pytest.approx(exact[side].mean(), rel=0.04)
