"""An edge out of focus: an emissive half plane through a thin lens.

A ray from the lens' point (u, v) through the image position whose pinhole ray has slope s meets the plane at depth z
at x = s z + u (1 - z / f), f the focused depth. The half plane x > 0 thus has the share of the round aperture that
lies beyond a chord: 1/2 + (t sqrt(1 - t^2) + asin t) / pi, t = s z / (R |1 - z / f|), R the aperture's radius.
"""

from __future__ import annotations

import numpy as np

from benchmarks.closed_forms.stage import DARK, Case, View, filtered, glow, look_down, rectangle
from pointmr_engine import Group, Scene

EYE = 10.0  # height of the camera, which looks down on a plane z
FOCAL = 36.0  # millimetres: as wide as the sensor
FSTOP = 0.06
RADIUS = 0.5e-3 * FOCAL / FSTOP


def disk_share(t: np.ndarray) -> np.ndarray:
    """Share of the unit disk with x < t."""
    t = np.clip(t, -1.0, 1.0)
    return 0.5 + (t * np.sqrt(1.0 - t * t) + np.arcsin(t)) / np.pi


def _case(name: str, depth: float, focus: float, scale: float) -> Case:
    view = View(48, 12, look_down(EYE, roll=0.3), 1.0)
    blur = RADIUS * abs(1.0 - depth / focus)

    def scene() -> Scene:
        size = 40.0
        half_plane = rectangle(0, size, -size, size, EYE - depth, glow(scale), "half plane")
        camera = view.camera(fstop=FSTOP, focus_distance=focus)
        return Scene(Group("root", [half_plane]), camera, [], DARK)

    def exact() -> np.ndarray:
        def radiance_at(px, py):
            _, d = view.rays(px, py)
            return scale * disk_share(d[..., 0] * depth / blur)

        return filtered(view, radiance_at, 24)

    pixels = 2.0 * blur / depth * view.focal * view.width
    what = f"half plane {'behind' if depth > focus else 'before'} the focus, {pixels:.1f} pixels of blur"
    return Case(name, what, view, scene, exact, "lens")


def cases() -> list[Case]:
    """Behind and before the plane in focus, and in focus (the plain edge under the pixel filter)."""
    return [
        _case("defocused far edge", 8.0, 1.5, 1.0),
        _case("defocused near edge", 1.0, 1.2, 1.0),
        _case("edge nearly in focus", 4.0, 3.5, 1.0),
    ]
