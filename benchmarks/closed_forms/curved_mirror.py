"""Mirrored stripes: a plane mirror and a sphere above which glowing stripes hang.

The sphere is intersected analytically and reflects by its true normals, at 72 x 72 points a pixel; the engine gets a
mesh of 500,000 triangles with smooth normals, whose sagitta is 2e-5 of the radius.
"""

from __future__ import annotations

import numpy as np

from benchmarks.closed_forms.stage import (
    DARK,
    Case,
    View,
    filtered,
    glow,
    look_at,
    look_down,
    mirror,
    rectangle,
)
from pointmr_engine import Group, Mesh, Scene

CEILING = 6.0
PITCH = 1.6  # of the stripes; half of it glows
REACH = 4.0  # the stripes' extent to either side


def stripes() -> list[Mesh]:
    """Glowing stripes along y under the ceiling."""
    starts = np.arange(-REACH, REACH - 1e-9, PITCH)
    return [
        rectangle(x, x + 0.5 * PITCH, -REACH, REACH, CEILING, glow(), f"stripe {i}")
        for i, x in enumerate(starts)
    ]


def stripes_along(p: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Radiance of rays from p (..., 3) along d (..., 3)."""
    up = d[..., 2] > 1e-9
    t = np.where(up, (CEILING - p[..., 2]) / np.where(up, d[..., 2], 1.0), 0.0)
    x, y = p[..., 0] + t * d[..., 0], p[..., 1] + t * d[..., 1]
    inside = up & (np.abs(x) < REACH) & (np.abs(y) < REACH)
    return np.where(inside & ((x + REACH) % PITCH < 0.5 * PITCH), 1.0, 0.0)


def sphere_radiance(origin: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Radiance of rays from `origin` (3,) along d (..., 3) that meet the mirrored unit sphere; else black."""
    d = d / np.linalg.norm(d, axis=-1, keepdims=True)
    b = d @ origin
    inside = b * b - (origin @ origin - 1.0)
    hit = inside > 0.0
    n = origin + (-b - np.sqrt(np.maximum(inside, 0.0)))[..., None] * d
    r = d - 2.0 * (n * d).sum(-1, keepdims=True) * n
    return np.where(hit, stripes_along(n, r), 0.0)


def sphere(rings: int) -> Mesh:
    """A unit sphere of rings x 2 rings quads with smooth normals, its poles on the x axis."""
    theta = np.linspace(0.0, np.pi, rings + 1)
    phi = np.linspace(0.0, 2.0 * np.pi, 2 * rings, endpoint=False)
    t, f = np.meshgrid(theta, phi, indexing="ij")
    p = np.stack([np.cos(t), np.sin(t) * np.cos(f), np.sin(t) * np.sin(f)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    k = (j + 1) % (2 * rings)
    a, b, c, e = (2 * rings * u + v for u, v in ((i, j), (i + 1, j), (i + 1, k), (i, k)))
    triangles = np.concatenate([np.stack([a, b, c], -1)[1:-1], np.stack([a, c, e], -1)[1:-1]]).reshape(-1, 3)
    first = np.stack([a, b, c], -1)[0], np.stack([a, c, e], -1)[-1]  # one triangle a quad at the poles
    triangles = np.concatenate([triangles, *first]).astype(np.int32)
    return Mesh("sphere", p, triangles, normals=p.astype(np.float32), materials=(mirror(),))


def _sphere_case(name: str, what: str, view: View) -> Case:
    def exact() -> np.ndarray:
        return filtered(view, lambda px, py: sphere_radiance(*view.rays(px, py)), 72)

    def scene() -> Scene:
        return Scene(Group("root", [sphere(350), *stripes()]), view.camera(), [], DARK)

    return Case(name, what, view, scene, exact, "reflection")


def _plane_case() -> Case:
    view = View(40, 20, look_at((0.0, -2.5, 2.5), (0.0, -1.5, 0.0), roll=0.4), 1.1)

    def radiance_at(px, py):
        _, d = view.rays(px, py)
        return np.where(d[..., 2] < 0.0, stripes_along(view.on_floor(px, py), d * [1.0, 1.0, -1.0]), 0.0)

    def scene() -> Scene:
        floor = rectangle(-90, 90, -90, 90, 0.0, mirror(), "mirror")
        return Scene(Group("root", [floor, *stripes()]), view.camera(), [], DARK)

    what = "stripes in a plane mirror"
    return Case("plane mirror", what, view, scene, lambda: filtered(view, radiance_at, 72), "reflection")


def cases() -> list[Case]:
    """A plane mirror, the sphere's middle, the whole sphere, and a small one whose stripes are below the pixels."""
    middle = View(40, 20, look_down(4.0, 0.1, 0.2, roll=0.35), 3.0)
    whole = View(32, 32, look_down(4.0, 0.1, 0.2, roll=0.35), 1.65)
    small = View(16, 16, look_down(4.0, 0.1, 0.2, roll=0.35), 0.9)
    return [
        _plane_case(),
        _sphere_case("mirrored sphere, middle", "stripes in the middle of a mirrored sphere", middle),
        _sphere_case("mirrored sphere, whole", "a whole mirrored sphere, 26 pixels across", whole),
        _sphere_case("mirrored sphere, small", "a mirrored sphere 7 pixels across", small),
    ]
