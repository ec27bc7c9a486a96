"""The projection factor: how many pixels a piece of surface covers, per square metre; and bounds of it over a box.

prj = depth * orientation * distortion / (area of a pixel on the plane z = 1), with the talk's factors ("Perspective
Mapping"): depth 1 / z^2, orientation cos(beta), beta between the normal and the line of sight, and distortion
1 / cos(alpha), alpha between the line of sight and the view axis. They follow from the solid angle of a piece of
surface, dA cos(beta) cos^2(alpha) / z^2, and its image on the plane z = 1, which is 1 / cos^3(alpha) times as large.
Orthographic cameras have depth and distortion 1. All in camera space: x right, y up, z along the view axis, metres;
z > 0 for perspective.
"""

from __future__ import annotations

import math

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing.camera import CameraArrays


@uncounted
def depth_factor(perspective, z):
    """1 / z^2; 1 for orthographic cameras."""
    return 1.0 / (z * z) if perspective else 1.0


@uncounted
def orientation_factor(perspective, x, y, z, nx, ny, nz):
    """|cos| of the angle between the unit normal n and the line of sight to (x, y, z)."""
    if not perspective:
        return abs(nz)
    return abs(nx * x + ny * y + nz * z) / math.sqrt(x * x + y * y + z * z)


@uncounted
def distortion_factor(perspective, x, y, z):
    """1 / cos of the angle between the line of sight and the view axis; 1 for orthographic cameras."""
    return math.sqrt(x * x + y * y + z * z) / z if perspective else 1.0


@uncounted
def pixels_per_area(camera: CameraArrays):
    """Pixels on a unit square of the plane z = 1 (orthographic: of any plane z = const)."""
    return 1.0 / (camera.plane[1, 0] * camera.plane[1, 1])


@uncounted
def projection_factor(camera: CameraArrays, x, y, z, nx, ny, nz):
    """Pixels per square metre of surface at (x, y, z) with unit normal n: the product of the factors."""
    p = camera.perspective[0]
    return (
        depth_factor(p, z)
        * orientation_factor(p, x, y, z, nx, ny, nz)
        * distortion_factor(p, x, y, z)
        * pixels_per_area(camera)
    )


@uncounted
def depth_ratio(perspective, z_min, z_max):
    """Largest over smallest depth factor, (z_max / z_min)^2: a box is sampled whole where it is at most 1 + epsilon."""
    if not perspective:
        return 1.0
    if z_min <= 0.0:
        return math.inf
    return (z_max / z_min) * (z_max / z_min)


@uncounted
def widest_distortion(view, x0, y0, x1, y1):
    """Upper bound of the distortion factor between these subpixels of the image; view: subpixels.View."""
    x = max(abs(x0 - view.shift_x), abs(x1 - view.shift_x)) / view.scale_x
    y = max(abs(y0 - view.shift_y), abs(y1 - view.shift_y)) / view.scale_y
    return distortion_factor(view.perspective, x, y, 1.0)


@uncounted
def densest(view, near, x0, y0, x1, y1):
    """Upper bound of the subpixels on a square metre of surface, whatever its orientation, at depths from `near` > 0 on
    (perspective) and between these subpixels of the image."""
    depth = depth_factor(view.perspective, near)
    return depth * widest_distortion(view, x0, y0, x1, y1) * view.scale_x * view.scale_y


@uncounted
def to_raster(camera: CameraArrays, x, y, z):
    """(x, y) in pixels of the whole image, from its lower left corner."""
    if camera.perspective[0]:
        x /= z
        y /= z
    return (x - camera.plane[0, 0]) / camera.plane[1, 0], (y - camera.plane[0, 1]) / camera.plane[1, 1]
