"""Which light to sample at a point: importances of lights and of clusters in a tree (Conty Estevez and Kulla 2018).

A handful of lights are all weighed at every point. Of many, a few clusters at the top of the tree are weighed, and one
of them is descended. The probability of any light is found by climbing from its leaf.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing import lamps as lamp_kinds
from pointmr_engine.raytracing.emitters import BACK, FRONT, Emitters
from pointmr_engine.raytracing.environment import OFF, WorldMap
from pointmr_engine.raytracing.lamps import Lamps

CLUSTER, LAMP, TRIANGLE, SUN, WORLD = range(5)  # kinds of nodes

# columns of LightTree.values
# box: centre, half sides, half diagonal; axis of the cone
CX, CY, CZ, HX, HY, HZ, RADIUS, AX, AY, AZ = range(10)
# the cone of the lights' axes: cos and sin of its half angle; cos of that plus the angle of emission; the share of
# importance against the axis; radiance times area
COS_O, SIN_O, COS_OE, BEHIND, ENERGY = range(10, 15)
KIND = 15  # as LightTree.kind
# how a lamp's intensity falls off with the cosine c to its axis: smoothstep((c - EDGE) * STEEP), and a factor
# LAMBERT ? c : 1, and a factor 1 - GRID * tan
EDGE, STEEP, LAMBERT, GRID = range(16, 20)
COLUMNS = 20

_FEW = 32  # lights that are all weighed at every point
_TOPS = 16  # nodes weighed at the top of a tree
_FAINT = 1 / 64  # share of the energy below which a cluster is not worth opening there: its descent will do
ALWAYS = -2  # in place of a light's node: it is not in the tree, for every point samples it
_CLOSED = 0.05  # importance of the inside of closed meshes


class LightTree(NamedTuple):
    """Nodes over all lights: near lights in the order of the tree, distant ones, then clusters.

    A cluster has two children, side by side, or none: then it is a bucket of few lights, all weighed.
    """

    kind: np.ndarray  # (M,) uint8
    item: np.ndarray  # (M,) int32: lamp or emitter; a cluster's first child, -1: it is a bucket
    span: np.ndarray  # (M, 2) int32: first and behind-last light of a cluster
    parent: np.ndarray  # (M,) int32, -1 where none
    top: np.ndarray  # (M,) int32: place in `tops`, -1 below and above them
    tops: np.ndarray  # (K,) int32: the nodes among which a light is first chosen; they cover each light once
    values: np.ndarray  # (M, COLUMNS) float64
    leaf_of_lamp: np.ndarray  # (L,) int32, or ALWAYS, here and below
    leaf_of_emitter: np.ndarray  # (E,) int32
    leaf_of_world: int  # -1: not sampled


def build_light_tree(lamps: Lamps, emitters: Emitters, world: WorldMap, apart: bool = False) -> LightTree:
    """The tree over all lamps, emissive triangles and the world. apart: over the triangles alone, the others ALWAYS."""
    distant = np.isin(lamps.shape, (lamp_kinds.DISTANT, lamp_kinds.SUN))
    near, far = np.flatnonzero(~distant & (not apart)), np.flatnonzero(distant & (not apart))
    values = np.concatenate([_lamp_values(lamps, near), _emitter_values(emitters)])
    item = np.concatenate([near, np.arange(len(emitters.path))]).astype(np.int32)
    far_values, far_item = _sun_values(lamps, far), far
    if world.mode != OFF and not apart:
        row = np.zeros((1, COLUMNS))
        row[0, ENERGY], row[0, KIND] = world.irradiance, WORLD
        far_values, far_item = np.concatenate([far_values, row]), np.append(far, 0)
    n, lights = len(item), len(item) + len(far_item)
    if n > _FEW:
        from pointmr_engine.raytracing import light_tree_build

        order, span, above, child = light_tree_build.split(values)
        values, item = values[order], item[order]
        clusters = light_tree_build.gather(values, span, child)
        bucket = np.flatnonzero(child < 0)
        of_light = np.zeros(n, np.int32)
        of_light[span[bucket, 0]] = 1
        of_light = bucket[np.argsort(span[bucket, 0])][np.cumsum(of_light) - 1] + lights
        parent = np.concatenate(
            [of_light, np.full(len(far_item), -1), np.where(above < 0, -1, above + lights)]
        )
        child = np.where(child < 0, -1, child + lights)
        tops = _top_nodes(child, span, clusters, lights)
    else:
        clusters, span, child = np.zeros((0, COLUMNS)), np.zeros((0, 2), np.int32), np.zeros(0, np.int32)
        parent = np.full(lights, -1)
        tops = list(range(n))
    values = np.concatenate([values, far_values, clusters])
    kind = values[:, KIND].astype(np.uint8)
    item = np.concatenate([item, far_item, child]).astype(np.int32)
    own = np.arange(lights, dtype=np.int32)
    tops = np.array([*tops, *range(n, lights)], np.int32)
    top = np.full(len(kind), -1, np.int32)
    top[tops] = np.arange(len(tops))
    leaf_of_lamp = np.full(len(lamps.shape), ALWAYS if apart else -1, np.int32)
    leaf_of_emitter = np.full(len(emitters.path), -1, np.int32)
    for leaf_of, kinds in ((leaf_of_lamp, (LAMP, SUN)), (leaf_of_emitter, (TRIANGLE,))):
        leaves = np.flatnonzero(np.isin(kind[:lights], kinds))
        leaf_of[item[leaves]] = leaves
    worlds = np.flatnonzero(kind == WORLD)
    return LightTree(
        kind,
        item,
        np.concatenate([np.stack([own, own + 1], 1), span]).astype(np.int32),
        parent.astype(np.int32),
        top,
        tops,
        np.ascontiguousarray(values),
        leaf_of_lamp,
        leaf_of_emitter,
        int(worlds[0]) if len(worlds) else (ALWAYS if apart and world.mode != OFF else -1),
    )


def _lamp_values(lamps: Lamps, index: np.ndarray) -> np.ndarray:
    """Node values (n, COLUMNS) of the lamps `index`, which have a place."""
    out = np.zeros((len(index), COLUMNS))
    out[:, KIND], out[:, EDGE], out[:, STEEP] = LAMP, -2.0, 1.0
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
            out[k, LAMBERT], out[k, GRID] = 1.0, 1.0 / max(tangent, 1e-9)
        else:
            radius = row[lamp_kinds.RADIUS]
            out[k, HX : HZ + 1] = out[k, RADIUS] = radius
            energy *= math.pi * radius * radius if radius > 0.0 else 1.0
            if row[lamp_kinds.SPOT]:
                cone = (1.0, 0.0, max(-1.0, 1.0 - row[lamp_kinds.SPOT_CONE]), 0.0, energy)
                out[k, EDGE], out[k, STEEP] = row[lamp_kinds.COS_HALF], row[lamp_kinds.SMOOTH]
            else:
                cone = (-1.0, 0.0, -1.0, 1.0, energy)
        out[k, COS_O : ENERGY + 1] = cone
    return out


def _sun_values(lamps: Lamps, index: np.ndarray) -> np.ndarray:
    """Node values of suns: the axis leads to the sun, COS_O and SIN_O are of its half angle, ENERGY its irradiance."""
    out = np.zeros((len(index), COLUMNS))
    out[:, KIND] = SUN
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
    out[:, KIND] = TRIANGLE
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


def _top_nodes(first_child: np.ndarray, span: np.ndarray, clusters: np.ndarray, lights: int) -> list[int]:
    """Nodes that cover the tree, the first `lights` of them lights: the large and bright clusters are opened."""
    tops, size = [lights], clusters[:, ENERGY] * clusters[:, RADIUS]
    faint = _FAINT * clusters[0, ENERGY]
    while True:
        best, most = -1, -1.0
        for k in tops:
            if k < lights or not clusters[k - lights, ENERGY] >= faint or size[k - lights] <= most:
                continue
            first, last = span[k - lights]
            parts = 2 if first_child[k - lights] >= 0 else last - first
            if len(tops) - 1 + parts <= _TOPS:
                best, most = k, size[k - lights]
        if best < 0:
            return tops
        tops.remove(best)
        child = int(first_child[best - lights])
        tops += [child, child + 1] if child >= 0 else range(*(int(x) for x in span[best - lights]))


@uncounted
def _facing(cosine, cos_u, sin_u, cos_o, sin_o, cos_oe):
    """Cosine at which a cluster's lights shine towards a point, at best: 0 if none of them does.

    cosine: of the angle between the cluster's axis and the direction to the point; u: half angle that the box fills;
    o: half angle of the cone of axes; oe: that and the angle of emission.
    """
    if cosine >= cos_u:
        return 1.0
    c = cosine * cos_u + math.sqrt(max(0.0, 1.0 - cosine * cosine)) * sin_u
    if c >= cos_o:
        return 1.0
    if c <= cos_oe:
        return 0.0
    return max(0.0, c * cos_o + math.sqrt(max(0.0, 1.0 - c * c)) * sin_o)


@uncounted
def _far_importance(values, node, nx, ny, nz, transmissive):
    """node_importance of suns and the world."""
    energy = values[node, ENERGY]
    if values[node, KIND] == WORLD:
        return energy
    c = values[node, AX] * nx + values[node, AY] * ny + values[node, AZ] * nz
    if transmissive:
        c = abs(c)
    if c >= values[node, COS_O]:
        return energy
    best = c * values[node, COS_O] + math.sqrt(max(0.0, 1.0 - c * c)) * values[node, SIN_O]
    return 0.5 * energy * (max(0.0, best) + max(0.0, c))


@uncounted
def _falloff(values, node, cosine):
    """Share of a lamp's strongest intensity that leaves its centre at an angle to its axis."""
    t = min(1.0, max(0.0, (cosine - values[node, EDGE]) * values[node, STEEP]))
    share = t * t * (3.0 - 2.0 * t)
    if values[node, LAMBERT] != 0.0:
        if cosine <= 0.0:
            return 0.0
        sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
        share = max(0.0, cosine - values[node, GRID] * sine)
    return share


@uncounted
def node_importance(values, node, px, py, pz, nx, ny, nz, transmissive):
    """Roughly the irradiance that a node's lights give to a point without shadows; 0 only if they give nothing.

    values: LightTree.values, all that is read, for calls with whole trees are slow.
    """
    kind = values[node, KIND]
    if kind >= SUN:
        return _far_importance(values, node, nx, ny, nz, transmissive)
    dx, dy, dz = values[node, CX] - px, values[node, CY] - py, values[node, CZ] - pz
    facing = nx * dx + ny * dy + nz * dz
    if not transmissive:
        reach = abs(nx) * values[node, HX] + abs(ny) * values[node, HY] + abs(nz) * values[node, HZ]
        if facing + reach <= 0.0:
            return 0.0
    d2 = dx * dx + dy * dy + dz * dz
    radius = values[node, RADIUS]
    r2 = radius * radius
    near = values[node, ENERGY] / max(d2, max(0.25 * r2, 1e-300))
    if d2 <= r2 * 1.000001:
        return near
    inverse = 1.0 / math.sqrt(d2)
    sin_u = radius * inverse
    cos_u = math.sqrt(max(0.0, 1.0 - sin_u * sin_u))
    c = facing * inverse
    if transmissive:
        c = abs(c)
    best = 1.0
    if c < cos_u:
        best = c * cos_u + math.sqrt(max(0.0, 1.0 - c * c)) * sin_u
        if best <= 0.0:
            return 0.0
    axis = -(values[node, AX] * dx + values[node, AY] * dy + values[node, AZ] * dz) * inverse
    cos_o, sin_o, cos_oe = values[node, COS_O], values[node, SIN_O], values[node, COS_OE]
    behind = values[node, BEHIND]
    shine = _facing(axis, cos_u, sin_u, cos_o, sin_o, cos_oe)
    if behind > 0.0:
        shine = max(shine, behind * _facing(-axis, cos_u, sin_u, cos_o, sin_o, cos_oe))
    if shine <= 0.0:
        return 0.0
    # the mean of a bound and of what the centre would give: neither misses light nor wastes samples on the edge
    if kind == TRIANGLE:
        likely = max(axis, -axis * behind)
    elif kind == LAMP:
        likely = _falloff(values, node, axis)
    else:
        likely = axis if axis >= 0.0 else (-axis if behind > 0.0 else axis)
        if likely >= cos_o:
            likely = 1.0
        else:
            likely = likely * cos_o + math.sqrt(max(0.0, 1.0 - likely * likely)) * sin_o
        if axis < 0.0 and behind > 0.0:
            likely *= behind
    return 0.5 * near * (best * shine + max(0.0, c) * max(0.0, likely))


@uncounted
def _weigh(values, item, span, node, px, py, pz, nx, ny, nz, transmissive):
    """Importance of a node; of a bucket the sum of its lights', which promises no more than they hold."""
    if values[node, KIND] != CLUSTER or item[node] >= 0:
        return node_importance(values, node, px, py, pz, nx, ny, nz, transmissive)
    total = 0.0
    for light in range(np.int64(span[node, 0]), np.int64(span[node, 1])):
        total += node_importance(values, light, px, py, pz, nx, ny, nz, transmissive)
    return total


@uncounted
def choose_light(tree, px, py, pz, nx, ny, nz, transmissive, u, weights):
    """Choose a light's node: (node, probability); node -1 if nothing lights the point. weights: scratch, as `tops`.

    Each light has one interval of u, so that well spread numbers choose well spread lights.
    """
    values, item, span, tops = tree.values, tree.item, tree.span, tree.tops
    total = 0.0
    chosen = np.int64(-1)
    weight = 0.0
    for k in range(len(tops)):
        weights[k] = _weigh(values, item, span, np.int64(tops[k]), px, py, pz, nx, ny, nz, transmissive)
        total += weights[k]
    u *= total
    for k in range(len(tops)):
        if weights[k] > 0.0:
            chosen = np.int64(tops[k])
            weight = weights[k]
            if u < weight:
                break
            u -= weight
    if chosen < 0:
        return -1, 0.0
    u = min(u / weight, 1.0 - 1e-15)
    probability = weight / total
    while values[chosen, KIND] == CLUSTER and item[chosen] >= 0:
        left = np.int64(item[chosen])
        a = _weigh(values, item, span, left, px, py, pz, nx, ny, nz, transmissive)
        b = _weigh(values, item, span, left + 1, px, py, pz, nx, ny, nz, transmissive)
        if a + b <= 0.0:
            return -1, 0.0
        share = a / (a + b)
        if u < share:
            chosen = left
            weight = a
            u = u / share
            probability *= share
        else:
            chosen = left + 1
            weight = b
            u = (u - share) / (1.0 - share)
            probability *= b / (a + b)
    if values[chosen, KIND] != CLUSTER:
        return chosen, probability
    # a bucket: walk along its lights' weights, whose sum is known
    u *= weight
    light = -1
    w = 0.0
    for k in range(np.int64(span[chosen, 0]), np.int64(span[chosen, 1])):
        next_w = node_importance(values, k, px, py, pz, nx, ny, nz, transmissive)
        if next_w > 0.0:
            light = k
            w = next_w
            if u < w:
                break
            u -= w
    return light, probability * w / weight


@uncounted
def light_probability(tree, leaf, px, py, pz, nx, ny, nz, transmissive):
    """Probability with which `choose_light` chooses that light's node; 1 for ALWAYS."""
    if leaf == ALWAYS:
        return 1.0
    values, item, span, tops = tree.values, tree.item, tree.span, tree.tops
    probability = 1.0
    node = np.int64(leaf)  # node numbers of another type would have all compiled once more, here and above
    own = node_importance(values, node, px, py, pz, nx, ny, nz, transmissive)
    while tree.top[node] < 0:
        if own <= 0.0:
            return 0.0
        parent = np.int64(tree.parent[node])
        left = np.int64(item[parent])
        if left < 0:
            total = _weigh(values, item, span, parent, px, py, pz, nx, ny, nz, transmissive)
            probability *= own / total
            own = total
        else:
            other = left + 1 if node == left else left
            rest = _weigh(values, item, span, other, px, py, pz, nx, ny, nz, transmissive)
            probability *= own / (own + rest)
            own = _weigh(values, item, span, parent, px, py, pz, nx, ny, nz, transmissive)
        node = parent
    if own <= 0.0:
        return 0.0
    total = 0.0
    for k in range(len(tops)):
        total += _weigh(values, item, span, np.int64(tops[k]), px, py, pz, nx, ny, nz, transmissive)
    return probability * own / total
