"""Static sampling: exact pieces, four strategies that keep their covering radius, and moments that lose nothing."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine.hierarchy.coverage import fill_uncovered, verified_radius
from pointmr_engine.hierarchy.moments import merge_moments
from pointmr_engine.hierarchy.nearest import build_tree, nearest_each
from pointmr_engine.hierarchy.pieces import cut
from pointmr_engine.hierarchy.strategies import STRATEGIES, neighbourhood, random_points, select
from pointmr_engine.hierarchy.surface_samples import sample_triangles
from pointmr_engine.scene.errors import SceneError

SURE = [s for s in STRATEGIES if s != "random"]
seeds = st.integers(0, 2**32 - 1)


def soup(seed: int, count: int = 6) -> np.ndarray:
    """(count, 3, 3) triangles of very different sizes and shapes, slivers and specks among them."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 3, 3)) * 10.0 ** rng.uniform(-2.5, 0.0, (count, 1, 1))
    corners[0, 2] = 0.5 * (corners[0, 0] + corners[0, 1]) + 1e-4 * rng.normal(size=3)
    return corners + rng.normal(size=(count, 1, 3))


def plane(seed: int) -> np.ndarray:
    """The unit square, turned at random."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float) @ turn
    return corners[[[0, 1, 2], [0, 2, 3]]]


def torus(rings: int = 40) -> np.ndarray:
    """A closed surface without edges or corners: (2 rings^2, 3, 3)."""
    a = np.arange(rings) * 2 * np.pi / rings
    a, b = np.meshgrid(a, a, indexing="ij")
    p = np.stack([(1 + 0.4 * np.cos(b)) * np.cos(a), (1 + 0.4 * np.cos(b)) * np.sin(a), 0.4 * np.sin(b)], -1)
    q, r, s = np.roll(p, -1, 0), np.roll(p, (-1, -1), (0, 1)), np.roll(p, -1, 1)
    return np.concatenate(
        [np.stack([p, q, r], 2).reshape(-1, 3, 3), np.stack([p, r, s], 2).reshape(-1, 3, 3)]
    )


def dense_points(triangles: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Random points of each triangle, and its corners and edges."""
    b = np.random.default_rng(seed).dirichlet((0.7, 0.7, 0.7), (len(triangles), count))
    b[:, :30] = np.concatenate([np.eye(3), [[k / 9, 1 - k / 9, 0] for k in range(9)]] * 3)[:30]
    return np.einsum("tcb,tbk->tck", b, triangles).reshape(-1, 3)


def distances(points: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Distance of each point to the nearest sample, by brute force."""
    out = np.full(len(points), np.inf)
    for s in samples.astype(np.float64):
        np.minimum(out, np.linalg.norm(points - s, axis=1), out=out)
    return out


def matrix(covariance: np.ndarray) -> np.ndarray:
    """(N, 6) to (N, 3, 3)."""
    return covariance[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3).astype(np.float64)


def total(area, centroid, covariance) -> tuple[float, np.ndarray, np.ndarray]:
    """Area, centroid and covariance of everything together."""
    area, centroid = area.astype(np.float64), centroid.astype(np.float64)
    mean = area @ centroid / area.sum()
    d = centroid - mean
    second = np.einsum("n,nij->ij", area, matrix(covariance) + d[:, :, None] * d[:, None, :])
    return area.sum(), mean, second / area.sum()


def surface(triangles: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """The same of whole triangles, straight from their corners."""
    mean = triangles.mean(axis=1)
    d = triangles - mean[:, None]
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    c = np.einsum("tvi,tvj->tij", d, d) / 12
    return total(np.linalg.norm(cross, axis=1) / 2, mean, c.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]])


def assert_same(ours, exact, scale):
    assert ours[0] == pytest.approx(exact[0], rel=2e-6)
    np.testing.assert_allclose(ours[1], exact[1], atol=2e-6 * scale)
    np.testing.assert_allclose(ours[2], exact[2], atol=5e-6 * scale**2)


# pieces


@settings(max_examples=40)
@given(seeds, st.floats(0.05, 3.0))
def test_pieces_sum_to_their_triangles_and_are_small(seed, size):
    triangles = soup(seed)
    pieces = cut(triangles, size)
    assert_same(total(pieces.area, pieces.position, pieces.covariance), surface(triangles), 10.0)
    corner = triangles[pieces.triangle]
    at = np.einsum(
        "cb,cbk->ck", np.stack([1 - pieces.u - pieces.v, pieces.u, pieces.v], 1).astype(float), corner
    )
    np.testing.assert_allclose(at, pieces.position, atol=1e-5)
    # a triangle's centroid is nowhere farther from a corner
    assert pieces.radius.max() <= size * 2 / 3 + 1e-6
    # the variance about the middle is at most a quarter of a triangle's radius squared, a third of a rectangle's
    longest = np.linalg.norm(triangles - np.roll(triangles, 1, 1), axis=2).max(1)
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    height = np.linalg.norm(across, axis=1) / longest
    compact = longest < 3.99 * height
    most = np.where(compact[pieces.triangle], 0.25, 1 / 3) * pieces.radius**2
    assert (np.trace(matrix(pieces.covariance), axis1=1, axis2=2) <= most * 1.001 + 1e-12).all()


def test_a_triangle_is_divided_no_further_than_needed():
    equilateral = np.array([[[0, 0, 0], [1, 0, 0], [0.5, math.sqrt(0.75), 0]]])
    assert [len(cut(equilateral, s).area) for s in (1.001, 0.999, 0.5001, 0.25001, 0.1)] == [1, 4, 4, 16, 100]
    # slivers are cut across alone, wherever their height stands: regular divisions make 3969
    for foot in (-0.3, 0.0, 0.01, 0.5, 1.0):
        sliver = np.array([[[0, 0, 0], [1, 0, 0], [foot, 1e-3, 0]]])
        assert len(cut(sliver, 1 / 63).area) <= 70 * (1.0 + max(0.0, -foot))
    wide = np.array([[[0, 0, 0], [1, 0, 0], [0, 0.05, 0]]])
    assert len(cut(wide, 0.01).area) <= 1600  # right-angled ones of that length would be 1000


@settings(max_examples=60)
@given(st.floats(-0.5, 1.5), st.floats(-7, -0.3), st.floats(-2.5, 0.3), seeds)
def test_pieces_of_slivers_sum_to_them(foot, height, size, seed):
    rng = np.random.default_rng(seed)
    sliver = np.array([[0, 0, 0], [1, 0, 0], [foot, 10.0**height, 0]])[rng.permutation(3)]
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    triangle = (sliver @ turn)[None]
    pieces = cut(triangle, 10.0**size)
    assert_same(total(pieces.area, pieces.position, pieces.covariance), surface(triangle), 1.0)
    at = np.stack([1 - pieces.u - pieces.v, pieces.u, pieces.v], 1).astype(float) @ triangle[0]
    np.testing.assert_allclose(at, pieces.position, atol=1e-6)
    assert pieces.radius.max() <= 10.0**size * (2 / 3 + 1e-6)


def test_covariance_of_one_piece_is_that_of_its_points():
    triangle = np.array([[[0.3, 1.0, -2.0], [4.0, 2.0, 1.0], [1.0, -3.0, 0.5]]])
    piece = cut(triangle, 100.0)
    b = np.random.default_rng(0).dirichlet((1, 1, 1), 400_000)
    points = b @ triangle[0]
    np.testing.assert_allclose(matrix(piece.covariance)[0], np.cov(points.T), atol=0.02)
    assert piece.radius[0] == pytest.approx(np.linalg.norm(triangle[0] - triangle[0].mean(0), axis=1).max())


def test_what_has_no_area_has_no_piece_and_no_sample():
    line = [[0, 0, 0], [1, 1, 1], [2, 2, 2]]
    point = [[1, 2, 3]] * 3
    broken = [[0, 0, 0], [1, 0, np.nan], [0, 1, 0]]
    endless = [[0, 0, 0], [np.inf, 0, 0], [0, 1, 0]]
    good = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    bad = np.array([line, point, broken, endless])
    assert len(cut(bad, 0.1).area) == 0
    assert set(cut(np.array([*bad, good]), 0.1).triangle) == {4}
    for strategy in STRATEGIES:
        for nothing in (bad, np.empty((0, 3, 3))):
            assert len(sample_triangles(nothing, 0.2, strategy).area) == 0
        samples = sample_triangles(np.array([*bad, good]), 0.2, strategy)
        assert set(samples.triangle) == {4}
        assert samples.area.sum() == pytest.approx(0.5, rel=1e-6)
        assert all(np.isfinite(x).all() for x in samples)
    assert verified_radius(bad[:2], np.zeros((1, 3))) == 0.0


# strategies


@settings(max_examples=25)
@given(seeds, st.floats(0.1, 5.0), st.sampled_from(SURE))
def test_every_point_of_a_surface_is_within_the_covering_radius(seed, spacing, strategy):
    triangles = soup(seed)
    samples = sample_triangles(triangles, spacing, strategy, seed)
    assert distances(dense_points(triangles, 300, seed), samples.position).max() <= spacing * (1 + 1e-6)


@settings(max_examples=25)
@given(seeds, st.floats(0.1, 5.0), st.sampled_from(STRATEGIES))
def test_moments_of_samples_sum_to_those_of_the_surface(seed, spacing, strategy):
    triangles = soup(seed)
    samples = sample_triangles(triangles, spacing, strategy, seed)
    assert_same(total(samples.area, samples.centroid, samples.covariance), surface(triangles), 10.0)
    # what a sample owns lies around it
    own = samples.area > 0
    if strategy != "random":
        away = np.linalg.norm(samples.centroid - samples.position, axis=1)[own]
        assert away.max() <= spacing * 1.001
    if strategy != "quantised_grid":
        corner = triangles[samples.triangle]
        b = np.stack([1 - samples.u - samples.v, samples.u, samples.v], 1).astype(float)
        np.testing.assert_allclose(np.einsum("cb,cbk->ck", b, corner), samples.position, atol=1e-5)


@settings(max_examples=25)
@given(seeds, st.integers(1, 400), st.floats(0.01, 10.0), st.sampled_from(STRATEGIES))
def test_selection_covers_its_candidates(seed, count, spacing, strategy):
    rng = np.random.default_rng(seed)
    position = rng.normal(size=(count, 3)).astype(np.float32) + np.float32(100.0)
    position[: count // 3] = position[0]  # the same place many times
    chosen = select(strategy, position, rng.uniform(0.1, 2, count).astype(np.float32), spacing, seed)
    own = np.linalg.norm(position.astype(float) - chosen.position[chosen.owner], axis=1)
    nearest = distances(position.astype(float), chosen.position)
    if strategy != "random":
        assert own.max() <= spacing * (1 + 1e-6) + 2e-5  # cell centres are rounded
    if strategy in ("random", "neighbourhood"):
        np.testing.assert_allclose(own, nearest, atol=1e-6)
    if strategy != "quantised_grid":
        np.testing.assert_array_equal(chosen.position, position[chosen.representative])
        assert len(np.unique(chosen.representative)) == len(chosen.representative)
    if strategy == "neighbourhood" and len(chosen.position) > 1:
        tree = [
            np.linalg.norm(np.delete(chosen.position, k, 0) - p, axis=1).min()
            for k, p in enumerate(chosen.position)
        ]
        assert min(tree) > spacing * (1 - 1e-5)


@pytest.mark.parametrize(("patches", "failure"), [(20, 0.2), (300, 0.05)])
def test_random_points_leave_a_patch_empty_as_often_as_asked(patches, failure):
    area = np.ones(patches, np.float32)
    number = random_points.count(float(patches), 1.0, failure)
    runs = 3000
    empty = sum(len(np.unique(random_points.draw(area, number, seed))) < patches for seed in range(runs))
    deviation = math.sqrt(failure * (1 - failure) / runs)
    assert failure * 0.6 < empty / runs < failure + 3 * deviation


def test_random_points_leave_holes_no_more_often_than_asked():
    triangles = torus(24)
    pieces = cut(triangles, 0.2)
    failure, runs = 0.3, 60
    holes = 0
    for seed in range(runs):
        chosen = select("random", pieces.position, pieces.area, 0.8, seed, failure)
        holes += np.linalg.norm(pieces.position - chosen.position[chosen.owner], axis=1).max() > 0.8
    assert holes <= failure * runs


def test_random_points_are_drawn_by_area():
    area = np.array([1, 0, 2, 5], np.float32)
    counts = np.bincount(random_points.draw(area, 80_000, 3), minlength=4)
    np.testing.assert_allclose(counts / 10_000, area, atol=0.15)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_same_seed_same_samples_another_seed_others(strategy):
    triangles = torus(12)
    first, again, other = (sample_triangles(triangles, 0.3, strategy, seed) for seed in (7, 7, 8))
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert len(first.area) != len(other.area) or (first.position != other.position).any()
    assert len(sample_triangles(triangles, 0.3, strategy, -1).area) > 0


def test_oversampling_on_planes_is_that_of_the_theory():
    spacing = 0.04
    edge = 1 + spacing  # samples of the edge reach beyond it
    o = {s: [] for s in STRATEGIES}
    for seed in range(4):
        triangles = plane(seed)
        pieces = cut(triangles, spacing / 5)
        for strategy in STRATEGIES:
            chosen = select(strategy, pieces.position, pieces.area, spacing, seed)
            o[strategy].append(len(chosen.position) * math.pi * spacing**2)
    assert max(o["jittered_grid"]) < 9 * math.pi * edge**2 and min(o["jittered_grid"]) > 9.0
    assert max(o["quantised_grid"]) < 9 * math.pi / 4 * edge**2 and min(o["quantised_grid"]) > 2.2
    assert max(o["neighbourhood"]) < 2 * math.pi / math.sqrt(3) * edge**2
    a = spacing**-2
    assert max(o["random"]) <= math.pi * (math.log(a) + math.log(1e3)) + 0.1


def test_neighbourhood_covers_planes_with_few_samples():
    swept, random_order, spacing = [], [], 0.03
    for seed in range(4):
        triangles = plane(seed)
        samples = sample_triangles(triangles, spacing, "neighbourhood", seed)
        radius = verified_radius(triangles, samples.position)
        assert radius <= spacing * 1.0011
        swept.append(len(samples.area) * math.pi * radius**2)
        pieces = cut(triangles, spacing / 4)
        chosen = neighbourhood.select(pieces.position, pieces.area, spacing, seed, "random").position
        extra = fill_uncovered(triangles, chosen, spacing)
        random_order.append((len(chosen) + len(extra.u)) * math.pi * spacing**2)
    assert np.mean(swept) < 2.05
    assert 2.15 < np.mean(random_order) < 2.4
    assert np.mean(swept) < 0.9 * np.mean(random_order)


# coverage


@settings(max_examples=25)
@given(seeds, st.integers(1, 60))
def test_verified_radius_is_a_tight_upper_bound(seed, count):
    triangles = soup(seed, 3)
    samples = np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)
    radius = verified_radius(triangles, samples, 1e-3)
    seen = distances(dense_points(triangles, 4000, seed), samples).max()
    assert seen <= radius * (1 + 1e-9)
    assert radius <= 1.03 * seen  # random points miss the farthest one by little


def test_verified_radius_of_known_cases():
    square = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]], float)
    assert verified_radius(square, [[0.5, 0.5, 0]], 1e-4) == pytest.approx(math.sqrt(0.5), rel=2e-4)
    assert verified_radius(square, [[0.5, 0.5, 3.0]], 1e-4) == pytest.approx(math.sqrt(9.5), rel=2e-4)
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    assert verified_radius(square, corners, 1e-4) == pytest.approx(math.sqrt(0.5), rel=2e-4)
    assert verified_radius(square, np.empty((0, 3))) == math.inf
    assert verified_radius(np.empty((0, 3, 3)), corners) == 0.0


def test_fill_covers_a_surface_without_any_samples_and_adds_nothing_to_a_covered_one():
    triangles = torus(16)
    extra = fill_uncovered(triangles, np.empty((0, 3)), 0.3)
    assert verified_radius(triangles, extra.position) <= 0.3 * 1.0011
    assert len(fill_uncovered(triangles, extra.position, 0.3).u) == 0
    hole = np.delete(extra.position, 5, 0)
    again = fill_uncovered(triangles, hole, 0.3)
    assert 1 <= len(again.u) <= 5
    assert (np.linalg.norm(again.position - extra.position[5], axis=1) < 0.6).all()


def test_nearest_points_are_those_of_brute_force():
    rng = np.random.default_rng(2)
    for count in (1, 7, 8, 9, 100, 1000):
        points = rng.normal(size=(count, 3)).astype(np.float32)
        points[: count // 2] = np.round(points[: count // 2])  # many the same, many in a plane
        queries = rng.normal(size=(300, 3)).astype(np.float32)
        owner, distance2 = np.empty(300, np.int32), np.empty(300)
        nearest_each(build_tree(points), queries, owner, distance2)
        exact = ((queries[:, None].astype(float) - points[None]) ** 2).sum(-1)
        np.testing.assert_allclose(distance2, exact.min(1), rtol=1e-12)
        np.testing.assert_allclose(exact[np.arange(300), owner], exact.min(1), rtol=1e-12)


# moments


def test_moments_merge_by_the_parallel_axis_rule_far_from_the_origin():
    rng = np.random.default_rng(4)
    triangles = soup(1, 50) + 1000.0
    pieces = cut(triangles, 0.5)
    fine = merge_moments(
        rng.integers(0, 40, len(pieces.area)).astype(np.int32),
        40,
        pieces.area,
        pieces.position,
        pieces.covariance,
    )
    coarse = merge_moments(
        (np.arange(40) // 8).astype(np.int32), 5, fine.area, fine.centroid, fine.covariance
    )
    one = merge_moments(np.zeros(5, np.int32), 1, *coarse)
    exact = surface(triangles)
    assert one.area[0] == pytest.approx(exact[0], rel=2e-6)
    np.testing.assert_allclose(one.centroid[0], exact[1], rtol=1e-6)
    np.testing.assert_allclose(matrix(one.covariance)[0], exact[2], atol=2e-3)


def test_moments_of_nothing_are_zero_and_negative_owners_are_dropped():
    pieces = cut(soup(3), 0.5)
    owner = np.full(len(pieces.area), 2, np.int32)
    owner[::2] = -1
    merged = merge_moments(owner, 4, pieces.area, pieces.position, pieces.covariance)
    assert merged.area[2] == pytest.approx(pieces.area[1::2].sum(), rel=1e-6)
    for k in (0, 1, 3):
        assert merged.area[k] == 0 and not merged.centroid[k].any() and not merged.covariance[k].any()


# what cannot be worked with


def test_bad_input_is_named():
    triangles = plane(0)
    position, area = np.zeros((3, 3), np.float32), np.ones(3, np.float32)
    for spacing in (0.0, -1.0, math.nan, math.inf):
        for strategy in STRATEGIES:
            with pytest.raises(SceneError, match="spacing"):
                select(strategy, position, area, spacing, 0)
        with pytest.raises(SceneError, match="spacing"):
            sample_triangles(triangles, spacing)
        with pytest.raises(SceneError, match="size"):
            cut(triangles, spacing)
    with pytest.raises(SceneError, match="'poisson'.*neighbourhood"):
        select("poisson", position, area, 1.0, 0)
    with pytest.raises(SceneError, match="too many pieces"):
        cut(triangles, 1e-9)
    with pytest.raises(SceneError, match="too many pieces"):
        cut(triangles, 1e-5)
    with pytest.raises(SceneError, match="corners"):
        cut(np.zeros((3, 3)), 1.0)
    with pytest.raises(SceneError, match="areas"):
        select("neighbourhood", position, area[:2], 1.0, 0)
    with pytest.raises(SceneError, match="finite"):
        select("neighbourhood", position + np.float32(np.nan), area, 1.0, 0)
    with pytest.raises(SceneError, match="too fine"):
        select("jittered_grid", np.array([[0, 0, 0], [1, 1, 1]]), area[:2], 1e-7, 0)
    with pytest.raises(SceneError, match="too fine"):
        sample_triangles(triangles + 1e7, 0.3)
    with pytest.raises(SceneError, match="finite"):
        verified_radius(triangles, [[0, 0, np.nan]])
