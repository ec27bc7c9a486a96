"""What cones meet, against exact rays: nearest surfaces, fragments' masks, hits that can be shaded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from instanced import Flat, accelerate, nest, random_mesh
from test_cones import EXACT, blocked, forest, sheet, some_cones

from pointmr_engine.hierarchy.prefilter import prefilter
from pointmr_engine.multires.cones.cone_hits import Merging, allocate_fragments, gather
from pointmr_engine.multires.cones.cone_space import Style
from pointmr_engine.multires.cones.cones import sub_rays
from pointmr_engine.raytracing import surface, walk
from pointmr_engine.raytracing.rays import Hits, Rays, allocate_hits, allocate_rays
from pointmr_engine.scene.group import Group, Instances, instance

seeds = st.integers(0, 2**32 - 1)
BITS = np.arange(64, dtype=np.uint64)


def met(acceleration, cones, style=Style(), merging=Merging()):  # noqa: B008
    """(fragments, masks, rays, hits, escaped): the rows that were written; masks (F, 64), escaped (N, 64) bool."""
    n = len(cones.origin)
    room = merging.most * n
    fragments, rays, hits = allocate_fragments(room), allocate_rays(room), allocate_hits(room)
    escaped = np.zeros(n, np.uint64)
    count = gather(acceleration, prefilter(acceleration), cones, fragments, rays, hits, escaped, style=style,
                   merging=merging)  # fmt: skip
    fragments, rays, hits = (
        type(x)(*(np.ascontiguousarray(c[:count]) for c in x)) for x in (fragments, rays, hits)
    )
    masks = (fragments.mask[:, None] >> BITS) & np.uint64(1) != 0
    return fragments, masks, rays, hits, (escaped[:, None] >> BITS) & np.uint64(1) != 0


def nearest(acceleration, cones) -> tuple[Hits, np.ndarray]:
    """Hits of the 64 sub-rays of all cones, one after the other, and how much longer rays are than their t."""
    origin, direction, stretch = sub_rays(cones)
    rays, hits = allocate_rays(stretch.size), allocate_hits(stretch.size)
    rays.origin[:], rays.direction[:] = origin.reshape(-1, 3), direction.reshape(-1, 3)
    rays.t_min[:] = (cones.t_min[:, None] * stretch).ravel()
    rays.t_max[:] = (cones.t_max[:, None] * stretch).ravel()
    walk.intersect(acceleration, rays, hits)
    return hits, stretch


def consistent(geometry, cones, fragments, masks, rays, hits, escaped):
    """Masks of a cone's fragments and what escapes are all sub-rays, each once; hits lie on their triangles."""
    total = escaped.astype(int)
    np.add.at(total, fragments.cone, masks.astype(int))
    assert (total == 1).all() and masks.any(1).all()
    assert (hits.triangle >= 0).all()
    frames = surface.allocate_frames(len(hits.t))
    surface.frames(geometry, rays, hits, frames, 0, len(hits.t))
    away = np.abs(rays.origin + rays.direction * hits.t[:, None] - frames.position).max(1)
    reach = np.abs(rays.origin).max(1) + hits.t
    assert (away <= 1e-5 * reach).all()
    np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=1), 1)
    return frames


@settings(max_examples=20)
@given(seeds, st.integers(0, 2), st.sampled_from([0.0, 1e6]))
def test_large_triangles_are_met_where_exact_rays_meet_them(seed, depth, offset):
    rng = np.random.default_rng(seed)
    inner = nest(rng, depth, Group("leaf", [random_mesh(rng, 15)]), 3, scale=(0.3, 1.0))
    far = np.eye(4)
    far[:3, 3] = offset
    geometry, acceleration = accelerate(Group("root", [], [instance(inner, far)]))
    corners = Flat(geometry).corners
    n = 20
    aimed = corners[rng.integers(0, len(corners), n)]
    aim, reach = aimed.mean(1), np.ptp(aimed, axis=1).max(1)[:, None]
    origin = aim + rng.normal(size=(n, 3)) * reach * rng.choice([2.0, 5.0], (n, 1))
    cones = some_cones(origin, aim - origin, rng.choice([0.02, 0.3], (n, 2)), t_max=20 * reach[:, 0])
    merging = Merging(most=64, gap=0.0)
    fragments, masks, rays, hits, escaped = met(acceleration, cones, EXACT, merging)
    consistent(geometry, cones, fragments, masks, rays, hits, escaped)
    exact, stretch = nearest(acceleration, cones)
    t = exact.t.reshape(n, 64) / stretch
    assert ((t < np.inf) == ~escaped).mean() > 0.999
    within = (t[fragments.cone] >= fragments.depth[:, :1] * (1 - 1e-5)) & (
        t[fragments.cone] <= fragments.depth[:, 1:] * (1 + 1e-5)
    )
    assert (~within[masks]).sum() <= 1 + masks.sum() / 1000  # an edge, which either triangle may have
    # every hit is that of a sub-ray of its fragment: same triangle, same placement
    for row in range(len(hits.t)):
        at = 64 * fragments.cone[row] + np.flatnonzero(masks[row])
        same = (exact.triangle[at] == hits.triangle[row]) & (exact.path[at] == hits.path[row])
        closest = np.abs(exact.t[at] - hits.t[row]) < 1e-5 * (hits.t[row] + offset * 1e-6)
        assert (same & closest).any() or len(at) <= 2


@pytest.mark.parametrize("spread", [0.1, 0.4])
@pytest.mark.parametrize("exact_look", [True, False])
def test_fragments_of_a_forest_are_as_near_as_exact_hits(spread, exact_look):
    off = []
    for seed in range(6):  # what 150 cones meet is as near to 3 % only
        rng = np.random.default_rng(seed)
        geometry, acceleration = accelerate(forest(rng))
        origin = np.concatenate([rng.uniform(-6, 6, (150, 2)), np.full((150, 1), 0.01)], 1)
        cones = some_cones(origin, rng.normal(size=(150, 3)) * [0.5, 0.5, 0] + [0, 0, 1], spread)
        fragments, masks, rays, hits, escaped = met(acceleration, cones, merging=Merging(exact=exact_look))
        consistent(geometry, cones, fragments, masks, rays, hits, escaped)
        exact, stretch = nearest(acceleration, cones)
        found = np.isfinite(exact.t)
        assert abs((~escaped).mean() - found.mean()) < 0.02
        np.testing.assert_array_equal(np.bincount(fragments.cone, minlength=150) <= 8, True)
        off.append(np.average(1 / hits.t, weights=masks.sum(1)) / (1 / exact.t[found]).mean() - 1)
    assert abs(np.mean(off)) < (0.04 if exact_look else 0.1)


def test_one_surface_is_one_fragment_and_another_is_its_own():
    near, far = sheet(60, 60, (-2, 0), (-2, 2), 2.0), sheet(60, 60, (-9, 9), (-9, 9), 6.0)
    geometry, acceleration = accelerate(Group("root", [near, far]))
    cones = some_cones([0, 0, 0], [0, 0, 1], 0.4)
    cones.axes[:] = np.eye(3)
    fragments, masks, rays, hits, escaped = met(acceleration, cones)
    frames = consistent(geometry, cones, fragments, masks, rays, hits, escaped)
    assert len(masks) == 2 and not escaped.any()
    np.testing.assert_array_equal(np.sort(frames.position[:, 2].round(4)), [2, 6])
    front = masks[np.argmin(hits.t)].reshape(8, 8)
    np.testing.assert_array_equal(front, np.broadcast_to(np.arange(8) < 4, (8, 8)))


def test_as_many_fragments_as_are_allowed():
    rng = np.random.default_rng(0)
    geometry, acceleration = accelerate(Group("root", [random_mesh(rng, 300, 1.0, (0, 0, 6.0))]))
    cones = some_cones([0, 0, 0], [0, 0, 1], 0.3)
    counts = []
    for most in (1, 2, 64):
        result = met(acceleration, cones, EXACT, Merging(most=most, gap=0.0))
        consistent(geometry, cones, *result)
        counts.append(len(result[1]))
        np.testing.assert_array_equal(~result[4], blocked(acceleration, cones, EXACT))
    assert counts[:2] == [1, 2] and counts[2] > 8
    with pytest.raises(ValueError, match="room"):
        fragments, rays, hits = allocate_fragments(1), allocate_rays(1), allocate_hits(1)
        gather(acceleration, prefilter(acceleration), cones, fragments, rays, hits, np.zeros(1, np.uint64))


def test_points_of_whole_groups_become_hits_in_their_instances():
    rng = np.random.default_rng(0)
    leaf = Group("leaf", [random_mesh(rng, 20, 0.01)])
    pair = Group("pair", [], [instance(leaf, np.eye(4)), instance(leaf, np.diag([1.0, -1.0, 2.0, 1.0]))])
    placed = np.zeros((3000, 3, 4))
    placed[:, [0, 1, 2], [0, 1, 2]] = 1.0
    placed[:, :, 3] = rng.uniform(-1, 1, (3000, 3)) + [0, 0, 5]
    geometry, acceleration = accelerate(Group("root", [], [Instances((pair,), placed)]))
    cones = some_cones(rng.normal(size=(20, 3)) * 0.2, [0, 0, 1], 0.15)
    fragments, masks, rays, hits, escaped = met(acceleration, cones, merging=Merging(exact=False))
    consistent(geometry, cones, fragments, masks, rays, hits, escaped)
    flat = Flat(geometry)
    known = set(zip(flat.numbers.tolist(), flat.paths.tolist(), strict=True))
    assert set(zip(hits.triangle.tolist(), hits.path.tolist(), strict=True)) <= known
    assert isinstance(rays, Rays) and (~escaped).any()


def test_crowded_cones_ask_a_few_of_their_sub_rays():
    """Each stands for a part of its cone, meets what its ray does, or lets its part escape: right on average."""
    rng = np.random.default_rng(1)
    geometry, acceleration = accelerate(Group("root", [random_mesh(rng, 400, 1.0, (0, 0, 6.0))]))
    cones = some_cones(rng.normal(size=(12, 3)) * 0.1, [0, 0, 1], 0.25)
    hits, stretch = nearest(acceleration, cones)
    exact = (hits.t.reshape(stretch.shape) / stretch, hits.triangle.reshape(stretch.shape))
    shares = []
    for seed in range(60):
        fragments, masks, rays, found, escaped = met(
            acceleration, cones, merging=Merging(most=3, boxes=0, seed=seed)
        )
        consistent(geometry, cones, fragments, masks, rays, found, escaped)
        assert len(masks) + escaped.any(1).sum() <= 4 * len(escaped)
        for k, n in enumerate(fragments.cone):
            same = exact[1][n] == found.triangle[k]
            assert (np.isclose(exact[0][n], fragments.depth[k, 0], rtol=1e-6) & same & masks[k]).any()
        shares.append(escaped.mean(1))
    expected = (exact[1] < 0).mean(1)
    assert 0.05 < expected.mean() < 0.95
    np.testing.assert_allclose(np.mean(shares, 0), expected, atol=4 * np.sqrt(0.25 / 3 / 60))


def test_few_boxes_are_looked_at_by_the_cone_itself():
    rng = np.random.default_rng(1)
    _, acceleration = accelerate(Group("root", [random_mesh(rng, 400, 1.0, (0, 0, 6.0))]))
    cones = some_cones(rng.normal(size=(12, 3)) * 0.1, [0, 0, 1], 0.25)
    whole, limited = (met(acceleration, cones, EXACT, Merging(boxes=n)) for n in (10**9, 512))
    np.testing.assert_array_equal(whole[1], limited[1])
    np.testing.assert_array_equal(whole[3].t, limited[3].t)
