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
    merge_buffers,
    resolve,
)
from pointmr_engine.forward.transforms import Transforms, allocate_transforms
from pointmr_engine.hierarchy.distribution import Distribution, allocate_chain
from pointmr_engine.hierarchy.octree import Octree
from pointmr_engine.numerics.hashing import hash_path
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.scene.errors import SceneError

__all__ = ["PointSet", "Statistics", "draw_image", "make_view", "select_boxes"]

TILE = 8  # pixels: side of the squares whose farthest depth culls boxes
BATCHES = 8  # boxes are drawn in as many steps, each culled by the depths of those before
_FEW = 1 << 16  # draws that are not worth a step
_PIECE = 16  # blocks that a thread takes at a time
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
    culled: int  # of them, hidden behind what was drawn before
    triangles: int  # to be rasterised
    expected: float  # points that the boxes expect
    drawn: int  # points


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
) -> tuple[PointSet, Transforms, Statistics]:
    """Draw the points of a selection, at selection.eye.limits' density.

    draws: "random", "stratified" or "poisson". cells: per side of a pixel; of each the nearest point is kept.
    depth: (height, width) float32 of the view's region, rows from the bottom: inverse depths that points must surpass (0:
    nothing there), such as those of the rasterised triangles. threads: 0: one per core; the result is the same.
    Returns the points, the selection's transforms with rows added below, and counts. Culling boxes by depth changes no point.
    Raises SceneError where more points are needed than can be numbered (2.7e8).
    """
    geometry, view = octree.geometry, selection.eye
    world = World(octree.arrays, distribution, geometry.tables, geometry.instances)
    line = _line(selection, draws, seed)
    threads = threads or os.cpu_count() or 1
    x0, y0, x1, y1 = (int(n) for n in view.region)
    buffer = np.zeros(((y1 - y0) * cells, (x1 - x0) * cells), np.uint64)
    if depth is not None:
        bits = np.ascontiguousarray(depth, np.float32).view(np.uint32).astype(np.uint64)
        taken = np.where(bits > 0, (bits << np.uint64(32)) | np.uint64(0xFFFFFFFF), np.uint64(0))
        buffer[:] = taken.repeat(cells, 0).repeat(cells, 1)
    buffers = [buffer] + [buffer.copy() for _ in range(threads - 1)]
    scratch = [_scratch(geometry.depth) for _ in range(threads)]
    drawn = 0
    with ThreadPoolExecutor(threads) as pool:
        for low, high in _batches(line, occlusion_culling):
            if low:
                _cull(selection, line, buffer, cells, low, high)
            blocks = _Counter(int(line.ends[low] // BLOCK), int(-(-line.ends[high] // BLOCK)))

            def work(t, blocks=blocks, low=low, high=high):
                points = 0
                for start, stop in blocks:
                    points += draw_blocks(
                        world, selection, line, np.int64(cells), buffers[t].reshape(-1), scratch[t],
                        np.int64(start), np.int64(stop), np.int64(low), np.int64(high),
                    )  # fmt: skip
                return points

            drawn += sum(pool.map(work, range(threads)))
            for other in buffers[1:]:
                merge_buffers(buffer.reshape(-1), other.reshape(-1), np.int64(0), np.int64(buffer.size))
        points, transforms = _resolved(world, selection, line, buffer, geometry.depth, scratch, pool)
    boxes = len(selection.boxes.row)
    statistics = Statistics(
        selection.visited, boxes, int(line.culled.sum()), len(selection.triangles.part), float(line.ends[-1]), drawn
    )  # fmt: skip
    return points, transforms, statistics


def _line(selection: Selection, draws: str, seed: int) -> Line:
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
    return Line(ends, counts, np.int64(kind), key, np.zeros(len(ends) - 1, np.bool_))


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


def _batches(line: Line, occlusion_culling: bool):
    """Ranges of boxes of about the same expected number of points."""
    count, total = len(line.ends) - 1, float(line.ends[-1])
    if not count:
        return
    steps = min(BATCHES, int(total // _FEW)) if occlusion_culling else 1
    cuts = np.searchsorted(line.ends, total * np.arange(1, max(steps, 1)) / max(steps, 1))
    cuts = np.unique(np.concatenate([[0], np.minimum(cuts, count), [count]]))
    yield from zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True)


def _cull(selection: Selection, line: Line, buffer: np.ndarray, cells: int, low: int, high: int) -> None:
    rows, columns = (-(-n // (TILE * cells)) for n in buffer.shape)
    tiles = np.empty((rows, columns), np.float32)
    _farthest(buffer, np.int64(TILE * cells), tiles)
    _cull_boxes(selection.boxes, selection.eye.region, tiles, line.culled, np.int64(low), np.int64(high))


@uncounted
def _farthest(buffer, side, tiles):
    """Least inverse depth of each square of side x side cells; 0 where one is empty."""
    for r in range(tiles.shape[0]):
        for c in range(tiles.shape[1]):
            least = np.uint64(0xFFFFFFFFFFFFFFFF)
            for y in range(r * side, min((r + 1) * side, buffer.shape[0])):
                for x in range(c * side, min((c + 1) * side, buffer.shape[1])):
                    least = min(least, buffer[y, x])
            tiles[r, c] = np.uint32(least >> np.uint64(32)).view(np.float32)


@uncounted
def _cull_boxes(boxes, region, tiles, culled, low, high):
    for k in range(low, high):
        x0, y0 = (boxes.rectangle[k, 0] - region[0]) // TILE, (boxes.rectangle[k, 1] - region[1]) // TILE
        x1 = (boxes.rectangle[k, 2] - 1 - region[0]) // TILE
        y1 = (boxes.rectangle[k, 3] - 1 - region[1]) // TILE
        hidden = True
        for r in range(y0, y1 + 1):
            for c in range(x0, x1 + 1):
                if not tiles[r, c] > boxes.nearest[k]:
                    hidden = False
                    break
            if not hidden:
                break
        culled[k] = hidden


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
