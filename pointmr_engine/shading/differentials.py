"""How points move along the surface, for what must be differenced: bump heights, footprints of coordinates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointmr_engine.numerics.transforms import inverse_linear
from pointmr_engine.shading.points import SurfacePoints
from pointmr_engine.shading.values import cross, dot, normalize


def tangent_axes(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (n, 3) that complete unit normals (n, 3) to right-handed frames."""
    x, y, z = normal[:, 0], normal[:, 1], normal[:, 2]
    diagonal = (x == y) & (x == z)
    a = np.empty_like(normal)
    a[:, 0] = z - y
    a[:, 1] = np.where(diagonal, x + z, x - z)
    a[:, 2] = np.where(diagonal, -y - x, y - x)
    a = normalize(a)
    return a, cross(normal, a)


def axes_at(points: SurfacePoints) -> tuple[np.ndarray, np.ndarray]:
    """`tangent_axes` of the points' geometric normals, found once."""
    if points.axes is None:
        points.axes = tangent_axes(points.geometric_normal)
    return points.axes


def moved_points(
    points: SurfacePoints,
    offset: np.ndarray,
    needs: frozenset[str] | None = None,
    narrower: np.ndarray | None = None,
    bump: bool = False,
) -> SurfacePoints:
    """The points moved by world offsets (N, 3) in their surfaces' planes; exact where `points.moved` is given.

    (K N, 3): all points once by the first N, again by the next, and so on.

    needs: the only fields that are read there. Without `points.moved` positions move, UVs follow the layer's tangent
    and footprint where both are known, the rest stays. narrower (N,): over what part of the footprints images are
    filtered there, and at points that these are moved to. bump: what is stored with the mesh, as UVs are, is that of
    the opposite offset where points are backfacing: so Cycles differences heights, whose bumps are dents from behind.
    """
    if points.moved is not None:
        return points.moved(offset, needs, narrower, bump)
    if len(offset) > points.count:
        points = points.repeated(len(offset) // points.count)
    changes: dict = {}
    if points.position is not None:
        changes["position"] = points.position + offset
    if points.local is not None:
        local_offset = offset
        if points.world_from_part is not None:
            local_offset = np.einsum("...ij,...j->...i", inverse_linear(points.world_from_part), offset)
        changes["local"] = (points.local + local_offset).astype(np.float32)
    if points.tangents and points.footprint is not None and points.geometric_normal is not None:
        uvs = dict(points.uvs)
        for layer, uv in points.uvs.items():
            tangent, width = points.tangents.get(layer), points.uv_footprints.get(layer)
            if tangent is None or width is None:
                continue
            bitangent = cross(points.geometric_normal, tangent[:, :3]) * tangent[:, 3:]
            scale = width / np.maximum(points.footprint, 1e-20)
            uvs[layer] = uv + np.stack([dot(offset, tangent) * scale, dot(offset, bitangent) * scale], -1)
        changes["uvs"] = uvs
    moved = replace(points, **changes)
    return moved if narrower is None else moved.narrowed(narrower)
