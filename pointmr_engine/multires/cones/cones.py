"""Cones: bundles of 8 x 8 sub-rays, as arrays."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.hashing import hash_u32
from pointmr_engine.numerics.jit import device

SIDE = 8  # sub-rays along each side of a cone
FULL = np.uint64(2**64 - 1)


class Cones(NamedTuple):
    """N cones in world space.

    At distance t along the axis a cone is the rectangle of half-widths start + t * spread about origin + t * axis.
    Sub-ray (i, j), bit 8 j + i of masks, passes at u = (i + 0.5) / 4 - 1 and v = (j + 0.5) / 4 - 1 of them. Spreads may
    be negative: such a cone narrows to a line or point and widens again, with its sides exchanged.
    """

    origin: np.ndarray  # (N, 3) float64
    # (N, 3, 3) float64, rows of unit length at right angles: x, y (lateral) and the axis. Walks alone take any rows
    # that give places' coordinates: those of lamp_cones count along oblique vectors
    axes: np.ndarray
    start: np.ndarray  # (N, 2) float64, half-widths along x and y at t = 0
    spread: np.ndarray  # (N, 2) float64, what they gain per metre
    t_min: np.ndarray  # (N,) float64: what lies nearer along the axis is ignored
    t_max: np.ndarray  # (N,) float64
    visibility: np.ndarray  # (N,) uint8, a bit of scene.group: only instances that have it are met


def allocate_cones(n: int) -> Cones:
    """Room for n cones, values undefined but for t_min (0), t_max (inf), start (0) and visibility (all)."""
    return Cones(
        np.empty((n, 3)),
        np.empty((n, 3, 3)),
        np.zeros((n, 2)),
        np.empty((n, 2)),
        np.zeros(n),
        np.full(n, np.inf),
        np.full(n, 255, np.uint8),
    )


def axes_of(direction: np.ndarray) -> np.ndarray:
    """(N, 3, 3) axes of cones along unit (N, 3) directions, turned about them anyhow."""
    d = np.asarray(direction, np.float64)
    sign = np.where(d[:, 2] < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + d[:, 2])
    b = d[:, 0] * d[:, 1] * a
    axes = np.empty((len(d), 3, 3))
    axes[:, 0] = np.stack([1.0 + sign * d[:, 0] ** 2 * a, sign * b, -sign * d[:, 0]], 1)
    axes[:, 1] = np.stack([b, sign + d[:, 1] ** 2 * a, -d[:, 1]], 1)
    axes[:, 2] = d
    return axes


@device
def perpendicular(x, y, z, dx, dy, dz):
    """A unit vector along (x, y, z) less its part along the unit vector d; any across d where there is none."""
    along = x * dx + y * dy + z * dz
    x, y, z = x - along * dx, y - along * dy, z - along * dz
    length = math.sqrt(x * x + y * y + z * z)
    if length > 1e-6:
        return x / length, y / length, z / length
    if abs(dx) < 0.7:
        x, y, z = 0.0, dz, -dy
    else:
        x, y, z = -dz, 0.0, dx
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@device
def set_axes(cones, m, x, y, z, dx, dy, dz):
    """Axes of cone m: along the unit vector d, with x as near to (x, y, z) as can be."""
    x, y, z = perpendicular(x, y, z, dx, dy, dz)
    cones.axes[m, 0, 0], cones.axes[m, 0, 1], cones.axes[m, 0, 2] = x, y, z
    cones.axes[m, 1, 0] = dy * z - dz * y
    cones.axes[m, 1, 1] = dz * x - dx * z
    cones.axes[m, 1, 2] = dx * y - dy * x
    cones.axes[m, 2, 0], cones.axes[m, 2, 1], cones.axes[m, 2, 2] = dx, dy, dz


@device
def jitter(x, y, z, width):
    """Two numbers in [0, 1) that differ from point to point, but not with the place of the point in the image."""
    scale = 8.0 / width if width > 0.0 else 1.0
    a, b, c = (
        np.int64(math.floor(x * scale)),
        np.int64(math.floor(y * scale)),
        np.int64(math.floor(z * scale)),
    )
    h = hash_u32(np.uint32(a & 0xFFFFFFFF))
    h = hash_u32(np.uint32(h ^ np.uint32(b & 0xFFFFFFFF)))
    h = hash_u32(np.uint32(h ^ np.uint32(c & 0xFFFFFFFF)))
    return (h & np.uint32(0xFFFF)) / 65536.0, (h >> np.uint32(16)) / 65536.0


@device
def origin_of(c: Cones, m, x, y):
    """The point beside where cone m begins, x and y metres along its axes."""
    return (
        c.origin[m, 0] + x * c.axes[m, 0, 0] + y * c.axes[m, 1, 0],
        c.origin[m, 1] + x * c.axes[m, 0, 1] + y * c.axes[m, 1, 1],
        c.origin[m, 2] + x * c.axes[m, 0, 2] + y * c.axes[m, 1, 2],
    )


@device
def direction_of(c: Cones, m, u, v):
    """Where cone m looks at slopes u, v of its axes; not of unit length."""
    return (
        c.axes[m, 2, 0] + u * c.axes[m, 0, 0] + v * c.axes[m, 1, 0],
        c.axes[m, 2, 1] + u * c.axes[m, 0, 1] + v * c.axes[m, 1, 1],
        c.axes[m, 2, 2] + u * c.axes[m, 0, 2] + v * c.axes[m, 1, 2],
    )


def sub_rays(cones: Cones, u: np.ndarray | None = None, v: np.ndarray | None = None):
    """Rays through places (K,) u, v in [-1, 1] of all cones, by default those of the 64 sub-rays in the order of bits.

    Returns (origin (N, K, 3), direction (N, K, 3), stretch (N, K)): directions of unit length; t of a cone is t of the
    ray divided by stretch.
    """
    if u is None:
        a = (np.arange(SIDE) + 0.5) / (SIDE / 2) - 1
        u, v = np.tile(a, SIDE), np.repeat(a, SIDE)
    x, y, t = (cones.axes[:, None, k] for k in range(3))
    wide = [np.stack([w[:, :1] * u, w[:, 1:] * v], -1)[..., None] for w in (cones.start, cones.spread)]
    origin = cones.origin[:, None] + wide[0][:, :, 0] * x + wide[0][:, :, 1] * y
    direction = t + wide[1][:, :, 0] * x + wide[1][:, :, 1] * y
    stretch = np.linalg.norm(direction, axis=-1)
    return origin, direction / stretch[..., None], stretch


def sub_ray(cones: Cones, index: np.ndarray, bit: np.ndarray):
    """(direction (K, 3) of unit length, stretch (K,)) of sub-rays bit[k] of cones index[k], as `sub_rays`."""
    u, v = ((bit & 7) + 0.5) * 0.25 - 1.0, ((bit >> 3) + 0.5) * 0.25 - 1.0
    axes, spread = cones.axes[index], cones.spread[index]
    direction = (
        axes[:, 2] + (u * spread[:, 0])[:, None] * axes[:, 0] + (v * spread[:, 1])[:, None] * axes[:, 1]
    )
    stretch = np.linalg.norm(direction, axis=1)
    return direction / stretch[:, None], stretch
