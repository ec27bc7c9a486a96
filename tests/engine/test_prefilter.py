"""Prefiltered points: exact moments of triangles, the same through instances as of flattened geometry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from instanced import Flat, accelerate, nest, random_mesh, random_transforms, sphere
from small_scenes import quad

from pointmr_engine.hierarchy.acceleration import EMPTY
from pointmr_engine.hierarchy.closed_shapes import is_closed
from pointmr_engine.hierarchy.prefilter import area_of, prefilter
from pointmr_engine.scene.group import CAMERA, SHADOW, VISIBLE, Group, Instances, instance
from pointmr_engine.scene.material import Material
from pointmr_engine.scene.mesh import Mesh

seeds = st.integers(0, 2**32 - 1)
UPPER = np.triu_indices(3)


def box():
    """A cube of 12 triangles that share 8 corners."""
    p = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return p, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)


def moments(corners):
    """Area, centroid, covariance (6,), normals (6,) of (N, 3, 3) corners."""
    c = np.asarray(corners, float)
    n = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])
    double = np.linalg.norm(n, axis=1)
    area, mean = double / 2, c.mean(1)
    mu = (area[:, None] * mean).sum(0) / area.sum()
    d = c - mean[:, None]
    own = np.einsum("nvi,nvj->nij", d, d) / 12
    off = mean - mu
    v = (area[:, None, None] * (own + off[:, :, None] * off[:, None])).sum(0) / area.sum()
    n = n[double > 0]
    m = np.einsum("ni,nj->ij", n / (2 * double[double > 0, None]), n)
    return area.sum(), mu, v[UPPER], m[UPPER]


def scene_moments(acceleration, prefiltered):
    raw = prefiltered.group_raw[-1]
    return raw[0], raw[1:4] + acceleration.arrays.group_center[-1], raw[4:10], raw[10:16]


def agree(got, expected, rtol):
    size = expected[2][[0, 3, 5]].sum()
    assert got[0] == pytest.approx(expected[0], rel=rtol)
    np.testing.assert_allclose(got[1], expected[1], atol=rtol * np.sqrt(size))
    np.testing.assert_allclose(got[2], expected[2], atol=rtol * size)
    np.testing.assert_allclose(got[3], expected[3], atol=rtol * expected[0])


@settings(max_examples=25)
@given(seeds, st.integers(1, 200))
def test_moments_of_a_mesh_are_exact(seed, triangles):
    mesh = random_mesh(np.random.default_rng(seed), triangles, 1.0, (5.0, -3.0, 2.0))
    _, acceleration = accelerate(Group("root", [mesh]))
    got = scene_moments(acceleration, prefilter(acceleration))
    agree(got, moments(mesh.positions[mesh.triangles]), 1e-5)


@settings(max_examples=20)
@given(seeds, st.integers(1, 3), st.sampled_from([0.0, 1e6]))
def test_moments_through_instances_are_those_of_flattened_geometry(seed, depth, offset):
    rng = np.random.default_rng(seed)
    group = Group("leaf", [random_mesh(rng, 30)])
    for level in range(depth):  # turned, mirrored, scaled evenly
        q, _ = np.linalg.qr(rng.normal(size=(3, 3, 3)))
        m = np.concatenate([q * rng.uniform(0.2, 2.0, (3, 1, 1)), 3 * rng.normal(size=(3, 3, 1))], axis=2)
        group = Group(f"level {level}", [], [Instances((group,), m)])
    far = np.eye(4)
    far[:3, 3] = offset
    geometry, acceleration = accelerate(Group("root", [], [instance(group, far)]))
    expected = moments(Flat(geometry).corners)
    agree(scene_moments(acceleration, prefilter(acceleration)), expected, 1e-5 if offset == 0.0 else 1e-4)


@settings(max_examples=15)
@given(seeds)
def test_uneven_scales_are_exact_for_one_normal_and_near_for_all(seed):
    rng = np.random.default_rng(seed)
    flat = quad(2.0)
    m = random_transforms(rng, 1, (0.2, 3.0))
    geometry, acceleration = accelerate(Group("root", [], [Instances((Group("leaf", [flat]),), m)]))
    agree(scene_moments(acceleration, prefilter(acceleration)), moments(Flat(geometry).corners), 1e-5)
    p, t = sphere(24, 32)
    geometry, acceleration = accelerate(Group("root", [], [Instances((Group("ball", [Mesh("", p, t)]),), m)]))
    got = scene_moments(acceleration, prefilter(acceleration))
    assert got[0] == pytest.approx(moments(Flat(geometry).corners)[0], rel=0.12)


def projected(points, node, child, direction):
    p = points[node, 9:15, child].astype(float)
    x, y, z = direction
    return np.sqrt(
        p[0] * x * x + p[3] * y * y + p[5] * z * z + 2 * (p[1] * x * y + p[2] * x * z + p[4] * y * z)
    )


def test_areas_seen_along_a_direction():
    """A square shows its cosine; a cloud of triangles so thin that none hides another half its area."""
    _, acceleration = accelerate(Group("root", [quad(2.0)]))
    points = prefilter(acceleration).points
    for angle in (0.0, 0.5, 1.5):
        assert projected(points, 0, 0, (np.sin(angle), 0, np.cos(angle))) == pytest.approx(
            4 * np.cos(angle), rel=1e-5
        )
    rng = np.random.default_rng(1)
    center, corners = rng.normal(size=(4000, 1, 3)), 1e-3 * rng.normal(size=(4000, 3, 3))
    cloud = Mesh("cloud", (center + corners).reshape(-1, 3), np.arange(12000, dtype=np.int32).reshape(-1, 3))
    _, acceleration = accelerate(
        Group("root", [], [instance(Group("cloud", [cloud])), instance(Group("none"))])
    )
    _, acceleration = accelerate(Group("root", [cloud, quad(1e-6, 50.0)]))
    points, root = prefilter(acceleration).points, acceleration.arrays.group_root[-1]
    area = moments(cloud.positions[cloud.triangles])[0]
    seen = [projected(points, root, c, (0, 0.6, 0.8)) for c in range(2)]
    assert max(seen) == pytest.approx(area / 2, rel=0.03)
    assert area_of(points)[root].max() == pytest.approx(area, rel=0.03)


@settings(max_examples=25)
@given(seeds)
def test_a_closed_convex_body_covers_a_quarter_of_its_area(seed):
    """Cauchy's theorem; the mean over directions, of balls and boxes and what they are when they are stretched."""
    rng = np.random.default_rng(seed)
    p, t = sphere(24, 32) if seed % 2 else box()
    p = p @ np.diag(rng.uniform(0.5, 1.5, 3)) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    mesh = Mesh("body", p.astype(np.float32), t)
    _, acceleration = accelerate(Group("root", [mesh, quad(1e-6, 50.0)]))
    prefiltered, root = prefilter(acceleration), acceleration.arrays.group_root[-1]
    body = int(np.argmax(area_of(prefiltered.points)[root]))
    d = rng.normal(size=(4000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    area = moments(mesh.positions[mesh.triangles])[0]
    assert projected(prefiltered.points, root, body, d.T).mean() == pytest.approx(area / 4, rel=0.03)


def test_what_hides_itself_covers_no_more_than_its_outline():
    p, t = sphere(48, 64)
    _, acceleration = accelerate(Group("root", [Mesh("ball", p, t), quad(1e-6, 50.0)]))
    points, root = prefilter(acceleration).points, acceleration.arrays.group_root[-1]
    seen = max(projected(points, root, c, (1, 0, 0)) for c in range(2))
    assert 0.75 * np.pi < seen < 1.35 * np.pi  # of its surface's 4 pi


def pieces(mesh, count, seed=0):
    """`count` copies of (positions, triangles) in one, each turned by chance and somewhere else."""
    rng, (p, t) = np.random.default_rng(seed), mesh
    turned = p @ np.linalg.qr(rng.normal(size=(count, 3, 3)))[0] + rng.normal(size=(count, 1, 3)) * 20.0
    return turned.reshape(-1, 3), (t + len(p) * np.arange(count)[:, None, None]).reshape(-1, 3)


def sheet(n):
    """A square of n x n quads that share their corners."""
    x, y = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1))
    at = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    quads = np.stack([at, at + 1, at + n + 2, at, at + n + 2, at + n + 1], 1).reshape(-1, 3)
    return np.stack([x.ravel(), y.ravel(), 0 * y.ravel()], 1), quads


def tube(sides, rings):
    """An open tube of radius 0.1 along z, its corners shared."""
    angle = np.arange(sides) * 2 * np.pi / sides
    p = np.array([[0.1 * np.cos(a), 0.1 * np.sin(a), z] for z in range(rings) for a in angle])
    at, on = np.arange(sides), (np.arange(sides) + 1) % sides
    wall = np.stack([at, on, on + sides, at, on + sides, at + sides], 1).reshape(-1, 3)
    return p, np.concatenate([wall + sides * k for k in range(rings - 1)])


def test_bodies_are_closed_and_leaves_are_not():
    ball, leaf, strand = sphere(24, 32), sheet(12), tube(6, 14)
    holed = ball[0], ball[1][3:]
    half = ball[0], ball[1][: len(ball[1]) // 2]
    for shape in (box(), ball, holed, strand, sphere(300, 400)):
        assert is_closed(*shape) and is_closed(*pieces(shape, 9))
    for shape in (leaf, half, sheet(2), sheet(400), (ball[0], ball[1][::2]), (ball[0], ball[1][:0])):
        assert not is_closed(*shape) and not is_closed(*pieces(shape, 9))


def test_what_is_open_shows_both_its_sides():
    p, t = pieces(sheet(12), 200)
    _, acceleration = accelerate(
        Group("root", [Mesh("leaves", p.astype(np.float32), t.astype(np.int32)), quad(1e-6, 50.0)])
    )
    points, root = prefilter(acceleration).points, acceleration.arrays.group_root[-1]
    assert max(projected(points, root, c, (0, 0.6, 0.8)) for c in range(2)) > 0.4 * 800.0


def test_opacity_scales_areas():
    solid, clear = Material("solid"), Material("clear")
    meshes = [quad(2.0, 0.0, solid), quad(2.0, 1.0, clear)]
    geometry, acceleration = accelerate(Group("root", meshes))
    opacity = np.ones(len(geometry.materials))
    opacity[geometry.materials.index(clear)] = 0.25
    prefiltered = prefilter(acceleration, opacity)
    assert prefiltered.group_raw[-1, 0] == pytest.approx(5.0)
    assert sorted(prefiltered.part_opacity) == [0.25, 1.0]
    with pytest.raises(ValueError, match="expected"):
        prefilter(acceleration, np.ones(7))


def test_visibility_of_what_lies_below():
    leaf = Group("leaf", [quad()])
    shown = Instances((leaf,), np.repeat(np.eye(4)[None, :3], 20, 0), visibility=np.array([CAMERA], np.uint8))
    mixed = Instances(
        (leaf,),
        np.repeat(np.eye(4)[None, :3], 2, 0),
        visibility=np.array([SHADOW, CAMERA | SHADOW], np.uint8),
    )
    _, acceleration = accelerate(Group("root", [], [shown]))
    prefiltered = prefilter(acceleration)
    used = acceleration.arrays.children != EMPTY
    group = np.arange(len(used)) >= acceleration.arrays.group_root[-1]
    assert (prefiltered.visibility[:, group][:, used[group]] == CAMERA).all() and prefiltered.mixed
    _, acceleration = accelerate(Group("root", [], [instance(Group("two", [], [mixed])), instance(leaf)]))
    prefiltered, root = prefilter(acceleration), acceleration.arrays.group_root[-1]
    pairs = {tuple(v) for v in prefiltered.visibility[:, root, :2].T}
    assert pairs == {(CAMERA | SHADOW, SHADOW), (VISIBLE, VISIBLE)}


def test_degenerate_triangles_and_empty_scenes_add_nothing():
    p = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [np.nan, 0, 0]], np.float32)
    t = np.array([[0, 1, 2], [0, 1, 1], [0, 1, 3], [0, 1, 4]], np.int32)
    _, acceleration = accelerate(Group("root", [Mesh("bad", p, t)]))
    prefiltered = prefilter(acceleration)
    assert prefiltered.group_raw[-1, 0] == pytest.approx(0.5)
    assert np.isfinite(prefiltered.points).all()
    _, acceleration = accelerate(Group("nothing"))
    assert len(prefilter(acceleration).points) == 0
    _, acceleration = accelerate(nest(np.random.default_rng(0), 2, Group("nothing")))
    assert prefilter(acceleration).group_raw[:, 0].sum() == 0
