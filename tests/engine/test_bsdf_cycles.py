"""Lobes against Cycles: noise-free BSDF values for random shader inputs, and surfaces under a uniform sky."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("bpy")

from bsdf_cases import even_numbers, make_lobes, sample, viewer  # noqa: E402

from benchmarks import bsdf_against_cycles as against  # noqa: E402
from benchmarks.bsdf_probe import probe  # noqa: E402
from pointmr_engine.shading import leaves  # noqa: E402

VALUES = (
    "oren-nayar",
    "sheen",
    "velvet",
    "glossy multi",
    "glossy beckmann",
    "metallic",
    "glass refracting",
    "refraction",
    "coat",
    "half metal",
    "transmission",
    "film",
    "anisotropic",
    "coat bumped apart",
    "everything",
)


@pytest.mark.parametrize("name", VALUES)
def test_values_are_those_of_cycles(name):
    result, reference, _ = against.run(name, side=12)
    difference = against.differences(result, reference)
    assert np.median(difference) < 5e-4
    assert np.quantile(difference, 0.98) < 5e-3
    assert result.mean() == pytest.approx(reference.mean(), rel=1e-3)


def test_diffuse_color_is_that_of_cycles():
    """What the layers above leave to the diffuse lobe, as Cycles' Diffuse Color pass."""
    rng = np.random.default_rng(5)
    n = 64
    normals = against.random_normals(rng, n)
    drawn = {name: rng.random(n).astype(np.float32) for name in ("coat_weight", "metallic", "roughness")}
    drawn["base_color"] = rng.random((n, 3)).astype(np.float32)
    inputs = {**against.PRINCIPLED_DEFAULTS, "sheen_weight": 0.3}
    attributes = {**drawn, "normal": normals}
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    reference = probe("ShaderNodeBsdfPrincipled", up, up[0], inputs, attributes, layer="Diffuse Color")
    _, lobes = against.ours(leaves.PRINCIPLED, normals, up[0], {"sheen_weight": 0.3, **drawn})
    assert lobes.diffuse_color == pytest.approx(reference, rel=2e-3, abs=1e-5)


def test_velvet_has_no_diffuse_color():
    up = np.array([[0.0, 0.0, 1.0]])
    node, defaults, _ = against.NODES[leaves.SHEEN]
    properties = {"distribution": "ASHIKHMIN"}
    reference = probe(node, up, up[0], defaults, {"normal": up}, properties, layer="Diffuse Color")
    _, lobes = against.ours(leaves.SHEEN, up, up[0], {}, distribution="ashikhmin")
    assert np.all(reference == 0.0) and np.all(lobes.diffuse_color == 0.0) and lobes.count[0] == 1


@pytest.mark.parametrize(
    "kind, values",
    [
        (leaves.GLOSSY, {"roughness": 0.0}),
        (leaves.GLOSSY, {"roughness": 0.7}),
        (leaves.GLASS, {"roughness": 0.0, "ior": 1.5}),
        (leaves.PRINCIPLED, {"roughness": 0.2, "coat_weight": 1.0, "coat_roughness": 0.0, "metallic": 0.5}),
        (
            leaves.PRINCIPLED,
            {"roughness": 0.3, "sheen_weight": 1.0, "alpha": 0.7, "base_color": (0.9, 0.3, 0.1)},
        ),
    ],
)
def test_surfaces_under_a_uniform_sky(kind, values):
    """Sampled throughput of one bounce is the radiance of that surface in Cycles, perfect mirrors included."""
    node, defaults, _ = against.NODES[kind]
    cosine = 0.8
    normal = np.array([[math.sqrt(1.0 - cosine**2), 0.0, cosine]])
    properties = {"distribution": "MULTI_GGX"} if kind != leaves.DIFFUSE else {}
    color = {"color": (1.0, 1.0, 1.0)} if "color" in defaults else {}
    attributes = {"normal": normal}
    inputs = {**defaults, **values, **color}
    reference = probe(
        node,
        np.array([[0.0, 0.0, 1.0]]),
        None,
        inputs,
        attributes,
        properties,
        world=1.0,
        samples=16384,
    )
    lobes = make_lobes(kind, viewer(1.0), values, normal=normal.astype(np.float32))
    out, labels = sample(lobes, viewer(1.0), even_numbers(100_000), 0)
    found = np.where(labels[:, None] > 0, out[:, 3:6] / np.maximum(out[:, 6:7], 1e-30), 0.0).mean(axis=0)
    assert found == pytest.approx(reference[0], rel=0.012)
