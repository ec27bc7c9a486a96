"""Opacity micromaps: where triangles with holes let all light through, and where none, two bits for each of their
cells, so that shadow rays pass or end without asking the material (Gruen, Benthin, Woop 2020, "Sub-triangle opacity
masks for faster ray tracing of transparent objects").

What is half transparent or coloured, and what lies at an outline, is asked for at the very point.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.baked.opacity_lattice import batches, in_triangle, lattice
from pointmr_engine.forward.drawing.cut_outs import lattices
from pointmr_engine.forward.drawing.part_opacity import PartOpacity
from pointmr_engine.hierarchy.acceleration import Acceleration, set_micromap
from pointmr_engine.hierarchy.geometry import triangle_materials
from pointmr_engine.shading.points import names_of

FINEST = 64  # cells along an edge at most: bits of a word
COARSEST = 8  # below, cells that are like all their neighbours are too few to be worth it
LOOKS = 1_500_000  # at most, over all triangles that differ
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
    nothing = cut_outs.first, np.zeros(0, np.int32), np.zeros((0, 2), np.int64), 0
    whole = (lattices(cut_outs) == 255).all((1, 2))
    groups = _to_know(opacity_of.geometry, opacity_of.programs, cut_outs)
    patterned = np.unique(np.concatenate([row[~whole[row]] for *_, row in groups])) if groups else whole[:0]
    side = _side(len(patterned), FINEST)
    if not groups or side < COARSEST:
        return nothing
    # words of triangles with a pattern, and one for all that are opaque as a whole
    words, solid = np.zeros((len(patterned) + 1, side, 2), np.int64), len(patterned)
    words[solid, :, 1] = -1
    words_of = np.full(len(whole), -1)
    words_of[patterned] = np.arange(len(patterned))
    few = _side(sum(int(whole[row].sum()) for *_, row in groups), COARSEST)
    for part, material, triangles, row in groups:
        for own in batches(np.flatnonzero(~whole[row]), side):
            share = _shares(opacity_of, part, material, triangles[own], row[own], side)
            again = _shares(opacity_of, part, material, triangles[own], row[own] + ELSEWHERE, side)
            words[words_of[row[own]]] = np.stack(
                [
                    _words(_known(share.min(3) >= CLEAR, again.min(3) >= CLEAR)),
                    _words(_known(share.max(3) <= SOLID, again.max(3) <= SOLID)),
                ],
                2,
            )
        for own in batches(np.flatnonzero(whole[row]), few) if few else ():
            share = _shares(opacity_of, part, material, triangles[own], row[own], few)
            words_of[row[own[(share <= SOLID).all((1, 2, 3))]]] = solid
    known = words_of >= 0
    known[known] = words.any((1, 2))[words_of[known]]
    first_row = np.where(known, words_of * side, -1)
    row = np.where(cut_outs.mask >= 0, first_row[cut_outs.mask], -1).astype(np.int32)
    return cut_outs.first, row, words.reshape(-1, 2), side if known.any() else 0


def _side(count: int, most: int) -> int:
    """Cells along the edges of `count` triangles, for no more looks than LOOKS."""
    return int(min(math.sqrt(LOOKS / max(count, 1)), most))


def _shares(
    opacity_of: PartOpacity, part: int, material: int, triangles: np.ndarray, row: np.ndarray, side: int
) -> np.ndarray:
    """(n, side, side, 3) share of light that passes triangles (n,) of a part at a place in each of their cells."""
    u, v = (a.ravel() for a in lattice(side, row))
    share = opacity_of.transparency(material, part, np.repeat(triangles, side * side), u, v)
    return share.reshape(len(row), side, side, 3)


def _words(known: np.ndarray) -> np.ndarray:
    """(n, R) int64: a bit for each of the cells (n, R, R) that are known."""
    return (known * (np.int64(1) << np.arange(known.shape[1], dtype=np.int64))).sum(2)


def _known(alike: np.ndarray, again: np.ndarray) -> np.ndarray:
    """(n, R, R) bool: cells that are surely so, and are so when looked at elsewhere.

    None of a triangle where that refutes too many: its pattern, many tiles of a fence, say, is finer than the cells,
    and neighbours that agree do so by chance.
    """
    sure = surely(alike)
    refuted = (sure & ~again).sum((1, 2))
    return sure & again & (refuted <= REFUTED * sure.sum((1, 2)))[:, None, None]


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
