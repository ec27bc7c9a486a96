"""Depth of field: the cones of a tile are split over the lens, and what they see is merged again before it is shaded.

Every lens point is a view of its own: a camera moved to it, whose image plane is sheared so that the plane in focus
stays where it is. The subpixels of a tile are dealt out to the views, V x V of them, in turns along both axes: a view
draws every V-th subpixel of every V-th row, so that what is in focus has as many distinct samples as without a lens,
and an edge out of focus as many steps as there are views. A surface is shaded once for all views, in the cells in
which the lens' centre would see it; only what reflects more sharply than the lens is wide is shaded for each view.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.drawing.subpixels import View
from pointmr_engine.raytracing.camera import CameraArrays
from pointmr_engine.shading import leaves as kinds

SHARP = 4.0  # subpixels: circles of confusion up to this size are drawn as if through a pinhole
SMALL = 16.0  # ... and up to this one by few views
MOST = 16  # views per side
GOLDEN = math.pi * (3.0 - math.sqrt(5.0))


class LensView(NamedTuple):
    """The scene from one point of the lens, at every V-th subpixel of the image."""

    view: View  # in its own subpixels: V times larger ones than the image's
    camera_from_world: np.ndarray  # (3, 4) float64; orthographic: sheared
    world_from_camera: np.ndarray  # (3, 4) float64 of the camera of which this point is the centre
    x: float  # of the lens point, metres
    y: float
    shear_x: float  # orthographic: camera-space x per z
    shear_y: float
    column: int  # its first subpixel in the image's
    row: int


def lens_points(lens: np.ndarray, count: int) -> np.ndarray:
    """(count, 2) float64 points of the aperture, metres: a sunflower's seeds, the first at its centre.

    lens: CameraArrays.lens. Each stands for the same area; seen along any direction they lie at distinct places.
    """
    i = np.arange(count)
    share, turn = (i + 0.5) / count, (i * GOLDEN) % (2.0 * math.pi)
    r = np.sqrt(share)
    if lens[2] < 3.0:
        x, y = r * np.cos(turn), r * np.sin(turn)
    else:
        half = math.pi / lens[2]
        blade = np.floor(turn / (2.0 * half))
        along = turn / half - 2.0 * blade - 1.0
        px, py = r * math.cos(half), r * along * math.sin(half)
        angle = lens[3] + 2.0 * half * blade
        x, y = np.cos(angle) * px - np.sin(angle) * py, np.sin(angle) * px + np.cos(angle) * py
    points = np.stack([x, y], 1)
    points -= points.mean(0)
    return points * (lens[0] * np.array([lens[4], 1.0]))


def confusion(camera: CameraArrays, view: View, depth_range: tuple[float, float]) -> float:
    """Diameter in subpixels of the largest circle of confusion of what lies between two depths along the view axis."""
    near, far = max(depth_range[0], view.near), min(depth_range[1], view.far)
    radius, focus = camera.lens[0], camera.lens[1]
    scale = max(abs(view.scale_x), abs(view.scale_y)) * max(camera.lens[4], 1.0)
    if view.perspective:
        most = max(abs(1.0 / max(z, 1e-30) - 1.0 / focus) for z in (near, far))
    else:
        most = max(abs(1.0 - z / focus) for z in (near, far))
    return float(2.0 * radius * scale * most)


def views_per_side(diameter: float, subpixels: int) -> int:
    """How many views an image needs whose circles of confusion are at most so many subpixels wide."""
    if diameter <= SHARP:
        return 1
    return min(subpixels // (4 if diameter <= SMALL else 2), MOST)


def make_views(camera: CameraArrays, view: View, subpixels: int, side: int) -> list[LensView]:
    """side x side views for an image whose pinhole has `view`."""
    points = lens_points(camera.lens, side * side)
    focus, found = float(camera.lens[1]), []
    sx, sy = view.scale_x / side, view.scale_y / side
    for k, (x, y) in enumerate(points.tolist()):
        # the lens' centre looks at the subpixel that stands for its pixel in unfiltered passes
        a, b = _dealt(k, side)
        column, row = (a + subpixels // 2) % side, (b + subpixels // 2) % side
        shift_x = view.shift_x / side + 0.5 - (column + 0.5) / side
        shift_y = view.shift_y / side + 0.5 - (row + 0.5) / side
        matrix = np.array(camera.camera_from_world, np.float64)[:3]
        shear_x = shear_y = 0.0
        if view.perspective:
            shift_x += sx * x / focus
            shift_y += sy * y / focus
        else:
            shear_x, shear_y = x / focus, y / focus
            matrix[0] += shear_x * matrix[2]
            matrix[1] += shear_y * matrix[2]
        matrix[0, 3] -= x
        matrix[1, 3] -= y
        to_world = np.array(camera.world_from_camera, np.float64)
        to_world[:, 3] += x * to_world[:, 0] + y * to_world[:, 1]
        found.append(
            LensView(
                view._replace(scale_x=sx, scale_y=sy, shift_x=float(shift_x), shift_y=float(shift_y)),
                np.ascontiguousarray(matrix),
                np.ascontiguousarray(to_world),
                x,
                y,
                shear_x,
                shear_y,
                column,
                row,
            )  # fmt: skip
        )
    return found


class LensRays(NamedTuple):
    """The views' rays, as arrays."""

    of: np.ndarray  # (V, V) int32: number of the view that has the subpixels of this row and column, modulo V
    shift: np.ndarray  # (V * V, 2) float64: View.shift_x, shift_y
    world_from_camera: np.ndarray  # (V * V, 3, 4) float64


def lens_rays(views: list[LensView]) -> LensRays:
    """What looks through single subpixels need of the views of an image."""
    side = math.isqrt(len(views))
    of = np.empty((side, side), np.int32)
    for k, view in enumerate(views):
        of[view.row, view.column] = k
    return LensRays(
        of,
        np.array([[v.view.shift_x, v.view.shift_y] for v in views]),
        np.stack([v.world_from_camera for v in views]),
    )


def _dealt(k: int, side: int) -> tuple[int, int]:
    """The k-th cell of side x side (a power of two) in the order of an ordered dither: successive ones lie apart."""
    x = y = 0
    size = side
    while size > 1:
        size //= 2
        a, b = k & 1, (k >> 1) & 1
        x += size * (a ^ b)
        y += size * a
        k >>= 2
    return x, y


def sharpest(programs: list) -> np.ndarray:
    """(materials + 1,) float64: GGX alpha of the sharpest lobe of each material; inf for those that reflect evenly."""
    return np.array(
        [min((_alpha(leaf) for leaf in p.leaves), default=math.inf) for p in programs] + [math.inf]
    )


def refracts(programs: list) -> bool:
    """Whether any material has a lobe that may refract."""
    return any(_refracts(leaf) for p in programs for leaf in p.leaves)


def _refracts(leaf) -> bool:
    if leaf.kind == kinds.PRINCIPLED:
        name = "transmission_weight"
        return leaf.column_varying.get(name) or leaf.template[0, kinds.COLUMNS[leaf.kind].index(name)] > 0.0
    return leaf.kind in (kinds.GLASS, kinds.REFRACTION)


def _alpha(leaf) -> float:
    """Of the sharpest lobe that a leaf (program.LeafPlan) may have; 0 where it varies."""
    if leaf.kind not in (kinds.PRINCIPLED, kinds.METALLIC, kinds.GLOSSY, kinds.GLASS, kinds.REFRACTION):
        return math.inf
    names = kinds.COLUMNS[leaf.kind]

    def value(name: str, unknown: float) -> float:
        return unknown if leaf.column_varying.get(name) else float(leaf.template[0, names.index(name)])

    least = 0.0 if leaf.distribution == "sharp" else value("roughness", 0.0)
    if "coat_weight" in names and value("coat_weight", 1.0) > 0.0:
        least = min(least, value("coat_roughness", 0.0))
    return least * least
