"""Direct light by three estimators: samples of lights, rays that meet them, and both together."""

import math

import numpy as np
import pytest

from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.numerics import warps
from pointmr_engine.raytracing.lights import (
    NONE,
    Lights,
    allocate_light_samples,
    build_lights,
    power_heuristic,
)
from pointmr_engine.scene.graph import Graph
from pointmr_engine.scene.group import DIFFUSE, Group
from pointmr_engine.scene.material import emission
from pointmr_engine.scene.mesh import Mesh
from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.world import World
from pointmr_engine.shading.program import compile_graph

UP = (0.0, 0.0, 1.0)
N = 1 << 14


def placed(location=(0.0, 0.0, 0.0), down=True, scale=(1.0, 1.0, 1.0)) -> np.ndarray:
    """A transform at a location; a lamp there shines down, or up."""
    m = np.eye(4)
    m[:3, :3] = np.diag(scale) if down else np.diag([1.0, -1.0, -1.0]) * scale
    m[:3, 3] = location
    return m


def lights_of(lamps=(), world=None, meshes=(), instances=(), **options) -> Lights:
    scene = Scene(Group("root", list(meshes), list(instances)), lights=list(lamps), world=world or World())
    geometry = compile_geometry(scene)
    programs = [compile_graph(m.graph if m else Graph()) for m in geometry.materials]
    return build_lights(scene, geometry, programs, **options)


def points(position, normal=UP, n=N, transmissive=False):
    p = np.broadcast_to(np.asarray(position, np.float64), (n, 3)).copy()
    nor = np.broadcast_to(np.asarray(normal, np.float32), (n, 3)).copy()
    return p, nor, np.full(n, transmissive)


def uniforms(n=N, dimensions=3, seed=0) -> np.ndarray:
    """Well-spread points of the unit cube, randomly shifted (Kronecker sequence)."""
    phi = 1.22074408460575947536 if dimensions == 3 else 1.32471795724474602596
    steps = phi ** -np.arange(1.0, dimensions + 1.0)
    return (np.arange(n)[:, None] * steps + np.random.default_rng(seed).random(dimensions)) % 1.0


def sampled(lights, position, normal=UP, n=N, transmissive=False, seed=0):
    out = allocate_light_samples(n)
    p, nor, trans = points(position, normal, n, transmissive)
    lights.sample(p, nor, trans, uniforms(n, seed=seed), out)
    lights.emission_at(out, p)
    assert not out.pending.any()
    return out


def meets(lights, position, direction):
    """(emitter or -1, distance) of the nearest emissive triangle along each ray, by brute force."""
    v = lights.arrays.emitters.vertices
    nearest, index = np.full(len(direction), np.inf), np.full(len(direction), -1)
    for e in range(len(v)):
        edge1, edge2 = v[e, 1] - v[e, 0], v[e, 2] - v[e, 0]
        h = np.cross(direction, edge2)
        with np.errstate(divide="ignore", invalid="ignore"):
            det = h @ edge1
            s = position - v[e, 0]
            a = np.einsum("ij,ij->i", s, h) / det
            q = np.cross(s, edge1)
            b = np.einsum("ij,ij->i", direction, q) / det
            t = q @ edge2 / det
            hit = (a >= 0.0) & (b >= 0.0) & (a + b <= 1.0) & (t > 1e-9) & (t < nearest)
        nearest[hit], index[hit] = t[hit], e
    return index, nearest


def by_lights(lights, position, normal=UP, n=N, mis=False, seed=0):
    """Irradiance by light samples, weighted against cosine-distributed rays if mis; blocked by nearer emitters."""
    out = sampled(lights, position, normal, n, seed=seed)
    p, nor, _ = points(position, normal, n)
    cosine = np.einsum("ij,ij->i", out.direction, nor.astype(np.float64))
    ok = (out.kind != NONE) & (cosine > 0.0)
    _, t = meets(lights, p, out.direction)
    ok &= t >= out.distance * (1.0 - 1e-6)
    value = np.zeros((n, 3))
    value[ok] = out.radiance[ok] * (cosine[ok] / out.pdf[ok])[:, None]
    if mis:
        weight = power_heuristic(out.pdf, np.maximum(cosine, 0.0) / math.pi)
        value *= np.where(out.mis, weight, 1.0)[:, None]
    return value


def by_rays(lights, position, normal=UP, n=N, mis=False, seed=1):
    """Irradiance by cosine-distributed rays that meet lights, weighted against light samples if mis."""
    axis = np.asarray(normal, np.float64)
    d = np.array([warps.cosine_hemisphere(*axis, *u) for u in uniforms(n, 2, seed)])
    p, nor, trans = points(position, normal, n)
    d, pdf = np.ascontiguousarray(d[:, :3]), d[:, 3] / math.pi
    bsdf_pdf = pdf if mis else np.full(n, np.inf)
    index, t = meets(lights, p, d)
    value = np.zeros((n, 3), np.float32)
    lights.seen_lamps(p, d, np.zeros(n), t, np.full(n, DIFFUSE, np.uint8), nor, trans, bsdf_pdf, value)
    hit = index >= 0
    emitters = lights.arrays.emitters
    if hit.any():
        e = index[hit]
        weight = lights.emitter_weight(
            emitters.path[e],
            emitters.triangle[e],
            p[hit],
            nor[hit],
            trans[hit],
            d[hit],
            t[hit],
            bsdf_pdf[hit],
        )
        value[hit] += emitters.radiance[e] * weight[:, None]
    miss = ~hit
    world = lights.world_radiance(d[miss], DIFFUSE)
    value[miss] += (
        world * lights.world_weight(p[miss], nor[miss], trans[miss], d[miss], bsdf_pdf[miss])[:, None]
    )
    return value.astype(np.float64) * math.pi


def all_agree(lights, position, normal=UP, expected=None, rel=0.02, n=N):
    """Light samples alone, rays alone and both weighted have one mean, which is `expected` if given."""
    alone = by_lights(lights, position, normal, n).mean(0)
    both = by_lights(lights, position, normal, n, mis=True).mean(0) + by_rays(
        lights, position, normal, n, True
    ).mean(0)
    rays = by_rays(lights, position, normal, n).mean(0)
    if expected is not None:
        assert alone == pytest.approx(np.full(3, expected), rel=rel)
    assert both == pytest.approx(alone, rel=rel)
    assert rays == pytest.approx(alone, rel=3.0 * rel)


def quad(name="quad", size=1.0, height=0.0, radiance=1.0, material=None, facing_down=True) -> Mesh:
    s = 0.5 * size
    p = np.array([[-s, -s, height], [s, -s, height], [s, s, height], [-s, s, height]], np.float32)
    t = np.array([[0, 2, 1], [0, 3, 2]] if facing_down else [[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(name, p, t, materials=(material or emission(strength=radiance),))


def cube(material) -> Mesh:
    p = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)], np.float32)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    t = np.array([t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))], np.int32)
    return Mesh("cube", p, t, materials=(material,))


def form_factor_square(half: float, height: float) -> float:
    """Of a small surface to a parallel square of sides 2 * half centred above it."""
    x = half / height
    root = math.sqrt(1.0 + x * x)
    return 4.0 / math.pi * x / root * math.atan(x / root)
