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
from numba import njit

from pointmr_engine.hierarchy.candidates import Candidates, Looks
from pointmr_engine.hierarchy.exposure import exposure
from pointmr_engine.hierarchy.octree import CHAIN, LEAF_TRIANGLES, SPACING, Octree
from pointmr_engine.hierarchy.self_hiding import GAPS, PLACES, seen_share
from pointmr_engine.hierarchy.set_chunks import CHUNK_OF, bound_chunks, in_space_order
from pointmr_engine.hierarchy.set_files import SetFiles, StoredSets
from pointmr_engine.hierarchy.strategies import select
from pointmr_engine.hierarchy.surface_split import split_surfaces
from pointmr_engine.hierarchy.surfels import (
    AREA,
    COLUMNS,
    Surfels,
    X,
    allocate_surfels,
    chosen,
    joined,
    merge_surfels,
    typical_rows,
)
from pointmr_engine.numerics.run_all import run_all

NEVER, NOT_YET = -1, -2  # in SetArrays.sets[:, 0]: the node has no set; its set is not built yet
# Below a cell that fits its group, nodes of fewer instances have no set: their groups' sets serve. Groups of many
# instances would need too much memory for as many sets as groups of few, of which the walk may meet millions.
INSTANCES_OF_SET, INSTANCES_OF_LARGE_SET, LARGE_GROUP = 3, 32, 4096
# up to this level samples are so far apart that what is hidden inside a group must not mix in
EXPOSED = CHAIN + 1
EXPOSED_CELLS = 64  # of a group's side: how finely it is looked at to tell
PIECE = 0.5  # of the spacing: the size that triangles are cut to before samples are chosen
CANDIDATE = 0.5  # of the spacing: the spacing of the surfels that stand for an instance among the candidates
SLACK = 8  # rows past the last surfel that may be read, for kernels that take several at once
# candidates at once: few stay in the cache; of what must be seen as a whole, as many as memory allows
CHUNK, WHOLE = 32_000, 2_000_000
LATTICE = 4096.0  # spacings along an axis over which nodes are put apart: float32 places stay exact to 1/4096 of one

_met: set[tuple] = set()  # kinds of sets that this process built: their kernels are compiled


class SetArrays(NamedTuple):
    """The sets as kernels read them."""

    sets: np.ndarray  # (N, 2) int64 per octree node: first surfel or NEVER or NOT_YET, number of surfels
    row: np.ndarray  # (S, 16) float32, Surfels.row
    emission: np.ndarray  # (S, 3) float32; (1, 3) while no surfel emits
    source: np.ndarray  # (S, 2) int32
    place: np.ndarray  # (S, 2) float32
    # (S / 8 + 8, 16) float32: a ball about each eight rows, as a surfel (set_chunks)
    chunk: np.ndarray


class SampleSets:
    """The sample sets of an octree, built level by level as they are asked for.

    looks(part, triangle, u, v, width) -> candidates.Look: materials at points (n,) of parts' triangles, for
    samples as wide as `width` (n,) float32, metres in the mesh's space. strategy: one of strategies.STRATEGIES.
    folder: where sets are kept between runs and found again (set_files); None: nowhere. exposed: coarse sets
    average what can be seen of their group (exposure), and areas are less what a sample's pieces hide of each other
    (self_hiding), which is what images need; without, they are all of the surface.
    """

    def __init__(
        self,
        octree: Octree,
        looks: Looks,
        strategy: str = "neighbourhood",
        seed: int = 0,
        failure: float = 1e-3,
        folder: str | None = None,
        exposed: bool = True,
    ):
        self.octree = octree
        self.exposed = exposed
        self.strategy, self.seed, self.failure = strategy, seed, failure
        constants = (
            INSTANCES_OF_SET,
            INSTANCES_OF_LARGE_SET,
            LARGE_GROUP,
            EXPOSED if exposed else -1,
            EXPOSED_CELLS,
            PIECE,
            CANDIDATE,
            CHUNK,
            WHOLE,
            LATTICE,
            PLACES,
            GAPS,
        )
        how = (strategy, seed, failure if strategy == "random" else 0.0)
        self.files = SetFiles(folder, octree.geometry, (how, constants)) if folder else None
        self.surfels = allocate_surfels(1 << 12)
        self.chunks = np.zeros(((1 << 12) // CHUNK_OF + SLACK, COLUMNS), np.float32)
        self.used = 0
        self.built: dict[tuple[int, int], tuple[int, int]] = {}  # (group, level) -> surfels' interval
        # of those that are built, how many by sampling, from files, and as they were in an earlier scene
        self.made = self.loaded = self.adopted = 0
        self._ready: dict[tuple[int, int], StoredSets] = {}  # on the way to `built`
        self._covers: dict[tuple[int, int], Surfels] = {}
        self._exposures: dict[tuple, np.ndarray] = {}
        self._candidates = Candidates(octree, looks, self.cover)
        self._lock, self._counting = threading.RLock(), threading.Lock()
        self._locks: dict[tuple, threading.Lock] = {}
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
        roots = np.maximum(a.group_root, 0)
        in_group = is_instance[a.items[roots, 3]] - is_instance[a.items[roots, 0]] if len(a.items) else roots
        least = np.where(in_group[self.node_group] > LARGE_GROUP, INSTANCES_OF_LARGE_SET, INSTANCES_OF_SET)
        enough = np.where(instances == small, instances >= np.where(above, 2, least), True)
        few = (instances == 0) & (small <= LEAF_TRIANGLES)
        return enough & ~few & (small > 0)

    @property
    def arrays(self) -> SetArrays:
        return SetArrays(self.sets, *self.surfels, self.chunks)

    def bytes_per_triangle(self) -> float:
        """Memory of all sets that are there, per unique triangle."""
        s, used = self.surfels, self.used
        total = sum(c[:used].nbytes for c in (s.row, s.emission, s.source, s.place)) + self.sets.nbytes
        return total / max(1, self.octree.geometry.unique_triangles)

    def statistics(self) -> dict[str, int]:
        """How many sets were made by sampling, and how many came from files; bytes read and written."""
        files = self.files
        result = {
            "sample_sets_made": self.made,
            "sample_sets_loaded": self.loaded,
            "sample_sets_adopted": self.adopted,
        }
        if files is not None:
            result |= {
                "sample_set_bytes_read": files.bytes_read,
                "sample_set_bytes_written": files.bytes_written,
            }
        return result

    def take_warnings(self) -> list[str]:
        """What could not be read or written since this was last asked."""
        warnings = [] if self.files is None else self.files.warnings
        taken = warnings[:]
        del warnings[: len(taken)]
        return taken

    def require(
        self, wanted, progress: Callable[[float], object] | None = None, threads: int | None = None
    ) -> None:
        """Build the sets of all (group, level) in `wanted` that are not built yet. progress may raise to cancel.

        The sets do not depend on `threads` (None or 0: one per core), nor on the order in which they are asked for.
        """
        with self._lock:
            wanted = [(int(g), int(level)) for g, level in wanted]
            wanted = [pair for pair in dict.fromkeys(wanted) if pair not in self.built]
            try:
                self._make_all(wanted, progress or (lambda fraction: None), threads)
                self._take(wanted)
            finally:
                self._candidates.clear()
                self._exposures.clear()

    def adopt(self, earlier: SampleSets) -> None:
        """Take over the sets that were built, in the same way, of groups that this scene has, too: the same objects."""
        groups = {id(group): g for g, group in enumerate(self.octree.geometry.groups)}
        parts = {id(mesh): part for part, mesh in enumerate(self.octree.geometry.parts)}
        before = earlier.octree.geometry
        part_of = np.array([parts.get(id(mesh), -1) for mesh in before.parts] or [-1], np.int32)
        taken = []
        for (g, level), (first, end) in earlier.built.items():
            own = groups.get(id(before.groups[g]))
            if own is None or first == end:
                continue
            surfels = chosen(earlier.surfels, slice(first, end))
            source = surfels.source.copy()
            source[:, 0] = part_of[source[:, 0]]
            counts = earlier.sets[earlier._nodes(g, level), 1]
            if (source[:, 0] < 0).any() or len(counts) != len(self._nodes(own, level)):
                continue
            self._ready[own, level] = StoredSets(counts, surfels._replace(source=source))
            taken.append((own, level))
        self._take(taken)
        self.adopted += len(taken)

    def spacing(self, g: int, level: int) -> float:
        """Distance of the samples of group g at `level`, in its space."""
        return float(np.ldexp(self.octree.arrays.group_side[g] * SPACING, CHAIN - level))

    # Building

    def _make_all(self, wanted: list[tuple[int, int]], progress, threads: int | None) -> None:
        """Make what is wanted ready: the first of its kind here, since numba must not meet new types on two threads."""
        rest, done = [], 0
        for g, level in wanted:
            kind = (self.strategy, bool(self.octree.geometry.group_batches[g]))
            if kind in _met:
                rest.append((g, level))
                continue
            progress(done / len(wanted))
            self._make(g, level)
            _met.add(kind)
            done += 1
        run_all(self._make, rest, threads, lambda part: progress((done + part * len(rest)) / len(wanted)))

    def _make(self, g: int, level: int) -> Surfels:
        """The surfels of group g at `level`: built already, or ready, or from a file, or made now. For any thread."""
        key = g, level
        with self._locks.setdefault(key, threading.Lock()):
            if key in self.built:
                return chosen(self.surfels, slice(*self.built[key]))
            if key not in self._ready:
                nodes = self._nodes(g, level)
                if not len(nodes):
                    return allocate_surfels(0)
                sets = self.files.load(g, level, len(nodes)) if self.files else None
                loaded = sets is not None
                if sets is None:
                    sets = self._sample(g, level, nodes)
                    if self.files:
                        self.files.store(g, level, sets)
                self._count(loaded)
                self._ready[key] = sets
            return self._ready[key].surfels

    def _count(self, loaded: bool) -> None:
        with self._counting:
            self.loaded += loaded
            self.made += not loaded

    def _take(self, wanted: list[tuple[int, int]]) -> None:
        """Put what is ready into the pool that kernels read; then what others were made from, wanted or not."""
        for g, level in [*wanted, *sorted(self._ready.keys() - set(wanted))]:
            if (g, level) not in self._ready:  # no node of this level has a set
                self.built[g, level] = self.used, self.used
                continue
            sets = self._ready[g, level]
            n, counts = len(sets.surfels.row), sets.counts
            self._append(sets.surfels)
            nodes = self._nodes(g, level)
            self.sets[nodes, 0] = self.used + np.cumsum(counts) - counts
            self.sets[nodes, 1] = counts
            self.built[g, level] = self.used, self.used + n
            self.used += n
            del self._ready[g, level]

    def _append(self, surfels: Surfels) -> None:
        """Copy surfels to the end of the pool."""
        pool, used, end = self.surfels, self.used, self.used + len(surfels.row)
        if end + SLACK > len(pool.row):
            pool = allocate_surfels(max(end + SLACK, 2 * len(pool.row)))
            if len(self.surfels.emission) > 1:
                pool = pool._replace(emission=np.empty((len(pool.row), 3), np.float32))
                pool.emission[:used] = self.surfels.emission[:used]
            for name in ("row", "source", "place"):
                getattr(pool, name)[:used] = getattr(self.surfels, name)[:used]
        if surfels.emission.any() and len(pool.emission) == 1:
            pool = pool._replace(emission=np.zeros((len(pool.row), 3), np.float32))
        for name in ("row", "source", "place"):
            getattr(pool, name)[used:end] = getattr(surfels, name)
        if len(pool.emission) > 1:
            pool.emission[used:end] = surfels.emission
        if len(self.chunks) < end // CHUNK_OF + SLACK:
            chunks = np.zeros((len(pool.row) // CHUNK_OF + SLACK, COLUMNS), np.float32)
            chunks[: len(self.chunks)] = self.chunks
            self.chunks = chunks
        bound_chunks(pool.row, np.int64(used), np.int64(end), self.chunks)
        self.surfels = pool

    def _nodes(self, g: int, level: int) -> np.ndarray:
        """Nodes of group g at `level` that have or will have a set."""
        first, end = self._ends[g]
        here = self.octree.arrays.level[first:end] == level
        return first + np.flatnonzero(here & (self.sets[first:end, 0] != NEVER))

    def _sample(self, g: int, level: int, nodes: np.ndarray) -> StoredSets:
        """The sets of `nodes`, so many nodes at once that their candidates fit in memory."""
        spacing = self.spacing(g, level)
        ranges = self.octree.arrays.items[nodes][:, [1, 3]].astype(np.int64)
        weight = np.cumsum(self._candidates.weights(g, ranges, spacing * CANDIDATE))
        parts: list[StoredSets] = []
        coarse = level <= EXPOSED and self.exposed
        most = WHOLE if coarse else CHUNK
        start = 0
        while start < len(nodes):
            before = weight[start - 1] if start else 0.0
            stop = max(start + 1, int(np.searchsorted(weight, before + most, side="right")))
            whole = coarse and stop - start == len(nodes)
            self._sample_nodes(g, ranges[start:stop], spacing, parts, whole)
            start = stop
        counts = np.concatenate([p.counts for p in parts]) if parts else np.zeros(0, np.int64)
        return StoredSets(counts, joined([p.surfels for p in parts]))

    def _sample_nodes(
        self, g: int, ranges: np.ndarray, spacing: float, out: list[StoredSets], whole: bool = False
    ) -> None:
        """Append the sets of the nodes with items in `ranges` (N, 2) to `out`; whole: they are all that is in the
        group."""
        if whole:
            candidates, node, whole_area = self._exposed(g, ranges, spacing)
        else:
            candidates, node = self._candidates.gather(g, ranges, spacing * PIECE, spacing * CANDIDATE)
            whole_area = None
        if not len(node):
            out.append(StoredSets(np.zeros(len(ranges), np.int64), candidates))
            return
        apart = np.empty((len(node), 3), np.float32)
        if not _apart(candidates.row, node, np.int64(len(ranges)), spacing, LATTICE * spacing, apart):
            half = len(ranges) // 2
            self._sample_nodes(g, ranges[:half], spacing, out)
            self._sample_nodes(g, ranges[half:], spacing, out)
            return
        area = np.ascontiguousarray(candidates.row[:, AREA])
        found = select(self.strategy, apart, area, spacing, self.seed, self.failure)
        owner, place = found.owner, found.representative
        if self.octree.geometry.group_batches[
            g
        ]:  # surfaces of the group itself are large triangles, kept as they are
            owner, place = split_surfaces(candidates.row, owner, place, spacing)
        # samples in the order of their nodes, and in each so that neighbours in space are neighbours in memory
        home = node[place]
        order = in_space_order(candidates.row, place.astype(np.int64), home, spacing)
        rank = np.empty(len(order), np.int32)
        rank[order] = np.arange(len(order), dtype=np.int32)
        representative = place[order]
        owner = np.where(owner >= 0, rank[owner], np.int32(-1))
        row = np.empty((len(order), COLUMNS), np.float32)
        emission = np.empty((len(order) if len(candidates.emission) > 1 else 1, 3), np.float32)
        if len(candidates.emission) == 1:
            emission[:] = candidates.emission
        merge_surfels(candidates.row, candidates.emission, owner, representative, row, emission)
        if self.exposed:
            if whole_area is not None:  # what is hidden takes no part in means, but it covers
                area, owned = whole_area, owner >= 0
                row[:, AREA] = np.bincount(owner[owned], area[owned], len(order))
            row[:, AREA] *= seen_share(candidates.row, area, owner, len(order))
        typical = representative.astype(np.int64)
        typical_rows(candidates.row, owner, row, typical)
        made = Surfels(row, emission, candidates.source[typical], candidates.place[typical])
        out.append(StoredSets(np.bincount(home, minlength=len(ranges)), made))

    def _exposed(self, g: int, ranges: np.ndarray, spacing: float) -> tuple[Surfels, np.ndarray, np.ndarray]:
        """Candidates as `Candidates.gather` has them, fine enough to tell what hides what; hidden ones lose area.

        The third value is the area (N,) float32 that they had.
        """
        fine = float(self.octree.arrays.group_side[g]) / EXPOSED_CELLS
        candidates, node = self._candidates.gather(
            g, ranges, min(spacing * PIECE, 4.0 * fine), min(spacing * CANDIDATE, fine)
        )
        key = g, len(node), int(ranges[0, 0]) if len(ranges) else 0, int(ranges[:, 1].max(initial=0))
        with self._locks.setdefault(("exposed", *key), threading.Lock()):
            if key not in self._exposures:
                self._exposures[key] = exposure(candidates.row)
        row = candidates.row.copy()
        row[:, AREA] *= self._exposures[key]
        return candidates._replace(row=row), node, np.ascontiguousarray(candidates.row[:, AREA])

    # What stands for a group's surface

    def cover(self, g: int, level: int) -> Surfels:
        """All of group g as surfels of the spacing of `level`: its sets there, and what has none cut to pieces."""
        key = g, level
        with self._locks.setdefault(("cover", *key), threading.Lock()):
            if key not in self._covers:
                parts = [self._make(g, level)]
                a = self.octree.arrays
                root = a.group_root[g]
                first, end = int(a.items[root, 0]), int(a.items[root, 3])
                inside = a.items[self._nodes(g, level)][:, [1, 3]].astype(np.int64)
                outside = np.concatenate([[first], inside.ravel(), [end]]).reshape(-1, 2)
                outside = outside[outside[:, 1] > outside[:, 0]]
                if len(outside):
                    spacing = self.spacing(g, level)
                    parts.append(self._candidates.gather(g, outside, spacing, spacing)[0])
                cover = joined(parts)
                # a copy: a part of the pool would keep all of it alive
                self._covers[key] = chosen(cover, np.flatnonzero(cover.row[:, AREA] > 0))
            return self._covers[key]


@njit(cache=True, nogil=True, error_model="numpy")
def _apart(rows, node, nodes, spacing, limit, out):
    """Places of surfels, every node's moved away from the others': samples of one never stand for another's surface.

    Neighbouring nodes may be drawn at different levels: each has to cover its own surface. False if that takes more
    than `limit` along an axis, where single precision would end.
    """
    low, high = np.full((nodes, 3), np.inf), np.full((nodes, 3), -np.inf)
    for i in range(len(rows)):
        n = node[i]
        for k in range(3):
            x = np.float64(rows[i, X + k])
            low[n, k] = min(low[n, k], x)
            high[n, k] = max(high[n, k], x)
    step = 0.0
    for n in range(nodes):
        for k in range(3):
            step = max(step, high[n, k] - low[n, k])
    step += 4.0 * spacing
    side = np.int64(np.ceil(np.float64(nodes) ** (1.0 / 3.0)))
    if nodes > 1 and side * step > limit:
        return False
    for n in range(nodes):
        low[n, 0] -= n % side * step
        low[n, 1] -= n // side % side * step
        low[n, 2] -= n // (side * side) * step
    for i in range(len(rows)):
        n = node[i]
        for k in range(3):
            out[i, k] = np.float64(rows[i, X + k]) - low[n, k]
    return True
