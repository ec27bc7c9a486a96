"""What instances say about the placements of a tile: indices, seeds and colours, combined from the root down."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.drawing.transforms import Transforms
from pointmr_engine.numerics.hashing import combine_seeds, hash_path
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.scene.group import HOLDOUT, VISIBLE

# names in a program's needs that only instances know
NEEDS = ("object_index", "object_color", "object_random", "instance_attribute")


class PlacementValues(NamedTuple):
    """One row per row of Transforms; equal to what the Hits of a ray through the same placement say."""

    path: np.ndarray  # (K,) uint64
    seed: np.ndarray  # (K,) uint32
    object_index: np.ndarray  # (K,) int32
    instance: np.ndarray  # (K,) int32 innermost record (with attributes, if any has), -1: none
    flags: np.ndarray  # (K,) uint8 bits of scene.group
    color: np.ndarray  # (K, 4) float32


def allocate_placement_values(n: int) -> PlacementValues:
    """Room for n rows, undefined."""
    return PlacementValues(
        np.empty(n, np.uint64),
        np.empty(n, np.uint32),
        np.empty(n, np.int32),
        np.empty(n, np.int32),
        np.empty(n, np.uint8),
        np.empty((n, 4), np.float32),
    )


@device
def _batch_of(first_record, record):
    """Index of the batch that a scene-wide record belongs to."""
    low, high = np.int64(0), np.int64(len(first_record) - 1)
    while high - low > 1:
        middle = (low + high) >> 1
        if first_record[middle] <= record:
            low = middle
        else:
            high = middle
    return low


@uncounted
def combine_placements(transforms: Transforms, instances, count, out: PlacementValues):
    """Fill rows 0..count. Parents must come before their children; instances: BatchTables."""
    for row in range(count):
        parent, record = np.int64(transforms.parent[row]), np.int64(transforms.record[row])
        if parent < 0:
            out.path[row] = 0
            out.seed[row] = 0
            out.object_index[row] = 0
            out.instance[row] = -1
            out.flags[row] = VISIBLE
            for c in range(4):
                out.color[row, c] = 1.0
            continue
        batch = _batch_of(instances.first_record, record)
        # of batches without placements, the last that starts here is the one that has the record
        i = record - instances.first_record[batch]
        out.path[row] = hash_path(out.path[parent], record)
        named = np.int64(out.instance[parent])
        keeps = named >= 0 and not instances.has_attributes[batch]
        if keeps:
            keeps = instances.has_attributes[_batch_of(instances.first_record, named)]
        out.instance[row] = named if keeps else record
        flags = np.int64(out.flags[parent])
        first, stride = instances.visibility[batch, 0], instances.visibility[batch, 1]
        if first >= 0:
            own = np.int64(instances.visibility_values[first + stride * i])
            flags = (flags & own & VISIBLE) | ((flags | own) & HOLDOUT)
        out.flags[row] = flags
        seed = out.seed[parent]
        first, stride = instances.seed[batch, 0], instances.seed[batch, 1]
        if first >= 0:
            seed = combine_seeds(seed, instances.seed_values[first + stride * i])
        out.seed[row] = seed
        index = out.object_index[parent]
        first, stride = instances.object_index[batch, 0], instances.object_index[batch, 1]
        if first >= 0 and instances.object_index_values[first + stride * i] >= 0:
            index = instances.object_index_values[first + stride * i]
        out.object_index[row] = index
        first, stride = instances.color[batch, 0], instances.color[batch, 1]
        for c in range(4):
            if first >= 0:
                out.color[row, c] = instances.color_values[first + stride * i, c]
            else:
                out.color[row, c] = out.color[parent, c]
