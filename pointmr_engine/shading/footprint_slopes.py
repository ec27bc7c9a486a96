"""How what a surface reflects changes across the footprint of a ray, as its fine textures do.

The mean over a footprint is a box filter before the pixel filter. With the plane that fits the texture best besides,
what the pixel filter makes of both is exact as far as the filter is linear within the footprint.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.shading.footprint_mean import Slopes
from pointmr_engine.shading.leaves import PRINCIPLED, Leaf, reduce_leaves
from pointmr_engine.shading.program import Program

STEP = 0.1  # of a footprint: what is compared with its middle
COAT = 0.04  # what plastic reflects, whatever its colour


class TextureSlopes(NamedTuple):
    """Of N rays."""

    known: np.ndarray  # (N,) bool: whether a fine texture changes there; else the others are undefined
    sides: np.ndarray  # (2, N, 3) float64 sides of the footprint on the surface, world space, metres
    change: np.ndarray  # (2, N, 3) float32 from end to end of either side, in parts of what is reflected


def allocate_texture_slopes(n: int) -> TextureSlopes:
    """Room for n rays, none known."""
    return TextureSlopes(np.zeros(n, np.bool_), np.empty((2, n, 3)), np.empty((2, n, 3), np.float32))


def _sent(leaves: list[Leaf], count: int) -> np.ndarray:
    """(count, 3) float32: what light from all around makes of the leaves, about, and what they emit."""
    albedo, emission, _ = reduce_leaves(leaves, count)
    coat = COAT if any(leaf.kind == PRINCIPLED for leaf in leaves) else 0.0
    return albedo + emission + np.float32(coat)


def fill_slopes(
    program: Program, values: dict, means: list, leaves: list[Leaf], slopes: Slopes, rows: np.ndarray,
    out: TextureSlopes,
) -> None:  # fmt: skip
    """Fill the rays `rows` (n,) of `out` where `slopes` are known; its rows count among these n points.

    values, means, leaves: of program.values and fill_leaves, at the n points.
    """
    n, at = len(rows), slopes.rows
    middle = _sent(leaves, n)[at]
    scale = 1.0 / (STEP * np.maximum(middle, 1e-6))
    for side, changes in enumerate(slopes.along):
        moved = _replaced(values, means, changes.keys(), n)
        for name, change in changes.items():
            moved[name][at] += np.float32(STEP) * change
        beside = program.fill_leaves(values, [*means, (np.arange(n), moved)])
        out.change[side, rows[at]] = (_sent(beside, n)[at] - middle) * scale
        out.sides[side, rows[at]] = slopes.sides[side]
    out.known[rows[at]] = True


def _replaced(values: dict, means: list, names, n: int) -> dict:
    """Values by name, with the means in their places."""
    found = {name: np.broadcast_to(values[name], (n, *values[name].shape[1:])).copy() for name in names}
    for rows, others in means:
        for name in names & others.keys():
            found[name][rows] = others[name]
    return found
