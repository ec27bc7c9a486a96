"""Surface attributes at hits: frames for all of them, and for each material what its program asks for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.raytracing.rays import Hits, Rays
from pointmr_engine.shading.points import SurfacePoints


class Frames(NamedTuple):
    """Where N rays hit. Undefined where hits.triangle < 0 but for `material` (-1)."""

    position: np.ndarray  # (N, 3) float64 world
    geometric_normal: np.ndarray  # (N, 3) float32 unit, world, as modelled (mirroring keeps outside outside)
    smooth_normal: np.ndarray  # (N, 3) float32 unit, world, interpolated; the geometric one on flat meshes
    backfacing: np.ndarray  # (N,) bool: the ray came from behind the geometric normal
    material: np.ndarray  # (N,) int32 index into geometry.materials
    offset: np.ndarray  # (N,) float64, metres: t_min of a ray that starts at `position` (with skip_triangle, skip_path)


class RayState(NamedTuple):
    """What the integrator knows about N rays besides their geometry; `gather` hands it to the surface points."""

    kind: np.ndarray  # (N,) uint8, bits RAY_* of shading.points
    depth: np.ndarray  # (N,) int32 bounces so far, and by kind:
    diffuse_depth: np.ndarray  # (N,) int32
    glossy_depth: np.ndarray  # (N,) int32
    transmission_depth: np.ndarray  # (N,) int32
    transparent_depth: np.ndarray  # (N,) int32
    length: np.ndarray  # (N,) float32, metres travelled before the origin that count (through transparent surfaces)
    width: np.ndarray  # (N,) float32, width of the ray's footprint at its origin, metres
    spread: np.ndarray  # (N,) float32, growth of that width per metre
    window: np.ndarray  # (N, 2) float32, position in the image, 0..1


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


def allocate_ray_state(n: int) -> RayState:
    """Room for n ray states: camera rays (kind RAY_CAMERA) of no width, no bounces yet."""
    return RayState(
        np.ones(n, np.uint8),
        np.zeros(n, np.int32),
        np.zeros(n, np.int32),
        np.zeros(n, np.int32),
        np.zeros(n, np.int32),
        np.zeros(n, np.int32),
        np.zeros(n, np.float32),
        np.zeros(n, np.float32),
        np.zeros(n, np.float32),
        np.zeros((n, 2), np.float32),
    )


def frames(geometry: Geometry, rays: Rays, hits: Hits, out: Frames, start: int = 0, stop: int | None = None) -> None:
    """Fill out[start:stop] for hits[start:stop]. Releases the GIL."""
    raise NotImplementedError


def gather(
    geometry: Geometry,
    rays: Rays,
    hits: Hits,
    frames: Frames,
    index: np.ndarray,
    needs: frozenset[str],
    ray_state: RayState | None = None,
    material: int = 0,
) -> SurfacePoints:
    """The surface points of hits[index], with the fields that `needs` names and no others.

    index (n,) integer; result row k belongs to hit index[k]. needs: field names of SurfacePoints ("position", "normal",
    "generated", "ray_length", ...), and "uv:NAME", "uv_footprint:NAME", "tangent:NAME" ("" is the mesh's active layer),
    "attribute:NAME", "instance_attribute:NAME". `ray_state` may be left out when nothing of it is needed.
    `SurfacePoints.material_index` is set to `material`'s pass index (index into geometry.materials).
    Raises KeyError for a need that is not known.
    """
    raise NotImplementedError


def points_at(
    geometry: Geometry,
    part: np.ndarray,
    triangle: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    world_from_part: np.ndarray,
    needs: frozenset[str],
    viewer: np.ndarray | None = None,
) -> SurfacePoints:
    """Surface points anywhere: samples of lights and hierarchies.

    part (n,) int32, triangle (n,) int32 scene-wide, u, v (n,) float32, world_from_part (n, 3, 4) float64.
    viewer (n, 3) float64: the points are seen from there; None: seen from along the normal (never backfacing).
    """
    raise NotImplementedError
