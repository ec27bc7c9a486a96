"""Visibility by alpha: coverages of lists of fragments, what merges in them and what hides, and images of them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine import Group, Mesh, RenderSettings, Scene, emission, principled, render, uniform_world
from pointmr_engine.forward.drawing.surfel_lanes import REACH
from pointmr_engine.forward.drawing.targets import put_ellipse, put_triangle
from pointmr_engine.forward.reconstruction.fragments import allocate_fragments
from pointmr_engine.image.filters import filter_weight
from pointmr_engine.multires.alpha.a_buffer import LINES, ROOM, allocate_layers
from pointmr_engine.multires.alpha.alpha_tiles import cell_taps, find_layers
from pointmr_engine.multires.alpha.layer_shapes import SIGMA
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.render import Cache
from pointmr_engine.scene.settings import RaytraceSettings
from tests.engine.instanced import sphere
from tests.engine.small_scenes import from_above, lit_floor, quad

SIZE = 16  # cells per side
ALPHA = RaytraceSettings(visibility="alpha")
SETTINGS = RenderSettings(width=48, height=36, method="raytrace", raytrace=ALPHA)
UP, DOWN = 1.0, -1.0  # sides


@uncounted
def draw_triangle(target, size, x, y, w, entry):
    put_triangle(target, size, size, (x[0], x[1], x[2]), (y[0], y[1], y[2]), (w[0], w[1], w[2]), entry)


@uncounted
def draw_ellipse(target, size, values, entry):
    """values (10,) float32: x, y, a, b, c, nearness, its two slopes, opacity, area."""
    v = values
    put_ellipse(
        target, size, size, v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], entry, v[8], v[9], np.int64(0)
    )


def new_target():
    return allocate_layers(SIZE, SIZE, (0.01, 0.0))


def triangle(target, corners, nearness, entry=0, side=UP) -> None:
    """corners (3, 2) counter-clockwise, in cells; nearness of each or of all."""
    corners = np.asarray(corners, float)[:: int(side)]
    w = np.broadcast_to(np.asarray(nearness, float), 3)[:: int(side)]
    draw_triangle(
        target, np.int64(SIZE), corners[:, 0].copy(), corners[:, 1].copy(), w.copy(), np.int64(entry)
    )


def half_plane(target, edge: float, nearness: float, left=True, **more) -> None:
    """All to one side of x = edge."""
    x0, x1 = (-40.0, edge) if left else (edge, 56.0)
    triangle(target, [(x0, -40), (x1, -40), (x1, 56)], nearness, **more)
    triangle(target, [(x0, -40), (x1, 56), (x0, 56)], nearness, **more)


def resolved(target) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(what cells let through (SIZE, SIZE), weights of fragments, their first numbers per cell)."""
    room = SIZE * SIZE * ROOM
    fragments, weight = allocate_fragments(room), np.empty(room, np.float32)
    first = np.empty(SIZE * SIZE + 1, np.int64)
    clear, empty = np.empty((SIZE, SIZE), np.float32), np.empty((SIZE, SIZE), np.uint8)
    n = np.int64(SIZE)
    count = find_layers(target, n, n, np.int64(0), np.int64(0), fragments, weight, first, clear, empty)
    assert np.array_equal(empty, clear > 0)
    return clear, weight[:count], first


# Coverage


def test_half_a_cell_is_a_half():
    target = new_target()
    half_plane(target, 8.5, 0.5)
    clear, weight, first = resolved(target)
    np.testing.assert_allclose(clear[:, 8], 0.5, atol=1e-6)
    assert np.all(clear[:, :7] == 0.0) and np.all(clear[:, 10:] == 1.0)
    sums = np.add.reduceat(np.append(weight, 0.0), first[:-1].clip(max=len(weight))) * (np.diff(first) > 0)
    np.testing.assert_allclose(sums.reshape(SIZE, SIZE), 1.0 - clear, atol=1e-5)


@settings(max_examples=100)
@given(
    st.lists(st.tuples(st.floats(2, SIZE - 2), st.floats(2, SIZE - 2)), min_size=3, max_size=3),
    st.floats(0.05, 0.95),
)
def test_a_triangle_weighs_its_area_under_the_cells_gaussian(corners, cut):
    """Two parts of a triangle weigh what the whole does, cell by cell, and all cells see its area."""
    p = np.array(corners)
    area = 0.5 * ((p[1, 0] - p[0, 0]) * (p[2, 1] - p[0, 1]) - (p[2, 0] - p[0, 0]) * (p[1, 1] - p[0, 1]))
    p = p if area > 0 else p[::-1]
    middle = p[1] + cut * (p[2] - p[1])
    edges = np.array([p[1] - p[0], p[2] - p[1], p[0] - p[2], middle - p[0]])
    # slivers between the lines, and edges along one, are right in the mean only
    if (
        min(cut, 1.0 - cut) * abs(area) < 0.5
        or np.ptp(p[:, 1]) < 2.0
        or np.abs(edges[:, 1]).min() < 1.0 / LINES
    ):
        return
    whole, parts = new_target(), new_target()
    triangle(whole, p, 0.5)
    triangle(parts, [p[0], p[1], middle], 0.5)
    triangle(parts, [p[0], middle, p[2]], 0.5, entry=1)
    a, b = 1.0 - resolved(whole)[0], 1.0 - resolved(parts)[0]
    assert np.abs(a - b).max() < 0.25 and abs(a.sum() - b.sum()) < 0.05 * abs(area) + 0.3
    assert abs(a.sum() - abs(area)) < 0.06 * abs(area) + 0.3


def test_surfels_that_tile_a_plane_leave_no_leak():
    """A jittered grid of pieces with their areas and covariances: what is far inside is whole."""
    target, rng = new_target(), np.random.default_rng(3)
    k = 0
    for y in range(-3, SIZE + 3):
        for x in range(-3, SIZE + 3):
            a = REACH**2 / 12.0
            px, py = np.array([x, y]) + 0.5 + rng.uniform(-0.03, 0.03, 2)
            values = np.array([px, py, a, 0.0, a, 0.5, 0.0, 0.0, 1.25, 1.0], np.float32)
            draw_ellipse(target, np.int64(SIZE), values, np.int64(k))
            k += 1
    assert resolved(target)[0].max() == 0.0


# What merges, and what hides


def test_surfaces_that_abut_in_a_cell_leave_no_leak():
    target = new_target()
    half_plane(target, 8.3, 0.5)
    half_plane(target, 8.3, 0.5, left=False, entry=1)
    assert resolved(target)[0].max() == 0.0


def test_a_crease_leaves_no_leak():
    """Two faces meet at one depth and fall off to both sides."""
    target = new_target()
    for x in (-40.0, 56.0):
        w = 0.5 - 0.01 * abs(x - 8.3)
        side = UP if x < 8.3 else DOWN
        a, b, c, d = (x, -40), (8.3, -40), (8.3, 56), (x, 56)
        # both face the viewer: their corners run the same way round
        for corners, depths in (([a, b, c], (w, 0.5, 0.5)), ([a, c, d], (w, 0.5, w))):
            order = 1 if side == UP else -1
            triangle(target, corners[::order], depths[::order], entry=int(x > 0))
    assert resolved(target)[0].max() == 0.0


def test_two_halves_apart_are_taken_for_independent():
    target = new_target()
    half_plane(target, 8.5, 0.5)
    half_plane(target, 8.5, 0.25, entry=1)
    clear = resolved(target)[0]
    np.testing.assert_allclose(1.0 - clear[:, 8], 0.75, atol=1e-6)
    np.testing.assert_allclose(clear[:, 10:], 1.0)


def test_two_sides_of_a_body_are_one_edge():
    target = new_target()
    half_plane(target, 8.5, 0.5, side=DOWN)
    half_plane(target, 8.5, 0.25, side=UP, entry=1)
    np.testing.assert_allclose(resolved(target)[0][:, 8], 0.5, atol=1e-6)


def test_what_is_behind_a_full_cell_is_not_kept():
    target = new_target()
    half_plane(target, 60.0, 0.5)
    lists = target.ids.copy()
    half_plane(target, 60.0, 0.25, entry=1)
    np.testing.assert_array_equal(lists, target.ids)
    assert (target.depth[:, :SIZE] > 0.25).all() and (target.depth[:, :SIZE] < 0.5).all()
    assert set(target.entry[8, 8, : target.ids[8, 8] + 1].tolist()) == {0}


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4 * ROOM))
def test_full_lists_stay_in_their_bounds(seed, count):
    """However many thin layers there are, in whatever order: coverages stay shares, and there is never less of them."""
    rng, target = np.random.default_rng(seed), new_target()
    least = 1.0
    for k in range(count):
        area = rng.uniform(0.05, 0.4)
        a = REACH**2 / 12.0 * area
        values = [8.5, 8.5, a, 0.0, a, rng.uniform(0.1, 0.9), 0.0, 0.0, 0.5, area]
        draw_ellipse(target, np.int64(SIZE), np.array(values, np.float32), np.int64(k))
        least = min(least, 1.0 - area)
    clear, weight, _ = resolved(target)
    assert target.ids[:, :SIZE].max() < ROOM
    assert (
        np.all((clear >= 0.0) & (clear <= 1.0))
        and np.all(weight > 0.0)
        and weight.max(initial=0.0) <= 1.0 + 1e-5
    )


# The pixel filter


@pytest.mark.parametrize(
    ("kind", "width", "bound"), [("blackman_harris", 1.5, 0.15), ("gaussian", 1.5, 0.15), ("box", 1.0, 0.2)]
)
@pytest.mark.parametrize("cells", [2, 4])
def test_cells_add_up_to_the_filter(kind, width, bound, cells):
    n = {"box": 1, "blackman_harris": 3, "gaussian": 5}[kind] * cells
    taps = cell_taps(kind, width, cells, n)
    assert taps.sum() == pytest.approx(1.0) and taps.min() >= 0.0
    np.testing.assert_allclose(taps, taps[::-1], atol=1e-6)
    x = np.linspace(-4, 4, 2001)
    at = (np.arange(n) + 0.5 - 0.5 * n) / cells
    sums = (taps * np.exp(-0.5 * ((x[:, None] - at) * cells / SIGMA) ** 2)).sum(1)
    wanted = filter_weight(kind, width, x)
    sums, wanted = sums / sums.sum(), wanted / wanted.sum()
    assert np.abs(sums - wanted).sum() < 2 * bound
    assert (sums * x * x).sum() == pytest.approx((wanted * x * x).sum(), rel=0.15 if kind != "box" else 0.3)


# Images


def ball(material) -> Mesh:
    return Mesh("ball", *sphere(96, 128, 0.8), materials=(material,))


def of(scene, cache=None, **values) -> np.ndarray:
    return render(scene, replace(SETTINGS, **values), cache=cache).passes["combined"].astype(float)


@pytest.mark.parametrize("kind", ["PERSPECTIVE", "ORTHOGRAPHIC"])
def test_a_body_is_whole_inside(kind):
    camera = from_above(5.0, kind=kind, ortho_scale=3.0)
    scene = Scene(Group("root", [ball(emission("glow"))]), camera, [], uniform_world())
    alpha = of(scene, film_transparent=True)[..., 3]
    masks = of(scene, film_transparent=True, raytrace=RaytraceSettings())[..., 3]
    inside = masks == 1.0
    # away from the rim, which the filter and the cells' Gaussians spread
    for axis in (0, 1):
        for step in (-1, 1, -2, 2):
            inside &= np.roll(masks == 1.0, step, axis)
    assert inside.sum() > 50 and alpha[inside].min() > 1.0 - 1e-6 and alpha.max() < 1.0 + 1e-5
    assert abs(alpha.sum() / masks.sum() - 1.0) < 0.02


def test_the_error_falls_with_the_cones():
    """Of what a ball covers, against many rays."""
    scene = Scene(Group("root", [ball(emission())]), from_above(5.0), [], uniform_world())
    cache, errors = Cache(), []
    exact = of(scene, cache, method="distributed", samples=1024, film_transparent=True)[..., 3]
    for cones in (1, 4, 16):
        seen = of(scene, cache, raytrace=replace(ALPHA, cones=cones), film_transparent=True)[..., 3]
        errors.append(np.abs(seen - exact).sum() / exact.sum())
    assert errors[2] < 0.7 * errors[1] < 0.5 * errors[0] and errors[0] < 0.05


def test_masks_keep_no_lists():
    masks = render(lit_floor(), replace(SETTINGS, raytrace=RaytraceSettings())).stats["counters"]
    alpha = render(lit_floor(), SETTINGS).stats["counters"]
    assert "layers" not in masks and alpha["layers"] > 0


def test_depth_of_field_is_seen_by_masks():
    scene = replace(lit_floor(quad(0.8, z=2.5)), camera=from_above(fstop=1.0, focus_distance=5.0))
    alpha, masks = render(scene, SETTINGS), render(scene, replace(SETTINGS, raytrace=RaytraceSettings()))
    assert any("depth of field" in w for w in alpha.warnings) and not masks.warnings
    np.testing.assert_array_equal(alpha.passes["combined"], masks.passes["combined"])


def test_a_tiles_border_does_not_show():
    """A region is a part of the whole, though its tiles begin elsewhere."""
    floor = lit_floor(quad(1.0, 1.0, principled("dull", specular_ior_level=0.0)), world=uniform_world())
    cache = Cache()
    whole = of(floor, cache, width=130, height=40)
    part = of(floor, cache, width=130, height=40, region=(60, 5, 110, 30))
    np.testing.assert_allclose(whole[5:30, 60:110], part, rtol=2e-3)


def test_passes_are_filtered_alike():
    frame = render(lit_floor(), replace(SETTINGS, passes=("combined", "depth", "normal", "diffuse_color")))
    np.testing.assert_allclose(frame.passes["depth"][..., 0], 5.0, rtol=1e-3)
    np.testing.assert_allclose(frame.passes["normal"], np.broadcast_to((0, 0, 1), (36, 48, 3)), atol=1e-3)
    np.testing.assert_allclose(frame.passes["diffuse_color"], 0.8, atol=1e-3)
