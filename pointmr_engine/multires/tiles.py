"""Tiles of a traced image: fragments of one surface merge, few stand for many, and light changes across them."""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.baked.baking import materials_of
from pointmr_engine.forward.reconstruction.pixel_filter import Slopes, allocate_slopes
from pointmr_engine.forward.shading.fragment_surfaces import NO_EYES
from pointmr_engine.forward.tiles import Workspace
from pointmr_engine.multires.fragments.looks import end_behind_clumps, look_where_seen
from pointmr_engine.multires.fragments.merge import choose_seen, merge_fragments, renumber, thin_margin
from pointmr_engine.multires.fragments.representatives import (
    bring_forward,
    choose_representatives,
    lend_light,
)
from pointmr_engine.multires.fragments.slopes import COLUMNS, find_slopes
from pointmr_engine.multires.fragments.texture_slopes import take_texture_slopes

CELL = 4  # subpixels per side of the part of a cone in which fragments merge


class TracedTiles(Workspace):
    """One thread's buffers for tiles of an image (method.TracedImage)."""

    def __init__(self, image):
        super().__init__(image)
        n = len(self.fragments.entry)
        self.into, self.work = np.empty(n, np.int32), np.empty(n, np.int32)
        self.rank = np.empty(n, np.float32)
        self.seen = np.empty((n, 2), np.float32)
        # of all fragments, of which there are `all`, the one that each has its light from
        self.stands, self.all = np.empty(n, np.int32), 0
        # in parts of the light of those that are shaded; None: not asked for
        self.textures = allocate_slopes(n)
        self.eyes = NO_EYES  # that see the fragments
        side = len(self.target.ids) // image.subpixels + 1
        self.used = np.zeros((side, side), np.int32)

    @staticmethod
    def cell_of(image) -> int:
        return CELL

    def widen_footprints(self, first: int, width: np.ndarray) -> None:
        """Widen footprints width (n,) of fragments first.. to those of their cells; here all cells are as large."""

    def cone_widths(self, first: int, width: np.ndarray) -> np.ndarray:
        """(n,) how wide cones are, of fragments first.. with footprints width (n,)."""
        return self.image.cone / self.cell * width

    def look(self, first: int, rows: np.ndarray, direction: np.ndarray, rays) -> None:
        """Aim rays at fragments first + rows, through places of the image that show them: looks.look_where_seen."""
        image = self.image
        look_where_seen(
            image.view, np.int64(self.left), np.int64(self.low), image.camera.world_from_camera, self.fragments,
            np.int64(first), rows, self.seen, direction, rays,
        )  # fmt: skip

    def end_looks(self, hierarchy, first: int, rows: np.ndarray, hits, rays) -> None:
        """End the rays of `look` behind the clumps that the fragments show; hits: of these, without `first`."""
        end_behind_clumps(
            self.image.view, self.scratch.transforms.matrix, self.scratch.entries, hierarchy.sets.row, self.fragments,
            np.int64(first), rows, hits, rays,
        )  # fmt: skip

    def _add_lamps_in_front(self, count: int) -> None:
        """Nothing: the fragments' paths meet them (integrator.seen_lamps)."""

    def lend(self, count: int) -> None:
        """Give the fragments behind the first `count` the light of those that stand for them."""
        lend_light(self.light, self.stands, np.int64(count), np.int64(self.all))
        if self.held is not None:
            self.held[count : self.all] = self.held[self.stands[count : self.all]]

    def _slopes(self, count: int) -> Slopes:
        image, shaded, count = self.image, count, max(count, self.all)
        sums, slopes = np.empty((count, COLUMNS), np.float32), allocate_slopes(count)
        find_slopes(
            self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(self.cell),
            image.view.perspective, np.float64(image.footprint), self.fragments, self.light, np.int64(count), sums,
            slopes,
        )  # fmt: skip
        take_texture_slopes(self.textures, self.light, np.int64(shaded), slopes)
        return slopes

    def _fragments(self, hierarchy) -> int:
        count = super()._fragments(hierarchy)
        image = self.image
        merged = merge_fragments(
            self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(self.cell),
            image.view.perspective, np.float64(image.footprint), self.fragments, np.int64(count), self.into,
            self.rank,
        )  # fmt: skip
        if image.beside:
            merged = thin_margin(
                self.target.ids, np.int64(self.width), np.int64(self.height),
                np.int64(image.beside * image.subpixels), np.int64(image.cone), self.fragments, np.int64(merged),
                self.into, self.work,
            )  # fmt: skip
        shaded = self._stand_in(hierarchy, merged)
        choose_seen(
            self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(self.left), np.int64(self.low),
            self.target.shift, np.int64(merged), self.work, self.seen,
        )  # fmt: skip
        return shaded

    def _stand_in(self, hierarchy, count: int) -> int:
        """Put the fragments that are to be shaded before those that borrow their light; returns how many."""
        self.all = count
        f, material = self.fragments, np.empty(count, np.int32)
        materials_of(hierarchy.parts, f.part[:count], f.triangle[:count], material)
        shape = self.height // self.cell, self.width // self.cell
        choose_representatives(
            f, np.int64(count), self.image.shining[material], np.int64(self.cell), shape, np.int64(self.left),
            np.int64(self.low), np.int64(self.image.settings.seed), self.stands,
        )  # fmt: skip
        shaded = bring_forward(f, np.int64(count), self.stands, self.into, self.work)
        renumber(self.target.ids, np.int64(self.width), np.int64(self.height), self.into)
        return shaded
