"""Dynamic sampling: distribution lists, the dynamic octree, and points drawn from them for an image."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from instanced import nest, random_mesh, random_transforms

from pointmr_engine.hierarchy.distribution import build_distribution, draw_points
from pointmr_engine.hierarchy.dynamic_octree import DynamicOctree
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.hierarchy.nesting import area_scale
from pointmr_engine.hierarchy.octree import build_octree
from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.group import Group, Instances
from pointmr_engine.scene.scene import Scene


def compiled(root):
    geometry = compile_geometry(Scene(root))
    octree = build_octree(geometry)
    return geometry, octree, build_distribution(octree)


def placed_areas(geometry, group, world=None, record=-1):
    """{(part, triangle, innermost record): true area in the root's space}, the slow way."""
    world = np.eye(3) if world is None else world
    areas = {}
    for part in geometry.group_parts[group]:
        mesh = geometry.parts[part]
        p = np.asarray(mesh.positions, float)[mesh.triangles] @ world.T
        area = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
        for t, a in enumerate(area):
            areas[part, t, record] = areas.get((part, t, record), 0.0) + a
    for b in geometry.group_batches[group]:
        batch = geometry.batches[b]
        for i, m in enumerate(batch.transforms):
            child = batch.groups[0 if batch.group_index is None else batch.group_index[i]]
            index = next(k for k, g in enumerate(geometry.groups) if g is child)
            inner = placed_areas(
                geometry, index, world @ m[:, :3], int(geometry.instances.first_record[b] + i)
            )
            for key, a in inner.items():
                areas[key] = areas.get(key, 0.0) + a
    return areas


def assert_follows(counts: np.ndarray, expected: np.ndarray, sigmas: float = 5.0):
    """Pearson's chi-square of counts against expected shares; bins of few are merged."""
    order = np.argsort(expected)
    counts, expected = counts[order], expected[order] / expected.sum() * counts.sum()
    bins = np.floor(np.cumsum(expected) / max(20.0, expected.max())).astype(int)
    c, e = np.bincount(bins, counts), np.bincount(bins, expected)
    c, e = c[e > 5], e[e > 5]
    chi = ((c - e) ** 2 / e).sum()
    n = len(e) - 1
    assert n > 3
    assert abs(chi - n) < sigmas * np.sqrt(2 * n), (chi, n)


def scenes(rng):
    flat = Group("flat", [random_mesh(rng, 60), random_mesh(rng, 40, 0.3, (4, 0, 0))])
    yield flat
    yield nest(rng, 2, flat, n=3)  # transforms that stretch unevenly
    rigid = random_transforms(rng, 5)
    q, _ = np.linalg.qr(rigid[:, :, :3])
    rigid[:, :, :3] = q * np.array([1, 2, 0.5, 1, 3])[:, None, None]
    small = Group("small", [random_mesh(rng, 7)])
    yield Group(
        "mixed",
        [random_mesh(rng, 30)],
        [Instances((flat, small), rigid, np.array([0, 1, 1, 0, 1], np.int32))],
    )


@pytest.mark.parametrize("presorted", [True, False])
@pytest.mark.parametrize("number", range(3))
def test_draws_are_uniform_in_true_area(number, presorted):
    root = list(scenes(np.random.default_rng(number)))[number]
    geometry, octree, distribution = compiled(root)
    g = len(geometry.groups) - 1
    areas = placed_areas(geometry, g)
    index = {key: k for k, key in enumerate(areas)}
    part, triangle, record, weights = draw_points(
        octree, distribution, int(octree.arrays.group_root[g]), g, 60_000, 5, presorted
    )
    assert len(part) > 15_000
    counts = np.bincount(
        [index[key] for key in zip(part.tolist(), triangle.tolist(), record.tolist(), strict=True)],
        minlength=len(index),
    )
    assert_follows(counts, np.array(list(areas.values())))
    # within triangles: each corner's weight of a uniform point has mean 1/3 and the density 2 (1 - w)
    w = np.stack([weights[:, 0], weights[:, 1], 1 - weights.sum(1)])
    assert w.min() >= 0
    for row in w:
        share = np.histogram(1 - (1 - row) ** 2, 20, (0, 1))[0]
        assert_follows(share.astype(float), np.full(20, 1.0))


def test_draws_below_a_node_stay_below_it():
    rng = np.random.default_rng(4)
    geometry, octree, distribution = compiled(Group("g", [random_mesh(rng, 400)]))
    a = octree.arrays
    for node in range(0, len(a.box), 7):
        items = a.item[a.items[node, 0] : a.items[node, 3]]
        _, triangle, _, _ = draw_points(octree, distribution, node, 0, 300, node)
        assert set(triangle) <= set(items[:, 1].tolist())
        p = geometry.shapes[0].positions[geometry.shapes[0].triangles[items[:, 1]]].astype(float)
        area = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
        low, high = a.items[node, 0] + distribution.shift[0], a.items[node, 3] + distribution.shift[0]
        assert distribution.sums[high] - distribution.sums[low] == pytest.approx(area.sum())
        assert distribution.largest[node] == pytest.approx(area.max())


def test_area_scale_is_the_product_of_the_two_largest_singular_values():
    rng = np.random.default_rng(0)
    for k in range(300):
        m = rng.normal(size=(3, 4)) * 10.0 ** rng.integers(-6, 6)
        if k % 3 == 0:
            m[:, :3] = np.linalg.qr(m[:, :3])[0] * abs(m[0, 3])
        s = np.linalg.svd(m[:, :3])[1]
        bound, even = area_scale(m.ravel(), np.int64(0))
        assert bound == pytest.approx(s[0] * s[1], rel=1e-6)
        assert bound >= s[0] * s[1] * (1 - 1e-9)
        assert even == (k % 3 == 0)


def random_items(rng, n: int):
    centers = rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-3, 4, (n, 1))
    if n > 20:
        centers[: n // 4] = centers[0]  # many in one place
    half = rng.random((n, 3)) * 10.0 ** rng.integers(-6, 2, (n, 1))
    if n > 20:
        half[: n // 4] = half[0]
    rows = np.column_stack([np.arange(n), rng.integers(0, 9, n)])
    return rows, rng.random(n) + 1e-3, np.concatenate([centers - half, centers + half], 1)


def assert_same_as_fresh(octree: DynamicOctree, rows, areas, boxes):
    fresh = DynamicOctree()
    fresh.insert(rows, areas, boxes)
    n = 4000
    us = (np.arange(n) + 0.5) / n
    share = np.bincount(rows[:, 0], areas) / areas.sum() * n
    for tree in (octree, fresh):
        assert len(tree) == len(rows)
        assert tree.area == pytest.approx(areas.sum(), rel=1e-12)
        box = tree.nodes.box[tree.root]
        assert (box[:3] == boxes[:, :3].min(0)).all() and (box[3:] == boxes[:, 3:].max(0)).all()
        drawn = tree.items.row[tree.sample(us), 0]
        assert np.abs(np.bincount(drawn, minlength=len(share)) - share).max() <= 1 + 1e-6


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32), steps=st.lists(st.tuples(st.booleans(), st.integers(1, 60)), max_size=12))
def test_a_changed_octree_draws_as_a_fresh_one(seed, steps):
    rng = np.random.default_rng(seed)
    octree = DynamicOctree()
    total = 1 + sum(n for _, n in steps)
    rows, areas, boxes = random_items(rng, total)
    number = np.full(total, -1)
    number[:1] = octree.insert(rows[:1], areas[:1], boxes[:1])
    for insert, n in steps:
        there = np.flatnonzero(number >= 0)
        if insert:
            new = np.flatnonzero(number < 0)[:n]
            number[new] = octree.insert(rows[new], areas[new], boxes[new])
        elif len(there) > 1:
            old = rng.permutation(there)[: min(n, len(there) - 1)]
            octree.delete(number[old])
            number[old] = -1
    there = number >= 0
    assert (octree.items.row[number[there]] == rows[there]).all()
    assert_same_as_fresh(octree, rows[there], areas[there], boxes[there])


def test_changes_touch_one_path():
    """No rebuild: the nodes looked at grow with the height, not with the number of items."""
    rng = np.random.default_rng(1)
    octree = DynamicOctree()
    touched = {}
    for n in (2000, 64_000):
        centers, half = rng.random((n, 3)), 0.5 * n ** (-1 / 3)
        numbers = octree.insert(
            np.zeros((n, 2), int), np.ones(n), np.concatenate([centers - half, centers + half], 1)
        )
        worst = 0
        for i in numbers[:: n // 100]:
            box, row = octree.items.box[i : i + 1].copy(), octree.items.row[i : i + 1].copy()
            octree.delete(numbers[:0])
            octree.delete(np.array([i]))
            worst = max(worst, octree.touched)
            octree.insert(row, np.ones(1), box)
            worst = max(worst, octree.touched)
            octree.sample(rng.random(1))
            worst = max(worst, octree.touched)
        touched[n] = worst
    assert touched[2000] < 40 and touched[64_000] < 60
    octree.delete(np.flatnonzero(octree.items.node[: octree._state[4]] >= 0))
    assert len(octree) == 0 and octree.area == 0.0


def test_the_dynamic_octree_refuses_what_it_cannot_hold():
    octree = DynamicOctree()
    box = np.array([[0, 0, 0, 1, 1, 1.0]])
    with pytest.raises(SceneError, match="empty"):
        octree.sample(np.zeros(1))
    with pytest.raises(SceneError, match="not usable"):
        octree.insert([[3, 4]], [np.nan], box)
    with pytest.raises(SceneError, match="not usable"):
        octree.insert([[3, 4]], [1.0], box + np.inf)
    number = octree.insert([[3, 4]], [1.0], box)
    octree.delete(number)
    with pytest.raises(SceneError, match="not there"):
        octree.delete(number)
