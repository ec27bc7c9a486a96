"""What the world sends to a surface, shared between its fragments: each asks with few rays, and all hear the answers.

Light that comes from everywhere changes slowly along a surface, by about as much as one moves against the distance of
what hides it (the split-sphere model: Ward, Rubinstein, Clear 1988, "A Ray Tracing Solution for Diffuse
Interreflection"). So fragments within a few cones take the mean of what arrives at each other, as far as that model
allows: all of it in the open, none of it in a corner or in foliage.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.shading.bsdf.layout import KIND_MASK, NORMAL, OREN_NAYAR, TRANSLUCENT, WEIGHT
from pointmr_engine.shading.bsdf.vector import row3

REACH = 2.0  # cones: how far apart fragments share
ERROR = 0.5  # of what arrives: change along the surface at which sharing ends
DIM = 1e-4  # reflectance below which a fragment has nothing to share


class WorldShares(NamedTuple):
    """What the F fragments of a tile received of the world; world space."""

    light: np.ndarray  # (F, 3) float32, as the surface reflects it
    albedo: np.ndarray  # (F, 3) float32: what it reflects; 0: does not share
    position: np.ndarray  # (F, 3) float64
    normal: np.ndarray  # (F, 3) float32
    rays: np.ndarray  # (F,) float32: how many asked
    nearness: np.ndarray  # (F,) float32: sum of 1 / distance of what they met


def allocate_shares(n: int) -> WorldShares:
    """Room for n fragments, undefined."""
    f = np.float32
    return WorldShares(
        np.empty((n, 3), f),
        np.empty((n, 3), f),
        np.empty((n, 3)),
        np.empty((n, 3), f),
        np.empty(n, f),
        np.empty(n, f),
    )


@uncounted
def begin_shares(lobes, throughput, position, flat, least_flat, first, count, shares):
    """Rows first..first + count of `shares`: what the points 0..count reflect diffusely, nothing received yet.

    flat (N,) float32: pieces less flat than least_flat have no normal of their own, and do not share; nor does what
    reflects otherwise than plain diffuse surfaces, or lets light through.
    """
    for k in range(count):
        row = first + k
        shares.rays[row] = shares.nearness[row] = np.float32(0)
        single = flat[k] >= least_flat
        normal = np.int64(-1)
        for c in range(3):
            shares.light[row, c] = shares.albedo[row, c] = np.float32(0)
            shares.position[row, c] = position[k, c]
        for j in range(np.int64(lobes.count[k])):
            base = lobes.kind[k, j] & KIND_MASK
            if base > TRANSLUCENT:
                continue
            if normal < 0:
                normal = np.int64(j)
            for c in range(3):
                single = single and lobes.data[k, j, NORMAL + c] == lobes.data[k, normal, NORMAL + c]
                shares.albedo[row, c] += throughput[k, c] * lobes.data[k, j, WEIGHT + c]
            single = single and base <= OREN_NAYAR
        for c in range(3):
            if normal >= 0:
                shares.normal[row, c] = lobes.data[k, normal, NORMAL + c]
            if not single:
                shares.albedo[row, c] = np.float32(0)


@uncounted
def count_rays(source, triangle, t, count, first, shares):
    """Shadow rays 0..count of the fragments first + source (N,): what each met, at t."""
    for i in range(count):
        row = first + np.int64(source[i])
        shares.rays[row] += np.float32(1)
        if triangle[i] != -1 and t[i] > 0.0:
            shares.nearness[row] += np.float32(1.0 / t[i])


@uncounted
def take_light(radiance, before, first, count, shares):
    """Move what radiance (N, 3) has gained since `before` to the fragments first..first + count that share."""
    for k in range(count):
        row = first + k
        if max(shares.albedo[row, 0], shares.albedo[row, 1], shares.albedo[row, 2]) > 0.0:
            for c in range(3):
                shares.light[row, c] += radiance[k, c] - before[k, c]
                radiance[k, c] = before[k, c]


@uncounted
def _by_pixel(x, y, subpixels, shares, count, head, after):
    """Lists of the fragments 0..count that share: head (rows, columns) int32 of each pixel, after (F,) int32."""
    head[:] = -1
    for k in range(count):
        if max(shares.albedo[k, 0], shares.albedo[k, 1], shares.albedo[k, 2]) > 0.0:
            i = min(max(np.int64(x[k]) // subpixels, 0), head.shape[1] - 1)
            j = min(max(np.int64(y[k]) // subpixels, 0), head.shape[0] - 1)
            after[k] = head[j, i]
            head[j, i] = k


@device
def _hidden_at(shares, lists, x, y, reach, k):
    """How near things are, 1 / metres, by all that the fragments about k have met."""
    head, after, size = lists
    i, j, wide = np.int64(x[k]) // size, np.int64(y[k]) // size, np.int64(math.ceil(reach / size))
    near, rays = 0.0, 0.0
    for q in range(max(j - wide, 0), min(j + wide + 1, head.shape[0])):
        for p in range(max(i - wide, 0), min(i + wide + 1, head.shape[1])):
            g = np.int64(head[q, p])
            while g >= 0:
                if abs(x[g] - x[k]) <= reach and abs(y[g] - y[k]) <= reach:
                    near += shares.nearness[g]
                    rays += shares.rays[g]
                g = np.int64(after[g])
    return near / max(rays, 1.0)


@device
def _weight(shares, near, k, g):
    """Of what fragment g received, for k, where things are as near as `near`."""
    if g == k:
        return 1.0
    distance, facing = 0.0, 0.0
    for c in range(3):
        distance += (shares.position[g, c] - shares.position[k, c]) ** 2
        facing += np.float64(shares.normal[g, c]) * np.float64(shares.normal[k, c])
    change = math.sqrt(distance) * near + math.sqrt(max(1.0 - facing, 0.0))
    return max(1.0 - change / ERROR, 0.0)


@device
def _add_received(shares, lists, x, y, reach, k, out):
    """Add to row k of `out` the weighted mean of what the fragments about k received."""
    near = _hidden_at(shares, lists, x, y, reach, k)
    head, after, size = lists
    i, j, wide = np.int64(x[k]) // size, np.int64(y[k]) // size, np.int64(math.ceil(reach / size))
    sums = (0.0, 0.0, 0.0)
    weights = (0.0, 0.0, 0.0)
    for q in range(max(j - wide, 0), min(j + wide + 1, head.shape[0])):
        for p in range(max(i - wide, 0), min(i + wide + 1, head.shape[1])):
            g = np.int64(head[q, p])
            while g >= 0:
                if abs(x[g] - x[k]) <= reach and abs(y[g] - y[k]) <= reach:
                    w = _weight(shares, near, k, g)
                    if w > 0.0:
                        a, light = row3(shares.albedo, g), row3(shares.light, g)
                        u = (w * (a[0] > DIM), w * (a[1] > DIM), w * (a[2] > DIM))
                        weights = (weights[0] + u[0], weights[1] + u[1], weights[2] + u[2])
                        sums = (
                            sums[0] + u[0] * light[0] / max(a[0], DIM),
                            sums[1] + u[1] * light[1] / max(a[1], DIM),
                            sums[2] + u[2] * light[2] / max(a[2], DIM),
                        )
                g = np.int64(after[g])
    for c in range(3):
        if weights[c] > 0.0 and shares.albedo[k, c] > DIM:
            out[k, c] += shares.albedo[k, c] * sums[c] / weights[c]
        else:
            out[k, c] += shares.light[k, c]


@uncounted
def share_light(x, y, subpixels, reach, shares, count, head, after, out):
    """Add what fragments 0..count of a tile share to out (F, 3) float32.

    x, y (F,) float32: their places, subpixels; reach: subpixels within which they share; head (rows, columns) int32 of
    the tile's pixels and after (F,) int32 to work in.
    """
    _by_pixel(x, y, subpixels, shares, count, head, after)
    lists = head, after, subpixels
    for j in range(head.shape[0]):
        for i in range(head.shape[1]):
            k = np.int64(head[j, i])
            while k >= 0:
                _add_received(shares, lists, x, y, reach, k, out)
                k = np.int64(after[k])
