"""Candidates of sample sets: a group's triangles, whole or cut to pieces, and surfels that stand for its instances.

Strategies choose samples among them, and their moments sum to those of the surface. What is made of whole
triangles does not depend on the level, so it is kept for all levels that are built together.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.octree import CHAIN, MAX_LEVEL, SPACING, Octree
from pointmr_engine.hierarchy.pieces import cut
from pointmr_engine.hierarchy.surfels import (
    AREA,
    BLUE,
    NX,
    NZ,
    RED,
    XX,
    Surfels,
    X,
    allocate_surfels,
    chosen,
    joined,
    place_surfels,
    repeated,
)
from pointmr_engine.numerics.pointers import load_f32, load_i32

KEPT_WHOLES = 4_000_000  # items of a group whose whole triangles are kept; of larger groups a part at a time


class Look(NamedTuple):
    """What is baked of n surface points' materials, in the mesh's space."""

    normal: np.ndarray  # (n, 3) float32 shading normals, unit
    albedo: np.ndarray  # (n, 3) float32
    emission: np.ndarray  # (n, 3) float32 radiance
    alpha: np.ndarray  # (n,) float32


Looks = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray], Look]
Cover = Callable[[int, int], Surfels]


class _Wholes(NamedTuple):
    """Surfels of the triangles among the items first..first + I of a group."""

    first: int
    before: np.ndarray  # (I + 1,) int32: number of triangles before each item
    surfels: Surfels
    longest: np.ndarray  # (triangles,) float64, their longest edges


class Candidates:
    """Candidates of an octree's groups, for threads that build sets side by side.

    looks: see sample_sets.SampleSets. cover(group, level): all of a group's surface as surfels of that level.
    """

    def __init__(self, octree: Octree, looks: Looks, cover: Cover):
        self.octree, self.looks, self.cover = octree, looks, cover
        self._kept: dict[int, _Wholes] = {}
        self._locks: dict[int, threading.Lock] = {}

    def clear(self) -> None:
        """Forget what was kept for further levels."""
        self._kept.clear()

    def gather(self, g: int, ranges: np.ndarray, piece: float, spacing: float) -> tuple[Surfels, np.ndarray]:
        """(surfels with an area, int32 the interval that each belongs to) of all items in the intervals (R, 2) int64.

        In group g's space. Triangles are cut to pieces of size `piece`; instances are covered with surfels
        `spacing` apart.
        """
        low, high = (int(ranges[:, 0].min()), int(ranges[:, 1].max())) if len(ranges) else (0, 0)
        wholes = self._wholes(g, low, high)
        items = int((ranges[:, 1] - ranges[:, 0]).sum())
        # rows of whole triangles; items of long triangles and instances
        found = np.empty((3, items), np.int64)
        homes = np.empty((3, items), np.int32)
        counts = np.zeros(3, np.int64)
        _sort_out(
            ranges, self.octree.arrays.item, np.int64(wholes.first), wholes.before, wholes.surfels.row, wholes.longest,
            np.float64(piece), found, homes, counts,
        )  # fmt: skip
        whole, long, placed = (found[k, : counts[k]] for k in range(3))
        home = [homes[k, : counts[k]] for k in range(3)]
        if len(whole) and whole[-1] - whole[0] == len(whole) - 1:
            whole = slice(int(whole[0]), int(whole[-1]) + 1)  # rows rise: all between, which need no copy
        parts = [chosen(wholes.surfels, whole)]
        which = [home[0]]
        if len(long):
            pieces, of = self._pieces(g, long, piece)
            parts.append(pieces)
            which.append(home[1][of])
        if len(placed):
            self._instances(g, placed, home[2], spacing, parts, which)
        surfels, which = joined(parts), np.concatenate(which)
        empty = ~(surfels.row[:, AREA] > 0)
        if empty.any():
            kept = np.flatnonzero(~empty)
            surfels, which = chosen(surfels, kept), which[kept]
        return surfels, which

    # Triangles

    def _wholes(self, g: int, low: int, high: int) -> _Wholes:
        """The whole triangles among items low..high of group g, and perhaps others."""
        a = self.octree.arrays
        root = a.group_root[g]
        first, end = int(a.items[root, 0]), int(a.items[root, 3])
        if end - first > KEPT_WHOLES:
            return self._make_wholes(g, low, high)
        with self._locks.setdefault(g, threading.Lock()):
            if g not in self._kept:
                self._kept[g] = self._make_wholes(g, first, end)
            return self._kept[g]

    def _make_wholes(self, g: int, first: int, end: int) -> _Wholes:
        a, tables = self.octree.arrays, self.octree.geometry.tables
        item = a.item[first:end]
        before = np.zeros(len(item) + 1, np.int32)
        np.cumsum(item[:, 0] >= 0, out=before[1:])
        n = int(before[-1])
        surfels = allocate_surfels(n)
        longest, width = np.empty(n), np.empty(n, np.float32)
        _fill_wholes(
            item, tables.positions, tables.triangles, a.part_offset, a.group_center[g], surfels.row, surfels.source,
            longest, width,
        )  # fmt: skip
        surfels.place[:] = np.float32(1 / 3)
        return _Wholes(first, before, self._dressed(surfels, width), longest)

    def _pieces(self, g: int, items: np.ndarray, size: float) -> tuple[Surfels, np.ndarray]:
        """(surfels, index into `items` that each is a piece of) of triangles that are too long to stay whole."""
        a, tables = self.octree.arrays, self.octree.geometry.tables
        corners = np.empty((len(items), 3, 3))
        _corners(items, a.item, tables.positions, tables.triangles, a.part_offset, a.group_center[g], corners)
        pieces = cut(corners, size)
        surfels = allocate_surfels(len(pieces.triangle))
        _fill_pieces(
            pieces.triangle, pieces.position, pieces.covariance, pieces.area, pieces.u, pieces.v, items, a.item,
            surfels.row, surfels.source, surfels.place,
        )  # fmt: skip
        width = np.full(len(pieces.triangle), size, np.float32)
        return self._dressed(surfels, width), pieces.triangle

    def _dressed(self, surfels: Surfels, width: np.ndarray) -> Surfels:
        """The surfels with their materials; alpha takes its share of their areas."""
        source, place = surfels.source, surfels.place
        u, v = np.ascontiguousarray(place[:, 0]), np.ascontiguousarray(place[:, 1])
        look = self.looks(np.ascontiguousarray(source[:, 0]), np.ascontiguousarray(source[:, 1]), u, v, width)
        row = surfels.row
        row[:, AREA] *= look.alpha
        row[:, NX : NZ + 1] = look.normal
        row[:, RED : BLUE + 1] = look.albedo
        return surfels._replace(emission=look.emission) if look.emission.any() else surfels

    # Instances

    def weights(self, g: int, ranges: np.ndarray, spacing: float) -> np.ndarray:
        """Roughly how many candidates each interval of items (R, 2) has, covers `spacing` apart."""
        if not len(ranges):
            return np.zeros(0)
        lo, hi = int(ranges[:, 0].min()), int(ranges[:, 1].max())
        item = self.octree.arrays.item[lo:hi]
        own = np.ones(hi - lo)
        if (item[:, 0] < 0).any():
            # between the intervals lie instances far too large to cover this finely
            steps = np.zeros(hi - lo + 1, np.int64)
            np.add.at(steps, ranges[:, 0] - lo, 1)
            np.add.at(steps, ranges[:, 1] - lo, -1)
            inside = np.flatnonzero((np.cumsum(steps[:-1]) > 0) & (item[:, 0] < 0))
            for _, child, level, rows in self._covers(item[inside], spacing):
                own[inside[rows]] = len(self.cover(child, level).row)
        sums = np.concatenate([[0.0], np.cumsum(own)])
        return sums[ranges[:, 1] - lo] - sums[ranges[:, 0] - lo]

    def _covers(self, item: np.ndarray, spacing: float):
        """(batch, group, its level, rows of `item`) of instances (n, 2) that take the same cover."""
        if not len(item):
            return
        tables = self.octree.geometry.instances
        order = np.argsort(item[:, 0], kind="stable")[::-1]
        batches, first = np.unique(-1 - item[order, 0], return_index=True)
        for batch, rows in zip(
            batches.tolist(), np.split(order, first[1:]) if len(batches) else (), strict=True
        ):
            rows = np.sort(rows)
            placement = item[rows, 1]
            at, stride = tables.group[batch]
            which = 0 if at < 0 else tables.group_values[at + stride * placement.astype(np.int64)]
            child = np.broadcast_to(tables.batch_groups[tables.group_first[batch] + which], len(rows))
            linear = np.asarray(self.octree.geometry.batches[batch].transforms[placement, :, :3], np.float64)
            levels = self._cover_levels(child, np.sqrt((linear**2).sum(1).max(1)), spacing)
            both = child.astype(np.int64) * (MAX_LEVEL + 1) + levels
            for key in np.unique(both).tolist():
                yield batch, *divmod(key, MAX_LEVEL + 1), rows[both == key]

    def _cover_levels(self, child: np.ndarray, scale: np.ndarray, spacing: float) -> np.ndarray:
        """Levels at which groups `child`, placed with `scale`, have samples at most `spacing` apart."""
        root = np.ldexp(self.octree.arrays.group_side[child] * SPACING, CHAIN) * scale
        with np.errstate(divide="ignore"):
            levels = np.ceil(np.log2(np.maximum(root / spacing, 1e-300)))
        return np.clip(levels, 0, MAX_LEVEL).astype(np.int64)

    def _instances(self, g: int, items: np.ndarray, home: np.ndarray, spacing: float, parts, homes) -> None:
        a, tables = self.octree.arrays, self.octree.geometry.instances
        item = a.item[items]
        for batch, child, level, rows in self._covers(item, spacing):
            cover = self.cover(child, level)
            size = len(cover.row)
            if not size:
                continue
            placed = repeated(cover, len(rows))
            place_surfels(
                cover.row, np.uint64(tables.transforms[batch]), item[rows, 1].astype(np.int64),
                np.arange(len(rows)) * size, a.group_center[child], a.group_center[g], placed.row,
            )  # fmt: skip
            parts.append(placed)
            homes.append(np.repeat(home[rows], size))


_jit = njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _sort_out(ranges, item, first, before, row, longest, piece, found, homes, counts):
    """Items of the intervals: triangles that stay whole (with an area), those to be cut, and instances."""
    for r in range(len(ranges)):
        for i in range(ranges[r, 0], ranges[r, 1]):
            kind, value = 2, i
            if item[i, 0] >= 0:
                kind = 1
                t = np.int64(before[i - first])
                if longest[t] <= piece:
                    if not row[t, AREA] > 0:
                        continue
                    kind, value = 0, t
            found[kind, counts[kind]] = value
            homes[kind, counts[kind]] = r
            counts[kind] += 1


@_jit
def _corner(positions, triangles, part, triangle, offset, center, corner, k):
    v = load_i32(triangles[part], 3 * triangle + corner)
    return np.float64(load_f32(positions[part], 3 * v + k)) + (offset[part, k] - center[k])


@_jit
def _corners(items, item, positions, triangles, offset, center, out):
    for n in range(len(items)):
        part, triangle = np.int64(item[items[n], 0]), np.int64(item[items[n], 1])
        for c in range(3):
            for k in range(3):
                out[n, c, k] = _corner(positions, triangles, part, triangle, offset, center, c, k)


@_jit
def _fill_wholes(item, positions, triangles, offset, center, row, source, longest, width):
    """Moments of the triangles among the items; one without area keeps AREA 0."""
    p = np.empty((3, 3))
    n = 0
    for i in range(len(item)):
        if item[i, 0] < 0:
            continue
        part, triangle = np.int64(item[i, 0]), np.int64(item[i, 1])
        for c in range(3):
            for k in range(3):
                p[c, k] = _corner(positions, triangles, part, triangle, offset, center, c, k)
        ex, ey, ez = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
        fx, fy, fz = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
        nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
        area = 0.5 * np.sqrt(nx * nx + ny * ny + nz * nz)
        gx, gy, gz = fx - ex, fy - ey, fz - ez
        most = max(ex * ex + ey * ey + ez * ez, fx * fx + fy * fy + fz * fz, gx * gx + gy * gy + gz * gz)
        if not (area > 1e-37 and most < 1e37):
            area, most = 0.0, 0.0
        longest[n] = np.sqrt(most)
        width[n] = np.sqrt(2.0 * area)
        source[n, 0] = part
        source[n, 1] = triangle
        row[n, AREA] = area
        for k in range(3):
            row[n, X + k] = (p[0, k] + p[1, k] + p[2, k]) / 3.0
        m = XX
        for j in range(3):
            for k in range(j, 3):
                mj, mk = (p[0, j] + p[1, j] + p[2, j]) / 3.0, (p[0, k] + p[1, k] + p[2, k]) / 3.0
                value = 0.0
                for c in range(3):
                    value += (p[c, j] - mj) * (p[c, k] - mk)
                row[n, m] = value / 12.0
                m += 1
        n += 1


@_jit
def _fill_pieces(triangle, position, covariance, area, u, v, items, item, row, source, place):
    for n in range(len(triangle)):
        i = items[triangle[n]]
        source[n, 0], source[n, 1] = item[i, 0], item[i, 1]
        place[n, 0], place[n, 1] = u[n], v[n]
        row[n, AREA] = area[n]
        for k in range(3):
            row[n, X + k] = position[n, k]
        for k in range(6):
            row[n, XX + k] = covariance[n, k]
