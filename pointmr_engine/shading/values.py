"""Batches of floats (n,) and vectors (n, 3) in float32: the small algebra that node programs share."""

from __future__ import annotations

import numpy as np

# Rec.709 luminance of scene-linear RGB
LUMINANCE = np.array([0.2126390, 0.7151687, 0.0721923], np.float32)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n,) scalar products."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n, 3) vector products."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape), np.float32)
    out[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    out[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    out[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return out


def length(a: np.ndarray) -> np.ndarray:
    """(n,) Euclidean lengths."""
    return np.sqrt(dot(a, a))


def normalize(a: np.ndarray) -> np.ndarray:
    """Unit vectors; zero vectors stay zero."""
    n = length(a)
    return a * np.where(n > 0, 1 / np.where(n > 0, n, 1), 0).astype(np.float32)[:, None]


def divide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a / b, and 0 where b is 0."""
    zero = b == 0
    return np.where(zero, np.float32(0), a / np.where(zero, np.float32(1), b))


def saturate(a: np.ndarray) -> np.ndarray:
    """Clamped to 0..1, NaN to 0."""
    return np.fmin(np.fmax(a, np.float32(0)), np.float32(1))


def mix(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """a (1 - t) + b t."""
    return a * (1 - t) + b * t


def choose(first: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a where `first` (n,) bool, else b: vectors (n, 3) or (1, 3)."""
    if len(a) == len(b) == 1:  # NumPy takes rows seven times faster than it broadcasts them
        return np.concatenate([b, a]).take(first.view(np.int8), 0)
    return np.where(first[:, None], a, b)


def stack(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(n, 3) from three (n,) that broadcast."""
    out = np.empty((max(len(x), len(y), len(z)), 3), np.float32)
    out[:, 0], out[:, 1], out[:, 2] = x, y, z
    return out


def luminance(color: np.ndarray) -> np.ndarray:
    """(n,) relative luminance of Rec.709 colours."""
    # a matrix product would wake the threads of the linear algebra library
    return dot(color, LUMINANCE[None])


def transform_point(m: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Affine maps m (3, 4) or (n, 3, 4) of points (n, 3), in m's precision."""
    return np.einsum("...ij,...j->...i", m[..., :3], p) + m[..., 3]


def transform_direction(m: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The linear part of m (3, 4) or (n, 3, 4) applied to (n, 3)."""
    return np.einsum("...ij,...j->...i", m[..., :3], d).astype(np.float32)


def transform_transposed(m: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The transposed linear part of m applied to (n, 3): normals through the inverse transform, not normalised."""
    return np.einsum("...ji,...j->...i", m[..., :3], d).astype(np.float32)


def rotation_from_euler(angles: np.ndarray) -> np.ndarray:
    """(n, 3, 3) rotation matrices of XYZ Euler angles (n, 3), radians."""
    c, s = np.cos(angles), np.sin(angles)
    cx, cy, cz, sx, sy, sz = c[:, 0], c[:, 1], c[:, 2], s[:, 0], s[:, 1], s[:, 2]
    rows = [
        [cy * cz, sy * sx * cz - cx * sz, sy * cx * cz + sx * sz],
        [cy * sz, sy * sx * sz + cx * cz, sy * cx * sz - sx * cz],
        [-sy, cy * sx, cy * cx],
    ]
    return np.stack([np.stack(r, -1) for r in rows], -2).astype(np.float32)


def rotate_around(v: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) turned around unit axes by angles (n,), right-handed."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return v * c + cross(axis, v) * s + axis * (dot(axis, v)[:, None] * (1 - c))
