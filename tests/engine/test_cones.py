"""Cones' masks against exact rays and closed forms, through nested instances, far away, with bad input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from instanced import Flat, accelerate, nest, random_mesh, random_transforms

from pointmr_engine.hierarchy.prefilter import prefilter
from pointmr_engine.multires.cones.cone_space import Style
from pointmr_engine.multires.cones.cone_walk import COUNTERS, POINTS, visible
from pointmr_engine.multires.cones.cones import FULL, Cones, allocate_cones, axes_of, sub_rays
from pointmr_engine.raytracing import walk
from pointmr_engine.raytracing.rays import allocate_hits, allocate_rays
from pointmr_engine.scene.group import CAMERA, SHADOW, Group, Instances, instance
from pointmr_engine.scene.material import Material
from pointmr_engine.scene.mesh import Mesh

seeds = st.integers(0, 2**32 - 1)
EXACT = Style(small=0.0)


def some_cones(origin, direction, spread, start=0.0, **values) -> Cones:
    origin, direction = np.atleast_2d(origin).astype(float), np.atleast_2d(direction).astype(float)
    cones = allocate_cones(max(len(origin), len(direction)))
    cones.origin[:] = origin
    cones.axes[:] = axes_of(direction / np.linalg.norm(direction, axis=1, keepdims=True))
    cones.spread[:], cones.start[:] = spread, start
    for name, value in values.items():
        getattr(cones, name)[:] = value
    return cones


def blocked(acceleration, cones, style=Style(), counters=None, prefiltered=None):  # noqa: B008
    """(N, 64) bool."""
    masks = np.zeros(len(cones.origin), np.uint64)
    prefiltered = prefilter(acceleration) if prefiltered is None else prefiltered
    visible(acceleration, prefiltered, cones, masks, counters, style=style)
    return (masks[:, None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1) != 0


def exact(acceleration, cones, u=None, v=None):
    """(N, K) bool, by shadow rays."""
    origin, direction, stretch = sub_rays(cones, u, v)
    n, k = stretch.shape
    rays, hits = allocate_rays(n * k), allocate_hits(n * k)
    rays.origin[:], rays.direction[:] = origin.reshape(-1, 3), direction.reshape(-1, 3)
    rays.t_min[:] = (cones.t_min[:, None] * stretch).ravel()
    rays.t_max[:] = (cones.t_max[:, None] * stretch).ravel()
    rays.visibility[:] = np.repeat(cones.visibility, k)
    walk.shadow(acceleration, rays, hits)
    return (hits.triangle == walk.BLOCKED).reshape(n, k)


@settings(max_examples=25)
@given(
    seeds,
    st.integers(0, 3),
    st.sampled_from([(0.5, 2.0), (0.1, 0.2), (1e3, 1e4)]),
    st.sampled_from([0.0, 1e6]),
)
def test_large_triangles_give_the_masks_of_exact_rays(seed, depth, scale, offset):
    rng = np.random.default_rng(seed)
    leaf = Group("leaf", [random_mesh(rng, 15), random_mesh(rng, 1, 0.1, (0, 0, 2))])
    inner = nest(rng, depth, leaf, 3, scale=scale, spread=3.0)
    far = np.eye(4)
    far[:3, 3] = offset, -offset / 3, offset / 7
    geometry, acceleration = accelerate(Group("root", [], [instance(inner, far)]))
    n = 40
    corners = Flat(geometry).corners
    aimed = corners[rng.integers(0, len(corners), n)]
    aim, reach = aimed.mean(1), np.ptp(aimed, axis=1).max(1)[:, None]
    origin = aim + rng.normal(size=(n, 3)) * reach * rng.choice([1.0, 10.0], (n, 1))
    size = np.linalg.norm(aim - origin, axis=1)[:, None]
    cones = some_cones(
        origin, aim - origin, rng.choice([0.01, 0.1, 1.0], (n, 2)), size * rng.choice([0.0, 0.0, 0.1], (n, 2)),
        t_min=size[:, 0] * rng.choice([1e-5, 0.3], n), t_max=size[:, 0] * rng.choice([1.0, 10.0], n),
    )  # fmt: skip
    got, expected = blocked(acceleration, cones, EXACT), exact(acceleration, cones)
    assert expected.any()
    # sub-rays that graze an edge within rounding may fall to either side
    assert (got != expected).sum() <= 2e-4 * got.size + 1


def test_an_empty_scene_blocks_nothing():
    _, acceleration = accelerate(Group("nothing"))
    assert not blocked(acceleration, some_cones([0, 0, 0], [0, 0, 1], 0.5)).any()


def forest(rng, trees: int = 60) -> Group:
    """Instances, of instances too, of clumps of small leaves on stems."""
    angle = rng.uniform(0, 2 * np.pi, (1200, 1))
    center = rng.normal(size=(1200, 1, 3)) * [0.5, 0.5, 0.7] + [0, 0, 2.0]
    leaves = center + 0.03 * rng.normal(size=(1200, 3, 3))
    stem = np.array([[[-0.05, 0, 0], [0.05, 0, 0], [0, 0, 2.0]], [[0, -0.05, 0], [0, 0.05, 0], [0, 0, 2.0]]])
    corners = np.concatenate([leaves, stem]).reshape(-1, 3).astype(np.float32)
    tree = Group("tree", [Mesh("tree", corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))])
    placed = np.zeros((trees, 3, 4))
    angle = rng.uniform(0, 2 * np.pi, trees)
    placed[:, 0, 0], placed[:, 0, 1] = np.cos(angle), -np.sin(angle)
    placed[:, 1, 0], placed[:, 1, 1], placed[:, 2, 2] = np.sin(angle), np.cos(angle), 1.0
    placed[:, :, :3] *= rng.uniform(0.5, 1.5, (trees, 1, 1))
    placed[:, :2, 3] = rng.uniform(-8, 8, (trees, 2))
    half = len(placed) // 2
    grove = Group("grove", [], [Instances((tree,), placed[half:])])
    return Group("forest", [], [Instances((tree,), placed[:half]), instance(grove)])


@pytest.mark.parametrize(("spread", "most"), [(0.02, 0.01), (0.2, 0.02), (0.5, 0.02), (1.0, 0.03)])
def test_a_forest_is_as_dark_as_for_exact_rays(spread, most):
    """Of many cones: the mean of what is blocked within `most`, single cones nearly as near as by 64 exact rays."""
    rng = np.random.default_rng(3)
    _, acceleration = accelerate(forest(rng))
    n = 150
    origin = np.concatenate([rng.uniform(-6, 6, (n, 2)), np.full((n, 1), 0.01)], 1)
    direction = rng.normal(size=(n, 3)) * [0.5, 0.5, 0] + [0, 0, 1.0]
    cones = some_cones(origin, direction, spread, t_max=100.0)
    a = (np.arange(24) + 0.5) / 12 - 1
    true = exact(acceleration, cones, np.tile(a, 24), np.repeat(a, 24)).mean(1)
    counters = np.zeros(COUNTERS, np.int64)
    got = blocked(acceleration, cones, counters=counters).mean(1)
    by_rays = exact(acceleration, cones).mean(1)
    error, sampled = (np.sqrt(np.mean((x - true) ** 2)) for x in (got, by_rays))
    assert 0.05 < true.mean() < 0.95
    assert abs(got.mean() - true.mean()) < most
    assert error < 1.5 * sampled + 0.01
    assert spread < 0.1 or counters[POINTS] > 5 * n  # it was not done by triangles alone


def sheet(rows: int, columns: int, x, y, z: float = 0.0, **values) -> Mesh:
    """A rectangle of rows x columns x 2 triangles; x, y: its bounds."""
    u, v = np.meshgrid(np.linspace(*x, rows + 1), np.linspace(*y, columns + 1), indexing="ij")
    i = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    k = columns + 1
    triangles = np.concatenate([np.stack([i, i + 1, i + k], 1), np.stack([i + 1, i + k + 1, i + k], 1)])
    corners = np.stack([u, v, np.full_like(u, z)], -1).reshape(-1, 3)
    return Mesh("sheet", corners.astype(np.float32), triangles.astype(np.int32), **values)


HALF_PLANES = {"large": sheet(1, 1, (0, 40), (-40, 40)), "small": sheet(80, 160, (0, 4), (-4, 4))}


@settings(max_examples=20)
@given(st.floats(-1.2, 1.2), st.floats(0, 2 * np.pi), st.floats(0.5, 2.0), st.sampled_from(list(HALF_PLANES)))
def test_half_planes(offset, angle, ratio, kind):
    """The share of a cone before a half plane that is blocked; made of two triangles, or of many drawn as points."""
    spread = np.array([0.3, 0.3 * ratio])
    c, s = np.cos(angle), np.sin(angle)
    placed = np.array([[c, -s, 0, 0.6 * offset * c], [s, c, 0, 0.6 * offset * s], [0, 0, 1, 2.0]])
    _, acceleration = accelerate(Group("root", [], [instance(Group("half", [HALF_PLANES[kind]]), placed)]))
    cones = some_cones([0, 0, 0], [0, 0, 1], spread)
    cones.axes[:] = np.eye(3)
    a = (np.arange(256) + 0.5) / 128 - 1
    u, v = np.meshgrid(a, a)
    true = (u * c * spread[0] + v * s * spread[1] > 0.3 * offset).mean()
    assert blocked(acceleration, cones).mean() == pytest.approx(true, abs=1 / 14)
    # of cones turned anyhow the grid's own errors average out
    turns = some_cones(np.zeros((60, 3)), [0, 0, 1], 0.3)
    a = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    turns.axes[:, 0] = np.stack([np.cos(a), np.sin(a), 0 * a], 1)
    turns.axes[:, 1] = np.stack([-np.sin(a), np.cos(a), 0 * a], 1)
    expected = exact(acceleration, turns, u[::8, ::8].ravel(), v[::8, ::8].ravel()).mean()
    assert blocked(acceleration, turns).mean() == pytest.approx(expected, abs=1 / 64)


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.1])
def test_surfaces_do_not_leak(tilt):
    """A plane of triangles smaller than the cells, seen from any side, lets next to nothing through."""
    rng = np.random.default_rng(7)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    for turn in (np.eye(3), q):
        mesh = sheet(150, 150, (-1, 1), (-1, 1))
        mesh = Mesh("plane", (mesh.positions @ turn.T).astype(np.float32), mesh.triangles)
        _, acceleration = accelerate(Group("root", [mesh]))
        direction = np.array([0.6 * np.sin(tilt), 0.8 * np.sin(tilt), -np.cos(tilt)])
        aim = np.concatenate([rng.uniform(-0.5, 0.5, (100, 2)), np.zeros((100, 1))], 1)
        counters = np.zeros(COUNTERS, np.int64)
        cones = some_cones((aim - 3 * direction) @ turn.T, [turn @ direction], 0.04)
        assert blocked(acceleration, cones, counters=counters).mean() > 0.99
        assert counters[POINTS] > 20 * 100


def test_a_disk_and_a_cone_that_ends_on_it():
    a = np.arange(256) * (2 * np.pi / 256)
    rim = np.stack([np.cos(a), np.sin(a), 0 * a + 3.0], 1)
    corners = np.concatenate([[[0, 0, 3.0]], rim]).astype(np.float32)
    k = np.arange(256)
    triangles = np.stack([0 * k, 1 + k, 1 + (k + 1) % 256], 1).astype(np.int32)
    _, acceleration = accelerate(Group("root", [Mesh("disk", corners, triangles)]))
    share = blocked(acceleration, some_cones([0, 0, 0], [0, 0, 1], 0.5)).mean()
    assert share == pytest.approx(np.pi / 9, abs=1 / 32)
    for t_max, met in ((2.999, False), (3.001, True)):
        assert blocked(acceleration, some_cones([0, 0, 0], [0, 0, 1], 0.5, t_max=t_max)).any() == met
    for t_min, met in ((2.999, True), (3.001, False)):
        assert blocked(acceleration, some_cones([0, 0, 0], [0, 0, 1], 0.5, t_min=t_min)).any() == met


@pytest.mark.parametrize("style", [EXACT, Style()])
def test_cones_through_a_focus(style):
    """A cone that narrows to a point at t = 2 and widens again, sides exchanged, against its own sub-rays."""
    rng = np.random.default_rng(5)
    _, acceleration = accelerate(Group("root", [random_mesh(rng, 60, 1.0, (0, 0, 4.0))]))
    cones = some_cones(rng.normal(size=(50, 3)) * 0.3, [0, 0, 1], [-0.5, -0.25], [1.0, 1.0])
    got, expected = blocked(acceleration, cones, style), exact(acceleration, cones)
    assert 0.2 < expected.mean() < 0.9
    assert (got != expected).mean() < (1e-3 if style.small == 0.0 else 0.03)


def test_visibility_bits_hide_instances_at_all_sizes():
    rng = np.random.default_rng(2)
    leaf = Group("leaf", [random_mesh(rng, 3)])
    for size in (0.2, 0.02):
        m = random_transforms(rng, 200, (size, 1.5 * size), spread=0.7)
        m[:, 2, 3] += 5.0
        bits = np.where(np.arange(200) % 3 == 0, CAMERA, SHADOW).astype(np.uint8)
        _, acceleration = accelerate(Group("root", [], [Instances((leaf,), m, visibility=bits)]))
        kept = Instances((leaf,), m[bits == SHADOW])
        _, only = accelerate(Group("root", [], [kept]))
        cones = some_cones(np.zeros((20, 3)), rng.normal(size=(20, 3)) * [0.05, 0.05, 0] + [0, 0, 1], 0.3)
        shadows = cones._replace(visibility=np.full(20, SHADOW, np.uint8))
        np.testing.assert_array_equal(blocked(acceleration, shadows, EXACT), exact(acceleration, shadows))
        assert abs(blocked(acceleration, shadows).mean() - blocked(only, cones).mean()) < 0.02
        assert blocked(acceleration, cones).mean() > blocked(acceleration, shadows).mean()


def test_transparent_materials_block_their_share():
    clear = Material("clear")
    for cells, opacity in ((1, 0.4), (120, 0.4), (120, 0.9)):  # as triangles, and as points
        mesh = sheet(cells, cells, (-4, 4), (-4, 4), 3.0, materials=(clear,))
        geometry, acceleration = accelerate(Group("root", [mesh]))
        prefiltered = prefilter(acceleration, np.full(len(geometry.materials), opacity))
        cones = some_cones(np.random.default_rng(0).normal(size=(60, 3)) * [0.3, 0.3, 0], [0, 0, 1], 0.4)
        assert blocked(acceleration, cones, prefiltered=prefiltered).mean() == pytest.approx(
            opacity, abs=0.06
        )


def test_bad_cones_and_bad_triangles_block_nothing():
    p = np.array([[-1, 0, 1], [1, 0, 1], [0, 0, 1], [0, 1, 1], [np.nan, 0, 1]], np.float32)
    t = np.array([[0, 1, 2], [0, 1, 1], [0, 1, 4]], np.int32)
    _, acceleration = accelerate(Group("root", [Mesh("bad", p, t)]))
    assert not blocked(acceleration, some_cones([0, 0.01, 0], [0, 0, 1], 0.5)).any()
    _, acceleration = accelerate(Group("root", [Mesh("good", p, np.array([[0, 1, 3]], np.int32))]))
    for name, value in (("t_min", np.nan), ("start", np.inf), ("axes", np.nan), ("t_max", -1.0)):
        cones = some_cones([0, 0.3, 0], [0, 0, 1], 0.5)
        getattr(cones, name)[:] = value
        assert not blocked(acceleration, cones).any()
    assert blocked(acceleration, some_cones([0, 0.3, 0], [0, 0, 1], 0.5)).any()


def test_ranges_of_cones_are_independent():
    rng = np.random.default_rng(0)
    _, acceleration = accelerate(forest(rng, 10))
    cones = some_cones(rng.uniform(-5, 5, (40, 3)), [0, 0, 1], 0.5)
    masks, prefiltered = np.full(40, FULL), prefilter(acceleration)
    visible(acceleration, prefiltered, cones, masks, None, 10, 20)
    assert (masks[:10] == FULL).all() and (masks[20:] == FULL).all()
    whole = np.zeros(40, np.uint64)
    visible(acceleration, prefiltered, cones, whole)
    np.testing.assert_array_equal(masks[10:20], whole[10:20])
