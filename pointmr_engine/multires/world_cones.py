"""The world's light on a surface point: six wide cones, a quarter of all around each, say from where it arrives.

The cones are the faces of a cube along the world's axes, 64 sub-rays each: what each sub-ray's cell sees of the world
is known beforehand, so that a point costs its masks and a sum. The sum over the open cells is taken relative to that
over all cells, and scales the exact irradiance of the open world (forward/world_light.py).
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.world_light import WorldMaps, world_lobe
from pointmr_engine.multires.cones import Cones
from pointmr_engine.multires.lamp_cones import NEAR
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.scene.group import DIFFUSE

FACES = 6
FINE = 4  # directions per side of a cell that its radiance is averaged over

# rows x, y, t of every face
_AXES = np.zeros((FACES, 3, 3))
for _f in range(FACES):
    _t = np.zeros(3)
    _t[_f >> 1] = 1.0 - 2.0 * (_f & 1)
    _x = np.roll(_t, 1)
    _AXES[_f] = _x, np.cross(_t, _x), _t


def cell_directions() -> tuple[np.ndarray, np.ndarray]:
    """((6, 64, 3) unit directions, (6, 64) solid angles) of the sub-rays' cells; the angles sum to 4 pi."""
    u = (np.arange(8) + 0.5) / 4.0 - 1.0
    u, v = (c.ravel() for c in np.meshgrid(u, u, indexing="xy"))
    local = np.stack([u, v, np.ones(64)], 1)
    length = np.linalg.norm(local, axis=1)
    solid = length**-3.0
    solid *= (4.0 * np.pi / FACES) / solid.sum()
    directions = np.einsum("kc,fcd->fkd", local / length[:, None], _AXES)
    return directions, np.broadcast_to(solid, (FACES, 64)).copy()


class WorldCells:
    """What the cells see of the world. direction, light (384, 3) float32; light: radiance times solid angle."""

    def __init__(self, maps: WorldMaps):
        direction, solid = cell_directions()
        offsets = ((np.arange(FINE) + 0.5) / FINE - 0.5) / 4.0
        light = np.zeros((FACES * 64, 3))
        u = (np.arange(8) + 0.5) / 4.0 - 1.0
        u, v = (c.ravel() for c in np.meshgrid(u, u, indexing="xy"))
        for du in offsets:
            for dv in offsets:
                local = np.stack([u + du, v + dv, np.ones(64)], 1)
                local /= np.linalg.norm(local, axis=1, keepdims=True)
                d = np.einsum("kc,fcd->fkd", local, _AXES).reshape(-1, 3)
                found = np.empty((len(d), 3))
                _look_up(maps, np.ascontiguousarray(d), found)
                light += found
        light *= solid.reshape(-1, 1) / FINE**2
        self.direction = np.ascontiguousarray(direction.reshape(-1, 3), np.float32)
        self.light = np.ascontiguousarray(light, np.float32)
        self.axes = np.ascontiguousarray(_AXES)


@uncounted
def _look_up(maps, direction, out):
    for k in range(len(direction)):
        r, g, b = world_lobe(maps, 0.0, direction[k, 0], direction[k, 1], direction[k, 2])
        out[k, 0], out[k, 1], out[k, 2] = r, g, b


@uncounted
def world_cones(axes, position, normal, wanted, both, width, offset, count, cones: Cones, source):
    """Cones from the points 0..count that are `wanted` (N,) bool over the side that their normals (N, 3) face.

    both (N,) bool: over the other side as well. source (M,) int32: filled with 6 * point + face. Returns how many.
    """
    m = np.int64(0)
    for k in range(count):
        if not wanted[k]:
            continue
        for f in range(FACES):
            t = axes[f, 2]
            facing = normal[k, 0] * t[0] + normal[k, 1] * t[1] + normal[k, 2] * t[2]
            # the face's corners are 54.7 degrees from its axis: it lies below the horizon from 144.7 on
            if not both[k] and facing < -0.82:
                continue
            source[m] = FACES * k + f
            for a in range(3):
                cones.origin[m, a] = position[k, a]
                for b in range(3):
                    cones.axes[m, a, b] = axes[f, a, b]
            cones.start[m, 0] = cones.start[m, 1] = 0.0
            cones.spread[m, 0] = cones.spread[m, 1] = 1.0
            cones.t_min[m] = max(offset[k], NEAR * width[k])
            cones.t_max[m] = np.inf
            cones.visibility[m] = DIFFUSE
            m += 1
    return m


@uncounted
def open_shares(direction, light, masks, normal, both, count, share):
    """share (N, 2, 3) float32: of the world's irradiance, what reaches points 0..count in front and from behind.

    direction, light: of WorldCells; masks (N, 6) uint64: blocked sub-rays of the cubes' faces.
    """
    for k in range(count):
        for c in range(3):
            share[k, 0, c] = share[k, 1, c] = np.float32(1)
        blocked = np.uint64(0)
        for f in range(FACES):
            blocked |= masks[k, f]
        if blocked == np.uint64(0):
            continue
        nx, ny, nz = normal[k, 0], normal[k, 1], normal[k, 2]
        r = g = b = r_all = g_all = b_all = np.float32(0)
        s = t = q = s_all = t_all = q_all = np.float32(0)
        for f in range(FACES):
            mask = masks[k, f]
            for j in range(64):
                cell = 64 * f + j
                cosine = nx * direction[cell, 0] + ny * direction[cell, 1] + nz * direction[cell, 2]
                is_open = np.float32((mask >> np.uint64(j)) & np.uint64(1) == np.uint64(0))
                front, back = max(cosine, np.float32(0)), max(-cosine, np.float32(0))
                r_all += front * light[cell, 0]
                g_all += front * light[cell, 1]
                b_all += front * light[cell, 2]
                r += is_open * front * light[cell, 0]
                g += is_open * front * light[cell, 1]
                b += is_open * front * light[cell, 2]
                if both[k]:
                    s_all += back * light[cell, 0]
                    t_all += back * light[cell, 1]
                    q_all += back * light[cell, 2]
                    s += is_open * back * light[cell, 0]
                    t += is_open * back * light[cell, 1]
                    q += is_open * back * light[cell, 2]
        share[k, 0, 0] = r / r_all if r_all > 0 else np.float32(1)
        share[k, 0, 1] = g / g_all if g_all > 0 else np.float32(1)
        share[k, 0, 2] = b / b_all if b_all > 0 else np.float32(1)
        share[k, 1, 0] = s / s_all if s_all > 0 else np.float32(1)
        share[k, 1, 1] = t / t_all if t_all > 0 else np.float32(1)
        share[k, 1, 2] = q / q_all if q_all > 0 else np.float32(1)
