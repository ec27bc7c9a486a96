"""The light tree of a scene: what is kept of each lamp, emissive triangle and the world, and the nodes above them."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.raytracing import lamps as lamp_kinds
from pointmr_engine.raytracing.emitters import BACK, FRONT, Emitters
from pointmr_engine.raytracing.environment import OFF, WorldMap
from pointmr_engine.raytracing.lamps import Lamps
from pointmr_engine.raytracing.light_tree_nodes import (
    ALWAYS,
    AX,
    AZ,
    BEHIND,
    COLUMNS,
    COS_O,
    COS_OE,
    CX,
    CZ,
    EDGE,
    ENERGY,
    GRID,
    HX,
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
    LightTree,
)
from pointmr_engine.raytracing.light_tree_split import gather, split

_FEW = 32  # lights that are all weighed at every point
_TOPS = 16  # nodes weighed at the top of a tree
_CLOSED = 0.05  # importance of the inside of closed meshes
_FAINT = 1 / 64  # share of the energy below which a cluster is not worth opening there: its descent will do


def build_light_tree(
    lamps: Lamps, emitters: Emitters, world: WorldMap, lamps_apart: bool = False, world_apart: bool = False
) -> LightTree:
    """The tree over all emissive triangles, and those of lamps and the world that are not apart: these are ALWAYS."""
    distant = np.isin(lamps.shape, (lamp_kinds.DISTANT, lamp_kinds.SUN))
    near, far = np.flatnonzero(~distant & (not lamps_apart)), np.flatnonzero(distant & (not lamps_apart))
    values = np.concatenate([_lamp_values(lamps, near), _emitter_values(emitters)])
    item = np.concatenate([near, np.arange(len(emitters.path))]).astype(np.int32)
    far_values, far_item = _sun_values(lamps, far), far
    if world.mode != OFF and not world_apart:
        row = np.zeros((1, COLUMNS))
        row[0, ENERGY], row[0, KIND] = world.irradiance, WORLD
        row[0, AX : AZ + 1] = world.towards
        far_values, far_item = np.concatenate([far_values, row]), np.append(far, 0)
    n, lights = len(item), len(item) + len(far_item)
    if n > _FEW:
        order, span, above, child = split(values)
        values, item = values[order], item[order]
        clusters = gather(values, span, child)
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
    leaf_of_lamp = np.full(len(lamps.shape), ALWAYS if lamps_apart else -1, np.int32)
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
        int(worlds[0]) if len(worlds) else (ALWAYS if world_apart and world.mode != OFF else -1),
    )


def _lamp_values(lamps: Lamps, index: np.ndarray) -> np.ndarray:
    """Node values (n, COLUMNS) of the lamps `index`, which have a place."""
    out = np.zeros((len(index), COLUMNS))
    out[:, KIND], out[:, EDGE], out[:, STEEP] = LAMP, -2.0, 1.0
    for k, i in enumerate(index):
        row, shape = lamps.values[i], lamps.shape[i]
        energy = float(np.abs(lamps.radiance[i]).mean() * lamps.factor[i])
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
    energy = np.abs(lamps.radiance[index]).mean(1) * lamps.factor[index]
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
