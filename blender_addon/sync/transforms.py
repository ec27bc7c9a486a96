"""Transforms as arrays, and the placements that Blender's vertex and face instancers make."""

from __future__ import annotations

import numpy as np


def matrix(m) -> np.ndarray:
    """A mathutils.Matrix as (4, 4) float64."""
    return np.array([m[0][:], m[1][:], m[2][:], m[3][:]], np.float64)


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, 3, 4) @ (3 or 4, 4), or (4, 4) @ (N, 3, 4), as (N, 3, 4)."""
    if a.ndim == 3:
        out = a[:, :, :3] @ b[:3, :]
        out[:, :, 3] += a[:, :, 3]
        return out
    out = a[:3, :3] @ b
    out[:, :, 3] += a[:3, 3]
    return out


CHUNK = 1 << 14  # rows worked on at a time: what is in between stays in the cache


def usable(transforms: np.ndarray) -> np.ndarray:
    """(N,) bool: finite and invertible, relative to the transform's own size."""
    good = np.empty(len(transforms), bool)
    with np.errstate(all="ignore"):
        for start in range(0, len(transforms), CHUNK):
            t = transforms[start : start + CHUNK]
            m = t[:, :, :3].reshape(-1, 9).T
            size = np.abs(m).max(0)
            cofactors = m[4] * m[8] - m[5] * m[7], m[5] * m[6] - m[3] * m[8], m[3] * m[7] - m[4] * m[6]
            det = m[0] * cofactors[0] + m[1] * cofactors[1] + m[2] * cofactors[2]
            good[start : start + CHUNK] = (np.abs(det) > 1e-12 * size**3) & np.isfinite(t).all((1, 2))
    return good


def quaternion_matrices(q: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) of quaternions (N, 4), w first; they need not be unit, zero gives identity."""
    q = np.asarray(q, np.float64)
    norm = np.sqrt((q * q).sum(1, keepdims=True))
    w, x, y, z = np.where(norm > 0, q / np.where(norm > 0, norm, 1), [1.0, 0, 0, 0]).T
    out = np.empty((len(q), 3, 3))
    out[:, 0] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1)
    out[:, 1] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1)
    out[:, 2] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1)
    return out


def euler_matrices(angles: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) of XYZ Euler angles (N, 3), radians: X first, as Blender applies them."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles.astype(np.float64)).T, np.sin(angles.astype(np.float64)).T
    out = np.empty((len(angles), 3, 3))
    out[:, 0] = np.stack([cy * cz, sx * sy * cz - cx * sz, cx * sy * cz + sx * sz], 1)
    out[:, 1] = np.stack([cy * sz, sx * sy * sz + cx * cz, cx * sy * sz - sx * cz], 1)
    out[:, 2] = np.stack([-sy, sx * cy, cx * cy], 1)
    return out


AXES = {
    "POS_X": (0, 1),
    "POS_Y": (1, 1),
    "POS_Z": (2, 1),
    "NEG_X": (0, -1),
    "NEG_Y": (1, -1),
    "NEG_Z": (2, -1),
}
UP = {"X": 0, "Y": 1, "Z": 2}


def track_matrices(normals: np.ndarray, track: str, up: str) -> np.ndarray:
    """Rotations (N, 3, 3) that turn an object's track axis along `normals` (N, 3), its up axis staying upright.

    track, up: Object.track_axis and up_axis. As Blender's instancers have it, whose rule is: turn the axis by the
    shortest way, then spin about it until the up axis points as far up as it can. Zero normals give identity.
    """
    axis, sign = AXES[track]
    n = np.asarray(normals, np.float64)
    length = np.sqrt((n * n).sum(1, keepdims=True))
    some = length[:, 0] > 0
    target = np.where(some[:, None], n / np.where(length > 0, length, 1), np.eye(3)[axis] * sign) * sign
    # shortest turn from the axis to the target; straight back turns about the next axis but one
    e = np.eye(3)[axis]
    turn = np.cross(e, target)
    flat = np.abs(turn).sum(1) < 1e-4
    turn[flat] = np.eye(3)[(1, 2, 0)[axis]]
    turn /= np.sqrt((turn * turn).sum(1, keepdims=True))
    # in single precision as Blender: where the target is straight up or down, its rounding decides the spin
    half = np.float32(0.5) * np.arccos(np.clip(target[:, axis], -1, 1).astype(np.float32))
    q = np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * turn], 1)
    if axis != UP[up]:
        # where z went decides the spin
        u = quaternion_matrices(q)[:, :, 2] * (-1 if axis == 2 else 1)
        third = 3 - axis - UP[up]
        odd = (UP[up] - axis) % 3 == 1
        spin = np.arctan2(u[:, third], u[:, UP[up]])
        spin = 0.5 * (spin if odd else -spin)
        s = np.concatenate([np.cos(spin)[:, None], np.sin(spin)[:, None] * target], 1)
        q = quaternion_product(s, q)
    q[~some] = [1, 0, 0, 0]
    return quaternion_matrices(q)


def quaternion_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Hamilton products (N, 4), w first."""
    aw, ax, ay, az = a.T
    bw, bx, by, bz = b.T
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        1,
    )


def face_frames(positions, starts, totals, corner_vertices, scale: float | None):
    """(linear (N, 3, 3), translation (N, 3)) of an instance on each polygon.

    x along the first edge, z along the normal, at the mean of the corners, scaled by sqrt(area) * scale (None: 1).
    """
    p = positions.astype(np.float64)[corner_vertices]
    if not len(starts):
        return np.empty((0, 3, 3)), np.empty((0, 3))
    centre = np.add.reduceat(p, starts, 0) / totals[:, None]
    # Newell: twice the area vector, the polygon being taken around its first corner
    following = np.arange(len(corner_vertices)) + 1
    following[starts + totals - 1] = starts
    origin = np.repeat(p[starts], totals, 0)
    area = np.add.reduceat(np.cross(p - origin, p[following] - origin), starts, 0)
    double = np.sqrt((area * area).sum(1))
    z = np.where(double[:, None] > 0, area / np.where(double > 0, double, 1)[:, None], [0.0, 0.0, 1.0])
    x = p[starts + 1] - p[starts]
    x -= (x * z).sum(1, keepdims=True) * z
    length = np.sqrt((x * x).sum(1, keepdims=True))
    x = np.where(length > 0, x / np.where(length > 0, length, 1), [1.0, 0.0, 0.0])
    linear = np.stack([x, np.cross(z, x), z], 2)
    if scale is not None:
        linear *= (np.sqrt(0.5 * double) * scale)[:, None, None]
    return linear, centre
