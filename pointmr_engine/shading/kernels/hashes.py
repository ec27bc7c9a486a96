"""Hashes of integers and float bits as procedural textures need them: Jenkins' lookup3 and PCG in 2 to 4 dimensions.

They fix where every noise pattern lies, so they are the ones that Cycles uses. References:
burtleburtle.net/bob/c/lookup3.c; Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 9(3), 2020.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pointmr_engine.numerics.jit import uncounted

# signatures are given where callers would otherwise have one compiled for every literal that they pass


@njit("uint32(uint32, uint32)", cache=True, nogil=True, error_model="numpy")
def rotate_left(x, k):
    """32-bit rotation."""
    x = np.uint32(x)
    return np.uint32(np.uint32(x << np.uint32(k)) | np.uint32(x >> np.uint32(32 - k)))


@uncounted
def mix_words(a, b, c):
    """lookup3's reversible mixing of three words."""
    a = np.uint32(np.uint32(a - c) ^ rotate_left(c, 4))
    c = np.uint32(c + b)
    b = np.uint32(np.uint32(b - a) ^ rotate_left(a, 6))
    a = np.uint32(a + c)
    c = np.uint32(np.uint32(c - b) ^ rotate_left(b, 8))
    b = np.uint32(b + a)
    a = np.uint32(np.uint32(a - c) ^ rotate_left(c, 16))
    c = np.uint32(c + b)
    b = np.uint32(np.uint32(b - a) ^ rotate_left(a, 19))
    a = np.uint32(a + c)
    c = np.uint32(np.uint32(c - b) ^ rotate_left(b, 4))
    b = np.uint32(b + a)
    return a, b, c


@uncounted
def finish_words(a, b, c):
    """lookup3's last scrambling; the third word is the hash."""
    c = np.uint32(np.uint32(c ^ b) - rotate_left(b, 14))
    a = np.uint32(np.uint32(a ^ c) - rotate_left(c, 11))
    b = np.uint32(np.uint32(b ^ a) - rotate_left(a, 25))
    c = np.uint32(np.uint32(c ^ b) - rotate_left(b, 16))
    a = np.uint32(np.uint32(a ^ c) - rotate_left(c, 4))
    b = np.uint32(np.uint32(b ^ a) - rotate_left(a, 14))
    return np.uint32(np.uint32(c ^ b) - rotate_left(b, 24))


@njit("uint32(int64, int64, int64, int64, int64)", cache=True, nogil=True, error_model="numpy")
def hash_words(count, x, y, z, w):
    """lookup3 of `count` (1 to 4) words."""
    start = np.uint32(0xDEADBEEF + (count << 2) + 13)
    a = np.uint32(start + np.uint32(x))
    b = np.uint32(start + np.uint32(y)) if count > 1 else start
    c = np.uint32(start + np.uint32(z)) if count > 2 else start
    if count > 3:
        a, b, c = mix_words(a, b, c)
        a = np.uint32(a + np.uint32(w))
    return finish_words(a, b, c)


@uncounted
def unit_float(h):
    """A word as a float in 0..1."""
    return np.float32(h) * np.float32(1.0 / 4294967295.0)


@uncounted
def pcg3d(x, y, z):
    """Three words of 31 bits from three integers."""
    x = np.int32(x * 1664525 + 1013904223)
    y = np.int32(y * 1664525 + 1013904223)
    z = np.int32(z * 1664525 + 1013904223)
    x = np.int32(x + np.int64(y) * z)
    y = np.int32(y + np.int64(z) * x)
    z = np.int32(z + np.int64(x) * y)
    x, y, z = np.int32(x ^ (x >> 16)), np.int32(y ^ (y >> 16)), np.int32(z ^ (z >> 16))
    x = np.int32(x + np.int64(y) * z)
    y = np.int32(y + np.int64(z) * x)
    z = np.int32(z + np.int64(x) * y)
    return x & 0x7FFFFFFF, y & 0x7FFFFFFF, z & 0x7FFFFFFF


@uncounted
def pcg2d(x, y):
    """Two words of 31 bits from two integers."""
    x = np.int32(x * 1664525 + 1013904223)
    y = np.int32(y * 1664525 + 1013904223)
    x = np.int32(x + np.int64(y) * 1664525)
    y = np.int32(y + np.int64(x) * 1664525)
    x, y = np.int32(x ^ (x >> 16)), np.int32(y ^ (y >> 16))
    x = np.int32(x + np.int64(y) * 1664525)
    y = np.int32(y + np.int64(x) * 1664525)
    return x & 0x7FFFFFFF, y & 0x7FFFFFFF


@uncounted
def pcg4d(x, y, z, w):
    """Four words of 31 bits from four integers."""
    x = np.int32(x * 1664525 + 1013904223)
    y = np.int32(y * 1664525 + 1013904223)
    z = np.int32(z * 1664525 + 1013904223)
    w = np.int32(w * 1664525 + 1013904223)
    x = np.int32(x + np.int64(y) * w)
    y = np.int32(y + np.int64(z) * x)
    z = np.int32(z + np.int64(x) * y)
    w = np.int32(w + np.int64(y) * z)
    x, y = np.int32(x ^ (x >> 16)), np.int32(y ^ (y >> 16))
    z, w = np.int32(z ^ (z >> 16)), np.int32(w ^ (w >> 16))
    x = np.int32(x + np.int64(y) * w)
    y = np.int32(y + np.int64(z) * x)
    z = np.int32(z + np.int64(x) * y)
    w = np.int32(w + np.int64(y) * z)
    return x & 0x7FFFFFFF, y & 0x7FFFFFFF, z & 0x7FFFFFFF, w & 0x7FFFFFFF


@uncounted
def hash_bits(words, count, out):
    """out (n,) float32 in 0..1: the hash of each row's first `count` words; words (n, 4) uint32."""
    for i in range(words.shape[0]):
        out[i] = unit_float(hash_words(count, words[i, 0], words[i, 1], words[i, 2], words[i, 3]))
