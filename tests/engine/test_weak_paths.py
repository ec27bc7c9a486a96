"""Of what weighs little: what goes on, textures behind what passes little light, and those of small fragments."""

import numpy as np
import pytest

from pointmr_engine import Group, Material, Mesh, Scene, uniform_world
from pointmr_engine.raytracing import shade
from pointmr_engine.scene.graph import Graph, Link, Node
from tests.engine.small_scenes import from_above, quad
from tests.engine.test_footprint_mean import checkered
from tests.engine.test_raytrace_light import image

SIDE = 0.03  # of a check: a few in a pixel


def behind_red_glass(share: float) -> Scene:
    """Shining checks behind a pane that passes a share of what is red and nothing else."""
    pane = Graph({"t": Node("transparent", {"color": (share, 0.0, 0.0)})}, surface=Link("t", "bsdf"))
    checks = quad(8.0, material=Material("checks", checkered(1.0 / SIDE)))
    world = uniform_world((0.0, 0.0, 0.0))
    root = Group("root", [checks, quad(8.0, 1.0, Material("pane", pane))])
    return Scene(root, from_above(4.0), [], world)


@pytest.mark.parametrize(("share", "averages"), [(0.9, True), (0.3, False)])
def test_only_what_passes_much_light_is_averaged(share, averages, monkeypatch):
    asked = []
    means = shade.footprint_means

    def counted(run, gather, rows, *more):
        asked.append(len(rows))
        return means(run, gather, rows, *more)

    monkeypatch.setattr(shade, "footprint_means", counted)
    seen = image(behind_red_glass(share))[6:-6, 6:-6]
    assert (sum(asked) > 0) == averages
    whole = image(behind_red_glass(1.0))[6:-6, 6:-6]
    assert seen[..., 0].mean() == pytest.approx(share * whole[..., 0].mean(), rel=0.02)
    assert whole[..., 0].mean() > 0.2 and np.abs(seen[..., 1:]).max() < 1e-6


@pytest.mark.parametrize(("share", "even"), [(0.1, True), (0.04, True), (0.025, False)])
def test_what_a_dark_pane_passes_goes_on_but_not_what_a_darker_one_does(share, even):
    """From 0.03 on, what passes a first surface is not left to chance (scatter.WEAK)."""
    scene = behind_red_glass(share)
    shining = Graph({"e": Node("emission", {"strength": 1.0})}, surface=Link("e", "emission"))
    scene.root.meshes[0].materials[0].graph = shining
    seen = image(scene)[6:-6, 6:-6, 0]
    assert seen.mean() == pytest.approx(share, rel=0.05)
    assert (seen.std() < 1e-3 * share) == even


def strips(across: float) -> Scene:
    """Shining checks in strips so wide, by turns at three heights."""
    x = np.arange(-2.0, 2.0, across)
    z = 0.3 * (np.arange(len(x)) % 3)
    sides = ((0, -2), (1, -2), (1, 2), (0, 2))
    corners = [(u + du * across, v, h) for u, h in zip(x, z, strict=True) for du, v in sides]
    triangles = (4 * np.arange(len(x))[:, None, None] + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3)
    checks = Material("checks", checkered(1.0 / SIDE))
    mesh = Mesh("strips", np.array(corners, np.float32), triangles.astype(np.int32), materials=(checks,))
    return Scene(Group("root", [mesh]), from_above(4.0), [], uniform_world((0.0, 0.0, 0.0)))


@pytest.mark.parametrize(("across", "fine"), [(0.004, True), (0.2, False)])  # a pixel is 0.06 wide
def test_fragments_of_a_few_subpixels_are_averaged_over_a_few_places(across, fine, monkeypatch):
    asked = []
    means = shade.footprint_means

    def counted(run, gather, rows, needs, seed, few, *more):
        asked.append(few.mean())
        return means(run, gather, rows, needs, seed, few, *more)

    monkeypatch.setattr(shade, "footprint_means", counted)
    seen = image(strips(across))[6:-6, 6:-6]
    assert np.mean(asked) > 0.9 if fine else np.mean(asked) < 0.4
    monkeypatch.setattr(shade, "footprint_means", lambda *a: means(*a[:5]))
    every = image(strips(across))[6:-6, 6:-6]
    if fine:
        assert (seen != every).any()
    assert seen.mean() == pytest.approx(every.mean(), rel=0.01) and every.mean() > 0.2
