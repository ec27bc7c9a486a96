"""Places in the image that subpixels look at: no two of a pixel in one line, and shapes cover those that they hold."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine.forward.drawing import near_clip, surfel_lanes
from pointmr_engine.forward.drawing.cut_out_cover import cover_cut_out
from pointmr_engine.forward.drawing.subpixel_places import INNER, subpixel_places
from pointmr_engine.forward.drawing.subpixels import allocate_target, clear, cover_ellipse, cover_triangle
from pointmr_engine.forward.reconstruction.pixel_filter import filter_taps
from pointmr_engine.numerics.jit import uncounted

SIDE = 48
WHOLE = 2.0  # opacity of what is drawn without gaps


@uncounted
def draw_triangle(target, width, height, x, y, w, entry):
    return cover_triangle(
        target, width, height, (x[0], x[1], x[2]), (y[0], y[1], y[2]), (w[0], w[1], w[2]), entry
    )


@uncounted
def draw_cut_out(target, width, height, x, y, w, entry, opacity):
    return cover_cut_out(
        target, width, height, True, (x[0], x[1], x[2]), (y[0], y[1], y[2]), (w[0], w[1], w[2]), near_clip.WHOLE, entry,
        opacity.reshape(-1), np.int64(0), np.int64(opacity.shape[1]), np.int64(0),
    )  # fmt: skip


@uncounted
def place_triangles(corners, constants, lanes):
    return surfel_lanes.corners_eight(
        np.uint64(corners.ctypes.data),
        np.int64(0),
        np.uint64(constants.ctypes.data),
        np.uint64(lanes.ctypes.data),
    )


@uncounted
def draw_ellipse(target, width, height, x, y, a, b, c, entry):
    return cover_ellipse(
        target, width, height, x, y, a, b, c, 1.0, 0.0, 0.0, entry, np.float32(WHOLE), np.int64(0)
    )


def empty(subpixels=8):
    target = allocate_target(SIDE, SIDE, subpixels)
    clear(target, SIDE)
    return target


def places(target):
    """x and y (SIDE, SIDE) of what subpixels look at."""
    j, i = np.indices((SIDE, SIDE))
    return i + 0.5 + target.shift[1, j & 7].astype(float), j + 0.5 + target.shift[0, i & 7].astype(float)


def drawn(target, entry):
    return target.ids[:SIDE, :SIDE] == entry


@pytest.mark.parametrize("subpixels", [1, 2, 3, 4, 6, 8, 16])
def test_no_two_subpixels_of_a_pixel_share_a_line_or_a_column(subpixels):
    shift = subpixel_places(subpixels)
    period = math.gcd(subpixels, 8)
    assert (np.abs(shift) <= 0.5 - INNER).all()
    assert np.abs(shift.mean(1)).max() < 1e-7
    j, i = np.indices((period, period))
    for values in (i + shift[1, j], j + shift[0, i]):
        lines = np.unique(values)
        assert len(lines) == period**2
        assert (np.diff(lines) > 0.5 / period).all()
        if period == 8:
            assert np.diff(lines) == pytest.approx(1.0 / period, abs=1e-6)


def coverage(angle, offset, subpixels, shift=None):
    """Share (offsets,) of a filtered pixel on one side of lines at an angle, seen by its subpixels."""
    taps = filter_taps("blackman_harris", 1.5, subpixels).astype(float)
    k = np.arange(len(taps))
    middle, of_pixel = k + 0.5 - len(taps) / 2, (k - (len(taps) - subpixels) // 2) % subpixels
    sx, sy = (0.0, 0.0) if shift is None else (shift[1, of_pixel], shift[0, of_pixel][:, None])
    x, y = (middle[:, None] + sx) / subpixels, (middle + sy) / subpixels
    edges = np.concatenate([[-9.0], offset, [9.0]])
    along = x * math.cos(angle) + y * math.sin(angle)
    return np.histogram(along.ravel(), edges, weights=np.outer(taps, taps).ravel())[0].cumsum()[:-1]


def half_plane_errors(subpixels, shift=None):
    """RMS errors of the coverage of a filtered pixel by half planes, by their angle. shift: none, a plain grid."""
    offset, errors = np.linspace(-1.6, 1.6, 321), []
    for angle in np.linspace(0.0, np.pi, 60, endpoint=False):
        error = coverage(angle, offset, subpixels, shift) - coverage(angle, offset, 96)
        errors.append(math.sqrt((error**2).mean()))
    return np.array(errors)


@pytest.mark.parametrize("subpixels, level, worst", [(2, 0.65, 0.7), (4, 0.5, 0.6), (8, 0.2, 0.45)])
def test_edges_at_every_angle_are_resolved_alike(subpixels, level, worst):
    """And on the whole no worse than on a plain grid, where the level and upright ones are the worst."""
    plain = half_plane_errors(subpixels)
    spread = half_plane_errors(subpixels, subpixel_places(subpixels).astype(float))
    assert max(spread[0], spread[30]) < level * plain[0]
    assert spread.max() < worst * plain.max()
    assert math.sqrt((spread**2).mean()) < 1.1 * math.sqrt((plain**2).mean())


corner = st.tuples(st.floats(-30.0, 80.0), st.floats(-30.0, 80.0))
size = st.sampled_from([0.5, 2.0, 7.0, 60.0])


def inside(x, y, px, py):
    """Whether places are in the triangle x, y; and how far the nearest edge is, subpixels."""
    area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    within, far = np.ones(px.shape, bool), np.full(px.shape, np.inf)
    for k in range(3):
        n = (k + 1) % 3
        ex, ey = x[n] - x[k], y[n] - y[k]
        side = (ex * (py - y[k]) - ey * (px - x[k])) * math.copysign(1.0, area)
        within &= side >= 0
        far = np.minimum(far, np.abs(side) / max(math.hypot(ex, ey), 1e-30))
    return within, far


@given(corner, st.lists(corner, min_size=2, max_size=2), size, st.sampled_from([1, 2, 4, 8]))
def test_triangles_cover_the_places_that_they_hold(at, others, scale, subpixels):
    at = np.clip(at, 0.0, SIDE)
    x, y = np.array([at, *(at + scale / 60.0 * (np.array(o) - 25.0) for o in others)]).T
    target, entry = empty(subpixels), 7
    written = draw_triangle(target, np.int64(SIDE), np.int64(SIDE), x, y, np.ones(3), np.int64(entry))
    within, far = inside(x, y, *places(target))
    assert written == drawn(target, entry).any()
    sure = far > 1e-4
    assert np.array_equal(drawn(target, entry)[sure], within[sure])


@given(corner, st.lists(corner, min_size=2, max_size=2), size)
def test_triangles_with_holes_cover_the_same(at, others, scale):
    at = np.clip(at, 0.0, SIDE)
    x, y = np.array([at, *(at + scale / 60.0 * (np.array(o) - 25.0) for o in others)]).T
    target = empty()
    opaque = np.full((1, 4, 4), 255, np.uint8)
    draw_cut_out(target, np.int64(SIDE), np.int64(SIDE), x, y, np.ones(3), np.int64(3), opaque)
    within, far = inside(x, y, *places(target))
    sure = far > 1e-4
    assert np.array_equal(drawn(target, 3)[sure], within[sure])


@given(st.integers(0, 2**32 - 1), st.integers(3, 40), st.sampled_from([1, 8]))
def test_fans_of_triangles_cover_every_subpixel_once(seed, count, subpixels):
    """Whatever their corners, and where edges and corners pass through places."""
    rng = np.random.default_rng(seed)
    middle = rng.choice([SIDE / 2, 20.0625, rng.uniform(10, 38)], 2)
    turn = np.sort(rng.uniform(0.0, 2.0 * np.pi, count))
    turn[0], turn[count // 3], turn[2 * count // 3] = 0.0, 2.1, 4.2  # no gap of more than half a turn
    turn = np.sort(turn)
    rim = middle[:, None] + 200.0 * np.array([np.cos(turn), np.sin(turn)])
    target, times = empty(subpixels), np.zeros((SIDE, SIDE), int)
    for k in range(count):
        n = (k + 1) % count
        x, y = (np.array([m, r[k], r[n]]) for m, r in zip(middle, rim, strict=True))
        draw_triangle(target, np.int64(SIDE), np.int64(SIDE), x, y, np.full(3, 1.0 + k), np.int64(k))
        times += drawn(target, k)
    assert (times == 1).all()


@given(
    st.floats(-5.0, 53.0),
    st.floats(-5.0, 53.0),
    st.floats(0.05, 20.0),
    st.floats(0.05, 20.0),
    st.floats(0.0, 3.2),
)
def test_ellipses_cover_the_places_that_they_hold(x, y, long, short, angle):
    c, s = math.cos(angle), math.sin(angle)
    turned = np.array([[c, -s], [s, c]])
    matrix = turned @ np.diag([long**2, short**2]) @ turned.T
    target = empty()
    written = draw_ellipse(
        target, np.int64(SIDE), np.int64(SIDE), x, y, matrix[0, 0], matrix[0, 1], matrix[1, 1], np.int64(5)
    )
    px, py = places(target)
    d = np.stack([px - x, py - y], -1)
    level = np.einsum("...i,ij,...j", d, np.linalg.inv(matrix), d)
    assert written == drawn(target, 5).any()
    sure = np.abs(level - 1.0) > 1e-3 * max(long / short, short / long) ** 2
    assert np.array_equal(drawn(target, 5)[sure], (level <= 1.0)[sure])


@given(st.floats(0.0, 1.0), st.floats(0.02, 0.5))
def test_a_level_wire_thinner_than_a_subpixel_covers_what_it_covers(offset, thick):
    """Wherever it lies between the lines of subpixels: not eight of a pixel's at once, or none."""
    target, low = empty(), 16.0 + 8.0 * offset
    x, y = np.array([0.0, SIDE, SIDE, 0.0]), np.array([low, low, low + thick, low + thick])
    for k in range(2):
        corners = [0, 1, 2] if k == 0 else [0, 2, 3]
        draw_triangle(target, np.int64(SIDE), np.int64(SIDE), x[corners], y[corners], np.ones(3), np.int64(k))
    covered = (target.ids[:SIDE, :SIDE] >= 0).sum() / (SIDE * SIDE / 6)  # of a line of pixels
    assert covered == pytest.approx(thick / 8, abs=1.01 / 64)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.3, 2.0, 100.0]))
def test_triangles_look_into_no_subpixel_outside_the_tile(seed, size):
    """Also such as reach from beyond a side to between it and the outermost places: what is behind is not ours."""
    rng = np.random.default_rng(seed)
    width, height = 40, 24
    constants = np.zeros(surfel_lanes.CONSTANTS, np.float32)
    constants[[surfel_lanes.MATRIX + k for k in (0, 5, 10)]] = 1.0
    constants[[surfel_lanes.FOCAL_X, surfel_lanes.FOCAL_Y, surfel_lanes.DEPTH_SHIFT]] = 1.0
    constants[surfel_lanes.FAR] = 10.0
    constants[[surfel_lanes.WIDTH_OF_TILE, surfel_lanes.HEIGHT_OF_TILE]] = width, height
    sides = rng.choice([0.0, 0.5, 1.0], (8, 1, 2)) * (width, height)
    corners = np.ones((8, 3, 3), np.float32)
    corners[..., :2] = sides + rng.normal(0.0, 1.0, (8, 3, 2)) * size
    lanes = np.zeros((surfel_lanes.LANE_ROWS, 8), np.float32)
    mask = place_triangles(corners, constants, lanes)
    drawn = (mask >> np.arange(8)) & 1 == 1
    first, last, low, high = (
        lanes[row, drawn]
        for row in (surfel_lanes.LEFT, surfel_lanes.RIGHT, surfel_lanes.LOW, surfel_lanes.HIGH)
    )
    assert (first >= 0).all() and (first <= last).all() and (last < width).all()
    assert (low >= 0).all() and (low <= high).all() and (high < height).all()
