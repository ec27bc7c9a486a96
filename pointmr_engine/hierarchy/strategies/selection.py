"""What every sampling strategy returns, and the random numbers that they draw."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.numerics.hashing import hash_path
from pointmr_engine.numerics.jit import device

_jit = njit(cache=True, nogil=True, error_model="numpy")


class Selection(NamedTuple):
    """K samples chosen from C candidates."""

    position: np.ndarray  # (K, 3) float32
    representative: np.ndarray  # (K,) int32, a candidate that stands for the sample
    owner: np.ndarray  # (C,) int32, the sample that each candidate belongs to


def seed_key(seed: int, salt: int) -> np.uint64:
    """Key of a sequence of random numbers; any integer is a seed, and sequences of other salts are independent."""
    # hashed twice: the sequence of a key is a hash of key + k * constant, so that plain seeds would only shift it
    key = hash_path(np.uint64(int(seed) % 2**64), np.int64(salt))
    return np.uint64(hash_path(np.uint64(key), np.int64(salt)))


@device
def uniform(key, k):
    """Number k of the sequence: float64 in (0, 1)."""
    return (np.float64(hash_path(key, np.int64(k)) >> np.uint64(12)) + 0.5) * 2.0**-52


@_jit
def uniforms(key, out):
    """Fill out (N,) float64 with numbers in (0, 1)."""
    for k in range(len(out)):
        out[k] = uniform(key, k)


@_jit
def shuffle(key, order):
    """Put `order` (N,) int32 into random order (Fisher and Yates)."""
    for k in range(len(order) - 1, 0, -1):
        j = int(uniform(key, k) * (k + 1))
        order[k], order[j] = order[j], order[k]
