"""How many rays each fragment sends to the world: as many as they are worth, judged by what its neighbours met.

Where all rays about a fragment escape, or none does, more would say nothing new. What a fragment's own rays met must
not decide, or those that are lucky would stop early and the mean would be wrong; nor what others of its pixel met,
whose rays are stratified with its own (those of other pixels are, too, but loosely).
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.sharing.light_shares import Shares, has_to_share
from pointmr_engine.multires.sharing.light_sharing import ERROR, REACH
from pointmr_engine.numerics.jit import uncounted

# rays of a cone that sees one surface and shares with none, for each unit of deviation of what arrives, against all its
# light; where the light of more cones becomes one, noise is least if each asks as often as the root of their number
WORTH = 240.0
MOST = 16  # rays of a fragment
LARGE = 0.75  # of a cone that a fragment fills, from which it begins with two rays
# rays that escaped, and as many that did not, besides those that were seen: a few that agree prove little
DOUBT = 0.025
DIM = 0.3  # sum of the channels of what counts as dark: errors matter by their ratio to what is brighter
_OPEN, _ARRIVED, _LIGHT, _SUBPIXELS, _RAYS = range(5)
SUMS = 5
_NEAR, _ASKED, _NORMAL, _FACES = 0, 1, 2, 5
PEER_SUMS = 6
MOST_PEERS = math.pi / 2.0 * (REACH + 1.0) ** 2


@uncounted
def first_rays(subpixels, whole, count, asked):
    """asked (N,) int64: rays that fragments 0..count, seen in `subpixels` (N,) of a cone's `whole`, begin with."""
    for k in range(count):
        asked[k] = 2 if subpixels[k] >= LARGE * whole else 1


@uncounted
def count_peers(pixel, shares: Shares, first, width, side, turn, count, sums, peers):
    """peers (N,) float64: the cones whose light becomes one with that of each of the fragments first..first + count.

    By what rays from the pixels about it met, and how normals turn there (light_sharing). pixel (N,) int64: their
    pixels' numbers in the tile; width (N,) float64: of a cone where it meets them, metres; side: cones per side of a
    pixel; turn: of the world (light_sharing.OF_WORLD); sums (rows, columns, PEER_SUMS) float64 to work in.
    """
    rows, columns = sums.shape[0], sums.shape[1]
    sums[:] = 0.0
    for k in range(count):
        j, i, row = pixel[k] // columns, pixel[k] % columns, first + k
        peers[k] = 1.0
        if has_to_share(shares, row):
            sums[j, i, _NEAR] += np.float64(shares.nearness[row])
            sums[j, i, _ASKED] += np.float64(shares.rays[row])
            for c in range(3):
                sums[j, i, _NORMAL + c] += np.float64(shares.normal[row, c])
            sums[j, i, _FACES] += 1.0
    for k in range(count):
        j, i, row = pixel[k] // columns, pixel[k] % columns, first + k
        if not has_to_share(shares, row):
            continue
        near, rays, x, y, z, faces = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for q in range(max(j - 1, 0), min(j + 2, rows)):
            for p in range(max(i - 1, 0), min(i + 2, columns)):
                x += sums[q, p, _NORMAL]
                y += sums[q, p, _NORMAL + 1]
                z += sums[q, p, _NORMAL + 2]
                faces += sums[q, p, _FACES]
                if q != j or p != i:
                    near += sums[q, p, _NEAR]
                    rays += sums[q, p, _ASKED]
        if rays > 0.0:
            # the mean normal is shorter than 1 by a third of the square of the angle from pixel to pixel
            bent = max(1.0 - math.sqrt(x * x + y * y + z * z) / faces, 0.0)
            change = near / rays * width[k] + turn * math.sqrt(1.5 * bent) / side
            reach = ERROR * np.float64(shares.width[row]) / max(change, 1e-6)
            peers[k] = min(1.0 + math.pi / 3.0 * reach * reach, MOST_PEERS)


@uncounted
def wanted_rays(pixel, open_light, arrived, others, subpixels, whole, worth, peers, count, sums, asked):
    """asked (N,) int64, rays that fragments 0..count have sent, becomes the number that they are worth, never less.

    pixel (N,) int64: their pixels' numbers in the tile; open_light, arrived (N,) float64: what they receive of the
    world without and with what hides it, sums of channels; others (N,): of all else so far. subpixels (N,): in which
    each is seen, of a cone's `whole`; peers (N,) float64: see count_peers. sums (rows, columns, SUMS) float64 to work
    in.
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
        wanted = np.int64(worth * subpixels[k] / whole * deviation / math.sqrt(peers[k]) + 0.5)
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
