"""Emissive triangles: sampled by the solid angle that they fill, looked up when met (`emitter_search` finds them)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.warps import spherical_triangle, triangle_barycentrics, triangle_solid_angle

FRONT, BACK = 1, 2


class Emitters(NamedTuple):
    """E emissive triangles in the world that are sampled as lights."""

    vertices: np.ndarray  # (E, 3, 3) float64 world
    sides: np.ndarray  # (E,) uint8: FRONT and BACK of the winding in the world, sampled sides only
    radiance: np.ndarray  # (E, 3) float64; where it varies: an estimate of the mean
    varying: np.ndarray  # (E,) bool
    visibility: np.ndarray  # (E,) uint8, bits of scene.group
    triangle: np.ndarray  # (E,) int32, scene-wide index
    path: np.ndarray  # (E,) uint64, hash of the instance path
    placement: np.ndarray  # (E,) int32, row of the Placements that it came from
    # (E,) float64: 1 or -1, the side of the winding that looks out of a closed mesh; 0: open
    outside: np.ndarray
    table: np.ndarray  # (S,) int32 hash table of emitters by path and triangle, -1: free; S is a power of two


def pack_emitters(blocks: list[tuple], varying: np.ndarray) -> tuple[Emitters, np.ndarray]:
    """One table of all blocks, without triangles that vanish in the world, and materials. varying: by material."""
    nothing = (
        np.zeros((0, 3, 3)),
        np.zeros(0, np.uint8),
        np.zeros((0, 3)),
        np.zeros(0, np.int32),
        np.zeros(0, np.uint8),
        np.zeros(0, np.int32),
        np.zeros(0, np.uint64),
        np.zeros(0, np.int32),
        np.zeros(0),
    )
    columns = [np.concatenate(c) for c in zip(nothing, *blocks, strict=True)]
    vertices = columns[0]
    cross = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.linalg.norm(cross, axis=1)
    good = np.isfinite(size) & (size > 0.0)
    if not good.all():
        columns = [c[good] for c in columns]
    vertices, sides, radiance, material, visibility, triangle, path, placement, outside = columns
    table = np.full(1 << max(1, int(2 * len(path)).bit_length()), -1, np.int32)
    if len(path):
        _fill_table(table, path, triangle)
    flags = varying[material] if len(path) else np.zeros(0, np.bool_)
    emitters = Emitters(
        vertices, sides, radiance, flags, visibility, triangle, path, placement, outside, table
    )
    return emitters, material


@uncounted
def _slot(path, triangle, mask):
    """Home of a key in the hash table."""
    z = np.uint64(path) ^ (np.uint64(np.uint32(triangle)) * np.uint64(0x9E3779B97F4A7C15))
    z = (z ^ (z >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
    return np.int64((z >> np.uint64(32)) & np.uint64(mask))


@uncounted
def _fill_table(table, path, triangle):
    mask = len(table) - 1
    for e in range(len(path)):
        slot = _slot(path[e], triangle[e], mask)
        while table[slot] >= 0:
            slot = (slot + 1) & mask
        table[slot] = e


@uncounted
def find_emitter(emitters, path, triangle):
    """Index of the emitter that is `triangle` of the placement `path`, or -1."""
    mask = len(emitters.table) - 1
    slot = _slot(path, triangle, mask)
    while True:
        e = emitters.table[slot]
        if e < 0:
            return -1
        if emitters.triangle[e] == triangle and emitters.path[e] == path:
            return e
        slot = (slot + 1) & mask


@uncounted
def _shape_from(v, px, py, pz):
    """What p sees of a triangle: (solid angle, 0 to sample by area; 2 * area; height of p over the winding's front)."""
    ex, ey, ez = v[1, 0] - v[0, 0], v[1, 1] - v[0, 1], v[1, 2] - v[0, 2]
    fx, fy, fz = v[2, 0] - v[0, 0], v[2, 1] - v[0, 1], v[2, 2] - v[0, 2]
    nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    double_area = math.sqrt(nx * nx + ny * ny + nz * nz)
    ax, ay, az = v[0, 0] - px, v[0, 1] - py, v[0, 2] - pz
    height = -(ax * nx + ay * ny + az * nz) / double_area
    bx, by, bz = v[1, 0] - px, v[1, 1] - py, v[1, 2] - pz
    cx, cy, cz = v[2, 0] - px, v[2, 1] - py, v[2, 2] - pz
    la = math.sqrt(ax * ax + ay * ay + az * az)
    lb = math.sqrt(bx * bx + by * by + bz * bz)
    lc = math.sqrt(cx * cx + cy * cy + cz * cz)
    edge = max(ex * ex + ey * ey + ez * ez, fx * fx + fy * fy + fz * fz)
    nearest = min(la, lb, lc)
    if nearest <= 0.0 or edge < 0.01 * nearest * nearest:
        return 0.0, double_area, height
    solid_angle = triangle_solid_angle(
        ax / la, ay / la, az / la, bx / lb, by / lb, bz / lb, cx / lc, cy / lc, cz / lc
    )
    if solid_angle < 1e-7:
        return 0.0, double_area, height
    return solid_angle, double_area, height


@uncounted
def sample_emitter(emitters, e, px, py, pz, u1, u2):
    """Choose a point of emitter e seen from p: (dx, dy, dz, distance, pdf, u, v). pdf 0: nothing can be sampled."""
    v = emitters.vertices[e]
    solid_angle, double_area, height = _shape_from(v, px, py, pz)
    side = FRONT if height > 0.0 else BACK
    if height == 0.0 or not emitters.sides[e] & side:
        return 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0
    ax, ay, az = v[0, 0] - px, v[0, 1] - py, v[0, 2] - pz
    ex, ey, ez = v[1, 0] - v[0, 0], v[1, 1] - v[0, 1], v[1, 2] - v[0, 2]
    fx, fy, fz = v[2, 0] - v[0, 0], v[2, 1] - v[0, 1], v[2, 2] - v[0, 2]
    if solid_angle == 0.0:
        s, t = triangle_barycentrics(u1, u2)
    else:
        bx, by, bz = ax + ex, ay + ey, az + ez
        cx, cy, cz = ax + fx, ay + fy, az + fz
        la = math.sqrt(ax * ax + ay * ay + az * az)
        lb = math.sqrt(bx * bx + by * by + bz * bz)
        lc = math.sqrt(cx * cx + cy * cy + cz * cz)
        dx, dy, dz = spherical_triangle(
            ax / la,
            ay / la,
            az / la,
            bx / lb,
            by / lb,
            bz / lb,
            cx / lc,
            cy / lc,
            cz / lc,
            solid_angle,
            u1,
            u2,
        )
        # where the direction meets the triangle's plane
        hx, hy, hz = dy * fz - dz * fy, dz * fx - dx * fz, dx * fy - dy * fx
        det = ex * hx + ey * hy + ez * hz
        if det == 0.0:
            return 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0
        s = -(ax * hx + ay * hy + az * hz) / det
        qx, qy, qz = ay * ez - az * ey, az * ex - ax * ez, ax * ey - ay * ex
        t = -(dx * qx + dy * qy + dz * qz) / det
        s = min(1.0, max(0.0, s))
        t = min(1.0 - s, max(0.0, t))
    dx, dy, dz = ax + s * ex + t * fx, ay + s * ey + t * fy, az + s * ez + t * fz
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if solid_angle == 0.0:
        pdf = 2.0 * distance * distance * distance / (abs(height) * double_area)
    else:
        pdf = 1.0 / solid_angle
    return dx / distance, dy / distance, dz / distance, distance, pdf, s, t


@uncounted
def emitter_density(emitters, e, px, py, pz, distance):
    """Density per solid angle with which `sample_emitter` chooses a point of emitter e at that distance from p."""
    solid_angle, double_area, height = _shape_from(emitters.vertices[e], px, py, pz)
    side = FRONT if height > 0.0 else BACK
    if height == 0.0 or not emitters.sides[e] & side:
        return 0.0
    if solid_angle == 0.0:
        return 2.0 * distance * distance * distance / (abs(height) * double_area)
    return 1.0 / solid_angle
