"""Scattered data interpolation: each pixel is a normalised sum of Gaussians about the visible samples near it.

Occlusion comes first: samples are drawn into a depth buffer of a few cells per pixel, and weigh as many cells as they
show, from the middle of those cells (talk: "Image Reconstruction"). Cells that show nothing are samples of the
background.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import uncounted

CELLS = 2  # per side of a pixel
SIGMA = 0.6  # of the Gaussian, in pixels, or in distances of samples where those are larger
REACH = 3.0  # sigmas


def sigma(samples_per_pixel: float) -> float:
    """Standard deviation, in pixels, for samples of this density."""
    return SIGMA * max(1.0, samples_per_pixel**-0.5)


def reach(sigma: float) -> int:
    """Whole pixels beyond a tile whose samples may count in it."""
    return math.ceil(REACH * sigma)


@uncounted
def count_shown(ids, width, height, shown):
    """Add the number of cells to shown (F,) int32 that show each fragment."""
    for y in range(height):
        for x in range(width):
            if ids[y, x] >= 0:
                shown[ids[y, x]] += 1


@uncounted
def _add(total, x, y, weight, sigma, a, b, c, d):
    """Add a sample at (x, y), in pixels of `total` (h, w, 5): four channels, and the weight."""
    far = REACH * sigma
    scale = -0.5 / (sigma * sigma)
    x -= 0.5  # pixel centres at whole numbers
    y -= 0.5
    for r in range(max(0, math.ceil(y - far)), min(total.shape[0] - 1, math.floor(y + far)) + 1):
        for k in range(max(0, math.ceil(x - far)), min(total.shape[1] - 1, math.floor(x + far)) + 1):
            g = weight * math.exp(scale * ((k - x) * (k - x) + (r - y) * (r - y)))
            total[r, k, 0] += g * a
            total[r, k, 1] += g * b
            total[r, k, 2] += g * c
            total[r, k, 3] += g * d
            total[r, k, 4] += g


@uncounted
def add_fragments(x, y, shown, values, cells, apron, sigma, total):
    """Add fragments 0..len(shown) with values (F, 3) float32 at (x, y) (F,) float32, in cells of the tile."""
    for k in range(len(shown)):
        if shown[k] > 0:
            _add(
                total, np.float64(x[k]) / cells - apron, np.float64(y[k]) / cells - apron, np.float64(shown[k]), sigma,
                np.float64(values[k, 0]), np.float64(values[k, 1]), np.float64(values[k, 2]), 1.0,
            )  # fmt: skip


@uncounted
def add_empty(ids, width, height, cells, background, apron, sigma, total):
    """Add the background (rows, columns, 4) float32 of the tile's pixels at cells that show nothing."""
    for y in range(height):
        for x in range(width):
            if ids[y, x] < 0:
                p, q = x // cells, y // cells
                _add(
                    total, (x + 0.5) / cells - apron, (y + 0.5) / cells - apron, 1.0, sigma,
                    np.float64(background[q, p, 0]), np.float64(background[q, p, 1]),
                    np.float64(background[q, p, 2]), np.float64(background[q, p, 3]),
                )  # fmt: skip


@uncounted
def divide(total, out):
    """Means (h, w, 4) float32 of the sums."""
    for r in range(total.shape[0]):
        for k in range(total.shape[1]):
            for c in range(4):
                out[r, k, c] = total[r, k, c] / total[r, k, 4] if total[r, k, 4] > 0.0 else 0.0
