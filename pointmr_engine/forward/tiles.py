"""Tiles of an image: what is drawn becomes fragments, fragments get their light, and light is filtered into pixels."""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.baked.baking import materials_of
from pointmr_engine.forward.drawing.subpixels import allocate_target, beyond, clear, close_gaps, gap_limits
from pointmr_engine.forward.reconstruction.fragments import (
    allocate_fragments,
    fill_fragments,
    fill_normal_matrices,
    find_fragments,
)
from pointmr_engine.forward.reconstruction.leaks import close_leaks
from pointmr_engine.forward.reconstruction.pixel_filter import NO_SLOPES, Slopes, filter_tile
from pointmr_engine.forward.reconstruction.scattered import add_empty, add_fragments, count_shown, divide
from pointmr_engine.forward.selection.walk import WAITING, Hierarchy, Scratch, walk
from pointmr_engine.forward.shading.placement_values import allocate_placement_values, combine_placements
from pointmr_engine.forward.shading.shadow_map import ShadowMaps
from pointmr_engine.image.frame import NOTHING, Frame
from pointmr_engine.scene.group import CAMERA

TILE = 94  # pixels; with one more on each side for the filter, and four subpixels, whole blocks
WIDE_TILE = 190  # where a pixel has two subpixels a side, or one: the buffers stay in the second-level cache
LOOKS = 4  # of a pixel at lamps before the background, along each of its sides, at least


class Workspace:
    """One thread's buffers for tiles of an image (method.Image), drawn from static samples.

    Images that are drawn from something else override `draw` and `_fill`, and where they know exact areas `_filtered`.
    """

    def __init__(self, image):
        side = (image.tile + 2 * image.apron) * image.subpixels
        self.target = self.target_of(image, side)
        self.scratch = Scratch(self.target)
        self.fragments = allocate_fragments(side * side)  # at most; untouched pages cost nothing
        self.leaks = np.empty(side * side, np.int32)
        self.fragment_of = np.empty(1 << 16, np.int32)
        self.wanted = np.zeros(len(image.sampler.octree.arrays.box), np.uint8)
        self.placed = allocate_placement_values(0)
        self.light = np.empty((side * side, 3), np.float32)
        self.sums = np.empty((image.tile, 4 * side), np.float32)
        self.cell = self.cell_of(image)
        self.empty = np.zeros((side // self.cell + 1,) * 2, np.uint8)
        self.normals = np.empty((1 << 12, 9))
        self.line = np.empty((side, 4), np.float32)
        self.corners = np.empty((3, 3))
        self.background = np.zeros((image.tile + 2 * image.apron,) * 2 + (4,), np.float32)
        self.begin(image)

    @staticmethod
    def cell_of(image) -> int:
        """Subpixels per side of the cells in each of which a large triangle has a fragment of its own: a pixel."""
        return image.subpixels

    @staticmethod
    def target_of(image, side: int):
        """What tiles are drawn into: `side` subpixels square."""
        return allocate_target(side, side, image.subpixels)

    def begin(self, image) -> None:
        """Turn to another image, for which these buffers fit (method.Image.fits)."""
        self.image = image
        self.shaded = self.closed = 0
        self.scratch.counters[:] = 0
        # (lamps, fragments) share of light that arrives; or nothing
        self.shadow = np.zeros((0, 0), np.float32)
        self.shadow_maps = ShadowMaps(image) if image.shadows else None
        self.shading = None  # what the image's shading keeps for this thread

    def counts(self) -> dict:
        """Counters of the tiles drawn."""
        counters = dict(zip(self.scratch.names, self.scratch.counters.tolist(), strict=True))
        return counters | {"fragments": self.shaded, "closed": self.closed}

    def rest(self) -> None:
        """Let go of the image, which is finished, and of what its shading kept."""
        self.image = self.shading = self.shadow_maps = None

    def start_tile(self, bounds) -> None:
        """Empty the target for a tile x0, y0, x1, y1 of pixels, and an apron around it."""
        s, a = self.image.subpixels, self.image.apron
        x0, y0, x1, y1 = bounds
        self.left, self.low = (x0 - a) * s, (y0 - a) * s
        self.width, self.height = (x1 - x0 + 2 * a) * s, (y1 - y0 + 2 * a) * s
        clear(self.target, self.width, beyond(self.image.view))

    def draw(self, bounds, hierarchy: Hierarchy) -> np.ndarray | None:
        """Walk for a tile x0, y0, x1, y1 of pixels; returns the nodes whose sets it misses, None if it is complete."""
        image = self.image
        self.start_tile(bounds)
        counters = self.scratch.counters
        waiting = counters[WAITING]
        self.entries = walk(
            image.view, hierarchy, image.camera.camera_from_world, image.spacing,
            (self.left, self.low, self.left + self.width, self.low + self.height),
            self.scratch, self.wanted, image.settings.forward.occlusion_culling, self.cell, image.hardly,
        )  # fmt: skip
        if counters[WAITING] == waiting:
            return None
        missing = np.flatnonzero(self.wanted)
        self.wanted[missing] = 0
        return missing

    def shade(self, bounds, hierarchy: Hierarchy, frame: Frame) -> np.ndarray | None:
        """Shade what the tile shows, and filter it into the frame; returns nodes whose sets shadows miss, as `draw`."""
        count = self._fragments(hierarchy)
        self.shaded += count
        if self.shadow_maps is not None:
            missing = self.shadow_maps.trace(hierarchy, self.fragments, count, self.wanted)
            if missing is not None:
                return missing
            self.shadow = self.shadow_maps.share
        self.held = None
        self.image.shading.shade(self, hierarchy, count)
        self._add_lamps_in_front(count)
        self.slopes = self._slopes(count)
        self._background(bounds)
        self._write(bounds, hierarchy, frame)
        return None

    def _fragments(self, hierarchy: Hierarchy) -> int:
        """Fill the tile's fragments, and its ids with their numbers; returns how many."""
        if len(self.fragment_of) < self.entries:
            self.fragment_of = np.empty(2 * self.entries, np.int32)
        self.fragment_of[: self.entries] = -1
        self.closed += close_gaps(
            self.target, np.int64(self.width), np.int64(self.height), self.scratch.entries.surfel,
            gap_limits(self.image.view, self.image.pixel / self.image.subpixels),
        )  # fmt: skip
        count = find_fragments(
            self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(self.cell),
            self.scratch.entries, self.fragment_of, self.empty, self.fragments,
        )  # fmt: skip
        self._fill(hierarchy, count)
        self.closed += close_leaks(
            self.target.ids, np.int64(self.width), np.int64(self.height), self.image.view.perspective,
            np.float64(self.image.pixel / self.image.subpixels), self.fragments, self.image.sampler.geometry,
            hierarchy.cut_outs, np.int64(count), self.leaks,
        )  # fmt: skip
        return count

    def _fill(self, hierarchy: Hierarchy, count: int) -> None:
        """Attributes of the fragments."""
        rows = int(self.scratch.used[1])
        if len(self.normals) < rows:
            self.normals = np.empty((2 * rows, 9))
        fill_normal_matrices(self.scratch.transforms.matrix, np.int64(rows), self.normals)
        fill_fragments(
            self.image.view, np.int64(self.left), np.int64(self.low), hierarchy.octree, hierarchy.sets,
            hierarchy.corners, hierarchy.parts, self.image.sampler.looks, self.scratch.transforms, self.normals,
            self.scratch.entries, self.fragments, count, self.corners,
        )  # fmt: skip

    def _slopes(self, count: int) -> Slopes:
        """How the light of fragments 0..count changes across them."""
        return NO_SLOPES

    def placement_values(self, hierarchy: Hierarchy):
        """What instances say about the tile's placements, a row each."""
        rows = int(self.scratch.used[1])
        if len(self.placed.path) < rows:
            self.placed = allocate_placement_values(2 * rows)
        combine_placements(self.scratch.transforms, hierarchy.instances, np.int64(rows), self.placed)
        return self.placed

    def _write(self, bounds, hierarchy: Hierarchy, frame: Frame) -> None:
        """All passes of the tile."""
        image, f, s = self.image, self.fragments, self.image.subpixels
        x0, y0 = image.region[:2]
        where = np.s_[bounds[1] - y0 : bounds[3] - y0, bounds[0] - x0 : bounds[2] - x0]
        rows, columns = bounds[3] - bounds[1], bounds[2] - bounds[0]

        def filtered(values, background):
            return self._filtered(values, background, rows, columns)

        combined, nothing = filtered(self.light, self.background), np.zeros_like(self.background)
        if self.held is not None:
            held = np.repeat(self.held[:, None], 3, 1)
            combined[:, :, 3] = np.maximum(combined[:, :, 3] - filtered(held, nothing)[:, :, 0], 0.0)
        lamps = self._lamps_behind(rows, columns)
        if lamps is not None:
            combined[:, :, :3] += lamps
        if image.settings.film_exposure != 1.0:
            combined[:, :, :3] *= image.settings.film_exposure
        if not np.isfinite(combined).all():
            np.nan_to_num(combined, copy=False)
        frame.passes["combined"][where] = combined
        if len(frame.passes) == 1:
            return
        middle = image.apron * s + s // 2
        nearest = self.target.ids[middle : self.height : s, middle : self.width : s][:rows, :columns]
        seen, k = nearest >= 0, np.maximum(nearest, 0)
        to_world = image.camera.world_from_camera
        for name, target in frame.passes.items():
            if name in ("emission", "diffuse_color", "normal"):
                values = {"emission": f.emission, "diffuse_color": f.albedo, "normal": f.normal}[name]
                block = filtered(values, nothing)[:, :, :3]
                if name == "emission":
                    block = block * image.settings.film_exposure
                elif name == "normal":
                    block = np.einsum("yxk,ck->yxc", block, to_world[:, :3])
            elif name == "depth":
                block = np.where(seen, f.position[k][..., 2], NOTHING)[..., None]
            elif name == "position":
                block = np.einsum("yxk,ck->yxc", f.position[k], to_world[:, :3])
                block = (block + to_world[:, 3]) * seen[..., None]
            elif name == "object_index":
                block = np.zeros((rows, columns, 1), np.float32)
                block[seen, 0] = self.placement_values(hierarchy).object_index[f.row[nearest[seen]]]
            elif name == "material_index":
                block, of = np.zeros((rows, columns, 1), np.float32), nearest[seen]
                material = np.zeros(len(of), np.int32)
                materials_of(hierarchy.parts, f.part[of], f.triangle[of], material)
                block[seen, 0] = image.material_index[material]
            elif name == "sample_count":
                block = np.ones((rows, columns, 1))
            else:
                continue
            target[where] = block

    def _filtered(self, values, background, rows: int, columns: int) -> np.ndarray:
        """(rows, columns, 4) float32 of the tile: values (F, 3) of the fragments, background (.., .., 4) elsewhere."""
        image = self.image
        out = np.empty((rows, columns, 4), np.float32)
        size = np.int64(self.width), np.int64(self.height), np.int64(image.subpixels)
        if image.settings.forward.reconstruction != "gaussian":
            filter_tile(
                self.target.ids, *size, values, background, image.taps, self.sums, self.line, out, self.fragments,
                self.slopes if values is self.light else NO_SLOPES,
            )  # fmt: skip
            return out
        f, total = self.fragments, np.zeros((rows, columns, 5))
        apron, sigma = np.int64(image.apron), np.float64(image.sigma)
        shown = np.zeros(int(self.target.ids[: self.height, : self.width].max(initial=-1)) + 1, np.int32)
        count_shown(self.target.ids, *size[:2], shown)
        add_fragments(f.x, f.y, shown, values, size[2], apron, sigma, total)
        add_empty(self.target.ids, *size, background, apron, sigma, total)
        divide(total, out)
        return out

    def _background(self, bounds) -> None:
        """World radiance of the tile's pixels that are not covered whole."""
        image, s = self.image, self.image.subpixels
        rows, columns = self.height // s, self.width // s
        n = s // self.cell
        empty = self.empty[: n * rows, : n * columns]
        background = self.background[:rows, :columns]
        background[:] = 0
        if image.settings.film_transparent or not empty.any():
            return
        uniform = image.sampler.environment.uniform(CAMERA)
        if uniform is not None:
            background[:, :, :3], background[:, :, 3] = uniform, 1  # where all is covered, nothing reads it
            return
        empty = empty.reshape(rows, n, columns, n).any((1, 3))
        y, x = np.nonzero(empty)
        background[y, x, :3] = image.sampler.environment.radiance(self._rays(x, y)[1], CAMERA)
        background[y, x, 3] = 1

    def _rays(
        self,
        x: np.ndarray,
        y: np.ndarray,
        u: float = 0.5,
        v: float = 0.5,
        eye: tuple[float, float] = (0.0, 0.0),
    ) -> tuple[np.ndarray, np.ndarray]:
        """(origins, unit directions) (n, 3) in world space of the tile's pixels (x, y), through u, v of each.

        eye: the point of the lens that they go through, metres from its centre.
        """
        image, view, s = self.image, self.image.view, self.image.subpixels
        place, d = np.zeros((len(x), 3)), np.zeros((len(x), 3))
        d[:, 2] = 1.0
        beside = d if view.perspective else place
        beside[:, 0] = (self.left + (x + u) * s - view.shift_x) / view.scale_x
        beside[:, 1] = (self.low + (y + v) * s - view.shift_y) / view.scale_y
        if eye != (0.0, 0.0):
            place[:, :2] += eye
            d[:, :2] -= np.array(eye) / image.camera.lens[1]
        place += view.near * d
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        to_world = image.camera.world_from_camera
        return place @ to_world[:, :3].T + to_world[:, 3], d @ to_world[:, :3].T

    def _lamps_behind(self, rows: int, columns: int) -> np.ndarray | None:
        """(rows, columns, 3) light of the lamps that the tile sees where nothing is drawn; None: of none."""
        lamps, image, s = self.image.in_view, self.image, self.image.subpixels
        if lamps.empty or not self.empty.any():
            return None
        high, wide = self.height // s, self.width // s
        y, x = (a.ravel() for a in np.mgrid[:high, :wide])
        near = lamps.near(*self._rays(x, y), image.pixel)
        x, y = x[near], y[near]
        if not len(x):
            return None
        looks = max(LOOKS, s // 2)
        looks = looks if s % looks == 0 else s
        seen = np.zeros((high, looks, wide, looks, 3), np.float32)
        reach, own = np.full(len(x), np.inf), np.empty((len(x), 3), np.float32)
        for j, i in np.ndindex(looks, looks):
            own[:] = 0.0
            # no two in one row or column, in which the edges of tubes would lie between looks
            place = (i + (j + 0.5) / looks) / looks, (j + (i + 0.5) / looks) / looks
            lamps.add(*self._rays(x, y, *place), reach, own)
            seen[y, j, x, i] = own
        seen = seen.reshape(high * looks, wide * looks, 3).repeat(s // looks, 0).repeat(s // looks, 1)
        seen *= self.uncovered()[: self.height, : self.width, None]
        for axis, count in ((1, columns), (0, rows)):
            windows = np.lib.stride_tricks.sliding_window_view(seen, len(self.taps), axis)
            seen = np.take(windows, s * np.arange(count), axis) @ self.taps.astype(np.float32)
        return seen

    @property
    def taps(self) -> np.ndarray:
        """The pixel filter's weights of subpixels along a side."""
        return self.image.taps

    def uncovered(self) -> np.ndarray:
        """(H, W) share of each subpixel where nothing is drawn."""
        return self.target.ids < 0

    def _add_lamps_in_front(self, count: int) -> None:
        """Add the lamps that the camera sees before fragments 0..count to their light."""
        image = self.image
        if image.in_view.empty or not count:
            return
        to_world = image.camera.world_from_camera
        place = self.fragments.position[:count].astype(np.float64)
        start = place * (image.view.near / np.maximum(place[:, 2:], 1e-300))
        if not image.view.perspective:
            start = place * (1.0, 1.0, 0.0) + (0.0, 0.0, image.view.near)
        way = place - start
        reach = np.linalg.norm(way, axis=1)
        direction = way @ to_world[:, :3].T / np.maximum(reach, 1e-300)[:, None]
        start = start @ to_world[:, :3].T + to_world[:, 3]
        image.in_view.add(start, direction, reach, self.light[:count])
