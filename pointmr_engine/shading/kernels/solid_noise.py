"""Perlin noise in three dimensions without a branch, so that loops over points become vector code.

The noise is that of `kernels.noise`, to the last bit: Perlin's gradients (2002) chosen by lookup3, in float64.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import device, uncounted

_START = 0xDEADBEEF + (3 << 2) + 13  # lookup3's, of three words


@device
def _word(x):
    return np.uint32(x)


@device
def _rotated(x, k):
    return np.uint32(np.uint32(x << np.uint32(k)) | np.uint32(x >> np.uint32(32 - k)))


@device
def _corner(ix, iy, iz, x, y, z):
    """Dot product of (x, y, z) with the gradient at a corner of the lattice; three uint32 and three float64."""
    a, b, c = _word(ix + _word(_START)), _word(iy + _word(_START)), _word(iz + _word(_START))
    c = _word(_word(c ^ b) - _rotated(b, 14))
    a = _word(_word(a ^ c) - _rotated(c, 11))
    b = _word(_word(b ^ a) - _rotated(a, 25))
    c = _word(_word(c ^ b) - _rotated(b, 16))
    a = _word(_word(a ^ c) - _rotated(c, 4))
    b = _word(_word(b ^ a) - _rotated(a, 14))
    h = _word(_word(c ^ b) - _rotated(b, 24))
    which = h & _word(15)
    first = x if which < _word(8) else y
    second = y if which < _word(4) else (x if (which == _word(12)) | (which == _word(14)) else z)
    return (-first if h & _word(1) else first) + (-second if h & _word(2) else second)


@device
def fade(t):
    """Perlin's quintic."""
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0)


@device
def perlin_solid(x, y, z):
    """Gradient noise, unscaled: the eight corners of the cell blended. Coordinates below 2^31."""
    cx, cy, cz = np.floor(x), np.floor(y), np.floor(z)
    x, y, z = x - cx, y - cy, z - cz
    ix, iy, iz = _word(np.int32(cx)), _word(np.int32(cy)), _word(np.int32(cz))
    jx, jy, jz = _word(ix + _word(1)), _word(iy + _word(1)), _word(iz + _word(1))
    u, v, w = fade(x), fade(y), fade(z)
    p, q, r = 1.0 - u, 1.0 - v, 1.0 - w
    x1, y1, z1 = x - 1.0, y - 1.0, z - 1.0
    total = 0.0 + p * q * r * _corner(ix, iy, iz, x, y, z)
    total += u * q * r * _corner(jx, iy, iz, x1, y, z)
    total += p * v * r * _corner(ix, jy, iz, x, y1, z)
    total += u * v * r * _corner(jx, jy, iz, x1, y1, z)
    total += p * q * w * _corner(ix, iy, jz, x, y, z1)
    total += u * q * w * _corner(jx, iy, jz, x1, y, z1)
    total += p * v * w * _corner(ix, jy, jz, x, y1, z1)
    total += u * v * w * _corner(jx, jy, jz, x1, y1, z1)
    return total


@uncounted
def add_solid(x, y, z, scale, amplitude, total, n):
    """Add amplitude times the noise (-1..1) at scale times the places x, y, z (n,) to total (n,); all float64."""
    for i in range(n):
        value = perlin_solid(scale * x[i], scale * y[i], scale * z[i])
        total[i] += amplitude * (0.9820 * value)
