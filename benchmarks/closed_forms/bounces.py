"""Light that bounces: the inside of a sphere, lit by a point lamp that is not in its middle.

Every part of a sphere sees every other alike: of what all of it sends, the same arrives everywhere (the integrating
sphere). With albedo a, power P of the lamp and radius 1, the irradiance of its light is P cos / (4 pi d^2) at distance
d, P / (4 pi) on the mean, and that of the k-th bounce a^k P / (4 pi) everywhere.
"""

from __future__ import annotations

import functools

import numpy as np

from benchmarks.closed_forms import curved_mirror
from benchmarks.closed_forms.stage import DARK, Case, View, diffuse, filtered, look_at
from pointmr_engine import Group, Light, Scene

ALBEDO, BOUNCES = 0.7, 3
LAMP, POWER = np.array([0.2, 0.3, 0.35]), 40.0
VIEW = View(32, 16, look_at((0.1, -0.6, -0.1), (0.0, 1.0, 0.2), roll=0.3), 0.6)
RINGS = 256


def _from_inside(px: np.ndarray, py: np.ndarray) -> np.ndarray:
    """Points (..., 3) of the unit sphere that the view shows."""
    origin, d = VIEW.rays(px, py)
    d = d / np.linalg.norm(d, axis=-1, keepdims=True)
    b = d @ origin
    return origin + (np.sqrt(b * b + 1.0 - origin @ origin) - b)[..., None] * d


def _lit(px: np.ndarray, py: np.ndarray) -> np.ndarray:
    p = _from_inside(px, py)
    away = LAMP - p
    square = (away * away).sum(-1)
    direct = -(away * p).sum(-1) / square**1.5
    bounced = sum(ALBEDO**k for k in range(1, BOUNCES + 1))
    return ALBEDO / np.pi * POWER / (4.0 * np.pi) * (direct + bounced)


def cases() -> list[Case]:
    """The sphere under its lamp."""
    place = np.eye(4)
    place[:3, 3] = LAMP
    lamp = Light("POINT", place, power=POWER, radius=0.0)

    def scene() -> Scene:
        sphere = curved_mirror.sphere(RINGS)
        sphere.materials = (diffuse(ALBEDO),)
        return Scene(Group("root", [sphere]), VIEW.camera(), [lamp], DARK)

    what = f"a lamp in a diffuse sphere, {BOUNCES} bounces"
    settings = {"diffuse_bounces": BOUNCES}
    exact = functools.partial(filtered, VIEW, _lit, 4)
    return [Case("sphere from inside", what, VIEW, scene, exact, "bounces", settings=settings)]
