"""Settings say by name what no render could honour."""

from __future__ import annotations

import math

import pytest

from pointmr_engine import ForwardSettings, RaytraceSettings, RenderSettings, SceneError


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("sampling", ["static", "dynamic"], ["", "Static", None]),
        ("draws", ["random", "stratified"], ["sobol"]),
        ("strategy", ["random", "jittered_grid", "quantised_grid", "neighbourhood"], ["grid"]),
        ("reconstruction", ["pixel", "gaussian", "subpixel", "analytic"], ["box"]),
        ("shading", ["simple", "full"], ["none"]),
        ("subpixels", [2, 4, 8], [0, 1, 5, 16]),
        ("samples_per_pixel", [0.05, 1.0, 64.0], [0.0, 0.049, 64.1, -1.0, math.nan, math.inf]),
        ("epsilon", [1e-3, 0.5, 8.0], [0.0, -0.5, math.nan, math.inf]),
        ("failure", [1e-9, 0.5], [0.0, 1.0, -0.1, math.nan]),
        ("shadows", [True, False], ["no", None]),
        ("backface_culling", [True, False], ["no", None]),
        ("occlusion_culling", [True, False], ["no", None]),
        ("cache_folder", [None, "sets"], ["", 3]),
    ],
)
def test_forward_settings(name, good, bad):
    for value in good:
        RenderSettings(method="forward", forward=ForwardSettings(**{name: value})).validate()
    for value in bad:
        with pytest.raises(SceneError, match=f"forward.{name} "):
            RenderSettings(method="forward", forward=ForwardSettings(**{name: value})).validate()


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("cones", [1, 4, 16, 64], [0, 2, 32, 256, -1, "4", None]),
        ("footprint", [0.25, 1.0, 4.0], [0.0, 0.249, 4.01, -1.0, math.nan, math.inf]),
        ("secondary", ["cones", "rays"], ["", "Cones", "ray", None]),
        ("visibility", ["masks", "alpha"], ["", "Masks", "mask", None]),
        ("cache_folder", [None, "sets"], ["", 3]),
    ],
)
def test_raytrace_settings(name, good, bad):
    for value in good:
        RenderSettings(method="raytrace", raytrace=RaytraceSettings(**{name: value})).validate()
    for value in bad:
        with pytest.raises(SceneError, match=f"raytrace.{name} "):
            RenderSettings(method="raytrace", raytrace=RaytraceSettings(**{name: value})).validate()


def test_filter_glossy():
    for value in (0.0, 1.0, 10.0):
        RenderSettings(filter_glossy=value).validate()
    for value in (-0.5, math.nan, math.inf):
        with pytest.raises(SceneError, match="filter glossy"):
            RenderSettings(filter_glossy=value).validate()


def test_settings_do_not_share_their_parts():
    RenderSettings().forward.samples_per_pixel = 4.0
    assert RenderSettings().forward.samples_per_pixel == 1.0
    RenderSettings().raytrace.cones = 4
    assert RenderSettings().raytrace.cones == 1
