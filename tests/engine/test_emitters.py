"""Emissive triangles as lights: closed forms, sides, textures, nested instances."""

import math

import numpy as np
import pytest

from pointmr_engine.raytracing.lights import (
    TRIANGLE,
)
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import Group, instance
from pointmr_engine.scene.material import Material, emission
from pointmr_engine.scene.mesh import Mesh
from pointmr_engine.scene.texture import Image
from tests.engine.light_estimators import (
    all_agree,
    by_lights,
    by_rays,
    cube,
    form_factor_square,
    lights_of,
    placed,
    quad,
    sampled,
)


@pytest.mark.parametrize("height", [0.05, 1.0, 30.0])
def test_emissive_square_over_its_centre(height):
    lights = lights_of(meshes=[quad(size=2.0, height=height, radiance=3.0)])
    expected = 3.0 * math.pi * form_factor_square(1.0, height)
    alone = by_lights(lights, (0.0, 0.0, 0.0)).mean(0)
    assert alone == pytest.approx(np.full(3, expected), rel=0.01)
    if height < 10.0:
        all_agree(lights, (0.0, 0.0, 0.0), expected=expected, rel=0.02)


def test_closed_emissive_mesh_hardly_samples_its_inside():
    lights = lights_of(
        instances=[instance(Group("cube", [cube(emission(strength=2.0))]), placed((0.2, 0.1, 2.0)))]
    )
    out = sampled(lights, (0.0, 0.0, 0.0), n=4096)
    v = lights.arrays.emitters.vertices[out.index]
    outward = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    assert (np.einsum("ij,ij->i", outward, out.direction) > 0.0).mean() < 0.2
    all_agree(lights, (0.0, 0.0, 0.0))
    all_agree(lights, (0.2, 0.1, 2.1), expected=2.0 * math.pi)  # within it


@pytest.mark.parametrize(
    "mode, front, back", [("AUTO", 1, 1), ("FRONT", 1, 0), ("BACK", 0, 1), ("NONE", 0, 0)]
)
@pytest.mark.parametrize("mirrored", [False, True])
def test_emission_sampling_sides(mode, front, back, mirrored):
    material = emission(strength=2.0)
    material.emission_sampling = mode
    m = placed((0.0, 0.0, 1.0), scale=(-1.0 if mirrored else 1.0, 1.0, 1.0))
    lights = lights_of(instances=[instance(Group("g", [quad(material=material)]), m)])
    below, above = (
        sampled(lights, (0.1, 0.0, 0.0), n=64),
        sampled(lights, (0.1, 0.0, 2.0), (0.0, 0.0, -1.0), n=64),
    )
    assert (below.kind == TRIANGLE).any() == bool(front)
    assert (above.kind == TRIANGLE).any() == bool(back)
    if mode == "NONE":
        assert lights.only_met and lights.empty
    # what is not sampled is met by rays, with their whole weight
    both = by_lights(lights, (0.1, 0, 0), mis=True).mean(0) + by_rays(lights, (0.1, 0, 0), mis=True).mean(0)
    if mode != "NONE":
        assert both == pytest.approx(by_rays(lights, (0.1, 0.0, 0.0)).mean(0), rel=0.03)


def test_weak_emission_is_left_to_chance():
    lights = lights_of(meshes=[quad(radiance=0.3, height=1.0)])
    assert lights.empty and lights.only_met
    assert not lights_of(meshes=[quad(radiance=0.7, height=1.0)]).empty


def test_emitters_of_nested_instances_are_found_by_path():
    leaf = Group("leaf", [quad(size=0.2, radiance=5.0)])
    pair = Group("pair", instances=[instance(leaf, placed((x, 0.0, 0.0))) for x in (-0.3, 0.3)])
    root = [instance(pair, placed((0.0, y, 1.0), scale=(1.0, 1.0, 2.0))) for y in (-0.4, 0.0, 0.4)]
    lights = lights_of(instances=root)
    emitters = lights.arrays.emitters
    assert len(emitters.path) == 12 and len(np.unique(emitters.path)) == 6
    centres = np.round(emitters.vertices.mean(1), 1)
    assert {tuple(c) for c in np.round(emitters.vertices.reshape(6, 6, 3).mean(1), 6) + 0.0} >= {
        (0.3, 0.4, 1.0)
    }
    assert centres[:, 2] == pytest.approx(1.0)
    all_agree(lights, (0.0, 0.0, 0.0))


def test_textured_emission_is_evaluated_where_it_is_sampled():
    pixels = np.zeros((8, 8, 4), np.float32)
    pixels[:, 4:, 0], pixels[:, :4, 1], pixels[..., 3] = 4.0, 2.0, 1.0
    image = Image("glow", pixels, colorspace="Linear")
    nodes = {
        "image": Node("image_texture", params={"image": image, "interpolation": "Closest"}),
        "emission": Node("emission", {"color": Link("image", "color"), "strength": 1.0}),
    }
    mesh = quad(
        size=2.0, height=1.0, material=Material("glow", Graph(nodes, surface=Link("emission", "emission")))
    )
    mesh.uvs["uv"] = (mesh.positions[mesh.triangles][..., :2] * 0.5 + 0.5).astype(np.float32)
    mesh.active_uv = "uv"
    lights = lights_of(meshes=[mesh])
    out = sampled(lights, (0.0, 0.0, 0.0), n=1024)
    x = out.direction[:, 0] * out.distance
    clear = np.abs(x) > 0.02
    assert out.radiance[clear & (x > 0.0)] == pytest.approx(
        np.array([[4.0, 0.0, 0.0]]).repeat((clear & (x > 0)).sum(), 0)
    )
    assert out.radiance[clear & (x < 0.0)] == pytest.approx(
        np.array([[0.0, 2.0, 0.0]]).repeat((clear & (x < 0)).sum(), 0)
    )


def test_degenerate_triangles_do_not_shine():
    p = np.array([[0, 0, 1], [1, 0, 1], [2, 0, 1], [0, 1, 1], [np.nan, 0, 1]], np.float32)
    t = np.array([[0, 1, 2], [0, 1, 1], [0, 4, 1], [0, 1, 3]], np.int32)
    lights = lights_of(meshes=[Mesh("odd", p, t, materials=(emission(strength=2.0),))])
    assert len(lights.arrays.emitters.path) == 1
    all_agree(lights, (0.0, 0.0, 0.0))


def test_more_emitters_than_the_limit(monkeypatch):
    from pointmr_engine.raytracing import emitter_search

    monkeypatch.setattr(emitter_search, "MOST_EMITTERS", 10)
    lights = lights_of(
        instances=[instance(Group("g", [quad(radiance=2.0)]), placed((k, 0.0, 1.0))) for k in range(9)]
    )
    assert len(lights.arrays.emitters.path) <= 10 and lights.only_met
    assert any("10" in w for w in lights.warnings)
