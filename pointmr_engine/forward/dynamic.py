"""Dynamic sampling: new random points of the triangles for each image (the randomized z-buffer).

    view = make_view(camera, points_per_pixel, epsilon, kept_points, backface_culling)
    selection = select_boxes(octree, distribution, view)      # boxes to sample, triangles to rasterise
    points, transforms, statistics = draw_image(octree, distribution, selection, "stratified", seed)

Time O(log tau + h + a log a log n): tau the relative depth range, h the octrees' height, a the surface in pixels.
"""

from __future__ import annotations

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.box_selection import (
    Selection,
    make_view,
    select_boxes,
)
from pointmr_engine.forward.cut_outs import CutOuts, no_cut_outs
from pointmr_engine.forward.point_draws import (
    BLOCK,
    MAX_BLOCKS,
    PER_BLOCK,
    RANDOM,
    STRATIFIED,
    Line,
    Points,
    Scratch,
    World,
    draw_blocks,
    resolve,
)
from pointmr_engine.forward.transforms import Transforms, allocate_transforms
from pointmr_engine.hierarchy.distribution import Distribution, allocate_chain
from pointmr_engine.hierarchy.octree import Octree
from pointmr_engine.numerics.hashing import hash_path
from pointmr_engine.scene.errors import SceneError

__all__ = ["PointSet", "Statistics", "draw_image", "make_view", "select_boxes"]

_PIECE = 8  # blocks that a thread takes at a time
_CHUNK = 1 << 14  # winners that are resolved at a time


class PointSet(NamedTuple):
    """Visible points of an image, of each cell of the depth buffer the nearest."""

    x: np.ndarray  # (N,) float32, pixels of the whole image from its lower left corner
    y: np.ndarray  # (N,) float32
    inverse_depth: np.ndarray  # (N,) float32: projection.inverse_depth
    part: np.ndarray  # (N,) int32
    triangle: np.ndarray  # (N,) int32, in its shape
    u: np.ndarray  # (N,) float32: barycentric weight of vertex 1
    v: np.ndarray  # (N,) float32: of vertex 2
    transform: np.ndarray  # (N,) int32: row of the transforms


class Statistics(NamedTuple):
    """Counts of one image."""

    nodes: int  # looked at
    boxes: int  # taken
    triangles: int  # to be rasterised
    expected: float  # points that the boxes expect
    drawn: int  # points that were not left out as hidden; the only count that depends on the threads' timing


def draw_image(
    octree: Octree,
    distribution: Distribution,
    selection: Selection,
    draws: str,
    seed: int,
    occlusion_culling: bool = True,
    cells: int = 1,
    depth: np.ndarray | None = None,
    threads: int = 0,
    cut_outs: CutOuts | None = None,
) -> tuple[PointSet, Transforms, Statistics]:
    """Draw the points of a selection, at selection.eye.limits' density.

    draws: "random", "stratified" or "poisson". cells: per side of a pixel; of each the nearest point is kept.
    depth: (height, width) float32 of the view's region, rows from the bottom: inverse depths that points must surpass
    (0: nothing there), such as those of the rasterised triangles. threads: 0: one per core. cut_outs: points in the
    holes of these triangles are left out; None: all are opaque.
    Returns the points, the selection's transforms with rows added below, and counts. Neither threads nor culling change
    the points.
    Raises SceneError where more points are needed than can be numbered (2.7e8).
    """
    geometry, view = octree.geometry, selection.eye
    if cut_outs is None:
        cut_outs = no_cut_outs(len(geometry.parts))
    world = World(octree.arrays, distribution, geometry.tables, geometry.instances, cut_outs)
    line = _line(selection, draws, seed, occlusion_culling)
    threads = threads or os.cpu_count() or 1
    x0, y0, x1, y1 = (int(n) for n in view.region)
    buffer = np.zeros(((y1 - y0) * cells, (x1 - x0) * cells), np.uint64)
    if depth is not None:
        bits = np.ascontiguousarray(depth, np.float32).view(np.uint32).astype(np.uint64)
        taken = np.where(bits > 0, (bits << np.uint64(32)) | np.uint64(0xFFFFFFFF), np.uint64(0))
        buffer[:] = taken.repeat(cells, 0).repeat(cells, 1)
    scratch = [_scratch(geometry.depth) for _ in range(threads)]
    blocks = _Counter(0, int(-(-line.ends[-1] // BLOCK)))

    def work(t):
        return sum(
            draw_blocks(
                world, selection, line, np.int64(cells), buffer.reshape(-1), np.uint64(buffer.ctypes.data), scratch[t],
                np.int64(start), np.int64(stop),
            )
            for start, stop in blocks
        )  # fmt: skip

    with ThreadPoolExecutor(threads) as pool:
        drawn = sum(pool.map(work, range(threads)))
        points, transforms = _resolved(world, selection, line, buffer, geometry.depth, scratch, pool)
    statistics = Statistics(
        selection.visited,
        len(selection.boxes.row),
        len(selection.triangles.part),
        float(line.ends[-1]),
        drawn,
    )
    return points, transforms, statistics


def _line(selection: Selection, draws: str, seed: int, culling: bool) -> Line:
    ends = np.concatenate([[0.0], np.cumsum(selection.boxes.area * selection.eye.limits[1])])
    total = float(ends[-1])
    blocks = int(-(-total // BLOCK))
    if blocks >= MAX_BLOCKS:
        raise SceneError(f"{total:.2g} points are too many for one image; lower the points per pixel")
    key = np.uint64(hash_path(np.uint64(seed & 0xFFFFFFFFFFFFFFFF), np.int64(0)))
    counts = np.zeros(blocks, np.int32)
    if draws != "stratified" and blocks:
        rng = np.random.Generator(np.random.Philox(key=int(key)))
        lengths = np.full(blocks, float(BLOCK))
        lengths[-1] = total - (blocks - 1) * BLOCK
        counts[:] = (
            rng.multinomial(int(np.ceil(total)), lengths / lengths.sum()) if draws == "random" else rng.poisson(lengths)
        )  # fmt: skip
        if counts.max() >= PER_BLOCK:
            raise SceneError("the random numbers are broken: too many points in one block")
    kind = {"random": RANDOM, "poisson": RANDOM, "stratified": STRATIFIED}[draws]
    return Line(ends, counts, np.int64(kind), key, np.int64(culling))


def _scratch(levels: int) -> Scratch:
    return Scratch(
        np.empty(PER_BLOCK + 1),
        allocate_chain(levels),
        np.empty(2),
        np.empty(3),
        np.empty(levels + 2, np.int64),
    )


class _Counter:
    """Pieces of a range of blocks, for threads to take."""

    def __init__(self, start: int, stop: int) -> None:
        self._next, self._stop, self._lock = start, stop, threading.Lock()

    def __iter__(self):
        while True:
            with self._lock:
                start = self._next
                self._next = min(start + _PIECE, self._stop)
            if start >= self._stop:
                return
            yield start, min(start + _PIECE, self._stop)


def _resolved(world, selection, line, buffer, levels, scratch, pool) -> tuple[PointSet, Transforms]:
    """The buffer's winners as points, in the order of their numbers."""
    low = buffer[(buffer & np.uint64(0xFFFFFFFF)) != np.uint64(0xFFFFFFFF)] & np.uint64(0xFFFFFFFF)
    numbers = np.sort(np.int64(0xFFFFFFFE) - low[low > 0].astype(np.int64))
    starts = range(0, len(numbers), _CHUNK)
    free = list(scratch)  # a chunk takes one and gives it back

    def chunk(start):
        stop = min(start + _CHUNK, len(numbers))
        mine = free.pop()
        n = stop - start
        real, whole = (lambda: np.empty(n, np.float32)), (lambda: np.empty(n, np.int32))
        out = Points(
            real(), real(), real(), whole(), whole(), real(), real(), whole(), allocate_transforms(n * levels)
        )
        rows = resolve(world, selection, line, numbers, np.int64(start), np.int64(stop), mine, out)
        free.append(mine)
        return out._replace(added=Transforms(*(a[:rows].copy() for a in out.added)))

    chunks = list(pool.map(chunk, starts))
    own = selection.transforms
    known = first = len(own.record)
    for c in chunks:
        for column in (c.transform, c.added.parent):
            column[column >= known] += first - known
        first += len(c.added.record)
    transforms = Transforms(
        *(np.concatenate([a, *(c.added[i] for c in chunks)]) if chunks else a for i, a in enumerate(own))
    )
    if not chunks:
        f, i = np.zeros(0, np.float32), np.zeros(0, np.int32)
        return PointSet(f, f, f, i, i, f, f, i), transforms
    return PointSet(*(np.concatenate(c) for c in zip(*(c[:8] for c in chunks), strict=True))), transforms
