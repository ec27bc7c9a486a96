"""Lamps, in Blender's units: watts for point, spot and area lights, W/m^2 for suns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pointmr_engine.scene.graph import Graph
from pointmr_engine.scene.group import VISIBLE


@dataclass
class Light:
    """One lamp. It shines along its -z axis (spot, sun, area).

    color linear RGB; power in W, a sun's irradiance in W/m^2; exposure in stops. normalize: area lights spread
    their power over their area, others over their surface; without it, power is radiance times a constant.
    radius (m) of point and spot; angle (rad) of a sun; spot_angle (rad, full cone), spot_blend 0..1;
    size_x, size_y (m): full sides or diameters of "SQUARE", "RECTANGLE", "DISK", "ELLIPSE"; spread (rad, full cone).
    soft_falloff: as Cycles' option of the same name. visibility: the bits of scene.group.
    graph: nodes whose emission is a factor of the lamp's light, by place, direction and distance; None: 1.
    lights_catchers: shadow catchers show its shadows; else it adds to their light, and may outshine shadows of others.
    """

    kind: str  # "POINT", "SUN", "SPOT", "AREA"
    world_from_light: np.ndarray = field(default_factory=lambda: np.eye(4))
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    power: float = 10.0
    exposure: float = 0.0
    normalize: bool = True
    radius: float = 0.0
    angle: float = 0.00918
    spot_angle: float = 0.785398
    spot_blend: float = 0.15
    shape: str = "SQUARE"
    size_x: float = 1.0
    size_y: float = 1.0
    spread: float = np.pi
    soft_falloff: bool = True
    cast_shadow: bool = True
    use_mis: bool = True
    visibility: int = VISIBLE
    lights_catchers: bool = True
    graph: Graph | None = None
    name: str = "Light"
