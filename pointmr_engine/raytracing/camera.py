"""Cameras for kernels: pixel, filter and lens samples become rays; positions become window coordinates and depths.

Camera space here is x right, y up, z into the scene, in metres. Image coordinates are in pixels of the whole image, the
origin at its lower left corner, whatever region of it is rendered.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.image.filters import filter_offset, filter_table
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.rng import pixel_seed, sample_4d
from pointmr_engine.numerics.transforms import inverse_linear
from pointmr_engine.raytracing.rays import Rays
from pointmr_engine.scene.camera import Camera
from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.group import CAMERA
from pointmr_engine.scene.settings import RenderSettings

_CAMERA_RAY = np.uint8(CAMERA)


class CameraArrays(NamedTuple):
    """A camera as kernels read it."""

    world_from_camera: np.ndarray  # (3, 4) float64, orthonormal columns (mirrored if the camera is)
    camera_from_world: np.ndarray  # (3, 4) float64, its inverse: row 2 gives the depth along the view axis
    # (2, 2) float64: camera-space (x, y) = plane[0] + raster * plane[1], at z = 1 (perspective)
    plane: np.ndarray
    perspective: np.ndarray  # (1,) bool; else orthographic
    clip: np.ndarray  # (2,) float64: start, end along the view axis
    # (5,) float64: radius (0: pinhole), focus distance, blades (0: round), rotation, 1 / aspect
    lens: np.ndarray
    size: np.ndarray  # (2,) float64: the whole image's width and height in pixels
    filter_table: np.ndarray  # image.filters.filter_table


def compile_camera(camera: Camera, settings: RenderSettings) -> CameraArrays:
    """The camera for `settings`' image size, pixel aspect and pixel filter, as Blender and Cycles define it.

    For the method "conventional" the lens is closed to a pinhole, since its one ray goes through the lens' centre.
    Raises SceneError, naming the camera, for a kind or a value that cannot be rendered.
    """
    _validate(camera)
    view_width, view_height = settings.width * settings.pixel_aspect, float(settings.height)
    horizontal = camera.sensor_fit == "HORIZONTAL" or (
        camera.sensor_fit == "AUTO" and view_width >= view_height
    )
    sensor = camera.sensor_height if camera.sensor_fit == "VERTICAL" else camera.sensor_width
    fitted = view_width if horizontal else view_height
    # Half the fitted side: at distance 1 (perspective) or in metres (orthographic).
    half = 0.5 * sensor / camera.focal_length if camera.kind == "PERSPECTIVE" else 0.5 * camera.ortho_scale
    half_x, half_y = half * view_width / fitted, half * view_height / fitted
    shift_x, shift_y = 2.0 * half * camera.shift_x, 2.0 * half * camera.shift_y
    plane = np.array(
        [
            [shift_x - half_x, shift_y - half_y],
            [2.0 * half_x / settings.width, 2.0 * half_y / settings.height],
        ]
    )
    world_from_camera = np.array(camera.world_from_camera, np.float64)[:3, :4]
    world_from_camera[:, :3] /= np.linalg.norm(world_from_camera[:, :3], axis=0)
    world_from_camera[:, 2] *= -1.0
    linear = inverse_linear(world_from_camera)
    camera_from_world = np.concatenate([linear, -linear @ world_from_camera[:, 3:]], 1)
    radius = 0.0
    if camera.fstop > 0.0 and settings.method != "conventional":
        focal_length = 1e-3 * camera.focal_length if camera.kind == "PERSPECTIVE" else 1.0
        radius = focal_length / (2.0 * camera.fstop)
    blades = camera.blades if camera.blades >= 3 else 0
    return CameraArrays(
        np.ascontiguousarray(world_from_camera),
        np.ascontiguousarray(camera_from_world),
        plane,
        np.array([camera.kind == "PERSPECTIVE"]),
        np.array([camera.clip_start, camera.clip_end], np.float64),
        np.array([radius, camera.focus_distance, blades, camera.blade_rotation, 1.0 / camera.aperture_ratio]),
        np.array([settings.width, settings.height], np.float64),
        filter_table(settings.pixel_filter, settings.filter_width),
    )


def _validate(camera: Camera) -> None:
    name = f"camera '{camera.name}'"
    if camera.kind not in ("PERSPECTIVE", "ORTHOGRAPHIC"):
        raise SceneError(f"{name}: kind '{camera.kind}' is not supported; use PERSPECTIVE or ORTHOGRAPHIC")
    if camera.sensor_fit not in ("AUTO", "HORIZONTAL", "VERTICAL"):
        raise SceneError(f"{name}: sensor fit '{camera.sensor_fit}' is not AUTO, HORIZONTAL or VERTICAL")
    m = np.asarray(camera.world_from_camera, np.float64)
    if m.shape not in ((4, 4), (3, 4)) or not np.isfinite(m).all():
        raise SceneError(f"{name}: its transform must be a finite 4x4 matrix")
    if abs(np.linalg.det(m[:3, :3])) < 1e-30:
        raise SceneError(f"{name}: its transform is singular (a scale of zero?)")
    for what in ("focal_length", "sensor_width", "sensor_height", "ortho_scale", "aperture_ratio"):
        value = getattr(camera, what)
        if not (value > 0.0 and math.isfinite(value)):
            raise SceneError(f"{name}: {what} = {value} must be positive and finite")
    if not (0.0 <= camera.clip_start < camera.clip_end):
        raise SceneError(f"{name}: clip range {camera.clip_start} to {camera.clip_end} is empty or negative")
    if camera.fstop > 0.0 and not camera.focus_distance > 0.0:
        raise SceneError(f"{name}: focus distance {camera.focus_distance} must be positive")


@uncounted
def sample_disk(u, v):
    """Point of the unit disk for (u, v) in the unit square, by the concentric mapping."""
    a = 2.0 * u - 1.0
    b = 2.0 * v - 1.0
    if a == 0.0 and b == 0.0:
        return 0.0, 0.0
    if abs(a) > abs(b):
        r = a
        angle = 0.25 * math.pi * b / a
    else:
        r = b
        angle = 0.5 * math.pi - 0.25 * math.pi * a / b
    return r * math.cos(angle), r * math.sin(angle)


@uncounted
def sample_aperture(lens, u, v):
    """Point of the aperture, in metres on the lens: a disk or a regular polygon, squeezed along x."""
    if lens[2] < 3.0:
        x, y = sample_disk(u, v)
    else:
        # one of the polygon's triangles (centre, corner, corner), then a point of it with uniform density
        blade = math.floor(u * lens[2])
        s = math.sqrt(u * lens[2] - blade)
        along = (2.0 * v - 1.0) * s
        half_angle = math.pi / lens[2]
        px = s * math.cos(half_angle)
        py = along * math.sin(half_angle)
        turn = lens[3] + 2.0 * half_angle * blade
        x = math.cos(turn) * px - math.sin(turn) * py
        y = math.sin(turn) * px + math.cos(turn) * py
    return lens[0] * lens[4] * x, lens[0] * y


@uncounted
def camera_ray(camera: CameraArrays, raster_x, raster_y, u_lens, v_lens, rays: Rays, k, width, spread):
    """Ray k through image position (raster_x, raster_y), in pixels, and a lens sample; see `generate_rays`."""
    px = camera.plane[0, 0] + raster_x * camera.plane[1, 0]
    py = camera.plane[0, 1] + raster_y * camera.plane[1, 1]
    pixel = math.sqrt(camera.plane[1, 0] * camera.plane[1, 1])
    near = camera.clip[0]
    far = camera.clip[1]
    lx = 0.0
    ly = 0.0
    if camera.lens[0] > 0.0:
        lx, ly = sample_aperture(camera.lens, u_lens, v_lens)
    if camera.perspective[0]:
        focus = camera.lens[1]
        if camera.lens[0] > 0.0:
            dx, dy, dz = px * focus - lx, py * focus - ly, focus
        else:
            dx, dy, dz = px, py, 1.0
        inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
        # The clip range is along the view axis, by the slant of the ray through the lens' centre (as Cycles has it).
        slant = math.sqrt(px * px + py * py + 1.0)
        start = near * slant
        length = (far - near) * slant
        ox, oy, oz = lx + start * dx, ly + start * dy, start * dz
        # The pixel's solid angle falls with the cube of the cosine; the footprint is the root of its area.
        spread[k] = pixel / (slant * math.sqrt(slant))
        width[k] = spread[k] * start
    else:
        focus = camera.lens[1]
        dx, dy, dz = 0.0, 0.0, 1.0
        if camera.lens[0] > 0.0:
            dx, dy, dz = -lx, -ly, focus
            inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
            dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
        start = near / dz
        length = far - near
        ox, oy, oz = px + lx + start * dx, py + ly + start * dy, start * dz
        spread[k] = 0.0
        width[k] = pixel
    m = camera.world_from_camera
    for a in range(3):
        rays.origin[k, a] = m[a, 0] * ox + m[a, 1] * oy + m[a, 2] * oz + m[a, 3]
        rays.direction[k, a] = m[a, 0] * dx + m[a, 1] * dy + m[a, 2] * dz
    norm = 1.0 / math.sqrt(rays.direction[k, 0] ** 2 + rays.direction[k, 1] ** 2 + rays.direction[k, 2] ** 2)
    for a in range(3):
        rays.direction[k, a] *= norm  # a sheared camera does not keep lengths
    rays.t_min[k] = 0.0
    rays.t_max[k] = length
    rays.visibility[k] = _CAMERA_RAY
    rays.skip_triangle[k] = -1
    rays.skip_path[k] = 0


@uncounted
def generate_rays(camera: CameraArrays, x, y, u, rays: Rays, width, spread, start, stop):
    """Camera rays k in start..stop through pixels (x[k], y[k]) of the whole image.

    x, y (N,) int32; u (N, 4) float, in [0, 1): filter x, filter y, lens, lens (all 0.5: the centres); rays: filled,
    starting on the near clip plane, t from 0 to the far plane; width (N,) float32: the pixel's footprint (root of its
    area across the ray, metres) at the ray's start; spread (N,) float32: its growth per metre.
    """
    for k in range(start, stop):
        raster_x = x[k] + 0.5 + filter_offset(camera.filter_table, u[k, 0])
        raster_y = y[k] + 0.5 + filter_offset(camera.filter_table, u[k, 1])
        camera_ray(camera, raster_x, raster_y, u[k, 2], u[k, 3], rays, k, width, spread)


@uncounted
def sample_rays(
    camera: CameraArrays, tables, seed, x, y, sample, rays: Rays, seeds, width, spread, start, stop
):
    """`generate_rays` with its random numbers: sample number sample[k] of pixel (x[k], y[k]), dimension set 0.

    tables: rng.sobol_tables(); seed: the settings' seed; sample (N,) int32; seeds (N,) uint32: filled with the pixels'
    seeds for further dimensions. Sample 0 goes through the pixel's centre, so that unfiltered passes lie there.
    """
    for k in range(start, stop):
        seeds[k] = pixel_seed(x[k], y[k], seed)
        u0, u1, u2, u3 = sample_4d(tables, seeds[k], 0, sample[k])
        if sample[k] == 0:
            u0, u1 = 0.5, 0.5
        raster_x = x[k] + 0.5 + filter_offset(camera.filter_table, u0)
        raster_y = y[k] + 0.5 + filter_offset(camera.filter_table, u1)
        camera_ray(camera, raster_x, raster_y, u2, u3, rays, k, width, spread)


def window_coordinates(camera: CameraArrays, positions: np.ndarray) -> np.ndarray:
    """(N, 2) float32: where positions (N, 3) in world space lie in the whole image, 0..1 from its lower left corner."""
    m = camera.camera_from_world
    p = np.asarray(positions, np.float64) @ m[:, :3].T + m[:, 3]
    xy = p[:, :2] / p[:, 2:] if camera.perspective[0] else p[:, :2]
    return ((xy - camera.plane[0]) / (camera.plane[1] * camera.size)).astype(np.float32)


@uncounted
def view_depth(camera: CameraArrays, position):
    """Depth of one world position (3,) along the view axis, in metres: the Depth pass of this camera."""
    m = camera.camera_from_world
    return m[2, 0] * position[0] + m[2, 1] * position[1] + m[2, 2] * position[2] + m[2, 3]
