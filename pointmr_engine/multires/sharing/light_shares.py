"""What fragments tell each other of their light: what their rays brought, and how fast that changes about them.

Light of the world is told with its gradient by the normal (Ward, Heckbert 1992, "Irradiance Gradients").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.shading.bsdf.layout import KIND_MASK, NORMAL, OREN_NAYAR, TRANSLUCENT, WEIGHT

MOST_DIFFUSE = 4  # diffuse rays of a fragment, each with light of its own to tell
DIM = 1e-4  # reflectance below which a fragment has nothing to share
# cosine: how light changes is told of lower rays as if they came from there, lest one of them outweighs all others
GRAZING = 0.1


class Shares(NamedTuple):
    """What the F fragments of a tile received of one kind of light; world space."""

    light: np.ndarray  # (F, 3) float32, as the surface reflects it
    albedo: np.ndarray  # (F, 3) float32: what it reflects; 0: does not share
    position: np.ndarray  # (F, 3) float64
    normal: np.ndarray  # (F, 3) float32
    rays: np.ndarray  # (F,) float32: how many asked
    nearness: np.ndarray  # (F,) float32: sum of 1 / distance of what they met
    worth: np.ndarray  # (F,) float32: how much what arrived counts
    width: np.ndarray  # (F,) float32: angle from which light arrives, against a hemisphere's
    turned: np.ndarray  # (F, 3) float32: of the sum of channels of what arrives, its gradient by the normal


def allocate_shares(n: int) -> Shares:
    """Room for n fragments, undefined."""
    f = np.float32
    return Shares(
        np.empty((n, 3), f),
        np.empty((n, 3), f),
        np.empty((n, 3)),
        np.empty((n, 3), f),
        np.empty(n, f),
        np.empty(n, f),
        np.empty(n, f),
        np.empty(n, f),
        np.empty((n, 3), f),
    )


@device
def clear_share(shares: Shares, row, x, y, z):
    """Row of a fragment at (x, y, z) that has nothing to share, and has received nothing."""
    shares.rays[row] = shares.nearness[row] = shares.worth[row] = shares.width[row] = np.float32(0)
    shares.position[row, 0], shares.position[row, 1], shares.position[row, 2] = x, y, z
    for c in range(3):
        shares.light[row, c] = shares.albedo[row, c] = np.float32(0)
        shares.normal[row, c] = shares.turned[row, c] = np.float32(0)


@device
def add_lobe(shares: Shares, row, passed, normal, rough):
    """A lobe that sends rays becomes part of what a fragment shares. passed: rgb of its albedo times throughput."""
    if shares.width[row] == 0 or 2.0 * rough < shares.width[row]:
        shares.width[row] = 2.0 * rough
        for c in range(3):
            shares.normal[row, c] = normal[c]
    for c in range(3):
        shares.albedo[row, c] += np.float32(passed[c])
    shares.worth[row] += np.float32(max(passed[0], passed[1], passed[2]))


@uncounted
def begin_shares(lobes, throughput, position, width, first, count, shares):
    """Rows first..first + count of `shares`: what the points 0..count reflect diffusely, nothing received yet.

    Matt lobes share what they reflect, if they have one normal and nothing lets light through; others keep theirs.
    width: angle from which light of the kind arrives, against a hemisphere's.
    """
    for k in range(count):
        row = first + k
        clear_share(shares, row, position[k, 0], position[k, 1], position[k, 2])
        shares.width[row], shares.worth[row] = np.float32(width), np.float32(1)
        single = True
        normal = np.int64(-1)
        for j in range(np.int64(lobes.count[k])):
            base = lobes.kind[k, j] & KIND_MASK
            single = single and base != TRANSLUCENT
            if base > OREN_NAYAR:
                continue
            if normal < 0:
                normal = np.int64(j)
            for c in range(3):
                single = single and lobes.data[k, j, NORMAL + c] == lobes.data[k, normal, NORMAL + c]
                shares.albedo[row, c] += throughput[k, c] * lobes.data[k, j, WEIGHT + c]
        for c in range(3):
            if normal >= 0:
                shares.normal[row, c] = lobes.data[k, normal, NORMAL + c]
            if not single:
                shares.albedo[row, c] = np.float32(0)


@uncounted
def count_lobe_rays(slot, triangle, t, closest, count, base, rays, near):
    """What rays of lobes met first, by their slots: paths 0..count of slots from `base` on, at t.

    closest (N,) float32: see `count_near`; rays, near (N,) float32: their number, and the sum of 1 / metres.
    """
    for i in range(count):
        k = np.int64(slot[i]) - base
        if k >= 0:
            rays[k] += np.float32(1)
            if triangle[i] != -1:
                near[k] += np.float32(1.0 / max(t[i], closest[k]))


@uncounted
def count_near(source, triangle, t, closest, count, first, shares):
    """Shadow rays 0..count of the fragments first + source (N,): what each met, at t.

    closest (N,) float32 by source: metres, nearer than which nothing counts as being: light that changes within a cone
    differs from fragment to fragment anyhow, as in hair, and the pixel filter takes its mean.
    """
    for i in range(count):
        if triangle[i] != -1:
            k = np.int64(source[i])
            shares.nearness[first + k] += np.float32(1.0 / max(t[i], closest[k]))


@uncounted
def count_blocked(source, triangle, t, far, width, closest, count, first, shares):
    """Count the shadow rays 0..count of fragments first + source: how fast their light changes along the surface.

    far (N,) float64: how far away the lights are; width (N,) float64 by source: angle from which light comes, against a
    hemisphere's; closest: see `count_near`.
    """
    for i in range(count):
        k = np.int64(source[i])
        shares.rays[first + k] += np.float32(1)
        if triangle[i] != -1:
            shares.nearness[first + k] += np.float32(
                shares.width[first + k] / (max(t[i], closest[k]) * width[k])
            )
        elif far[i] > 0.0:  # what arrives falls off with the distance
            shares.nearness[first + k] += np.float32(1.0 / far[i])


@uncounted
def take_reflected(light, part, source, triangle, count, first, shares):
    """Move `part` (N, 3) of the light of shadow rays 0..count that nothing stops to the fragments that share it."""
    for i in range(count):
        row = first + np.int64(source[i])
        if triangle[i] == -1 and has_to_share(shares, row):
            for c in range(3):
                shares.light[row, c] += part[i, c]
                light[i, c] -= part[i, c]


@uncounted
def keep_own(light, matt, glossy, source, triangle, count, own):
    """Add to own (N, 3) float64, by source, what rays 0..count bring to lobes that do not share."""
    for i in range(count):
        if triangle[i] == -1:
            k = np.int64(source[i])
            for c in range(3):
                own[k, c] += light[i, c] - matt[i, c] - glossy[i, c]


@uncounted
def take_turns(light, direction, source, triangle, count, first, shares):
    """Add how what rays 0..count bring to fragments first + source that share changes with their normals.

    light (N, 3): what matt lobes have of a ray, proportional to the cosine between its direction (N, 3) and the normal,
    however it was drawn.
    """
    for i in range(count):
        row = first + np.int64(source[i])
        if triangle[i] != -1 or not has_to_share(shares, row):
            continue
        _take_turn(light, direction, i, shares, row)


@device
def _take_turn(light, direction, i, shares, row):
    """Add how what ray i brings to fragment `row` changes with its normal; others as of `take_turns`."""
    cosine, arrived = 0.0, 0.0
    for c in range(3):
        cosine += np.float64(shares.normal[row, c]) * direction[i, c]
        if shares.albedo[row, c] > DIM:
            arrived += light[i, c] / np.float64(shares.albedo[row, c])
    for c in range(3):
        shares.turned[row, c] += np.float32(arrived / max(cosine, GRAZING) * direction[i, c])


@uncounted
def take_bounced(radiance, direction, first, count, shares):
    """What `count` rays have found, one of each of the fragments from `first` on, is shared by these.

    radiance, direction (N, 3) float64. How it changes with their normals is told, too: see `take_turns`.
    """
    for k in range(count):
        for c in range(3):
            shares.light[first + k, c] += np.float32(radiance[k, c])
        _take_turn(radiance, direction, k, shares, first + k)


@device
def has_to_share(shares: Shares, k):
    """Whether fragment k shares what it receives."""
    return max(shares.albedo[k, 0], shares.albedo[k, 1], shares.albedo[k, 2]) > 0.0


@uncounted
def take_light(radiance, before, own, first, count, shares):
    """Move what radiance (N, 3) has gained since `before` to the fragments first..first + count that share, but `own`.

    before, own (N, 3) float64: see keep_own.
    """
    for k in range(count):
        row = first + k
        if has_to_share(shares, row):
            for c in range(3):
                kept = before[k, c] + own[k, c]
                shares.light[row, c] += radiance[k, c] - kept
                radiance[k, c] = kept
