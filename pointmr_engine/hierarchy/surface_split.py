"""Samples in which a surface meets clutter, such as ground under grass, become two: the surface, and the rest.

Merged, they would be a clump, which is drawn with gaps, and the ground would be seen through. A group's own large
triangles are drawn as they are; this is for those of its instances' groups. A sample's pieces hold a surface if those
that lie in one plane fill the ellipse that they span, and it is not much smaller than a sample's share.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.surfels import AREA, NX, NY, NZ, XX, XY, XZ, YY, YZ, ZZ, X, Y, Z

PARALLEL = 0.85  # cosine: normals within it are the plane's
THIN = 0.25  # of the spacing: how far from the plane its pieces lie
FILLED = 0.6  # share of its ellipse that a surface fills
WIDE = 0.25  # of the square of the spacing: a smaller surface is clutter itself
REST = 0.1  # of the surface's area: as much clutter must there be
ROUNDS = 8  # of the power iteration for the dominant normal

_jit = njit(cache=True, nogil=True, error_model="numpy")


def split_surfaces(row: np.ndarray, owner: np.ndarray, representative: np.ndarray, spacing: float):
    """(owner (C,) int32, representative (K',) int32 or as given) with more samples than before where they are split.

    row (C, 16) float32 candidates; owner (C,) int32 the sample of each, -1: none; representative (K,) the candidate in
    the place of each sample. Candidates keep the sample that they had, or go to a new one.
    """
    planes, surface = np.empty((len(representative), 4)), np.empty(len(row), np.bool_)
    _find_planes(row, owner, representative, float(spacing), planes)
    part = np.empty(len(representative), np.int32)
    count = _choose(row, owner, representative, float(spacing), planes, surface, part)
    if not count:
        return owner, representative
    most = np.concatenate([representative, np.full(count, -1, representative.dtype)])
    owner = owner.copy()
    _move(row, surface, part, owner, most)
    return owner, most


@_jit
def _find_planes(row, owner, representative, spacing, planes):
    """planes (K, 4): dominant unit normal of each sample's pieces, and where along it they lie, from the
    representative."""
    count = len(representative)
    tensor, sums = np.zeros((count, 6)), np.zeros((count, 2))
    for c in range(len(row)):
        k = owner[c]
        if k >= 0:
            w = np.float64(row[c, AREA])
            x, y, z = np.float64(row[c, NX]), np.float64(row[c, NY]), np.float64(row[c, NZ])
            tensor[k, 0] += w * x * x
            tensor[k, 1] += w * x * y
            tensor[k, 2] += w * x * z
            tensor[k, 3] += w * y * y
            tensor[k, 4] += w * y * z
            tensor[k, 5] += w * z * z
    for k in range(count):
        t = tensor[k]
        x = y = z = 0.0
        if t[0] >= t[3] and t[0] >= t[5]:
            x, y, z = t[0], t[1], t[2]
        elif t[3] >= t[5]:
            x, y, z = t[1], t[3], t[4]
        else:
            x, y, z = t[2], t[4], t[5]
        for _ in range(ROUNDS):
            length = math.sqrt(x * x + y * y + z * z)
            if not length > 0.0:
                break
            x, y, z = x / length, y / length, z / length
            x, y, z = (
                t[0] * x + t[1] * y + t[2] * z,
                t[1] * x + t[3] * y + t[4] * z,
                t[2] * x + t[4] * y + t[5] * z,
            )
        length = math.sqrt(x * x + y * y + z * z)
        scale = 1.0 / length if length > 0.0 else 0.0
        planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3] = x * scale, y * scale, z * scale, 0.0
    for turn in range(2):  # the mean of all, then of those near it
        sums[:] = 0.0
        for c in range(len(row)):
            k = owner[c]
            if k >= 0 and _is_parallel(row, c, planes[k]):
                d = _distance(row, c, representative[k], planes[k])
                if turn == 0 or abs(d) < 2.0 * THIN * spacing:
                    sums[k, 0] += row[c, AREA] * (d + planes[k, 3])
                    sums[k, 1] += row[c, AREA]
        for k in range(count):
            if sums[k, 1] > 0.0:
                planes[k, 3] = sums[k, 0] / sums[k, 1]


@_jit
def _is_parallel(row, c, plane):
    along = row[c, NX] * plane[0] + row[c, NY] * plane[1] + row[c, NZ] * plane[2]
    return abs(along) > PARALLEL


@_jit
def _distance(row, c, r, plane):
    x, y, z = row[c, X] - row[r, X], row[c, Y] - row[r, Y], row[c, Z] - row[r, Z]
    return x * plane[0] + y * plane[1] + z * plane[2] - plane[3]


@_jit
def _choose(row, owner, representative, spacing, planes, surface, part):
    """Which candidates lie in their sample's plane; part (K,): the new sample of the rest, -1: it stays whole.

    Returns the number of new samples.
    """
    count = len(representative)
    sums = np.zeros((count, 11))  # of the surface: area, place, moments; area of the rest
    for c in range(len(row)):
        k = owner[c]
        surface[c] = False
        if k < 0:
            continue
        w, r = np.float64(row[c, AREA]), representative[k]
        if not _is_parallel(row, c, planes[k]) or abs(_distance(row, c, r, planes[k])) > THIN * spacing:
            sums[k, 10] += w
            continue
        surface[c] = True
        x, y, z = (
            np.float64(row[c, X]) - row[r, X],
            np.float64(row[c, Y]) - row[r, Y],
            np.float64(row[c, Z]) - row[r, Z],
        )
        sums[k, 0] += w
        sums[k, 1] += w * x
        sums[k, 2] += w * y
        sums[k, 3] += w * z
        sums[k, 4] += w * (x * x + row[c, XX])
        sums[k, 5] += w * (x * y + row[c, XY])
        sums[k, 6] += w * (x * z + row[c, XZ])
        sums[k, 7] += w * (y * y + row[c, YY])
        sums[k, 8] += w * (y * z + row[c, YZ])
        sums[k, 9] += w * (z * z + row[c, ZZ])
    new = 0
    for k in range(count):
        part[k] = -1
        area = sums[k, 0]
        if not area > WIDE * spacing * spacing or not sums[k, 10] > REST * area:
            continue
        s = sums[k] / area
        a, b, c = s[4] - s[1] * s[1], s[5] - s[1] * s[2], s[6] - s[1] * s[3]
        d, e, f = s[7] - s[2] * s[2], s[8] - s[2] * s[3], s[9] - s[3] * s[3]
        # the determinant in the plane: n . adj(V) n
        x, y, z = planes[k, 0], planes[k, 1], planes[k, 2]
        flat = (
            x * x * (d * f - e * e) + y * y * (a * f - c * c) + z * z * (a * d - b * b)
            + 2.0 * (x * y * (c * e - b * f) + x * z * (b * e - c * d) + y * z * (b * c - a * e))
        )  # fmt: skip
        if area > FILLED * 4.0 * math.pi * math.sqrt(max(flat, 0.0)):
            part[k] = count + new
            new += 1
    return new


@_jit
def _move(row, surface, part, owner, representative):
    """Give the rest of split samples to the new ones, and to both the largest of their pieces as representatives."""
    for k in range(len(part)):
        if part[k] >= 0:
            representative[k] = -1
    for c in range(len(row)):
        k = owner[c]
        if k < 0 or part[k] < 0:
            continue
        if not surface[c]:
            k = part[k]
            owner[c] = k
        r = representative[k]
        if r < 0 or row[c, AREA] > row[r, AREA]:
            representative[k] = c
