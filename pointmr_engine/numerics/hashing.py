"""Hashes of integers: keys of instance paths, seeds along a path, random numbers without state."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import uncounted


@uncounted
def hash_u32(x: np.uint32) -> np.uint32:
    """A bijective 32-bit mix with low bias (Wellons' lowbias32)."""
    x = np.uint32(x)
    x ^= x >> np.uint32(16)
    x = np.uint32(x * np.uint32(0x7FEB352D))
    x ^= x >> np.uint32(15)
    x = np.uint32(x * np.uint32(0x846CA68B))
    x ^= x >> np.uint32(16)
    return x


@uncounted
def hash_path(parent: np.uint64, record: np.int64) -> np.uint64:
    """Key of the placement reached from `parent` (0: the root) through instance record `record` (splitmix64)."""
    z = np.uint64(parent) + (np.uint64(record) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@uncounted
def combine_seeds(parent: np.uint32, child: np.uint32) -> np.uint32:
    """Seed of an instance inside an instance; 0 is neutral on either side."""
    if parent == 0:
        return np.uint32(child)
    if child == 0:
        return np.uint32(parent)
    return hash_u32(np.uint32(hash_u32(np.uint32(parent)) ^ np.uint32(child)))
