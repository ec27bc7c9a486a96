"""Simple shading: baked colours under Lambert's law, lit by lamps at their centres and by the world's mean light."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.drawing.surfel_lanes import FLAT, ROUND
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing.lamp_nodes import lamp_nodes
from pointmr_engine.scene.light import Light


class SimpleShading:
    """Shading "simple" of one image. Threads may share it."""

    def __init__(self, image):
        scene_lights = image.scene_lights
        chosen = [scene_lights[i] for i in image.lamps.source]
        self.image = image
        lights = point_lights(chosen, image.camera.camera_from_world)
        self.nodes = lamp_nodes(scene_lights, image.lamps)  # of the last lamps (method.Image)
        self.alone = {k: PointLights(*(column[k : k + 1] for column in lights)) for k in self.nodes}
        self.even = PointLights(*(column[: len(chosen) - len(self.nodes)] for column in lights))

    def shade(self, space, hierarchy, count: int) -> None:
        """Fill space.light[:count] with radiance towards the camera; fragments on triangles get their looks."""
        f = space.fragments
        self._look_up_triangles(space, count)
        perspective, shadow = self.image.view.perspective, space.shadow
        shade_lambert(
            perspective, f.position, f.normal, f.albedo, f.emission, self.even, self.image.sampler.ambient,
            shadow[: len(self.even.blend)], np.int64(count), space.light,
        )  # fmt: skip
        for k, nodes in self.nodes.items():
            own, dark = np.zeros((2, count, 3), np.float32)
            shade_lambert(
                perspective, f.position, f.normal, f.albedo, dark, self.alone[k], np.zeros(3), shadow[k : k + 1],
                np.int64(count), own,
            )  # fmt: skip
            to_world = self.image.camera.world_from_camera
            place = f.position[:count] @ to_world[:, :3].T + to_world[:, 3]
            normal = (f.normal[:count] @ to_world[:, :3].T).astype(np.float32)
            space.light[:count] += own * nodes.mean(place, normal)

    def _look_up_triangles(self, space, count: int) -> None:
        f = space.fragments
        rows = np.empty(count, np.int64)
        rows = rows[: _without_normal(f.normal, np.int64(count), rows)]
        if not len(rows):
            return
        width = self.image.pixel * np.maximum(f.position[rows, 2], 0.0).astype(np.float32)
        look = self.image.sampler.baker(
            f.part[rows], f.triangle[rows], f.place[rows, 0], f.place[rows, 1], width
        )
        matrix = space.scratch.transforms.matrix[f.row[rows]].reshape(-1, 3, 4)[:, :, :3]
        cofactors = np.stack([np.cross(matrix[:, (i + 1) % 3], matrix[:, (i + 2) % 3]) for i in range(3)], 1)
        normal = (cofactors * look.normal[:, None, :]).sum(2)
        normal *= np.sign((matrix[:, 0] * cofactors[:, 0]).sum(1, keepdims=True))  # mirrored spaces
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        f.normal[rows] = normal / np.where(length > 0, length, 1)
        f.albedo[rows], f.emission[rows] = look.albedo, look.emission


@uncounted
def _without_normal(normal, count, out):
    """Fill `out` with the rows 0..count of normal (F, 3) that are 0; returns how many."""
    n = np.int64(0)
    for k in range(count):
        if normal[k, 0] == 0.0 and normal[k, 1] == 0.0 and normal[k, 2] == 0.0:
            out[n] = k
            n += 1
    return n


class PointLights(NamedTuple):
    """L lamps without extent, in camera space."""

    place: np.ndarray  # (L, 3) float64: position, or unit direction towards it (suns)
    axis: np.ndarray  # (L, 3) float64: where it shines to (spots, areas)
    strength: np.ndarray  # (L, 3) float64: irradiance of suns, intensity of others
    # (L, 3) float64: 1 for suns; exponent of the cosine to the axis (areas: 1); cosine of a spot's half angle, or -2
    kind: np.ndarray
    blend: np.ndarray  # (L,) float64: 1 / (width of a spot's soft rim in cosine)


def point_lights(lights: list[Light], camera_from_world: np.ndarray) -> PointLights:
    """All lamps of the scene, shrunk to their centres."""
    rows = []
    linear = camera_from_world[:3, :3]
    for light in lights:
        m = np.asarray(light.world_from_light, np.float64)
        strength = np.asarray(light.color, np.float64) * light.power * 2.0**light.exposure
        axis = linear @ (-m[:3, 2] / (np.linalg.norm(m[:3, 2]) or 1.0))
        place = linear @ m[:3, 3] + camera_from_world[:3, 3]
        kind, blend = [0.0, 0.0, -2.0], 0.0
        if light.kind == "SUN":
            place, kind[0] = -axis, 1.0
            if not light.normalize:
                strength = strength * math.pi * math.sin(0.5 * light.angle) ** 2
        elif light.kind == "AREA":
            kind[1] = 1.0
            sides = np.linalg.norm(m[:3, :2], axis=0) * (
                light.size_x, light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size_x
            )  # fmt: skip
            area = sides[0] * sides[1] * (math.pi / 4 if light.shape in ("DISK", "ELLIPSE") else 1.0)
            strength = strength / math.pi * (1.0 if light.normalize else area)
        else:
            if light.normalize:
                strength = strength / (4.0 * math.pi)
            else:
                strength = strength * (light.radius**2 if light.radius > 0 else 1.0 / math.pi)
            if light.kind == "SPOT":
                half = 0.5 * min(max(light.spot_angle, 1e-4), math.pi)
                kind[2] = math.cos(half)
                blend = 1.0 / max((1.0 - math.cos(half)) * light.spot_blend, 1e-12)
        rows.append((place, axis, strength, kind, blend))
    columns = list(zip(*rows, strict=True)) if rows else [np.zeros((0, 3))] * 4 + [np.zeros(0)]
    return PointLights(*(np.ascontiguousarray(np.array(c, np.float64)) for c in columns))


@uncounted
def shade_lambert(
    perspective, position, normal, albedo, emission, lights: PointLights, ambient, shadow, count, out
):
    """Radiance towards the camera of fragments 0..count.

    position (F, 3) float64, normal (F, 3) float32 of length up to 1 (what is missing: the piece's normals differ),
    albedo, emission (F, 3) float32; ambient (3,) float64 radiance of the world; shadow (L or 0, F) float32: share of
    each lamp's light that arrives; out (F, 3) float32. Surfaces are lit on the side that the camera sees.
    """
    for k in range(count):
        x, y, z = position[k, 0], position[k, 1], position[k, 2]
        if perspective:
            far = 1.0 / math.sqrt(x * x + y * y + z * z)
            vx, vy, vz = -x * far, -y * far, -z * far
        else:
            vx, vy, vz = 0.0, 0.0, -1.0
        nx, ny, nz = np.float64(normal[k, 0]), np.float64(normal[k, 1]), np.float64(normal[k, 2])
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        flat = min(max((length - ROUND) / (FLAT - ROUND), 0.0), 1.0)
        if length > 0.0:
            back = 1.0 / length
            if nx * vx + ny * vy + nz * vz < 0.0:
                back = -back
            nx *= back
            ny *= back
            nz *= back
        r, g, b = ambient[0], ambient[1], ambient[2]
        for i in range(len(lights.blend)):
            if lights.kind[i, 0] == 1.0:
                dx, dy, dz = lights.place[i, 0], lights.place[i, 1], lights.place[i, 2]
                scale = 1.0
            else:
                dx, dy, dz = lights.place[i, 0] - x, lights.place[i, 1] - y, lights.place[i, 2] - z
                d2 = max(dx * dx + dy * dy + dz * dz, 1e-30)
                scale = 1.0 / math.sqrt(d2)
                dx *= scale
                dy *= scale
                dz *= scale
                scale *= scale
                along = -(dx * lights.axis[i, 0] + dy * lights.axis[i, 1] + dz * lights.axis[i, 2])
                if lights.kind[i, 1] > 0.0:
                    scale *= max(along, 0.0)
                if lights.kind[i, 2] > -2.0:
                    t = min(max((along - lights.kind[i, 2]) * lights.blend[i], 0.0), 1.0)
                    scale *= t * t * (3.0 - 2.0 * t)
            cosine = max(nx * dx + ny * dy + nz * dz, 0.0)
            if flat < 1.0:
                # a sphere's mean cosine over the side that is seen, for pieces that face all directions
                c = min(max(vx * dx + vy * dy + vz * dz, -1.0), 1.0)
                angle = math.acos(c)
                ball = (math.sin(angle) + (math.pi - angle) * c) * (2.0 / (3.0 * math.pi))
                cosine = flat * cosine + (1.0 - flat) * ball
            scale *= cosine / math.pi
            if len(shadow) > 0:
                scale *= shadow[i, k]
            r += scale * lights.strength[i, 0]
            g += scale * lights.strength[i, 1]
            b += scale * lights.strength[i, 2]
        out[k, 0] = emission[k, 0] + albedo[k, 0] * r
        out[k, 1] = emission[k, 1] + albedo[k, 1] * g
        out[k, 2] = emission[k, 2] + albedo[k, 2] * b
