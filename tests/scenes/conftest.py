"""Workers that keep a renderer's process alive from scene to scene."""

from __future__ import annotations

import contextlib

import pytest

pytest.importorskip("bpy", reason="the Blender wheel (bpy) is not installed")

from benchmarks.overlay import Keeper


@pytest.fixture(scope="session")
def keepers(tmp_path_factory):
    """A process for Cycles and one for PointMR, started when first asked for."""
    folder = tmp_path_factory.mktemp("workers")
    with contextlib.ExitStack() as stack:
        found = {name: Keeper(folder / f"{name}.log") for name in ("cycles", "method")}
        for keeper in found.values():
            stack.callback(keeper.close)
        yield found
