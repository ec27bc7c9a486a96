"""PointMR in a real Blender with its window: the engine's menu, panels, F12, Esc, viewport, preview.

Run with POINTMR_GUI_BLENDER set (see blender_window.py): `POINTMR_GUI_BLENDER=/opt/blender/blender pytest tests/gui`.
"""

from __future__ import annotations

import numpy as np
import pytest
from blender_window import run_session


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """A folder per session, seen by Blender under the same path."""
    base = tmp_path_factory.mktemp("gui")

    def make(name: str):
        folder = base / name
        folder.mkdir()
        return folder

    return make


def test_final_render_and_escape(shared):
    folder = shared("final_render")
    session = run_session("final_render", folder, timeout=600)  # the first session may compile all kernels
    assert session.alarms() == []
    image = pytest.importorskip("PIL.Image")
    pixels = np.asarray(image.open(folder / "f12_result.png").convert("RGB")).astype(int)
    assert pixels.shape == (320, 480, 3)
    middle = pixels[160, 230:250].mean(0)
    assert middle[0] > 2 * middle[1] and middle[0] > 2 * middle[2], "the cube in the middle is red"
    assert session.values["progress"] == {"init": 2, "complete": 1, "cancel": 1}
    assert session.values["seconds_to_cancel"] < 3  # a software-drawn window on a shared machine


def test_engine_is_chosen_in_the_menu(shared):
    session = run_session("engine_menu", shared("engine_menu"))
    assert session.values["engine"] == "POINTMR"
    assert session.alarms() == []


def test_click_in_the_panel_changes_the_method(shared):
    session = run_session("panel_click", shared("panel_click"))
    assert session.values["methods"] == ["DISTRIBUTED", "CONVENTIONAL"]
    assert session.alarms() == []


def test_material_preview_is_rendered(shared):
    session = run_session("preview", shared("preview"), timeout=300)
    assert all(is_preview for is_preview, *_ in session.values["previews"])
    assert max(width for _, width, *_ in session.values["previews"]) > 100, "the open panel's, not only icons"
    assert session.values["changed"]
    assert session.alarms() == []


def test_rendered_viewport(shared):
    session = run_session("viewport", shared("viewport"), timeout=400)
    v = session.values
    assert session.alarms() == []
    assert np.abs(np.subtract(v["rendered_middle"], v["solid_middle"])).max() < 4, "where solid mode has it"
    assert abs(v["red"] / v["solid_red"] - 1) < 0.1
    assert v["changed_by_orbit"] > 0.2
    assert v["red_when_larger"] > 2 * v["red"]
    assert v["red_through_camera"] > 0.01 and v["red_orthographic"] > 0.01
    assert v["longest_pause_in_orbit"] < 2, "the window hung while the viewport rendered"
    assert v["rendered_beside_viewport"]
