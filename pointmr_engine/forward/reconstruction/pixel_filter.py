"""The pixel filter over a tile's subpixels: each shows one fragment, whose light may change across it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.reconstruction.fragments import Fragments
from pointmr_engine.image.filters import filter_extent, filter_weight
from pointmr_engine.numerics.jit import device, uncounted


class Slopes(NamedTuple):
    """Change of the light of F fragments from a subpixel to the next; of none: each has one light everywhere."""

    x: np.ndarray  # (F, 3) float32
    y: np.ndarray  # (F, 3) float32


def allocate_slopes(n: int) -> Slopes:
    """Room for n fragments, undefined."""
    return Slopes(np.empty((n, 3), np.float32), np.empty((n, 3), np.float32))


NO_SLOPES = allocate_slopes(0)


def filter_taps(kind: str, width: float, subpixels: int) -> np.ndarray:
    """(n,) float32 weights of the subpixels along one axis, about a pixel's centre; they sum to 1, n / subpixels is
    odd."""
    reach = max(0, int(np.ceil(filter_extent(kind, width) - 0.5 - 1e-9)))
    n = (2 * reach + 1) * subpixels
    edges = 64
    offset = ((np.arange(n * edges) + 0.5) / edges - 0.5 * n) / subpixels
    taps = filter_weight(kind, width, offset).reshape(n, edges).sum(1)
    return (taps / taps.sum()).astype(np.float32)


@device
def _gather_line(ids, y, width, subpixels, light, background, line):
    """Colours (width, 4) of row y's subpixels."""
    below = y // subpixels
    one = np.float32(1)
    for left in range(0, width, subpixels):
        p = left // subpixels
        for x in range(left, left + subpixels):
            k = ids[y, x]
            if k >= 0:
                line[x, 0] = light[k, 0]
                line[x, 1] = light[k, 1]
                line[x, 2] = light[k, 2]
                line[x, 3] = one
            else:
                for c in range(4):
                    line[x, c] = background[below, p, c]


@device
def _add_slopes(ids, y, width, fragments, slopes, line):
    """Colours (width, 4) of row y's subpixels, as they differ from the means of their fragments."""
    half = np.float32(0.5)
    for x in range(width):
        k = np.int64(ids[y, x])
        if k >= 0:
            dx, dy = np.float32(x) + half - fragments.x[k], np.float32(y) + half - fragments.y[k]
            for c in range(3):
                line[x, c] += dx * slopes.x[k, c] + dy * slopes.y[k, c]


@device
def _add_scaled(total, line, weight):
    """total += weight * line, both flat."""
    for i in range(len(total)):
        total[i] += weight * line[i]


@uncounted
def filter_tile(
    ids,
    width,
    height,
    subpixels,
    light,
    background,
    taps,
    sums,
    line,
    out,
    fragments: Fragments,
    slopes: Slopes,
):
    """Pixels of a tile: light of the fragments that its subpixels show, under the pixel filter.

    ids as find_fragments left them; light (F, 3) float32; background (rows, columns, 4) float32 of the tile's pixels,
    premultiplied with alpha, for empty subpixels; taps (n,) float32. sums (rows + 1, width * 4) and line (width, 4)
    float32 to work in; out (h, w, 4) float32: the pixels whose filter lies inside the tile. width, height: multiples
    of `subpixels`.
    """
    columns, rows, n = out.shape[1], out.shape[0], len(taps)
    flat = line.reshape(-1)[: 4 * width]
    for q in range(rows):
        sums[q, : 4 * width] = np.float32(0)
    for y in range(height):
        _gather_line(ids, y, width, subpixels, light, background, line)
        if len(slopes.x) > 0:
            _add_slopes(ids, y, width, fragments, slopes, line)
        # every row of subpixels belongs to a few rows of pixels: those whose taps reach it
        last = min(y // subpixels, rows - 1)
        for q in range(max((y - n) // subpixels + 1, 0), last + 1):
            _add_scaled(sums[q, : 4 * width], flat, taps[y - q * subpixels])
    for q in range(rows):
        for p in range(columns):
            a = b = c = d = np.float32(0)
            at = 4 * p * subpixels
            for t in range(n):
                weight = taps[t]
                a += weight * sums[q, at]
                b += weight * sums[q, at + 1]
                c += weight * sums[q, at + 2]
                d += weight * sums[q, at + 3]
                at += 4
            out[q, p, 0] = a
            out[q, p, 1] = b
            out[q, p, 2] = c
            out[q, p, 3] = d
