"""Cones' masks against exact rays and closed forms, through nested instances, far away, with bad input."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from instanced import Flat, accelerate, nest, random_mesh

from pointmr_engine.hierarchy.prefilter import prefilter
from pointmr_engine.multires.cone_space import Style
from pointmr_engine.multires.cone_walk import visible
from pointmr_engine.multires.cones import Cones, allocate_cones, axes_of, sub_rays
from pointmr_engine.raytracing import walk
from pointmr_engine.raytracing.rays import allocate_hits, allocate_rays
from pointmr_engine.scene.group import Group, instance

seeds = st.integers(0, 2**32 - 1)
EXACT = Style(small=0.0)


def some_cones(origin, direction, spread, start=0.0, **values) -> Cones:
    origin, direction = np.atleast_2d(origin).astype(float), np.atleast_2d(direction).astype(float)
    cones = allocate_cones(max(len(origin), len(direction)))
    cones.origin[:] = origin
    cones.axes[:] = axes_of(direction / np.linalg.norm(direction, axis=1, keepdims=True))
    cones.spread[:], cones.start[:] = spread, start
    for name, value in values.items():
        getattr(cones, name)[:] = value
    return cones


def blocked(acceleration, cones, style=Style(), counters=None, prefiltered=None):  # noqa: B008
    """(N, 64) bool."""
    masks = np.zeros(len(cones.origin), np.uint64)
    prefiltered = prefilter(acceleration) if prefiltered is None else prefiltered
    visible(acceleration, prefiltered, cones, masks, counters, style=style)
    return (masks[:, None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1) != 0


def exact(acceleration, cones, u=None, v=None):
    """(N, K) bool, by shadow rays."""
    origin, direction, stretch = sub_rays(cones, u, v)
    n, k = stretch.shape
    rays, hits = allocate_rays(n * k), allocate_hits(n * k)
    rays.origin[:], rays.direction[:] = origin.reshape(-1, 3), direction.reshape(-1, 3)
    rays.t_min[:] = (cones.t_min[:, None] * stretch).ravel()
    rays.t_max[:] = (cones.t_max[:, None] * stretch).ravel()
    rays.visibility[:] = np.repeat(cones.visibility, k)
    walk.shadow(acceleration, rays, hits)
    return (hits.triangle == walk.BLOCKED).reshape(n, k)


@settings(max_examples=25, deadline=None)
@given(
    seeds,
    st.integers(0, 3),
    st.sampled_from([(0.5, 2.0), (0.1, 0.2), (1e3, 1e4)]),
    st.sampled_from([0.0, 1e6]),
)
def test_large_triangles_give_the_masks_of_exact_rays(seed, depth, scale, offset):
    rng = np.random.default_rng(seed)
    leaf = Group("leaf", [random_mesh(rng, 15), random_mesh(rng, 1, 0.1, (0, 0, 2))])
    inner = nest(rng, depth, leaf, 3, scale=scale, spread=3.0)
    far = np.eye(4)
    far[:3, 3] = offset, -offset / 3, offset / 7
    geometry, acceleration = accelerate(Group("root", [], [instance(inner, far)]))
    n = 40
    corners = Flat(geometry).corners
    aimed = corners[rng.integers(0, len(corners), n)]
    aim, reach = aimed.mean(1), np.ptp(aimed, axis=1).max(1)[:, None]
    origin = aim + rng.normal(size=(n, 3)) * reach * rng.choice([1.0, 10.0], (n, 1))
    size = np.linalg.norm(aim - origin, axis=1)[:, None]
    cones = some_cones(
        origin, aim - origin, rng.choice([0.01, 0.1, 1.0], (n, 2)), size * rng.choice([0.0, 0.0, 0.1], (n, 2)),
        t_min=size[:, 0] * rng.choice([1e-5, 0.3], n), t_max=size[:, 0] * rng.choice([1.0, 10.0], n),
    )  # fmt: skip
    got, expected = blocked(acceleration, cones, EXACT), exact(acceleration, cones)
    assert expected.any()
    # sub-rays that graze an edge within rounding may fall to either side
    assert (got != expected).sum() <= 2e-4 * got.size + 1


def test_an_empty_scene_blocks_nothing():
    _, acceleration = accelerate(Group("nothing"))
    assert not blocked(acceleration, some_cones([0, 0, 0], [0, 0, 1], 0.5)).any()
