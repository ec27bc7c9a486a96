"""Every node, translated and evaluated, against Cycles' picture of the same node."""

import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
sys.path.insert(0, str(Path(__file__).parent))

import node_planes  # noqa: E402
from node_cases import CASES  # noqa: E402

from blender_addon.sync.materials import MaterialSync  # noqa: E402
from pointmr_engine.shading.program import compile_graph  # noqa: E402


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """name -> (Cycles' pixels, ours), each (n, n, 3); what was reported; name -> values of no points."""
    objects = node_planes.build({name: make for name, (make, _) in CASES.items()})
    picture = node_planes.render(tmp_path_factory.mktemp("nodes") / "cycles.exr")
    reports = []
    sync = MaterialSync(lambda level, message: reports.append((level, message)))
    bpy.context.evaluated_depsgraph_get().update()
    found, empty = {}, {}
    for i, (name, obj) in enumerate(objects.items()):
        program = compile_graph(sync.get(obj.data.materials[0]).surface_graph)
        points = node_planes.points_of(obj)
        ours = program.emission(points).reshape(node_planes.WINDOW, node_planes.WINDOW, 3)
        empty[name] = program.emission(points.repeated(0))
        found[name] = (node_planes.window(picture, i, len(objects)), ours)
    return found, reports, empty


@pytest.mark.parametrize("name", CASES)
def test_node_matches_cycles(pictures, name):
    theirs, ours = pictures[0][name]
    difference = np.abs(theirs - ours).max(-1)
    # patterns have edges: a pixel on one may fall to either side of it
    share = (difference > CASES[name][1]).mean()
    assert share < 0.02, f"{share:.0%} of the pixels differ, by up to {difference.max():.2g}"


def test_no_points_have_no_values(pictures):
    assert {values.shape for values in pictures[2].values()} == {(0, 3)}


def test_nothing_is_reported(pictures):
    assert pictures[1] == []
