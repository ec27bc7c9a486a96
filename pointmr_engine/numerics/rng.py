"""Random numbers without state: shuffled, Owen-scrambled Sobol points in padded sets of four dimensions.

Burley, Practical Hash-based Owen Scrambling (2020); the scrambling hash is Vegdahl's improved Laine-Karras permutation.
A sample is a pure function of (pixel seed, dimension set, sample index): any thread may compute it, in any order.
Within a set the four dimensions are stratified together, best in the first two; different sets and different pixels
are decorrelated. Values lie in [0, 1) and have 24 bits, so that they stay below one as float32, too.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.hashing import hash_u32
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.sobol import sobol_tables  # noqa: F401  (the `tables` argument of the kernels here)

_INV_2_24 = 2.0**-24
R1 = 0.6180339887498949  # step of the golden ratio's low-discrepancy sequence
R2 = (0.7548776662466927, 0.5698402909980532)  # steps of Roberts' low-discrepancy sequence in two dimensions


@uncounted
def reverse_bits(n: np.uint32) -> np.uint32:
    """The 32 bits of n in opposite order."""
    n = np.uint32(n)
    n = np.uint32((n >> np.uint32(16)) | (n << np.uint32(16)))
    n = np.uint32(
        ((n & np.uint32(0xFF00FF00)) >> np.uint32(8)) | ((n & np.uint32(0x00FF00FF)) << np.uint32(8))
    )
    n = np.uint32(
        ((n & np.uint32(0xF0F0F0F0)) >> np.uint32(4)) | ((n & np.uint32(0x0F0F0F0F)) << np.uint32(4))
    )
    n = np.uint32(
        ((n & np.uint32(0xCCCCCCCC)) >> np.uint32(2)) | ((n & np.uint32(0x33333333)) << np.uint32(2))
    )
    n = np.uint32(
        ((n & np.uint32(0xAAAAAAAA)) >> np.uint32(1)) | ((n & np.uint32(0x55555555)) << np.uint32(1))
    )
    return n


@uncounted
def scramble_reversed(n: np.uint32, seed: np.uint32) -> np.uint32:
    """Owen scrambling (base 2) of a number whose bits are reversed."""
    n = np.uint32(n)
    seed = np.uint32(seed)
    n ^= np.uint32(n * np.uint32(0x3D20ADEA))
    n = np.uint32(n + seed)
    n = np.uint32(n * ((seed >> np.uint32(16)) | np.uint32(1)))
    n ^= np.uint32(n * np.uint32(0x05526C56))
    n ^= np.uint32(n * np.uint32(0x53A22864))
    return n


@uncounted
def pixel_seed(x: np.int64, y: np.int64, seed: np.int64) -> np.uint32:
    """Seed of one pixel's sequence, from its place in the whole image and the seed of the settings."""
    h = hash_u32(np.uint32(seed) + np.uint32(0x9E3779B9))
    h = hash_u32(np.uint32(h ^ np.uint32(x)))
    return hash_u32(np.uint32(np.uint32(h + np.uint32(0x85EBCA6B)) ^ np.uint32(y)))


@uncounted
def _set_seed(seed: np.uint32, dimension_set: np.uint32, salt: np.uint32) -> np.uint32:
    return hash_u32(
        np.uint32(np.uint32(seed) ^ hash_u32(np.uint32(np.uint32(dimension_set) + np.uint32(salt))))
    )


@uncounted
def _coordinate(table: np.ndarray, reversed_index: np.uint32, seed: np.uint32) -> np.float64:
    bits = (
        table[0, reversed_index & np.uint32(255)]
        ^ table[1, (reversed_index >> np.uint32(8)) & np.uint32(255)]
        ^ table[2, (reversed_index >> np.uint32(16)) & np.uint32(255)]
        ^ table[3, reversed_index >> np.uint32(24)]
    )
    return np.float64(reverse_bits(scramble_reversed(bits, hash_u32(seed))) >> np.uint32(8)) * _INV_2_24


@uncounted
def _first_coordinate(reversed_index: np.uint32, seed: np.uint32) -> np.float64:
    # Dimension 0 is the radical inverse: both reversals cancel but for the last one.
    bits = scramble_reversed(reverse_bits(reversed_index), hash_u32(seed))
    return np.float64(reverse_bits(bits) >> np.uint32(8)) * _INV_2_24


@uncounted
def sample_4d(tables, seed, dimension_set, index):
    """Four numbers in [0, 1) (float64), jointly stratified over `index`, which counts a pixel's samples from 0.

    tables: sobol_tables(); seed: uint32 of pixel_seed(); dimension_set: which set of dimensions, >= 0.
    """
    s = _set_seed(seed, dimension_set, np.uint32(0x4C957F2D))
    i = scramble_reversed(reverse_bits(np.uint32(index)), s)
    return (
        _first_coordinate(i, np.uint32(s + np.uint32(1))),
        _coordinate(tables[1], i, np.uint32(s + np.uint32(2))),
        _coordinate(tables[2], i, np.uint32(s + np.uint32(3))),
        _coordinate(tables[3], i, np.uint32(s + np.uint32(4))),
    )


@uncounted
def sample_2d(tables, seed, dimension_set, index):
    """Two numbers as `sample_4d`; uncorrelated with the 4D and 1D sets of the same number."""
    s = _set_seed(seed, dimension_set, np.uint32(0x2545F491))
    i = scramble_reversed(reverse_bits(np.uint32(index)), s)
    return (
        _first_coordinate(i, np.uint32(s + np.uint32(1))),
        _coordinate(tables[1], i, np.uint32(s + np.uint32(2))),
    )


@uncounted
def sample_1d(tables, seed, dimension_set, index):
    """One number as `sample_4d`; uncorrelated with the 4D and 2D sets of the same number."""
    s = _set_seed(seed, dimension_set, np.uint32(0x1B56C4E9))
    i = scramble_reversed(reverse_bits(np.uint32(index)), s)
    return _first_coordinate(i, np.uint32(s + np.uint32(1)))


@uncounted
def fill_4d(tables, seeds, dimension_set, indices, out, start, stop):
    """`sample_4d` for a batch: out[k] = sample of (seeds[k], dimension_set, indices[k]) for k in start..stop.

    seeds (N,) uint32; indices (N,) int32 or uint32; out (N, 4) float32 or float64.
    """
    for k in range(start, stop):
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = sample_4d(tables, seeds[k], dimension_set, indices[k])


@uncounted
def fill_pixel_seeds(x, y, seed, out, start, stop):
    """`pixel_seed` for a batch: x, y (N,) int32 pixels, seed int; out (N,) uint32."""
    for k in range(start, stop):
        out[k] = pixel_seed(x[k], y[k], seed)
