"""How many rays each fragment sends to the world: as many as they are worth, judged by what its neighbours met.

Where all rays about a fragment escape, or none does, more would say nothing new. What a fragment's own rays met must
not decide, or those that are lucky would stop early and the mean would be wrong; nor what others of its pixel met,
whose rays are stratified with its own.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import uncounted

WORTH = 120.0  # rays of a cone that sees one surface, for each unit of deviation of what arrives, against all its light
MOST = 16  # rays of a fragment
LARGE = 0.75  # of a cone that a fragment fills, from which it begins with two rays
DOUBT = 0.1  # rays that escaped, and as many that did not, besides those that were seen: a few that agree prove little
DIM = 0.3  # sum of the channels of what counts as dark: errors matter by their ratio to what is brighter
_OPEN, _ARRIVED, _LIGHT, _SUBPIXELS, _RAYS = range(5)
SUMS = 5


@uncounted
def first_rays(subpixels, whole, count, asked):
    """asked (N,) int64: rays that fragments 0..count, seen in `subpixels` (N,) of a cone's `whole`, begin with."""
    for k in range(count):
        asked[k] = 2 if subpixels[k] >= LARGE * whole else 1


@uncounted
def wanted_rays(pixel, open_light, arrived, others, subpixels, whole, worth, count, sums, asked):
    """asked (N,) int64, rays that fragments 0..count have sent, becomes the number that they are worth, never less.

    pixel (N,) int64: their pixels' numbers in the tile; open_light, arrived (N,) float64: what they receive of the
    world without and with what hides it, sums of channels; others (N,): of all else so far. subpixels (N,): in which
    each is seen, of a cone's `whole`. sums (rows, columns, SUMS) float64 to work in.
    """
    rows, columns = sums.shape[0], sums.shape[1]
    sums[:] = 0.0
    for k in range(count):
        j, i = pixel[k] // columns, pixel[k] % columns
        n = np.float64(subpixels[k])
        sums[j, i, _OPEN] += n * open_light[k]
        sums[j, i, _ARRIVED] += n * arrived[k]
        sums[j, i, _LIGHT] += n * (others[k] + arrived[k])
        sums[j, i, _SUBPIXELS] += n
        sums[j, i, _RAYS] += asked[k]
    for k in range(count):
        j, i = pixel[k] // columns, pixel[k] % columns
        opened, through, light, seen, rays = 0.0, 0.0, 0.0, 0.0, 0.0
        for q in range(max(j - 1, 0), min(j + 2, rows)):
            for p in range(max(i - 1, 0), min(i + 2, columns)):
                if q == j and p == i:
                    continue
                opened += sums[q, p, _OPEN]
                through += sums[q, p, _ARRIVED]
                light += sums[q, p, _LIGHT]
                seen += sums[q, p, _SUBPIXELS]
                rays += sums[q, p, _RAYS]
        deviation = 0.5  # of what arrives, by its ratio to all light
        if opened > 0.0 and light > 0.0:
            share = min(max((through / opened * rays + DOUBT) / (rays + 2.0 * DOUBT), 0.0), 1.0)
            deviation = opened * math.sqrt(share * (1.0 - share)) / max(light, DIM * seen)
        wanted = np.int64(worth * subpixels[k] / whole * deviation + 0.5)
        asked[k] = min(max(wanted, asked[k]), MOST)


def split_repeats(times: np.ndarray, room: int) -> list[slice]:
    """Parts of rows that fit into `room` when each is repeated so many times (N,).

    Raises ValueError if a row alone does not fit.
    """
    if not len(times):
        return []
    if times.max() > room:
        raise ValueError(f"{times.max()} repetitions of one row do not fit into a room of {room}")
    ends = np.cumsum(times)
    parts, first = [], 0
    while first < len(times):
        before = ends[first - 1] if first else 0
        last = int(np.searchsorted(ends, before + room, "right"))
        parts.append(slice(first, last))
        first = last
    return parts
