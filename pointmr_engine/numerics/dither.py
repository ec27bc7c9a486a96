"""Ordered dithers for what is half transparent: eight orders of the cells of an 8 x 8 square.

Layers of glass or leaves must not share an order, or those behind show too much or too little in the holes of those
before. An order is an invertible linear map over GF(2) from the bits of a cell's place to those of its rank, as in
digital nets (Niederreiter 1987): the first n ranks lie evenly over the square, and those of two orders meet as often as
if they were independent, within one cell in 64 (found by a random search; tests/engine/test_dither.py).
"""

from __future__ import annotations

import numpy as np

SIDE = 8
# of each order, from the highest bit of the rank on: the bits of x + 8 y whose parity it is
_MAPS = (
    (42, 49, 24, 40, 36, 33),
    (58, 31, 55, 38, 44, 54),
    (61, 44, 62, 24, 2, 22),
    (12, 51, 13, 34, 44, 22),
    (19, 15, 10, 40, 21, 20),
    (60, 43, 18, 35, 61, 33),
    (53, 14, 54, 33, 52, 38),
    (11, 30, 29, 37, 31, 5),
)
ORDERS = len(_MAPS)


def _ranks() -> np.ndarray:
    place = np.arange(SIDE * SIDE)
    out = np.zeros((ORDERS, SIDE * SIDE), np.int64)
    for order, rows in enumerate(_MAPS):
        for row in rows:
            parity = np.array([int(p & row).bit_count() & 1 for p in place])
            out[order] = 2 * out[order] + parity
    return out.reshape(ORDERS, SIDE, SIDE)


RANKS = _ranks()  # (ORDERS, 8, 8) int64, by y and x: which of the 64 cells are covered first
