"""Cameras: perspective and orthographic, with shift, clipping and a thin lens."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Camera:
    """A camera that looks along its -z axis, y up. Lengths in metres unless said otherwise.

    world_from_camera: 4x4 float64 (scale is ignored). focal_length and sensor sizes in millimetres.
    sensor_fit "AUTO", "HORIZONTAL" or "VERTICAL"; shift in units of the fitted image side.
    fstop 0 means a pinhole; else the aperture's radius is focal_length / (2 fstop) (orthographic: 1 / (2 fstop), as
    Blender has it). blades 0 to 2 mean a round aperture; blade_rotation in radians; aperture_ratio > 1 squeezes it.
    """

    world_from_camera: np.ndarray = field(default_factory=lambda: np.eye(4))
    kind: str = "PERSPECTIVE"  # or "ORTHOGRAPHIC"
    focal_length: float = 50.0
    sensor_width: float = 36.0
    sensor_height: float = 24.0
    sensor_fit: str = "AUTO"
    ortho_scale: float = 6.0
    shift_x: float = 0.0
    shift_y: float = 0.0
    clip_start: float = 0.1
    clip_end: float = 1000.0
    fstop: float = 0.0
    focus_distance: float = 10.0
    blades: int = 0
    blade_rotation: float = 0.0
    aperture_ratio: float = 1.0
    name: str = "Camera"
