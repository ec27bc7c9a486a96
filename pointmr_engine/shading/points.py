"""Surface points: what a material program reads, a batch at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace

import numpy as np


@dataclass
class SurfacePoints:
    """N surface points of one material, as arrays; serves ray hits and samples of a hierarchy alike.

    A program fills only what it asked for (`Program.needs`); the rest stays None. World space unless said otherwise.
    """

    count: int
    position: np.ndarray | None = None  # (N, 3) float64
    normal: np.ndarray | None = None  # (N, 3) float32 shading normal, turned to the viewer's side
    geometric_normal: np.ndarray | None = None  # (N, 3) float32, turned to the viewer's side
    smooth_normal: np.ndarray | None = None  # (N, 3) float32 shading normal before turning
    incoming: np.ndarray | None = None  # (N, 3) float32, unit, from the point to the viewer
    backfacing: np.ndarray | None = None  # (N,) bool
    generated: np.ndarray | None = None  # (N, 3) float32, 0..1 over the mesh's box
    local: np.ndarray | None = None  # (N, 3) float32, position in the object's space
    world_from_part: np.ndarray | None = None  # (N, 3, 4) float64
    uvs: dict[str, np.ndarray] = field(default_factory=dict)  # layer -> (N, 2) float32; "" is the active one
    # layer -> (N, 4) float32: tangent, bitangent sign
    tangents: dict[str, np.ndarray] = field(default_factory=dict)
    # layer -> (N,) float32: UV units per footprint
    uv_footprints: dict[str, np.ndarray] = field(default_factory=dict)
    attributes: dict[str, np.ndarray] = field(default_factory=dict)  # name -> (N, 4) float32 (missing: zeros)
    instance_attributes: dict[str, np.ndarray] = field(default_factory=dict)  # name -> (N, 4) float32
    footprint: np.ndarray | None = None  # (N,) float32, width of the ray's footprint at the point, metres
    narrower: np.ndarray | None = None  # (N,) float32: of it, over what images are filtered
    footprints: float = 1.0  # of these to the width of a pixel, which bumps are differenced over
    barycentric: np.ndarray | None = None  # (N, 2) float32
    object_location: np.ndarray | None = None  # (N, 3) float32
    object_color: np.ndarray | None = None  # (N, 4) float32
    object_index: np.ndarray | None = None  # (N,) int32
    object_random: np.ndarray | None = None  # (N,) float32
    # moved(offset (N, 3) float32, world, needs): the points there, in the plane of each one's triangle, with the fields
    # that `needs` names (None: the same) filled; bump mapping differences its height through it (needs: "moved").
    # (K N, 3): all points once by the first N, again by the next, and so on. A third argument: `narrowed` by it; a
    # fourth: as bumps are differenced (differentials.moved_points)
    moved: Callable[..., SurfacePoints] | None = None
    axes: tuple[np.ndarray, np.ndarray] | None = None  # kept by differentials.axes_at
    # the ray that came here
    ray_kind: np.ndarray | None = None  # (N,) uint8: bits RAY_* below
    ray_length: np.ndarray | None = None  # (N,) float32
    ray_depth: np.ndarray | None = None  # (N,) int32, and by kind:
    diffuse_depth: np.ndarray | None = None
    glossy_depth: np.ndarray | None = None
    transmission_depth: np.ndarray | None = None
    transparent_depth: np.ndarray | None = None
    camera_from_world: np.ndarray | None = None  # (3, 4) float64, z growing away from the camera
    window: np.ndarray | None = None  # (N, 2) float32, position in the image, 0..1

    def repeated(self, times: int, needs: frozenset[str] | None = None) -> SurfacePoints:
        """The points so many times over, one after the other; needs: with these arrays only (None: with all)."""
        changes: dict = {"count": times * self.count, "moved": None, "axes": None}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, dict):
                changes[f.name] = {k: _tiled(v, times) for k, v in value.items()}
            elif isinstance(value, np.ndarray) and f.name != "camera_from_world":
                changes[f.name] = _tiled(value, times) if needs is None or f.name in needs else None
        return replace(self, **changes)

    def narrowed(self, by: np.ndarray) -> SurfacePoints:
        """The points, where images are filtered over a part of the footprints; by (N,) float32, or that of so many
        times fewer points.
        """
        return replace(self, narrower=np.tile(by, self.count // len(by)))


def names_of(needs: frozenset[str]) -> frozenset[str]:
    """The names of needs without those of layers: "uv" of "uv:UVMap"."""
    return frozenset(need.partition(":")[0] for need in needs)


def add_missing_layers(points: SurfacePoints, needs: frozenset[str]) -> None:
    """Fill the layers and attributes that `needs` names with zeros where the points have none."""
    n = points.count
    kinds = {
        "uv": (points.uvs, (n, 2)),
        "tangent": (points.tangents, (n, 4)),
        "uv_footprint": (points.uv_footprints, (n,)),
        "attribute": (points.attributes, (n, 4)),
        "instance_attribute": (points.instance_attributes, (n, 4)),
    }
    for need in needs:
        kind, _, name = need.partition(":")
        if kind in kinds:
            layers, shape = kinds[kind]
            layers.setdefault(name, np.zeros(shape, np.float32))


def _tiled(values: np.ndarray, times: int) -> np.ndarray:
    return np.tile(values, (times,) + (1,) * (values.ndim - 1))


# how a ray came here, bits of `ray_kind`
RAY_CAMERA = 1
RAY_SHADOW = 2
RAY_DIFFUSE = 4
RAY_GLOSSY = 8
RAY_SINGULAR = 16
RAY_REFLECTION = 32
RAY_TRANSMISSION = 64
RAY_MIRRORED = 128  # to materials as RAY_SINGULAR, but within a lobe, as wide as a mirror's normals differ
