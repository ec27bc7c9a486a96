"""Lamps whose light nodes decide: falloffs, photometric webs, pictures that a spot throws.

A lamp's nodes give a factor of its radiance, by the place on the lamp, the direction in which it shines and the
distance to what it lights. Space of the nodes: as in Cycles, a lamp is an object whose own space is the light's.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.transforms import inverse_linear
from pointmr_engine.raytracing.lamps import (
    AX,
    AZ,
    CONE,
    COS_HALF,
    DISC,
    DISTANT,
    ELLIPSE,
    HALF_U,
    HALF_V,
    POINT,
    PX,
    PZ,
    RECTANGLE,
    SPHERE,
    SPOT,
    UX,
    UZ,
    VX,
    VZ,
    Lamps,
    intersect_lamp,
    sample_lamp,
)
from pointmr_engine.scene.light import Light
from pointmr_engine.shading.points import SurfacePoints, add_missing_layers, names_of
from pointmr_engine.shading.program import compile_graph

_FAR = np.finfo(np.float32).max  # metres to a sun
# what differs from place to place of a lamp; the second, where it does not go by the direction of the light alone
_PLACES, _COORDINATES = frozenset({"position", "local", "generated"}), frozenset({"uv", "barycentric"})
# places of a lamp in its mean: of small ones, of area lights, of what differs from place to place; powers of two
FEW, SOME, MANY = 4, 16, 64


class LampNodes:
    """The nodes of one lamp. Threads may share it.

    warnings: of nodes that are not supported. patterned: the lamp itself differs from place to place.
    """

    def __init__(self, light: Light, lamps: Lamps, index: int) -> None:
        self._program = compile_graph(light.graph, "light", filtered=False)
        self.warnings = [f"light '{light.name}': {w}" for w in self._program.warnings]
        self._lamps = Lamps(*(np.ascontiguousarray(column[index : index + 1]) for column in lamps))
        self._world_from_light = np.asarray(light.world_from_light, np.float64)[:3]
        self._linear = inverse_linear(self._world_from_light)  # the lamp's own space, from the world's
        kinds = names_of(self._program.emission_needs)
        shape = self._lamps.shape[0]
        told = _PLACES if shape == DISC else _PLACES | _COORDINATES
        self.patterned = bool(kinds & told) and shape not in (POINT, DISTANT)
        flat = shape in (RECTANGLE, ELLIPSE)
        self._places = MANY if self.patterned else SOME if flat else FEW

    def emission(self, position: np.ndarray, direction: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """(n, 3) float32 factors of the lamp's radiance, where rays from points that it lights meet it.

        position (n, 3) float64 world, direction (n, 3) float64 unit, to the lamp, distance (n,) float64 to it (inf:
        a sun).
        """
        return self._program.emission(self._points(position, direction, distance))

    def mean(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(n, 3) float32 mean factors over the lamp as seen from points, by the irradiance that its places bring.

        position (n, 3) float64, normal (n, 3) float32, of the surface there.
        """
        n = len(position)
        total, weights = np.zeros((n, 3), np.float32), np.zeros(n, np.float32)
        places = 1 if self._lamps.shape[0] in (POINT, DISTANT) else self._places
        direction, distance, weight = np.empty((n, 3)), np.empty(n), np.empty(n, np.float32)
        for k in range(places):
            u, v = (k + 0.5) / places, (_mirrored(k, places) + 0.5) / places  # Hammersley's points
            lamp_places(self._lamps, position, normal, u, v, direction, distance, weight)
            total += weight[:, None] * self.emission(position, direction, distance)
            weights += weight
        return total / np.maximum(weights, np.float32(1e-30))[:, None]

    def met(self, position: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """(n, 3) float32 factors where rays meet the lamp; of those that miss it, any."""
        distance = np.empty(len(position))
        lamp_distances(self._lamps, position, direction, distance)
        return self.emission(position, direction, distance)

    def estimate(self) -> float:
        """A mean factor, of all directions and of distances from 1 to 16 m; never 0."""
        k = np.arange(64) + 0.5
        height, turn = 2.0 * k / 64 - 1.0, k * (math.pi * (3.0 - math.sqrt(5.0)))
        flat = np.sqrt(1.0 - height * height)
        way = 16.0 ** ((k * 0.7548776662) % 1.0)
        place = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], 1) * way[:, None]
        mean = self.mean(place + self._lamps.values[0, PX : PZ + 1], np.tile(np.float32([0, 0, 1]), (64, 1)))
        return max(float(np.abs(mean).mean()), 1e-6)

    def _points(self, position: np.ndarray, direction: np.ndarray, distance: np.ndarray) -> SurfacePoints:
        """The places on the lamp, seen from `position`."""
        n, row, shape = len(position), self._lamps.values[0], self._lamps.shape[0]
        d = direction.astype(np.float32)
        near = np.isfinite(distance)
        way = np.where(near, distance, 1.0)
        place = np.where(near[:, None], position + way[:, None] * direction, -direction)
        normal = -d
        if shape == SPHERE:
            out = place - row[PX : PZ + 1]
            normal = (out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)).astype(np.float32)
        elif shape in (RECTANGLE, ELLIPSE):
            normal = np.broadcast_to(row[AX : AZ + 1].astype(np.float32), (n, 3))
        local = ((place - self._world_from_light[:, 3]) @ self._linear.T).astype(np.float32)
        zero, depth = np.zeros(n, np.float32), np.zeros(n, np.int32)
        uv = self._uv(place, normal if shape == SPHERE else -direction).astype(np.float32)
        points = SurfacePoints(
            n, position=place, normal=normal, geometric_normal=normal, smooth_normal=normal, incoming=-d,
            backfacing=np.zeros(n, np.bool_), generated=local, local=local,
            world_from_part=np.broadcast_to(self._world_from_light, (n, 3, 4)), footprint=zero,
            barycentric=np.stack([uv[:, 1], 1.0 - uv[:, 0] - uv[:, 1]], 1),
            object_location=np.broadcast_to(self._world_from_light[:, 3].astype(np.float32), (n, 3)),
            object_color=np.ones((n, 4), np.float32), object_index=depth, object_random=zero,
            ray_kind=np.zeros(n, np.uint8), ray_length=np.where(near, distance, _FAR).astype(np.float32),
            ray_depth=depth, diffuse_depth=depth, glossy_depth=depth, transmission_depth=depth,
            transparent_depth=depth, camera_from_world=np.eye(4)[:3], window=np.zeros((n, 2), np.float32),
        )  # fmt: skip
        points.uvs[""] = uv
        add_missing_layers(points, self._program.emission_needs)
        return points

    def _uv(self, place: np.ndarray, out: np.ndarray) -> np.ndarray:
        """(n, 2) texture coordinates: over an area light, a sun's disc, a spot's cone, the directions of a point light.

        place (n, 3) on the lamp; out (n, 3): its normals there, of flat ones the directions in which it shines.
        """
        row, shape = self._lamps.values[0], self._lamps.shape[0]
        if shape in (RECTANGLE, ELLIPSE):
            beside = place - row[PX : PZ + 1]
            u, v = beside @ row[UX : UZ + 1] / row[HALF_U], beside @ row[VX : VZ + 1] / row[HALF_V]
            return 0.5 + 0.5 * np.stack([u, v], 1)
        if shape > DISC:
            wide = math.sqrt(row[CONE] * (2.0 - row[CONE]))
            u, v = -out @ row[UX : UZ + 1], -out @ row[VX : VZ + 1]
            return 0.5 + np.stack([u, v], 1) * (0.5 / wide if wide > 0.0 else 0.0)
        out = out @ self._linear.T
        if row[SPOT] != 0.0:
            half = math.acos(row[COS_HALF])
            with np.errstate(divide="ignore", invalid="ignore"):
                scale = 0.5 / (math.tan(half) * -out[:, 2])
                return np.nan_to_num(0.5 + out[:, :2] * scale[:, None])
        out = out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)
        turn = 0.5 - np.arctan2(out[:, 0], out[:, 1]) / (2.0 * math.pi)
        return np.stack([turn, 1.0 - np.arccos(np.clip(out[:, 2], -1.0, 1.0)) / math.pi], 1)


def _mirrored(k: int, places: int) -> int:
    """The bits of k in the reverse order; places: a power of two above it."""
    bits = places.bit_length() - 1
    return int(f"{k:0{bits}b}"[::-1], 2) if bits else 0


def lamp_nodes(lights: list[Light], lamps: Lamps) -> dict[int, LampNodes]:
    """The nodes of each of `lamps` whose light they decide, which are compiled from `lights`."""
    return {int(k): LampNodes(lights[lamps.source[k]], lamps, int(k)) for k in np.flatnonzero(lamps.varying)}


@uncounted
def lamp_places(lamps, position, normal, u, v, direction, distance, weight):
    """Directions (N, 3) and distances (N,) from points to one place of the first lamp; u, v in 0..1 choose it.

    weight (N,) float32: relative irradiance that it brings a surface of normal (N, 3), or at grazing angles a little.
    """
    for k in range(len(position)):
        nx, ny, nz = np.float64(normal[k, 0]), np.float64(normal[k, 1]), np.float64(normal[k, 2])
        dx, dy, dz, t, pdf, scale = sample_lamp(
            lamps, 0, position[k, 0], position[k, 1], position[k, 2], nx, ny, nz, True, u, v
        )
        weight[k] = max(nx * dx + ny * dy + nz * dz, 1e-3) * scale / pdf if pdf > 0.0 else 0.0
        direction[k, 0], direction[k, 1], direction[k, 2], distance[k] = dx, dy, dz, t


@uncounted
def lamp_distances(lamps, position, direction, distance):
    """distance (N,) float64 at which rays meet the first lamp, -1 where they miss it."""
    for k in range(len(position)):
        distance[k] = intersect_lamp(
            lamps, 0, position[k, 0], position[k, 1], position[k, 2], direction[k, 0], direction[k, 1],
            direction[k, 2],
        )  # fmt: skip
