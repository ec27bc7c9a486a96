"""Images by dynamic sampling: the points of a whole image are drawn first, then its tiles show them.

Triangles that would need many points are rasterised, points are small discs in the planes of their triangles, and both
go through the tiles' depth buffers (talk: "Dynamic Sampling", "Image Reconstruction"). Where pixels are missing, the
boxes that may lie there are sampled again.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.box_selection import Boxes, Selection
from pointmr_engine.forward.draw import Entries
from pointmr_engine.forward.dynamic import PointSet, Statistics, draw_image, make_view, select_boxes
from pointmr_engine.forward.fragments import fill_normal_matrices
from pointmr_engine.forward.placement_values import allocate_placement_values, combine_placements
from pointmr_engine.forward.point_drawing import (
    PlacedPoints,
    PlacedTriangles,
    draw_points,
    draw_triangle_list,
    fill_point_fragments,
    place_points,
    place_triangles,
)
from pointmr_engine.forward.point_image import depth_image, holes, nearest_points
from pointmr_engine.forward.sample_count import points_per_pixel
from pointmr_engine.forward.subpixels import View, allocate_target, clear
from pointmr_engine.forward.tiles import TILE, Workspace
from pointmr_engine.forward.transforms import Transforms
from pointmr_engine.hierarchy.octree import KEPT_POINTS

AGAIN = 2  # times that missing pixels are sampled again at most: many are gaps that the scene has
COVER = 2.5  # area of all discs over that of the surface: a share of e^-2.5 of random ones would stay open
_PIECE = 1 << 16  # points that are placed between two looks at the progress callback


class DrawnPoints:
    """Points and triangles of one image (method.Image), in camera space."""

    def __init__(self, image):
        self.image = image
        options = image.settings.forward
        # cells half as wide as the distance of samples: wider ones would keep too few, finer ones more than it asks for
        self.cells = 1
        if options.reconstruction != "pixel":
            self.cells = int(np.clip(round(2.0 * options.samples_per_pixel**0.5), 1, image.subpixels))
        x0, y0, x1, y1 = image.region
        self.region = (x0 - image.apron, y0 - image.apron, x1 + image.apron, y1 + image.apron)
        area = (x1 - x0) * (y1 - y0) * max(options.samples_per_pixel, 1.0)
        self.density = options.samples_per_pixel * points_per_pixel(options.draws, area, options.failure)
        kept = min(self.density, float(self.cells**2))
        self.radius = image.subpixels * math.sqrt(COVER / (math.pi * kept))
        if options.reconstruction == "pixel" and options.samples_per_pixel >= 1.0:
            self.radius = 0.0  # the pixel that a point lies in is all that it shows
        self.counts = {"holes": 0, "drawn_again": 0}

    def draw(self, tell) -> None:
        """Draw all points. tell() is called between steps and may raise to cancel."""
        image, sampler = self.image, self.image.sampler
        options = image.settings.forward
        view = make_view(
            image.camera, self.density, options.epsilon, KEPT_POINTS, options.backface_culling, self.region
        )
        tell()
        selection = select_boxes(sampler.octree, sampler.distribution, view)
        tell()
        self.triangles = self._place_triangles(selection)
        tell()
        behind, before = self._triangle_depths()
        points, transforms, statistics = self._draw(selection, image.settings.seed, behind)
        self._count(statistics)
        for k in range(AGAIN):
            tell()
            seen = np.maximum(depth_image(points, nearest_points(points, self.region)), before)
            missing = holes(seen, image.camera)
            if k == 0:
                self.counts["holes"] = int(missing.sum())
            again = _touching(selection, missing, self.region)
            if not len(again.boxes.row):
                break
            more, added, statistics = self._draw(
                again, image.settings.seed + ((k + 1) << 32), np.where(missing, behind, np.float32(np.inf))
            )
            self.counts["drawn_again"] += statistics.drawn
            if not len(more.x):
                break
            points, transforms = _joined(points, transforms, more, added, len(selection.transforms.record))
        self.counts["points"] = len(points.x)
        self._place(points, transforms, tell)

    def _draw(self, selection: Selection, seed: int, depth: np.ndarray):
        image = self.image
        options = image.settings.forward
        return draw_image(
            image.sampler.octree, image.sampler.distribution, selection, options.draws, seed,
            options.occlusion_culling, self.cells, depth, image.settings.threads,
            image.sampler.cut_outs,
        )  # fmt: skip

    def _count(self, statistics: Statistics) -> None:
        self.counts.update(
            nodes=statistics.nodes,
            boxes=statistics.boxes,
            triangles=statistics.triangles,
            points_expected=round(statistics.expected),
            points_drawn=statistics.drawn,
        )

    def _place_triangles(self, selection: Selection) -> PlacedTriangles:
        found, image = selection.triangles, self.image
        n = len(found.part)
        out = PlacedTriangles(
            np.empty((n, 3, 3)), np.empty((n, 4)), found.part, found.triangle, found.transform
        )
        octree = image.sampler.octree
        place_triangles(
            image.view,
            octree.arrays,
            octree.geometry.tables,
            selection.transforms,
            float(image.subpixels),
            out,
        )
        return out

    def _triangle_depths(self) -> tuple[np.ndarray, np.ndarray]:
        """(height, width) float32 inverse depths of the triangles, at the pixels' corners: the farthest, the nearest.

        0: a corner, or all of them, show none. For orthographic cameras all are 0, and 1 where all corners are covered.
        """
        x0, y0, x1, y1 = self.region
        width, height = x1 - x0 + 1, y1 - y0 + 1
        view, s = self.image.view, self.image.subpixels
        pixels = View(
            view.perspective, view.scale_x / s, view.scale_y / s, view.shift_x / s, view.shift_y / s, view.near,
            view.far, view.depth_shift, view.depth_scale,
        )  # fmt: skip
        target = allocate_target(width, height)
        clear(target, width)
        entries = Entries(
            np.empty(len(self.triangles.part), np.int64), np.empty(len(self.triangles.part), np.int32)
        )
        draw_triangle_list(
            pixels, target, np.int64(width), np.int64(height), x0 - 0.5, y0 - 0.5, self.triangles,
            self.image.sampler.cut_outs, True, 1.0, entries, np.int64(0),
        )  # fmt: skip
        seen = target.depth[:height, :width]
        if not view.perspective:
            # nearness has another unit here, and another zero
            camera = self.image.camera
            z = (view.depth_shift - seen.astype(np.float64)) / view.depth_scale
            inverse = 1.0 - (z - camera.clip[0]) / (camera.clip[1] - camera.clip[0])
            seen = np.where(seen > 0, np.clip(inverse, 1e-7, 1.0), 0.0).astype(np.float32)
        corners = seen[:-1, :-1], seen[:-1, 1:], seen[1:, :-1], seen[1:, 1:]
        return np.minimum.reduce(corners), np.maximum.reduce(corners)

    def _place(self, points: PointSet, transforms: Transforms, tell) -> None:
        """Positions and planes of the points, in the order of blocks of the image."""
        x0, y0, x1, y1 = self.region
        self.corner = x0 // TILE, y0 // TILE
        self.columns, rows = (x1 - 1) // TILE - self.corner[0] + 1, (y1 - 1) // TILE - self.corner[1] + 1
        column = np.floor(points.x / TILE).astype(np.int64) - self.corner[0]
        row = np.floor(points.y / TILE).astype(np.int64) - self.corner[1]
        block = row * self.columns + column
        order = np.argsort(block, kind="stable")
        self.first = np.searchsorted(block[order], np.arange(rows * self.columns + 1))
        points = PointSet(*(a[order] for a in points))
        n = len(order)
        place = np.stack([points.u, points.v], 1)
        self.points = PlacedPoints(
            np.empty((n, 3)), np.empty((n, 3), np.float32), points.x, points.y, points.part, points.triangle, place,
            points.transform,
        )  # fmt: skip
        octree = self.image.sampler.octree
        corners = np.empty((1, 3, 3))
        for start in range(0, n, _PIECE):
            tell()
            place_points(
                octree.arrays, octree.geometry.tables, transforms, self.points, corners, np.int64(start),
                np.int64(min(start + _PIECE, n)),
            )  # fmt: skip
        self.transforms = transforms
        self.normals = np.empty((len(transforms.record), 9))
        fill_normal_matrices(transforms.matrix, np.int64(len(self.normals)), self.normals)
        self._values = None

    def runs_near(self, bounds) -> list[tuple[int, int]]:
        """(first, last) of the points that may be seen in a tile x0, y0, x1, y1 of pixels, apron included."""
        apron, (x, y) = self.image.apron, self.corner
        left, right = (bounds[0] - apron) // TILE - x, (bounds[2] + apron - 1) // TILE - x
        rows = range((bounds[1] - apron) // TILE - y, (bounds[3] + apron - 1) // TILE - y + 1)
        return [
            (int(self.first[r * self.columns + left]), int(self.first[r * self.columns + right + 1]))
            for r in rows
        ]

    def placement_values(self, hierarchy):
        """What instances say about the placements, a row each; made when first asked for."""
        if self._values is None:
            rows = len(self.transforms.record)
            values = allocate_placement_values(rows)
            combine_placements(self.transforms, hierarchy.instances, np.int64(rows), values)
            self._values = values
        return self._values


def _touching(selection: Selection, missing: np.ndarray, region) -> Selection:
    """The selection with only those boxes that may touch a missing pixel."""
    sums = np.zeros((missing.shape[0] + 1, missing.shape[1] + 1), np.int64)
    sums[1:, 1:] = missing.cumsum(0).cumsum(1)
    r = selection.boxes.rectangle.astype(np.int64) - np.array(region[:2] * 2)
    there = (
        sums[r[:, 3], r[:, 2]] - sums[r[:, 1], r[:, 2]] - sums[r[:, 3], r[:, 0]] + sums[r[:, 1], r[:, 0]] > 0
    )
    return selection._replace(boxes=Boxes(*(a[there] for a in selection.boxes)))


def _joined(
    points: PointSet, transforms: Transforms, more: PointSet, added: Transforms, known: int
) -> tuple[PointSet, Transforms]:
    """Two draws from one selection, whose first `known` transforms are the same."""
    shift = len(transforms.record) - known
    moved = more._replace(transform=np.where(more.transform >= known, more.transform + shift, more.transform))
    parent = added.parent[known:]
    below = Transforms(
        added.matrix[known:],
        np.where(parent >= known, parent + shift, parent).astype(np.int32),
        added.record[known:],
        added.group[known:],
    )
    return (
        PointSet(*(np.concatenate(c).astype(c[0].dtype) for c in zip(points, moved, strict=True))),
        Transforms(*(np.concatenate(c) for c in zip(transforms, below, strict=True))),
    )


class PointSpace(Workspace):
    """One thread's buffers for tiles that show the drawn points and triangles of their image."""

    def draw(self, bounds, hierarchy) -> None:
        """Draw a tile x0, y0, x1, y1 of pixels."""
        image, drawn, s = self.image, self.image.drawn, self.image.subpixels
        self.start_tile(bounds)
        self.scratch.transforms = drawn.transforms
        self.scratch.used[1] = len(drawn.transforms.record)
        runs = drawn.runs_near(bounds)
        room = sum(last - first for first, last in runs) + len(drawn.triangles.part)
        if len(self.scratch.entries.surfel) < room:
            self.scratch.entries = Entries(np.empty(2 * room, np.int64), np.empty(2 * room, np.int32))
        size = np.int64(self.width), np.int64(self.height), float(self.left), float(self.low)
        entries = self.scratch.entries
        used = draw_triangle_list(
            image.view,
            self.target,
            *size,
            drawn.triangles,
            hierarchy.cut_outs,
            False,
            float(s),
            entries,
            np.int64(0),
        )
        for first, last in runs:
            used = draw_points(
                image.view, self.target, *size, drawn.points, np.int64(first), np.int64(last), float(s),
                float(drawn.radius), entries, np.int64(used),
            )  # fmt: skip
        self.entries = int(used)

    def _fill(self, hierarchy, count: int) -> None:
        drawn = self.image.drawn
        fill_point_fragments(
            self.image.view, np.int64(self.left), np.int64(self.low), hierarchy.parts, self.image.sampler.looks,
            drawn.normals, drawn.points, drawn.triangles, self.scratch.entries, self.fragments, np.int64(count),
        )  # fmt: skip

    def placement_values(self, hierarchy):
        return self.image.drawn.placement_values(hierarchy)
