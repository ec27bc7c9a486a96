"""Transforms of nested placements into camera space, composed in float64 as a walk meets them.

A row belongs to one placement of one group. Its matrix takes positions relative to `octree.group_center[group]`: boxes
and positions stored in float32 are multiplied as they are, for the large numbers of a world cancel here, once per row.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.nesting import enter
from pointmr_engine.numerics.hashing import hash_u32
from pointmr_engine.numerics.jit import device, uncounted


class Transforms(NamedTuple):
    """K placements of groups, a parent before those below it."""

    # (K, 12) float64: (3, 4) camera_from_group, of positions relative to the group's centre
    matrix: np.ndarray
    parent: np.ndarray  # (K,) int32 row of the placement that this one lies in, -1: none, the root
    record: np.ndarray  # (K,) int32 scene-wide instance record, -1: the root
    group: np.ndarray  # (K,) int32


def allocate_transforms(capacity: int) -> Transforms:
    """Room for `capacity` rows, undefined."""
    return Transforms(
        np.empty((capacity, 12)),
        np.empty(capacity, np.int32),
        np.empty(capacity, np.int32),
        np.empty(capacity, np.int32),
    )


def grow_transforms(transforms: Transforms, used: int, capacity: int) -> Transforms:
    """Room for `capacity` rows, of which the first `used` are copied."""
    larger = allocate_transforms(capacity)
    for old, new in zip(transforms, larger, strict=True):
        new[:used] = old[:used]
    return larger


@uncounted
def compose_root(transforms: Transforms, camera_from_world, octree, group, out_row):
    """Row `out_row` for the root group; camera_from_world (3, 4) float64, octree: OctreeArrays."""
    m = transforms.matrix
    x, y, z = octree.group_center[group, 0], octree.group_center[group, 1], octree.group_center[group, 2]
    for r in range(3):
        a, b, c = camera_from_world[r, 0], camera_from_world[r, 1], camera_from_world[r, 2]
        m[out_row, 4 * r] = a
        m[out_row, 4 * r + 1] = b
        m[out_row, 4 * r + 2] = c
        m[out_row, 4 * r + 3] = a * x + b * y + c * z + camera_from_world[r, 3]
    transforms.parent[out_row] = -1
    transforms.record[out_row] = -1
    transforms.group[out_row] = group


@uncounted
def compose(transforms: Transforms, parent_row, octree, instances, batch, placement, out_row):
    """Row `out_row`: the placement `placement` of batch `batch`, met inside row `parent_row`. Returns its group.

    octree: OctreeArrays; instances: BatchTables; indices int64.
    """
    outer = np.int64(transforms.group[parent_row])
    group = enter(transforms.matrix, parent_row, outer, octree, instances, batch, placement, out_row)
    transforms.parent[out_row] = parent_row
    transforms.record[out_row] = instances.first_record[batch] + placement
    transforms.group[out_row] = group
    return group


@device
def hash_placement(transforms: Transforms, row):
    """What tells the placement of a row from others, uint32, never 0: by the records on its way, not where it lies."""
    h = np.uint32(1)
    while row >= 0:
        h = hash_u32(h ^ np.uint32(transforms.record[row] + 1))
        row = np.int64(transforms.parent[row])
    return h | np.uint32(1)


@uncounted
def box_to_camera(matrix, row, box, node, out):
    """Bounds in camera space of box[node] (lower, upper, relative to the group's centre), under matrix[row].

    out (6,) float64: filled with lower x, y, z, upper x, y, z. Exact but for rounding in float64: it is the box's image
    under the affine map, bounded along the camera's axes.
    """
    for r in range(3):
        low = high = matrix[row, 4 * r + 3]
        for c in range(3):
            a = matrix[row, 4 * r + c]
            p, q = a * box[node, c], a * box[node, 3 + c]
            low += min(p, q)
            high += max(p, q)
        out[r] = low
        out[3 + r] = high
