"""Real files: what an export shows, and where, is what Blender's own expansion shows."""

from __future__ import annotations

import os
from pathlib import Path

import bpy
import placements
import pytest

from blender_addon import sync
from pointmr_engine.scene import group as groups

FOLDER = os.environ.get("POINTMR_SCENES", "")
FILES = sorted(Path(FOLDER).glob("*/*.blend")) if FOLDER else []
MAX_PLACEMENTS = 2000  # above this, only the numbers are compared


@pytest.mark.skipif(not FOLDER, reason="POINTMR_SCENES does not name a folder of third-party scenes")
@pytest.mark.parametrize("path", FILES or [None], ids=[p.stem for p in FILES] or ["none"])
def test_export_agrees_with_blender(path):
    bpy.ops.wm.open_mainfile(filepath=str(path))

    def action(depsgraph):
        said = []
        result = sync.export(depsgraph, report=lambda level, text: said.append((level, text)))
        return result, said, placements.by_blender(depsgraph)

    result, said, theirs = placements.with_depsgraph(action)
    assert not [text for level, text in said if level == "ERROR" and "camera" not in text]
    result.validate()
    _, instanced, _ = groups.count_triangles(result.root)
    assert instanced == sum(s.triangles for s in theirs)
    if len(theirs) <= MAX_PLACEMENTS:
        assert placements.differences(placements.by_engine(result.root), theirs) == ""
