"""Triangles with holes that a view shows large: their opacity, sampled as finely as the view shows it.

What every view reads (`cut_outs.build_cut_outs`) has room for a hundred cells along a triangle's edge, or few where
many triangles differ: of a card that fills the image, its outline would be seen to be of cells.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pointmr_engine.forward.baked.opacity_lattice import batches
from pointmr_engine.forward.drawing.cut_out_cover import cut_out_of
from pointmr_engine.forward.drawing.cut_outs import CutOuts, Source, lattices, sampled
from pointmr_engine.forward.drawing.draw import triangle_to_camera
from pointmr_engine.forward.drawing.part_opacity import PartOpacity
from pointmr_engine.forward.drawing.subpixels import View
from pointmr_engine.forward.drawing.transforms import (
    allocate_transforms,
    box_to_camera,
    compose,
    compose_root,
    grow_transforms,
)
from pointmr_engine.forward.selection.box_heap import bound_in_tile
from pointmr_engine.forward.selection.walk import Hierarchy
from pointmr_engine.numerics.jit import device, uncounted

CELL = 2.0  # subpixels that a cell is wide, at most, where there is room
SMALL = 16  # pixels: triangles whose edges are no longer stay as they are, for there may be very many
LARGEST = 2048  # cells along an edge at most
ROOM = 16_000_000  # cells, over all triangles that are sampled anew and all looks at them


class NearCutOuts:
    """What a scene's triangles with holes are samples of, and their finer lattices, kept from view to view."""

    def __init__(self, sources: list[Source]):
        self._sources = sources
        self._first = np.cumsum([0, *(len(source.triangles) for source in sources)])  # rows of the sources
        self.kept: dict[tuple[int, int], np.ndarray] = {}  # (row, side): both opacities of CutOuts

    def of(self, opacity_of: PartOpacity) -> NearCutOuts:
        """The same of another scene (cut_outs.have_same_cut_outs), and what was kept."""
        other = NearCutOuts([source.of(opacity_of) for source in self._sources])
        other.kept = self.kept
        return other

    def refined(
        self,
        cut_outs: CutOuts,
        densest: bool,
        view: View,
        hierarchy: Hierarchy,
        camera_from_world: np.ndarray,
        size: tuple[int, int],
        subpixels: int,
        tell: Callable[[], None],
    ) -> CutOuts:
        """`cut_outs`, with finer lattices of the triangles that an image of width, height `size` in pixels, of so many
        subpixels along an edge each, shows so large that their cells would be seen; itself where there are none.

        cut_outs: as build_cut_outs returns them; densest: the second of them. tell() may raise to cancel.
        """
        if not len(cut_outs.side):
            return cut_outs
        coarse = lattices(cut_outs)
        least = max(CELL * coarse.shape[1], float(SMALL * subpixels))
        size = subpixels * size[0], subpixels * size[1]
        large = largest_in_view(view, hierarchy, camera_from_world, size, len(coarse), least)
        rows = np.flatnonzero(large > least)
        rows = rows[~cut_outs.even[rows]]
        looks = np.repeat([source.looks for source in self._sources], np.diff(self._first))
        sides = lattice_sides(large[rows], coarse.shape[1], looks[rows])
        wanted = [(int(row), int(side)) for row, side in zip(rows, sides, strict=True)]
        self.kept = {key: self.kept[key] for key in wanted if key in self.kept}
        if not wanted:
            return cut_outs
        self._sample([key for key in wanted if key not in self.kept], tell)
        start, side = cut_outs.start.copy(), cut_outs.side.copy()
        start[rows] = len(cut_outs.cells) + np.cumsum(sides**2) - sides**2
        side[rows] = sides
        finer = [self.kept[key][int(densest)].ravel() for key in wanted]
        return cut_outs._replace(start=start, side=side, cells=np.concatenate([cut_outs.cells, *finer]))

    def _sample(self, wanted: list[tuple[int, int]], tell: Callable[[], None]) -> None:
        """Keep the lattices of `wanted`, (row, side), those of one material and size together."""
        rows, sides = np.array(wanted, np.int64).reshape(-1, 2).T
        which = np.searchsorted(self._first, rows, side="right") - 1
        for material, side in sorted(set(zip(which.tolist(), sides.tolist(), strict=True))):
            for own in batches(rows[(which == material) & (sides == side)], side):
                tell()
                source = self._sources[material]
                found = sampled(source.opacity, source.triangles[own - self._first[material]], own, side)
                self.kept |= {(int(row), side): found[:, k] for k, row in enumerate(own)}


def lattice_sides(edges: np.ndarray, coarse: int, looks: np.ndarray | int = 1) -> np.ndarray:
    """(n,) int64 cells along edges of so many subpixels (n,): powers of two, so that views near by share them.

    looks: (n,) that a cell takes.
    """
    most = np.clip(edges / CELL, coarse, LARGEST)
    sides = np.minimum(2 ** np.ceil(np.log2(most)).astype(np.int64), LARGEST)
    while (looks * sides**2).sum() > ROOM and (sides > coarse).any():
        sides[sides == sides.max()] //= 2
    return np.maximum(sides, coarse)


def largest_in_view(
    view: View,
    hierarchy: Hierarchy,
    camera_from_world: np.ndarray,
    size: tuple[int, int],
    rows: int,
    least: float,
) -> np.ndarray:
    """(rows,) float64: the longest edge in subpixels, as if it were as near as the triangle's nearest point and faced
    the camera, of the triangles of each row of the cut-outs that may be seen; those shorter than `least` are left out.
    """
    transforms, stack = allocate_transforms(1 << 10), np.empty((1 << 12, 2), np.int32)
    used, box, where, corners = np.zeros(2, np.int64), np.empty(6), np.empty(4), np.empty((3, 3))
    found = np.zeros(rows)
    while not _find(
        view, hierarchy, np.ascontiguousarray(camera_from_world[:3], np.float64), float(size[0]), float(size[1]),
        float(least), transforms, stack, used, box, where, corners, found,
    ):  # fmt: skip
        transforms = grow_transforms(transforms, 0, 2 * len(transforms.parent))
        stack = np.empty((2 * len(stack), 2), np.int32)
    return found


@device
def _may_show(view, box, width, height, least, where):
    """Whether what lies in a camera-space box may be seen, and may be longer than `least` subpixels."""
    if not bound_in_tile(view, box, 0.0, 0.0, 0.0, width, height, where):
        return False
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    near = max(box[2], view.near) if view.perspective else 1.0
    return (x * x + y * y + z * z) ** 0.5 * max(view.scale_x, view.scale_y) > least * near


@uncounted
def _find(
    view,
    hierarchy,
    camera_from_world,
    width,
    height,
    least,
    transforms,
    stack,
    used,
    box,
    where,
    corners,
    found,
):
    """largest_in_view; False: no room. used (2,) int64: of the stack and the transforms."""
    octree = hierarchy.octree
    root = len(octree.group_root) - 1
    if root < 0 or octree.group_root[root] < 0:
        return True
    compose_root(transforms, camera_from_world, octree, root, np.int64(0))
    stack[0, 0], stack[0, 1] = octree.group_root[root], 0
    used[0] = used[1] = 1
    while used[0] > 0:
        used[0] -= 1
        node, row = np.int64(stack[used[0], 0]), np.int64(stack[used[0], 1])
        box_to_camera(transforms.matrix, row, octree.box, node, box)
        if not _may_show(view, box, width, height, least, where):
            continue
        first, own_end = np.int64(octree.items[node, 0]), np.int64(octree.items[node, 2])
        if used[0] + own_end - first + octree.child[node, 1] > len(stack):
            return False
        for i in range(first, own_end):
            part = np.int64(octree.item[i, 0])
            if part < 0:
                if used[1] >= len(transforms.parent):
                    return False
                group = compose(
                    transforms,
                    row,
                    octree,
                    hierarchy.instances,
                    -1 - part,
                    np.int64(octree.item[i, 1]),
                    used[1],
                )
                top = np.int64(octree.group_root[group])
                box_to_camera(transforms.matrix, used[1], octree.box, top, box)
                if _may_show(view, box, width, height, least, where):
                    stack[used[0], 0], stack[used[0], 1] = top, used[1]
                    used[0] += 1
                    used[1] += 1
                continue
            mask = cut_out_of(hierarchy.cut_outs, part, np.int64(octree.item[i, 1]))
            if mask < 0:
                continue
            triangle_to_camera(transforms.matrix, row, hierarchy.corners, i, corners)
            for r in range(3):
                box[r] = min(corners[0, r], corners[1, r], corners[2, r])
                box[3 + r] = max(corners[0, r], corners[1, r], corners[2, r])
            if _may_show(view, box, width, height, least, where):
                near = max(box[2], view.near) if view.perspective else 1.0
                longest = _longest_edge(corners) * max(view.scale_x, view.scale_y) / near
                found[mask] = max(found[mask], longest)
        for c in range(octree.child[node, 0], octree.child[node, 0] + octree.child[node, 1]):
            stack[used[0], 0], stack[used[0], 1] = c, row
            used[0] += 1
    return True


@device
def _longest_edge(corners):
    """Of a triangle (3, 3)."""
    most = 0.0
    for k in range(3):
        n = (k + 1) % 3
        x, y, z = corners[k, 0] - corners[n, 0], corners[k, 1] - corners[n, 1], corners[k, 2] - corners[n, 2]
        most = max(most, x * x + y * y + z * z)
    return most**0.5
