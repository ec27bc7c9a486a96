"""Warps: each lands in its shape, and equal areas of the square become equal areas (or solid angles) of the shape."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from pointmr_engine.numerics import warps

unit = st.floats(0.0, 1.0, exclude_max=True)
coordinate = st.floats(-10.0, 10.0)


def grid(n: int) -> np.ndarray:
    """One random point in each of n x n cells of the unit square."""
    c = np.arange(n)
    return (np.stack(np.meshgrid(c, c), -1).reshape(-1, 2) + np.random.default_rng(1).random((n * n, 2))) / n


def directions(*vectors):
    return [np.asarray(v, np.float64) / np.linalg.norm(v) for v in vectors]


def test_disk_keeps_area():
    p = np.array([warps.concentric_disk(*u) for u in grid(60)])
    r2 = (p**2).sum(1)
    assert r2.max() <= 1.0
    # r^2 is uniform, and so is the angle
    assert np.quantile(r2, [0.25, 0.5, 0.75]) == pytest.approx([0.25, 0.5, 0.75], abs=0.01)
    assert p.mean(0) == pytest.approx(0.0, abs=1e-2)
    assert (p[:, 0] * p[:, 1] > 0.0).mean() == pytest.approx(0.5, abs=0.01)
    assert warps.concentric_disk(0.5, 0.5) == (0.0, 0.0)


@given(st.tuples(coordinate, coordinate, coordinate))
def test_basis_is_orthonormal_and_right_handed(v):
    assume(np.linalg.norm(v) > 1e-6)
    (z,) = directions(v)
    b = np.array(warps.orthonormal_basis(*z)).reshape(2, 3)
    assert np.abs(b @ b.T - np.eye(2)).max() < 1e-12
    assert np.abs(np.cross(b[0], b[1]) - z).max() < 1e-12


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 2.0, -3.0)])
@pytest.mark.parametrize("one_minus_cos", [2.0, 1.0, 0.3, 1e-6])
def test_cone_is_uniform_in_solid_angle(axis, one_minus_cos):
    (axis,) = directions(axis)
    d = np.array([warps.uniform_cone(*axis, one_minus_cos, *u) for u in grid(40)])
    assert np.linalg.norm(d[:, :3], axis=1) == pytest.approx(1.0)
    assert 1.0 - d[:, :3] @ axis == pytest.approx(d[:, 3], abs=1e-12)
    # the height within the cone is uniform
    assert np.quantile(d[:, 3], [0.1, 0.5, 0.9]) == pytest.approx(
        np.array([0.1, 0.5, 0.9]) * one_minus_cos, rel=0.05
    )
    assert d[:, 3].max() <= one_minus_cos


def test_hemisphere_has_cosine_density():
    (axis,) = directions((1.0, -2.0, 0.5))
    d = np.array([warps.cosine_hemisphere(*axis, *u) for u in grid(60)])
    assert d[:, :3] @ axis == pytest.approx(d[:, 3], abs=1e-12)
    # the density is cos / pi: cos^2 is uniform
    assert np.quantile(d[:, 3] ** 2, [0.25, 0.5, 0.75]) == pytest.approx([0.25, 0.5, 0.75], abs=0.01)


@given(st.floats(1e-16, 1.0))
def test_one_minus_cos_is_exact_for_small_angles(sine_squared):
    expected = 2.0 * math.sin(0.5 * math.asin(math.sqrt(sine_squared))) ** 2
    assert warps.one_minus_cos_of_sine(sine_squared) == pytest.approx(expected, rel=1e-7)


@given(unit, unit)
def test_barycentrics_lie_in_the_triangle(u1, u2):
    a, b = warps.triangle_barycentrics(u1, u2)
    assert a >= 0.0 and b >= 0.0 and a + b <= 1.0


def test_barycentrics_are_uniform():
    p = np.array([warps.triangle_barycentrics(*u) for u in grid(60)])
    assert p.mean(0) == pytest.approx(1.0 / 3.0, abs=3e-3)
    assert (p[:, 0] < 0.5).mean() == pytest.approx(0.75, abs=0.02)


def test_solid_angles_of_known_shapes():
    x, y, z = np.eye(3)
    assert warps.triangle_solid_angle(*x, *y, *z) == pytest.approx(math.pi / 2)  # an eighth of the sphere
    # a cube's side
    assert warps.rectangle_solid_angle(-1.0, 1.0, -1.0, 1.0, 1.0) == pytest.approx(4.0 * math.pi / 6.0)
    assert warps.rectangle_solid_angle(-1e9, 1e9, -1e9, 1e9, 1.0) == pytest.approx(2.0 * math.pi)
    far = warps.rectangle_solid_angle(-0.5, 0.5, -0.5, 0.5, 1e3)
    assert far == pytest.approx(1e-6, rel=1e-5)
    a, b, c = directions((1e-4, 0.0, 1.0), (0.0, 1e-4, 1.0), (0.0, 0.0, 1.0))
    assert warps.triangle_solid_angle(*a, *b, *c) == pytest.approx(0.5e-8, rel=1e-5)


@given(
    coordinate, coordinate, st.floats(0.01, 10.0), st.floats(0.01, 10.0), st.floats(0.01, 10.0), unit, unit
)
def test_rectangle_points_lie_in_it(x0, y0, a, b, z, u1, u2):
    omega = warps.rectangle_solid_angle(x0, x0 + a, y0, y0 + b, z)
    assume(omega > 1e-6)
    x, y = warps.spherical_rectangle(x0, x0 + a, y0, y0 + b, z, omega, u1, u2)
    assert x0 <= x <= x0 + a and y0 <= y <= y0 + b
    # the share of the solid angle left of x is u1: the map is the inverse of that distribution
    left = warps.rectangle_solid_angle(x0, x, y0, y0 + b, z)
    assert left / omega == pytest.approx(u1, abs=1e-5)


@pytest.mark.parametrize("height", [0.01, 0.5, 30.0])
def test_rectangle_is_uniform_in_solid_angle(height):
    x0, x1, y0, y1 = -1.0, 2.0, 0.5, 3.0
    omega = warps.rectangle_solid_angle(x0, x1, y0, y1, height)
    p = np.array([warps.spherical_rectangle(x0, x1, y0, y1, height, omega, *u) for u in grid(100)])
    for a, b, c, d in [(-1.0, 0.0, 0.5, 1.0), (0.2, 1.1, 0.7, 2.0)]:
        share = warps.rectangle_solid_angle(a, b, c, d, height) / omega
        inside = (p[:, 0] > a) & (p[:, 0] < b) & (p[:, 1] > c) & (p[:, 1] < d)
        assert inside.mean() == pytest.approx(share, abs=0.01)


@given(*[st.tuples(coordinate, coordinate, coordinate)] * 3, unit, unit)
@example((1.0, 3.0, 1.0), (-4.0, 2.0**-23, 0.0), (1.0, 0.0, 0.0), 0.0, 0.5)  # two corners nearly opposite
def test_triangle_directions_lie_in_it(a, b, c, u1, u2):
    assume(min(np.linalg.norm(v) for v in (a, b, c)) > 1e-3)
    a, b, c = directions(a, b, c)
    omega = warps.triangle_solid_angle(*a, *b, *c)
    assume(omega > 1e-4 and omega < 6.2)
    d = np.array(warps.spherical_triangle(*a, *b, *c, omega, u1, u2))
    assert np.linalg.norm(d) == pytest.approx(1.0)
    # corners in one plane with the point that sees them, opposite ones above all, span nothing to weigh d by
    assume(abs(np.linalg.det(np.stack([a, b, c], 1))) > 1e-9)
    weights = np.linalg.solve(np.stack([a, b, c], 1), d)
    assert weights.min() > -1e-5 * np.abs(weights).max()


@pytest.mark.parametrize(
    "corners",
    [
        ((1.0, 0.0, 1.0), (0.0, 1.0, 1.0), (-1.0, -1.0, 1.0)),
        ((3.0, 0.0, 1.0), (0.0, 2.0, 0.2), (1.0, 1.0, 1.0)),
        ((-3.0, -3.0, 0.2), (3.0, -3.0, 0.2), (0.0, 5.0, 0.2)),
    ],
)
def test_triangle_is_uniform_in_solid_angle(corners):
    a, b, c = directions(*corners)
    omega = warps.triangle_solid_angle(*a, *b, *c)
    d = np.array([warps.spherical_triangle(*a, *b, *c, omega, *u) for u in grid(100)])
    # parts of the triangle get their share
    (m,) = directions(a + b + c)
    (ab,) = directions(a + b)
    for part in ((a, b, m), (b, c, m), (c, a, m), (a, ab, c)):
        share = warps.triangle_solid_angle(*part[0], *part[1], *part[2]) / omega
        inside = (np.linalg.solve(np.stack(part, 1), d.T) >= 0.0).all(0)
        assert inside.mean() == pytest.approx(share, abs=0.01)
