"""Dynamic sampling: distribution lists, the dynamic octree, and points drawn from them for an image."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from instanced import nest, random_mesh, random_transforms, sphere

from pointmr_engine.forward.dynamic import PointSet, draw_image, make_view, select_boxes
from pointmr_engine.forward.point_image import (
    depth_image,
    holes,
    interpolate_gaussian,
    interpolate_nearest,
    nearest_points,
    visible_points,
    window,
)
from pointmr_engine.forward.projection import inverse_depth, to_raster
from pointmr_engine.hierarchy.acceleration import build_acceleration
from pointmr_engine.hierarchy.distribution import build_distribution, draw_points
from pointmr_engine.hierarchy.dynamic_octree import DynamicOctree
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.hierarchy.nesting import area_scale
from pointmr_engine.hierarchy.octree import build_octree
from pointmr_engine.raytracing import walk
from pointmr_engine.raytracing.camera import camera_ray, compile_camera
from pointmr_engine.raytracing.rays import allocate_hits, allocate_rays
from pointmr_engine.scene.camera import Camera
from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.group import Group, Instances
from pointmr_engine.scene.mesh import Mesh
from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.settings import RenderSettings


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


def ball_field(rng, n=60, rings=40):
    """Instances, nested twice and unevenly scaled, of a sphere of 3,000 triangles."""
    p, t = sphere(rings, rings)
    leaf = Group("ball", [Mesh("ball", p, t)])
    pair = Group("pair", [], [Instances((leaf,), random_transforms(rng, 2, (0.3, 0.6), 0.8))])
    m = random_transforms(rng, n, (0.5, 1.0), 6.0)
    return Group("root", [], [Instances((pair, leaf), m, rng.integers(0, 2, n).astype(np.int32))])


def view_of(
    kind="PERSPECTIVE", distance=25.0, size=(64, 48), ppp=8.0, kept=np.inf, culling=False, clip=0.1, **values
):
    world = np.eye(4)
    world[2, 3] = distance
    camera = compile_camera(
        Camera(world, kind, focal_length=40.0, ortho_scale=16.0, clip_start=clip, **values),
        RenderSettings(width=size[0], height=size[1], method="forward"),
    )
    return make_view(camera, ppp, 0.5, kept, culling)


def cast_at(acceleration, view, x, y):
    """Inverse depths (N,) that rays through image positions find; 0: nothing."""
    camera = view.camera
    rays, hits = allocate_rays(len(x)), allocate_hits(len(x))
    width, spread = np.empty(len(x), np.float32), np.empty(len(x), np.float32)
    for k in range(len(x)):
        camera_ray(camera, float(x[k]), float(y[k]), 0.5, 0.5, rays, k, width, spread)
    walk.intersect(acceleration, rays, hits)
    position = rays.origin + rays.direction * np.where(np.isfinite(hits.t), hits.t, 1.0)[:, None]
    z = position @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
    return np.where(np.isfinite(hits.t), [inverse_depth(camera, d) for d in z], 0.0)


def position_of(geometry, octree, points, transforms):
    """Camera-space positions (N, 3) from what the points say of themselves, and the chain of their transforms."""
    a = octree.arrays
    out = np.empty((len(points.x), 3))
    for k in range(len(points.x)):
        part, row = points.part[k], points.transform[k]
        shape = geometry.shapes[geometry.tables.shape[part]]
        p = shape.positions[shape.triangles[points.triangle[k]]].astype(float)
        w = np.array([1.0 - points.u[k] - points.v[k], points.u[k], points.v[k]])
        m = transforms.matrix[row].reshape(3, 4)
        out[k] = m[:, :3] @ (w @ p + a.part_offset[part] - a.group_center[transforms.group[row]]) + m[:, 3]
    return out


@pytest.mark.parametrize("draws", ["random", "stratified", "poisson"])
@pytest.mark.parametrize("kind", ["PERSPECTIVE", "ORTHOGRAPHIC"])
def test_points_lie_on_the_surface_that_a_ray_sees_there(kind, draws):
    geometry, octree, distribution = compiled(ball_field(np.random.default_rng(3)))
    view = view_of(kind)
    selection = select_boxes(octree, distribution, view)
    points, transforms, statistics = draw_image(octree, distribution, selection, draws, 5)
    assert statistics.triangles == 0 and len(points.x) > 500
    assert (transforms.parent < np.arange(len(transforms.parent))).all()
    camera = view.camera
    p = position_of(geometry, octree, points, transforms)
    raster = np.array([to_raster(camera, *q) for q in p])
    assert np.abs(raster - np.column_stack([points.x, points.y])).max() < 1e-3
    assert points.inverse_depth == pytest.approx(np.array([inverse_depth(camera, q[2]) for q in p]), rel=1e-5)
    # never in front of the surface; mostly on it (the rest is at silhouettes, where a nearer one missed the pixel)
    seen = cast_at(build_acceleration(geometry), view, points.x, points.y)
    assert (points.inverse_depth <= seen * (1 + 1e-4) + 1e-6).mean() > 0.995
    assert (points.inverse_depth >= seen * (1 - 1e-3) - 1e-6).mean() > 0.9


def same(a, b):
    return all((x == y).all() for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("draws", ["random", "stratified", "poisson"])
def test_neither_threads_nor_culling_change_a_point(draws):
    geometry, octree, distribution = compiled(ball_field(np.random.default_rng(3), 200))
    view = view_of(ppp=12.0)
    selection = select_boxes(octree, distribution, view)
    reference = draw_image(octree, distribution, selection, draws, 5, False, threads=1)
    for threads, culling in ((1, True), (2, True), (3, False)):
        points, transforms, statistics = draw_image(
            octree, distribution, selection, draws, 5, culling, threads=threads
        )
        assert same(points, reference[0]) and same(transforms, reference[1])
        assert (nearest_points(points, view.region) >= 0).sum() == len(points.x)  # one in each pixel, still
        assert not culling or statistics.drawn < reference[2].drawn
    other, _, _ = draw_image(octree, distribution, selection, draws, 6)
    assert len(other.x) != len(reference[0].x) or not same(other, reference[0])


def test_the_number_of_points_is_what_was_expected():
    geometry, octree, distribution = compiled(ball_field(np.random.default_rng(3), 200))
    selection = select_boxes(octree, distribution, view_of())
    expected = selection.boxes.area.sum() * 8.0
    drawn = {
        draws: draw_image(octree, distribution, selection, draws, 1, False)[2].drawn
        for draws in ("random", "stratified", "poisson")
    }
    assert drawn["random"] == math.ceil(expected)
    assert drawn["stratified"] == pytest.approx(expected, abs=1)
    assert drawn["poisson"] == pytest.approx(expected, abs=6 * math.sqrt(expected))


def test_large_and_near_triangles_are_kept():
    geometry, octree, distribution = compiled(ball_field(np.random.default_rng(3), 200))
    view = view_of(distance=8.0, kept=3.0, clip=7.0)
    selection = select_boxes(octree, distribution, view)
    triangles, transforms = selection.triangles, selection.transforms
    assert 0 < len(triangles.part) and 0 < len(selection.boxes.row)
    listed = set(zip(triangles.transform.tolist(), triangles.triangle.tolist(), strict=True))
    assert len(listed) == len(triangles.part)
    a = octree.arrays
    m = transforms.matrix.reshape(-1, 3, 4)
    nearest = []
    for part, triangle, row in zip(*triangles, strict=True):
        shape = geometry.shapes[geometry.tables.shape[part]]
        p = shape.positions[shape.triangles[triangle]] + a.part_offset[part]
        q = (p - a.group_center[transforms.group[row]]) @ m[row, :, :3].T + m[row, :, 3]
        nearest.append(q[:, 2].min())
    assert min(nearest) < 7.0  # triangles through the near plane are here, too
    # none is sampled as well
    boxes = selection.boxes
    single = boxes.interval[:, 1] - boxes.interval[:, 0] == 1
    items = a.item[boxes.interval[single, 0]]
    assert not listed & set(zip(boxes.row[single].tolist(), items[:, 1].tolist(), strict=True))


def test_backface_culling_leaves_the_backs_of_mirrored_balls_out():
    geometry, octree, distribution = compiled(ball_field(np.random.default_rng(3), 40))
    everything, _, _ = draw_image(
        octree, distribution, select_boxes(octree, distribution, view_of(ppp=30.0)), "stratified", 1
    )
    view = view_of(ppp=30.0, culling=True)
    points, transforms, _ = draw_image(
        octree, distribution, select_boxes(octree, distribution, view), "stratified", 1
    )
    assert 0.95 * len(everything.x) < len(points.x) <= 1.02 * len(everything.x)
    m = transforms.matrix.reshape(-1, 3, 4)
    for part, triangle, row in zip(points.part, points.triangle, points.transform, strict=True):
        shape = geometry.shapes[geometry.tables.shape[part]]
        p = shape.positions[shape.triangles[triangle]].astype(float)
        center = p.mean(0)  # outwards, in a ball about its origin
        normal = np.linalg.inv(m[row, :, :3]).T @ center
        q = m[row, :, :3] @ (p.mean(0) + octree.arrays.part_offset[part]) + m[row, :, 3]
        q -= m[row, :, :3] @ octree.arrays.group_center[transforms.group[row]]
        assert normal @ q / np.linalg.norm(normal) / np.linalg.norm(q) < 0.1


def test_what_lies_behind_given_depths_is_not_drawn():
    geometry, octree, distribution = compiled(ball_field(np.random.default_rng(3), 200))
    selection = select_boxes(octree, distribution, view_of(ppp=12.0))
    free, _, _ = draw_image(octree, distribution, selection, "stratified", 5)
    depth = np.zeros((48, 64), np.float32)
    depth[:, :32] = 1 / 24.0
    points, _, _ = draw_image(octree, distribution, selection, "stratified", 5, depth=depth)
    left = points.x < 32
    assert (points.inverse_depth[left] > np.float32(1 / 24.0)).all()
    assert left.sum() < (free.x < 32).sum() and (~left).sum() == (free.x >= 32).sum()


def test_an_empty_scene_has_no_points():
    geometry, octree, distribution = compiled(Group("nothing", []))
    points, transforms, _ = draw_image(
        octree, distribution, select_boxes(octree, distribution, view_of()), "random", 1
    )
    assert len(points.x) == 0 and len(transforms.record) == 0


def test_images_of_points():
    """A near plane of less than a point a pixel hides a far one."""
    rng = np.random.default_rng(2)
    camera = view_of().camera
    n, region = 1800, (0, 0, 64, 48)
    x, y = rng.random((2, 2 * n)).astype(np.float32) * np.array([[64], [48]], np.float32)
    near = np.arange(2 * n) < n
    z = np.where(near, 10.0, 20.0)
    blank = np.zeros(2 * n, np.int32)
    points = PointSet(x, y, (1 / z).astype(np.float32), blank, blank, x, y, blank)
    nearest = nearest_points(points, region)
    cell = np.floor(y).astype(int) * 64 + np.floor(x).astype(int)
    for k in range(64 * 48):
        here = np.flatnonzero(cell == k)
        want = -1 if not len(here) else here[np.argmin(z[here])]
        assert nearest.flat[k] == want
    depth = depth_image(points, nearest)
    side = window(n / (64 * 48))
    assert side == 5
    keep = visible_points(points, depth, region, camera, side)
    assert keep[near].all() and keep[~near].mean() < 0.01
    color = np.column_stack([near, x / 64]).astype(np.float32)
    image = interpolate_nearest(nearest, keep, color)
    assert image[nearest >= 0][:, 0].mean() < 0.99  # points behind were the nearest in some pixels: dropped
    smooth, weight = interpolate_gaussian(points, keep, color, region)
    covered = weight > 0.2
    assert covered.mean() > 0.7 and smooth[covered][:, 0].min() > 0.99
    centers = (np.arange(64) + 0.5) / 64
    assert np.abs(smooth[:, :, 1] - centers)[covered].max() < 1.5 / 64


def test_holes_are_found_but_not_beyond_silhouettes():
    camera = view_of().camera
    depth = np.full((20, 30), 1 / 30, np.float32)
    depth[4:16, 5:20] = 1 / 20  # a square in front
    assert not holes(depth, camera).any()
    depth[8, 10], depth[12, 12] = 0.0, 1 / 30  # nothing; something behind
    depth[17, 25] = 0.0
    assert set(zip(*np.nonzero(holes(depth, camera)), strict=True)) == {(8, 10), (12, 12), (17, 25)}
