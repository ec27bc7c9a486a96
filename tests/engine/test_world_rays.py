"""How often fragments ask the world: by what their neighbours met, and never by what they or their pixel met."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine.multires.sharing.light_shares import allocate_shares
from pointmr_engine.multires.sharing.light_sharing import OF_WORLD
from pointmr_engine.multires.sharing.world_rays import (
    MOST,
    MOST_PEERS,
    PEER_SUMS,
    SUMS,
    WORTH,
    count_peers,
    first_rays,
    split_repeats,
    wanted_rays,
)

SIDE, WHOLE = 5, 64.0


def ask(pixel, opened, arrived, others, subpixels, peers=1.0):
    """What wanted_rays says of fragments, after the rays they begin with."""
    n = len(pixel)
    asked = np.zeros(n, np.int64)
    subpixels = np.asarray(subpixels, np.int32)
    first_rays(subpixels, WHOLE, n, asked)
    before = asked.copy()
    wanted_rays(
        np.asarray(pixel, np.int64), np.asarray(opened, float), np.asarray(arrived, float),
        np.asarray(others, float), subpixels, WHOLE, WORTH, np.full(n, peers), n,
        np.empty((SIDE, SIDE, SUMS)), asked,
    )  # fmt: skip
    return before, asked


def field(share, others=0.0):
    """One fragment a pixel, of whose world alternately more and less arrives: `share` on average."""
    n = SIDE * SIDE
    arrived = np.clip(share + 0.01 * (-1.0) ** np.arange(n), 0.0, 1.0)
    return np.arange(n), np.ones(n), arrived, np.full(n, others), np.full(n, 64)


def test_where_every_ray_escapes_or_none_does_fewer_are_worth_it_than_where_half_do():
    middle = SIDE * SIDE // 2
    pixel, opened, half, others, subpixels = field(0.5, others=1.0)
    open_, closed, half = (
        ask(pixel, opened, arrived, others, subpixels)[1][middle] for arrived in (opened, 0.0 * opened, half)
    )
    assert max(open_, closed) < half == MOST


def test_where_other_light_outshines_the_world_few_rays_are_worth_it():
    _, dark = ask(*field(0.5))
    _, bright = ask(*field(0.5, others=50.0))
    assert (bright <= 2).all() and (dark > bright).all()


def test_small_fragments_are_worth_less():
    pixel, opened, arrived, others, subpixels = field(0.9)
    _, whole = ask(pixel, opened, arrived, others, subpixels)
    _, part = ask(pixel, opened, arrived, others, subpixels // 16)
    assert (part < whole).all() and (part >= 1).all()


def test_the_more_share_what_arrives_the_fewer_rays_each_is_worth():
    alone, among_many = (ask(*field(0.98), peers=n)[1] for n in (1.0, 25.0))
    assert (among_many < alone).all()


def peers(near=0.0, angle=0.0, side=1.0, albedo=0.5):
    """What count_peers says of the middle of a plane, one fragment a pixel, pixels 0.1 m wide.

    near: of what rays met, 1 / metres; angle: radians that normals turn from pixel to pixel.
    """
    n, shares = SIDE * SIDE, allocate_shares(SIDE * SIDE)
    x = np.arange(n) % SIDE * angle
    shares.normal[:] = np.stack([np.sin(x), 0 * x, np.cos(x)], 1)
    shares.albedo[:], shares.rays[:], shares.nearness[:], shares.width[:] = albedo, 2, 2 * near, 1
    out = np.empty(n)
    count_peers(
        np.arange(n),
        shares,
        0,
        np.full(n, 0.1),
        side,
        OF_WORLD.turn,
        n,
        np.empty((SIDE, SIDE, PEER_SUMS)),
        out,
    )
    return out[n // 2]


def test_what_is_open_and_even_has_peers_and_what_is_near_or_bent_has_none():
    assert peers() == pytest.approx(MOST_PEERS)
    assert MOST_PEERS > peers(near=1.5) > peers(near=5.0) > peers(near=100.0)
    assert peers(near=100.0) == pytest.approx(1.0, abs=0.01)
    assert peers() > peers(angle=0.1) > peers(angle=0.5)
    assert peers(albedo=0.0) == 1.0  # has nothing to share


def test_normals_of_narrower_cones_turn_less():
    assert peers(angle=0.1, side=2.0) > 2.0 * peers(angle=0.1)


@given(st.data())
def test_own_rays_and_those_of_the_pixel_do_not_decide(data):
    n = data.draw(st.integers(2, 40))
    draw = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    pixel = draw.integers(0, SIDE * SIDE, n)
    opened, share, others = draw.uniform(0, 2, n), draw.uniform(0, 1, n), draw.uniform(0, 2, n)
    subpixels = draw.integers(1, 65, n)
    before, asked = ask(pixel, opened, opened * share, others, subpixels)
    assert (asked >= before).all() and (asked <= MOST).all()
    mine = pixel == pixel[0]
    changed = np.where(mine, draw.uniform(0, 1, n), share)
    # some rays may have left below the surface
    opened = np.where(mine, opened * draw.integers(0, 2, n), opened)
    _, again = ask(pixel, opened, opened * changed, others, subpixels)
    assert (again[mine] == asked[mine]).all()


@given(st.lists(st.integers(0, 16), max_size=60), st.integers(16, 50))
def test_parts_hold_every_row_once_and_fit(times, room):
    times = np.array(times, np.int64)
    parts = split_repeats(times, room)
    rows = [k for p in parts for k in range(p.start, p.stop)]
    assert rows == list(range(len(times)))
    assert all(times[p].sum() <= room for p in parts)


def test_a_row_that_does_not_fit_is_refused_before_anything_is_lost():
    with pytest.raises(ValueError, match="room"):
        split_repeats(np.array([3, 40]), 16)
