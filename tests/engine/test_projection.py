"""The projection factor and its bounds over boxes, and how many points cover an image."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine.forward import projection as pr
from pointmr_engine.forward.sample_count import hole_probability, points_per_pixel, random_count
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


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32), kind=st.sampled_from(KINDS))
def test_bounds_hold_in_the_whole_box(seed, kind):
    rng = np.random.default_rng(seed)
    c = camera(kind)
    p = point_in_view(c, rng)
    half = p[2] * rng.random(3) * np.array([1, 1, 0.9]) * 10.0 ** rng.uniform(-3, 0)
    box = np.concatenate([p - half, p + half])
    slope = pr.widest_slope(c)
    low, high = pr.density_bounds(c, box, slope)
    rectangle = np.empty(4)
    pr.box_to_raster(c, box, rectangle)
    inside = box[:3] + rng.random((400, 3)) * (box[3:] - box[:3])
    inside[:8] = [[box[3 * (k & 1)], box[1 + 3 * (k >> 1 & 1)], box[2 + 3 * (k >> 2)]] for k in range(8)]
    for q in inside:
        x, y = pr.to_raster(c, *q)
        assert rectangle[0] - 1e-6 <= x <= rectangle[2] + 1e-6
        assert rectangle[1] - 1e-6 <= y <= rectangle[3] + 1e-6
        if 0 <= x <= c.size[0] and 0 <= y <= c.size[1]:
            toward = q / np.linalg.norm(q) if c.perspective[0] else np.array([0, 0, 1.0])
            factor = pr.projection_factor(c, *q, *toward)
            assert low * (1 - 1e-9) <= factor <= high * (1 + 1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_inverse_depth_falls_with_depth_and_comes_back(kind):
    c = camera(kind)
    z = np.geomspace(0.11, 900, 50)
    inverse = [pr.inverse_depth(c, d) for d in z]
    assert (np.diff(inverse) < 0).all() and min(inverse) > 0
    assert [pr.depth_of(c, i) for i in inverse] == pytest.approx(z)


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
            u = rng.random(n if draws == "random" else rng.poisson(n))
        code = (u * 4**13).astype(np.int64)
        x = sum(((code >> 2 * b) & 1) << b for b in range(13)) / 2**13 - 0.5
        y = sum(((code >> 2 * b + 1) & 1) << b for b in range(13)) / 2**13 - 0.5
        turn = rng.uniform(0, 2 * np.pi)
        x, y = x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)
        i, j = np.floor(x * cells + 0.5 * inner), np.floor(y * cells + 0.5 * inner)
        inside = (i >= 0) & (i < inner) & (j >= 0) & (j < inner)
        empty[k] = inner * inner - len(np.unique(i[inside] * inner + j[inside]))
    return (empty > 0).mean(), empty.mean() / inner**2, inner * inner


@pytest.mark.parametrize("draws", ["random", "poisson", "stratified"])
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
    assert points_per_pixel("poisson", a, 1e-3) == points_per_pixel("random", a, 1e-3)
    assert points_per_pixel("stratified", 1, 0.9) <= points_per_pixel("random", 1, 0.9)
    with pytest.raises(KeyError):
        points_per_pixel("other", a, 1e-3)
