"""Whether what is drawn already hides a rectangle of subpixels: against its definition, for all sizes and places."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine.forward.drawing.draw import box_is_behind, cells_are_behind
from pointmr_engine.forward.drawing.subpixels import allocate_target
from pointmr_engine.numerics.jit import uncounted

SIDE = 40


@uncounted
def cells_behind(target, i, j, columns, rows, w):
    return cells_are_behind(target, i, j, columns, rows, w)


@uncounted
def box_behind(target, x0, y0, x1, y1, w):
    return box_is_behind(target, np.float32(SIDE), np.float32(SIDE), x0, y0, x1, y1, w)


def drawn(seed: int, open_ones: int):
    """A target where all is at nearness 2, but for some subpixels at 1; it is read up to its padded width."""
    target = allocate_target(SIDE, SIDE)
    target.depth[:] = 2.0
    random = np.random.default_rng(seed)
    for x, y in random.integers(0, SIDE, (open_ones, 2)):
        target.depth[y, x] = 1.0
    target.depth[:, SIDE:] = 0.0  # beyond the tile: open, and never to be looked at
    target.depth[SIDE:] = 0.0
    return target


@pytest.mark.parametrize(("i", "j"), [(0, 0), (5, 9), (SIDE - 10, SIDE - 10)])
def test_a_rectangle_is_behind_unless_a_subpixel_in_it_is_open(i, j):
    target, w = drawn(0, 0), np.float32(1.5)
    for columns in range(1, 11):
        for rows in range(1, 11):
            assert cells_behind(target, i, j, columns, rows, w)
            for y in range(max(j - 1, 0), min(j + rows + 1, SIDE)):
                for x in range(max(i - 1, 0), min(i + columns + 1, SIDE)):
                    target.depth[y, x] = 1.0
                    inside = i <= x < i + columns and j <= y < j + rows
                    assert bool(cells_behind(target, i, j, columns, rows, w)) != inside, (columns, rows, x, y)
                    target.depth[y, x] = 2.0


@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 30),
    st.floats(-12, SIDE + 12, width=32),
    st.floats(-12, SIDE + 12, width=32),
    st.floats(0, 14, width=32),
    st.floats(0, 14, width=32),
)
def test_bounds_that_reach_out_of_the_tile_are_judged_by_what_is_in_it(seed, open_ones, x, y, wide, high):
    target = drawn(seed, open_ones)
    f = np.float32
    x0, y0, x1, y1 = f(x), f(y), f(x + wide), f(y + high)
    i0, i1 = int(max(x0, f(0))), int(min(x1, f(SIDE - 1)))
    j0, j1 = int(max(y0, f(0))), int(min(y1, f(SIDE - 1)))
    seen = target.depth[j0 : j1 + 1, i0 : i1 + 1] if i0 <= i1 and j0 <= j1 else np.zeros((0, 0))
    assert bool(box_behind(target, x0, y0, x1, y1, f(1.5))) == bool((seen > 1.5).all())
