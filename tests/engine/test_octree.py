"""Octrees over groups' items: depth-first intervals, boxes, levels, and what is left out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine import Group, Mesh, Scene
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.hierarchy.octree import (
    CHAIN,
    LEAF_TRIANGLES,
    MAX_LEVEL,
    Octree,
    build_octree,
    triangle_corners,
)
from pointmr_engine.scene.group import SHADOW, Instances, instance
from tests.engine.instanced import random_mesh, random_transforms


def octree_of(root: Group) -> Octree:
    return build_octree(compile_geometry(Scene(root)))


def nested(seed: int, triangles: int, placements: int, size: float = 1.0) -> Group:
    """Triangles of all sizes beside two kinds of placed groups."""
    rng = np.random.default_rng(seed)
    small = Group("small", [random_mesh(rng, 5, 0.01)])
    twigs = Group("twigs", [random_mesh(rng, 3, 0.1)], [Instances((small,), random_transforms(rng, 4))])
    groups = (small, twigs)
    which = rng.integers(0, 2, placements).astype(np.int32)
    batch = Instances(groups, random_transforms(rng, placements, (1e-3, 2.0)), which)
    mesh = random_mesh(rng, triangles)
    mesh.positions *= (size * np.exp(rng.uniform(-6, 1, len(mesh.positions))))[:, None]
    return Group("root", [mesh] if triangles else [], [batch] if placements else [])


def boxes_of(octree: Octree, g: int) -> np.ndarray:
    """(M, 6) float64 boxes of a group's items, relative to its centre, from their corners in float64."""
    a, geometry = octree.arrays, octree.geometry
    root = a.group_root[g]
    boxes = []
    for kind, index in a.item[a.items[root, 0] : a.items[root, 3]].tolist():
        if kind >= 0:
            shape = geometry.shapes[geometry.tables.shape[kind]]
            corners = shape.positions[shape.triangles[index]].astype(np.float64) + shape.center
        else:
            batch = geometry.batches[-1 - kind]
            child = batch.groups[0 if batch.group_index is None else batch.group_index[index]]
            c = next(i for i, group in enumerate(geometry.groups) if group is child)
            ends = np.stack([octree.lower[c], octree.upper[c]])
            grid = np.array(
                [[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
            )
            corners = grid @ batch.transforms[index, :, :3].T + batch.transforms[index, :, 3]
        corners = corners - a.group_center[g]
        boxes.append([*corners.min(0), *corners.max(0)])
    return np.array(boxes)


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(0, 300), st.integers(0, 60), st.sampled_from([1e-6, 1.0, 1e6]))
def test_a_tree_of_intervals_and_boxes(seed, triangles, placements, size):
    if not triangles + placements:
        return
    octree = octree_of(nested(seed, triangles, placements, size))
    a = octree.arrays
    g = len(octree.geometry.groups) - 1
    root = a.group_root[g]
    end = len(a.box)
    first_item = a.items[root, 0]
    assert a.items[root, 3] - first_item == triangles + placements
    assert end - root <= CHAIN + 2 * (triangles + placements) * 4 + 1
    boxes = boxes_of(octree, g)
    # every item once
    assert len(np.unique(a.item[first_item:], axis=0)) == triangles + placements
    visited = 0
    for n in range(root, end):
        first, large, own, last = a.items[n]
        assert first <= large <= own <= last
        child, children = a.child[n]
        inside = boxes[first - first_item : last - first_item]
        slack = 1e-9 * size
        assert (a.box[n, :3] <= inside[:, :3].min(0) + slack).all()
        assert (a.box[n, 3:] >= inside[:, 3:].max(0) - slack).all()
        # the children's intervals follow the own items, without a gap
        at = own
        for c in range(child, child + children):
            assert a.items[c, 0] == at and a.items[c, 3] > at and a.level[c] == a.level[n] + 1
            assert a.side[c] == a.side[n] / 2
            at = a.items[c, 3]
        assert at == last
        visited += own - first
        # own items belong here: large ones first; small ones only where nothing is split any further
        levels = a.item_level[first:own]
        assert (levels[: large - first] <= a.level[n]).all() and (levels[large - first :] > a.level[n]).all()
        if large < own:
            few = last - first <= LEAF_TRIANGLES and (a.item[first:last, 0] >= 0).all()
            assert children == 0 and (few or last - first == 1 or a.level[n] == MAX_LEVEL)
        # items that are not the root's are no larger than a cell of their level
        assert (a.item_level[own:last] > a.level[n]).all()
    assert visited == triangles + placements


@settings(max_examples=10)
@given(st.integers(0, 10**6))
def test_levels_fit_sizes(seed):
    octree = octree_of(nested(seed, 200, 0))
    a = octree.arrays
    g = len(octree.geometry.groups) - 1
    extent = (lambda b: (b[:, 3:] - b[:, :3]).max(1))(boxes_of(octree, g))
    cell = np.ldexp(a.group_side[g], CHAIN - a.item_level.astype(int))
    fits = (a.item_level > 0) & (a.item_level < MAX_LEVEL)
    # a triangle counts by its area, or by half its length where that is more
    assert (extent[fits] <= 2.0 * cell[fits] * (1 + 1e-6)).all()


def test_broken_triangles_are_left_out():
    mesh = Mesh(
        "broken",
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [np.nan, 0, 0], [np.inf, 0, 0], [3e12, 0, 0]], np.float32),
        np.array([[0, 1, 2], [0, 1, 3], [0, 4, 2], [1, 1, 1], [0, 1, 5]], np.int32),
    )
    octree = octree_of(Group("root", [mesh]))
    assert octree.arrays.item.tolist() == [[0, 0]]
    assert np.isfinite(octree.arrays.box).all()
    assert (octree.upper[-1] - octree.lower[-1]).tolist() == [1, 1, 0]


def test_placements_that_show_nothing_are_left_out():
    rng = np.random.default_rng(1)
    child, empty = Group("child", [random_mesh(rng)]), Group("empty")
    flat = np.eye(4)
    flat[2, 2] = 0.0
    root = Group(
        "root",
        [],
        [instance(child), instance(child, flat), instance(empty), instance(child, visibility=SHADOW)],
    )
    octree = octree_of(root)
    a = octree.arrays
    g = len(octree.geometry.groups) - 1
    first, end = a.items[a.group_root[g]][[0, 3]]
    assert a.item[first:end].tolist() == [[-1, 0]]
    assert a.group_root[[group.name for group in octree.geometry.groups].index("empty")] == -1


@pytest.mark.parametrize(
    "root",
    [Group("nothing"), Group("no triangles", [Mesh("m", np.zeros((3, 3)), np.zeros((0, 3), np.int32))])],
)
def test_groups_without_anything(root):
    octree = octree_of(root)
    assert len(octree.arrays.box) == 0 and octree.arrays.group_root.tolist() == [-1]
    assert len(triangle_corners(octree)) == 8


def test_one_point_repeated_and_one_place_for_all_end():
    """What no cell can tell apart ends at the finest level, in one leaf."""
    corners = np.array([[0, 0, 0], [1e-9, 0, 0], [0, 1e-9, 0], [1, 1, 1], [1, 2, 1], [1, 1, 2]], np.float32)
    mesh = Mesh("heap", corners, np.array([[0, 1, 2]] * 50 + [[3, 4, 5]], np.int32))
    octree = octree_of(Group("root", [mesh]))
    a = octree.arrays
    assert a.items[0, 3] == 51 and a.level.max() <= MAX_LEVEL
    assert len(a.box) < 3 * MAX_LEVEL


def test_corners_are_those_of_the_items():
    octree = octree_of(nested(3, 50, 10))
    corners = triangle_corners(octree)
    g = len(octree.geometry.groups) - 1
    first = octree.arrays.items[octree.arrays.group_root[g], 0]
    triangles = octree.arrays.item[first:, 0] >= 0
    boxes = boxes_of(octree, g)[triangles]
    own = corners[first:-8][triangles].reshape(-1, 3, 3)
    np.testing.assert_allclose(own.min(1), boxes[:, :3], atol=1e-5)
    np.testing.assert_allclose(own.max(1), boxes[:, 3:], atol=1e-5)


def test_cancel_while_building():
    def stop(fraction):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_octree(compile_geometry(Scene(nested(1, 10, 3))), stop)
