"""Surfels: samples that carry the moments of the piece of surface that they stand for (moment-matched surfels).

A surfel is a row of float32 in its group's space: where its piece's centroid lies, the piece's area and covariance, the
area-weighted mean of its normals - shorter than one where they differ - and of its colour. Kernels here place surfels
by an affine map and merge many into one (parallel-axis rule), so that coarse levels keep the moments of the fine ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.numerics.pointers import pointer_f64

X, Y, Z, XX, XY, XZ, YY, YZ, ZZ, AREA, NX, NY, NZ, RED, GREEN, BLUE = range(16)
COLUMNS = 16  # one cache line
FLAT, ROUND = 0.95, 0.5  # mean normals of this length count as one direction, as all directions


class Surfels(NamedTuple):
    """S samples. `row` is all that drawing with simple shading reads; the rest is read for visible samples only.

    AREA is that of the surface, less what pieces of one sample hide of each other (self_hiding).
    """

    row: np.ndarray  # (S, 16) float32: columns X to BLUE; positions relative to the group's centre
    # (S, 3) float32 radiance; or (1, 3), that of all: surfels that do not emit need no memory
    emission: np.ndarray
    source: np.ndarray  # (S, 2) int32: part and triangle in its shape that represent the piece
    place: np.ndarray  # (S, 2) float32: barycentric weights of that triangle's vertices 1 and 2


def allocate_surfels(n: int) -> Surfels:
    """Room for n surfels, undefined; they do not emit."""
    return Surfels(
        np.empty((n, COLUMNS), np.float32),
        np.zeros((1, 3), np.float32),
        np.empty((n, 2), np.int32),
        np.empty((n, 2), np.float32),
    )


def joined(parts: list[Surfels]) -> Surfels:
    """All surfels of the list, one after the other."""
    parts = [p for p in parts if len(p.row)]
    if len(parts) < 2:
        return parts[0] if parts else allocate_surfels(0)
    emission = np.zeros((1, 3), np.float32)
    if any(p.emission.any() for p in parts):
        emission = np.concatenate([np.broadcast_to(p.emission, (len(p.row), 3)) for p in parts])
    columns = (np.concatenate(c) for c in zip(*((p.row, p.source, p.place) for p in parts), strict=True))
    row, source, place = columns
    return Surfels(row, emission, source, place)


def chosen(surfels: Surfels, rows) -> Surfels:
    """The surfels at `rows` (a slice or an index array)."""
    row, emission, source, place = surfels
    emission = emission if len(emission) == 1 else emission[rows]
    if not len(emission):
        emission = np.zeros((1, 3), np.float32)
    return Surfels(row[rows], emission, source[rows], place[rows])


def repeated(surfels: Surfels, times: int) -> Surfels:
    """The surfels so many times over, all but their rows, which are undefined."""
    row, emission, source, place = surfels
    if len(emission) > 1:
        emission = np.tile(emission, (times, 1))
    rows = np.empty((len(row) * times, COLUMNS), np.float32)
    return Surfels(rows, emission, np.tile(source, (times, 1)), np.tile(place, (times, 1)))


@njit(cache=True, nogil=True, error_model="numpy")
def place_surfels(rows, address, placements, first, child_center, parent_center, out):
    """Copies of rows (S, 16) under the placements' matrices: out[first[k] : first[k] + S] for placements[k].

    address: of (N, 3, 4) float64 matrices parent_from_child. Areas scale as a surface with the row's normal does.
    """
    m = pointer_f64(address)
    size = len(rows)
    for k in range(len(placements)):
        at = 12 * placements[k]
        a, b, c = m[at], m[at + 1], m[at + 2]
        d, e, f = m[at + 4], m[at + 5], m[at + 6]
        g, h, i = m[at + 8], m[at + 9], m[at + 10]
        x0 = a * child_center[0] + b * child_center[1] + c * child_center[2] + m[at + 3] - parent_center[0]
        y0 = d * child_center[0] + e * child_center[1] + f * child_center[2] + m[at + 7] - parent_center[1]
        z0 = g * child_center[0] + h * child_center[1] + i * child_center[2] + m[at + 11] - parent_center[2]
        # cofactors carry normals, and their length is the scale of areas
        c00, c01, c02 = e * i - f * h, f * g - d * i, d * h - e * g
        c10, c11, c12 = h * c - i * b, i * a - g * c, g * b - h * a
        c20, c21, c22 = b * f - c * e, c * d - a * f, a * e - b * d
        mean = np.sqrt((c00 * c00 + c01 * c01 + c02 * c02 + c10 * c10 + c11 * c11 + c12 * c12
                        + c20 * c20 + c21 * c21 + c22 * c22) / 3.0)  # fmt: skip
        for j in range(size):
            o = first[k] + j
            x, y, z = rows[j, X], rows[j, Y], rows[j, Z]
            out[o, X] = a * x + b * y + c * z + x0
            out[o, Y] = d * x + e * y + f * z + y0
            out[o, Z] = g * x + h * y + i * z + z0
            xx, xy, xz = rows[j, XX], rows[j, XY], rows[j, XZ]
            yy, yz, zz = rows[j, YY], rows[j, YZ], rows[j, ZZ]
            ax, ay, az = a * xx + b * xy + c * xz, a * xy + b * yy + c * yz, a * xz + b * yz + c * zz
            dx, dy, dz = d * xx + e * xy + f * xz, d * xy + e * yy + f * yz, d * xz + e * yz + f * zz
            gx, gy, gz = g * xx + h * xy + i * xz, g * xy + h * yy + i * yz, g * xz + h * yz + i * zz
            out[o, XX] = ax * a + ay * b + az * c
            out[o, XY] = ax * d + ay * e + az * f
            out[o, XZ] = ax * g + ay * h + az * i
            out[o, YY] = dx * d + dy * e + dz * f
            out[o, YZ] = dx * g + dy * h + dz * i
            out[o, ZZ] = gx * g + gy * h + gz * i
            nx, ny, nz = rows[j, NX], rows[j, NY], rows[j, NZ]
            px = c00 * nx + c01 * ny + c02 * nz
            py = c10 * nx + c11 * ny + c12 * nz
            pz = c20 * nx + c21 * ny + c22 * nz
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            grown = np.sqrt(px * px + py * py + pz * pz)
            scale = grown / length if length > 1e-3 else mean
            out[o, AREA] = rows[j, AREA] * scale
            back = length / grown if grown > 0.0 else 0.0
            out[o, NX], out[o, NY], out[o, NZ] = px * back, py * back, pz * back
            for q in range(RED, COLUMNS):
                out[o, q] = rows[j, q]


@njit(cache=True, nogil=True, error_model="numpy")
def merge_surfels(rows, emission, owner, representative, out, out_emission):
    """out[k] = all rows that owner names k, as one: sums of area and moments, means of normals and colours.

    rows (C, 16), emission (C, 3), owner (C,) int32 (-1: none), representative (K,) int32 row of `rows`: normals are
    taken on its side, since a surface seen from behind looks the same. Owners without area become empty (AREA 0).
    An out_emission of one row is left as it is: nothing emits.
    """
    count = len(representative)
    sums = np.zeros((count, COLUMNS))
    glows = len(out_emission) == count
    last = len(emission) - 1
    light = np.zeros((len(out_emission), 3))
    for c in range(len(rows)):
        k = owner[c]
        if k < 0:
            continue
        r = representative[k]
        w = float(rows[c, AREA])
        # about the representative, so that nothing cancels
        x, y, z = (
            float(rows[c, X]) - rows[r, X],
            float(rows[c, Y]) - rows[r, Y],
            float(rows[c, Z]) - rows[r, Z],
        )
        sums[k, X] += w * x
        sums[k, Y] += w * y
        sums[k, Z] += w * z
        sums[k, XX] += w * (x * x + rows[c, XX])
        sums[k, XY] += w * (x * y + rows[c, XY])
        sums[k, XZ] += w * (x * z + rows[c, XZ])
        sums[k, YY] += w * (y * y + rows[c, YY])
        sums[k, YZ] += w * (y * z + rows[c, YZ])
        sums[k, ZZ] += w * (z * z + rows[c, ZZ])
        sums[k, AREA] += w
        side = rows[c, NX] * rows[r, NX] + rows[c, NY] * rows[r, NY] + rows[c, NZ] * rows[r, NZ]
        turned = -w if side < 0.0 else w
        sums[k, NX] += turned * rows[c, NX]
        sums[k, NY] += turned * rows[c, NY]
        sums[k, NZ] += turned * rows[c, NZ]
        for q in range(RED, COLUMNS):
            sums[k, q] += w * rows[c, q]
        if glows:
            for q in range(3):
                light[k, q] += w * emission[min(c, last), q]
    for k in range(count):
        w = sums[k, AREA]
        r = representative[k]
        out[k, AREA] = w
        if not w > 0.0:
            for q in range(COLUMNS):
                out[k, q] = np.float32(0)
            if glows:
                for q in range(3):
                    out_emission[k, q] = np.float32(0)
            continue
        s = 1.0 / w
        x, y, z = sums[k, X] * s, sums[k, Y] * s, sums[k, Z] * s
        out[k, X], out[k, Y], out[k, Z] = x + rows[r, X], y + rows[r, Y], z + rows[r, Z]
        out[k, XX], out[k, XY] = sums[k, XX] * s - x * x, sums[k, XY] * s - x * y
        out[k, XZ], out[k, YY] = sums[k, XZ] * s - x * z, sums[k, YY] * s - y * y
        out[k, YZ], out[k, ZZ] = sums[k, YZ] * s - y * z, sums[k, ZZ] * s - z * z
        for q in range(NX, COLUMNS):
            out[k, q] = sums[k, q] * s
        if glows:
            for q in range(3):
                out_emission[k, q] = light[k, q] * s


@njit(cache=True, nogil=True, error_model="numpy")
def typical_rows(rows, owner, merged, out):
    """out (K,) int64: of the rows that owner names k, the largest of those whose colour is nearest to merged[k]'s.

    What is evaluated later at one place of a sample's surface should look like the mean of it.
    """
    best = np.full(len(merged), np.inf)
    for c in range(len(rows)):
        k = owner[c]
        if k < 0 or not rows[c, AREA] > 0.0:
            continue
        difference = 0.0
        for q in range(RED, COLUMNS):
            difference += (rows[c, q] - merged[k, q]) ** 2
        if difference < best[k] or (difference == best[k] and rows[c, AREA] > rows[out[k], AREA]):
            best[k] = difference
            out[k] = c
