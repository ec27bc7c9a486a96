"""Tiles whose visibility is alpha: lists of cells become fragments with weights, and weighted light becomes pixels."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.drawing.surfel_lanes import ALL_AREAS, PAD
from pointmr_engine.forward.reconstruction.fragments import Fragments, allocate_fragments
from pointmr_engine.forward.reconstruction.pixel_filter import NO_SLOPES, Slopes
from pointmr_engine.image.filters import filter_weight
from pointmr_engine.multires.alpha.a_buffer import (
    APART,
    AT_X,
    AT_Y,
    COVER,
    FULL,
    LEAST,
    ROOM,
    SIDE,
    allocate_layers,
    next_surface,
    put_behind,
    sort_cell,
)
from pointmr_engine.multires.alpha.layer_shapes import CUT, SIGMA
from pointmr_engine.multires.fragments.merge import copy_fragment, join, mergeable
from pointmr_engine.multires.tiles import CELL, TracedTiles
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import R2, pixel_seed

OF_CELL = CELL * CELL  # subpixels that a cell stands for: what counts of subpixels go by
MINOR = 0.15  # of the largest coverage in a surface: fragments with less are left to the others
GRAIN = 1.0 / 16.0  # of a cell: what weighs less is shaded by chance, in proportion, and then weighs this
FINE = 1024  # weights of fragments while they merge, in whole numbers


@device
def _thin_out(f: Fragments, weight, first, last, total, seed):
    """Leave few of fragments first..last that weigh less than GRAIN, each by as much more likely as it weighs more.

    They are chosen in one systematic sample; weights then sum to `total`. Returns the new end.
    """
    at, to, got = np.float64(seed) / 2.0**32, first, 0.0
    for k in range(first, last):
        w = np.float64(weight[k])
        if w < GRAIN:
            at += w / GRAIN
            if at < 1.0:
                continue
            at -= 1.0
            w = GRAIN
        f.entry[to], f.x[to], f.y[to] = f.entry[k], f.x[k], f.y[k]
        weight[to] = w
        got += w
        to += 1
    if to == first and last > first:  # one that is too light stands for all
        got, weight[to] = 1.0, 1.0
        to += 1
    for k in range(first, to):
        weight[k] *= np.float32(total / got)
    return to


@uncounted
def find_layers(
    target, width, height, left_cell, low_cell, fragments: Fragments, weight, first, clear, empty
):
    """Number the fragments of a tile's cells, in the order of cells; returns how many.

    first (H W + 1,) int64: filled, of each cell; weight (F,) float32: of each fragment in its cell; hidden ones
    get no number; clear (H, W) float32: what a cell lets through; empty (H, W) uint8: 1 where that
    is something. left_cell, low_cell: the tile's first cell in the image.
    """
    part, count = target.part, np.int64(0)
    for j in range(height):
        for i in range(width):
            begin = first[j * width + i] = count
            n = np.int64(target.ids[j, i]) + 1
            sort_cell(target, np.int64(j), np.int64(i), n)
            left, k = 1.0, np.int64(0)
            before, last, last_side = 1.0, 0.0, 0.0
            while k < n and left >= FULL:
                end, cover, _, side, one, other = next_surface(target, np.int64(j), np.int64(i), k, n)
                share, rest = put_behind(left, cover, side, before, last, last_side)
                if share < LEAST:
                    k = end
                    continue
                before, last, last_side = left, cover, side
                for m in range(k, end):  # what is hidden by the other side of the same surface
                    turned = part[j, i, m, SIDE]
                    part[j, i, m, COVER] *= np.float32(one if turned > 0 else (other if turned < 0 else 1.0))
                most = total = np.float32(0)
                for m in range(k, end):
                    most = max(most, part[j, i, m, COVER])
                for m in range(k, end):
                    if part[j, i, m, COVER] > np.float32(MINOR) * most:
                        total += part[j, i, m, COVER]
                for m in range(k, end):
                    if part[j, i, m, COVER] > np.float32(MINOR) * most:
                        fragments.entry[count] = target.entry[j, i, m]
                        fragments.x[count], fragments.y[count] = part[j, i, m, AT_X], part[j, i, m, AT_Y]
                        weight[count] = share * part[j, i, m, COVER] / total
                        count += 1
                left = rest
                k = end
            if left < FULL:
                left = 0.0
            count = _thin_out(
                fragments,
                weight,
                begin,
                count,
                1.0 - left,
                pixel_seed(left_cell + i, low_cell + j, np.int64(1)),
            )
            for m in range(begin, count):
                fragments.count[m] = max(np.int64(weight[m] * FINE), 1)
            clear[j, i] = left
            empty[j, i] = 1 if left > 0.0 else 0
    first[height * width] = count
    return count


@uncounted
def merge_cells(
    ids, width, height, left, low, perspective, footprint, fragments: Fragments, weight, first, largest, seen
):
    """Merge the fragments of each cell in place, as merge.merge_fragments does; returns how many are left.

    first, weight: as find_layers left them, and then of the merged ones. footprint: width of a cell at depth 1
    (perspective) or in metres. largest (F,) int32 to work in. ids (H, W): filled, the fragment that a cell shows most
    of. seen (F, 2) float32: a place of each in the tile, subpixels.
    left, low: the tile's first cell in the image.
    """
    f, groups = fragments, np.int64(0)
    for cell in range(height * width):
        begin, end = first[cell], first[cell + 1]
        own = first[cell] = groups
        for k in range(begin, end):
            size = footprint
            if perspective:
                size = footprint * f.position[k, 2]
            found = np.int64(-1)
            for g in range(own, groups):
                if mergeable(f, g, np.int64(k), size):
                    found = np.int64(g)
                    break
            if found >= 0:
                join(f, found, np.int64(k), f.count[k] > largest[found])
                largest[found] = max(f.count[k], largest[found])
                weight[found] += weight[k]
                continue
            if groups != k:
                copy_fragment(f, groups, np.int64(k))
                weight[groups] = weight[k]
            largest[groups] = f.count[groups]
            groups += 1
        best, most = np.int64(-1), np.float32(0)
        for g in range(own, groups):
            if weight[g] > most:
                best, most = np.int64(g), weight[g]
        ids[cell // width, cell % width] = best
        # a clump is looked at anywhere in its cell, evenly
        x, y = cell % width, cell // width
        turn = np.float64(pixel_seed(np.int64(left + x), np.int64(low + y), np.int64(0))) / 2.0**32
        for g in range(own, groups):
            u, v = turn + (g - own) * R2[0], 7.0 * turn + (g - own) * R2[1]
            seen[g, 0] = x + u - math.floor(u)
            seen[g, 1] = y + v - math.floor(v)
    first[height * width] = groups
    for g in range(groups):
        f.count[g] = max(np.int64(weight[g] * OF_CELL + 0.5), 1)
    return groups


@uncounted
def gather_cells(width, height, cells, first, weight, values, clear, background, out):
    """out (H, W, 4) float32: what the cells show of fragments with values (F, 3), and of the background behind them.

    background (rows, columns, 4) float32 of the tile's pixels, `cells` cells a side.
    """
    for j in range(height):
        for i in range(width):
            behind = background[j // cells, i // cells]
            rest = clear[j, i]
            a, b, c = rest * behind[0], rest * behind[1], rest * behind[2]
            d = rest * behind[3]
            for k in range(first[j * width + i], first[j * width + i + 1]):
                w = weight[k]
                a += w * values[k, 0]
                b += w * values[k, 1]
                c += w * values[k, 2]
                d += w
            out[j, i, 0], out[j, i, 1], out[j, i, 2], out[j, i, 3] = a, b, c, d


def cell_taps(kind: str, width: float, cells: int, taps: int) -> np.ndarray:
    """(taps,) float64 weights, of sum 1, of cells along one axis about a pixel's centre, `cells` of them to a pixel.

    Those with which the cells' Gaussians come closest to the filter (least squares), and none below 0.
    """
    at = (np.arange(taps) + 0.5 - 0.5 * taps) / cells
    x = np.linspace(-0.5 * taps / cells - 1.0, 0.5 * taps / cells + 1.0, 1024)
    wanted = filter_weight(kind, width, x)
    basis = np.exp(-0.5 * ((x[:, None] - at) * cells / SIGMA) ** 2)
    matrix, aim = np.einsum("xa,xb->ab", basis, basis), np.einsum("xa,x->a", basis, wanted)
    weights = np.full(taps, aim.sum() / matrix.sum())
    for _ in range(200):  # coordinate by coordinate; few are enough, for distant cells hardly overlap
        for k in range(taps):
            rest = aim[k] - (matrix[k] * weights).sum()
            weights[k] = max(weights[k] + rest / matrix[k, k], 0.0)
    return weights / weights.sum()


def use_alpha(image) -> None:
    """Have an image (multires.method.TracedImage) resolved by alpha; its subpixels are cells already."""
    image.space_of = AlphaTiles
    between = APART * image.footprint
    image.apart = (between, 0.0) if image.view.perspective else (0.0, between * image.view.depth_scale)
    settings = image.settings
    beside = image.beside * image.subpixels
    own = cell_taps(
        settings.pixel_filter, settings.filter_width, image.subpixels, len(image.taps) - 2 * beside
    )
    image.cell_taps = np.pad(own, beside)


class AlphaTiles(TracedTiles):
    """One thread's buffers for tiles that are resolved by alpha. A subpixel of the image is a cell here."""

    def __init__(self, image):
        super().__init__(image)
        self.textures = None  # no subpixel shows one fragment alone
        n = len(self.fragments.entry) * ROOM
        self.fragments = allocate_fragments(n)  # at most; untouched pages cost nothing
        self.weight, self.largest = np.empty(n, np.float32), np.empty(n, np.int32)
        self.seen = np.empty((n, 2), np.float32)
        self.light = np.empty((n, 3), np.float32)
        side = len(self.target.ids)
        self.first = np.empty(side * side + 1, np.int64)
        self.clear = np.empty((side, side), np.float32)
        self.cells = np.empty((side, side, 4), np.float32)

    @staticmethod
    def cell_of(image) -> int:
        return 1

    @staticmethod
    def target_of(image, side: int):
        return allocate_layers(side, side, image.apart)

    def begin(self, image) -> None:
        super().begin(image)
        self.scratch.constants[[PAD, ALL_AREAS]] = CUT * SIGMA, 1.0
        self.target.apart[:] = image.apart

    def shade(self, bounds, hierarchy, frame):
        missing = super().shade(bounds, hierarchy, frame)
        self.shading.counters.update(layers=self.layers)
        return missing

    def end_looks(self, hierarchy, first: int, rows: np.ndarray, hits, rays) -> None:
        """Looks do not end: clumps of one crown hide too much together, and what lies behind them makes up for it."""

    @property
    def taps(self) -> np.ndarray:
        return self.image.cell_taps

    def uncovered(self) -> np.ndarray:
        return self.clear

    def _slopes(self, count: int) -> Slopes:
        return NO_SLOPES  # no subpixel shows one fragment alone

    def _fragments(self, hierarchy) -> int:
        image, width, height = self.image, np.int64(self.width), np.int64(self.height)
        self.layers = int((self.target.ids[: self.height, : self.width] + 1).sum())
        count = find_layers(
            self.target,
            width,
            height,
            np.int64(self.left),
            np.int64(self.low),
            self.fragments,
            self.weight,
            self.first,
            self.clear,
            self.empty,
        )
        self._fill(hierarchy, count)
        return merge_cells(
            self.target.ids, width, height, np.int64(self.left), np.int64(self.low),
            image.view.perspective, np.float64(image.footprint), self.fragments,
            self.weight, self.first, self.largest, self.seen,
        )  # fmt: skip

    def _filtered(self, values, background, rows: int, columns: int) -> np.ndarray:
        image = self.image
        s, taps = image.subpixels, image.cell_taps
        gather_cells(
            np.int64(self.width), np.int64(self.height), np.int64(s), self.first, self.weight, values, self.clear,
            background, self.cells,
        )  # fmt: skip
        lines = np.zeros((rows, self.width, 4), np.float32)
        for k, weight in enumerate(taps.tolist()):
            lines += np.float32(weight) * self.cells[k : k + s * rows : s, : self.width]
        out = np.zeros((rows, columns, 4), np.float32)
        for k, weight in enumerate(taps.tolist()):
            out += np.float32(weight) * lines[:, k : k + s * columns : s]
        return out
