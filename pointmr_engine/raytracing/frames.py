"""Frames: where rays hit, exactly, with normals, sides and materials; and what else a triangle says about a point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.hierarchy.triangle_prefetch import (
    INDICES,
    VERTICES,
    prefetch_indices,
    prefetch_normals,
    prefetch_positions,
)
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.pointers import pointer_f32, pointer_i32
from pointmr_engine.numerics.transforms import cofactors
from pointmr_engine.raytracing.rays import Hits, Rays

# of the position's and the part's size: far above the rounding of origins, far below any detail
OFFSET = 2.0**-36


class Frames(NamedTuple):
    """Where N rays hit. Undefined where hits.triangle < 0 but for `material` (-1)."""

    position: np.ndarray  # (N, 3) float64 world
    geometric_normal: np.ndarray  # (N, 3) float32 unit, world, as modelled (mirroring keeps outside outside)
    smooth_normal: np.ndarray  # (N, 3) float32 unit, world, interpolated; the geometric one on flat meshes
    backfacing: np.ndarray  # (N,) bool: the ray came from behind the geometric normal
    material: np.ndarray  # (N,) int32 index into geometry.materials
    # (N,) float64, metres: t_min of a ray that starts at `position` (with skip_triangle, skip_path)
    offset: np.ndarray


def allocate_frames(n: int) -> Frames:
    """Room for n frames."""
    return Frames(
        np.zeros((n, 3)),
        np.zeros((n, 3), np.float32),
        np.zeros((n, 3), np.float32),
        np.zeros(n, np.bool_),
        np.full(n, -1, np.int32),
        np.zeros(n),
    )


class Samples(NamedTuple):
    """N points on parts, from hits or chosen freely."""

    part: np.ndarray  # (N,) int32
    triangle: np.ndarray  # (N,) int32 scene-wide
    u: np.ndarray  # (N,) float64: differences of moved points are smaller than single precision resolves
    v: np.ndarray  # (N,) float64
    world_from_part: np.ndarray  # (N, 3, 4) float64


@uncounted
def _normalized(x, y, z, fallback, out):
    length = np.sqrt(x * x + y * y + z * z)
    if length > 0.0 and length < np.inf:
        out[0], out[1], out[2] = x / length, y / length, z / length
    else:
        out[0], out[1], out[2] = fallback[0], fallback[1], fallback[2]


@njit(cache=True, nogil=True, error_model="numpy")
def frames_of(tables, samples, outgoing, out):
    """Frames of all samples; outgoing (N, 3) points away from the viewer, or (0, 3): seen from the front."""
    corner = np.empty((3, 3))
    normals_to_world = np.empty((3, 3))
    up = np.zeros(3, np.float32)
    up[2] = 1.0
    for n in range(len(samples.part)):
        _ask_ahead(tables, samples, n)
        triangle, p = np.int64(samples.triangle[n]), samples.part[n]
        if triangle < 0:
            out.material[n] = -1
            continue
        m = samples.world_from_part[n]
        t = triangle - tables.first_triangle[p]
        corners, positions = pointer_i32(tables.triangles[p]), pointer_f32(tables.positions[p])
        u, v = samples.u[n], samples.v[n]
        w = 1.0 - u - v
        for k in range(3):
            for axis in range(3):
                corner[k, axis] = positions[3 * np.int64(corners[3 * t + k]) + axis]
        x, y, z, out.offset[n] = _place(tables, m, p, t, u, v)
        out.position[n, 0], out.position[n, 1], out.position[n, 2] = x, y, z
        cofactors(m, normals_to_world)
        q = normals_to_world
        ax, ay, az = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1], corner[1, 2] - corner[0, 2]
        bx, by, bz = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1], corner[2, 2] - corner[0, 2]
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        geometric = out.geometric_normal[n]
        _normalized(
            q[0, 0] * x + q[0, 1] * y + q[0, 2] * z,
            q[1, 0] * x + q[1, 1] * y + q[1, 2] * z,
            q[2, 0] * x + q[2, 1] * y + q[2, 2] * z,
            up,
            geometric,
        )
        if tables.normals[p] == 0:
            for axis in range(3):  # a row at once would take numba seconds more to compile
                out.smooth_normal[n, axis] = geometric[axis]
        else:
            values = pointer_f32(tables.normals[p])
            a, b, c = 3 * t, 3 * t + 1, 3 * t + 2
            if not tables.normals_per_corner[p]:
                a, b, c = np.int64(corners[a]), np.int64(corners[b]), np.int64(corners[c])
            x = w * values[3 * a] + u * values[3 * b] + v * values[3 * c]
            y = w * values[3 * a + 1] + u * values[3 * b + 1] + v * values[3 * c + 1]
            z = w * values[3 * a + 2] + u * values[3 * b + 2] + v * values[3 * c + 2]
            _normalized(
                q[0, 0] * x + q[0, 1] * y + q[0, 2] * z,
                q[1, 0] * x + q[1, 1] * y + q[1, 2] * z,
                q[2, 0] * x + q[2, 1] * y + q[2, 2] * z,
                geometric,
                out.smooth_normal[n],
            )
        if len(outgoing):
            d = outgoing[n]
            out.backfacing[n] = geometric[0] * d[0] + geometric[1] * d[1] + geometric[2] * d[2] > 0.0
        else:
            out.backfacing[n] = False
        out.material[n] = _material(tables, p, t)


@uncounted
def veils_of(tables, samples, out):
    """Of the frames of all samples, which are of surfaces, offset and material alone."""
    for n in range(len(samples.part)):
        _ask_ahead(tables, samples, n)
        p = samples.part[n]
        t = np.int64(samples.triangle[n]) - tables.first_triangle[p]
        place = _place(tables, samples.world_from_part[n], p, t, samples.u[n], samples.v[n])
        out.offset[n], out.material[n] = place[3], _material(tables, p, t)


@device
def _place(tables, m, p, t, u, v):
    """World x, y, z of a point of a triangle, and the offset of rays that start there."""
    corners, positions = pointer_i32(tables.triangles[p]), pointer_f32(tables.positions[p])
    a, b, c = 3 * np.int64(corners[3 * t]), 3 * np.int64(corners[3 * t + 1]), 3 * np.int64(corners[3 * t + 2])
    lx = _between(positions, a, b, c, u, v) + tables.center[p, 0]
    ly = _between(positions, a + 1, b + 1, c + 1, u, v) + tables.center[p, 1]
    lz = _between(positions, a + 2, b + 2, c + 2, u, v) + tables.center[p, 2]
    x = m[0, 0] * lx + m[0, 1] * ly + m[0, 2] * lz + m[0, 3]
    y = m[1, 0] * lx + m[1, 1] * ly + m[1, 2] * lz + m[1, 3]
    z = m[2, 0] * lx + m[2, 1] * ly + m[2, 2] * lz + m[2, 3]
    scale = max(
        abs(m[0, 0]) + abs(m[0, 1]) + abs(m[0, 2]),
        abs(m[1, 0]) + abs(m[1, 1]) + abs(m[1, 2]),
        abs(m[2, 0]) + abs(m[2, 1]) + abs(m[2, 2]),
    )
    reach = (
        max(abs(tables.center[p, 0]), abs(tables.center[p, 1]), abs(tables.center[p, 2])) + tables.radius[p]
    )
    return x, y, z, OFFSET * (max(abs(x), abs(y), abs(z)) + scale * reach)


@device
def _between(values, a, b, c, u, v):
    """values[a], interpolated to those of b and c."""
    first = np.float64(values[a])
    return first + u * (np.float64(values[b]) - first) + v * (np.float64(values[c]) - first)


@device
def _material(tables, p, t):
    slot = np.int64(0)
    if tables.material_index[p] != 0:
        slot = np.int64(pointer_i32(tables.material_index[p])[t])
        slot = min(max(slot, np.int64(0)), np.int64(tables.slots[p]) - 1)
    return tables.slot_material[tables.first_slot[p] + slot]


@device
def _ask_ahead(tables, samples, n):
    count = len(samples.part)
    if n + INDICES < count and samples.triangle[n + INDICES] >= 0:
        p = np.int64(samples.part[n + INDICES])
        prefetch_indices(tables, p, np.int64(samples.triangle[n + INDICES]) - tables.first_triangle[p])
    if n + VERTICES < count and samples.triangle[n + VERTICES] >= 0:
        p = np.int64(samples.part[n + VERTICES])
        t = np.int64(samples.triangle[n + VERTICES]) - tables.first_triangle[p]
        prefetch_positions(tables, p, t)
        prefetch_normals(tables, p, t)


@uncounted
def local_points(tables, samples, local, generated):
    """Positions in the part's space and generated coordinates (0..1 over the mesh's box), (n, 3) or (0, 3) float32."""
    for n in range(len(samples.part)):
        p = samples.part[n]
        t = np.int64(samples.triangle[n]) - tables.first_triangle[p]
        corners, positions = pointer_i32(tables.triangles[p]), pointer_f32(tables.positions[p])
        u, v = samples.u[n], samples.v[n]
        a, b, c = (
            3 * np.int64(corners[3 * t]),
            3 * np.int64(corners[3 * t + 1]),
            3 * np.int64(corners[3 * t + 2]),
        )
        for k in range(3):
            x = (
                (1.0 - u - v) * positions[a + k]
                + u * positions[b + k]
                + v * positions[c + k]
                + tables.center[p, k]
            )
            if len(local):
                local[n, k] = x
            if len(generated):
                lower, upper = tables.generated[p, 0, k], tables.generated[p, 1, k]
                generated[n, k] = (x - lower) / (upper - lower) if upper != lower else 0.0


@uncounted
def world_edges(tables, samples, out):
    """World edges from corner 0 of each sample's triangle, out (n, 2, 3) float64."""
    for n in range(len(samples.part)):
        p, m = samples.part[n], samples.world_from_part[n]
        t = np.int64(samples.triangle[n]) - tables.first_triangle[p]
        corners, positions = pointer_i32(tables.triangles[p]), pointer_f32(tables.positions[p])
        a = 3 * np.int64(corners[3 * t])
        for k in range(2):
            b = 3 * np.int64(corners[3 * t + 1 + k])
            x = np.float64(positions[b]) - positions[a]
            y = np.float64(positions[b + 1]) - positions[a + 1]
            z = np.float64(positions[b + 2]) - positions[a + 2]
            for r in range(3):
                out[n, k, r] = m[r, 0] * x + m[r, 1] * y + m[r, 2] * z


@uncounted
def move_weights(edges, offset, u, v, out_u, out_v):
    """Barycentric weights u, v (n,) of points moved by world offsets (n, 3) in triangles of world edges (n, 2, 3)."""
    for n in range(len(u)):
        aa, ab, bb, x, y = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            a, b = edges[n, 0, k], edges[n, 1, k]
            aa, ab, bb = aa + a * a, ab + a * b, bb + b * b
            x, y = x + a * offset[n, k], y + b * offset[n, k]
        det = aa * bb - ab * ab
        if not det > 0.0:
            det = np.inf
        out_u[n] = u[n] + (bb * x - ab * y) / det
        out_v[n] = v[n] + (aa * y - ab * x) / det


@njit(cache=True, nogil=True, error_model="numpy")
def tangents_to_world(samples, tangents):
    """Turn (n, 4) tangents in part space into unit world tangents, in place; mirroring flips the sign."""
    q = np.empty((3, 3))
    zero = np.zeros(3)
    for n in range(len(samples.part)):
        m = samples.world_from_part[n]
        cofactors(m, q)
        x, y, z = np.float64(tangents[n, 0]), np.float64(tangents[n, 1]), np.float64(tangents[n, 2])
        _normalized(
            q[0, 0] * x + q[0, 1] * y + q[0, 2] * z,
            q[1, 0] * x + q[1, 1] * y + q[1, 2] * z,
            q[2, 0] * x + q[2, 1] * y + q[2, 2] * z,
            zero,
            tangents[n],
        )
        sign = np.float32(-1) if tangents[n, 3] < np.float32(0) else np.float32(1)
        # cofactors() negates all of q for a mirroring transform
        minor = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
        mirrored = minor * q[0, 0] < 0.0
        if minor == 0.0:
            minor = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
            mirrored = minor * q[0, 1] < 0.0
            if minor == 0.0:
                mirrored = (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]) * q[0, 2] < 0.0
        tangents[n, 3] = -sign if mirrored else sign


def frames(
    geometry: Geometry, rays: Rays, hits: Hits, out: Frames, start: int = 0, stop: int | None = None
) -> None:
    """Fill out[start:stop] for hits[start:stop]. Releases the GIL."""
    chosen = slice(start, len(hits.triangle) if stop is None else stop)
    frames_of(
        geometry.tables, samples_of(hits, chosen), rays.direction[chosen], Frames(*(c[chosen] for c in out))
    )


def veil_frames(geometry: Geometry, hits: Hits, count: int, out: Frames) -> None:
    """Fill offset and material of out[:count], all that shadow rays want of most surfaces that they pass."""
    chosen = slice(0, count)
    veils_of(geometry.tables, samples_of(hits, chosen), Frames(*(c[chosen] for c in out)))


def sub_frames(geometry, rays: Rays, hits: Hits, rows: np.ndarray, out) -> None:
    """Frames of the hits `rows` only, written to those rows."""
    chosen_rays, chosen_hits = Rays(*(a[rows] for a in rays)), Hits(*(a[rows] for a in hits))
    found = allocate_frames(len(rows))
    frames(geometry, chosen_rays, chosen_hits, found)
    for target, values in zip(out, found, strict=True):
        target[rows] = values


def samples_of(hits: Hits, chosen, placed: bool = True) -> Samples:
    """The points that hits[chosen] stand for; chosen is a slice or indices. Without placements unless `placed`."""
    with np.errstate(invalid="ignore"):  # weights of misses are undefined
        u, v = hits.u[chosen].astype(np.float64), hits.v[chosen].astype(np.float64)
    placements = hits.world_from_part[chosen] if placed else hits.world_from_part[:0]
    return Samples(hits.part[chosen], hits.triangle[chosen], u, v, placements)
