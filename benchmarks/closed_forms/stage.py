"""What the closed forms stand on: a case, a camera, the pixel filter, and the few shapes of their scenes.

The camera and the filter are written here once more, from their definitions, so that a mistake in the engine's own
cannot cancel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pointmr_engine import Camera, Material, Mesh, RenderSettings, Scene, emission, uniform_world
from pointmr_engine.scene.graph import Graph, Link, Node

FILTER_WIDTH = 1.5  # pixels to either side: the default of RenderSettings
DARK = uniform_world((0.0, 0.0, 0.0))


@dataclass(frozen=True)
class View:
    """A pinhole and its image. world_from_camera: 4x4, looks along -z; focal: in units of the image's width."""

    width: int
    height: int
    world_from_camera: np.ndarray
    focal: float = 1.0

    def camera(self, **values) -> Camera:
        """The engine's camera of this view; it must be at least as wide as high."""
        values = {"sensor_width": 36.0, "focal_length": 36.0 * self.focal, "clip_start": 1e-3} | values
        return Camera(self.world_from_camera, **values)

    def rays(self, px: np.ndarray, py: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origin (3,) and directions (..., 3), world space, of unit length along the axis, through image positions.

        px, py: pixels from the lower left corner.
        """
        local = np.stack(
            [(px - 0.5 * self.width) / (self.width * self.focal),
             (py - 0.5 * self.height) / (self.width * self.focal),
             np.full_like(px, -1.0)], -1
        )  # fmt: skip
        m = self.world_from_camera
        return m[:3, 3], local @ m[:3, :3].T

    def on_floor(self, px: np.ndarray, py: np.ndarray) -> np.ndarray:
        """Points (..., 3) where rays meet the plane z = 0."""
        origin, d = self.rays(px, py)
        return origin + d * (-origin[2] / d[..., 2])[..., None]

    def project(self, points: np.ndarray) -> np.ndarray:
        """Image positions (N, 2), in pixels, of points (N, 3)."""
        m = self.world_from_camera
        local = (points - m[:3, 3]) @ m[:3, :3]
        xy = local[:, :2] / -local[:, 2:] * self.focal * self.width
        return xy + [0.5 * self.width, 0.5 * self.height]


@dataclass(frozen=True)
class Case:
    """One scene, its exact image and what the image is relative to.

    exact(): (height, width) float64, the red channel, pixel filter included. needs: what a method must have to draw
    it at all, of "area light", "lens", "reflection", "world light". settings: further values of RenderSettings.
    """

    name: str
    what: str
    view: View
    scene: Callable[[], Scene]
    exact: Callable[[], np.ndarray]
    needs: str = ""
    range: float | None = None  # None: the exact image's own
    settings: dict = field(default_factory=dict)

    def render_settings(self, **values) -> RenderSettings:
        """Settings of this case's image with the default pixel filter."""
        size = {"width": self.view.width, "height": self.view.height, "passes": ("combined",)}
        return RenderSettings(**(size | self.settings | values))

    def error(self, image: np.ndarray, exact: np.ndarray) -> float:
        """Root mean square error of an image's red channel, relative to the exact image's range."""
        span = self.range or float(exact.max() - exact.min())
        return float(np.sqrt(np.mean((image[..., 0] - exact) ** 2))) / span


def filter_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Offsets in pixels and weights that sum to 1: the Blackman-Harris filter, by the midpoint rule."""
    x = ((np.arange(count) + 0.5) / count * 2.0 - 1.0) * FILTER_WIDTH
    phase = np.pi * (x / FILTER_WIDTH + 1.0)
    w = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2.0 * phase) - 0.01168 * np.cos(3.0 * phase)
    return x, w / w.sum()


def filter_share(x: np.ndarray) -> np.ndarray:
    """The filter's cumulative share up to offset x, in pixels."""
    t = np.clip(x / FILTER_WIDTH, -1.0, 1.0)
    k = np.pi * np.arange(1, 4)
    a = np.array([0.48829, 0.14128, 0.01168])  # cos(n pi (t + 1)) = (-1)^n cos(n pi t): all signs become plus
    return (0.35875 * (t + 1.0) + (a / k * np.sin(k * t[..., None])).sum(-1)) / (2.0 * 0.35875)


def filtered(view: View, f: Callable[[np.ndarray, np.ndarray], np.ndarray], count: int) -> np.ndarray:
    """(height, width): f(px, py) through the pixel filter, by count x count points a pixel."""
    offsets, weights = filter_nodes(count)
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    total = np.zeros((view.height, view.width))
    for dy, wy in zip(offsets, weights, strict=True):
        for dx, wx in zip(offsets, weights, strict=True):
            total += wx * wy * f(x + dx, y + dy)
    return total


def look_down(z: float, x: float = 0.0, y: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """4x4 of a camera at (x, y, z) that looks along -z, turned about its axis by roll radians."""
    m = np.eye(4)
    m[0, :2], m[1, :2] = (np.cos(roll), -np.sin(roll)), (np.sin(roll), np.cos(roll))
    m[:3, 3] = x, y, z
    return m


def look_at(eye, target, roll: float = 0.0) -> np.ndarray:
    """4x4 of a camera at `eye` that looks at `target`, z up, turned about its axis by roll radians."""
    back = np.asarray(eye, float) - np.asarray(target, float)
    back /= np.linalg.norm(back)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    m = np.eye(4)
    c, s = np.cos(roll), np.sin(roll)
    m[:3, 0], m[:3, 1], m[:3, 2], m[:3, 3] = c * right + s * up, c * up - s * right, back, eye
    return m


def rectangle(x0, x1, y0, y1, z: float, material: Material, name: str = "rectangle") -> Mesh:
    """A rectangle in a plane z, facing up."""
    corners = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]], np.float64)
    return Mesh(name, corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), materials=(material,))


def diffuse(albedo: float, name: str = "diffuse") -> Material:
    """A Lambertian material."""
    node = Node("diffuse", {"color": (albedo, albedo, albedo), "roughness": 0.0})
    return Material(name, Graph({"bsdf": node}, surface=Link("bsdf", "bsdf")))


def mirror(roughness: float = 0.0) -> Material:
    """A white metal: GGX of this roughness (alpha is its square) without Fresnel or energy compensation."""
    distribution = "ggx" if roughness > 0.0 else "sharp"
    node = Node("glossy", {"color": (1.0, 1.0, 1.0), "roughness": roughness}, {"distribution": distribution})
    return Material("mirror", Graph({"bsdf": node}, surface=Link("bsdf", "bsdf")))


def glow(radiance: float = 1.0, lights: bool = False) -> Material:
    """A material that emits; it is searched for as a light only if `lights`."""
    material = emission("glow", strength=radiance)
    material.emission_sampling = "AUTO" if lights else "NONE"
    return material
