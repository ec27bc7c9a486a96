"""Glossy surfaces seen by way of rough ones are made rougher, so that light samples find what lights by way of them.

Beside Cycles: tests/addon/test_filter_glossy_cycles.py.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenes import from_above, quad

from benchmarks.forward.scenes import look
from pointmr_engine import Group, Light, Scene, principled
from pointmr_engine.shading.bsdf.layout import ALPHA_X, ALPHA_Y, HAS_EVALUATION, SINGULAR_LOBE
from pointmr_engine.shading.bsdf.widening import filter_glossy
from pointmr_engine.shading.leaves import DIFFUSE, GLOSSY, Leaf
from pointmr_engine.shading.lobes import View, allocate, append, load_tables, reset
from tests.engine.test_raytrace_light import DARK, card, image


@given(
    st.floats(0, 1, width=32), st.one_of(st.just(math.inf), st.floats(0, 100, width=32)), st.floats(0.01, 10)
)
def test_lobes_are_at_least_as_rough_as_paths_to_them_ask(roughness, density, most):
    """Those of matt surfaces stay, and all behind directions that are certain enough."""
    up = np.tile(np.array([[0, 0, 1]], np.float32), (2, 1))
    view = View(up, up, up, np.zeros(2, np.bool_), np.zeros(2, np.bool_))
    out = allocate(2, 2)
    reset(out, view)
    append(out, Leaf(DIFFUSE, np.array([(1, 1, 1, 0)], np.float32)), np.arange(2), view, load_tables())
    glossy = np.array([(1, 1, 1, roughness, 0, 0, 0, 0, 0)], np.float32)
    append(out, Leaf(GLOSSY, glossy), np.arange(2), view, load_tables())
    data, kind = out.data.copy(), out.kind.copy()
    filter_glossy(out, np.array([1]), np.array([density], np.float32), most)
    assert (out.data[0] == data[0]).all() and (out.kind[0] == kind[0]).all()  # not asked for
    assert (out.data[1, 0] == data[1, 0]).all() and out.kind[1, 0] == kind[1, 0]
    least = 0.5 * math.sqrt(max(1.0 - float(np.float32(density)) / most, 0.0))
    expected = max(float(data[1, 1, ALPHA_X]), least)
    assert out.data[1, 1, ALPHA_X] == out.data[1, 1, ALPHA_Y] == pytest.approx(expected, rel=1e-6)
    if least > 0.01:
        assert not out.kind[1, 1] & SINGULAR_LOBE and out.flags[1] & HAS_EVALUATION


def corner() -> Scene:
    """A matt floor seen from above, in the light that a mirror on edge beside it throws there, of a sun that is a
    point."""
    matt = principled("floor", base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0)
    mirror = principled("mirror", base_color=(0.9, 0.9, 0.9), metallic=1.0, roughness=0.0)
    wall = card("wall", [(1, -1, 0), (1, -1, 2), (1, 1, 2), (1, 1, 0)], mirror)
    sun = Light("SUN", look((-3, 0, 2), (0, 0, 0)), power=3.0, angle=0.0)
    return Scene(Group("root", [quad(2.0, material=matt), wall]), from_above(6.0), [sun], DARK)


@pytest.mark.parametrize("method", ["distributed", "raytrace"])
def test_mirrors_light_matt_surfaces_by_lamps_without_extent(method):
    """No path meets such a lamp in a mirror, and without a filter no light sample finds it there."""
    kept = {"method": method, "samples": 256, "size": (16, 16)}
    direct, plain = image(corner(), **kept), image(corner(), diffuse_bounces=1, **kept)
    filtered = image(corner(), diffuse_bounces=1, filter_glossy=1.0, **kept)
    # what the wall is a mirror of, the sun apart, is the floor
    assert plain.mean() == pytest.approx(direct.mean(), rel=0.15)
    assert filtered.mean() > 1.2 * plain.mean()


def test_methods_agree():
    kept = {"diffuse_bounces": 1, "filter_glossy": 1.0, "size": (16, 16)}
    exact = image(corner(), method="distributed", samples=1024, **kept)
    ours = image(corner(), method="raytrace", cones=16, **kept)
    assert ours.mean() == pytest.approx(exact.mean(), rel=0.01)
    assert np.sqrt(((ours - exact) ** 2).mean()) < 0.05 * exact.mean()


@pytest.mark.parametrize("method", ["distributed", "raytrace"])
def test_what_is_seen_without_rough_surfaces_is_as_it_was(method):
    """Where diffuse light does not bounce and mirrors are sharp, no lobe is made rougher."""
    kept = {"method": method, "samples": 4, "size": (16, 16)}
    assert np.array_equal(image(corner(), **kept), image(corner(), filter_glossy=10.0, **kept))
