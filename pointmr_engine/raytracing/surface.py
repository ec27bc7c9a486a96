"""Surface attributes at hits: frames for all of them, and for each material what its program asks for."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.hierarchy.layers import NONE, interpolate, layer
from pointmr_engine.hierarchy.placements import Placements
from pointmr_engine.raytracing.frames import (
    Frames,
    Samples,
    allocate_frames,
    frames,
    frames_of,
    local_points,
    move_weights,
    samples_of,
    tangents_to_world,
    world_edges,
)
from pointmr_engine.raytracing.rays import Hits, Rays
from pointmr_engine.scene.mesh import GENERATED
from pointmr_engine.shading.footprint_mean import GRAZING
from pointmr_engine.shading.points import RAY_DIFFUSE, RAY_REFLECTION, SurfacePoints, names_of
from pointmr_engine.shading.values import cross

__all__ = [
    "Frames",
    "RayState",
    "allocate_frames",
    "allocate_ray_state",
    "emitting_points",
    "frames",
    "gather",
    "place_points",
    "points_at",
]


class RayState(NamedTuple):
    """What the integrator knows about N rays besides their geometry; `gather` hands it to the surface points."""

    kind: np.ndarray  # (N,) uint8, bits RAY_* of shading.points
    depth: np.ndarray  # (N,) int32 bounces so far, and by kind:
    diffuse_depth: np.ndarray  # (N,) int32
    glossy_depth: np.ndarray  # (N,) int32
    transmission_depth: np.ndarray  # (N,) int32
    transparent_depth: np.ndarray  # (N,) int32
    # (N,) float32, metres travelled before the origin that count (through transparent surfaces)
    length: np.ndarray
    width: np.ndarray  # (N,) float32, width of the ray's footprint at its origin, metres
    spread: np.ndarray  # (N,) float32, growth of that width per metre
    # (N,) float32, least density per solid angle of the directions that chance drew so far; inf: none was drawn
    density: np.ndarray
    window: np.ndarray  # (N, 2) float32, position in the image, 0..1
    camera_from_world: np.ndarray  # (3, 4) float64


def allocate_ray_state(n: int, camera_from_world: np.ndarray | None = None) -> RayState:
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
        np.full(n, np.inf, np.float32),
        np.zeros((n, 2), np.float32),
        np.eye(4)[:3] if camera_from_world is None else np.asarray(camera_from_world, np.float64)[:3],
    )


def gather(
    geometry: Geometry,
    rays: Rays,
    hits: Hits,
    frames: Frames,
    index: np.ndarray,
    needs: frozenset[str],
    ray_state: RayState | None = None,
) -> SurfacePoints:
    """The surface points of hits[index], with the fields that `needs` names and no others.

    index (n,) integer, of hits (triangle >= 0); row k of the result belongs to hits[index[k]]. needs: field names of
    SurfacePoints ("position", "normal", "generated", "ray_length", ...), and "uv:NAME", "uv_footprint:NAME",
    "tangent:NAME" ("" is the mesh's active layer), "attribute:NAME", "instance_attribute:NAME". `ray_state` may be left
    out when nothing of it is needed. Raises KeyError for a need that is not known.
    """
    names = names_of(needs)
    read = {column for name in names for column in _FRAME_COLUMNS.get(name, ())}
    chosen = Frames(*(c[index] if n in read else None for n, c in zip(Frames._fields, frames, strict=True)))
    samples = samples_of(hits, index, placed=bool(names & _PLACED))
    direction = rays.direction[index] if names & _DIRECTED else None
    points = SurfacePoints(count=len(samples.part))
    width = None
    if ray_state is not None and names & _WIDE:
        width = ray_state.width[index] + ray_state.spread[index] * hits.t[index].astype(np.float32)
    _fill_surface(geometry, points, samples, chosen, needs, direction, width)
    for need in needs:
        if need in _RAY_FIELDS:
            setattr(points, need, getattr(ray_state, _RAY_FIELDS[need])[index])
        elif need == "ray_length":
            points.ray_length = ray_state.length[index] + hits.t[index].astype(np.float32)
        elif need == "camera_from_world":
            points.camera_from_world = ray_state.camera_from_world
    place_points(geometry, points, hits, index, needs)
    return points


_RAY_FIELDS = {
    "ray_kind": "kind",
    "ray_depth": "depth",
    "diffuse_depth": "diffuse_depth",
    "glossy_depth": "glossy_depth",
    "transmission_depth": "transmission_depth",
    "transparent_depth": "transparent_depth",
    "window": "window",
}
RAY_NEEDS = frozenset({*_RAY_FIELDS, "ray_length", "camera_from_world"})  # told by the ray alone
_OTHER_FIELDS = {"ray_length", "camera_from_world", "object_index", "object_color", "object_random"}
# what only frames know, of "NAME" and "KIND:NAME", and which of their columns
_FRAME_COLUMNS = {
    "position": ("position",),
    "normal": ("smooth_normal", "backfacing"),
    "smooth_normal": ("smooth_normal",),
    "geometric_normal": ("geometric_normal", "backfacing"),
    "backfacing": ("backfacing",),
    "uv_footprint": ("geometric_normal",),
    "moved": ("backfacing",),
}
_FRAME_NEEDS = frozenset(_FRAME_COLUMNS)
_FACING_NEEDS = _FRAME_NEEDS | {"incoming"}  # and what is seen from along the normal
# what reads the direction of rays, the width of their footprints, and where parts are placed
_DIRECTED = {"incoming", "moved", "uv_footprint"}
_WIDE = {"footprint", "moved", "uv_footprint"}
_PLACED = {"world_from_part", "object_location", "tangent", "uv_footprint", "moved"}
_STORED = {"uv", "attribute", "generated", "barycentric"}  # at triangles' corners; not made of positions
_LAYERS = ("uv", "uv_footprint", "tangent", "attribute", "instance_attribute")


def told_by_hits(needs: frozenset[str]) -> bool:
    """Whether `gather` knows all that `needs` names from hits: without frames, rays, or what is known of them."""
    return names_of(needs).isdisjoint(_FACING_NEEDS | _WIDE | RAY_NEEDS)


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
    What only a ray or an instance knows (ray kind and depths, object colour, ...) is filled with neutral values.
    """
    n = len(part)
    samples = Samples(
        np.ascontiguousarray(part, np.int32),
        np.ascontiguousarray(triangle, np.int32),
        np.ascontiguousarray(u, np.float64),
        np.ascontiguousarray(v, np.float64),
        np.ascontiguousarray(world_from_part, np.float64),
    )
    own, direction, distance = None, None, np.zeros(n, np.float32)
    if viewer is not None or names_of(needs) & _FACING_NEEDS:
        own = allocate_frames(n)
        frames_of(geometry.tables, samples, np.zeros((0, 3)), own)
        if viewer is None:
            direction = -own.smooth_normal.astype(np.float64)
        else:
            direction = own.position - viewer
            length = np.linalg.norm(direction, axis=1, keepdims=True)
            distance = length[:, 0].astype(np.float32)
            direction = np.where(
                length > 0, direction / np.where(length > 0, length, 1), -own.geometric_normal
            )
            own.backfacing[:] = (own.geometric_normal * direction).sum(1) > 0
    points = SurfacePoints(count=n)
    _fill_surface(geometry, points, samples, own, needs, direction, np.zeros(n, np.float32))
    state = allocate_ray_state(n)
    for need in needs:
        if need in _RAY_FIELDS:
            setattr(points, need, getattr(state, _RAY_FIELDS[need]))
        elif need == "ray_length":
            points.ray_length = distance
        elif need == "camera_from_world":
            points.camera_from_world = state.camera_from_world
        elif need == "object_index":
            points.object_index = np.zeros(n, np.int32)
        elif need == "object_color":
            points.object_color = np.ones((n, 4), np.float32)
        elif need == "object_random":
            points.object_random = np.zeros(n, np.float32)
        elif need.startswith("instance_attribute:"):
            points.instance_attributes[need.partition(":")[2]] = np.zeros((n, 4), np.float32)
    return points


def place_points(
    geometry: Geometry,
    points: SurfacePoints,
    told: Hits | Placements,
    rows: np.ndarray,
    needs: frozenset[str],
) -> None:
    """Fill what the points' instances say, of that what `needs` names; told: by rows (n,), one a point."""
    if "object_index" in needs:
        points.object_index = told.object_index[rows]
    if "object_color" in needs:
        points.object_color = told.color[rows]
    if "object_random" in needs:
        points.object_random = (told.seed[rows] * (1 / 2**32)).astype(np.float32)
    for need in needs:
        kind, _, name = need.partition(":")
        if kind == "instance_attribute":
            points.instance_attributes[name] = _instance_attribute(geometry, told.instance[rows], name)


def emitting_points(
    geometry: Geometry, placed: Placements, rows: np.ndarray, triangle: np.ndarray, u, v,
    needs: frozenset[str], viewer: np.ndarray | None = None, scattered: np.ndarray | bool = False,
) -> SurfacePoints:  # fmt: skip
    """`points_at` of placements, rows (n,) of `placed`, as lights: sampled by no ray of any kind, or met by one that a
    diffuse surface has `scattered` (n,).
    """
    points = points_at(
        geometry, placed.part[rows], triangle, u, v, placed.world_from_part[rows], needs, viewer
    )
    place_points(geometry, points, placed, rows, needs)
    if points.ray_kind is not None:
        points.ray_kind[:] = np.where(scattered, RAY_DIFFUSE | RAY_REFLECTION, 0)
    return points


def _fill_surface(
    geometry: Geometry,
    points: SurfacePoints,
    samples: Samples,
    own: Frames | None,
    needs: frozenset[str],
    direction: np.ndarray,
    width: np.ndarray | None,
) -> None:
    """Everything that place, triangle, view direction (n, 3) and footprint width (n,) decide.

    own: the frames; may be None where none of _FRAME_NEEDS is asked for.
    """
    n, tables = len(samples.part), geometry.tables
    if "local" in needs or "generated" in needs:
        local = np.empty((n if "local" in needs else 0, 3), np.float32)
        generated = np.empty((n if "generated" in needs else 0, 3), np.float32)
        local_points(tables, samples, local, generated)
        # what is not named stays: moved points are filled in two parts
        if "local" in needs:
            points.local = local
        if "generated" in needs:
            points.generated = generated
        if "generated" in needs and layer(geometry, "attribute", GENERATED).domain.any():
            rest = _layer_values(geometry, "attribute", GENERATED, samples, 3)
            stored = layer(geometry, "attribute", GENERATED).domain[samples.part] != NONE
            generated[stored] = rest[stored]
    for need in needs:
        kind, colon, name = need.partition(":")
        if need == "position":
            points.position = own.position
        elif need == "normal":
            points.normal = _turned(own.smooth_normal, own.backfacing)
        elif need == "smooth_normal":
            points.smooth_normal = own.smooth_normal
        elif need == "geometric_normal":
            points.geometric_normal = _turned(own.geometric_normal, own.backfacing)
        elif need == "incoming":
            points.incoming = (-direction).astype(np.float32)
        elif need == "backfacing":
            points.backfacing = own.backfacing
        elif need == "barycentric":
            points.barycentric = np.stack([samples.u, samples.v], 1).astype(np.float32)
        elif need == "footprint":
            points.footprint = width
        elif need == "world_from_part":
            points.world_from_part = samples.world_from_part
        elif need == "object_location":
            points.object_location = samples.world_from_part[:, :, 3].astype(np.float32)
        elif need == "moved":
            points.moved = _mover(geometry, points, samples, needs, direction, width, own.backfacing)
        elif kind == "uv":
            points.uvs[name] = _layer_values(geometry, "uv", name, samples, 2)
        elif kind == "attribute":
            points.attributes[name] = _layer_values(geometry, "attribute", name, samples, 4)
        elif kind == "tangent":
            points.tangents[name] = _layer_values(geometry, "tangent", name, samples, 4)
            tangents_to_world(samples, points.tangents[name])
        elif kind == "uv_footprint":
            points.uv_footprints[name] = _uv_footprint(geometry, name, samples, own, direction, width)
        elif not (need in _RAY_FIELDS or need in _OTHER_FIELDS or need in ("local", "generated")
                  or (colon and kind in _LAYERS)):  # fmt: skip
            raise KeyError(f"surface points have no '{need}'")


def _turned(normal: np.ndarray, backfacing: np.ndarray) -> np.ndarray:
    return np.where(backfacing[:, None], -normal, normal)


def _layer_values(geometry: Geometry, kind: str, name: str, samples: Samples, channels: int) -> np.ndarray:
    out = np.empty((len(samples.part), channels), np.float32)
    found = layer(geometry, kind, name)
    interpolate(geometry.tables, found, samples.part, samples.triangle, samples.u, samples.v, out)
    return out


def _uv_footprint(geometry, name, samples, own, direction, width) -> np.ndarray:
    """UV units per footprint: the side of a square as large as the footprint on the (tilted) surface."""
    found = layer(geometry, "uv", name)
    n = len(samples.part)
    uv = np.empty((3, n, 2), np.float32)
    for k, (u, v) in enumerate(((0, 0), (1, 0), (0, 1))):
        ones = np.ones(n)
        interpolate(geometry.tables, found, samples.part, samples.triangle, u * ones, v * ones, uv[k])
    s, t = (uv[1] - uv[0]).astype(np.float64), (uv[2] - uv[0]).astype(np.float64)
    edges = np.empty((n, 2, 3))
    world_edges(geometry.tables, samples, edges)
    world = np.sqrt((cross(edges[:, 0], edges[:, 1]).astype(np.float64) ** 2).sum(1))
    area = np.abs(s[:, 0] * t[:, 1] - s[:, 1] * t[:, 0])
    cosine = np.maximum(np.abs((own.geometric_normal * direction).sum(1)), GRAZING)
    with np.errstate(all="ignore"):
        density = np.where(world > 0, area / np.where(world > 0, world, 1), 0)
    return (width * np.sqrt(density / cosine)).astype(np.float32)


def _mover(geometry, points, samples, every, direction, width, backfacing):
    """SurfacePoints.moved: the same triangles' planes at other barycentric weights."""
    edges, n = [], len(samples.part)

    def fill(result: SurfacePoints, offset: np.ndarray, needs: frozenset[str]) -> None:
        if not edges:
            edges.append(np.empty((n, 2, 3)))
            world_edges(geometry.tables, samples, edges[0])
        there, of, towards, wide = samples, edges[0], direction, width
        if len(offset) > n:
            again = np.tile(np.arange(n), len(offset) // n)
            there, of, towards = Samples(*(c[again] for c in samples)), of[again], direction[again]
            wide = None if width is None else width[again]
        u, v = np.empty(len(offset)), np.empty(len(offset))
        move_weights(of, np.ascontiguousarray(offset, np.float64), there.u, there.v, u, v)
        there, frames_there = there._replace(u=u, v=v), None
        if names_of(needs) & _FRAME_NEEDS:
            frames_there = allocate_frames(len(offset))
            frames_of(geometry.tables, there, towards, frames_there)
        _fill_surface(geometry, result, there, frames_there, needs, towards, wide)

    def place(offset, of_stored, needs, narrower) -> SurfacePoints:
        needs = every if needs is None else needs
        rest = needs - {"moved"}
        result = replace(points, uvs={}, tangents={}, attributes={}, uv_footprints={})
        if len(offset) > n:
            result = result.repeated(len(offset) // n, needs)
        result.moved = mover(offset, of_stored, narrower)
        if "position" in rest and result.position is not None:
            result.position, rest = result.position + offset, rest - {"position"}
        apart = of_stored is not offset
        stored = frozenset(need for need in rest if apart and need.partition(":")[0] in _STORED)
        for where, what in ((of_stored, stored), (offset, rest - stored)):
            if what:
                fill(result, where, what)
        return result if narrower is None else result.narrowed(narrower)

    def mover(start, start_of_stored, narrowed=None):
        def moved(offset, needs=None, narrower=None, bump=False) -> SurfacePoints:
            narrower = narrowed if narrower is None else narrower
            there = start + offset
            turned = bump and backfacing.any()
            if start_of_stored is start and not turned:
                return place(there, there, needs, narrower)
            back = np.tile(backfacing, len(offset) // max(n, 1))[:, None]
            return place(there, start_of_stored + np.where(back & turned, -offset, offset), needs, narrower)

        return moved

    here = np.zeros(3)
    return mover(here, here)


def _instance_attribute(geometry: Geometry, record: np.ndarray, name: str) -> np.ndarray:
    """(n, 4) float32 of an attribute of the instances themselves; zeros where there is none."""
    out = np.zeros((len(record), 4), np.float32)
    batch_of = np.searchsorted(geometry.instances.first_record, record, side="right") - 1
    for b in np.unique(batch_of[record >= 0]):
        batch = geometry.batches[b]
        values = batch.attributes.get(name)
        if values is None or not len(values):
            continue
        rows = np.flatnonzero((batch_of == b) & (record >= 0))
        place = (
            record[rows] - geometry.instances.first_record[b] if len(values) > 1 else np.zeros(len(rows), int)
        )
        found = np.asarray(values, np.float32).reshape(len(values), -1)[place]
        if found.shape[1] == 1:
            out[rows, :3] = found
        else:
            out[rows[:, None], np.arange(min(found.shape[1], 4))] = found[:, :4]
        if found.shape[1] < 4:
            out[rows, 3] = 1
    return out
