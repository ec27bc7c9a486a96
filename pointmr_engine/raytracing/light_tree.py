"""Which light to sample at a point: importances of lights and of clusters in a tree (Conty Estevez and Kulla 2018).

A handful of lights are all weighed at every point. Of many, a few clusters at the top of the tree are weighed, and one
of them is descended. The probability of any light is found by climbing from its leaf.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing.light_tree_nodes import (
    ALWAYS,
    AX,
    AY,
    AZ,
    BEHIND,
    CLUSTER,
    COS_O,
    COS_OE,
    CX,
    CY,
    CZ,
    EDGE,
    ENERGY,
    GRID,
    HX,
    HY,
    HZ,
    KIND,
    LAMBERT,
    LAMP,
    RADIUS,
    SIN_O,
    STEEP,
    SUN,
    TRIANGLE,
    WORLD,
)

LEAST_OF_WORLD = 0.25  # of its mean irradiance: importance for surfaces that face its dark side


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
        if transmissive:
            return 2.0 * energy
        more = values[node, AX] * nx + values[node, AY] * ny + values[node, AZ] * nz
        return max(energy + more, LEAST_OF_WORLD * energy)
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
