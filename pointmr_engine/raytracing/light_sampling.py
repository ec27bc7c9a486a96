"""Kernels that sample one light for each point, and weigh what rays meet against them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing.emitters import Emitters, emitter_density, find_emitter, sample_emitter
from pointmr_engine.raytracing.environment import WorldMap, density_by_texels, sample_world, world_density
from pointmr_engine.raytracing.lamps import Lamps, intersect_lamp, lamp_pdf_scale, sample_lamp
from pointmr_engine.raytracing.light_tree import choose_light, light_probability
from pointmr_engine.raytracing.light_tree_nodes import TRIANGLE as TRIANGLE_NODE
from pointmr_engine.raytracing.light_tree_nodes import WORLD as WORLD_NODE
from pointmr_engine.raytracing.light_tree_nodes import LightTree
from pointmr_engine.scene.group import CAMERA

NONE, LAMP, TRIANGLE, WORLD = 0, 1, 2, 3


class LightSamples(NamedTuple):
    """One chosen light for each of N points. All but `kind` is undefined where kind is NONE (nothing lights the point).

    The light adds f(wi, direction) |cos| * radiance / (pdf * times) * (mis ? power_heuristic(pdf, bsdf_pdf) : 1), where
    the lobes that `visibility` names are f. Shadow rays run from t_min to `distance` less a little.
    """

    kind: np.ndarray  # (N,) uint8: NONE, LAMP, TRIANGLE, WORLD
    index: np.ndarray  # (N,) int32: lamp, emitter, or 0
    direction: np.ndarray  # (N, 3) float64, unit, from the point to the light
    distance: np.ndarray  # (N,) float64, inf for sun and world
    radiance: np.ndarray  # (N, 3) float32; for delta lamps: radiance times solid angle
    # (N,) float64 per solid angle, selection included; for delta lamps: of the selection alone
    pdf: np.ndarray
    pending: np.ndarray  # (N,) bool: `radiance` must still be filled in, by `Lights.emission_at`
    mis: np.ndarray  # (N,) bool: a ray chosen by a BSDF can meet this light too
    cast_shadow: np.ndarray  # (N,) bool
    # (N,) uint8, bits DIFFUSE, GLOSSY, TRANSMISSION of scene.group: what may see the light
    visibility: np.ndarray
    triangle: np.ndarray  # (N,) int32, the emissive triangle that a shadow ray may touch, -1 if none
    path: np.ndarray  # (N,) uint64, its instance path
    u: np.ndarray  # (N,) float32, barycentric weight of vertex 1
    v: np.ndarray  # (N,) float32, barycentric weight of vertex 2
    # (N,) bool: Cycles does not sample this light: rays to it stand for those that lobes send
    scattered: np.ndarray
    # (N,) float64: samples of the point that ask for the same light, each of which stands for a part of it
    times: np.ndarray
    # (N,) float64: pdf as it would be if it did not go by the surface that is lit (environment.WorldMap.even)
    anywhere: np.ndarray


def allocate_light_samples(n: int) -> LightSamples:
    """Room for n samples, none of them valid."""
    return LightSamples(
        np.zeros(n, np.uint8),
        np.zeros(n, np.int32),
        np.zeros((n, 3)),
        np.zeros(n),
        np.zeros((n, 3), np.float32),
        np.zeros(n),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
        np.zeros(n, np.uint8),
        np.full(n, -1, np.int32),
        np.zeros(n, np.uint64),
        np.zeros(n, np.float32),
        np.zeros(n, np.float32),
        np.zeros(n, np.bool_),
        np.ones(n),
        np.zeros(n),
    )


class LightArrays(NamedTuple):
    """What the kernels read."""

    lamps: Lamps
    emitters: Emitters
    world: WorldMap
    tree: LightTree
    world_visibility: int
    met_suns: int  # how many of met_lamps are suns
    met_lamps: np.ndarray  # (K,) int32: lamps that rays can meet, suns first


def power_heuristic(pdf: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(N,) float32: pdf^2 / (pdf^2 + other^2); 1 where pdf is infinite or other is 0."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = np.where(other > 0.0, other / pdf, 0.0)
        return (1.0 / (1.0 + ratio * ratio)).astype(np.float32)


@uncounted
def choose_lights(tree, position, normal, transmissive, u, weights, out):
    """First stage of `Lights.sample`: kind and index of a light for each point; its probability in out.pdf.

    weights: scratch, float64, as long as tree.tops.
    """
    for i in range(len(position)):
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        node, probability = choose_light(tree, px, py, pz, nx, ny, nz, transmissive[i], u[i, 0], weights)
        kind = NONE
        if node >= 0:
            light = tree.kind[node]
            kind = TRIANGLE if light == TRIANGLE_NODE else (WORLD if light == WORLD_NODE else LAMP)
            out.index[i] = tree.item[node]
        out.kind[i] = kind
        out.pdf[i] = probability
        out.pending[i] = kind == WORLD
        out.triangle[i] = -1


@uncounted
def _place(out, i, dx, dy, dz, t, pdf):
    """Note the direction to light i's sample; False, and no light, where it could not be sampled."""
    pdf *= out.pdf[i]
    # written so that a NaN fails as well
    if not (pdf > 0.0 and pdf < math.inf and t > 0.0):
        out.kind[i] = NONE
        out.pending[i] = False
        return False
    out.direction[i, 0], out.direction[i, 1], out.direction[i, 2] = dx, dy, dz
    out.distance[i] = t
    out.pdf[i] = pdf
    out.cast_shadow[i] = True
    out.mis[i] = True
    out.times[i], out.anywhere[i] = 1.0, pdf
    return True


@uncounted
def sample_lamps(lamps, position, normal, transmissive, u, out):
    """Second stage: directions to the lamps that were chosen."""
    for i in range(len(position)):
        if out.kind[i] != LAMP:
            continue
        lamp = out.index[i]
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        dx, dy, dz, t, pdf, scale = sample_lamp(
            lamps, lamp, px, py, pz, nx, ny, nz, transmissive[i], u[i, 1], u[i, 2]
        )
        if not scale > 0.0:
            pdf = 0.0
        if _place(out, i, dx, dy, dz, t, pdf):
            for k in range(3):
                out.radiance[i, k] = lamps.radiance[lamp, k] * scale
            out.pending[i] = lamps.varying[lamp]
            out.mis[i] = lamps.mis[lamp]
            out.cast_shadow[i] = lamps.cast_shadow[lamp]
            out.visibility[i] = lamps.visibility[lamp]


@uncounted
def sample_emitters(emitters, position, u, out):
    """Second stage: points of the emissive triangles that were chosen."""
    for i in range(len(position)):
        if out.kind[i] != TRIANGLE:
            continue
        e = out.index[i]
        dx, dy, dz, t, pdf, bu, bv = sample_emitter(
            emitters, e, position[i, 0], position[i, 1], position[i, 2], u[i, 1], u[i, 2]
        )
        if _place(out, i, dx, dy, dz, t, pdf):
            for k in range(3):
                out.radiance[i, k] = emitters.radiance[e, k]
            out.pending[i] = emitters.varying[e]
            out.visibility[i] = emitters.visibility[e]
            out.triangle[i] = emitters.triangle[e]
            out.path[i] = emitters.path[e]
            out.u[i], out.v[i] = bu, bv


@uncounted
def sample_worlds(world, visibility, normal, transmissive, u, out):
    """Second stage: directions where the world was chosen."""
    for i in range(len(normal)):
        if out.kind[i] != WORLD:
            continue
        nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        dx, dy, dz, pdf = sample_world(world, nx, ny, nz, transmissive[i], u[i, 1], u[i, 2])
        chance = out.pdf[i]
        if _place(out, i, dx, dy, dz, math.inf, pdf):
            out.visibility[i] = visibility
            if world.even > 0.0:
                out.anywhere[i] = chance * density_by_texels(world, dx, dy, dz)


@uncounted
def _weight(pdf, other):
    """Power heuristic of one pair; pdf may be infinite."""
    if not other > 0.0:
        return 1.0
    ratio = other / pdf
    return 1.0 / (1.0 + ratio * ratio)


@uncounted
def add_seen_lamps(
    lamps, tree, met, suns, position, direction, t_min, t_hit, visibility, normal, transmissive, bsdf_pdf, out
):
    """`Lights.seen_lamps`; met: the lamps that rays can meet, the first `suns` of them suns; none that varies."""
    for i in range(len(position)):
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        camera = visibility[i] & CAMERA
        first = 0 if t_hit[i] == math.inf else suns
        for k in range(first, len(met)):
            lamp = met[k]
            if not (lamps.visibility[lamp] & visibility[i]) or lamps.varying[lamp]:
                continue
            if not lamps.mis[lamp] and (not camera or k < suns):
                continue
            t = intersect_lamp(lamps, lamp, px, py, pz, dx, dy, dz)
            if not (t > t_min[i]) or (t >= t_hit[i] and t < math.inf):
                continue
            pdf, scale = lamp_pdf_scale(lamps, lamp, px, py, pz, nx, ny, nz, transmissive[i], dx, dy, dz, t)
            if not scale > 0.0:
                continue
            if bsdf_pdf[i] < math.inf and lamps.mis[lamp]:
                leaf = tree.leaf_of_lamp[lamp]
                pdf *= light_probability(tree, leaf, px, py, pz, nx, ny, nz, transmissive[i])
                scale *= _weight(bsdf_pdf[i], pdf)
            for c in range(3):
                out[i, c] += lamps.radiance[lamp, c] * scale


@uncounted
def selection_pdf(tree, leaf, position, normal, transmissive, out):
    """Multiply out (N,) by the probability with which the light of each node leaf (N,) is chosen; nothing below 0."""
    for i in range(len(leaf)):
        if leaf[i] >= 0 and out[i] > 0.0:
            px, py, pz = position[i, 0], position[i, 1], position[i, 2]
            nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
            out[i] *= light_probability(tree, leaf[i], px, py, pz, nx, ny, nz, transmissive[i])


@uncounted
def emitter_densities(emitters, leaf_of_emitter, path, triangle, position, distance, leaf, out):
    """Density (N,) per solid angle of each triangle's own sampling, and its node in the tree (-1: not sampled)."""
    for i in range(len(path)):
        leaf[i] = -1
        out[i] = 0.0
        e = find_emitter(emitters, path[i], triangle[i])
        if e >= 0:
            leaf[i] = leaf_of_emitter[e]
            out[i] = emitter_density(emitters, e, position[i, 0], position[i, 1], position[i, 2], distance[i])


@uncounted
def world_densities(world, normal, transmissive, direction, out):
    """Density (N,) per solid angle of the world's own sampling."""
    for i in range(len(direction)):
        nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        out[i] = world_density(world, nx, ny, nz, transmissive[i], dx, dy, dz)
