"""The walk through nested instances, against every ray tried with every triangle; leaks, bad input, shadows."""

from __future__ import annotations

import threading
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from instanced import (
    Flat,
    accelerate,
    cast,
    nest,
    random_mesh,
    random_transforms,
    scene_rays,
    sphere,
)

from pointmr_engine.hierarchy.acceleration import build_acceleration, set_opaque
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.raytracing import surface, walk
from pointmr_engine.raytracing.rays import allocate_hits
from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.group import CAMERA, GLOSSY, HOLDOUT, SHADOW, VISIBLE, Group, Instances, instance
from pointmr_engine.scene.material import Material
from pointmr_engine.scene.mesh import Mesh
from pointmr_engine.scene.scene import Scene

seeds = st.integers(0, 2**32 - 1)


def square(z: float = 0.0, size: float = 1.0, name: str = "square", **values) -> Mesh:
    p = np.array([[-1, -1, z], [1, -1, z], [1, 1, z], [-1, 1, z]], np.float32) * np.float32([size, size, 1])
    return Mesh(name, p, np.array([[0, 1, 2], [0, 2, 3]], np.int32), **values)


def shifted(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    m = np.eye(4)
    m[:3, 3] = x, y, z
    return m


@settings(max_examples=25)
@given(
    seeds,
    st.integers(0, 3),
    st.sampled_from([(0.5, 2.0), (1e-4, 1e-3), (1e3, 1e4)]),
    st.sampled_from([0.0, 1e6]),
)
def test_agrees_with_every_ray_against_every_triangle(seed, depth, scale, offset):
    rng = np.random.default_rng(seed)
    leaf = Group("leaf", [random_mesh(rng, 15), random_mesh(rng, 1, 0.1, (0, 0, 2))])
    inner = nest(rng, depth, leaf, 3, scale=scale, spread=3.0)
    far = shifted(offset, -offset / 3, offset / 7)
    root = Group("root", [], [instance(inner, far)])
    geometry, acceleration = accelerate(root)
    flat = Flat(geometry)
    n = 60
    aim = flat.corners[rng.integers(0, len(flat.corners), n)].mean(1)
    reach = np.ptp(flat.corners.reshape(-1, 3), axis=0).max()
    origin = aim + rng.normal(size=(n, 3)) * reach * rng.choice([0.05, 0.5, 3.0], (n, 1))
    direction = aim - origin + rng.normal(size=(n, 3)) * reach * 0.01
    rays, hits = cast(acceleration, origin, direction)
    told = 0
    for i in range(n):
        t, row, clear = flat.closest(rays.origin[i], rays.direction[i])
        if not clear:
            continue
        told += 1
        if np.isinf(t):
            assert hits.triangle[i] == -1 and np.isinf(hits.t[i])
            continue
        assert hits.triangle[i] == flat.numbers[row] and hits.path[i] == flat.paths[row]
        assert abs(hits.t[i] - t) < 1e-5 * max(t, reach)
    assert told > 0


@settings(max_examples=15)
@given(seeds, st.sampled_from([0.0, 1e5]), st.booleans())
def test_closed_meshes_do_not_leak(seed, offset, nested):
    rng = np.random.default_rng(seed)
    p, t = sphere(14, 18)
    p = p * (1 + 0.3 * rng.random((len(p), 1))).astype(np.float32)
    group = Group("star", [Mesh("star", p, t)])
    world = np.eye(4)
    if nested:
        world[:3] = random_transforms(rng, 1, (1e-2, 1e2))[0]
    world[:3, 3] += offset
    geometry, acceleration = accelerate(Group("root", [], [instance(group, world)]))
    corners = p[t].astype(np.float64)
    targets = np.concatenate([p.astype(np.float64), corners.mean(1), (corners[:, 0] + corners[:, 1]) / 2])
    inside = rng.normal(size=(len(targets), 3)) * 0.1  # the star holds a ball of radius 0.9
    origin, target = inside @ world[:3, :3].T + world[:3, 3], targets @ world[:3, :3].T + world[:3, 3]
    _, hits = cast(acceleration, origin, target - origin)
    assert (hits.triangle >= 0).all()
    center = np.broadcast_to(world[:3, 3], target.shape)
    _, hits = cast(acceleration, center, target - center)
    assert (hits.triangle >= 0).all()


def test_grid_does_not_leak_along_exact_edges():
    n = 16
    x, y = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    p = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3).astype(np.float32)
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    t = np.concatenate([np.stack([i, i + n + 1, i + n + 2], 1), np.stack([i, i + n + 2, i + 1], 1)]).astype(
        np.int32
    )
    _, acceleration = accelerate(Group("root", [Mesh("grid", p, t)]))
    at = np.concatenate([p, p + [0.5, 0, 0], p + [0, 0.5, 0], p + [0.5, 0.5, 0]])
    at = at[(at[:, :2] <= n).all(1)]
    for direction in ([0, 0, -1], [0.25, 0.5, -1], [0.125, 0, -1]):
        origin = at - 3.0 * np.asarray(direction)
        _, hits = cast(acceleration, origin, direction)
        assert (hits.triangle >= 0).all()
        np.testing.assert_allclose(hits.t, 3 * np.linalg.norm(direction), rtol=1e-6)


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_rays_from_a_surface_do_not_meet_it_again(offset):
    rng = np.random.default_rng(3)
    p, t = sphere(40, 60)
    p *= np.float32(2.0)
    normals = p / np.linalg.norm(p, axis=1, keepdims=True)
    geometry, acceleration = accelerate(
        Group(
            "root",
            [],
            [instance(Group("ball", [Mesh("ball", p, t, normals=normals)]), shifted(offset, offset, 0))],
        )
    )
    n = 20000
    direction = rng.normal(size=(n, 3))
    origin = np.array([offset, offset, 0]) - 10 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    origin += rng.uniform(-1.9, 1.9, (n, 3))
    rays, hits = cast(acceleration, origin, direction)
    frames = surface.allocate_frames(n)
    surface.frames(geometry, rays, hits, frames)
    k = np.flatnonzero(hits.triangle >= 0)
    assert len(k) > n // 4
    out = rng.normal(size=(len(k), 3))
    up = frames.geometric_normal[k].astype(np.float64)
    height = (out * up).sum(1, keepdims=True)
    out += np.where(height < 0, -2 * height, 0) * up  # away from the (convex) ball
    again, second = cast(
        acceleration,
        frames.position[k],
        out,
        t_min=frames.offset[k],
        skip_triangle=hits.triangle[k],
        skip_path=hits.path[k],
    )
    assert (second.triangle >= 0).sum() == 0
    # inwards, every ray leaves through the other side
    _, through = cast(
        acceleration,
        frames.position[k],
        rays.direction[k],
        t_min=frames.offset[k],
        skip_triangle=hits.triangle[k],
        skip_path=hits.path[k],
    )
    assert (through.triangle >= 0).mean() > 0.999


def test_skips_a_triangle_of_one_placement_only():
    root = Group(
        "root", [], [Instances((Group("g", [square()]),), np.stack([shifted(z=z)[:3] for z in (0.0, -1.0)]))]
    )
    _, acceleration = accelerate(root)
    _, first = cast(acceleration, [0.1, 0, 1], [0, 0, -1])
    assert first.t[0] == 1.0
    _, second = cast(
        acceleration, [0.1, 0, 1], [0, 0, -1], skip_triangle=first.triangle[0], skip_path=first.path[0]
    )
    assert second.t[0] == 2.0 and second.triangle[0] == first.triangle[0] and second.path[0] != first.path[0]


def test_range_of_a_ray_is_open_and_exact():
    _, acceleration = accelerate(Group("root", [square(), square(-1e-7)]))
    for t_min, t_max, expected in (
        (0, 1.0, np.inf),
        (1.0, 2.0, 1 + 1e-7),
        (0, 1 + 1e-9, 1.0),
        (1.1, 9.0, np.inf),
    ):
        _, hits = cast(acceleration, [0.3, 0.1, 1], [0, 0, -1], t_min=t_min, t_max=t_max)
        assert (
            hits.t[0] == pytest.approx(expected, rel=1e-12, abs=1e-12)
            or np.isinf(expected)
            and np.isinf(hits.t[0])
        )


def test_bad_rays_hit_nothing():
    _, acceleration = accelerate(Group("root", [square()]))
    rays, hits = scene_rays(np.full((6, 3), [0.1, 0, 1.0]), [0, 0, -1])
    rays.direction[0] = 0
    rays.direction[1] = np.nan
    rays.origin[2] = np.inf
    rays.t_max[3] = -1
    rays.t_max[4] = np.nan
    walk.intersect(acceleration, rays, hits)
    assert (hits.triangle[:5] == -1).all() and np.isinf(hits.t[:5]).all() and hits.triangle[5] >= 0


def test_bad_geometry_is_named_and_the_rest_is_hit():
    p = np.array(
        [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0]],
        np.float32,
    )
    t = np.array(
        [[0, 1, 2], [0, 2, 3], [0, 1, 4], [1, 2, 5], [0, 0, 1], [6, 6, 6], [0, 6, 2], [0, 1, 2]], np.int32
    )
    broken = Mesh("broken", p, t)
    nothing = Mesh("nothing", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    only_bad = Mesh("only bad", p[4:6], np.array([[0, 1, 1]], np.int32))
    flat = np.eye(4)
    flat[2, 2] = 0
    infinite = shifted(np.inf)
    transforms = np.stack([m[:3] for m in (shifted(), flat, infinite, shifted(5))])
    root = Group(
        "root",
        [nothing, only_bad],
        [
            Instances((Group("g", [broken]),), transforms, name="twigs"),
            instance(Group("hollow")),
            instance(Group("x", [nothing])),
        ],
    )
    geometry, acceleration = accelerate(root)
    text = "\n".join(geometry.warnings)
    assert "'broken'" in text and "'nothing'" in text and "'only bad'" in text
    assert "twigs" in text and "2 of 4" in text and "number 1" in text
    _, hits = cast(acceleration, [[0.5, 0, 1], [5.5, 0, 1], [40, 0, 1]], [0, 0, -1])
    assert (hits.triangle >= 0).tolist() == [True, True, False]


def test_an_empty_scene_hits_nothing():
    _, acceleration = accelerate(Group("root"))
    _, hits = cast(acceleration, [0, 0, 0], [0, 0, 1])
    assert hits.triangle[0] == -1


def test_malformed_batches_are_refused():
    leaf = Group("leaf", [square()])
    for batch in (
        Instances((leaf,), np.zeros((2, 4, 4)), name="wrong shape"),
        Instances(
            (leaf,), np.zeros((3, 3, 4)), group_index=np.array([0, 1, 0], np.int32), name="wrong group"
        ),
        Instances((leaf,), np.zeros((3, 3, 4)), seed=np.zeros(2, np.uint32), name="wrong count"),
    ):
        with pytest.raises(SceneError, match=batch.name):
            compile_geometry(Scene(Group("root", [], [batch])))


def test_visibility_and_holdout_combine_along_the_path():
    leaf = Group("leaf", [square()])
    middle = Group("middle", [], [instance(leaf, visibility=CAMERA | SHADOW | HOLDOUT)])
    root = Group("root", [], [instance(middle, visibility=CAMERA | GLOSSY)])
    _, acceleration = accelerate(root)
    for bit, seen in ((CAMERA, True), (GLOSSY, False), (SHADOW, False), (255, True), (HOLDOUT, False)):
        _, hits = cast(acceleration, [0.1, 0, 1], [0, 0, -1], visibility=bit)
        assert (hits.triangle[0] >= 0) == seen
    _, hits = cast(acceleration, [0.1, 0, 1], [0, 0, -1], visibility=CAMERA)
    assert hits.holdout[0]
    _, hits = cast(accelerate(Group("root", [square()]))[1], [0.1, 0, 1], [0, 0, -1], visibility=SHADOW)
    assert hits.triangle[0] >= 0 and not hits.holdout[0]


def test_what_instances_say_reaches_the_hit():
    leaf = Group("leaf", [square()])
    inner = Instances(
        (leaf,),
        np.stack([shifted(3.0 * i)[:3] for i in range(3)]),
        object_index=np.array([7, -1, 9], np.int32),
        seed=np.array([0, 5, 6], np.uint32),
        color=np.array([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1]], np.float32),
    )
    middle = Group("middle", [], [inner])
    root = Group(
        "root", [], [instance(middle, shifted(y=1), object_index=4, seed=11), instance(middle, shifted(y=9))]
    )
    geometry, acceleration = accelerate(root)
    _, hits = cast(acceleration, [[0.1, 1, 1], [3.1, 1, 1], [6.1, 9, 1], [3.1, 9, 1]], [0, 0, -1])
    assert hits.object_index.tolist() == [7, 4, 9, 0]
    assert (
        hits.seed[0] == 11 and hits.seed[2] == 6 and hits.seed[3] == 5 and len(set(hits.seed.tolist())) == 4
    )
    np.testing.assert_array_equal(hits.color[:3], inner.color)
    assert hits.instance.tolist() == [0, 1, 2, 1] and len(set(hits.path.tolist())) == 4
    np.testing.assert_allclose(hits.world_from_part[2], shifted(6, 9)[:3])


def test_several_groups_in_one_batch():
    groups = tuple(Group(f"g{i}", [square(z=-float(i))]) for i in range(3))
    batch = Instances(
        groups,
        np.stack([shifted(3.0 * i)[:3] for i in range(4)]),
        group_index=np.array([2, 0, 1, 2], np.int32),
    )
    _, acceleration = accelerate(Group("root", [], [batch]))
    _, hits = cast(acceleration, [[3.0 * i + 0.1, 0, 1] for i in range(4)], [0, 0, -1])
    assert hits.t.tolist() == [3, 1, 2, 3]


def test_shadows_stop_at_opaque_triangles_only():
    glass, wall = Material("glass"), Material("wall")
    slots = np.array([0, 1], np.int32)  # the lower right half is glass, the upper left one wall
    mixed = square(name="mixed", materials=(glass, wall), material_index=slots)
    root = Group("root", [square(1.0, materials=(glass,)), mixed, square(-1.0, materials=(None,))])
    geometry, acceleration = accelerate(root)
    origin = [[0.5, -0.5, 2], [-0.5, 0.5, 2], [0.5, -0.5, 0.5], [3, 0, 2]]
    rays, hits = scene_rays(origin, [0, 0, -1], t_max=2.5)
    walk.shadow(acceleration, rays, hits)
    assert hits.triangle.tolist() == [-2, -2, -2, -1]  # everything is opaque until told otherwise
    clear = set_opaque(acceleration, np.array([m is not glass for m in geometry.materials]))
    rays.t_max[2] = 1.0  # ends before the wall
    walk.shadow(clear, rays, hits)
    assert hits.triangle[1] == -2 and hits.triangle[3] == -1
    assert hits.triangle[0] == 0 and hits.t[0] == 1.0  # the nearer of two glass triangles
    assert hits.triangle[2] == 2 and hits.t[2] == 0.5
    rays.t_max[:] = 9.0  # now the wall behind is within reach
    walk.shadow(clear, rays, hits)
    assert hits.triangle.tolist() == [-2, -2, -2, -1]
    walk.shadow(acceleration, rays, hits)
    assert hits.triangle[0] == -2
    with pytest.raises(ValueError):
        set_opaque(acceleration, np.ones(7, np.bool_))


@settings(max_examples=10)
@given(seeds)
def test_shadow_rays_agree_with_closest_hits(seed):
    rng = np.random.default_rng(seed)
    glass, wall = Material("glass"), Material("wall")
    mesh = random_mesh(
        rng, 30, materials=(glass, wall), material_index=rng.integers(0, 2, 30).astype(np.int32)
    )
    geometry, acceleration = accelerate(nest(rng, 2, Group("leaf", [mesh]), 4))
    acceleration = set_opaque(acceleration, np.array([m is wall for m in geometry.materials]))
    origin = rng.normal(size=(200, 3)) * 10
    rays, hits = scene_rays(origin, rng.normal(size=(200, 3)) * 3 - origin)
    walk.shadow(acceleration, rays, hits)
    for i in range(200):  # march through all closest hits
        rest, near = scene_rays(rays.origin[i], rays.direction[i])
        first, blocked = None, False
        for _ in range(100):
            walk.intersect(acceleration, rest, near)
            if near.triangle[0] < 0:
                break
            if mesh.material_index[near.triangle[0]]:
                blocked = True
                break
            first = (near.triangle[0], near.t[0]) if first is None else first
            rest.t_min[0] = near.t[0] * (1 + 1e-12)
        if blocked:
            assert hits.triangle[i] == -2
        elif first is None:
            assert hits.triangle[i] == -1
        else:
            assert hits.triangle[i] == first[0] and hits.t[i] == pytest.approx(first[1], rel=1e-9)


def test_same_hits_in_any_number_of_threads():
    rng = np.random.default_rng(5)
    geometry, acceleration = accelerate(nest(rng, 3, Group("leaf", [random_mesh(rng, 60)]), 6))
    origin = rng.normal(size=(4000, 3)) * 12
    rays, hits = cast(acceleration, origin, rng.normal(size=(4000, 3)) * 4 - origin)
    again = build_acceleration(compile_geometry(Scene(geometry.groups[-1])))
    other = allocate_hits(4000)
    work = [
        threading.Thread(target=walk.intersect, args=(again, rays, other, i, i + 500))
        for i in range(0, 4000, 500)
    ]
    for thread in work:
        thread.start()
    for thread in work:
        thread.join()
    found = hits.triangle >= 0
    assert found.mean() > 0.2
    for name, a, b in zip(hits._fields, hits, other, strict=True):
        rows = slice(None) if name in ("t", "triangle") else found
        np.testing.assert_array_equal(a[rows], b[rows], err_msg=name)


def test_a_forest_of_ten_to_the_fifteen():
    rng = np.random.default_rng(6)
    p, t = sphere(5, 6)
    group, size, n = Group("leaf", [Mesh("ball", p, t)]), 1.0, 1000
    for level in range(5):
        m = np.zeros((n, 3, 4))
        turn = rng.uniform(0, 2 * np.pi, n)
        m[:, 0, 0] = m[:, 1, 1] = np.cos(turn)
        m[:, 0, 1], m[:, 1, 0], m[:, 2, 2] = -np.sin(turn), np.sin(turn), 1
        k = np.arange(n)
        m[:, 0, 3], m[:, 1, 3] = 2.2 * size * (k % 32 - 15.5), 2.2 * size * (k // 32 - 15.5)
        group, size = Group(f"level {level}", [], [Instances((group,), m)]), size * 50
    geometry, acceleration = accelerate(group)
    assert geometry.instanced_triangles == len(t) * 1000**5 and geometry.depth == 5
    assert sum(a.nbytes for a in acceleration.arrays if isinstance(a, np.ndarray)) < 2_000_000
    origin = np.stack([rng.uniform(-1, 1, 2000), rng.uniform(-1, 1, 2000), np.full(2000, 1e3)], 1) * [
        1e7,
        1e7,
        1,
    ]
    rays, hits = cast(acceleration, origin, rng.normal(size=(2000, 3)) * 0.2 - [0, 0, 1])
    frames = surface.allocate_frames(2000)
    surface.frames(geometry, rays, hits, frames)
    k = hits.triangle >= 0
    assert 0.01 < k.mean() < 1 and len(set(hits.path[k].tolist())) == k.sum()
    # at 10^7 metres from the origin, triangles are still met to within a micrometre
    along = rays.origin + rays.direction * hits.t[:, None]
    assert np.abs(along - frames.position)[k].max() < 1e-6


@settings(max_examples=20)
@given(st.integers(1, 300), seeds, st.booleans())
def test_every_triangle_lies_in_exactly_one_leaf_within_its_boxes(count, seed, clustered):
    rng = np.random.default_rng(seed)
    mesh = random_mesh(rng, count)
    if clustered:  # many triangles at one place cannot be told apart by position
        mesh.positions[:] = mesh.positions[rng.integers(0, 3, len(mesh.positions))]
    geometry, acceleration = accelerate(Group("root", [mesh]))
    a = acceleration.arrays
    if a.shape_root[0] == -(2**31):
        return
    seen = []

    def visit(node, lower, upper):
        for c in range(8):
            child = int(a.children[node, c])
            lo, hi = a.boxes[node, [c, 8 + c, 16 + c]], a.boxes[node, [24 + c, 32 + c, 40 + c]]
            if child == -(2**31):
                assert (lo == np.inf).all() and (hi == -np.inf).all()
                continue
            assert (lo >= lower).all() and (hi <= upper).all()
            if child >= 0:
                visit(child, lo, hi)
            else:
                for triangle in a.block_triangles[~child]:
                    if triangle >= 0:
                        seen.append(int(triangle))
                        p = geometry.shapes[0].positions[mesh.triangles[triangle]]
                        assert (p >= lo).all() and (p <= hi).all()

    visit(int(a.shape_root[0]), np.full(3, -np.inf), np.full(3, np.inf))
    distinct = [
        i
        for i, t in enumerate(geometry.shapes[0].positions[mesh.triangles])
        if len(np.unique(t, axis=0)) == 3
    ]
    assert sorted(seen) == distinct


def test_arrays_are_borrowed_and_shared():
    positions, triangles = sphere()
    m = random_transforms(np.random.default_rng(0), 10)
    a, b = Mesh("a", positions, triangles), Mesh("b", positions, triangles, materials=(Material("other"),))
    group = Group("g", [a, b])
    geometry = compile_geometry(Scene(Group("root", [a], [Instances((group,), m), Instances((group,), m)])))
    assert (
        len(geometry.parts) == 2 and len(geometry.shapes) == 1 and geometry.unique_triangles == len(triangles)
    )
    assert geometry.tables.positions[0] == positions.ctypes.data
    assert geometry.instances.transforms.tolist() == [m.ctypes.data] * 2
    assert Fraction(geometry.instanced_triangles, len(triangles)) == 1 + 2 * 2 * 10
    assert VISIBLE == 63
