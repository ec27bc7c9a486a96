"""Which light to sample at a point: importances of lights and of clusters in a tree (Conty Estevez and Kulla 2018).

A handful of lights are all weighed at every point. Of many, a few clusters at the top of the tree are weighed, and one
of them is descended. The probability of any light is found by climbing from its leaf.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.raytracing import lamps as lamp_kinds
from pointmr_engine.raytracing.emitters import BACK, FRONT, Emitters
from pointmr_engine.raytracing.environment import OFF, WorldMap
from pointmr_engine.raytracing.lamps import Lamps, lamp_falloff

CLUSTER, LAMP, TRIANGLE, SUN, WORLD = range(5)  # kinds of nodes

# columns of LightTree.values
CX, CY, CZ, HX, HY, HZ, RADIUS, AX, AY, AZ = range(
    10
)  # box: centre, half sides, half diagonal; axis of the cone
# the cone of the lights' axes: cos and sin of its half angle; cos of that plus the angle of emission; the share of
# importance against the axis; radiance times area
COS_O, SIN_O, COS_OE, BEHIND, ENERGY = range(10, 15)
COLUMNS = 15

_FEW = 16  # lights that are all weighed at every point
_TOPS = 8  # clusters weighed at the top of a tree
_CLOSED = 0.05  # importance of the inside of closed meshes

_jit = njit(cache=True, nogil=True, error_model="numpy")


class LightTree(NamedTuple):
    """Nodes over all lights. Children lie side by side, after their parent."""

    kind: np.ndarray  # (M,) uint8
    item: np.ndarray  # (M,) int32: lamp or emitter; a cluster's first child
    parent: np.ndarray  # (M,) int32, -1 where none
    top: np.ndarray  # (M,) int32: place in `tops`, -1 below and above them
    tops: np.ndarray  # (K,) int32: the nodes among which a light is first chosen; they cover each light once
    values: np.ndarray  # (M, COLUMNS) float64
    leaf_of_lamp: np.ndarray  # (L,) int32
    leaf_of_emitter: np.ndarray  # (E,) int32
    leaf_of_world: int  # -1: not sampled


def build_light_tree(lamps: Lamps, emitters: Emitters, world: WorldMap) -> LightTree:
    """The tree over all lamps, emissive triangles and the world."""
    distant = np.isin(lamps.shape, (lamp_kinds.DISTANT, lamp_kinds.SUN))
    near_lamps = np.flatnonzero(~distant)
    values = np.concatenate([_lamp_values(lamps, near_lamps), _emitter_values(emitters)])
    kind = np.repeat(np.array([LAMP, TRIANGLE], np.uint8), [len(near_lamps), len(emitters.path)])
    item = np.concatenate([near_lamps, np.arange(len(emitters.path))]).astype(np.int32)
    far_lamps = np.flatnonzero(distant)
    far_values = [_sun_values(lamps, far_lamps)]
    far_kind = [np.full(len(far_lamps), SUN, np.uint8)]
    far_item = [far_lamps.astype(np.int32)]
    if world.mode != OFF:
        row = np.zeros((1, COLUMNS))
        row[0, ENERGY] = world.irradiance
        far_values.append(row)
        far_kind.append(np.full(1, WORLD, np.uint8))
        far_item.append(np.zeros(1, np.int32))
    parent = np.full(len(kind), -1, np.int32)
    tops = list(range(len(kind)))
    if len(kind) > _FEW:
        kind, item, parent, values = _cluster(kind, item, values)
        tops = _top_clusters(kind, item, values)
    far = len(kind)
    kind = np.concatenate([kind, *far_kind])
    item = np.concatenate([item, *far_item])
    values = np.concatenate([values, *far_values])
    parent = np.concatenate([parent, np.full(len(kind) - far, -1, np.int32)])
    tops = np.array(tops + list(range(far, len(kind))), np.int32)
    top = np.full(len(kind), -1, np.int32)
    top[tops] = np.arange(len(tops))
    leaf_of_lamp = np.full(len(lamps.shape), -1, np.int32)
    leaf_of_emitter = np.full(len(emitters.path), -1, np.int32)
    for leaf_of, kinds in ((leaf_of_lamp, (LAMP, SUN)), (leaf_of_emitter, (TRIANGLE,))):
        leaves = np.flatnonzero(np.isin(kind, kinds))
        leaf_of[item[leaves]] = leaves
    worlds = np.flatnonzero(kind == WORLD)
    return LightTree(
        kind,
        item,
        parent,
        top,
        tops,
        np.ascontiguousarray(values),
        leaf_of_lamp,
        leaf_of_emitter,
        int(worlds[0]) if len(worlds) else -1,
    )


def _lamp_values(lamps: Lamps, index: np.ndarray) -> np.ndarray:
    """Node values (n, COLUMNS) of the lamps `index`, which have a place."""
    out = np.zeros((len(index), COLUMNS))
    for k, i in enumerate(index):
        row, shape = lamps.values[i], lamps.shape[i]
        energy = float(np.abs(lamps.radiance[i]).mean())
        out[k, CX : CZ + 1] = row[:3]
        out[k, AX : AZ + 1] = row[lamp_kinds.AX : lamp_kinds.AZ + 1]
        if shape in (lamp_kinds.RECTANGLE, lamp_kinds.ELLIPSE):
            a, b, tangent = row[lamp_kinds.HALF_U], row[lamp_kinds.HALF_V], row[lamp_kinds.TAN_SPREAD]
            half = a * np.abs(row[lamp_kinds.UX : lamp_kinds.UZ + 1])
            out[k, HX : HZ + 1] = half + b * np.abs(row[lamp_kinds.VX : lamp_kinds.VZ + 1])
            out[k, RADIUS] = math.hypot(a, b) if shape == lamp_kinds.RECTANGLE else max(a, b)
            area = a * b * (4.0 if shape == lamp_kinds.RECTANGLE else math.pi)
            beyond = math.atan(tangent)
            peak = 1.0 if math.isinf(tangent) else max(tangent * row[lamp_kinds.SPREAD_SCALE], 1e-3)
            cone = (1.0, 0.0, math.cos(beyond), 0.0, energy * area * peak)
        else:
            radius = row[lamp_kinds.RADIUS]
            out[k, HX : HZ + 1] = out[k, RADIUS] = radius
            energy *= math.pi * radius * radius if radius > 0.0 else 1.0
            if row[lamp_kinds.SPOT]:
                cone = (1.0, 0.0, max(-1.0, 1.0 - row[lamp_kinds.SPOT_CONE]), 0.0, energy)
            else:
                cone = (-1.0, 0.0, -1.0, 1.0, energy)
        out[k, COS_O:] = cone
    return out


def _sun_values(lamps: Lamps, index: np.ndarray) -> np.ndarray:
    """Node values of suns: the axis leads to the sun, COS_O and SIN_O are of its half angle, ENERGY its irradiance."""
    out = np.zeros((len(index), COLUMNS))
    cone = lamps.values[index, lamp_kinds.CONE]
    sine2 = cone * (2.0 - cone)
    out[:, AX : AZ + 1] = -lamps.values[index, lamp_kinds.AX : lamp_kinds.AZ + 1]
    out[:, COS_O], out[:, SIN_O] = 1.0 - cone, np.sqrt(sine2)
    energy = np.abs(lamps.radiance[index]).mean(1)
    out[:, ENERGY] = energy * np.where(lamps.shape[index] == lamp_kinds.SUN, math.pi * sine2, 1.0)
    return out


def _emitter_values(emitters: Emitters) -> np.ndarray:
    """Node values (E, COLUMNS) of emissive triangles."""
    v = emitters.vertices
    out = np.zeros((len(v), COLUMNS))
    if not len(v):
        return out
    low, high = v.min(1), v.max(1)
    out[:, CX : CZ + 1] = 0.5 * (low + high)
    out[:, HX : HZ + 1] = 0.5 * (high - low)
    out[:, RADIUS] = np.linalg.norm(v - out[:, None, CX : CZ + 1], axis=2).max(1)
    cross = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    size = np.linalg.norm(cross, axis=1)
    both = emitters.sides == FRONT | BACK
    turn = np.where(emitters.sides == BACK, -1.0, 1.0)
    turn = np.where(both & (emitters.outside < 0.0), -1.0, turn)
    out[:, AX : AZ + 1] = cross / size[:, None] * turn[:, None]
    out[:, COS_O], out[:, SIN_O], out[:, COS_OE] = 1.0, 0.0, 0.0
    out[:, BEHIND] = np.where(both, np.where(emitters.outside != 0.0, _CLOSED, 1.0), 0.0)
    out[:, ENERGY] = np.abs(emitters.radiance).mean(1) * 0.5 * size
    return out


def _cluster(kind: np.ndarray, item: np.ndarray, values: np.ndarray):
    """(kind, item, parent, values) of a binary tree whose leaves are the given ones."""
    from pointmr_engine.raytracing import light_tree_build

    order, node_range, parent, first_child = light_tree_build.split(values)
    leaf = first_child < 0
    out = np.zeros((len(parent), COLUMNS))
    source = order[node_range[leaf, 0]]
    out[leaf] = values[source]
    light_tree_build.gather(out, first_child)
    kinds, items = np.full(len(parent), CLUSTER, np.uint8), first_child.astype(np.int32)
    kinds[leaf], items[leaf] = kind[source], item[source]
    return kinds, items, parent, out


def _top_clusters(kind: np.ndarray, item: np.ndarray, values: np.ndarray) -> list[int]:
    """Nodes that cover the tree, those opened that are large and bright."""
    tops = [0]
    while len(tops) < _TOPS:
        weight = [values[n, ENERGY] * values[n, RADIUS] if kind[n] == CLUSTER else -1.0 for n in tops]
        best = int(np.argmax(weight))
        if weight[best] < 0.0:
            break
        child = int(item[tops.pop(best)])
        tops += [child, child + 1]
    return tops


@_jit
def _facing(v, cosine, cos_u, sin_u):
    """Cosine at which a cluster's lights shine towards a point, at best: 0 if none of them does.

    cosine: of the angle between the cluster's axis and the direction to the point; u: half angle that the box fills.
    """
    if cosine >= cos_u:
        return 1.0
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    c = cosine * cos_u + sine * sin_u
    if c >= v[COS_O]:
        return 1.0
    if c <= v[COS_OE]:
        return 0.0
    s = math.sqrt(max(0.0, 1.0 - c * c))
    return max(0.0, c * v[COS_O] + s * v[SIN_O])


@_jit
def node_importance(tree, lamps, node, px, py, pz, nx, ny, nz, transmissive):
    """Roughly the irradiance that a node's lights give to a point without shadows; 0 only if they give nothing."""
    v = tree.values[node]
    kind = tree.kind[node]
    if kind == WORLD:
        return v[ENERGY]
    if kind == SUN:
        c = v[AX] * nx + v[AY] * ny + v[AZ] * nz
        if transmissive:
            c = abs(c)
        if c >= v[COS_O]:
            return v[ENERGY]
        best = c * v[COS_O] + math.sqrt(max(0.0, 1.0 - c * c)) * v[SIN_O]
        return 0.5 * v[ENERGY] * (max(0.0, best) + max(0.0, c))
    dx, dy, dz = v[CX] - px, v[CY] - py, v[CZ] - pz
    facing = nx * dx + ny * dy + nz * dz
    if not transmissive and facing + abs(nx) * v[HX] + abs(ny) * v[HY] + abs(nz) * v[HZ] <= 0.0:
        return 0.0
    d2 = dx * dx + dy * dy + dz * dz
    r2 = v[RADIUS] * v[RADIUS]
    near = v[ENERGY] / max(d2, max(0.25 * r2, 1e-300))
    if d2 <= r2 * 1.000001:
        return near
    d = math.sqrt(d2)
    sin_u = v[RADIUS] / d
    cos_u = math.sqrt(max(0.0, 1.0 - sin_u * sin_u))
    c = facing / d
    if transmissive:
        c = abs(c)
    best = 1.0
    if c < cos_u:
        best = c * cos_u + math.sqrt(max(0.0, 1.0 - c * c)) * sin_u
        if best <= 0.0:
            return 0.0
    axis = -(v[AX] * dx + v[AY] * dy + v[AZ] * dz) / d
    shine = _facing(v, axis, cos_u, sin_u)
    if v[BEHIND] > 0.0:
        shine = max(shine, v[BEHIND] * _facing(v, -axis, cos_u, sin_u))
    if shine <= 0.0:
        return 0.0
    # the mean of a bound and of what the centre would give: neither misses light nor wastes samples on the edge
    if kind == CLUSTER:
        likely = _facing(v, axis, 1.0, 0.0)
        if v[BEHIND] > 0.0:
            likely = max(likely, v[BEHIND] * _facing(v, -axis, 1.0, 0.0))
    elif kind == LAMP:
        likely = lamp_falloff(lamps, tree.item[node], dx / d, dy / d, dz / d)
    else:
        likely = max(axis, -axis * v[BEHIND])
    return 0.5 * near * (best * shine + max(0.0, c) * max(0.0, likely))


@_jit
def choose_light(tree, lamps, px, py, pz, nx, ny, nz, transmissive, u):
    """Choose a leaf: (node, probability); node -1 if nothing lights the point."""
    total = 0.0
    chosen = -1
    weight = 0.0
    for k in range(len(tree.tops)):
        w = node_importance(tree, lamps, tree.tops[k], px, py, pz, nx, ny, nz, transmissive)
        if w > 0.0:
            total += w
            share = w / total
            if u < share:
                chosen = tree.tops[k]
                weight = w
                u = u / share
            else:
                u = (u - share) / (1.0 - share)
    if chosen < 0:
        return -1, 0.0
    probability = weight / total
    while tree.kind[chosen] == CLUSTER:
        left = tree.item[chosen]
        a = node_importance(tree, lamps, left, px, py, pz, nx, ny, nz, transmissive)
        b = node_importance(tree, lamps, left + 1, px, py, pz, nx, ny, nz, transmissive)
        if a + b <= 0.0:
            return -1, 0.0
        share = a / (a + b)
        if u < share:
            chosen = left
            u = u / share
            probability *= share
        else:
            chosen = left + 1
            u = (u - share) / (1.0 - share)
            probability *= b / (a + b)
    return chosen, probability


@_jit
def light_probability(tree, lamps, leaf, px, py, pz, nx, ny, nz, transmissive):
    """Probability with which `choose_light` chooses that leaf."""
    probability = 1.0
    node = leaf
    while tree.top[node] < 0:
        parent = tree.parent[node]
        left = tree.item[parent]
        own = node_importance(tree, lamps, node, px, py, pz, nx, ny, nz, transmissive)
        if own <= 0.0:
            return 0.0
        other = left + 1 if node == left else left
        rest = node_importance(tree, lamps, other, px, py, pz, nx, ny, nz, transmissive)
        probability *= own / (own + rest)
        node = parent
    own = node_importance(tree, lamps, node, px, py, pz, nx, ny, nz, transmissive)
    if own <= 0.0:
        return 0.0
    total = 0.0
    for k in range(len(tree.tops)):
        total += node_importance(tree, lamps, tree.tops[k], px, py, pz, nx, ny, nz, transmissive)
    return probability * own / total
