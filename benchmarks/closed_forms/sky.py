"""World light that something hides: a floor under a uniform sky beside a wall and under a roof.

A wall of height h, infinitely long, hides (1 - cos phi) / 2 of the irradiance at distance d, tan phi = h / d. A disk
of radius R that faces the floor at height h hides, at distance a from its axis,
    F = 1/2 (1 - (a^2 + h^2 - R^2) / sqrt((a^2 + h^2 + R^2)^2 - 4 a^2 R^2)).
Radiance: albedo (1 - F) times the sky's.
"""

from __future__ import annotations

import numpy as np

from benchmarks.closed_forms.stage import Case, View, diffuse, filtered, look_down, rectangle
from pointmr_engine import Group, Mesh, Scene, uniform_world

ALBEDO = 0.8
WALL = 1.0
LENGTH = 300.0  # the wall's, to either side: its ends hide 1e-5 less than infinity
ROOF, RADIUS = 1.0, 1.0


def _floor() -> Mesh:
    return rectangle(-400, 400, -400, 400, 0.0, diffuse(ALBEDO, "floor"), "floor")


def _wall() -> Mesh:
    corners = np.array([[0, -LENGTH, 0], [0, LENGTH, 0], [0, LENGTH, WALL], [0, -LENGTH, WALL]], np.float64)
    return Mesh(
        "wall", corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), materials=(diffuse(0.0, "black"),)
    )


def _roof(sides: int = 720) -> Mesh:
    t = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    radius = RADIUS * np.sqrt(2.0 * np.pi / sides / np.sin(2.0 * np.pi / sides))  # the disk's area
    rim = np.stack([radius * np.cos(t), radius * np.sin(t), np.full_like(t, ROOF)], 1)
    i = np.arange(sides)
    triangles = np.stack([np.full(sides, sides), i, (i + 1) % sides], 1).astype(np.int32)
    return Mesh("roof", np.vstack([rim, [0, 0, ROOF]]), triangles, materials=(diffuse(0.0, "black"),))


def beside_wall(d: np.ndarray) -> np.ndarray:
    """Share of the sky's irradiance at distance d (> 0) from the wall."""
    return 0.5 * (1.0 + d / np.hypot(d, WALL))


def under_roof(a: np.ndarray) -> np.ndarray:
    """Share of the sky's irradiance at distance a from the roof's axis."""
    a2, h2, r2 = a * a, ROOF**2, RADIUS**2
    return 0.5 * (1.0 + (a2 + h2 - r2) / np.sqrt((a2 + h2 + r2) ** 2 - 4.0 * a2 * r2))


def _case(name: str, what: str, view: View, mesh, radiance, count: int) -> Case:
    def exact() -> np.ndarray:
        def radiance_at(px, py):
            return ALBEDO * radiance(view.on_floor(px, py))

        return filtered(view, radiance_at, count)

    def scene() -> Scene:
        return Scene(Group("root", [_floor(), mesh()]), view.camera(), [], uniform_world((1.0, 1.0, 1.0)))

    return Case(name, what, view, scene, exact, "world light", range=ALBEDO)


def cases() -> list[Case]:
    """Away from the wall, where it meets the floor, and under the roof."""

    def wall(p):
        return np.where(p[..., 0] > 0.0, beside_wall(np.maximum(p[..., 0], 0.0)), 0.0)

    def roof(p):
        return under_roof(np.hypot(p[..., 0], p[..., 1]))

    away = View(32, 8, look_down(0.9, 1.6, roll=0.3), 0.6)
    contact = View(32, 8, look_down(0.5, 0.3, roll=0.3), 0.6)
    below = View(32, 8, look_down(0.9, 1.0, roll=0.3), 0.4)
    return [
        _case("sky beside a wall", "floor 0.8 to 2.4 heights from a black wall", away, _wall, wall, 12),
        _case("sky at a contact", "floor where it meets the wall", contact, _wall, wall, 48),
        _case("sky under a roof", "floor under a black disk", below, _roof, roof, 12),
    ]
