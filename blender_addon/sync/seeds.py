"""Random seeds of objects and instances: the hashes by which Blender and Cycles fill Object Info's Random."""

from __future__ import annotations

import numpy as np

MASK = 0xFFFFFFFF


def _rotate(x, k: int):
    return (x << np.uint32(k)) | (x >> np.uint32(32 - k))


def hash_string(text: str) -> int:
    """Multiplicative hash (base 37) of a name's UTF-8 bytes, as uint32."""
    h = 0
    for byte in text.encode("utf-8"):
        # C's plain char is signed on the machines that Blender runs on
        h = (h * 37 + (byte - 256 if byte > 127 else byte)) & 0xFFFFFFFF
    return h


def _final_mix(a, b, c) -> np.ndarray:
    """Jenkins' lookup3 final mix of uint32 arrays."""
    with np.errstate(over="ignore"):
        c = (c ^ b) - _rotate(b, 14)
        a = (a ^ c) - _rotate(c, 11)
        b = (b ^ a) - _rotate(a, 25)
        c = (c ^ b) - _rotate(b, 16)
        a = (a ^ c) - _rotate(c, 4)
        b = (b ^ a) - _rotate(a, 14)
        return (c ^ b) - _rotate(b, 24)


def hash_one(x) -> np.ndarray:
    """Lookup3 of one uint32 each (array) into a uint32 array."""
    x = np.asarray(x, np.uint32)
    start = np.full(x.shape, 0xDEADBEEF + (1 << 2) + 13, np.uint32)
    with np.errstate(over="ignore"):
        return _final_mix(x + start, start, start)


def hash_pair(x, y) -> np.ndarray:
    """Lookup3 of two uint32 (arrays or scalars) into a uint32 array."""
    x, y = np.broadcast_arrays(np.asarray(x, np.uint32), np.asarray(y, np.uint32))
    start = np.full(x.shape, 0xDEADBEEF + (2 << 2) + 13, np.uint32)
    with np.errstate(over="ignore"):
        return _final_mix(x + start, y + start, start)


def pair(x: int, y: int) -> int:
    """`hash_pair` of two integers, which costs a tenth for one."""
    start = 0xDEADBEEF + (2 << 2) + 13
    a, b, c = (x + start) & MASK, (y + start) & MASK, start & MASK
    c = ((c ^ b) - (b << 14 | b >> 18)) & MASK
    a = ((a ^ c) - (c << 11 | c >> 21)) & MASK
    b = ((b ^ a) - (a << 25 | a >> 7)) & MASK
    c = ((c ^ b) - (b << 16 | b >> 16)) & MASK
    a = ((a ^ c) - (c << 4 | c >> 28)) & MASK
    b = ((b ^ a) - (a << 14 | a >> 18)) & MASK
    return ((c ^ b) - (b << 24 | b >> 8)) & MASK


def object_seed(name: str) -> int:
    """Seed of an object that is no instance, as uint32 (never 0, which means: inherit)."""
    return pair(hash_string(name), 0) or 1


def instance_seed(name: str, ids, root: str | None = None) -> int:
    """`instance_seeds` of one instance."""
    h = hash_string(name)
    for level in ids:
        h = pair(h, level & MASK)
    if root is not None and root != name:
        h ^= pair(hash_string(root), 0)
    return h or 1


def instance_seeds(name, ids, root: str | None = None) -> np.ndarray:
    """Seeds (N,) uint32 of instances, as Blender's random_id (never 0).

    name: of the instanced object, or (N,) uint32 hashes of names. ids: the instance's index at each level, innermost
    first, each an integer or (N,). root: the top-level object that makes the instances, None inside a shared group.
    """
    h = np.atleast_1d(np.asarray(hash_string(name) if isinstance(name, str) else name, np.uint32))
    own = h
    for level in ids:
        h = hash_pair(h, np.asarray(level).astype(np.int64).astype(np.uint32))
    if root is not None:
        r = hash_string(root)
        # an object that makes instances of itself keeps its own hash
        h = np.where(own == np.uint32(r), h, h ^ hash_pair(r, 0))
    return np.maximum(h, np.uint32(1))
