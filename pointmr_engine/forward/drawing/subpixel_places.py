"""Where in its cell each subpixel looks: no two of a pixel share a line or a column.

On a plain grid, eight centres cross a level edge at once: a wire thinner than a subpixel is seen by eight of them or
by none, and its coverage flickers in steps of an eighth. Here it goes in steps of 1/64. Places that are spread over
their whole cells, as n-rooks are, resolve level edges best, but are uneven: of a pixel's few subpixels, 4 x 4, edges at
other angles have a third more mean square error then. So these stay nearer to their middles. Coverage of a pixel by a
half plane, under the pixel filter, root mean square error:

| subpixels | places | all angles | the worst | level |
|---|---|---|---|---|
| 8 x 8 | grid | 0.0045 | 0.0162 | 0.0162 |
| 8 x 8 | n-rooks, here | 0.0048 | 0.0071 | 0.0027 |
| 4 x 4 | grid | 0.0126 | 0.0333 | 0.0333 |
| 4 x 4 | n-rooks | 0.0144 | 0.0266 | 0.0093 |
| 4 x 4 | here | 0.0130 | 0.0178 | 0.0154 |
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.simd import WIDTH

# subpixels a side -> x of rows and y of columns, in ranks, and what part of their cells they take: of those that were
# tried (all; of eight, 10^5) the least mean square error over all angles, at the worst one and at level edges
ORDERS = {
    8: ((4, 7, 2, 3, 1, 6, 5, 0), (0, 6, 3, 5, 1, 4, 2, 7), 1.0),
    4: ((0, 2, 1, 3), (0, 2, 1, 3), 0.6),
    2: ((1, 0), (1, 0), 0.6),
    1: ((0,), (0,), 1.0),
}
INNER = 1.0 / 16.0  # subpixels: least distance from a place to the sides of its cell


def subpixel_places(subpixels: int) -> np.ndarray:
    """(2, 16) float32: what is added to the middles of subpixels, y of columns and x of rows, each twice.

    subpixels: per side of a pixel; rows and columns repeat after eight, or after the largest power of two in it.
    """
    period = math.gcd(subpixels, WIDTH)
    rows, columns, part = ORDERS[period]
    shift = [part * ((np.array(order) + 0.5) / period - 0.5) for order in (columns, rows)]
    return np.ascontiguousarray(np.tile(shift, (1, 2 * WIDTH // period)), np.float32)


@device
def place_of(shift, i, j):
    """(x, y) that subpixel (i, j) looks at. shift: as of subpixel_places."""
    return i + 0.5 + shift[1, j & 7], j + 0.5 + shift[0, i & 7]
