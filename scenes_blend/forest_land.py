"""The land under the forest: hills, a lake, mountains; heights in metres by formula."""

from __future__ import annotations

import bpy
import numpy as np
from parts import grid_faces, mesh

NEAR, MIDDLE, FAR = 450.0, 3300.0, 45000.0  # how far trees, groves and stands reach, in metres
GROVE, STAND = 32.0, 384.0  # sides of the tiles, in metres
TREE_LINE = 1150.0


# Terrain


def _lattice(ix, iy, seed):
    h = (ix.astype(np.int64) * 374761393 + iy.astype(np.int64) * 668265263 + seed * 144665) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    return ((h ^ (h >> 16)) & 0xFFFF) / 65535.0 * 2 - 1


def noise(x, y, seed):
    """Smooth value noise in -1..1 on the unit lattice."""
    ix, iy = np.floor(x), np.floor(y)
    u, v = x - ix, y - iy
    u, v = u * u * u * (u * (u * 6 - 15) + 10), v * v * v * (v * (v * 6 - 15) + 10)
    a, b = _lattice(ix, iy, seed), _lattice(ix + 1, iy, seed)
    c, d = _lattice(ix, iy + 1, seed), _lattice(ix + 1, iy + 1, seed)
    return (a + (b - a) * u) * (1 - v) + (c + (d - c) * u) * v


def smoothstep(a, b, x):
    t = np.clip((x - a) / (b - a), 0, 1)
    return t * t * (3 - 2 * t)


def height(x, y):
    """Height of the ground in metres; water lies at 0."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    r = np.hypot(x, y)
    near = smoothstep(60, 700, r)
    h = 42 + 16 * noise(x / 420, y / 420, 1) * near + 55 * noise(x / 1300, y / 1300, 2) * near
    far = smoothstep(2200, 9000, r)
    h += far * (150 + 230 * noise(x / 4300, y / 4300, 3) + 60 * noise(x / 1700, y / 1700, 4))
    ridge = 1 - np.abs(noise(x / 9000 + 0.35, y / 9000 + 0.2, 5))
    fine = 1 - np.abs(noise(x / 3300, y / 3300, 6))
    peaks = smoothstep(6500, 19000, r) * np.clip(y / r.clip(1) + 0.7, 0.15, 1)
    h += peaks * (2300 * ridge**3 + 620 * fine**2 * ridge)
    h += (
        112 * np.exp(-(np.sqrt(r**2 + 15**2) - 15) / 330)
        + 0.35 * noise(x / 7, y / 7, 7)
        + 1.2 * noise(x / 23, y / 23, 8) * smoothstep(8, 60, r)
    )
    h -= 165 * np.exp(-(((x + 60) / 760) ** 2) - ((y - 1500) / 620) ** 2)  # the lake
    h -= (
        75
        * np.exp(-(((x - 0.30 * y) / 500) ** 2))
        * smoothstep(1500, 3000, y)
        * (1 - smoothstep(5000, 9000, y))
    )
    return h


def slopes(x, y, step):
    """(dh/dx, dh/dy) over a distance."""
    return (
        (height(x + step, y) - height(x - step, y)) / (2 * step),
        (height(x, y + step) - height(x, y - step)) / (2 * step),
    )


def terrain_mesh(ground) -> bpy.types.Mesh:
    """Rings around the camera, finer where it looks; sunk a little where stands hide it."""
    radius = np.r_[0.4, np.geomspace(1.2, 1.12 * FAR, 190)]
    ahead = np.linspace(-0.8, 0.8, 190)
    behind = np.linspace(0.8, 2 * np.pi - 0.8, 50)[1:-1]
    angle = np.pi / 2 - np.r_[ahead, behind]
    x, y = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    z = height(x, y)
    z -= smoothstep(NEAR, MIDDLE, np.hypot(x, y)) * 3 + smoothstep(MIDDLE, 2 * MIDDLE, np.hypot(x, y)) * 9
    points = np.round(np.stack([x, y, z], -1).reshape(-1, 3) * 32) / 32
    return mesh("Terrain", points, grid_faces(len(radius), len(angle), wrap=True)[:, ::-1], [ground])
