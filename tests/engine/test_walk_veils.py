"""Surfaces that shadow rays may pass, noted by one walk and taken one after the other."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from instanced import accelerate, nest, random_mesh, scene_rays

from pointmr_engine.hierarchy.acceleration import set_opaque
from pointmr_engine.raytracing import walk
from pointmr_engine.raytracing.rays import allocate_hits
from pointmr_engine.raytracing.walk_veils import allocate_veils
from pointmr_engine.scene.group import Group
from pointmr_engine.scene.material import Material


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 5))
def test_veils_are_all_that_closest_hits_find_one_after_the_other(seed, noted, at_once):
    rng = np.random.default_rng(seed)
    glass, wall = Material("glass"), Material("wall")
    mesh = random_mesh(
        rng, 30, materials=(glass, wall), material_index=(rng.random(30) < 0.05).astype(np.int32)
    )
    geometry, acceleration = accelerate(nest(rng, 2, Group("leaf", [mesh]), 4))
    clear = set_opaque(acceleration, np.array([m is wall for m in geometry.materials]))
    origin, n = rng.normal(size=(100, 3)) * 10, 100
    rays, hits = scene_rays(origin, rng.normal(size=(n, 3)) * 3 - origin)
    start, along, near = rays.origin.copy(), rays.direction.copy(), allocate_hits(1)
    veils, found = allocate_veils(n, acceleration.arrays.levels + 1, noted), [[] for _ in range(n)]
    moving, blocked = np.arange(n), np.zeros(n, np.bool_)
    while len(moving):
        walk.shadow(clear, rays, hits, 0, len(moving), veils)
        blocked[moving[hits.triangle[: len(moving)] == walk.BLOCKED]] = True
        rows = np.flatnonzero(hits.triangle[: len(moving)] >= 0)
        met = allocate_hits(len(rows) * at_once)
        taken = walk.take_veils(clear, veils, rows, np.full(len(rows), at_once), met)
        assert (taken > 0).all()
        ends = np.cumsum(taken)
        for k, (row, end) in enumerate(zip(rows, ends, strict=True)):
            own = slice(end - taken[k], end)
            found[moving[row]] += list(
                zip(met.t[own], met.triangle[own], met.path[own], met.u[own], strict=True)
            )
            # rays are packed, as the integrator does; their lists stay
            rays.origin[k], rays.direction[k], rays.t_max[k] = rays.origin[row], rays.direction[row], np.inf
            rays.t_min[k] = met.t[end - 1] * (1 + 1e-12)
            rays.skip_triangle[k], rays.skip_path[k] = met.triangle[end - 1], met.path[end - 1]
            veils.row[k] = veils.row[row]
        moving = moving[rows]
    for i in range(n):
        rest = scene_rays(start[i : i + 1], along[i : i + 1])[0]
        wanted = []
        while True:
            walk.intersect(acceleration, rest, near)
            if near.triangle[0] < 0 or mesh.material_index[near.triangle[0]]:
                break
            wanted.append((near.t[0], near.triangle[0], near.path[0], near.u[0]))
            rest.t_min[0] = near.t[0] * (1 + 1e-12)
            rest.skip_triangle[0], rest.skip_path[0] = near.triangle[0], near.path[0]
        assert blocked[i] == (near.triangle[0] >= 0)
        if not blocked[i]:
            assert [f[1:3] for f in found[i]] == [w[1:3] for w in wanted]
            np.testing.assert_allclose(
                [f[::3] for f in found[i]], [w[::3] for w in wanted], rtol=1e-6, atol=1e-6
            )
