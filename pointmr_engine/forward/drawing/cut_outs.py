"""Triangles with holes: how opaque their materials are, sampled once over each triangle and tested at every subpixel.

So a leaf on a card hides, and throws the shadow of, its own shape, however many lie behind each other. What is half
transparent is drawn at a share of its subpixels (ordered dither). Triangles that look the same share their samples
(`opacity_classes`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.baked.baking import materials_of
from pointmr_engine.forward.baked.opacity_classes import Opacity, opacity_classes
from pointmr_engine.forward.baked.opacity_lattice import batches, in_triangle, lattice
from pointmr_engine.forward.drawing.cut_out_cover import (
    BESIDE,
    HOLE,
    OPAQUE,
    move_to_opaque,
    move_to_samples,
    with_holes,
)
from pointmr_engine.forward.drawing.draw import piece_to_tile
from pointmr_engine.forward.drawing.near_clip import clip, corners_of_piece
from pointmr_engine.forward.drawing.part_opacity import BRIGHTENED, PartOpacity
from pointmr_engine.forward.drawing.targets import put_cut_out
from pointmr_engine.hierarchy.geometry import slot_materials, triangle_materials
from pointmr_engine.numerics.jit import device
from pointmr_engine.scene.recognised import same_objects

# cells at most, of which half lie in triangles, over all that differ and all looks at them
SAMPLES = 8_000_000
FINEST = 128  # samples along a triangle's edge at most
NARROW = np.float32(0.05)  # of a footprint: what is read of materials whose holes have a colour of their own
# so many samples along an edge tell which triangles are the same all over, which share one row; where very many
# differ, no more than SAMPLES allow
FIRST = 24
FEWEST = 3
FAINT = 0.1  # of a lattice's opacity: with more of it in cells below HOLE, these are surfaces
MUCH = 0.125  # of a triangle's cells: at outlines of leaves, what light passes is often brighter than what hides it
_BRIGHTENED = np.uint8(round((1.0 - BRIGHTENED) * 255.0))  # opacity of what brightens what passes


class CutOuts(NamedTuple):
    """Opacity over M different triangles, each on a lattice of its own of R x R cells: [q, p] (p + q <= R - 1), by
    barycentric weights of vertices 1 (p) and 2 (q). What is the same all over has few rows: where materials of cards
    are those of stems, too, most triangles are opaque."""

    first: np.ndarray  # (P,) int64 row of a part's triangle 0 in `mask`, -1: the part is opaque
    mask: np.ndarray  # (K,) int32 row of `start` and `side`, -1: the triangle is opaque
    start: np.ndarray  # (M,) int64 place in `cells` of a lattice's first
    side: np.ndarray  # (M,) int64: R
    seen: np.ndarray  # (M,) uint8: the least of a lattice that is not a hole, whose colour is anybody's guess
    even: np.ndarray  # (M,) bool: a lattice is the same all over
    cells: np.ndarray  # uint8; 255: opaque


class Source(NamedTuple):
    """Triangles of one material whose opacity is sampled: rows of CutOuts, one after another."""

    opacity: Opacity  # a partial of PartOpacity.opacity
    triangles: np.ndarray  # (n,) int64
    looks: int  # that a point takes

    def of(self, opacity_of: PartOpacity) -> Source:
        """The same of another scene."""
        own = self.opacity
        return self._replace(opacity=partial(opacity_of.opacity, *own.args, **own.keywords))


def even_cut_outs(first: np.ndarray, mask: np.ndarray, opacity: np.ndarray) -> CutOuts:
    """Those whose lattices are the same size: opacity (M, R, R) uint8."""
    count, side, _ = opacity.shape
    start = np.arange(count, dtype=np.int64) * side**2
    cells = opacity.reshape(count, side**2)
    even = (cells == cells[:, :1]).all(1)
    faint = np.where(cells < HOLE, cells, 0).sum(1, dtype=np.int64) > FAINT * cells.sum(1, dtype=np.int64)
    seen = np.where(faint, 1, HOLE).astype(np.uint8)
    return CutOuts(first, mask, start, np.full(count, side, np.int64), seen, even, cells.reshape(-1))


def lattices(cut_outs: CutOuts) -> np.ndarray:
    """(M, R, R) uint8: the opacity of even_cut_outs."""
    side = int(cut_outs.side[0]) if len(cut_outs.side) else 2
    return cut_outs.cells.reshape(-1, side, side)


def no_cut_outs(parts: int) -> CutOuts:
    """Those of `parts` opaque parts."""
    return even_cut_outs(np.full(parts, -1, np.int64), np.zeros(0, np.int32), np.zeros((0, 2, 2), np.uint8))


def build_cut_outs(
    opacity_of: PartOpacity, progress: Callable[[float], object] | None = None
) -> tuple[CutOuts, CutOuts, list[Source]]:
    """The cut-outs of all parts whose materials let light through: by their mean opacity, and by that of the channel
    that they block most, for methods whose rays pass what goes through the others (Image.coloured); and what
    they are samples of. progress(fraction) may raise to cancel.
    """
    geometry = opacity_of.geometry
    first = np.full(len(geometry.parts), -1, np.int64)
    masks, groups, total = [], [], 0
    for part, mesh in enumerate(geometry.parts):
        found = _groups(opacity_of, part) if len(mesh.triangles) else []
        if found:
            first[part] = total
            masks.append(np.full(len(mesh.triangles), -1, np.int32))
            groups += [(masks[-1], *group) for group in found]
            total += len(mesh.triangles)
    coarse = _side(sum(len(which) * source.looks for _, source, which, _ in groups), FEWEST, FIRST)
    sources, known = [], 0
    tell = progress or (lambda fraction: None)
    for k, (mask, source, which, inverse) in enumerate(groups):
        tell(0.5 * k / len(groups))
        which, shared = _without_even(source, which, coarse)
        mask[source.triangles] = known + shared[inverse]
        known += len(which)
        sources.append(source._replace(triangles=source.triangles[which]))
    side = _side(sum(len(source.triangles) * source.looks for source in sources), 2, FINEST)
    opacity = np.empty((2, known, side, side), np.uint8)
    at = 0
    for source in sources:
        for chosen in batches(source.triangles, side):
            tell(0.5 + 0.5 * at / known)
            rows = at + np.arange(len(chosen))
            opacity[:, rows] = sampled(source.opacity, chosen, rows, side)
            at += len(chosen)
    mask = np.concatenate(masks) if masks else np.zeros(0, np.int32)
    return even_cut_outs(first, mask, opacity[0]), even_cut_outs(first, mask, opacity[1]), sources


def have_same_cut_outs(before: PartOpacity, now: PartOpacity) -> bool:
    """Whether what build_cut_outs made of one scene is what it would make of the other: what lets light through is the
    same parts, in the same places of their lists, and no placement decides how much.
    """
    a, b = before.geometry, now.geometry
    if not (same_objects(a.materials, b.materials) and len(a.parts) == len(b.parts)):
        return False
    opaque = np.array([p.opaque for p in now.programs], np.bool_)
    changed = [part for part in range(len(a.parts)) if a.parts[part] is not b.parts[part]]
    return not any(p.placed for p in now.programs) and all(
        opaque[slot_materials(geometry, part)].all() for geometry in (a, b) for part in changed
    )


def _groups(opacity_of: PartOpacity, part: int) -> list[tuple[Source, np.ndarray, np.ndarray]]:
    """(triangles of a part under one material, and what opacity_classes says of them), of what lets light through."""
    geometry, found = opacity_of.geometry, []
    material = triangle_materials(geometry, part)
    for m in np.unique(material):
        program = opacity_of.programs[m]
        if program.opaque:
            continue
        triangles = np.flatnonzero(material == m)
        own = partial(opacity_of.opacity, m, part, adds=program.adds)
        needs = program.passed_needs
        source = Source(own, triangles, opacity_of.looks(m, part))
        found.append((source, *opacity_classes(geometry, part, needs, triangles, own)))
    return found


def _side(looks: int, fewest: int, most: int) -> int:
    """Cells along the edges of triangles that take so many looks for each cell, for SAMPLES of them at most."""
    return int(np.clip(math.sqrt(SAMPLES / max(looks, 1)), fewest, most))


def sampled(opacity_of: Opacity, triangles: np.ndarray, rows: np.ndarray, side: int) -> np.ndarray:
    """(2, n, side, side) uint8: the opacity of triangles (n,), at the places of the rows (n,) of CutOuts.

    Cells that lie beyond the longest edge, which nobody asks for, have what they are turned into. Beside opaque cells,
    which shine for the holes between them, too, what is added to holes is left out, and so it is where there is little
    of it. For rays, triangles that brighten what passes in many of their cells are drawn all over, for a fragment
    weighs all that it is seen of alike.
    """
    n = len(triangles)
    u, v = lattice(side, rows)
    own = in_triangle(side)
    u, v, which = u[:, own].ravel(), v[:, own].ravel(), np.repeat(triangles, own.sum())
    found = opacity_of(which, u, v)
    result = np.zeros((found.shape[1], n, side, side), np.uint8)
    result[:, :, own] = np.round(found.T * 255.0).astype(np.uint8).reshape(len(result), n, -1)
    if len(result) > 2:
        much = MUCH * own.sum()
        brightens = (result[4] > 0).sum((1, 2)) > much
        adds = ((result[3] > result[1]).sum((1, 2)) > much)[None, :, None, None]
        result = np.where(adds & ~_beside(result[:2] >= OPAQUE), result[2:4], result[:2])
        result[1, brightens] = _BRIGHTENED
    result[:, :, ~own] = result[:, :, ::-1, ::-1][:, :, ~own]
    return result


def _beside(chosen: np.ndarray) -> np.ndarray:
    """Which of cells (2, n, R, R) are chosen (bool), or at most BESIDE cells away from those."""
    for axis in (-2, -1):
        rows = np.swapaxes(chosen, axis, -1)
        near = rows.copy()
        for k in range(1, BESIDE + 1):
            near[..., k:] |= rows[..., :-k]
            near[..., :-k] |= rows[..., k:]
        chosen = np.swapaxes(near, axis, -1)
    return chosen


def _without_even(source: Source, which: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """(those of `which`, places in the source's triangles, that are sampled; the one of these for each) where those
    that are the same at side x side cells share one."""
    even = np.full(len(which), -1)  # 256 times the one opacity, plus the other
    at = 0
    for chosen in batches(source.triangles[which], side):
        found = sampled(source.opacity, chosen, at + np.arange(len(chosen)), side).reshape(2, len(chosen), -1)
        same = (found == found[:, :, :1]).all((0, 2))
        value = 256 * found[0, :, 0].astype(np.int64) + found[1, :, 0]
        even[at : at + len(chosen)] = np.where(same, value, -1)
        at += len(chosen)
    key = np.where(even >= 0, even, (1 << 16) + np.arange(len(which)))
    _, first, shared = np.unique(key, return_index=True, return_inverse=True)
    return which[first], shared.ravel()


def look_where_opaque(
    opacity_of: PartOpacity, cut_outs: CutOuts, densest: bool, fragments, first: int, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Move the places at which fragments first..first + count are shaded out of holes; which may have some (n,) int64,
    counted from `first`, and the materials of these (n,) int32. What is the same all over has none.

    fragments: Fragments; changes `place`. densest: the cut-outs are those of the channel that is blocked most.

    What is visible of a fragment is opaque; a hole's colour is anybody's guess. Cells of the cut-outs that are opaque
    at their samples may have holes elsewhere: who is found in one goes to the cell's sample.
    """
    first_, count_ = np.int64(first), np.int64(count)
    move_to_opaque(cut_outs, fragments, first_, count_)
    rows = np.empty(count, np.int64)
    rows = rows[: with_holes(cut_outs, fragments, first_, count_, rows)]
    part, triangle = fragments.part[rows], fragments.triangle[rows]
    material = np.empty(len(rows), np.int32)
    materials_of(opacity_of.geometry.tables, part, triangle, material)
    for m in np.unique(material):
        if opacity_of.programs[m].opaque:
            continue
        own = np.flatnonzero(material == m)
        u, v = fragments.place[rows[own]].T
        opacity = opacity_of.opacity(m, part[own], triangle[own], u, v)[:, 1 if densest else 0]
        move_to_samples(cut_outs, fragments, rows[own], np.ascontiguousarray(opacity))
    return rows - first, material


@device
def draw_cut_out(view, target, width, height, left, low, corners, entry, cut_outs, mask, key):
    """Draw the triangle with corners (3, 3) in camera space where it is opaque, clipped at the near plane; whether it
    was written."""
    written = False
    pieces, k, s, t = clip(corners, view.near)
    for piece in range(pieces):
        at = corners_of_piece(piece, pieces, k, s, t)
        x, y, w = piece_to_tile(view, corners, at, left, low)
        if put_cut_out(
            target, width, height, view.perspective, x, y, w, at, entry, cut_outs.cells, cut_outs.start[mask],
            cut_outs.side[mask], key,
        ):  # fmt: skip
            written = True
    return written
