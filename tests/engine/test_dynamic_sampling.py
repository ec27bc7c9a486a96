"""Dynamic sampling: distribution lists, the dynamic octree, and points drawn from them for an image."""

import numpy as np
import pytest
from instanced import nest, random_mesh, random_transforms

from pointmr_engine.hierarchy.distribution import build_distribution, draw_points
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.hierarchy.nesting import area_scale
from pointmr_engine.hierarchy.octree import build_octree
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
