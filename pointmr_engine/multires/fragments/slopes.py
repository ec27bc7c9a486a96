"""How light changes across fragments: slopes from neighbours of the same surface.

A fragment that has one light everywhere is a box filter before the pixel filter, and blurs what is as fine as a pixel.
Slopes are those of the plane nearest to the neighbours' light, limited so that a fragment is nowhere much brighter or
darker than what is about it (Barth and Jespersen 1989, "The Design and Application of Upwind Schemes on Unstructured
Meshes"): at edges and in noise they vanish.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.reconstruction.fragments import Fragments, is_clump
from pointmr_engine.forward.reconstruction.pixel_filter import Slopes
from pointmr_engine.multires.fragments.merge import mergeable
from pointmr_engine.numerics.jit import device, uncounted

# Columns of what is summed for a fragment: squares of steps to neighbours, steps times differences of light by
# channel, then the least and greatest difference by channel.
XX, XY, YY, X_LIGHT, Y_LIGHT, LEAST, MOST = 0, 1, 2, 3, 6, 9, 12
COLUMNS = 15
STEADY = 0.01  # of the sum of squares: keeps slopes finite where all neighbours lie in one line
ROOM = 2.0  # times as far from its mean as a neighbour on either side a fragment's corners may be
APART = 2.0  # footprints: neighbours lie in one plane as fragments of a cell twice as large would


@device
def _compare(f: Fragments, light, a, b, footprint, perspective, sums):
    """Tell the fragments a and b, which are side by side, of each other's light if they are one surface.

    Light of a clump was met at one place of it.
    """
    if is_clump(f, a):
        return
    width = footprint
    if perspective:
        width = footprint * f.position[a, 2]
    if not mergeable(f, a, b, width):
        return
    dx, dy = f.x[b] - f.x[a], f.y[b] - f.y[a]
    for k, sign in ((a, np.float32(1)), (b, np.float32(-1))):
        sums[k, XX] += dx * dx
        sums[k, XY] += dx * dy
        sums[k, YY] += dy * dy
        for c in range(3):
            change = light[b, c] - light[a, c]
            sums[k, X_LIGHT + c] += dx * change
            sums[k, Y_LIGHT + c] += dy * change
            sums[k, LEAST + c] = min(sums[k, LEAST + c], sign * change)
            sums[k, MOST + c] = max(sums[k, MOST + c], sign * change)


@device
def _solve(sums, light, k, half, out: Slopes):
    """Slopes of fragment k, within what its neighbours allow; half: of a fragment's width, subpixels."""
    steady = np.float32(STEADY) * (sums[k, XX] + sums[k, YY])
    xx, yy, xy = sums[k, XX] + steady, sums[k, YY] + steady, sums[k, XY]
    det = xx * yy - xy * xy
    inverse = np.float32(1) / det if det > np.float32(0) else np.float32(0)
    for c in range(3):
        u, v = sums[k, X_LIGHT + c], sums[k, Y_LIGHT + c]
        gx, gy = inverse * (yy * u - xy * v), inverse * (xx * v - xy * u)
        corner = half * (abs(gx) + abs(gy))
        room = min(
            np.float32(ROOM) * min(sums[k, MOST + c], -sums[k, LEAST + c]), max(light[k, c], np.float32(0))
        )
        part = room / corner if corner > room else np.float32(1)
        out.x[k, c], out.y[k, c] = part * gx, part * gy


@uncounted
def find_slopes(ids, width, height, cell, perspective, pixel, fragments, light, count, sums, out: Slopes):
    """Slopes of the light (F, 3) of the tile's fragments 0..count, whose numbers are in `ids`.

    cell: subpixels per side of a fragment; pixel: its footprint at depth 1 (perspective) or in metres; sums (count,
    COLUMNS) float32 to work in.
    """
    f, footprint = fragments, APART * pixel
    sums[:] = np.float32(0)
    for x in range(cell, width, cell):
        last_a, last_b = np.int64(-1), np.int64(-1)
        for y in range(height):
            a, b = np.int64(ids[y, x - 1]), np.int64(ids[y, x])
            if a >= 0 and b >= 0 and a != b and (a != last_a or b != last_b):
                last_a, last_b = a, b
                _compare(f, light, a, b, footprint, perspective, sums)
    for y in range(cell, height, cell):
        last_a, last_b = np.int64(-1), np.int64(-1)
        for x in range(width):
            a, b = np.int64(ids[y - 1, x]), np.int64(ids[y, x])
            if a >= 0 and b >= 0 and a != b and (a != last_a or b != last_b):
                last_a, last_b = a, b
                _compare(f, light, a, b, footprint, perspective, sums)
    for k in range(count):
        _solve(sums, light, k, np.float32(0.5 * cell), out)


@uncounted
def find_slopes_by_key(key, right, above, perspective, pixel, fragments, light, half, sums, out: Slopes):
    """Slopes of the light (F, 3) of fragments that lie in cells of which each has a key.

    key (N,) int64, sorted: of fragment k; right, above: what the cell beside and above has more; half (N,) float32: of
    a cell's width, subpixels; others: find_slopes.
    """
    f, footprint, count = fragments, APART * pixel, len(key)
    sums[:] = np.float32(0)
    for k in range(count):
        for step in (right, above):
            for other in range(np.searchsorted(key, key[k] + step), count):
                if key[other] != key[k] + step:
                    break
                _compare(f, light, k, other, footprint, perspective, sums)
    for k in range(count):
        _solve(sums, light, k, half[k], out)
