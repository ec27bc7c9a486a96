"""A half plane's shadow of a disk or a square light, or of the sun, on a diffuse floor.

The light, of radiance L, lies in the plane z = H; the occluder is the half plane x > 0 of z = h. From floor point
(x, y) the light is cut along the straight line x' = -x (H - h) / h, and what is left of x' gives
    E = L integral of H^2 / r^4 over x', y',   r^2 = H^2 + (x' - x)^2 + (y' - y)^2,
whose inner integral over y' is elementary. Radiance: albedo E / pi.

The sun of half angle a stands in the zenith, and E = L times what is left of the disk of radius sin a onto which its
directions project: those beyond the plane through the point and the edge, w_x = k w_z with k = -x / h, are cut off.
"""

from __future__ import annotations

import numpy as np

from benchmarks.closed_forms.stage import DARK, Case, View, diffuse, filtered, look_down, rectangle
from pointmr_engine import Group, Light, Scene

LIGHT, EDGE = 2.0, 1.0  # heights H and h
SUN = 0.25  # its half angle, rad
SIZE = 1.0  # diameter of the disk, side of the square
ALBEDO = 0.8
POWER = 10.0
NODES, WEIGHTS = np.polynomial.legendre.leggauss(48)


def _inner(a2: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Antiderivative over u of 1 / (a2 + u^2)^2."""
    a = np.sqrt(a2)
    return u / (2.0 * a2 * (a2 + u * u)) + np.arctan(u / a) / (2.0 * a2 * a)


def irradiance(x: np.ndarray, y: np.ndarray, disk: bool) -> np.ndarray:
    """Irradiance per unit of radiance at floor points (..., )."""
    r = 0.5 * SIZE
    cut = np.clip(-x * (LIGHT - EDGE) / EDGE, -r, r)[..., None]
    x, y = x[..., None], y[..., None]
    if disk:  # x' = r sin(t) takes the root out of the chord's ends
        last = np.arcsin(cut / r)
        t = 0.5 * (NODES + 1.0) * (last + 0.5 * np.pi) - 0.5 * np.pi
        lx, half = r * np.sin(t), r * np.cos(t)
        dx = half * 0.5 * WEIGHTS * (last + 0.5 * np.pi)
    else:
        lx = 0.5 * (NODES + 1.0) * (cut + r) - r
        half = np.full_like(lx, r)
        dx = 0.5 * WEIGHTS * (cut + r)
    a2 = LIGHT**2 + (lx - x) ** 2
    return (LIGHT**2 * (_inner(a2, half - y) - _inner(a2, -half - y)) * dx).sum(-1)


def _screened() -> Group:
    """The floor and the half plane."""
    return Group("root", [
        rectangle(-30, 30, -30, 30, 0.0, diffuse(ALBEDO, "floor"), "floor"),
        rectangle(0, 30, -30, 30, EDGE, diffuse(0.0, "screen"), "screen"),
    ])  # fmt: skip


def _case(name: str, shape: str, view: View) -> Case:
    disk = shape == "DISK"
    area = SIZE**2 * (0.25 * np.pi if disk else 1.0)
    radiance = POWER / (np.pi * area)

    def scene() -> Scene:
        lamp = Light("AREA", look_down(LIGHT), shape=shape, size_x=SIZE, size_y=SIZE, power=POWER)
        return Scene(_screened(), view.camera(), [lamp], DARK)

    def exact() -> np.ndarray:
        def radiance_at(px, py):
            p = view.on_floor(px, py)
            return ALBEDO / np.pi * radiance * irradiance(p[..., 0], p[..., 1], disk)

        return filtered(view, radiance_at, 16)

    what = f"half plane's shadow of a {shape.lower()} light, {_width(view):.0f} pixels of penumbra"
    return Case(name, what, view, scene, exact, "area light")


def sun_share(x: np.ndarray) -> np.ndarray:
    """Share of the sun's irradiance that arrives at floor points at x (...,)."""
    t = (np.arange(2000) + 0.5) / 2000 * np.pi - 0.5 * np.pi  # w_y = sin a sin t
    sine, half = np.sin(SUN) * np.sin(t), np.sin(SUN) * np.cos(t)
    k = (-x / EDGE)[..., None]
    cut = np.clip(k / np.sqrt(1.0 + k * k) * np.sqrt(1.0 - sine**2), -half, half)
    return ((cut + half) * half).sum(-1) / (2.0 * half**2).sum()


def _sun_case(view: View) -> Case:
    def scene() -> Scene:
        return Scene(
            _screened(), view.camera(), [Light("SUN", look_down(LIGHT), angle=2.0 * SUN, power=POWER)], DARK
        )

    def exact() -> np.ndarray:
        def radiance_at(px, py):
            return ALBEDO / np.pi * POWER * sun_share(view.on_floor(px, py)[..., 0])

        return filtered(view, radiance_at, 16)

    pixels = 2.0 * np.tan(SUN) * EDGE * view.focal * view.width / view.world_from_camera[2, 3]
    what = f"half plane's shadow of a wide sun, {pixels:.0f} pixels of penumbra"
    return Case("penumbra of the sun", what, view, scene, exact, "area light")


def _width(view: View) -> float:
    """The penumbra's width in pixels."""
    height = view.world_from_camera[2, 3]
    return SIZE * EDGE / (LIGHT - EDGE) * view.focal * view.width / height


def cases() -> list[Case]:
    """Wide penumbras of three lights, and one of few pixels; the edge is turned against the pixels."""
    wide = View(48, 12, look_down(0.9, roll=0.3), 0.45)
    narrow = View(48, 12, look_down(0.9, roll=0.3), 0.075)
    return [
        _case("penumbra of a disk", "DISK", wide),
        _case("penumbra of a square", "SQUARE", wide),
        _case("narrow penumbra", "DISK", narrow),
        _sun_case(wide),
    ]
