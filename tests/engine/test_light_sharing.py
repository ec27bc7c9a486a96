"""Fragments that share what the world sends them: means where it is the same, nothing where it is not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine.multires.light_sharing import (
    REACH,
    TURN_OF_WORLD,
    allocate_shares,
    share_light,
)

SUBPIXELS = 8


def shares_of(side, rng, spacing=0.1):
    """Fragments on a plane, four a pixel, side x side pixels, their places in the image, and nothing near."""
    n = 4 * side * side
    shares = allocate_shares(n)
    y, x = np.divmod(np.arange(n), 2 * side)
    shares.position[:] = np.stack([x * spacing, y * spacing, np.zeros(n)], 1)
    shares.normal[:] = (0, 0, 1)
    shares.albedo[:] = rng.uniform(0.1, 0.9, (n, 3))
    shares.rays[:] = 2
    shares.nearness[:] = 0
    shares.worth[:] = shares.width[:] = 1
    shares.light[:] = shares.albedo
    places = ((a + 0.5) * SUBPIXELS / 2 for a in (x, y))
    return shares, *(a.astype(np.float32) for a in places)


def shared(shares, x, y, side, turn=TURN_OF_WORLD):
    out = np.zeros((len(x), 3), np.float32)
    share_light(x, y, SUBPIXELS, REACH * SUBPIXELS, turn, shares, len(x), (side, side), out)
    return out


@settings(deadline=None)
@given(st.integers(0, 1000))
def test_even_light_stays_what_it_is_whatever_the_colours(seed):
    shares, x, y = shares_of(6, np.random.default_rng(seed))
    np.testing.assert_allclose(shared(shares, x, y, 6), shares.albedo, rtol=1e-5)


def test_noise_falls_in_the_open():
    rng = np.random.default_rng(3)
    shares, x, y = shares_of(16, rng)
    shares.light[:] *= rng.uniform(0.0, 2.0, (len(x), 1))
    before = (shares.light / shares.albedo).var()
    after = (shared(shares, x, y, 16) / shares.albedo).var()
    assert after < before / 20  # 81 fragments lie within reach, fewer at the tile's edge


def test_what_is_near_keeps_light_apart():
    rng = np.random.default_rng(4)
    shares, x, y = shares_of(8, rng)
    shares.light[:] *= rng.uniform(0.0, 2.0, (len(x), 1))
    shares.nearness[:] = shares.rays * 100.0  # something a centimetre off, fragments ten apart
    np.testing.assert_allclose(shared(shares, x, y, 8), shares.light, rtol=1e-6)


def test_other_sides_of_an_edge_do_not_share():
    shares, x, y = shares_of(8, np.random.default_rng(5))
    right = x > 4 * SUBPIXELS
    shares.normal[right] = (1, 0, 0)
    shares.light[right] = 0
    result = shared(shares, x, y, 8)
    assert (result[right] == 0).all()
    np.testing.assert_allclose(result[~right], shares.albedo[~right], rtol=1e-5)


def test_channels_that_a_neighbour_does_not_reflect_are_left_to_the_others():
    shares, x, y = shares_of(4, np.random.default_rng(6))
    shares.albedo[::2, 1] = 0
    shares.light[:] = shares.albedo
    np.testing.assert_allclose(shared(shares, x, y, 4), shares.albedo, rtol=1e-5)


@pytest.mark.parametrize("place", [-30.0, 500.0])
def test_places_beyond_the_tile_are_kept(place):
    shares, x, y = shares_of(4, np.random.default_rng(7))
    x[5] = place
    np.testing.assert_allclose(shared(shares, x, y, 4), shares.albedo, rtol=1e-5)
