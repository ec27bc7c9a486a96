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
def distortion_bounds(perspective, box, slope_max):
    """(lower, upper) bound of the distortion factor in a camera-space box (6,) with z_min > 0.

    slope_max: the largest tangent of alpha in the image: what lies farther out is not seen, and does not count.
    """
    if not perspective:
        return 1.0, 1.0
    near, far = 0.0, 0.0
    for k in range(2):
        low, high = box[k], box[3 + k]
        edge = max(abs(low), abs(high)) / box[2]
        far += edge * edge
        if low > 0.0 or high < 0.0:
            edge = min(abs(low), abs(high)) / box[5]
            near += edge * edge
    seen = slope_max * slope_max
    return math.sqrt(1.0 + min(near, seen)), math.sqrt(1.0 + min(far, seen))


@uncounted
def density_bounds(camera: CameraArrays, box, slope_max):
    """(lower, upper) bound of depth * distortion in pixels per square metre, orientation left out, over a box as above.

    The upper bound holds for every surface in the box, whatever its orientation; the ratio of both is at most
    (z_max / z_min)^2 times that of the distortion.
    """
    p = camera.perspective[0]
    low, high = distortion_bounds(p, box, slope_max)
    scale = pixels_per_area(camera)
    return low * depth_factor(p, box[5]) * scale, high * depth_factor(p, box[2]) * scale


@uncounted
def widest_slope(camera: CameraArrays):
    """Tangent of the largest angle between a line of sight in the image and the view axis."""
    x = max(abs(camera.plane[0, 0]), abs(camera.plane[0, 0] + camera.size[0] * camera.plane[1, 0]))
    y = max(abs(camera.plane[0, 1]), abs(camera.plane[0, 1] + camera.size[1] * camera.plane[1, 1]))
    return math.sqrt(x * x + y * y)


@uncounted
def to_raster(camera: CameraArrays, x, y, z):
    """(x, y) in pixels of the whole image, from its lower left corner."""
    if camera.perspective[0]:
        x /= z
        y /= z
    return (x - camera.plane[0, 0]) / camera.plane[1, 0], (y - camera.plane[0, 1]) / camera.plane[1, 1]


@uncounted
def box_to_raster(camera: CameraArrays, box, out):
    """Pixel bounds (lower x, y, upper x, y) of a camera-space box (6,) with z_min > 0; out (4,) float64."""
    for k in range(2):
        low, high = box[k], box[3 + k]
        if camera.perspective[0]:
            low /= box[2] if low < 0.0 else box[5]
            high /= box[5] if high < 0.0 else box[2]
        out[k] = (low - camera.plane[0, k]) / camera.plane[1, k]
        out[2 + k] = (high - camera.plane[0, k]) / camera.plane[1, k]


@uncounted
def inverse_depth(camera: CameraArrays, z):
    """A value that is larger the nearer: 1 / z, or for orthographic cameras 1 - (z - start) / (end - start)."""
    if camera.perspective[0]:
        return 1.0 / z
    return 1.0 - (z - camera.clip[0]) / (camera.clip[1] - camera.clip[0])


@uncounted
def depth_of(camera: CameraArrays, inverse):
    """The z that has this `inverse_depth`."""
    if camera.perspective[0]:
        return 1.0 / inverse
    return camera.clip[0] + (1.0 - inverse) * (camera.clip[1] - camera.clip[0])
