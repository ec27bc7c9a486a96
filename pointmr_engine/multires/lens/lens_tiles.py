"""Tiles drawn from several points of the lens: fragments of all views, merged before they are shaded."""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.baked.baking import materials_of
from pointmr_engine.forward.drawing.draw import Entries
from pointmr_engine.forward.drawing.subpixels import (
    allocate_target,
    beyond,
    clear,
    close_gaps,
    gap_limits,
    thresholds,
)
from pointmr_engine.forward.drawing.transforms import grow_transforms
from pointmr_engine.forward.method import depth_range
from pointmr_engine.forward.reconstruction.fragments import (
    Fragments,
    allocate_fragments,
    fill_fragments,
    fill_normal_matrices,
    find_fragments,
)
from pointmr_engine.forward.reconstruction.leaks import close_leaks
from pointmr_engine.forward.reconstruction.pixel_filter import NO_SLOPES, Slopes, allocate_slopes, filter_tile
from pointmr_engine.forward.selection.walk import WAITING, Scratch, walk
from pointmr_engine.forward.shading.placement_values import (
    PlacementValues,
    allocate_placement_values,
    combine_placements,
)
from pointmr_engine.multires.fragments.looks import look_through_lens
from pointmr_engine.multires.fragments.merge import choose_seen, renumber
from pointmr_engine.multires.fragments.slopes import COLUMNS, find_slopes_by_key
from pointmr_engine.multires.fragments.texture_slopes import take_texture_slopes
from pointmr_engine.multires.lens.lens import (
    LensView,
    confusion,
    lens_rays,
    make_views,
    sharpest,
    views_per_side,
)
from pointmr_engine.multires.lens.lens_merge import (
    MIXED,
    ROW,
    VIEW,
    light_where_seen,
    merge_views,
    place_merged,
)
from pointmr_engine.multires.tiles import TracedTiles
from pointmr_engine.numerics.dither import SIDE
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.scene.group import CAMERA

BLURRED = 2.0  # pixels: circles of confusion from this size on are shaded in larger cells


@uncounted
def deal_out(ids, width, height, side, column, row, first, subpixels, out, empty, turns):
    """Write a view's fragments to its subpixels of the image; count those that show nothing.

    turns (N,) uint8, zeros: which of two by two subpixels show a fragment, a bit each; they begin elsewhere from view
    to view, so that what shows of the views at one turn is spread evenly.

    ids: of the view's target, width x height subpixels; first: number of its first fragment; out (H, W) int32; empty
    (rows, columns) int32: subpixels per pixel of the tile that show nothing.
    """
    for y in range(height):
        for x in range(width):
            k = np.int64(ids[y, x])
            out[y * side + row, x * side + column] = np.int32(k + first if k >= 0 else k)
            if k < 0:
                empty[(y * side + row) // subpixels, (x * side + column) // subpixels] += 1
            else:
                turns[k] |= 1 << (((x ^ column) & 1) + 2 * ((y ^ row) & 1))


def split_lens(image) -> None:
    """Have an image (multires.method.TracedImage) drawn through its lens, if anything is out of focus."""
    octree = image.sampler.octree
    root = len(image.sampler.geometry.groups) - 1
    near, far = depth_range(image.camera.camera_from_world, octree.lower[root], octree.upper[root])
    if image.sampler.environment.constant is None and not image.settings.film_transparent:
        far = np.inf  # the world
    diameter = confusion(image.camera, image.view, (near, far))
    side = views_per_side(diameter, image.subpixels)
    if side == 1:
        return
    image.views = make_views(image.camera, image.view, image.subpixels, side)
    image.side = side
    image.lens_rays = lens_rays(image.views)
    image.sharpest = sharpest(image.sampler.programs)
    image.space_of = LensTiles


class LensTiles(TracedTiles):
    """One thread's buffers for tiles that are drawn from several points of the lens."""

    def __init__(self, image):
        super().__init__(image)
        side, n = len(self.target.ids), len(self.fragments.entry)
        self.part = allocate_target(side // image.side, side // image.side)
        # views look at other places of a dither: what they show of a pixel together is all of it
        step = max(SIDE // image.side, 1)
        self.patterns = [thresholds(step * v.column % SIDE, step * v.row % SIDE) for v in image.views]
        self.shifts = [_shift_of(self.target.shift, v, image.side) for v in image.views]
        self.own = Scratch(self.part)  # of the view that is drawn
        self.own.counters = self.scratch.counters
        self.scratch.entries = Entries(np.empty(n, np.int64), np.empty(0, np.int32))
        self.found = allocate_fragments(n)
        self.seen = np.empty((0, 2), np.float32)  # the views see a fragment in different subpixels
        self.shown = np.empty((n, 2), np.float32)
        self.of_view = np.empty(n, np.int32)
        self.kept, self.turns = np.empty(n, np.int64), np.empty(n, np.uint8)
        self.own_ids = np.empty_like(self.target.ids)  # before fragments merge
        self.own_light = np.empty((n, 3), np.float32)
        self.own_values = allocate_placement_values(0)
        side = len(self.background)
        self.open, self.open_in_view = np.zeros((side, side), np.int32), np.zeros((side, side), np.int32)
        self.sky = np.zeros((side, side, 3))
        self.ones = np.ones_like(self.background)
        self.gaps = np.zeros((len(self.part.ids) + 1,) * 2, np.uint8)

    def draw(self, bounds, hierarchy):
        """Draw the tile in every view; see Workspace.draw."""
        image, v = self.image, self.image.side
        self.start_tile(bounds)
        counters = self.scratch.counters
        waiting = counters[WAITING]
        self.count = 0
        self.scratch.used[1] = 0
        self.open[:], self.sky[:] = 0, 0.0
        x, y, width, height = self.left // v, self.low // v, self.width // v, self.height // v
        for k, seen in enumerate(image.views):
            clear(self.part, width, beyond(seen.view))
            self.part.pattern[:], self.part.shift[:] = self.patterns[k], self.shifts[k]
            entries = walk(
                seen.view, hierarchy, seen.camera_from_world, image.spacing / v, (x, y, x + width, y + height),
                self.own, self.wanted, image.settings.forward.occlusion_culling, max(self.cell // v, 1),
            )  # fmt: skip
            if counters[WAITING] == waiting:
                self._take(hierarchy, k, seen, entries, (x, y, np.int64(width), np.int64(height)))
        if counters[WAITING] == waiting:
            return None
        missing = np.flatnonzero(self.wanted)
        self.wanted[missing] = 0
        return missing

    def _take(self, hierarchy, k: int, seen: LensView, entries: int, bounds) -> None:
        """Add the fragments that view k shows, in the camera space of the lens' centre."""
        image, v, first, own = self.image, self.image.side, self.count, self.own
        left, low, width, height = bounds
        if len(self.fragment_of) < entries:
            self.fragment_of = np.empty(2 * entries, np.int32)
        self.fragment_of[:entries] = -1
        limits = gap_limits(seen.view, image.pixel * v / image.subpixels)
        self.closed += close_gaps(self.part, width, height, own.entries.surfel, limits)
        f = Fragments(*(a[first:] for a in self.found))
        count = find_fragments(
            self.part.ids, width, height, np.int64(max(self.cell // v, 1)), own.entries, self.fragment_of,
            self.gaps, f,
        )  # fmt: skip
        rows = int(own.used[1])
        if len(self.normals) < rows:
            self.normals = np.empty((2 * rows, 9))
        fill_normal_matrices(own.transforms.matrix, np.int64(rows), self.normals)
        fill_fragments(
            seen.view, np.int64(left), np.int64(low), hierarchy.octree, hierarchy.sets, hierarchy.corners,
            hierarchy.parts, image.sampler.looks, own.transforms, self.normals, own.entries, f, count, self.corners,
        )  # fmt: skip
        self.closed += close_leaks(
            self.part.ids, width, height, seen.view.perspective,
            np.float64(image.pixel * v / image.subpixels), f, image.sampler.geometry, hierarchy.cut_outs,
            np.int64(count), self.leaks,
        )  # fmt: skip
        self.open_in_view[:] = 0
        turns = self.turns[first : first + count]
        turns[:] = 0
        deal_out(
            self.part.ids, width, height, np.int64(v), np.int64(seen.column), np.int64(seen.row), np.int64(first),
            np.int64(image.subpixels), self.target.ids, self.open_in_view, turns,
        )  # fmt: skip
        self._add_sky(seen)
        here = np.s_[first : first + count]
        self.scratch.entries.surfel[here] = own.entries.surfel[self.found.entry[here]]
        self.found.entry[here] = np.arange(first, first + count)
        self._keep_rows(hierarchy, seen, here, rows)
        position = self.found.position[here]
        position[:, 0] += seen.x - seen.shear_x * position[:, 2]
        position[:, 1] += seen.y - seen.shear_y * position[:, 2]
        if not image.view.perspective:
            _unshear(self.found.normal[here], seen)
            _unshear(self.found.geometric[here], seen)
        self.of_view[here] = k
        self.count += count

    def _keep_rows(self, hierarchy, seen: LensView, here: slice, rows: int) -> None:
        """Keep the placements of the fragments `here`, of a view's, and let the fragments refer to them."""
        own, kept = self.own, self.scratch
        if len(self.own_values.path) < rows:
            self.own_values = allocate_placement_values(2 * rows)
        combine_placements(own.transforms, hierarchy.instances, np.int64(rows), self.own_values)
        used, self.found.row[here] = np.unique(self.found.row[here], return_inverse=True)
        first = int(kept.used[1])
        last = first + len(used)
        self.found.row[here] += first
        if last > len(kept.transforms.parent):
            kept.transforms = grow_transforms(kept.transforms, first, 2 * last)
        if last > len(self.placed.path):
            larger = allocate_placement_values(2 * last)
            for old, new in zip(self.placed, larger, strict=True):
                new[:first] = old[:first]
            self.placed = larger
        for source, target in ((own.transforms, kept.transforms), (self.own_values, self.placed)):
            for old, new in zip(source, target, strict=True):
                new[first:last] = old[used]
        matrix = kept.transforms.matrix[first:last]
        matrix[:, 0:4] -= seen.shear_x * matrix[:, 8:12]
        matrix[:, 4:8] -= seen.shear_y * matrix[:, 8:12]
        matrix[:, 3] += seen.x
        matrix[:, 7] += seen.y
        kept.used[1] = last

    def placement_values(self, hierarchy) -> PlacementValues:
        return self.placed

    def _fragments(self, hierarchy) -> int:
        """Merge what the views show: fragments that the lens' centre would see in one cone, of one surface."""
        image, f, n = self.image, self.found, self.count
        view, z = image.view, self.found.position[:n, 2]
        scale = 1.0 / z if view.perspective else 1.0
        f.x[:n] = f.position[:n, 0] * scale * view.scale_x + view.shift_x - self.left
        f.y[:n] = f.position[:n, 1] * scale * view.scale_y + view.shift_y - self.low
        material = np.empty(n, np.int32)
        materials_of(hierarchy.parts, f.part[:n], f.triangle[:n], material)
        lens = image.camera.lens
        wide = lens[0] * max(lens[4], 1.0) / (z if view.perspective else lens[1])
        alone = image.sharpest[material] < wide if view.perspective else np.zeros(n, np.bool_)
        # cells as without a lens; twice as large where every pixel mixes many of them
        blur = 2.0 * lens[0] * np.abs(1.0 / z - 1.0 / lens[1] if view.perspective else 1.0 - z / lens[1])
        mixed = blur * abs(view.scale_y) > BLURRED * image.subpixels
        cell = np.where(mixed, 2 * self.cell, self.cell)
        single = 2 * max(self.cell, image.side)  # of which a view has two subpixels a side
        cell[alone] = single
        last = 1 << (ROW - 1)  # what lies far outside the tile is in the last cells
        i, j = (np.clip(a[:n] // cell, -last, last - 1).astype(np.int64) + last for a in (f.x, f.y))
        view_of = np.where(alone, self.of_view[:n].astype(np.int64) + 1, 0)
        key = (view_of << VIEW) + (mixed.astype(np.int64) << MIXED) + (j << ROW) + i
        order = np.argsort(key, kind="stable")
        self.own_place = f.x[:n].copy(), f.y[:n].copy()
        self.own_ids[: self.height, : self.width] = self.target.ids[: self.height, : self.width]
        self.times = np.empty(n, np.float32)
        count = merge_views(
            order, key, cell, view.perspective, np.float64(image.footprint), f, np.int64(n), self.into, self.rank,
            self.kept, np.empty(n, np.int64), self.times, self.turns, np.int64(self.left // single),
            np.int64(self.low // single), np.int64(image.settings.seed),
        )  # fmt: skip
        self.key, self.whole = key[self.kept[:count]], None
        renumber(self.target.ids, np.int64(self.width), np.int64(self.height), self.into)
        choose_seen(
            self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(self.left), np.int64(self.low),
            self.target.shift, np.int64(count), self.work, self.shown,
        )  # fmt: skip
        chosen = self.kept[:count]
        for old, new in zip(f, self.fragments, strict=True):
            new[:count] = old[chosen]
        place_merged(
            view, np.int64(self.left), np.int64(self.low), hierarchy.corners, self.scratch.transforms,
            self.scratch.entries.surfel, self.key, self.fragments, np.int64(count), self.corners,
        )  # fmt: skip
        points = np.array([(0.0, 0.0), *((v.x, v.y) for v in image.views)])
        self.eyes = points[self.key >> VIEW]
        return count

    def widen_footprints(self, first: int, width: np.ndarray) -> None:
        width *= self._larger(first, len(width))

    def cone_widths(self, first: int, width: np.ndarray) -> np.ndarray:
        return super().cone_widths(first, width) / self._larger(first, len(width))

    def _larger(self, first: int, count: int) -> np.ndarray:
        """(count,) float32: how much larger the cells of fragments first.. that views share are than without a lens."""
        key = self.key[first : first + count]
        return 1.0 + ((key >> MIXED & 1) & (key >> VIEW == 0)).astype(np.float32)

    def _slopes(self, count: int) -> Slopes:
        """Of what views share; what each asks for itself shows its light where it was asked."""
        image, slopes = self.image, allocate_slopes(count)
        shared = self.key[self.key >> VIEW == 0]
        n = len(shared)
        half = np.where(shared >> MIXED & 1, self.cell, 0.5 * self.cell).astype(np.float32)
        find_slopes_by_key(
            shared, np.int64(1), np.int64(1 << ROW), image.view.perspective, np.float64(image.footprint),
            self.fragments, self.light, half, np.empty((n, COLUMNS), np.float32), slopes,
        )  # fmt: skip
        slopes.x[n:], slopes.y[n:] = 0.0, 0.0
        take_texture_slopes(self.textures, self.light, np.int64(n), slopes)
        return slopes

    def _filtered(self, values, background, rows: int, columns: int) -> np.ndarray:
        """Of what the views saw before it merged, at its own places; see Workspace._filtered."""
        slopes = self.slopes if values is self.light else NO_SLOPES
        out = self._filter_own(values, slopes, background, rows, columns)
        if self.whole is None:  # of all passes of the tile
            ones = np.ones_like(values)
            self.whole = self._filter_own(ones, NO_SLOPES, self.ones, rows, columns)[:, :, :1]
        out[:, :, :3] /= self.whole
        return out

    def _filter_own(self, values, slopes: Slopes, background, rows: int, columns: int) -> np.ndarray:
        """(rows, columns, 4) float32: values (F, 3) of the merged fragments as often as they count."""
        image, (x, y) = self.image, self.own_place
        light_where_seen(x, y, self.into, self.times, values, self.fragments, slopes, self.own_light)
        out = np.empty((rows, columns, 4), np.float32)
        filter_tile(
            self.own_ids, np.int64(self.width), np.int64(self.height), np.int64(image.subpixels), self.own_light,
            background, image.taps, self.sums, self.line, out, self.fragments, NO_SLOPES,
        )  # fmt: skip
        return out

    def look(self, first: int, rows: np.ndarray, direction: np.ndarray, rays) -> None:
        image = self.image
        if not image.view.perspective:
            super().look(first, rows, direction, rays)
            return
        look_through_lens(
            image.view, image.lens_rays, np.int64(self.left), np.int64(self.low), np.int64(first), rows, self.shown,
            direction, rays,
        )  # fmt: skip

    def _add_sky(self, seen: LensView) -> None:
        """Add the world's radiance behind the open subpixels of a view, and that of lamps before it."""
        image, lamps = self.image, self.image.in_view
        shows_world = not image.settings.film_transparent
        y, x = np.nonzero(self.open_in_view)
        if not len(x) or (lamps.empty and not shows_world):
            return
        weight = self.open_in_view[y, x]
        if shows_world:
            _, direction = self._rays(x, y, eye=(seen.x, seen.y))
            self.sky[y, x] += weight[:, None] * image.sampler.environment.radiance(direction, CAMERA)
        if not lamps.empty:
            u, v = (seen.column + 0.5) / image.side, (seen.row + 0.5) / image.side
            light = np.zeros((len(x), 3), np.float32)
            lamps.add(*self._rays(x, y, u, v, (seen.x, seen.y)), np.full(len(x), np.inf), light)
            self.sky[y, x] += weight[:, None] * light
        self.open[y, x] += weight

    def _lamps_behind(self, rows: int, columns: int) -> None:
        """Nothing: they are in the background (`_add_sky`)."""

    def _background(self, bounds) -> None:
        """The world's mean radiance behind the open subpixels of each pixel."""
        rows, columns = self.height // self.image.subpixels, self.width // self.image.subpixels
        self.background[:rows, :columns] = 0
        n = self.open[:rows, :columns]
        self.background[:rows, :columns, :3] = self.sky[:rows, :columns] / np.maximum(n, 1)[..., None]
        self.background[:rows, :columns, 3] = (n > 0) & (not self.image.settings.film_transparent)


def _unshear(normals: np.ndarray, seen: LensView) -> None:
    """Turn normals (N, 3) of an orthographic view back into the camera space of the lens' centre."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals[:, 2] += seen.shear_x * normals[:, 0] + seen.shear_y * normals[:, 1]
    normals *= length / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def _shift_of(shift: np.ndarray, view: LensView, side: int) -> np.ndarray:
    """(2, 16) float32: where a view's own subpixels look in their cells; shift: of the image's (subpixel_places)."""
    k = side * np.arange(shift.shape[1])
    return np.stack([shift[0, (k + view.column) & 7], shift[1, (k + view.row) & 7]]) / side
