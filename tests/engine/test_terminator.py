"""Shadow rays of smooth coarse meshes: raised to the round surface, where the light grazes, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from pointmr_engine import Group, Light, Mesh, RenderSettings, Scene, principled, render, uniform_world
from pointmr_engine.raytracing.terminator import height, share_of_height
from tests.engine.small_scenes import from_above


def test_raised_points_lie_near_the_sphere_that_normals_suggest():
    corners, normals = np.zeros((4, 3)), np.zeros((4, 3))
    angle = 2 * np.pi * np.arange(3) / 3
    corners[:3] = np.stack([0.4 * np.cos(angle), 0.4 * np.sin(angle), np.full(3, np.sqrt(1 - 0.16))], 1)
    normals[:3] = corners[:3]  # of a sphere about the origin
    for weights in ((1 / 3, 1 / 3, 1 / 3), (0.6, 0.3, 0.1), (0.1, 0.45, 0.45)):
        point = weights @ corners[:3]
        flat = np.linalg.norm(point)
        raised = np.linalg.norm(point + height(corners, normals, 1.0, *weights) * (weights @ normals[:3]))
        assert flat < 0.95 and 0.999 < raised < 2 - flat  # outside, by no more than the triangle is inside
    assert height(corners, normals, 1.0, 1.0, 0.0, 0.0) == pytest.approx(0, abs=1e-12)
    assert height(corners, normals, -1.0, 0.2, 0.3, 0.5) < 0  # seen from inside: toward the inside
    normals[:3] = (0, 0, 1)
    assert height(corners, normals, 1.0, 0.2, 0.3, 0.5) == 0


def test_only_grazing_light_raises():
    assert share_of_height(0.5, 0.5, 0.1) == 0 and share_of_height(0.02, -0.05, 0.1) == 1
    assert share_of_height(0.05, 0.1, 0.1) == pytest.approx(0.5)


def ball(columns: int, rows: int, offset: float) -> Mesh:
    """A unit sphere, smooth."""
    theta, phi = np.meshgrid(
        np.pi * np.arange(rows + 1) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij"
    )
    p = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a, b = i * columns + j, i * columns + (j + 1) % columns
    triangles = np.concatenate(
        [np.stack([a, a + columns, b + columns], -1), np.stack([a, b + columns, b], -1)]
    )
    grey = principled(base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0)
    p = p.astype(np.float32)
    mesh = Mesh("ball", p, triangles.reshape(-1, 3).astype(np.int32), normals=p, materials=(grey,))
    return replace(mesh, terminator_offset=offset)


def lit_ball(mesh: Mesh, method: str, angle: float, samples: int) -> np.ndarray:
    """(48, 48) of a ball seen from above, under a sun 30 degrees above the horizon: its shadow ends within facets."""
    low = np.eye(4)
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    low[:3, :3] = np.array([[s, 0, -c], [0, 1, 0], [c, 0, s]]).T
    sun = Light("SUN", low, power=3.0, angle=angle)
    scene = Scene(Group("root", [mesh]), from_above(4.0), [sun], uniform_world((0, 0, 0)))
    settings = RenderSettings(width=48, height=48, method=method, samples=samples, max_bounces=0)
    return render(scene, settings).passes["combined"][..., 0]


X, Y = np.meshgrid(np.arange(48) - 23.5, np.arange(48) - 23.5)
WITHIN = np.hypot(X, Y) < 13  # the coarse ball's outline


@pytest.mark.parametrize("method", ["distributed", "raytrace"])
def test_a_coarse_ball_is_lit_like_a_fine_one(method):
    fine = lit_ball(ball(96, 48, 0.0), method, 0.0, 4)
    lit = (fine > 0.02) & WITHIN
    bare, raised = (
        (lit_ball(ball(15, 8, offset), method, 0.0, 4) < 0.5 * fine)[lit].mean() for offset in (0.0, 0.1)
    )
    assert lit.mean() > 0.05 and bare > 0.04 and raised < 0.2 * bare


@pytest.mark.parametrize("offset", [0.0, 0.1])
@pytest.mark.parametrize("angle", [0.2, 0.6, 1.0])
def test_cones_to_wide_lamps_start_and_end_where_rays_do(angle, offset):
    """Where normals see a lamp that lies below their triangle, the ball hides it; where it is raised, it does not."""
    rays = lit_ball(ball(15, 8, offset), "distributed", angle, 1024)
    cones = lit_ball(ball(15, 8, offset), "raytrace", angle, 1)
    assert (np.abs(cones - rays)[WITHIN] / rays.max()).mean() < 0.0026


@pytest.mark.parametrize("method", ["distributed", "raytrace"])
@pytest.mark.parametrize("tilt", [0.5, 1.0])
def test_under_a_world_of_one_colour_tilted_normals_lose_what_lies_below_the_triangle(method, tilt):
    """Of the directions about the normal, by their cosine, (1 + cos tilt) / 2 lie above the square."""
    corners = np.array([[-4, -4, 0], [4, -4, 0], [4, 4, 0], [-4, 4, 0]], np.float32)
    normals = np.tile(np.float32([np.sin(tilt), 0, np.cos(tilt)]), (4, 1))
    grey = principled(base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0)
    square = Mesh("square", corners, np.int32([[0, 1, 2], [0, 2, 3]]), normals=normals, materials=(grey,))
    square = replace(square, terminator_offset=0.1)
    scene = Scene(Group("root", [square]), from_above(4.0), [], uniform_world((1, 1, 1)))
    settings = RenderSettings(width=24, height=24, method=method, samples=64, max_bounces=0)
    image = render(scene, settings).passes["combined"][..., :3]
    assert image.mean() == pytest.approx(0.8 * (1 + np.cos(tilt)) / 2, rel=0.01)
