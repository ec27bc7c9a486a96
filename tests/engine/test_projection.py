"""The projection factor and its bounds over boxes, and how many points cover an image."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine.forward.drawing.subpixels import make_view
from pointmr_engine.forward.selection import projection as pr
from pointmr_engine.forward.selection.sample_count import hole_probability, points_per_pixel, random_count
from pointmr_engine.raytracing.camera import compile_camera
from pointmr_engine.scene.camera import Camera
from pointmr_engine.scene.settings import RenderSettings


def camera(kind="PERSPECTIVE", **values):
    settings = RenderSettings(width=320, height=200, pixel_aspect=1.25)
    return compile_camera(Camera(kind=kind, focal_length=24.0, shift_x=0.1, **values), settings)


KINDS = ("PERSPECTIVE", "ORTHOGRAPHIC")


def point_in_view(c, rng):
    z = 10.0 ** rng.uniform(-1, 3)
    xy = c.plane[0] + rng.random(2) * c.size * c.plane[1]
    return np.array([*(xy * z if c.perspective[0] else xy), z])


@pytest.mark.parametrize("kind", KINDS)
def test_the_factor_is_the_growth_of_area(kind):
    """A small triangle covers its area times the factor, in pixels."""
    rng = np.random.default_rng(1)
    c = camera(kind)
    for _ in range(200):
        p = point_in_view(c, rng)
        size = 1e-5 * p[2]
        corners = p + size * rng.normal(size=(3, 3))
        cross = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        area = 0.5 * np.linalg.norm(cross)
        n = cross / (2 * area)
        q = np.array([pr.to_raster(c, *corner) for corner in corners])
        u, v = q[1] - q[0], q[2] - q[0]
        covered = 0.5 * abs(u[0] * v[1] - u[1] * v[0])
        factor = pr.projection_factor(c, *corners.mean(0), *n)
        assert covered == pytest.approx(
            factor * area, rel=1e-3, abs=1e-5 * factor * area + 1e-6 * covered
        ) or (pr.orientation_factor(c.perspective[0], *p, *n) < 0.01)


def test_factors_of_known_directions():
    assert pr.depth_factor(True, 4.0) == 1 / 16 and pr.depth_factor(False, 4.0) == 1.0
    assert pr.distortion_factor(True, 3.0, 0.0, 3.0) == pytest.approx(math.sqrt(2))
    assert pr.distortion_factor(False, 3.0, 0.0, 3.0) == 1.0
    # the surface seen along the line of sight, not along the axis
    assert pr.orientation_factor(True, 3.0, 0.0, 3.0, 0.0, 0.0, 1.0) == pytest.approx(math.sqrt(0.5))
    assert pr.orientation_factor(True, 3.0, 0.0, 3.0, math.sqrt(0.5), 0.0, -math.sqrt(0.5)) == pytest.approx(
        0
    )
    assert pr.orientation_factor(False, 3.0, 0.0, 3.0, 0.0, 0.6, -0.8) == pytest.approx(0.8)
    assert pr.depth_ratio(True, 2.0, 3.0) == pytest.approx(2.25)
    assert pr.depth_ratio(True, -1.0, 3.0) == math.inf and pr.depth_ratio(False, -1.0, 3.0) == 1.0


@settings(max_examples=200)
@given(seed=st.integers(0, 2**32), kind=st.sampled_from(KINDS))
def test_bounds_hold_everywhere_behind_a_rectangle(seed, kind):
    rng = np.random.default_rng(seed)
    c = camera(kind)
    subpixels = 4
    view = make_view(c, subpixels, (0.1, 1000.0))
    corners = np.sort(rng.random((2, 2)), 0) * c.size
    near = 10.0 ** rng.uniform(-1, 3)
    most = pr.densest(view, near, *(corners * subpixels).ravel())
    for _ in range(50):
        xy = c.plane[0] + (corners[0] + rng.random(2) * (corners[1] - corners[0])) * c.plane[1]
        z = near * (1.0 + rng.random() ** 4)
        q = np.array([*(xy * z if c.perspective[0] else xy), z])
        toward = q / np.linalg.norm(q) if c.perspective[0] else np.array([0, 0, 1.0])
        assert pr.projection_factor(c, *q, *toward) * subpixels**2 <= most * (1 + 1e-9)
    # it is met: at the corner that lies farthest from the axis, by a surface that faces the camera
    x, y = corners[:, 0], corners[:, 1]
    best = 0.0
    for k in range(4):
        xy = c.plane[0] + np.array([x[k & 1], y[k >> 1]]) * c.plane[1]
        q = np.array([*(xy * near if c.perspective[0] else xy), near])
        toward = q / np.linalg.norm(q) if c.perspective[0] else np.array([0, 0, 1.0])
        best = max(best, pr.projection_factor(c, *q, *toward) * subpixels**2)
    assert best == pytest.approx(most)


def images_with_holes(draws, density, cells, images, rng):
    """Share of images with an empty cell, and mean share of empty cells: points in a unit square, in the order of a
    Z curve, and a turned grid of cells in its middle; 1 / cells is a cell's side."""
    n = math.ceil(cells * cells * density)
    inner = int(0.7 * cells)
    empty = np.empty(images, int)
    for k in range(images):
        if draws == "stratified":
            u = (np.arange(n) + rng.random(n)) / n
        else:
            u = rng.random(rng.poisson(n))
        code = (u * 4**13).astype(np.int64)
        x = sum(((code >> 2 * b) & 1) << b for b in range(13)) / 2**13 - 0.5
        y = sum(((code >> 2 * b + 1) & 1) << b for b in range(13)) / 2**13 - 0.5
        turn = rng.uniform(0, 2 * np.pi)
        x, y = x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)
        i, j = np.floor(x * cells + 0.5 * inner), np.floor(y * cells + 0.5 * inner)
        inside = (i >= 0) & (i < inner) & (j >= 0) & (j < inner)
        empty[k] = inner * inner - len(np.unique(i[inside] * inner + j[inside]))
    return (empty > 0).mean(), empty.mean() / inner**2, inner * inner


@pytest.mark.parametrize("draws", ["random", "stratified"])
def test_the_density_keeps_the_promised_probability_of_holes(draws):
    rng = np.random.default_rng(7)
    failure, images = 0.2, 3000
    cells = 14
    area = int(0.7 * cells) ** 2
    density = points_per_pixel(draws, area, failure)
    holes, _, _ = images_with_holes(draws, density, cells, images, rng)
    assert holes < failure + 4 * math.sqrt(failure / images)
    if draws != "stratified":
        assert holes > 0.7 * failure  # the bound is not generous
    _, share, _ = images_with_holes(draws, 2.0, cells, 600, rng)
    assert share == pytest.approx(hole_probability(draws, 2.0), rel=0.25)


def test_counts_of_points():
    a = 640 * 480
    assert random_count(a, 1e-3) / a == pytest.approx(19.54, abs=0.01)  # a (ln a + ln 1/f)
    assert points_per_pixel("stratified", a, 1e-3) < 0.55 * points_per_pixel("random", a, 1e-3)
    assert points_per_pixel("stratified", 1, 0.9) <= points_per_pixel("random", 1, 0.9)
    with pytest.raises(KeyError):
        points_per_pixel("other", a, 1e-3)
