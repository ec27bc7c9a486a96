"""Tiles drawn from several points of the lens: fragments of all views, merged before they are shaded."""

from __future__ import annotations

import copy

import numpy as np

from pointmr_engine.forward.baking import materials_of
from pointmr_engine.forward.draw import Entries
from pointmr_engine.forward.fragments import (
    Fragments,
    allocate_fragments,
    fill_fragments,
    fill_normal_matrices,
    find_fragments,
)
from pointmr_engine.forward.leaks import close_leaks
from pointmr_engine.forward.method import depth_range
from pointmr_engine.forward.placement_values import (
    PlacementValues,
    allocate_placement_values,
    combine_placements,
)
from pointmr_engine.forward.subpixels import allocate_target, clear, close_gaps, thresholds
from pointmr_engine.forward.transforms import grow_transforms
from pointmr_engine.forward.walk import WAITING, Scratch, walk
from pointmr_engine.multires.fragment_paths import BATCH
from pointmr_engine.multires.lens import LensView, confusion, lens_rays, make_views, sharpest, views_per_side
from pointmr_engine.multires.looks import look_through_lens
from pointmr_engine.multires.merge import choose_seen, copy_fragment, join, mergeable, renumber, unit_normal
from pointmr_engine.multires.method import TracedShading, TracedTiles
from pointmr_engine.numerics.dither import SIDE
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.rng import pixel_seed
from pointmr_engine.scene.group import CAMERA

VIEW = 33  # first bit of the view in a fragment's key
MIXED = 2.0  # pixels: circles of confusion from this size on are shaded in larger cells


@uncounted
def deal_out(ids, width, height, side, column, row, first, subpixels, out, empty):
    """Write a view's fragments to its subpixels of the image; count those that show nothing.

    ids: of the view's target, width x height subpixels; first: number of its first fragment; out (H, W) int32; empty
    (rows, columns) int32: subpixels per pixel of the tile that show nothing.
    """
    for y in range(height):
        for x in range(width):
            k = np.int64(ids[y, x])
            out[y * side + row, x * side + column] = np.int32(k + first if k >= 0 else k)
            if k < 0:
                empty[(y * side + row) // subpixels, (x * side + column) // subpixels] += 1


@uncounted
def merge_views(
    order, key, perspective, footprint, f: Fragments, count, into, largest, kept, left, low, seed
):
    """Merge fragments 0..count that have the same key and continue each other's surface; returns how many are left.

    order (N,) int64: by key; key (N,) int64: cell, and from bit VIEW on the view where views do not share. There one
    of them represents all, by chance, for what is sharp must not be asked in the same places always. The merged ones
    take the places of their first ones, kept (N,) int64; into (N,) int32: the number of what each is part of. left,
    low: the tile's first subpixel.
    """
    groups, first, last = np.int64(0), np.int64(0), np.int64(-1)
    for n in range(count):
        k = order[n]
        if n == 0 or key[k] != last:
            last = key[k]
            first = groups
        size = footprint
        if perspective:
            size = footprint * f.position[k, 2]
        found = np.int64(-1)
        for g in range(first, groups):
            if mergeable(f, kept[g], k, size):
                found = g
                break
        if found >= 0:
            g = kept[found]
            if key[k] >> VIEW == 0:
                join(f, g, k, largest)
            else:
                seen = f.count[g] + f.count[k]
                h = pixel_seed(np.int64(4.0 * (left + f.x[k])), np.int64(4.0 * (low + f.y[k])), seed)
                if np.int64(h) * seen < np.int64(f.count[k]) << 32:
                    copy_fragment(f, g, k)
                f.count[g] = seen
            into[k] = found
        else:
            kept[groups] = k
            largest[k] = f.count[k]
            into[k] = groups
            groups += 1
    for n in range(groups):
        unit_normal(f, kept[n])
    return groups


class LensShading(TracedShading):
    """Light of fragments that the views share, seen from the lens' centre, and of those of single views."""

    def shade(self, space: LensTiles, hierarchy, count: int) -> None:
        image, f = self.image, space.fragments
        paths, values = self.paths(space), space.placement_values(hierarchy)
        paths.start_tile(space, count)
        matrix = space.scratch.transforms.matrix
        for start, stop, k in space.parts:
            space.image = image.seen[k] if k >= 0 else image
            if k >= 0:  # into the view's own camera space, and back
                shift, rows = np.array([image.views[k].x, image.views[k].y]), slice(*space.rows_of[k])
                f.position[start:stop, :2] -= shift
                matrix[rows, 3:8:4] -= shift
            for first in range(start, stop, BATCH):
                paths.trace(hierarchy, values, first, min(BATCH, stop - first))
            if k >= 0:
                f.position[start:stop, :2] += shift
                matrix[rows, 3:8:4] += shift
        space.image = image
        paths.finish_tile(count)


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
    image.seen = []
    for view in image.views:
        image.seen.append(copy.copy(image))
        image.seen[-1].camera = view.camera
    image.space_of = LensTiles
    image.shading = LensShading(image)


class LensTiles(TracedTiles):
    """One thread's buffers for tiles that are drawn from several points of the lens."""

    def __init__(self, image):
        super().__init__(image)
        side, n = len(self.target.ids), len(self.fragments.entry)
        self.part = allocate_target(side // image.side, side // image.side)
        # views look at other places of a dither: what they show of a pixel together is all of it
        step = max(SIDE // image.side, 1)
        self.patterns = [thresholds(step * v.column % SIDE, step * v.row % SIDE) for v in image.views]
        self.own = Scratch(self.part)  # of the view that is drawn
        self.own.counters = self.scratch.counters
        self.scratch.entries = Entries(np.empty(n, np.int64), np.empty(0, np.int32))
        self.found = allocate_fragments(n)
        self.seen = np.empty((0, 2), np.int32)  # the views see a fragment in different subpixels
        self.shown = np.empty((n, 2), np.int32)
        self.of_view = np.empty(n, np.int32)
        self.kept = np.empty(n, np.int64)
        self.own_values = allocate_placement_values(0)
        side = len(self.background)
        self.open, self.open_in_view = np.zeros((side, side), np.int32), np.zeros((side, side), np.int32)
        self.sky = np.zeros((side, side, 3))
        self.gaps = np.zeros((len(self.part.ids) + 1,) * 2, np.uint8)

    def draw(self, bounds, hierarchy):
        """Draw the tile in every view; see Workspace.draw."""
        image, v = self.image, self.image.side
        self.start_tile(bounds)
        counters = self.scratch.counters
        waiting = counters[WAITING]
        self.count = 0
        self.scratch.used[1] = 0
        self.rows_of: list = []  # of each view, in the transforms
        self.open[:], self.sky[:] = 0, 0.0
        x, y, width, height = self.left // v, self.low // v, self.width // v, self.height // v
        for k, seen in enumerate(image.views):
            clear(self.part, width)
            self.part.pattern[:] = self.patterns[k]
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
        self.closed += close_gaps(self.part, width, height, own.entries.surfel)
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
            np.float64(image.pixel * v / image.subpixels), f, hierarchy.cut_outs, np.int64(count), self.leaks,
        )  # fmt: skip
        self.open_in_view[:] = 0
        deal_out(
            self.part.ids, width, height, np.int64(v), np.int64(seen.column), np.int64(seen.row), np.int64(first),
            np.int64(image.subpixels), self.target.ids, self.open_in_view,
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
        self.rows_of.append((first, last))

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
        mixed = alone | (blur * abs(view.scale_y) > MIXED * image.subpixels)
        cell = np.where(mixed, 2 * self.cell, self.cell)
        last = 1 << 15  # what lies far outside the tile is in the last cells
        i, j = (np.clip(a[:n] // cell, -last, last - 1).astype(np.int64) + last for a in (f.x, f.y))
        view_of = np.where(alone, self.of_view[:n].astype(np.int64) + 1, 0)
        key = (view_of << VIEW) + (mixed.astype(np.int64) << 32) + (j << 16) + i
        order = np.argsort(key, kind="stable")
        count = merge_views(
            order, key, view.perspective, np.float64(image.footprint), f, np.int64(n), self.into, self.largest,
            self.kept, np.int64(self.left), np.int64(self.low), np.int64(image.settings.seed),
        )  # fmt: skip
        renumber(self.target.ids, np.int64(self.width), np.int64(self.height), self.into)
        choose_seen(
            self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(self.left), np.int64(self.low),
            np.int64(count), self.largest, self.shown,
        )  # fmt: skip
        chosen = self.kept[:count]
        for old, new in zip(f, self.fragments, strict=True):
            new[:count] = old[chosen]
        of, start = np.unique(key[chosen] >> VIEW, return_index=True)
        stop = [*start[1:].tolist(), count][: len(of)]
        self.parts = list(zip(start.tolist(), stop, (of - 1).tolist(), strict=True))
        return count

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
        """Add the world's radiance behind the open subpixels of a view."""
        image, s = self.image, self.image.subpixels
        if image.settings.film_transparent:
            return
        y, x = np.nonzero(self.open_in_view)
        if not len(x):
            return
        d = np.zeros((len(x), 3))
        d[:, 2] = 1.0
        if image.view.perspective:
            d[:, 0] = (self.left + (x + 0.5) * s - image.view.shift_x) / image.view.scale_x
            d[:, 1] = (self.low + (y + 0.5) * s - image.view.shift_y) / image.view.scale_y
        d[:, :2] -= np.array([seen.x, seen.y]) / image.camera.lens[1]
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        world = np.einsum(
            "nk,ck->nc", d, image.camera.world_from_camera[:, :3]
        )  # BLAS would start threads for it
        weight = self.open_in_view[y, x]
        self.sky[y, x] += weight[:, None] * image.sampler.environment.radiance(world, CAMERA)
        self.open[y, x] += weight

    def _background(self, bounds) -> None:
        """The world's mean radiance behind the open subpixels of each pixel."""
        rows, columns = self.height // self.image.subpixels, self.width // self.image.subpixels
        self.background[:rows, :columns] = 0
        n = self.open[:rows, :columns]
        self.background[:rows, :columns, :3] = self.sky[:rows, :columns] / np.maximum(n, 1)[..., None]
        self.background[:rows, :columns, 3] = n > 0


def _unshear(normals: np.ndarray, seen: LensView) -> None:
    """Turn normals (N, 3) of an orthographic view back into the camera space of the lens' centre."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals[:, 2] += seen.shear_x * normals[:, 0] + seen.shear_y * normals[:, 1]
    normals *= length / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
