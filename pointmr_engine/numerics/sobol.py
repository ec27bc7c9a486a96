"""Tables of a four-dimensional Sobol sequence, for numerics.rng."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

# Joe and Kuo's first three primitive polynomials (degree, inner coefficients) and their initial direction integers;
# dimension 0 is the radical inverse and needs none.
_POLYNOMIALS = ((1, 0, (1,)), (2, 1, (1, 3)), (3, 1, (1, 3, 1)))


def direction_numbers() -> np.ndarray:
    """(4, 32) uint32: for each dimension, what bit k of the index adds (by XOR) to the sample as a 32-bit fraction."""
    numbers = np.zeros((4, 32), np.uint32)
    numbers[0] = [1 << (31 - k) for k in range(32)]
    for dimension, (degree, inner, initial) in enumerate(_POLYNOMIALS, start=1):
        m = list(initial)
        while len(m) < 32:
            k = len(m)
            value = m[k - degree] ^ (m[k - degree] << degree)
            for j in range(1, degree):
                if inner >> (degree - 1 - j) & 1:
                    value ^= m[k - j] << j
            m.append(value)
        numbers[dimension] = [(m[k] << (31 - k)) & 0xFFFFFFFF for k in range(32)]
    return numbers


@lru_cache(maxsize=1)
def sobol_tables() -> np.ndarray:
    """(4, 4, 256) uint32, read only: what byte `value` at position `byte` of a bit-reversed index adds to a sample.

    Sample of index i, dimension d, with its bits reversed = XOR over byte of tables[d, byte, byte of reverse(i)].
    Both reversals are baked in: Owen scrambling works on reversed bits before and after.
    """
    numbers = direction_numbers()
    bits = (numbers[:, :, None] >> np.arange(32, dtype=np.uint32)) & np.uint32(1)
    reversed_numbers = (bits << (31 - np.arange(32, dtype=np.uint32))).sum(2, dtype=np.uint32)
    tables = np.zeros((4, 4, 256), np.uint32)
    value = np.arange(256, dtype=np.uint32)
    for byte in range(4):
        for bit in range(8):
            chosen = (value >> np.uint32(bit)) & np.uint32(1)
            k = 31 - (8 * byte + bit)  # bit of the index before its reversal
            tables[:, byte] ^= chosen[None] * reversed_numbers[:, k, None]
    tables.setflags(write=False)
    return tables
