"""Orders of ordered dithers: even over the square, each by itself and two of them together."""

import itertools

import numpy as np
import pytest

from pointmr_engine.numerics.dither import ORDERS, SIDE, ranks

RANKS = ranks()


@pytest.mark.parametrize("order", range(ORDERS))
def test_an_order_has_every_rank_once_and_covers_parts_of_the_square_evenly(order):
    rank = RANKS[order]
    assert sorted(rank.ravel()) == list(range(SIDE**2))
    for side, step in (
        (4, 16),
        (2, 4),
    ):  # so many cells of the square, of which each has one of the first `step`
        blocks = rank.reshape(SIDE // side, side, SIDE // side, side).swapaxes(1, 2).reshape(-1, side * side)
        per_block = 64 // len(blocks)
        for first in range(0, 64, 64 // per_block):
            inside = (blocks >= first) & (blocks < first + 64 // per_block)
            assert (inside.sum(1) == 1).all(), (order, side, step)


def test_two_orders_hide_each_other_as_if_they_were_independent():
    """Layers behind each other: of 64 cells, what both cover is off by three at most, and by less than one on average;
    layers of one order are off by up to 16."""
    worst, total, count = 0.0, 0.0, 0
    for a, b in itertools.combinations(range(ORDERS), 2):
        for turn_x, turn_y in ((0, 0), (3, 0), (0, 5), (6, 7)):
            y, x = np.mgrid[:SIDE, :SIDE]
            behind = RANKS[b][y ^ turn_y, x ^ turn_x]
            for m, n in itertools.product(range(4, 64, 4), repeat=2):
                off = abs(np.sum((RANKS[a] < m) & (behind < n)) - m * n / 64)
                worst, total, count = max(worst, off), total + off, count + 1
    assert worst <= 4.0 and total / count < 1.0, (worst, total / count)
    same = RANKS[0] < 32
    assert abs(np.sum(same & same) - 16) == 16
