"""Textures behind what passes little light are seen at points, whose noise weighs less than means would cost."""

import numpy as np
import pytest

from pointmr_engine import Group, Material, Scene, uniform_world
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
