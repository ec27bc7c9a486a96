"""Edges of sharp lamps' shadows: where they cross a pixel, fragments ask for the lamp at several of their points.

One ray from the middle of each fragment finds the edges; only there more are worth it (adaptive supersampling, Whitted
1980).
"""

from __future__ import annotations

import math

from pointmr_engine.numerics.jit import uncounted

LOOKS = 3  # more points of a fragment
LARGE = 8  # subpixels from which a fragment is worth more than one point
DIFFERENT = 0.1  # of a lamp's light: shares of neighbours between which an edge lies


@uncounted
def find_edges(pixel, shape, open_light, light, subpixels, count, low, high, edge):
    """edge (N,) bool: of fragments 0..count, those that are large and lie where the lamp is partly hidden.

    pixel (N,) int64: their pixels' numbers in a tile of `shape` (rows, columns); open_light (N,) float64: what they
    receive of the lamp without shadows, 0 where nothing; light (N,) float64: with them. low, high (rows, columns)
    float64 to work in.
    """
    rows, columns = shape
    low[:] = math.inf
    high[:] = -math.inf
    for k in range(count):
        edge[k] = False
        if open_light[k] > 0.0:
            share = light[k] / open_light[k]
            j, i = pixel[k] // columns, pixel[k] % columns
            low[j, i] = min(low[j, i], share)
            high[j, i] = max(high[j, i], share)
    for k in range(count):
        if not open_light[k] > 0.0 or subpixels[k] < LARGE:
            continue
        j, i = pixel[k] // columns, pixel[k] % columns
        least, most = math.inf, -math.inf
        for q in range(max(j - 1, 0), min(j + 2, rows)):
            for p in range(max(i - 1, 0), min(i + 2, columns)):
                least, most = min(least, low[q, p]), max(most, high[q, p])
        edge[k] = most - least > DIFFERENT
