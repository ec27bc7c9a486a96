"""Dynamic sampling: distribution lists, the dynamic octree, and points drawn from them for an image."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from instanced import nest, random_mesh, random_transforms, sphere

from pointmr_engine.forward.drawing.cut_outs import no_cut_outs
from pointmr_engine.forward.drawing.subpixels import allocate_target, clear, make_view
from pointmr_engine.forward.reconstruction.holes import holes
from pointmr_engine.forward.selection.dynamic import PointScratch, sample_tile
from pointmr_engine.forward.selection.point_draws import Draws, World
from pointmr_engine.forward.selection.projection import to_raster
from pointmr_engine.hierarchy.acceleration import build_acceleration
from pointmr_engine.hierarchy.distribution import build_distribution, draw_points
from pointmr_engine.hierarchy.dynamic_octree import DynamicOctree
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.hierarchy.nesting import area_scale
from pointmr_engine.hierarchy.octree import build_octree, triangle_corners
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


@settings(max_examples=40)
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


class Drawn:
    """The whole image of a scene as one tile, in pixels: of each the nearest point or triangle."""

    def __init__(self, root, draws="stratified", seed=5, culling=True, ppp=8.0, subpixels=1, kind="PERSPECTIVE",
                 distance=25.0, size=(64, 48), clip=0.1, **how):  # fmt: skip
        world = np.eye(4)
        world[2, 3] = distance
        self.camera = compile_camera(
            Camera(world, kind, focal_length=40.0, ortho_scale=16.0, clip_start=clip),
            RenderSettings(width=size[0], height=size[1], method="forward"),
        )
        self.geometry, self.octree, distribution = compiled(root)
        self.view = make_view(self.camera, subpixels, (distance - 12.0, distance + 12.0))
        width, height = size[0] * subpixels, size[1] * subpixels
        target = allocate_target(width, height)
        clear(target, width)
        self.scratch = PointScratch(target, self.geometry.depth)
        values = {
            "density": ppp / subpixels**2, "ratio": 1.5, "kept": np.inf, "wide": 5.0 * subpixels,
            "tiny": 0.5 * subpixels, "most": ppp, "radius": 0.0, "stratified": draws == "stratified",
            "backface_culling": False,
        } | how  # fmt: skip
        tables = self.geometry.tables
        self.world = World(
            self.octree.arrays, distribution, triangle_corners(self.octree), tables, self.geometry.instances,
            no_cut_outs(len(self.geometry.parts)),
        )  # fmt: skip
        self.count = sample_tile(
            self.view, self.world, self.camera.camera_from_world, Draws(**values), seed, (0, 0, width, height),
            self.scratch, culling, subpixels,
        )  # fmt: skip
        self.depth, self.ids = target.depth[:height, :width].copy(), target.ids[:height, :width].copy()
        self.counters = dict(zip(self.scratch.names, self.scratch.counters.tolist(), strict=True))

    def shown(self):
        """(y, x, item, row) of the pixels that show something."""
        y, x = np.nonzero(self.ids >= 0)
        entry = self.ids[y, x]
        entries = self.scratch.entries
        return y, x, (-1 - entries.surfel[entry]) >> 1, entries.row[entry]

    def corners(self, items, rows):
        """(N, 3, 3) camera space."""
        m = self.scratch.transforms.matrix[rows].reshape(-1, 3, 4)
        p = self.world.corners[items].reshape(-1, 3, 3).astype(float)
        return np.einsum("nrc,nvc->nvr", m[:, :, :3], p) + m[:, None, :, 3]

    def z(self):
        """(H, W) z, infinite where there is nothing."""
        view = self.view
        with np.errstate(all="ignore"):
            z = 1.0 / self.depth if view.perspective else (view.depth_shift - self.depth) / view.depth_scale
        return np.where(self.depth > 0, z, np.inf)


def cast_z(drawn, across=4):
    """(H, W, across^2) z of what rays through places in each pixel hit."""
    camera = drawn.camera
    height, width = drawn.depth.shape
    step = np.linspace(1e-3, 1 - 1e-3, across)
    y, x, v, u = np.meshgrid(np.arange(height), np.arange(width), step, step, indexing="ij")
    x, y = (x + u).ravel(), (y + v).ravel()
    rays, hits = allocate_rays(len(x)), allocate_hits(len(x))
    wide, spread = np.empty(len(x), np.float32), np.empty(len(x), np.float32)
    for k in range(len(x)):
        camera_ray(camera, float(x[k]), float(y[k]), 0.5, 0.5, rays, k, wide, spread)
    walk.intersect(build_acceleration(drawn.geometry), rays, hits)
    position = rays.origin + rays.direction * np.where(np.isfinite(hits.t), hits.t, 1.0)[:, None]
    z = position @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]
    return np.where(np.isfinite(hits.t), z, np.inf).reshape(height, width, -1)


@pytest.mark.parametrize("draws", ["random", "stratified"])
@pytest.mark.parametrize("kind", ["PERSPECTIVE", "ORTHOGRAPHIC"])
def test_points_lie_on_the_surface_that_rays_see_there(kind, draws):
    drawn = Drawn(ball_field(np.random.default_rng(3)), draws, kind=kind)
    y, x, items, rows = drawn.shown()
    assert drawn.counters["triangles"] == 0 and len(y) > 500
    transforms = drawn.scratch.transforms
    parent = transforms.parent[: drawn.scratch.used[1]]
    assert (parent < np.arange(len(parent))).all()
    # the triangle that a pixel names lies there
    corners, camera = drawn.corners(items, rows), drawn.camera
    raster = np.array([[to_raster(camera, *q) for q in p] for p in corners])
    assert (raster.min(1) < np.stack([x, y], 1) + 1 + 1e-3).all()
    assert (raster.max(1) > np.stack([x, y], 1) - 1e-3).all()
    z = drawn.z()[y, x]
    assert (z > corners[:, :, 2].min(1) - 1e-4 * z).all() and (z < corners[:, :, 2].max(1) + 1e-4 * z).all()
    # never in front of the surface; mostly on it (the rest is at silhouettes, where a nearer one missed the pixel)
    seen = cast_z(drawn)[y, x]
    assert (z > seen.min(1) * (1 - 0.02)).mean() > 0.97
    assert (z < np.where(np.isfinite(seen), seen, 0.0).max(1) * (1 + 0.02)).mean() > 0.9


@pytest.mark.parametrize("draws", ["random", "stratified"])
def test_culling_changes_nothing_but_the_work(draws):
    root = ball_field(np.random.default_rng(3), 200)
    all_of_it, culled = (Drawn(root, draws, culling=culling, ppp=12.0) for culling in (False, True))
    np.testing.assert_array_equal(culled.depth, all_of_it.depth)
    assert culled.counters["points_drawn"] < all_of_it.counters["points_drawn"]
    assert culled.counters["hidden"] > 0 and all_of_it.counters["hidden"] == 0
    other = Drawn(root, draws, seed=6, ppp=12.0)
    assert (other.depth != culled.depth).any()


def nested_field(rng, levels=4):
    """Balls in front of each other, of 8 smaller ones each, and so on: most points lie in placements below a pixel."""
    p, t = sphere(6, 6)
    group = Group("ball", [Mesh("ball", p, t)])
    for level in range(levels):
        group = Group(
            f"level {level}", [], [Instances((group,), random_transforms(rng, 8, (0.25, 0.4), 0.8))]
        )
    return Group("root", [], [Instances((group,), random_transforms(rng, 60, (2.0, 3.0), 6.0))])


@pytest.mark.parametrize("draws", ["random", "stratified"])
@pytest.mark.parametrize("radius", [0.0, 1.5])
@pytest.mark.parametrize("kind", ["PERSPECTIVE", "ORTHOGRAPHIC"])
def test_points_end_at_placements_that_cannot_be_seen(kind, radius, draws):
    root = nested_field(np.random.default_rng(4))
    how = {"kind": kind, "ppp": 24.0, "subpixels": 2, "radius": radius}
    all_of_it, culled = (Drawn(root, draws, culling=culling, **how) for culling in (False, True))
    inner = slice(2, -2)  # boxes across the border of a tile are hidden as what they show in it is
    np.testing.assert_array_equal(culled.depth[inner, inner], all_of_it.depth[inner, inner])
    ended = culled.counters["points_ended"] - all_of_it.counters["points_ended"]
    assert (culled.depth > 0).mean() > 0.2 and ended > 0.2 * culled.counters["points_drawn"]


@pytest.mark.parametrize("draws", ["random", "stratified"])
def test_tiles_see_the_same_points(draws):
    """Cells that are drawn in two parts are those of the whole, whatever the tiles are."""
    root = ball_field(np.random.default_rng(3))
    whole = Drawn(root, draws)
    for x0, x1 in ((0, 24), (24, 64)):
        target = allocate_target(x1 - x0, 48)
        clear(target, x1 - x0)
        scratch = PointScratch(target, whole.geometry.depth)
        how = Draws(8.0, 1.5, np.inf, 5.0, 0.5, 8.0, 0.0, draws == "stratified", False)
        sample_tile(
            whole.view, whole.world, whole.camera.camera_from_world, how, 5, (x0, 0, x1, 48), scratch, True, 1
        )
        part = target.depth[:48, : x1 - x0]
        # densities are bounded by how far a tile reaches from the axis, so some boxes have a point more or less
        assert (part == whole.depth[:, x0:x1]).mean() > 0.6


@pytest.mark.parametrize("draws", ["random", "stratified"])
def test_the_number_of_points_is_that_of_the_area(draws):
    """A wall of many triangles, seen face on by an orthographic camera: nothing is bounded, all is exact."""
    n = 200
    x, y = np.meshgrid(np.linspace(-7, 7, n + 1), np.linspace(-5, 5, n + 1))
    k = np.arange(n * n)
    a = k // n * (n + 1) + k % n
    faces = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    p = np.stack([x, y, 0 * x], -1).reshape(-1, 3).astype(np.float32)
    drawn = Drawn(Group("root", [Mesh("wall", p, faces.astype(np.int32))]), draws, kind="ORTHOGRAPHIC")
    expected = 14 * 10 * (64 / 16) ** 2 * 8.0
    spread = {"random": 6 * math.sqrt(expected), "stratified": 3 * math.sqrt(drawn.counters["boxes"])}
    assert drawn.counters["points_drawn"] == pytest.approx(expected, abs=spread[draws])
    # and each box's own: a Poisson distribution's variance is its mean, stratified draws have hardly any
    cells = np.zeros(100)
    for seed in range(100):
        cells[seed] = Drawn(
            Group("root", [Mesh("wall", p, faces.astype(np.int32))]), draws, seed, kind="ORTHOGRAPHIC"
        ).counters["points_drawn"]
    if draws == "random":
        assert 0.6 < cells.var() / expected < 1.6
    else:
        assert cells.var() < 0.3 * expected
    assert abs(cells.mean() - expected) < 5 * math.sqrt(max(cells.var(), 1.0) / 100)


def test_large_and_near_triangles_are_drawn_as_they_are():
    root = ball_field(np.random.default_rng(3), 200)
    drawn = Drawn(root, distance=8.0, clip=7.0, kept=1.0, subpixels=4, radius=1.0)
    assert drawn.counters["triangles"] > 0 and drawn.counters["points"] > 0
    y, x, items, rows = drawn.shown()
    corners = drawn.corners(items, rows)
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    point = drawn.scratch.entries.surfel[drawn.ids[y, x]] & 1 == 0
    assert point.any()
    # what crosses the near plane is never left to points, and no point stands for what expects more than one
    focal = drawn.view.scale_x * drawn.view.scale_y / 16
    points = point & (corners[:, :, 2].max(1) > 7.2)
    assert (corners[:, :, 2].min(1) < 7.0).any()
    expects = area * focal / np.maximum(corners[:, :, 2].min(1), 7.0) ** 2 * 8.0
    assert (
        expects[points] < 1.2
    ).mean() > 0.5  # triangles that look small are drawn as lumps, whose mark is the same
    z = drawn.z()[y, x]
    seen = cast_z(Drawn(root, distance=8.0, clip=7.0), 2).min(2)[y // 4, x // 4]
    assert (np.abs(z - seen) < 0.1 * z).mean() > 0.8


def test_backface_culling_leaves_the_backs_of_mirrored_balls_out():
    root = ball_field(np.random.default_rng(3), 40)
    for kept in (np.inf, 1.0):
        everything = Drawn(root, ppp=30.0, kept=kept)
        drawn = Drawn(root, ppp=30.0, kept=kept, backface_culling=True)
        there, still = everything.depth > 0, drawn.depth > 0
        assert still.sum() > 0.98 * there.sum() and not (still & ~there).any()
        assert drawn.counters["points"] < everything.counters["points"]
        _, _, items, rows = drawn.shown()
        m = drawn.scratch.transforms.matrix[rows].reshape(-1, 3, 4)
        center = drawn.world.corners[items].reshape(-1, 3, 3).astype(float).mean(1)
        # outwards, in a ball about its origin
        normal = np.einsum("ncr,nc->nr", np.linalg.inv(m[:, :, :3]), center)
        q = np.einsum("nrc,nc->nr", m[:, :, :3], center) + m[:, :, 3]
        cosine = (normal * q).sum(1) / np.linalg.norm(normal, axis=1) / np.linalg.norm(q, axis=1)
        assert (cosine < 0.1).all()


def test_an_empty_scene_has_no_points():
    drawn = Drawn(Group("nothing", []))
    assert drawn.count == 0 and not drawn.depth.any()


def test_holes_are_found_but_not_beyond_silhouettes():
    world = np.eye(4)
    world[2, 3] = 25.0
    camera = compile_camera(
        Camera(world, focal_length=40.0), RenderSettings(width=64, height=48, method="forward")
    )
    depth = np.full((20, 30), 1 / 30, np.float32)
    depth[4:16, 5:20] = 1 / 20  # a square in front
    for subpixels in (1, 4):
        view = make_view(camera, subpixels, (1.0, 40.0))
        assert not holes(depth, view, subpixels).any()
        gaps = depth.copy()
        gaps[8, 10], gaps[12, 12] = 0.0, 1 / 30  # nothing; something behind
        gaps[17, 25] = 0.0
        assert set(zip(*np.nonzero(holes(gaps, view, subpixels)), strict=True)) == {
            (8, 10),
            (12, 12),
            (17, 25),
        }
