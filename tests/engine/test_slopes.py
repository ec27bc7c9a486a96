"""Slopes of light across fragments: exact where light is even or linear, and nothing made up at edges."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine.forward.drawing.subpixels import View
from pointmr_engine.forward.reconstruction.pixel_filter import (
    NO_SLOPES,
    allocate_slopes,
    filter_taps,
    filter_tile,
)
from pointmr_engine.multires.fragments.slopes import COLUMNS, ROOM, find_slopes
from pointmr_engine.multires.fragments.texture_slopes import slopes_in_image, take_texture_slopes
from pointmr_engine.shading.footprint_slopes import allocate_texture_slopes
from tests.engine.test_raytrace_parts import fragments

CELL, SIDE = 4, 6  # subpixels of a fragment, fragments a side
N = SIDE * SIDE


def grid(**values):
    """SIDE x SIDE fragments of one plane, and the subpixels that show them."""
    f = fragments(N, **values)
    j, i = np.divmod(np.arange(N), SIDE)
    f.x[:], f.y[:] = CELL * (i + 0.5), CELL * (j + 0.5)
    ids = np.arange(N, dtype=np.int32).reshape(SIDE, SIDE).repeat(CELL, 0).repeat(CELL, 1)
    return f, ids


def slopes_of(f, ids, light):
    out, n = allocate_slopes(len(light)), np.int64(len(light))
    size = (np.int64(a) for a in (*ids.shape[::-1], CELL))
    light = np.asarray(light, np.float32)
    find_slopes(ids, *size, False, np.float64(1.0), f, light, n, np.empty((n, COLUMNS), np.float32), out)
    return out


def by_place(f, gx, gy):
    return np.repeat((1.0 + gx * f.x + gy * f.y)[:, None], 3, 1)


@given(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
def test_linear_light_has_its_slope(gx, gy):
    f, ids = grid()
    found = slopes_of(f, ids, by_place(f, gx, gy))
    inner = np.pad(np.ones((SIDE - 2, SIDE - 2), bool), 1).ravel()
    for values, slope in ((found.x, gx), (found.y, gy)):
        np.testing.assert_allclose(values[inner], slope, rtol=0.02, atol=1e-5)


@given(st.integers(0, 1000))
def test_no_place_is_much_brighter_or_darker_than_what_is_about_it(seed):
    rng = np.random.default_rng(seed)
    f, ids = grid()
    light = rng.exponential(1.0, (N, 3)) ** 3
    found = slopes_of(f, ids, light)
    corner = 0.5 * CELL * (abs(found.x) + abs(found.y))
    cells = light.reshape(SIDE, SIDE, 3)
    for j in range(SIDE):
        for i in range(SIDE):
            about = [
                cells[q, p]
                for q, p in ((j - 1, i), (j + 1, i), (j, i - 1), (j, i + 1))
                if 0 <= q < SIDE and 0 <= p < SIDE
            ]
            own = cells[j, i]
            room = ROOM * np.minimum(
                np.maximum(np.max(about, 0) - own, 0), np.maximum(own - np.min(about, 0), 0)
            )
            assert (corner[j * SIDE + i] <= room * 1.001 + 1e-5).all()  # none at all at a peak
    assert (corner <= light * 1.001 + 1e-5).all()  # nor darker than black


@pytest.mark.parametrize(
    "values",
    [
        {"part": np.arange(N) % SIDE // 3},
        {"geometric": np.where((np.arange(N) % SIDE < 3)[:, None], (0, 0, -1), (0, -0.8, -0.6))},
        {"position": np.where((np.arange(N) % SIDE < 3)[:, None], (0, 0, 2.0), (0, 0, 9.0))},
        {"normal": np.full((N, 3), (0, 0, -0.5))},  # clumps: what one place of each was met by
    ],
    ids=["another mesh", "an edge", "behind", "clumps"],
)
def test_light_of_other_surfaces_says_nothing(values):
    f, ids = grid(**values)
    light = np.where((np.arange(N) % SIDE < 3)[:, None], 1.0, 5.0) * np.ones((N, 3))
    found = slopes_of(f, ids, light)
    assert not found.x.any() and not found.y.any()


def filtered(f, ids, light, slopes, subpixels):
    """(pixels, pixels) red of pixels of so many subpixels a side, under a box."""
    pixels, taps = ids.shape[0] // subpixels, filter_taps("box", 1.0, subpixels)
    out = np.empty((pixels, pixels, 4), np.float32)
    size = (np.int64(a) for a in (*ids.shape, subpixels))
    nothing = np.zeros((pixels, pixels, 4), np.float32)
    sums, line = np.empty((pixels, 4 * ids.shape[1]), np.float32), np.empty((ids.shape[1], 4), np.float32)
    filter_tile(ids, *size, light, nothing, taps, sums, line, out, f, slopes)
    return out[..., 0]


@given(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
def test_the_filter_keeps_the_mean_and_shows_linear_light_as_it_is(gx, gy):
    f, ids = grid()
    light = by_place(f, gx, gy).astype(np.float32)
    slopes = slopes_of(f, ids, light)
    whole = [filtered(f, ids, light, s, 2 * CELL) for s in (slopes, NO_SLOPES)]
    np.testing.assert_allclose(whole[0], whole[1], atol=1e-5)  # whole cells under a box: slopes cancel
    half = filtered(f, ids, light, slopes, CELL // 2)
    at = (np.arange(len(half)) + 0.5) * (CELL // 2)
    exact = 1.0 + gx * at + gy * at[:, None]
    inner = np.s_[2:-2, 2:-2]  # without the cells at the border, which lack neighbours on one side
    np.testing.assert_allclose(
        half[inner], exact[inner], atol=0.025 * (abs(gx) + abs(gy)) + 1e-5
    )  # 1 without


def in_image(perspective: bool, sides, change, depth=5.0):
    """Slopes of the texture of one fragment aside of the view axis, of light 1."""
    f = fragments(1)
    f.position[0] = 0.4 * depth, -0.2 * depth, depth
    scale = 8.0 * (depth if perspective else 1.0)  # subpixels per metre there: 8
    view = View(perspective, scale, -scale, 0.0, 0.0, 0.1, 100.0, 0.0, 1.0)
    textures, out = allocate_texture_slopes(1), allocate_slopes(1)
    textures.known[0] = True
    textures.sides[:, 0], textures.change[:, 0] = sides, np.asarray(change, np.float32)[:, None]
    slopes_in_image(view, np.eye(4)[:3], f, np.int64(0), textures, np.float64(CELL), np.int64(1), out)
    return out


@pytest.mark.parametrize("perspective", [False, True])
@given(st.floats(-0.6, 0.6), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(0.0, 6.0))
def test_slopes_of_textures_are_those_that_the_image_shows(perspective, gx, gy, lean, turn):
    """Of light that rises by gx and gy per cell, on a plane that leans; the footprint's sides are turned anyhow."""
    depth, width = 5.0, 0.5  # of a cell: 4 subpixels
    c, s = np.cos(turn), np.sin(turn)
    sides = np.array([[c, s, 0.0], [-s, c, 0.0]]) * width
    sides[:, 2] = lean * sides[:, 0]
    x, y = sides[:, 0].copy(), sides[:, 1].copy()
    if perspective:  # what moves away moves towards the middle, too
        x, y = x - 0.4 * sides[:, 2], y + 0.2 * sides[:, 2]
    found = in_image(perspective, sides, (gx * x - gy * y) / width, depth)
    np.testing.assert_allclose(found.x[0], gx / CELL, atol=1e-5)
    np.testing.assert_allclose(found.y[0], gy / CELL, atol=1e-5)


def test_nothing_is_known_beyond_a_footprint():
    """Cards with holes are looked at through a part of their cell: a plane of that would go astray in the rest."""
    sides = np.array([[0.5, 0.0, 0.0], [0.0, 0.5, 0.0]])
    assert np.isfinite(in_image(False, sides, (0.1, 0.1)).x[0]).all()
    assert np.isnan(in_image(False, 0.6 * sides, (0.1, 0.1)).x[0, 0])
    light = np.ones((1, 3), np.float32)
    kept = allocate_slopes(1)
    kept.x[:], kept.y[:] = 7.0, 7.0
    take_texture_slopes(in_image(False, 0.6 * sides, (0.1, 0.1)), light, np.int64(1), kept)
    assert (kept.x == 7.0).all() and (kept.y == 7.0).all()
