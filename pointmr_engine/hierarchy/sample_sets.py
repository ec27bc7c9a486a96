"""Static sampling: for every octree node a set of surfels whose spacing is a fixed fraction of the node's side.

A set stands for what lies in its node and is small for it; what is large there (triangles of more than about three
samples, instances as large as the cell) is drawn as it is when the walk passes the node (talk: "Store large triangles
as-is"). Sets of groups that are made of instances come from their groups' sets, so that a far forest is a few samples
and no walk to its leaves. A (group, level) is built when a view first asks for it: levels that no view needs are not.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.octree import CHAIN, LEAF_TRIANGLES, MAX_LEVEL, SPACING, Octree
from pointmr_engine.hierarchy.pieces import cut
from pointmr_engine.hierarchy.strategies import select
from pointmr_engine.hierarchy.surfels import (
    AREA,
    BLUE,
    COLUMNS,
    NX,
    RED,
    XX,
    Z,
    ZZ,
    X,
    Surfels,
    allocate_surfels,
    chosen,
    joined,
    merge_surfels,
    place_surfels,
)

NEVER, NOT_YET = -1, -2  # in SetArrays.sets[:, 0]: the node has no set; its set is not built yet
INSTANCES_OF_SET = (
    32  # below a cell that fits its group, nodes of fewer instances have no set: their groups' serve
)
PIECE = 0.5  # of the spacing: the size that triangles are cut to before samples are chosen
CANDIDATE = 0.5  # of the spacing: the spacing of the surfels that stand for an instance among the candidates
SLACK = 8  # rows past the last surfel that may be read, for kernels that take several at once
CHUNK = 2_000_000  # candidates at once


class Look(NamedTuple):
    """What is baked of n surface points' materials, in the mesh's space."""

    normal: np.ndarray  # (n, 3) float32 shading normals, unit
    albedo: np.ndarray  # (n, 3) float32
    emission: np.ndarray  # (n, 3) float32 radiance
    alpha: np.ndarray  # (n,) float32


Looks = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray], Look]


class SetArrays(NamedTuple):
    """The sets as kernels read them."""

    sets: np.ndarray  # (N, 2) int64 per octree node: first surfel or NEVER or NOT_YET, number of surfels
    row: np.ndarray  # (S, 16) float32, Surfels.row
    emission: np.ndarray  # (S, 3) float32
    source: np.ndarray  # (S, 2) int32
    place: np.ndarray  # (S, 2) float32


class SampleSets:
    """The sample sets of an octree, built level by level as they are asked for.

    looks(part, triangle, u, v, width) -> Look: materials at points (n,) of parts' triangles, for samples as wide as
    `width` (n,) float32, metres in the mesh's space. strategy: one of strategies.STRATEGIES.
    """

    def __init__(
        self,
        octree: Octree,
        looks: Looks,
        strategy: str = "neighbourhood",
        seed: int = 0,
        failure: float = 1e-3,
    ):
        self.octree, self.looks = octree, looks
        self.strategy, self.seed, self.failure = strategy, seed, failure
        self.surfels = allocate_surfels(1 << 12)
        self.used = 0
        self.built: dict[tuple[int, int], tuple[int, int]] = {}  # (group, level) -> surfels' interval
        self._covers: dict[tuple[int, int], Surfels] = {}
        self._triangle_looks: dict[int, Look] = {}
        self._lock = threading.RLock()
        a = octree.arrays
        self.node_group = np.zeros(len(a.box), np.int32)
        self._ends = np.zeros((len(a.group_root), 2), np.int64)  # nodes of each group
        order = np.argsort(a.group_root, kind="stable")
        order = order[a.group_root[order] >= 0]
        ends = np.append(a.group_root[order], len(a.box))[1:]
        for g, end in zip(order, ends, strict=True):
            self._ends[g] = a.group_root[g], end
            self.node_group[a.group_root[g] : end] = g
        self.sets = np.zeros((len(a.box), 2), np.int64)
        self.sets[:, 0] = np.where(self._wants_set(), NOT_YET, NEVER)

    def _wants_set(self) -> np.ndarray:
        """(nodes,) bool: the nodes that may have a set."""
        a = self.octree.arrays
        is_instance = np.concatenate([[0], np.cumsum(a.item[:, 0] < 0)])
        small = a.items[:, 3] - a.items[:, 1]
        instances = is_instance[a.items[:, 3]] - is_instance[a.items[:, 1]]
        above = a.level <= CHAIN
        enough = np.where(instances == small, instances >= np.where(above, 2, INSTANCES_OF_SET), True)
        few = (instances == 0) & (small <= LEAF_TRIANGLES)
        return enough & ~few & (small > 0)

    @property
    def arrays(self) -> SetArrays:
        s = self.surfels
        return SetArrays(self.sets, s.row, s.emission, s.source, s.place)

    def require(self, wanted, progress: Callable[[float], object] | None = None) -> None:
        """Build the sets of all (group, level) in `wanted` that are not built yet. progress may raise to cancel."""
        with self._lock:
            wanted = [pair for pair in wanted if pair not in self.built]
            for i, (g, level) in enumerate(wanted):
                if progress is not None:
                    progress(i / len(wanted))
                self._build(int(g), int(level))
            self._triangle_looks.clear()

    def release(self) -> None:
        """Forget what only helps to build further levels."""
        with self._lock:
            self._covers.clear()

    def _nodes(self, g: int, level: int) -> np.ndarray:
        """Nodes of group g at `level` that have or will have a set."""
        first, end = self._ends[g]
        here = self.octree.arrays.level[first:end] == level
        return first + np.flatnonzero(here & (self.sets[first:end, 0] != NEVER))

    def spacing(self, g: int, level: int) -> float:
        """Distance of the samples of group g at `level`, in its space."""
        return float(np.ldexp(self.octree.arrays.group_side[g] * SPACING, CHAIN - level))

    def _build(self, g: int, level: int) -> None:
        if (g, level) in self.built:
            return
        nodes = self._nodes(g, level)
        spacing = self.spacing(g, level)
        a = self.octree.arrays
        first = self.used
        ranges = a.items[nodes][:, [1, 3]].astype(np.int64)
        weight = self._weights(g, ranges, spacing)
        start = 0
        while start < len(nodes):  # so many nodes at once that their candidates fit in memory
            stop = start + 1
            total = weight[start]
            while stop < len(nodes) and total + weight[stop] <= CHUNK:
                total += weight[stop]
                stop += 1
            self._build_nodes(g, nodes[start:stop], ranges[start:stop], spacing)
            start = stop
        self.built[g, level] = (first, self.used)

    def _build_nodes(self, g: int, nodes: np.ndarray, ranges: np.ndarray, spacing: float) -> None:
        candidates, node = self._gather(g, ranges, spacing * PIECE, spacing * CANDIDATE)
        kept = np.flatnonzero(candidates.row[:, AREA] > 0)
        if len(kept) < len(node):
            candidates, node = chosen(candidates, kept), node[kept]
        if not len(node):
            self.sets[nodes] = self.used, 0
            return
        apart = self._apart(nodes, node, candidates.row[:, X : Z + 1], spacing)
        found = select(
            self.strategy, apart, np.ascontiguousarray(candidates.row[:, AREA]), spacing, self.seed + g, self.failure
        )  # fmt: skip
        # samples in the order of their nodes
        home = node[found.representative]
        order = np.argsort(home, kind="stable")
        rank = np.empty(len(order), np.int32)
        rank[order] = np.arange(len(order), dtype=np.int32)
        representative = found.representative[order]
        owner = np.where(found.owner >= 0, rank[found.owner], -1).astype(np.int32)
        made = self._room(len(order))
        merge_surfels(candidates.row, candidates.emission, owner, representative, made.row, made.emission)
        made.source[:] = candidates.source[representative]
        made.place[:] = candidates.place[representative]
        counts = np.bincount(home, minlength=len(nodes))
        self.sets[nodes, 0] = self.used + np.cumsum(counts) - counts
        self.sets[nodes, 1] = counts
        self.used += len(order)

    def _room(self, n: int) -> Surfels:
        """Views of n further surfels at the end of the pool."""
        need = self.used + n
        if need + SLACK > len(self.surfels.row):
            larger = allocate_surfels(max(need + SLACK, 2 * len(self.surfels.row)))
            for old, new in zip(self.surfels, larger, strict=True):
                new[: self.used] = old[: self.used]
            self.surfels = larger
        return chosen(self.surfels, slice(self.used, need))

    def _apart(self, nodes, node, position, spacing: float) -> np.ndarray:
        """Positions with every node's moved away from the others', so that samples of one never stand for another's.

        Neighbouring nodes may be drawn at different levels: each has to cover its own surface.
        """
        box = self.octree.arrays.box[nodes]
        middle = 0.5 * (box[:, :3] + box[:, 3:])
        step = float((box[:, 3:] - box[:, :3]).max()) + 4.0 * spacing
        side = int(np.ceil(len(nodes) ** (1 / 3)))
        index = np.arange(len(nodes))
        shift = np.stack([index % side, index // side % side, index // side**2], 1) * step
        return (position + (shift - middle)[node]).astype(np.float32)

    def _weights(self, g: int, ranges: np.ndarray, spacing: float) -> np.ndarray:
        """Roughly how many candidates each interval of items has."""
        a = self.octree.arrays
        item = a.item
        size = np.where(item[:, 0] < 0, 0.0, 1.0)
        cost = np.ones(len(item))
        for first, end in ranges[:1]:
            del first, end
        lo, hi = int(ranges[:, 0].min(initial=0)), int(ranges[:, 1].max(initial=0))
        rows = item[lo:hi]
        own = np.ones(hi - lo)
        steps = np.zeros(hi - lo + 1, np.int64)
        np.add.at(steps, ranges[:, 0] - lo, 1)
        np.add.at(steps, ranges[:, 1] - lo, -1)
        inside = np.cumsum(steps[:-1]) > 0  # between the intervals lie instances far too large to cover this finely
        for b in np.unique(rows[(rows[:, 0] < 0) & inside, 0]):
            mask = (rows[:, 0] == b) & inside
            child, scale = self._placed(-1 - int(b), rows[mask, 1])
            levels = self._cover_levels(child, scale, spacing * CANDIDATE)
            counts = np.zeros(int(mask.sum()))
            for c, level in np.unique(np.stack([child, levels], 1), axis=0):
                here = (child == c) & (levels == level)
                counts[here] = len(self.cover(int(c), int(level)).row)
            own[mask] = counts
        del size, cost
        sums = np.concatenate([[0.0], np.cumsum(own)])
        return sums[ranges[:, 1] - lo] - sums[ranges[:, 0] - lo]

    # What stands for a group's surface

    def cover(self, g: int, level: int) -> Surfels:
        """All of group g as surfels of the spacing of `level`: its sets there, and what has none cut to pieces."""
        key = (g, level)
        if key not in self._covers:
            self._build(g, level)
            a = self.octree.arrays
            nodes = self._nodes(g, level)
            root = a.group_root[g]
            first, end = int(a.items[root, 0]), int(a.items[root, 3])
            inside = a.items[nodes][:, [1, 3]].astype(np.int64)
            edges = np.concatenate([[first], inside.ravel(), [end]])
            outside = edges.reshape(-1, 2)
            outside = outside[outside[:, 1] > outside[:, 0]]
            low, high = self.built[key]
            parts = [chosen(self.surfels, slice(low, high))] if high > low else []
            if len(outside):
                spacing = self.spacing(g, level)
                parts.append(self._gather(g, outside, spacing, spacing)[0])
            cover = joined(parts)
            kept = cover.row[:, AREA] > 0
            self._covers[key] = cover if kept.all() and len(parts) != 1 else chosen(cover, kept)
        return self._covers[key]

    def _placed(self, batch: int, placement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(groups, largest scales) of placements of a batch."""
        geometry = self.octree.geometry
        instances = geometry.batches[batch]
        index = {id(g): i for i, g in enumerate(geometry.groups)}
        groups = np.array([index[id(g)] for g in instances.groups], np.int64)
        which = instances.group_index
        if which is None:
            child = np.full(len(placement), groups[0])
        else:
            child = groups[which[placement] if len(which) > 1 else np.repeat(which, len(placement))]
        linear = np.asarray(instances.transforms[placement, :, :3], np.float64)
        return child, np.sqrt((linear**2).sum(1).max(1))

    def _cover_levels(self, child: np.ndarray, scale: np.ndarray, spacing: float) -> np.ndarray:
        """Levels at which groups `child`, placed with `scale`, have samples at most `spacing` apart."""
        root = np.ldexp(self.octree.arrays.group_side[child] * SPACING, CHAIN) * scale
        with np.errstate(divide="ignore"):
            levels = np.ceil(np.log2(np.maximum(root / spacing, 1e-300)))
        return np.clip(levels, 0, MAX_LEVEL).astype(np.int64)

    def _gather(self, g: int, ranges: np.ndarray, piece: float, spacing: float) -> tuple[Surfels, np.ndarray]:
        """(surfels, the interval that each belongs to) of all items in the intervals, in group g's space.

        Triangles are cut to pieces of size `piece`; instances are covered with surfels `spacing` apart.
        """
        a = self.octree.arrays
        lengths = ranges[:, 1] - ranges[:, 0]
        home = np.repeat(np.arange(len(ranges)), lengths)
        at = np.arange(len(home)) + np.repeat(ranges[:, 0] - (np.cumsum(lengths) - lengths), lengths)
        item = a.item[at]
        parts, homes = [], []
        for p in np.unique(item[:, 0]):
            rows = np.flatnonzero(item[:, 0] == p)
            if p >= 0:
                surfels, which = self._pieces(g, int(p), item[rows, 1], piece)
                parts.append(surfels)
                homes.append(home[rows][which])
            else:
                self._instances(g, -1 - int(p), item[rows, 1], home[rows], spacing, parts, homes)
        if not parts:
            return allocate_surfels(0), np.zeros(0, np.int64)
        return joined(parts), np.concatenate(homes)

    def _pieces(self, g: int, part: int, triangle: np.ndarray, size: float) -> tuple[Surfels, np.ndarray]:
        geometry, a = self.octree.geometry, self.octree.arrays
        shape = geometry.shapes[geometry.tables.shape[part]]
        shift = a.part_offset[part] - a.group_center[g]
        corners = shape.positions[shape.triangles[triangle]] + shift
        pieces = cut(corners, size)
        n = len(pieces.triangle)
        surfels = allocate_surfels(n)
        surfels.row[:, X : Z + 1] = pieces.position
        surfels.row[:, XX : ZZ + 1] = pieces.covariance
        surfels.source[:, 0] = part
        surfels.source[:, 1] = triangle[pieces.triangle]
        surfels.place[:, 0], surfels.place[:, 1] = pieces.u, pieces.v
        look = self._look(part, surfels, pieces.triangle, len(triangle), size)
        surfels.row[:, AREA] = pieces.area * look.alpha
        surfels.row[:, NX : NX + 3] = look.normal
        surfels.row[:, RED : BLUE + 1] = look.albedo
        surfels.emission[:] = look.emission
        return surfels, pieces.triangle

    def _look(self, part: int, surfels: Surfels, piece: np.ndarray, triangles: int, size: float) -> Look:
        """Materials of pieces; those of whole triangles are kept until all levels wanted now are built."""
        source, place = surfels.source, surfels.place
        if len(piece) != triangles or triangles < 1024:
            width = np.full(len(piece), size, np.float32)
            return self.looks(source[:, 0], source[:, 1], place[:, 0], place[:, 1], width)
        if part not in self._triangle_looks:
            shape = self.octree.geometry.shapes[self.octree.geometry.tables.shape[part]]
            n = len(shape.triangles)
            third = np.full(n, 1 / 3, np.float32)
            corners = shape.positions[shape.triangles]
            width = np.sqrt(
                np.abs(
                    np.linalg.norm(
                        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
                    )
                )
            )
            self._triangle_looks[part] = self.looks(
                np.full(n, part, np.int32),
                np.arange(n, dtype=np.int32),
                third,
                third,
                width.astype(np.float32),
            )
        return Look(*(column[source[:, 1]] for column in self._triangle_looks[part]))

    def _instances(self, g, batch, placement, home, spacing, parts, homes) -> None:
        a, geometry = self.octree.arrays, self.octree.geometry
        child, scale = self._placed(batch, placement)
        levels = self._cover_levels(child, scale, spacing)
        address = np.uint64(geometry.instances.transforms[batch])
        for c, level in np.unique(np.stack([child, levels], 1), axis=0):
            rows = np.flatnonzero((child == c) & (levels == level))
            cover = self.cover(int(c), int(level))
            size = len(cover.row)
            if not size:
                continue
            placed = Surfels(
                np.empty((size * len(rows), COLUMNS), np.float32),
                np.tile(cover.emission, (len(rows), 1)),
                np.tile(cover.source, (len(rows), 1)),
                np.tile(cover.place, (len(rows), 1)),
            )
            place_surfels(
                cover.row, address, placement[rows].astype(np.int64), np.arange(len(rows)) * size,
                a.group_center[c], a.group_center[g], placed.row,
            )  # fmt: skip
            parts.append(placed)
            homes.append(np.repeat(home[rows], size))
