"""Opacity micromaps: where triangles with holes let all light through, and where none, two bits for each of their
cells, so that shadow rays pass or end without asking the material (Gruen, Benthin, Woop 2020, "Sub-triangle opacity
masks for faster ray tracing of transparent objects").

What is half transparent or coloured, and what lies at an outline, is asked for at the very point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pointmr_engine.forward.baked.opacity_lattice import batches, in_triangle, lattice
from pointmr_engine.forward.drawing.cut_outs import lattices
from pointmr_engine.forward.drawing.part_opacity import PartOpacity, largest
from pointmr_engine.hierarchy.acceleration import Acceleration, set_micromap
from pointmr_engine.hierarchy.geometry import triangle_materials
from pointmr_engine.shading.points import names_of

FINEST = 64  # cells along an edge at most: bits of a word
COARSEST = 8  # below, cells that are like all their neighbours are too few to be worth it
LOOKS = 2_000_000  # at most, over all triangles that differ, each time that cells are halved
MOST = 30_000_000  # cells at most, looked at or not
ELSEWHERE = 1 << 30  # added to a row's number, for other places in its cells
REFUTED = 0.01  # of the cells that seem sure: more of them are by chance
CLEAR, SOLID = 1.0 - 1e-6, 1e-6  # shares of light, in every channel
# what a triangle's own points decide, wherever it is placed and whoever looks
_OWN = {"uv", "attribute", "local", "generated", "barycentric"}


def with_micromap(acceleration: Acceleration, sampler) -> Acceleration:
    """The acceleration whose shadow rays ask only where the micromap does not know; itself where it knows nothing."""
    if sampler.micromap is None:
        sampler.micromap = build_micromap(sampler.opacity, sampler.densest_cut_outs)
    return set_micromap(acceleration, *sampler.micromap) if sampler.micromap[-1] else acceleration


def build_micromap(opacity_of: PartOpacity, cut_outs) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """(first, row, bits, side) as acceleration.set_micromap takes them; side 0 where nothing is worth it.

    cut_outs: forward.drawing.cut_outs.CutOuts of the channel that is blocked most, whose triangles share samples.
    """
    whole = (lattices(cut_outs) == 255).all((1, 2))
    groups = _to_know(opacity_of.geometry, opacity_of.programs, cut_outs)
    patterns = _refine(
        opacity_of, [(part, m, own[~whole[row]], row[~whole[row]]) for part, m, own, row in groups]
    )
    side = patterns[0].side if patterns else COARSEST
    # words of triangles with a pattern, and one for all that are opaque as a whole
    patterned = np.unique(np.concatenate([p.row for p in patterns] or [np.zeros(0, np.int64)]))
    words, solid = np.zeros((len(patterned) + 1, side, 2), np.int64), len(patterned)
    words[solid, :, 1] = -1
    words_of = np.full(len(whole), -1)
    words_of[patterned] = np.arange(len(patterned))
    for p in patterns:
        words[words_of[p.row]] = _words(p.known)
    few = _side(sum(int(whole[row].sum()) for *_, row in groups), COARSEST)
    for part, material, triangles, row in groups:
        for own in batches(np.flatnonzero(whole[row]), few) if few else ():
            cells = np.broadcast_to(in_triangle(few), (len(own), few, few))
            share = _shares(opacity_of, part, material, triangles[own], row[own], cells)
            opaque = np.ones(cells.shape, np.bool_)
            opaque[cells] = largest(share) <= SOLID
            words_of[row[own[opaque.all((1, 2))]]] = solid
    known = words_of >= 0
    known[known] = words.any((1, 2))[words_of[known]]
    first_row = np.where(known, words_of * side, -1)
    row = np.where(cut_outs.mask >= 0, first_row[cut_outs.mask], -1).astype(np.int32)
    return cut_outs.first, row, words.reshape(-1, 2), side if known.any() else 0


@dataclass
class Pattern:
    """Triangles (n,) of a part that have a pattern, rows (n,) of CutOuts, and what is known of their R x R cells.

    known: (2, n, R, R) bool, [.., q, p]: cells that are clear, and those that are opaque. open: (n, R, R) bool: those
    that may be found to be so.
    """

    part: int
    material: int
    triangles: np.ndarray
    row: np.ndarray
    known: np.ndarray
    open: np.ndarray

    @classmethod
    def unseen(cls, part: int, material: int, triangles: np.ndarray, row: np.ndarray, side: int) -> Pattern:
        """Of side x side cells, of which nothing is known yet."""
        known = np.zeros((2, len(row), side, side), np.bool_)
        return cls(part, material, triangles, row, known, np.repeat(in_triangle(side)[None], len(row), 0))

    @property
    def side(self) -> int:
        return self.known.shape[-1]

    def halve(self) -> None:
        """Divide all cells into two by two, of which is known what is known of the whole."""
        self.known = self.known.repeat(2, 2).repeat(2, 3)
        self.open = self.open.repeat(2, 1).repeat(2, 2) & in_triangle(self.side)

    def look(self, opacity_of: PartOpacity) -> None:
        """Look at the open cells: which of all are surely clear or opaque, and are so when looked at elsewhere.

        None of a triangle where that refutes too many: its pattern, many tiles of a fence, say, is finer than the
        cells, and neighbours that agree do so by chance.
        """
        for own in batches(np.arange(len(self.row)), self.side):
            cells, known = self.open[own], self.known[:, own]
            alike = known.copy()
            alike[:, cells] = self._alike(opacity_of, own, self.row[own], cells)
            sure = np.stack([surely(a) for a in alike])
            again, still = (sure & cells).any(0), known.copy()
            still[:, again] = self._alike(opacity_of, own, self.row[own] + ELSEWHERE, again)
            refuted = (sure & ~still).sum((2, 3)) > REFUTED * sure.sum((2, 3))
            self.known[:, own] = known = sure & still & ~refuted[..., None, None]
            # what lies amid others that are neither will not be found to be clear or opaque in parts
            self.open[own] = in_triangle(self.side) & ~known.any(0) & ~surely(~alike.any(0))

    def _alike(
        self, opacity_of: PartOpacity, own: np.ndarray, row: np.ndarray, cells: np.ndarray
    ) -> np.ndarray:
        """(2, N) bool: whether a place of each of the N `cells` (n, R, R) bool of triangles `own` is clear, opaque."""
        share = _shares(opacity_of, self.part, self.material, self.triangles[own], row, cells)
        return np.stack([-largest(-share) >= CLEAR, largest(share) <= SOLID])


def _refine(opacity_of: PartOpacity, groups: list[tuple]) -> list[Pattern]:
    """What is known of the patterned triangles of groups, as _to_know has them less those that are opaque as a whole.

    Cells are halved as long as few are open: few looks find where outlines are not.
    """
    count = len(np.unique(np.concatenate([row for *_, row in groups]))) if groups else 0
    most = _side(count / 2, FINEST)  # half of a lattice lies beyond the triangle
    if not count or most < COARSEST:
        return []
    first = COARSEST << int(math.log2(most / COARSEST))
    patterns = [Pattern.unseen(*group, first) for group in groups]
    while True:
        for pattern in patterns:
            pattern.look(opacity_of)
        side = 2 * patterns[0].side
        looks = 4 * sum(int(p.open.sum()) for p in patterns)
        if side > FINEST or not 0 < looks <= LOOKS or count * side**2 > MOST:
            return patterns
        for pattern in patterns:
            pattern.halve()


def _side(count: float, most: int) -> int:
    """Cells along the edges of `count` triangles, for no more looks than LOOKS."""
    return int(min(math.sqrt(LOOKS / max(count, 1)), most))


def _shares(
    opacity_of: PartOpacity, part: int, material: int, triangles: np.ndarray, row: np.ndarray, cells: np.ndarray
) -> np.ndarray:  # fmt: skip
    """(N, 3) share of light that passes triangles (n,) of a part at a place in each of N cells (n, R, R) bool."""
    u, v = lattice(cells.shape[1], row)
    index = np.nonzero(cells)[0]
    return opacity_of.transparency(material, part, triangles[index], u[cells], v[cells])


def _words(known: np.ndarray) -> np.ndarray:
    """(n, R, 2) int64: a bit for each of the cells (2, n, R, R) that are known."""
    return (known << np.arange(known.shape[-1], dtype=np.int64)).sum(-1).transpose(1, 2, 0)


def surely(alike: np.ndarray) -> np.ndarray:
    """(M, R, R) bool: cells whose samples (M, R, R) are so and all of whose neighbours' in the triangle are."""
    side = alike.shape[1]
    own = in_triangle(side)
    padded = np.pad(alike | ~own, ((0, 0), (1, 1), (1, 1)), constant_values=True)
    result = alike & own
    for y in range(3):
        for x in range(3):
            result &= padded[:, y : y + side, x : x + side]
    return result


def _to_know(geometry, programs: list, cut_outs) -> list[tuple]:
    """(part, material, its triangles (n,), rows (n,) of cut_outs) of those with holes or opaque places."""
    found = []
    opacity = lattices(cut_outs)
    worth = ((opacity == 0) | (opacity == 255)).any((1, 2))
    for part, mesh in enumerate(geometry.parts):
        if cut_outs.first[part] < 0:
            continue
        n = len(mesh.triangles)
        mask, material = cut_outs.mask[cut_outs.first[part] :][:n], triangle_materials(geometry, part)
        for m in np.unique(material):
            program = programs[m]
            if program.opaque or not names_of(program.transparency_needs) <= _OWN:
                continue
            own = np.flatnonzero((material == m) & (mask >= 0))
            own = own[worth[mask[own]]]
            row, leader = np.unique(mask[own], return_index=True)
            if len(row):
                found.append((part, m, own[leader], row))
    return found
