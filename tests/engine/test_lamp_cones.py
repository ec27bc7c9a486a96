"""Lamps' cones: which sub-rays stand for which part of a lamp, and how much light each."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pointmr_engine import Light
from pointmr_engine.multires.cones.cones import allocate_cones
from pointmr_engine.multires.cones.lamp_cones import (
    ACROSS,
    ALL,
    BUMPS,
    NOTHING,
    TERMS,
    lamp_cones,
    take_shares,
)
from pointmr_engine.raytracing.compile_lamps import compile_lamps
from pointmr_engine.raytracing.lamps import intersect_lamp

KINDS = {
    "square": {"kind": "AREA", "shape": "SQUARE", "size_x": 1.0},
    "rectangle": {"kind": "AREA", "shape": "RECTANGLE", "size_x": 2.0, "size_y": 0.3},
    "disk": {"kind": "AREA", "shape": "DISK", "size_x": 1.0},
    "ellipse": {"kind": "AREA", "shape": "ELLIPSE", "size_x": 0.4, "size_y": 1.5},
    "sphere": {"kind": "POINT", "radius": 0.5},
    "facing disc": {"kind": "POINT", "radius": 0.5, "soft_falloff": True},
    "sun": {"kind": "SUN", "angle": 0.6},
}


def lamp_of(name: str, place: np.ndarray | None = None):
    """The compiled lamp at `place` (4, 4), by default two metres up, where it shines down."""
    if place is None:
        place = np.eye(4)
        place[2, 3] = 2.0
    values = dict(KINDS[name])
    return compile_lamps([Light(values.pop("kind"), place, power=1.0, **values)])[0]


def cones_from(lamps, points: np.ndarray, normal, behind: int = NOTHING):
    """(count, cones, terms, rows) of points (N, 3) whose normal is the same; each is a footprint of its own."""
    n = len(points)
    cones, terms, rows = allocate_cones(2 * n), np.empty((2 * n, TERMS)), np.empty(2 * n, np.int32)
    start = np.asarray(points, float)
    count = lamp_cones(
        lamps, np.int64(0), start, start, np.tile(np.float32(normal), (n, 1)),
        np.full(n, behind, np.uint8), np.full(n, 1e-6, np.float32), np.zeros(n), np.ones(n, np.int32), np.int64(n),
        cones, rows, terms,
    )  # fmt: skip
    return count, cones, terms, rows


def shares_of(lamps, masks: np.ndarray, cones, terms, rows, behind: int = NOTHING) -> np.ndarray:
    """(N,) shares that masks (N, 64) bool of blocked sub-rays leave."""
    n = len(masks)
    bits = (masks.astype(np.uint64) << np.arange(64, dtype=np.uint64)).sum(1, dtype=np.uint64)
    share = np.full(int(rows[:n].max()) + 1, 7.0, np.float32)
    behind = np.full(len(share), behind, np.uint8)
    beneath = share.copy()
    take_shares(bits, lamps, np.int64(0), cones, terms, behind, rows, np.int64(n), share, beneath)
    return share[rows[:n]].astype(float)


def directions(cones, m: int) -> np.ndarray:
    """(64, 3) of a cone's sub-rays, by the inverse of its axes: what the walk's coordinates mean in the world."""
    x, y, d = np.linalg.inv(cones.axes[m]).T
    a = (np.arange(8) + 0.5) / 4 - 1
    u, v = np.tile(a, 8)[:, None], np.repeat(a, 8)[:, None]
    return d + u * cones.spread[m, 0] * x + v * cones.spread[m, 1] * y


def turned(seed: int) -> np.ndarray:
    """A 4x4 that turns anyhow, about two metres up."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    m = np.eye(4)
    m[:3, :3] = q * np.sign(np.diag(r))
    m[:3, 3] = 0.3, -0.2, 2.0
    return m


@settings(max_examples=60)
@given(st.sampled_from(list(KINDS)), st.integers(0, 10**6), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_a_sub_ray_counts_by_the_irradiance_of_the_part_of_the_lamp_that_it_meets(name, seed, x, y):
    """Judged by the walk for rays, and by cos cos / r^2 on flat lamps, by their solid angle on others."""
    lamps, point, up = lamp_of(name, turned(seed)), np.array([x, y, 0.0]), np.array([0.0, 0.0, 1.0])
    count, cones, terms, rows = cones_from(lamps, point[None], up)
    assume(count == 1)
    w = directions(cones, 0)
    flat = "size_x" in KINDS[name]
    met, expected = np.zeros(64), np.zeros(64)
    for b in range(64):
        d = w[b] / np.linalg.norm(w[b])
        t = intersect_lamp(lamps, np.int64(0), *point, *d)
        met[b] = t > 0.0
        cosine = max(d @ up, 0.0)
        expected[b] = (
            met[b] * cosine / (t**2 / abs(d @ lamps.values[0, 9:12]) if flat else np.sum(w[b] ** 2) ** 1.5)
        )
    assume(expected.sum() > 0.0)
    alone = ~np.eye(64, dtype=bool)
    share = np.array([shares_of(lamps, alone[b : b + 1], cones, terms, rows)[0] for b in range(64)])
    edge = np.abs(share - expected / expected.sum()) > 1e-3 * share.max()
    assert edge.sum() <= 2  # rounding decides at the very rim
    if edge.sum() == 0:
        np.testing.assert_allclose(share, expected / expected.sum(), atol=1e-5)
    if "shape" in KINDS[name] and KINDS[name]["shape"] in ("SQUARE", "RECTANGLE"):
        assert met.sum() == ACROSS**2


@pytest.mark.parametrize("name", list(KINDS))
def test_open_and_blocked_lamps(name):
    lamps = lamp_of(name)
    count, cones, terms, rows = cones_from(lamps, np.array([[0.3, 0.1, 0.0], [0.2, 0.0, 0.0]]), (0, 0, 1))
    assert count == 2
    assert shares_of(lamps, np.zeros((2, 64), bool), cones, terms, rows).tolist() == [1.0, 1.0]
    assert shares_of(lamps, np.ones((2, 64), bool), cones, terms, rows).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("name", list(KINDS))
def test_a_half_plane_over_the_middle_leaves_a_half_in_the_mean(name):
    """Cells lie elsewhere from point to point, so that what they leave has no bias; and each point is near it."""
    lamps = lamp_of(name)
    points = np.random.default_rng(5).uniform(-1e-3, 1e-3, (512, 3)) * [1, 1, 0]
    count, cones, terms, rows = cones_from(lamps, points, (0, 0, 1))
    masks = np.stack([directions(cones, m)[:, 0] > 0.0 for m in range(count)])
    share = shares_of(lamps, masks, cones, terms, rows)
    assert abs(share.mean() - 0.5) < 0.006
    assert np.abs(share - 0.5).max() < 0.13  # half of seven cells, of the lamp's width


@pytest.mark.parametrize("behind", [ALL, BUMPS])
def test_surfaces_that_face_away_take_no_cone_unless_light_passes_them_or_bumps_may_face_it(behind):
    lamps = lamp_of("square")
    points = np.array([[0.0, 0.0, 0.0]])
    assert cones_from(lamps, points, (0, 0, -1))[0] == 0
    count, cones, terms, rows = cones_from(lamps, points, (0, 0, -1), behind)
    assert count == 1
    some = np.zeros((1, 64), bool)
    some[0, :32] = True
    assert 0.3 < shares_of(lamps, some, cones, terms, rows, behind)[0] < 0.7


@pytest.mark.parametrize("name", ["square", "disk"])
def test_lamps_seen_from_behind_or_edge_on_take_no_cone(name):
    lamps = lamp_of(name)
    for z in (2.0, 2.5):
        assert cones_from(lamps, np.array([[3.0, 0.0, z]]), (0, 0, 1), ALL)[0] == 0
