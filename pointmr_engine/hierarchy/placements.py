"""All placements of chosen parts: the instance paths that lead to them, for lights and for tests."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.numerics.hashing import combine_seeds, hash_path
from pointmr_engine.scene.group import HOLDOUT, VISIBLE


class Placements(NamedTuple):
    """N placements of parts in the world. Equal to what a ray's Hits would say there."""

    part: np.ndarray  # (N,) int32
    world_from_part: np.ndarray  # (N, 3, 4) float64
    path: np.ndarray  # (N,) uint64
    visibility: np.ndarray  # (N,) uint8, bits of scene.group combined along the path
    object_index: np.ndarray  # (N,) int32
    seed: np.ndarray  # (N,) uint32
    instance: np.ndarray  # (N,) int32 innermost record (with attributes, if any has), -1: none
    color: np.ndarray  # (N, 4) float32


def _leads_to(geometry: Geometry, wanted: np.ndarray) -> np.ndarray:
    """(groups,) bool: a wanted part lies in the group or below."""
    result = np.zeros(len(geometry.groups), np.bool_)
    index = {id(g): i for i, g in enumerate(geometry.groups)}
    for g in range(len(geometry.groups)):
        below = [index[id(c)] for b in geometry.group_batches[g] for c in geometry.batches[b].groups]
        result[g] = any(wanted[p] for p in geometry.group_parts[g]) or any(result[c] for c in below)
    return result


def _inherited(where: np.ndarray, values: np.ndarray, i: int):
    return values[where[0] + where[1] * i] if where[0] >= 0 else None


def placements(geometry: Geometry, wanted: np.ndarray, limit: int = 1_000_000) -> Placements:
    """Placements of the parts with wanted[part] (bool), in the order of a depth-first walk from the root.

    Branches without a wanted part are not entered. Stops after `limit`: compare len(result.part) with it. Placements
    with a singular matrix, or that no ray sees, are left out.
    """
    tables = geometry.instances
    leads = _leads_to(geometry, np.asarray(wanted, np.bool_))
    rows: list[tuple] = []
    root = (
        len(geometry.groups) - 1,
        np.eye(4)[:3],
        np.uint64(0),
        VISIBLE,
        0,
        np.uint32(0),
        -1,
        np.ones(4, np.float32),
    )
    stack = [iter([root])]
    while stack and len(rows) < limit:
        place = next(stack[-1], None)
        if place is None:
            stack.pop()
            continue
        g, world, path, flags, index, seed, record, color = place
        for p in geometry.group_parts[g]:
            if wanted[p] and len(rows) < limit:
                rows.append((p, world, path, flags, index, seed, record, color))
        if any(leads[c] for c in _children(geometry, g)):
            stack.append(_below(geometry, tables, leads, place))
    columns = list(zip(*rows, strict=True)) if rows else [()] * 8
    return Placements(
        np.array(columns[0], np.int32),
        np.array(columns[1], np.float64).reshape(-1, 3, 4),
        np.array(columns[2], np.uint64),
        np.array(columns[3], np.uint8),
        np.array(columns[4], np.int32),
        np.array(columns[5], np.uint32),
        np.array(columns[6], np.int32),
        np.array(columns[7], np.float32).reshape(-1, 4),
    )


def times_placed(geometry: Geometry) -> np.ndarray:
    """(parts,) float64: how often each part is placed in the world, those that nobody sees included."""
    tables, times = geometry.instances, np.zeros(len(geometry.groups))
    times[-1:] = 1.0
    result = np.zeros(len(geometry.parts))
    for g in reversed(range(len(times))):  # parents before children
        np.add.at(result, geometry.group_parts[g], times[g])
        for b in geometry.group_batches[g]:
            first, used = tables.group_first[b], geometry.batches[b].times_used()
            np.add.at(times, tables.batch_groups[first : first + len(used)], times[g] * used)
    return result


def _children(geometry: Geometry, g: int) -> list[int]:
    tables, result = geometry.instances, []
    for b in geometry.group_batches[g]:
        first = tables.group_first[b]
        result += [int(c) for c in tables.batch_groups[first : first + len(geometry.batches[b].groups)]]
    return result


def _below(geometry, tables, leads, place):
    """The placements one level below `place`, one after the other."""
    g, world, path, flags, index, seed, record, color = place
    for b in geometry.group_batches[g]:
        batch = geometry.batches[b]
        first = tables.group_first[b]
        for i in range(len(batch)):
            which = _inherited(tables.group[b], tables.group_values, i)
            child = int(tables.batch_groups[first + (0 if which is None else which)])
            own = _inherited(tables.visibility[b], tables.visibility_values, i)
            own = flags if own is None else (flags & int(own) & VISIBLE) | ((flags | int(own)) & HOLDOUT)
            m = np.asarray(batch.transforms[i], np.float64)
            if not leads[child] or not own & VISIBLE or not _invertible(m):
                continue
            number = int(tables.first_record[b]) + i
            composed = world[:, :3] @ m
            composed[:, 3] += world[:, 3]
            pass_index = _inherited(tables.object_index[b], tables.object_index_values, i)
            own_seed = _inherited(tables.seed[b], tables.seed_values, i)
            own_color = _inherited(tables.color[b], tables.color_values, i)
            keeps = record >= 0 and not batch.attributes and _has_attributes(geometry, record)
            yield (
                child,
                composed,
                hash_path(np.uint64(path), np.int64(number)),
                own,
                index if pass_index is None or pass_index < 0 else int(pass_index),
                seed if own_seed is None else combine_seeds(np.uint32(seed), np.uint32(own_seed)),
                record if keeps else number,
                color if own_color is None else own_color,
            )


def _has_attributes(geometry: Geometry, record: int) -> bool:
    batch = np.searchsorted(geometry.instances.first_record, record, side="right") - 1
    return bool(geometry.instances.has_attributes[batch])


def _invertible(m: np.ndarray) -> bool:
    from pointmr_engine.numerics.transforms import SINGULAR

    with np.errstate(all="ignore"):
        box = np.prod(np.linalg.norm(m[:, :3], axis=0))
        return bool(np.isfinite(m).all() and box > 0 and abs(np.linalg.det(m[:, :3])) > SINGULAR * box)
