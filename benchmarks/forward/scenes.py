"""Scenes of forward mapping's benchmarks, made without Blender: forests of 10^4 to 10^15 triangles, and families of
scenes in which one quantity changes and all others stay.

All are lit by one sun without shadow under a sky that only the camera sees, and all surfaces are Lambertian: what
methods show then differs by sampling alone.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.forward import plants
from pointmr_engine import Camera, Group, Instances, Light, Mesh, Scene, uniform_world
from pointmr_engine.scene.group import CAMERA, count_triangles

SKY = (0.45, 0.6, 0.85)


def look(eye, target) -> np.ndarray:
    """4x4 world_from_camera of a camera at `eye` that looks at `target`, z up."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    back = plants.unit(eye - target)
    up = (0.0, 1.0, 0.0) if abs(back[2]) > 0.999 else (0.0, 0.0, 1.0)
    right = plants.unit(np.cross(up, back))
    m = np.eye(4)
    m[:3, 0], m[:3, 1], m[:3, 2], m[:3, 3] = right, np.cross(back, right), back, eye
    return m


def camera(eye, target, focal_length: float = 28.0, near: float = 0.05, far: float = 1e6) -> Camera:
    """A pinhole at `eye`."""
    return Camera(look(eye, target), focal_length=focal_length, clip_start=near, clip_end=far)


def stage(root: Group, view: Camera, power: float = 4.5) -> Scene:
    """A scene with the sun and the sky of all benchmarks."""
    sun = Light("SUN", look((-2, -3, 7), (0, 0, 0)), power=power, angle=0.0, cast_shadow=False)
    world = uniform_world(SKY)
    world.visibility = CAMERA
    return Scene(root, view, [sun], world)


@dataclass(frozen=True)
class Flight:
    """A scene and the cameras that fly through it."""

    name: str
    root: Group
    cameras: list[Camera]

    @functools.cached_property
    def scene(self) -> Scene:
        return stage(self.root, self.cameras[0])

    def views(self) -> list[Scene]:
        """The same scene from every camera; world and light are shared, so that a Cache knows it again."""
        s = self.scene
        return [Scene(s.root, c, s.lights, s.world) for c in self.cameras]

    @property
    def triangles(self) -> int:
        return count_triangles(self.root)[1]

    @property
    def unique(self) -> int:
        return count_triangles(self.root)[0]


def hills(x: np.ndarray, y: np.ndarray, height: float, length: float) -> np.ndarray:
    """Height of a rolling ground."""
    u, v = x / length, y / length
    return height * (
        np.sin(u + 0.7 * np.sin(1.3 * v))
        + np.sin(1.1 * v + 0.5 * np.sin(0.9 * u))
        + 0.4 * np.sin(2.3 * u - 1.7 * v)
    )


def ground(size: float, cells: int, height: Callable, material=plants.SOIL) -> Mesh:
    """A square of cells x cells x 2 triangles over the origin."""
    a = np.linspace(-size / 2, size / 2, cells + 1)
    x, y = np.meshgrid(a, a, indexing="xy")
    positions = np.stack([x, y, height(x, y)], -1).reshape(-1, 3)
    i = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    triangles = np.concatenate(
        [np.stack([i, i + 1, i + cells + 2], 1), np.stack([i, i + cells + 2, i + cells + 1], 1)]
    )
    return plants.mesh("ground", material, positions, triangles)


def upright(x, y, z, scale, spin) -> np.ndarray:
    """(N, 3, 4) placements that stand, turned about z."""
    c, s, o = np.cos(spin) * scale, np.sin(spin) * scale, np.zeros_like(x)
    return np.stack(
        [np.stack([c, -s, o, x], 1), np.stack([s, c, o, y], 1), np.stack([o, o, scale + o, z], 1)], 1
    )


def scattered(rng, side: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """side x side jittered points `step` apart, about the origin."""
    a = (np.arange(side) - (side - 1) / 2) * step
    x, y = np.meshgrid(a, a, indexing="xy")
    jitter = rng.uniform(-0.38, 0.38, (2, side * side)) * step
    return x.ravel() + jitter[0], y.ravel() + jitter[1]


def flight(
    radius: float, above: Callable, count: int, lift: tuple[float, float], ahead: float = 0.6
) -> list[Camera]:
    """Cameras along a curve that crosses the ground, low and high by turns."""
    t = np.linspace(0, 2 * np.pi, count, endpoint=False)

    def place(t):
        return radius * np.array([0.75 * np.sin(t), 0.65 * np.cos(t) + 0.15 * np.sin(2 * t)])

    cameras = []
    for i, a in enumerate(t):
        p, q = place(a), place(a + ahead)
        h = lift[0] + (lift[1] - lift[0]) * 0.5 * (1 - np.cos(2 * np.pi * i / count * 2))
        eye = (*p, float(above(*p)) + h)
        cameras.append(camera(eye, (*q, float(above(*q)) + 0.3 * h)))
    return cameras


def forest(trees: int, views: int = 24, seed: int = 0) -> Flight:
    """The talk's forest: `trees` instances of trees of some 84,000 triangles on rolling ground of 32,768 triangles.

    5,000 trees make 4.2 * 10^8 triangles, 72,000 make 6 * 10^9.
    """
    rng = np.random.default_rng(seed)
    side = max(1, round(trees**0.5))
    step = 6.5
    size = max(side * step * 1.05, 20.0)

    def height(x, y):
        return hills(x, y, 4.0 if side > 20 else 0.6, 48.0)

    x, y = scattered(rng, side, step)
    kinds = (
        plants.tree("ash", 1, plants.LEAF),
        plants.tree("alder", 2, plants.DARK_LEAF, 8.0),
        plants.tree("maple", 3, plants.AUTUMN, 7.0),
    )
    which = rng.choice(3, side * side, p=(0.55, 0.35, 0.1)).astype(np.int32)
    placed = upright(
        x, y, height(x, y) - 0.1, rng.uniform(0.7, 1.25, side * side), rng.uniform(0, 6.28, side * side)
    )
    root = Group("forest", [ground(size, 128, height)], [Instances(kinds, placed, which)])
    return Flight(f"forest of {trees:,} trees", root, flight(0.5 * size * 0.9, height, views, (4.0, 26.0)))


def land(views: int = 24, extent: float = 45_000.0) -> Flight:
    """A forest of 10^15 triangles to the horizon: sprigs, branches, limbs, trees, groves, stands, land."""
    rng = np.random.default_rng(3)
    trees = [
        plants.great_tree("oak", 10, plants.LEAF),
        plants.great_tree("elm", 20, plants.DARK_LEAF, 16.0),
        plants.great_tree("maple", 30, plants.AUTUMN, 11.0),
    ]
    grass = plants.tuft("grass", 5, plants.STRAW)
    groves = []
    for k in range(3):
        x, y = scattered(rng, 7, 32 / 7)
        n = len(x)
        which = rng.choice(3, n, p=((0.7, 0.2, 0.1), (0.2, 0.75, 0.05), (0.4, 0.4, 0.2))[k]).astype(np.int32)
        gx, gy = scattered(rng, 30, 32 / 30)
        groves.append(
            Group(
                f"grove {k}",
                [ground(32.0, 8, lambda x, y: 0 * x)],
                [
                    Instances(
                        tuple(trees),
                        upright(x, y, 0 * x, rng.uniform(0.7, 1.2, n), rng.uniform(0, 6.28, n)),
                        which,
                    ),
                    Instances(
                        (grass,),
                        upright(
                            gx, gy, 0 * gx, rng.uniform(0.7, 1.6, len(gx)), rng.uniform(0, 6.28, len(gx))
                        ),
                    ),
                ],
            )
        )
    stands = []
    for k in range(3):
        a = (np.arange(12) - 5.5) * 32.0
        x, y = (c.ravel() for c in np.meshgrid(a, a, indexing="xy"))
        turns = rng.integers(0, 4, 144) * (np.pi / 2)
        which = rng.choice(3, 144, p=np.roll((0.6, 0.25, 0.15), k)).astype(np.int32)
        stands.append(
            Group(
                f"stand {k}", [], [Instances(tuple(groves), upright(x, y, 0 * x, np.ones(144), turns), which)]
            )
        )

    def height(x, y):
        far = np.clip((np.hypot(x, y) - 2500.0) / 20_000.0, 0.0, 1.0)
        return hills(x, y, 25.0, 400.0) + far * (hills(x, y, 260.0, 5200.0) + 420.0)

    step = 384.0
    side = int(extent // step) * 2 + 1
    a = (np.arange(side) - side // 2) * step
    x, y = (c.ravel() for c in np.meshgrid(a, a, indexing="xy"))
    inside = np.hypot(x, y) < extent
    x, y = x[inside], y[inside]
    n = len(x)
    # stands lean with the slope, so that their borders nearly meet
    z, d = height(x, y), 0.5 * step
    placed = np.zeros((n, 3, 4))
    turns = rng.integers(0, 4, n)
    c, s = np.round(np.cos(turns * np.pi / 2)), np.round(np.sin(turns * np.pi / 2))
    slope_x, slope_y = (
        (height(x + d, y) - height(x - d, y)) / step,
        (height(x, y + d) - height(x, y - d)) / step,
    )
    placed[:, 0, 0], placed[:, 0, 1], placed[:, 1, 0], placed[:, 1, 1] = c, -s, s, c
    placed[:, 2, 0], placed[:, 2, 1], placed[:, 2, 2] = (
        slope_x * c + slope_y * s,
        slope_y * c - slope_x * s,
        1.0,
    )
    placed[:, :, 3] = np.stack([x, y, z], 1)
    soil = ground(2 * extent, 256, lambda x, y: height(x, y) - 8.0)
    which = rng.integers(0, 3, n).astype(np.int32)
    root = Group("land", [soil], [Instances(tuple(stands), placed, which)])
    return Flight("forest of 10^15 triangles", root, flight(1800.0, height, views, (40.0, 140.0)))


def carpet(levels: int, views: int = 4) -> Flight:
    """A rolling meadow whose triangles grow 16-fold with each level, while its area and all its angles stay.

    A tile is 4 x 4 copies of the tile of one level less at a quarter of its size, each turned by quarters. With 9 x 9
    of them, levels 0 to 9 have 10^4 to 10^15 triangles.
    """
    rng = np.random.default_rng(1)
    blades = plants.tuft("blades", 8, plants.LEAF, 60)
    soil = ground(1.0, 1, lambda x, y: 0 * x)
    tile = Group("tile 0", [*blades.meshes, soil])
    a = (np.arange(4) - 1.5) * 0.25
    x, y = (c.ravel() for c in np.meshgrid(a, a, indexing="xy"))
    for level in range(levels):
        turns = rng.integers(0, 4, 16) * (np.pi / 2)
        tile = Group(
            f"tile {level + 1}", [], [Instances((tile,), upright(x, y, 0 * x, np.full(16, 0.25), turns))]
        )
    a = np.arange(-4, 5) * 1.0
    x, y = (c.ravel() for c in np.meshgrid(a, a, indexing="xy"))
    placed = upright(x, y, hills(x, y, 0.2, 2.0), np.ones(81), rng.integers(0, 4, 81) * (np.pi / 2))
    root = Group("meadow", [], [Instances((tile,), placed)])
    t = np.linspace(0, 2 * np.pi, views, endpoint=False)
    cameras = [camera((7 * np.sin(b), -7 * np.cos(b), 3.5), (0, 0, 0), near=0.01) for b in t]
    return Flight(f"meadow {levels}", root, cameras)


def depths(tau: float, count: int = 1200, seed: int = 0) -> Flight:
    """`count` trees of one size in the image, side by side and at depths 10 to 10 tau: the same projected area
    for every tau.
    """
    rng = np.random.default_rng(seed)
    tree = plants.tree("ash", 1, plants.LEAF)
    columns = round((count * 4 / 3) ** 0.5)
    rows = round(columns * 3 / 4)
    u, v = (c.ravel() for c in np.meshgrid(np.arange(columns), np.arange(rows), indexing="xy"))
    n = len(u)
    u, v = (u + rng.uniform(0.3, 0.7, n)) / columns - 0.5, (v + rng.uniform(0.3, 0.7, n)) / rows - 0.5
    z = 10.0 * tau ** rng.permutation(np.linspace(0, 1, n))
    view = camera((0, 0, 0), (0, 1, 0), 28.0, 1.0, 1e2 * tau)
    wide = 36.0 / 28.0
    size = 0.75 * wide / columns / 9.0
    placed = upright(
        u * wide * z, z, (v * wide * 0.75 * z - 4.5 * size * z), size * z, rng.uniform(0, 6.28, n)
    )
    return Flight(f"depth range {tau:g}", Group("depths", [], [Instances((tree,), placed)]), [view])


def dragon(path: Path, views: int = 4) -> Flight:
    """The 871,414-triangle dragon on a floor, from its .ply.gz."""
    from benchmarks.speed_rays import read_ply

    positions, triangles = read_ply(path)
    positions = positions[:, [0, 2, 1]] * np.float32([1, -1, 1])  # y up -> z up
    low, high = positions.min(0), positions.max(0)
    middle = 0.5 * (low + high)
    positions = (positions - [middle[0], middle[1], low[2]]) * (1.0 / float((high - low).max()))
    body = plants.mesh("dragon", plants.diffuse("jade", 0.25, 0.55, 0.35), positions, triangles)
    floor = ground(6.0, 1, lambda x, y: 0 * x, plants.diffuse("floor", 0.5, 0.5, 0.5))
    t = np.linspace(0, 2 * np.pi, views, endpoint=False)
    cameras = [camera((1.3 * np.sin(a), -1.3 * np.cos(a), 0.75), (0, 0, 0.33), 40.0, 0.01) for a in t]
    return Flight("dragon", Group("dragon", [body, floor]), cameras)
