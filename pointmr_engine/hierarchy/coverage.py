"""Coverage: how far a surface is from the samples that stand for it, proven for every point of it, and holes filled.

A convex piece of surface lies within r of the samples if one of them lies within r of all its corners; pieces for which
that fails are halved until it holds or one of their points is proven to be farther away (branch and bound).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.nearest import STACK, PointTree, build_tree, descend, squared
from pointmr_engine.hierarchy.pieces import as_triangles, halve, measure, positive, whole
from pointmr_engine.hierarchy.strategies import neighbourhood
from pointmr_engine.scene.errors import SceneError

_jit = njit(cache=True, nogil=True, error_model="numpy")

_PARTS = 512  # parts of one triangle that wait
_LARGE = 0.25  # of the spacing: a hole is not filled from pieces that are larger
_SMALL = 1.0 / 512.0  # of the spacing: pieces that are smaller get a sample where the proof fails


class Extra(NamedTuple):
    """K points added where a surface was not covered."""

    position: np.ndarray  # (K, 3) float32
    triangle: np.ndarray  # (K,) int32
    u: np.ndarray  # (K,) float32, as in Pieces
    v: np.ndarray  # (K,) float32


def verified_radius(triangles: np.ndarray, samples: np.ndarray, tolerance: float = 1e-3) -> float:
    """An upper bound of the largest distance from any point of triangles (T, 3, 3) to the nearest of samples (K, 3).

    At most 1 + tolerance times the true distance. Triangles without area count nothing. Without triangles 0, without
    samples infinite.
    """
    triangles = as_triangles(triangles)
    tolerance = positive(tolerance, "tolerance")
    samples = _points(samples)
    if len(samples) == 0:
        return math.inf if len(triangles) else 0.0
    return float(_radius(triangles, build_tree(samples), tolerance, *_room()))


def fill_uncovered(triangles: np.ndarray, samples: np.ndarray, spacing: float) -> Extra:
    """Points of triangles (T, 3, 3) that bring every point of them within `spacing` of a sample.

    samples (K, 3), in the space of the triangles. Few are added where they miss only slivers between the candidates
    that they were chosen from. Raises SceneError where float32 positions are too coarse for the spacing.
    """
    triangles = as_triangles(triangles)
    samples = _points(samples)
    spacing = positive(spacing, "spacing")
    found = _nothing()
    which = np.arange(len(triangles), dtype=np.int64)
    while True:
        # a piece near which a point was added may still reach beyond it: look again where there was something to add
        tree = build_tree(np.concatenate([samples, found.position]))
        bare = _bare(triangles, which, tree, spacing)
        if len(bare.triangle) == 0:
            return found
        if np.abs(bare.position).max() > spacing * 2**21:
            # rounded to float32, an added point would not cover what it was added for
            raise SceneError(
                f"a spacing of {spacing:g} is too fine for points as far from the origin as these"
            )
        chosen = neighbourhood.select(
            bare.position, np.ones(len(bare.u), np.float32), spacing, 0
        ).representative
        found = Extra(*(np.concatenate([a, b[chosen]]) for a, b in zip(found, bare, strict=True)))
        which = np.unique(bare.triangle).astype(np.int64)


def _points(samples: np.ndarray) -> np.ndarray:
    samples = np.ascontiguousarray(samples, np.float32).reshape(-1, 3)
    if not np.isfinite(samples).all():
        raise SceneError("samples must be finite")
    return samples


def _nothing() -> Extra:
    return Extra(
        np.empty((0, 3), np.float32), np.empty(0, np.int32), np.empty(0, np.float32), np.empty(0, np.float32)
    )


def _room() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.empty((_PARTS, 6)), np.empty((STACK, 3), np.int64), np.empty(STACK)


def _bare(triangles: np.ndarray, which: np.ndarray, tree: PointTree, spacing: float) -> Extra:
    """Centres of uncovered pieces of some triangles: a pass that counts, and one that writes if there are any."""
    part, stack, gap = _room()
    count = _uncovered(triangles, which, tree, spacing, part, stack, gap, _nothing())
    bare = Extra(
        np.empty((count, 3), np.float32),
        np.empty(count, np.int32),
        np.empty(count, np.float32),
        np.empty(count, np.float32),
    )
    if count:
        _uncovered(triangles, which, tree, spacing, part, stack, gap, bare)
    return bare


@_jit
def _load(triangles, t, part, top, corner):
    """Write a part's corners to rows 0 to 2 of corner, its centre to row 3; its longest edge, squared, and which."""
    for k in range(3):
        a, b, c = triangles[t, 0, k], triangles[t, 1, k], triangles[t, 2, k]
        for i in range(3):
            u, v = part[top, 2 * i], part[top, 2 * i + 1]
            corner[i, k] = (1.0 - u - v) * a + u * b + v * c
        corner[3, k] = (corner[0, k] + corner[1, k] + corner[2, k]) / 3.0
    longest, edge = -1.0, 0
    for i in range(3):
        d2 = 0.0
        for k in range(3):
            d = corner[(i + 1) % 3, k] - corner[i, k]
            d2 += d * d
        if d2 > longest:
            longest, edge = d2, i
    return longest, edge


@_jit
def _farthest(tree, i, corner):
    """Squared distance of the tree's point i to the corner that is farthest from it."""
    most = 0.0
    for j in range(3):
        most = max(most, squared(tree, i, corner[j, 0], corner[j, 1], corner[j, 2]))
    return most


@_jit
def _cover(tree, corner, enough, guess, stack, gap):
    """(place, bound, least): the sample whose farthest corner is nearest, its squared distance, and that of the centre.

    All squared. Stops with the first sample whose bound is at most `enough`; then `least` may be too large.
    """
    x, y, z = corner[3, 0], corner[3, 1], corner[3, 2]
    best, bound, least = guess, _farthest(tree, guess, corner), squared(tree, guess, x, y, z)
    if bound <= enough:
        return best, bound, least
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, len(tree.point)
    gap[0] = 0.0
    top = 1
    while top > 0:
        top -= 1
        # the farthest corner is at least as far as the centre: one bound serves both searches
        if gap[top] >= bound:
            continue
        low, high, top = descend(tree, x, y, z, bound, stack, gap, top)
        for i in range(low, high):
            d2 = squared(tree, i, x, y, z)
            least = min(least, d2)
            if d2 < bound:
                far = _farthest(tree, i, corner)
                if far < bound:
                    best, bound = i, far
                    if bound <= enough:
                        return best, bound, least
    return best, bound, least


@_jit
def _radius(triangles, tree, tolerance, part, stack, gap):
    corner = np.empty((4, 3))
    slack = (1.0 + tolerance) ** 2
    proven = 0.0  # squared distance of the farthest point met so far
    unproven = 0.0  # squared bound of parts too small to be halved
    guess = np.int64(0)
    # first the centres alone: the sooner a far point is met, the fewer parts must be looked into
    for exact in range(2):
        for t in range(len(triangles)):
            area, _ = measure(triangles, t)
            if area == 0.0:
                continue
            whole(part)
            top = 0
            while top >= 0:
                longest, edge = _load(triangles, t, part, top, corner)
                guess, bound, least = _cover(tree, corner, proven * slack, guess, stack, gap)
                if bound > proven * slack:
                    proven = max(proven, least)
                    if exact == 1 and bound > proven * slack:
                        if top < _PARTS - 2 and longest > 1e-60:
                            halve(part, top, edge)
                            top += 2
                        else:
                            unproven = max(unproven, bound)
                top -= 1
    return math.sqrt(max(proven * slack, unproven))


@_jit
def _uncovered(triangles, which, tree, spacing, part, stack, gap, bare):
    """Write the centres of uncovered pieces, as far as there is room in `bare`; how many there are."""
    corner = np.empty((4, 3))
    enough = spacing * spacing
    count = 0
    guess = np.int64(0)
    for w in range(len(which)):
        t = which[w]
        area, _ = measure(triangles, t)
        if area == 0.0:
            continue
        whole(part)
        top = 0
        while top >= 0:
            longest, edge = _load(triangles, t, part, top, corner)
            bound = least = np.inf
            if len(tree.point) > 0:
                guess, bound, least = _cover(tree, corner, enough, guess, stack, gap)
            if bound > enough:
                done = least > enough and longest <= (_LARGE * spacing) ** 2
                if done or longest <= (_SMALL * spacing) ** 2 or top >= _PARTS - 2:
                    if count < len(bare.u):
                        u = (part[top, 0] + part[top, 2] + part[top, 4]) / 3.0
                        v = (part[top, 1] + part[top, 3] + part[top, 5]) / 3.0
                        for k in range(3):
                            bare.position[count, k] = corner[3, k]
                        bare.triangle[count] = t
                        bare.u[count] = u
                        bare.v[count] = v
                    count += 1
                else:
                    halve(part, top, edge)
                    top += 2
            top -= 1
    return count
