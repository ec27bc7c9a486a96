"""Choosing among many lights: probabilities, and means without bias."""

import numpy as np
import pytest

from pointmr_engine.raytracing.lights import (
    TRIANGLE,
    Lights,
)
from pointmr_engine.scene.light import Light
from pointmr_engine.scene.material import emission
from pointmr_engine.scene.mesh import Mesh
from pointmr_engine.scene.world import uniform_world
from tests.engine.light_estimators import by_lights, lights_of, placed, points, quad, sampled


def many_lights(n: int, seed=5) -> Lights:
    """n emissive triangles and lamps of every kind, around the origin."""
    rng = np.random.default_rng(seed)
    t = rng.normal(size=(n, 1, 3)) * 3.0 + rng.normal(size=(n, 3, 3)) * 0.3
    materials = tuple(emission(strength=s) for s in (1.0, 5.0, 20.0))
    mesh = Mesh(
        "shards",
        t.reshape(-1, 3).astype(np.float32),
        np.arange(3 * n, dtype=np.int32).reshape(n, 3),
        material_index=rng.integers(0, 3, n).astype(np.int32),
        materials=materials,
    )
    lamps = [
        Light("POINT", placed((1.0, 2.0, 1.0)), power=30.0),
        Light("POINT", placed((-2.0, 1.0, 2.0)), power=30.0, radius=0.4, soft_falloff=False),
        Light("SPOT", placed((0.0, 0.5, 3.0)), power=90.0, radius=0.1, spot_angle=1.2),
        Light("AREA", placed((2.0, -1.0, 2.0)), power=40.0),
        Light("AREA", placed((-2.0, -1.0, 2.0)), power=40.0, shape="DISK", spread=1.0),
        Light("SUN", placed(), power=1.0, angle=0.1),
    ]
    return lights_of(lamps, uniform_world((0.3, 0.3, 0.3)), [mesh])


@pytest.mark.parametrize("n", [4, 300])
def test_probabilities_of_all_lights_sum_to_one(n):
    from pointmr_engine.raytracing import light_tree

    lights = many_lights(n)
    tree = lights.arrays.tree
    assert (len(tree.tops) <= 16 + 2) and len(tree.leaf_of_emitter) == n
    rng = np.random.default_rng(0)
    for transmissive in (True, False):
        for _ in range(6):
            p, normal = rng.normal(size=3) * 3.0, rng.normal(size=3)
            args = (*p, *normal / np.linalg.norm(normal), transmissive)
            leaves = [*tree.leaf_of_emitter, *tree.leaf_of_lamp, tree.leaf_of_world]
            q = np.array([light_tree.light_probability(tree, k, *args) for k in leaves])
            # where a cluster seems possible but none of its lights is, a choice fails: that share is missing
            assert q.sum() < 1.0 + 1e-9 and q.sum() > (1.0 - 1e-9 if n == 4 else 0.6)
            chosen = [
                light_tree.choose_light(tree, *args, u, np.empty(len(tree.tops)))
                for u in (np.arange(400) + 0.5) / 400
            ]
            assert np.mean([node >= 0 for node, _ in chosen]) == pytest.approx(q.sum(), abs=0.02)
            nodes = np.array([node for node, _ in chosen])
            if n == 4:  # each light has one interval of u
                assert (np.diff(nodes) != 0).sum() == len(np.unique(nodes)) - 1
            lookup = dict(zip(leaves, q, strict=True))
            for node, probability in chosen:
                assert node < 0 or lookup[node] == pytest.approx(probability, rel=1e-9)


def test_bright_lamps_are_weighed_beside_a_cluster_of_faint_ones():
    mesh = quad(radiance=1e-6)
    lamps = [Light("AREA", placed((float(x), 0.0, 2.0)), power=40.0) for x in range(6)]
    lamps += [Light("POINT", placed((0.01 * k, 5.0, 0.0)), power=1e-3, radius=0.01) for k in range(100)]
    tree = lights_of(lamps, meshes=[mesh]).arrays.tree
    assert (tree.top[tree.leaf_of_lamp[:6]] >= 0).all()
    assert (tree.top[tree.leaf_of_lamp[6:]] < 0).all() and (tree.top[tree.leaf_of_emitter] < 0).all()
    assert len(tree.tops) < 10  # nothing that is faint is opened


def test_tree_is_unbiased():
    lights = many_lights(200)
    p, normal = np.array([0.2, 0.1, -0.5]), np.array([0.0, 0.6, 0.8])
    e = lights.arrays.emitters
    # every triangle by itself, seen from both sides, without shadows: the exact polygon formula, clipped by sampling
    v = e.vertices - p
    total = np.zeros(3)
    rng = np.random.default_rng(2)
    b = rng.random((4000, 2))
    b = np.where(b.sum(1, keepdims=True) > 1.0, 1.0 - b, b)
    for k in range(len(v)):
        x = v[k, 0] + b[:, :1] * (v[k, 1] - v[k, 0]) + b[:, 1:] * (v[k, 2] - v[k, 0])
        cross = np.cross(v[k, 1] - v[k, 0], v[k, 2] - v[k, 0])
        r2 = (x * x).sum(1)
        total += e.radiance[k] * (np.maximum(x @ normal, 0.0) * np.abs(x @ cross) * 0.5 / r2**2).mean()
    out = sampled(lights, p, normal, n=1 << 16)
    ok = out.kind == TRIANGLE
    cosine = np.maximum(out.direction[ok] @ normal, 0.0)
    value = (out.radiance[ok] * (cosine / out.pdf[ok])[:, None]).sum(0) / len(out.kind)
    assert value == pytest.approx(total, rel=0.01)


def test_densities_of_rays_equal_those_of_samples():
    lights = many_lights(200)
    out = sampled(lights, (0.2, 0.1, -0.5), (0.0, 0.6, 0.8), n=4096)
    ok = np.flatnonzero(out.kind == TRIANGLE)
    p, nor, trans = points((0.2, 0.1, -0.5), (0.0, 0.6, 0.8), n=len(ok))
    again = lights.emitter_pdf(
        out.path[ok], out.triangle[ok], p, nor, trans, out.direction[ok], out.distance[ok]
    )
    assert again == pytest.approx(out.pdf[ok], rel=1e-6)
    assert (
        lights.emitter_pdf(
            out.path[ok] + np.uint64(1), out.triangle[ok], p, nor, trans, None, out.distance[ok]
        ).max()
        == 0
    )


def test_many_lights_with_little_noise():
    lights = many_lights(200)
    value = by_lights(lights, (0.2, 0.1, -0.5), (0.0, 0.6, 0.8), n=1 << 14)[:, 0]
    assert value.std() < 2.5 * value.mean()
