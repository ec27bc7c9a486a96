"""Leaks: where the gaps between small triangles and surfels of a surface show the far side of its body.

Surfels stand for what is smaller than their spacing, and do not meet what is drawn beside them edge to edge. What turns
its back on the eye is taken for such a gap where it is seen between two places of one surface, a subpixel or two apart,
and at a body's rim where a few subpixels of it touch the near side. Only what bounds bodies leaks: of leaves and sheets
either side may be seen.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.drawing.cut_out_cover import cut_out_of
from pointmr_engine.forward.reconstruction.fragments import Fragments, is_clump
from pointmr_engine.hierarchy.geometry import UNKNOWN, Geometry
from pointmr_engine.numerics.jit import device, uncounted

REACH = 2  # subpixels: how far from a leak the surface is looked for
ALIKE = 0.7  # least cosine between the normals of its two sides
BEHIND = 2.0  # times as far behind the surface as its two sides are from each other
THIN = 3  # subpixels of what is taken for a gap at a rim
RIM = 8.0  # subpixels: as far behind the near side as it may lie there
FRONT, STAYS = -1, -2  # instead of numbers of leaks: shows no back; cannot leak and has nothing to close


@device
def _shows_back(f: Fragments, k, perspective):
    """Whether fragment k turns its back on the eye. Clumps do not, for they have none."""
    if is_clump(f, k):
        return False
    away = np.float64(f.geometric[k, 2])
    if perspective:
        away *= f.position[k, 2]
        away += f.geometric[k, 0] * f.position[k, 0] + f.geometric[k, 1] * f.position[k, 1]
    return away > 0.0


@device
def _surface_beside(ids, width, height, x, y, dx, dy, f: Fragments, k, leaks):
    """The fragment before k that begins within REACH of (x, y) in the direction (dx, dy); -1: none."""
    for n in range(1, REACH + 1):
        i, j = x + n * dx, y + n * dy
        if i < 0 or j < 0 or i >= width or j >= height:
            return np.int64(-1)
        g = np.int64(ids[j, i])
        if g < 0:
            return np.int64(-1)
        if g != k and leaks[g] == FRONT and f.position[g, 2] < f.position[k, 2]:
            return g
    return np.int64(-1)


@device
def _continues(f: Fragments, a, b, k):
    """Whether a and b are of one surface before fragment k."""
    if f.part[a] != f.part[b] or f.row[a] != f.row[b]:
        return False
    alike = 0.0
    for c in range(3):
        alike += np.float64(f.geometric[a, c]) * f.geometric[b, c]
    near, far = f.position[a, 2], f.position[b, 2]
    return alike >= ALIKE and BEHIND * abs(near - far) <= f.position[k, 2] - max(near, far)


@device
def _rim_beside(ids, width, height, x, y, f: Fragments, k, leaks, far):
    """The fragment of the near side of k's body that touches (x, y), no farther than `far` before it; -1: none."""
    for n in range(4):
        i, j = x + (1 - n) * (1 - n % 2), y + (2 - n) * (n % 2)
        if i < 0 or j < 0 or i >= width or j >= height:
            continue
        g = np.int64(ids[j, i])
        if g >= 0 and leaks[g] == FRONT and f.part[g] == f.part[k] and f.row[g] == f.row[k]:
            if abs(f.position[g, 2] - f.position[k, 2]) <= far:
                return g
    return np.int64(-1)


@device
def _surface_about(ids, width, height, x, y, perspective, subpixel, f: Fragments, k, leaks):
    """The fragment of the surface that ought to be seen at (x, y), which shows k; -1: k itself."""
    a = _surface_beside(ids, width, height, x, y, -1, 0, f, k, leaks)
    b = _surface_beside(ids, width, height, x, y, 1, 0, f, k, leaks)
    if a >= 0 and b >= 0 and _continues(f, a, b, k):
        return a
    a = _surface_beside(ids, width, height, x, y, 0, -1, f, k, leaks)
    b = _surface_beside(ids, width, height, x, y, 0, 1, f, k, leaks)
    if a >= 0 and b >= 0 and _continues(f, a, b, k):
        return a
    if f.count[k] > THIN:
        return np.int64(-1)
    far = RIM * subpixel
    if perspective:
        far *= f.position[k, 2]
    return _rim_beside(ids, width, height, x, y, f, k, leaks, far)


def close_leaks(
    ids,
    width,
    height,
    perspective,
    subpixel,
    fragments: Fragments,
    geometry: Geometry,
    cut_outs,
    count,
    leaks,
) -> int:
    """Let the surface show that fragments 0..count of a tile leak through; returns how many subpixels did.

    ids as fragments.find_fragments left them. Fragments leak as a whole or not at all, and nothing shows those that
    do any more: the order of the others stays. Triangles that light passes, and samples of such, neither leak nor
    close leaks. subpixel: its width at depth 1 (perspective) or in metres; leaks (F,) int32 to work in: of those that
    show their backs, in how many subpixels they leak, or STAYS; FRONT for the others.
    """
    first = np.int64(0)
    while (
        first := _may_leak(perspective, fragments, geometry.closed, cut_outs, first, count, leaks)
    ) < count:
        geometry.find_closed(int(fragments.part[first]))
    return _close(ids, width, height, perspective, subpixel, fragments, count, leaks)


@uncounted
def _may_leak(perspective, f: Fragments, closed, cut_outs, first, count, leaks):
    """leaks[first..count] to begin with; returns the fragment of whose part `closed` is UNKNOWN, count: of none."""
    for k in range(first, count):
        leaks[k] = FRONT
        if cut_out_of(cut_outs, np.int64(f.part[k]), np.int64(f.triangle[k])) >= 0:
            leaks[k] = STAYS
        elif _shows_back(f, k, perspective):
            known = closed[f.part[k]]
            if known == UNKNOWN:
                return k
            leaks[k] = 0 if known else STAYS
    return count


@uncounted
def _close(ids, width, height, perspective, subpixel, f: Fragments, count, leaks):
    """See close_leaks."""
    found = np.int64(0)
    for y in range(height):
        for x in range(width):
            k = np.int64(ids[y, x])
            if k < 0 or leaks[k] < 0:
                continue
            if _surface_about(ids, width, height, x, y, perspective, subpixel, f, k, leaks) >= 0:
                leaks[k] += 1
                found += 1
            else:
                leaks[k] = STAYS  # as a whole: its other subpixels need no look
    if found == 0:
        return found
    closed = np.int64(0)
    for y in range(height):
        for x in range(width):
            k = np.int64(ids[y, x])
            if k >= 0 and leaks[k] > 0:
                g = _surface_about(ids, width, height, x, y, perspective, subpixel, f, k, leaks)
                if g >= 0:
                    ids[y, x] = g
                    f.count[g] += 1
                    closed += 1
    return closed
