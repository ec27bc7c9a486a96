"""Pieces of triangles in front of the near plane."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine.forward.drawing.near_clip import at_place, clip, corners_of_piece
from pointmr_engine.numerics.jit import uncounted

NEAR = 0.25


@uncounted
def pieces_of(corners, near, at, places):
    """Fill at (2, 3, 2) and places (2, 3, 3), in camera space, of pieces; returns how many."""
    pieces, k, s, t = clip(corners, near)
    for piece in range(pieces):
        a, b, c = corners_of_piece(piece, pieces, k, s, t)
        at[piece, 0, 0], at[piece, 0, 1] = a
        at[piece, 1, 0], at[piece, 1, 1] = b
        at[piece, 2, 0], at[piece, 2, 1] = c
        places[piece, 0, 0], places[piece, 0, 1], places[piece, 0, 2] = at_place(corners, near, a)
        places[piece, 1, 0], places[piece, 1, 1], places[piece, 1, 2] = at_place(corners, near, b)
        places[piece, 2, 0], places[piece, 2, 1], places[piece, 2, 2] = at_place(corners, near, c)
    return pieces


def area(at: np.ndarray) -> np.ndarray:
    """Signed, of triangles (n, 3, 2)."""
    a, b = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


@given(st.tuples(*[st.floats(-1e6, 1e6)] * 3), st.integers(0, 1000))
def test_pieces_are_what_lies_in_front(depth, seed):
    rng = np.random.default_rng(seed)
    corners = np.column_stack([rng.normal(size=(3, 2)), depth])
    at, places = np.zeros((2, 3, 2)), np.zeros((2, 3, 3))
    n = pieces_of(corners, NEAR, at, places)
    front = corners[:, 2] >= NEAR
    assert n == (0, 1, 2, 1)[front.sum()]
    at, places = at[:n], places[:n]
    assert (places[..., 2] >= NEAR).all() and (area(at) >= 0).all()  # none is turned round
    # each corner in front, and each edge's crossing, is a corner of a piece, exactly where it is
    for k in np.flatnonzero(front):
        assert (places == corners[k]).all(-1).any()
    share = {0: 0.0, 3: 1.0}.get(front.sum())
    if share is None:
        alone = np.flatnonzero(front == (front.sum() == 1))[0]
        z = np.abs(corners[:, 2] - NEAR)
        corner = np.prod([z[alone] / (z[alone] + z[j]) for j in range(3) if j != alone])
        share = corner if front[alone] else 1.0 - corner
    assert area(at).sum() == pytest.approx(0.5 * share, abs=1e-9)
