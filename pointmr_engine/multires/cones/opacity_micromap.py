"""Opacity micromaps: where triangles with holes let all light through, a bit for each of their cells, so that shadow
rays pass through holes without asking the material (Gruen, Benthin, Woop 2020, "Sub-triangle opacity masks for faster
ray tracing of transparent objects").

Only holes are looked up. What is half transparent or coloured is asked for at the very point.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.baked.opacity_lattice import lattice
from pointmr_engine.forward.drawing.cut_outs import part_materials, part_transparency
from pointmr_engine.hierarchy.acceleration import Acceleration, set_clear

FINEST = 64  # cells along an edge at most: bits of a word
COARSEST = 8  # below, cells that are clear with all their neighbours are too few to be worth it
LOOKS = 1_500_000  # at most, over all triangles that differ
_CHUNK = 1 << 18
CLEAR = 1.0 - 1e-6  # share of light, in every channel
# what a triangle's own points decide, wherever it is placed and whoever looks
_OWN = {"uv", "attribute", "local", "generated", "barycentric"}


def with_micromap(acceleration: Acceleration, sampler) -> Acceleration:
    """The acceleration whose shadow rays pass through the holes that are known; itself where none are."""
    if sampler.micromap is None:
        sampler.micromap = build_micromap(sampler.geometry, sampler.programs, sampler.densest_cut_outs)
    return set_clear(acceleration, *sampler.micromap) if sampler.micromap[-1] else acceleration


def build_micromap(geometry, programs: list, cut_outs) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """(first, row, bits, side) as acceleration.set_clear takes them; side 0 where no holes are worth it.

    cut_outs: forward.drawing.cut_outs.CutOuts of the channel that is blocked most, whose triangles share samples.
    """
    nothing = cut_outs.first, np.zeros(0, np.int32), np.zeros(0, np.int64), 0
    groups = _with_holes(geometry, programs, cut_outs)
    count = sum(len(row) for *_, row in groups)
    side = int(min(math.sqrt(LOOKS / max(count, 1)), FINEST))
    if not count or side < COARSEST:
        return nothing
    words = np.zeros((len(cut_outs.opacity), side), np.int64)
    weights = np.int64(1) << np.arange(side, dtype=np.int64)
    step = max(1, _CHUNK // side**2)
    for part, program, triangles, row in groups:
        for k in range(0, len(row), step):
            chosen = triangles[k : k + step]
            u, v = (a.ravel() for a in lattice(side, row[k : k + step]))
            share = part_transparency(geometry, program, part, np.repeat(chosen, side * side), u, v)
            clear = share.min(1) >= CLEAR
            words[row[k : k + step]] = (surely(clear.reshape(-1, side, side)) * weights).sum(2)
    known = words.any(1)
    first_row = np.where(known, (np.cumsum(known) - 1) * side, -1)
    row = np.where(cut_outs.mask >= 0, first_row[cut_outs.mask], -1).astype(np.int32)
    return cut_outs.first, row, np.ascontiguousarray(words[known].ravel()), side if known.any() else 0


def surely(clear: np.ndarray) -> np.ndarray:
    """(M, R, R) bool: cells whose samples (M, R, R) are clear and all of whose neighbours' in the triangle are."""
    side = clear.shape[1]
    q, p = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    padded = np.pad(clear | (p + q >= side), ((0, 0), (1, 1), (1, 1)), constant_values=True)
    result = clear & (p + q < side)
    for y in range(3):
        for x in range(3):
            result &= padded[:, y : y + side, x : x + side]
    return result


def _with_holes(geometry, programs: list, cut_outs) -> list[tuple]:
    """(part, program, its triangles (n,), rows (n,) of cut_outs.opacity) of those that may have holes."""
    found = []
    holes = (cut_outs.opacity == 0).any((1, 2))
    for part, mesh in enumerate(geometry.parts):
        if cut_outs.first[part] < 0:
            continue
        n = len(mesh.triangles)
        mask, material = cut_outs.mask[cut_outs.first[part] :][:n], part_materials(geometry, part)
        for m in np.unique(material):
            program = programs[m]
            reads = {need.partition(":")[0] for need in program.transparency_needs}
            if program.opaque or not reads <= _OWN:
                continue
            own = np.flatnonzero((material == m) & (mask >= 0))
            own = own[holes[mask[own]]]
            row, leader = np.unique(mask[own], return_index=True)
            if len(row):
                found.append((part, program, own[leader], row))
    return found
