"""Boxes of placed groups hold all that is in them, and hardly more, however deep they are nested and turned."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine.hierarchy.bvh_build import build_wide
from pointmr_engine.hierarchy.covers import BOXES, FEWEST, fewer, top_boxes, turned
from pointmr_engine.hierarchy.leaves import triangle_boxes
from pointmr_engine.scene.group import Group, Instances
from pointmr_engine.scene.mesh import Mesh
from tests.engine.instanced import accelerate, random_mesh, random_transforms, sphere


def root_box(root: Group) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of what the hierarchy's root holds, in world space."""
    _, acceleration = accelerate(root)
    arrays = acceleration.arrays
    boxes = arrays.boxes[arrays.group_root[-1]].reshape(6, 8)
    return boxes[:3].min(1) + arrays.group_center[-1], boxes[3:].max(1) + arrays.group_center[-1]


def world_points(group: Group, matrix=None) -> np.ndarray:
    """(N, 3) all vertices below a group, flattened."""
    matrix = np.eye(4)[:3] if matrix is None else matrix
    found = [m.positions.astype(float) @ matrix[:, :3].T + matrix[:, 3] for m in group.meshes]
    for batch in group.instances:
        for i, own in enumerate(batch.transforms):
            child = batch.groups[0 if batch.group_index is None else batch.group_index[i]]
            both = np.concatenate(
                [matrix[:, :3] @ own[:, :3], (matrix[:, :3] @ own[:, 3] + matrix[:, 3])[:, None]], 1
            )
            found.append(world_points(child, both))
    return np.concatenate(found)


def tree_of(seed: int, levels: int, items: int) -> Group:
    rng = np.random.default_rng(seed)
    group = Group("leaf", [random_mesh(rng, 40), random_mesh(rng, 3, center=(2.0, 0.0, 0.0))])
    for level in range(levels):
        group = Group(f"level {level}", instances=[Instances((group,), random_transforms(rng, items))])
    return group


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.integers(1, 4), st.sampled_from([2, 5, 12]))
def test_boxes_of_nested_groups_hold_every_vertex(seed, levels, items):
    if items == 12 and levels > 2:
        levels = 2
    root = tree_of(seed, levels, items)
    low, high = root_box(root)
    points = world_points(root)
    assert (points.min(0) >= low).all() and (points.max(0) <= high).all()


def test_turning_a_ball_again_and_again_hardly_makes_its_box_grow():
    positions, triangles = sphere(24, 32)
    group = Group("ball", [Mesh("ball", positions, triangles)])
    turn = random_transforms(np.random.default_rng(3), 2, mirror=False)
    turn[:, :, :3] /= np.linalg.norm(turn[:, :, :3], axis=1, keepdims=True)
    turn[:, :, 3] = 0.0
    box_of_box = np.ones(3)  # half its sides
    for level in range(3):
        group = Group(f"turned {level}", instances=[Instances((group,), turn)])
        box_of_box = (np.abs(turn[:, :, :3]) @ box_of_box).max(0)
        low, high = root_box(group)
        assert (0.5 * (high - low)).max() < (1.35, 1.75, 2.35)[level] < 0.8 * box_of_box.max()


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.sampled_from([FEWEST, 20, BOXES]), st.integers(1, 3000))
def test_the_top_of_a_hierarchy_is_a_few_boxes_that_hold_all(seed, limit, count):
    rng = np.random.default_rng(seed)
    mesh = random_mesh(rng, count)
    prims = triangle_boxes(mesh.positions.astype(np.float32), mesh.triangles)
    boxes, children = np.empty((count + 16, 48), np.float32), np.empty((count + 16, 8), np.int32)
    build_wide(prims, 8, 0, 0, boxes, children, np.empty((count + 16, 2), np.int32))
    rows, center = np.empty((limit, 6)), np.array([5.0, -3.0, 1e3])
    rows = rows[: top_boxes(boxes, children, 0, center, limit, rows)]
    corners = mesh.positions[mesh.triangles].astype(np.float32) + center
    inside = (np.abs(corners.mean(1)[:, None] - rows[None, :, :3]) <= rows[None, :, 3:] + 1e-9).all(2)
    assert inside.any(1).all()
    assert len(rows) > limit - 7 or len(rows) >= min(count // 8, limit - 7)


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 300), st.integers(1, 64))
def test_fewer_boxes_hold_as_much_and_no_more_than_all(seed, count, limit):
    rng = np.random.default_rng(seed)
    rows = np.concatenate([rng.normal(size=(count, 3)), rng.random((count, 3))], 1)
    rows = np.repeat(rows, rng.integers(1, 3, count), 0)
    out = fewer(rows, limit)
    assert len(out) == min(limit, len(rows))
    inside = np.abs(rows[:, None, :3] - out[None, :, :3]) + rows[:, None, 3:] <= out[None, :, 3:] + 1e-9
    assert inside.all(2).any(1).all()
    for sign in (-1, 1):
        edges = [(sign * r[:, :3] + r[:, 3:]).max(0) for r in (rows, out)]
        np.testing.assert_allclose(*edges, atol=1e-12)


def test_neighbours_become_one():
    rows = np.zeros((64, 6))
    rows[:, 3:] = 0.01
    rows[:32, 0], rows[32:, 0] = np.linspace(0, 1, 32), np.linspace(100, 101, 32)
    assert (fewer(rows[::-1], 2)[:, 3] < 0.6).all()


def test_a_turned_box_holds_its_corners():
    rng = np.random.default_rng(8)
    rows = np.concatenate([rng.normal(size=(9, 3)), rng.random((9, 3))], 1)
    for matrix in random_transforms(rng, 4):
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        corners = rows[:, None, :3] + signs * rows[:, None, 3:]
        moved = corners @ matrix[:, :3].T + matrix[:, 3]
        out = turned(rows, matrix)
        np.testing.assert_allclose(out[:, :3] - out[:, 3:], moved.min(1), atol=1e-12)
        np.testing.assert_allclose(out[:, :3] + out[:, 3:], moved.max(1), atol=1e-12)
