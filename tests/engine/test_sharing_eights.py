"""Eights of fragments that share light: nobody is lost, and all that is near enough is heard, as one by one."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine.multires.sharing.sharing_eights import allocate_eights, gather_eights, receive
from pointmr_engine.multires.sharing.sharing_lanes import (
    ANGLE,
    ARRIVED,
    AT_X,
    AT_Y,
    BOUNDED,
    COLUMNS,
    FACING,
    HEARD,
    NEARNESS,
    PLACE,
    SUM_ARRIVED,
    SUM_FACING,
    SUM_HEARD,
    SUM_TURNED,
    SUMS,
    TURNED,
)

F = np.float32


def table_of(rng, lines, columns, most, extent, bend):
    """(table, begin) of fragments at random: up to `most` a cone, normals that differ by `bend`."""
    counts = rng.integers(0, most + 1, (lines, columns))
    begin = np.zeros((lines, columns + 1), np.int32)
    begin.ravel()[:] = np.concatenate([[0], np.cumsum(np.pad(counts, ((0, 0), (0, 1))).ravel())[:-1]])
    n = counts.sum()
    table = rng.uniform(0.0, 1.0, (COLUMNS, n)).astype(F)
    table[AT_Y], table[AT_X] = np.repeat(np.indices(counts.shape).reshape(2, -1), counts.ravel(), 1)
    table[NEARNESS] *= rng.choice([0.0, 0.1, 1.0], n)
    table[PLACE : PLACE + 3] = extent * rng.normal(size=(3, n))
    normal = np.array([[0.0], [0.0], [1.0]]) + bend * rng.normal(size=(3, n))
    table[FACING : FACING + 3] = normal / np.linalg.norm(normal, axis=0)
    return table, begin


def one_by_one(table, reach, turn, error):
    """What each receives, by the definition, float64."""
    t = table.astype(np.float64)
    place, facing = t[PLACE : PLACE + 3].T, t[FACING : FACING + 3].T
    near = np.maximum(t[NEARNESS][:, None], t[NEARNESS][None])
    change = np.linalg.norm(place[:, None] - place[None], axis=2) * near
    change += turn * np.sqrt(np.maximum(1.0 - facing @ facing.T, 0.0)) + abs(
        t[ANGLE][:, None] - t[ANGLE][None]
    )
    apart = sum((t[c][:, None] - t[c][None]) ** 2 for c in (AT_X, AT_Y)) / (reach + 1.0) ** 2
    narrow = 1.0 / np.maximum(error * t[ANGLE], 1e-12)
    weight = np.maximum(1.0 - change * narrow[:, None], 0.0) * np.maximum(1.0 - apart, 0.0)
    np.fill_diagonal(weight, 1.0)
    out = np.empty((SUMS, len(place)))
    for to, source in ((SUM_HEARD, HEARD), (SUM_ARRIVED, ARRIVED), (SUM_TURNED, TURNED)):
        out[to : to + 3] = t[source : source + 3] @ weight.T
    out[SUM_FACING : SUM_FACING + 3] = (t[HEARD : HEARD + 3].sum(0) * facing.T) @ weight.T
    return out


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 14),
    st.integers(1, 14),
    st.integers(0, 12),
    st.sampled_from([0.0, 0.3, 3.0]),
    st.sampled_from([0.0, 0.05, 1.0]),
    st.integers(1, 5),
)
def test_all_receive_what_they_would_one_by_one(seed, lines, columns, most, extent, bend, reach):
    table, begin = table_of(np.random.default_rng(seed), lines, columns, most, extent, bend)
    received = np.full((SUMS, table.shape[1]), np.nan, F)
    receive(table, begin, reach, F(2.0), F(0.5), received)
    wanted = one_by_one(table, reach, 2.0, 0.5)
    # a cosine of 1 is off by 1e-7, of which the root is 3e-4
    np.testing.assert_allclose(received, wanted, rtol=5e-3, atol=1e-3 * (1 + abs(wanted).max(initial=0)))


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(0, 30), st.integers(1, 6))
def test_eights_hold_every_row_once_within_their_bounds(seed, lines, most, side):
    table, begin = table_of(np.random.default_rng(seed), lines, 7, most, 1.0, 0.3)
    n = table.shape[1]
    across, down = -(-7 // side), -(-lines // side)
    eights = allocate_eights(n, across * down)
    work = np.empty((2, n), np.int32)
    gather_eights(table, begin, np.int64(side), F(1.4), F(0.1), *work, eights)
    count = eights.block[-1]
    rows = eights.row[:count]
    assert sorted(rows[rows >= 0]) == list(range(n))
    assert count <= len(eights.row) and (rows[:, 0] >= 0).all()
    bounds = eights.bounds.reshape(-1, 2, BOUNDED, 8).transpose(0, 3, 1, 2).reshape(-1, 2, BOUNDED)
    for number, members in enumerate(rows):
        values = table[:BOUNDED, members[members >= 0]]
        np.testing.assert_array_equal(bounds[number], [values.min(1), values.max(1)])
    for b in range(across * down):
        y, x = b // across, b % across
        own = rows[eights.block[b] : eights.block[b + 1]].ravel()
        own = own[own >= 0]
        assert (table[AT_X, own] // side == x).all() and (table[AT_Y, own] // side == y).all()


def test_what_is_alike_shares_an_eight():
    """Two surfaces behind each other: no eight is of both but where one of them ends."""
    rng = np.random.default_rng(5)
    table, begin = table_of(rng, 4, 4, 10, 0.01, 0.01)
    n = table.shape[1]
    far = rng.uniform(size=n) < 0.5
    table[PLACE + 2] += 100.0 * far
    table[NEARNESS] = 1.0
    eights = allocate_eights(n, 1)
    gather_eights(table, begin, np.int64(4), F(1.4), F(0.1), *np.empty((2, n), np.int32), eights)
    both = [0 < far[row[row >= 0]].mean() < 1 for row in eights.row[: eights.block[-1]]]
    assert sum(both) <= 1
