"""Clumps, samples whose pieces face all ways, show what they cover, whatever lies behind them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointmr_engine import Camera, Group, Material, Mesh, RenderSettings, Scene, render, uniform_world
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import Instances, instance
from tests.engine.small_scenes import at, quad

SIDE = 10  # shoots a side
APART = 1.3  # metres from one to the next
NEEDLES = 90


def glowing(*colour: float) -> Material:
    """It shines and lights nothing: what is seen of it is how much of it is seen."""
    nodes = {"glow": Node("emission", {"color": colour, "strength": 1.0})}
    return Material("glowing", Graph(nodes, surface=Link("glow", "emission")), emission_sampling="none")


def shoot(material: Material, rng) -> Mesh:
    """A conifer's shoot along x, a metre long, without its stem: needles of three thin triangles on all sides."""
    turn = np.pi * (3 - 5**0.5) * np.arange(NEEDLES)
    ahead = np.stack([np.full(NEEDLES, 0.75), np.cos(turn), np.sin(turn)], 1) + rng.normal(
        0, 0.1, (NEEDLES, 3)
    )
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    side = np.cross((0.0, 0.0, 1.0), ahead)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(ahead, side)
    base = np.stack([np.linspace(-0.5, 0.5, NEEDLES), 0 * turn, 0 * turn], 1)
    ring = 0.07 * np.stack([np.cos(np.arange(3) * 2.1), np.sin(np.arange(3) * 2.1)], 1)
    size = 0.09
    corners = [base + size * (c * side + s * up) for c, s in ring] + [base + size * ahead]
    points = np.stack(corners, 1).reshape(-1, 3).astype(np.float32)
    faces = np.array([(0, 1, 3), (1, 2, 3), (2, 0, 3)]) + 4 * np.arange(NEEDLES)[:, None, None]
    return Mesh("shoot", points, faces.reshape(-1, 3).astype(np.int32), materials=(material,))


def turned(count: int, rng) -> np.ndarray:
    """(count, 3, 4) rotations, by chance."""
    q, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    return np.concatenate([q * np.linalg.det(q)[:, None, None], np.zeros((count, 3, 1))], 2)


def shoots(pixels: int, seed: int = 7) -> tuple[Scene, RenderSettings]:
    """SIDE x SIDE shoots as many pixels long, turned by chance, seen from above; green before a red wall."""
    rng = np.random.default_rng(seed)
    group = Group("shoot", [shoot(glowing(0.0, 1.0, 0.0), rng)])
    m = turned(SIDE * SIDE, rng)
    m[:, :2, 3] = APART * (np.stack(np.meshgrid(*[np.arange(SIDE)] * 2), -1).reshape(-1, 2) - (SIDE - 1) / 2)
    wall = Group("wall", [quad(40.0, -5.0, glowing(1.0, 0.0, 0.0))])
    root = Group("root", [], [Instances((group,), m), instance(wall)])
    side = round(SIDE * APART * pixels) + 4
    camera = Camera(at(0, 0, 10), kind="ORTHOGRAPHIC", ortho_scale=side / pixels)
    settings = RenderSettings(width=side, height=side, samples=64)
    return Scene(root, camera, [], uniform_world((0, 0, 0))), settings


def covered(method: str, pixels: int, seed: int = 7) -> float:
    """Pixels that shoots cover."""
    scene, settings = shoots(pixels, seed)
    frame = render(scene, replace(settings, method=method))
    if method == "raytrace":
        assert frame.stats["counters"]["clump_rays"] > 0
    return float(frame.passes["combined"][..., 1].sum())


@pytest.mark.parametrize("pixels", [1, 2, 4])
def test_clumps_hide_what_their_needles_hide(pixels):
    """Looks at what a clump shows must not find the wall through its gaps, which are drawn already: a half was left."""
    # a few samples stand for all shoots: of those of one seed, by chance, up to a quarter more or less
    ours, exact = (
        sum(covered(m, pixels, seed) for seed in range(7, 15)) for m in ("raytrace", "distributed")
    )
    assert ours == pytest.approx(exact, rel=0.1)
