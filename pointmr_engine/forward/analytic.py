"""Exact visible polygons, as a reference for small scenes: what every triangle shows is a polygon, and areas are exact.

Nearness is linear in the image, so where two triangles overlap the nearer one hides the other in a convex piece, cut
off by the line in which they meet if they do; what is left of a triangle after all such pieces is what is visible (no
order of depth is needed, and triangles may penetrate each other). Areas are exact in the cells of a lattice of
`subpixels` per side of a pixel, so a box filter is exact and others are as if constant over a cell; a triangle is
shaded once per pixel, at the middle of what it shows there.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.drawing.draw import Entries
from pointmr_engine.forward.drawing.polygon_cover import (
    CORNERS,
    LEAST,
    Shares,
    clip_to_rectangle,
    filter_shares,
    hiding_pieces,
    show_polygons,
)
from pointmr_engine.forward.selection.view_triangles import view_triangles
from pointmr_engine.forward.tiles import Workspace
from pointmr_engine.scene.errors import SceneError

TRIANGLES = 20_000  # in view, at most
PLACED = 2_000_000  # in the whole scene, at most
PAIRS = 4_000_000  # of triangles that overlap in the image, at most
GRID = 2.0**-24  # pixels: what corners are rounded to, so that none of the library's unions fails
_CHUNK = 1 << 16  # pairs between two looks at the progress callback


class VisiblePolygons:
    """The visible part of every triangle of one image (method.Image), as edges in pixels."""

    def __init__(self, image):
        self.image = image

    def find(self, tell) -> None:
        """Find all polygons. tell() may raise to cancel.

        Raises SceneError where there are too many triangles, where materials let light through, and without shapely.
        """
        try:
            import shapely
        except ImportError as error:
            raise SceneError(
                "forward.reconstruction = 'analytic' needs the package shapely (pip install 'pointmr[analytic]')"
            ) from error
        image = self.image
        self._check_materials()
        x0, y0, x1, y1 = image.region
        a = image.apron
        region = np.array([x0 - a, y0 - a, x1 + a, y1 + a], np.float64)
        self._find_triangles(region)
        tell()
        polygons, corners, planes = self._polygons(region)
        visible = self._visible(shapely, polygons, corners, planes, tell)
        self._edges(shapely, visible)
        self.counts = {
            "triangles": len(corners),
            "polygons": int((np.diff(self.first_edge) > 0).sum()),
            "edges": len(self.edges),
        }

    def _check_materials(self) -> None:
        sampler = self.image.sampler
        placed = sampler.geometry.instanced_triangles
        if placed > PLACED:
            raise _refused(f"the scene has {placed} triangles, more than {PLACED}")
        for material, program in zip(sampler.geometry.materials, sampler.programs, strict=True):
            if not program.opaque:
                name = "no material" if material is None else material.name
                raise _refused(f"material '{name}' is not opaque")

    def _find_triangles(self, region) -> None:
        """List the triangles that the region may show."""
        image = self.image
        self.triangles, self.transforms = view_triangles(
            image.view, image.hierarchy(), image.camera.camera_from_world, region * image.subpixels, TRIANGLES
        )
        if len(self.triangles.item) > TRIANGLES:
            raise _refused(f"more than {TRIANGLES} triangles are in view")

    def _polygons(self, region):
        """(polygons (T, CORNERS, 2) in pixels, their numbers of corners (T,), planes (T, 3) of nearness)."""
        camera, p = self.image.camera, self.triangles.corners
        n = len(p)
        work, corners = np.zeros((n, CORNERS, 3)), np.full(n, 3, np.int64)
        work[:, :3] = p
        near = max(float(camera.clip[0]), 1e-12) if camera.perspective[0] else float(camera.clip[0])
        for side, limit in ((1.0, near), (-1.0, float(camera.clip[1]))):
            z = side * (p[:, :, 2] - limit)
            for k in np.flatnonzero((z < 0.0).any(1)):
                cut = _cut_by_depth(work[k, : corners[k]], side, limit)
                corners[k] = len(cut)
                work[k, : len(cut)] = cut
        with np.errstate(all="ignore"):
            xy = work[:, :, :2] / work[:, :, 2:] if camera.perspective[0] else work[:, :, :2].copy()
        polygons = np.ascontiguousarray(np.nan_to_num((xy - camera.plane[0]) / camera.plane[1]))
        clip_to_rectangle(polygons, corners, region, np.empty((CORNERS + 1, 2)))
        # the plane n p = d; nearness is 1 / z, or -z for orthographic cameras
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        d = (normal * p[:, 0]).sum(1)
        (ox, oy), (dx, dy) = camera.plane
        with np.errstate(all="ignore"):
            if camera.perspective[0]:
                planes = np.stack([normal[:, 2] + normal[:, 0] * ox + normal[:, 1] * oy, normal[:, 0] * dx,
                                   normal[:, 1] * dy], 1) / d[:, None]  # fmt: skip
            else:
                planes = np.stack([normal[:, 0] * ox + normal[:, 1] * oy - d, normal[:, 0] * dx,
                                   normal[:, 1] * dy], 1) / normal[:, 2:]  # fmt: skip
        corners[~np.isfinite(planes).all(1)] = 0  # seen edge-on
        return polygons, corners, np.nan_to_num(planes)

    def _visible(self, shapely, polygons, corners, planes, tell) -> list:
        """What is visible of each polygon, as shapely geometries; None: nothing."""
        shown = np.flatnonzero(corners >= 3)
        shapes = np.full(len(corners), None, object)
        shapes[shown] = _shapes(shapely, polygons[shown], corners[shown])
        tell()
        tree = shapely.STRtree(shapes[shown])
        behind, before = tree.query(shapes[shown])
        behind, before = shown[behind], shown[before]
        keep = behind != before
        behind, before = behind[keep], before[keep]
        if len(behind) > PAIRS:
            raise _refused(f"{len(behind)} pairs of triangles overlap in the image, more than {PAIRS}")
        hiding: list[list] = [[] for _ in corners]
        side = 2 * CORNERS + 1
        for start in range(0, len(behind), _CHUNK):
            tell()
            pair = behind[start : start + _CHUNK], before[start : start + _CHUNK]
            pieces, count = np.empty((len(pair[0]), side, 2)), np.zeros(len(pair[0]), np.int64)
            hiding_pieces(polygons, corners, planes, *pair, pieces, count, np.empty((side, 2)))
            there = np.flatnonzero(count)
            for k, shape in zip(there, _shapes(shapely, pieces[there], count[there]), strict=True):
                hiding[pair[0][k]].append(shape)
        for n, k in enumerate(shown):
            if n % 256 == 0:
                tell()
            if not hiding[k]:
                continue
            if shapely.area(hiding[k]).max() >= shapely.area(shapes[k]) - LEAST:
                shapes[k] = None
                continue
            hidden = shapely.union_all(hiding[k], grid_size=GRID)
            shapes[k] = shapely.difference(shapes[k], hidden, grid_size=GRID)
        return list(shapes)

    def _edges(self, shapely, visible: list) -> None:
        """Edges (E, 4) of polygon t from first_edge[t] on, outer rings counter-clockwise; bounds (T, 4) in pixels."""
        edges, self.first_edge = [], np.zeros(len(visible) + 1, np.int64)
        self.bounds = np.zeros((len(visible), 4))
        for t, shape in enumerate(visible):
            n = 0
            if shape is not None and not shape.is_empty:
                self.bounds[t] = shape.bounds
                for part in shapely.get_parts(shape):
                    if part.geom_type != "Polygon":
                        continue  # lines along which polygons touch
                    for k, ring in enumerate([part.exterior, *part.interiors]):
                        points = np.asarray(ring.coords)[:, :2]
                        if ring.is_ccw != (k == 0):
                            points = points[::-1]
                        edges.append(np.concatenate([points[:-1], points[1:]], 1))
                        n += len(points) - 1
            self.first_edge[t + 1] = self.first_edge[t] + n
        self.edges = np.ascontiguousarray(np.concatenate(edges)) if edges else np.zeros((0, 4))


def _refused(reason: str) -> SceneError:
    return SceneError(f"forward.reconstruction = 'analytic': {reason}; use 'subpixel'")


def _cut_by_depth(points: np.ndarray, side: float, limit: float) -> np.ndarray:
    """A polygon (n, 3) clipped to side * (z - limit) >= 0."""
    out = []
    for a, b in zip(points, np.roll(points, -1, 0), strict=True):
        d, e = side * (a[2] - limit), side * (b[2] - limit)
        if d >= 0.0:
            out.append(a)
        if d * e < 0.0:
            point = a + d / (d - e) * (b - a)
            point[2] = limit
            out.append(point)
    return np.array(out).reshape(-1, 3)


def _shapes(shapely, polygons: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Shapely polygons of convex ones, (K, n, 2) with `corners` each."""
    if not len(corners):
        return np.zeros(0, object)
    lengths = corners + 1
    first = np.concatenate([[0], np.cumsum(lengths)])
    which = np.repeat(np.arange(len(corners)), lengths)
    place = (np.arange(first[-1]) - first[which]) % corners[which]  # the first corner again at the end
    rings = np.arange(len(corners) + 1)
    shapes = shapely.from_ragged_array(shapely.GeometryType.POLYGON, polygons[which, place], (first, rings))
    bent = ~shapely.is_valid(shapes)  # by rounding
    shapes[bent] = shapely.convex_hull(shapes[bent])
    return shapes


class PolygonSpace(Workspace):
    """One thread's buffers for tiles of exact polygons."""

    def draw(self, bounds, hierarchy) -> None:
        """Find the fragments of a tile x0, y0, x1, y1 of pixels."""
        found, s = self.image.drawn, self.image.subpixels
        self.start_tile(bounds)
        self.scratch.transforms = found.transforms
        self.scratch.used[1] = len(found.transforms.record)
        n = len(found.triangles.item)
        if len(self.scratch.entries.surfel) < n:
            self.scratch.entries = Entries(np.empty(n, np.int64), np.empty(n, np.int32))
        if not hasattr(self, "shares"):
            self.shares = _shares(1 << 16)
            self.covered, self.areas = np.empty(self.target.ids.shape), np.zeros(self.target.ids.shape)
        while True:
            self.count, self.entries, self.shared = show_polygons(
                found.edges, found.first_edge, found.bounds, found.triangles.item, found.triangles.row,
                float(self.left), float(self.low), np.int64(self.width), np.int64(self.height), np.int64(s), self.areas,
                self.target, self.covered, self.empty, self.scratch.entries, self.fragments, self.shares,
            )  # fmt: skip
            if self.shared >= 0:
                return
            self.shares = _shares(2 * len(self.shares.area))
            self.areas[:] = 0.0
            self.start_tile(bounds)

    def _fragments(self, hierarchy) -> int:
        self._fill(hierarchy, np.int64(self.count))
        return self.count

    def _filtered(self, values, background, rows: int, columns: int) -> np.ndarray:
        out = np.zeros((rows, columns, 4))
        filter_shares(
            self.shares, np.int64(self.shared), values, self.covered, np.int64(self.width), np.int64(self.height),
            background, np.int64(self.image.subpixels), self.image.taps, out,
        )  # fmt: skip
        return out.astype(np.float32)


def _shares(n: int) -> Shares:
    return Shares(np.empty((n, 2), np.int32), np.empty(n, np.int32), np.empty(n, np.float32))
