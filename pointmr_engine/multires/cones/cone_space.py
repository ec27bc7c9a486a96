"""From the world into a cone's space, through nested instances: float64 matrices, then float32 about a hierarchy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.acceleration import Acceleration
from pointmr_engine.hierarchy.prefilter import Prefiltered
from pointmr_engine.numerics.dither import ORDERS, RANKS
from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.pointers import (
    load_f64,
    pointer_f64,
    store_f32,
)
from pointmr_engine.numerics.simd_cone import (
    BOX_ROWS,
    CONSTANTS,
    DENSE,
    ELLIPSE_ROWS,
    FAR,
    MATRIX,
    NEAR,
    PAD,
    REACH,
    SMALL,
    SOLID,
    SPREAD_X,
    SPREAD_Y,
    START_X,
    START_Y,
    TRIANGLE_ROWS,
    WHOLE,
)

# of the coordinates about a hierarchy's centre: more than the roundings of its boxes in cone space
PADDING = 1e-6
PHASES, LEVELS = 64, 16  # of the ordered dither
KIND, FLAGS, BOTTOM, SEED = 0, 1, 2, 3  # columns of Levels.state


class Style(NamedTuple):
    """What is drawn as points, and how."""

    # cells: boxes no larger are drawn as their prefiltered point; 0: only triangles are met
    small: float = 2.5
    reach: float = 2.05  # radius of an ellipse in standard deviations; a disk's edge is at 2
    # times the share of the ellipse that surfaces cover: from 1 on it is drawn without gaps
    solid: float = 1.1
    dense: float = 1.0  # times the share that clumps cover
    # cells times spread: no box is small that is larger, for wide cones see its near part larger
    wide: float = 1.5
    whole: float = 0.75  # share of an ellipse of two standard deviations from which a surface has no gaps


class Levels(NamedTuple):
    """The hierarchies that the walk is inside of, groups and at last a shape, one row per level."""

    matrix: np.ndarray  # (levels, 12) float64: cone_from_local
    constants: np.ndarray  # (levels, CONSTANTS) float32, of numerics.simd_cone
    # (levels, 4) int64: ~group or the part; visibility bits of the path; the bottom of the stack; a hash of the path
    state: np.ndarray
    chain: np.ndarray  # (levels, 2) int64: the instance records walked down, and their batches
    depth: np.ndarray  # (levels,) int64: number of instances above
    offset: np.ndarray  # (levels,) float64: t of the centre that the level's constants are about


class Scratch(NamedTuple):
    """A call's working memory."""

    stack: np.ndarray  # (entries, 2) int64: children to be visited, sub-rays that may meet them
    fronts: np.ndarray  # (entries,) float32: where their boxes begin
    constants: int  # address of Levels.constants
    boxes: int  # addresses of rows of eight float32, of numerics.simd_cone
    ellipses: int
    triangles: int
    kept: np.ndarray  # the memory of these rows


class Scene(NamedTuple):
    """Addresses of what has been prefiltered."""

    points: int
    some: int
    every: int
    part_opacity: int
    slot_opacity: int
    mixed: int  # 1: not everything is visible to all rays
    clear: int  # 1: not everything is opaque
    columns: int  # (64,) int64: sub-rays in columns first..last, at 8 * first + last
    lines: int  # (64,) int64: of lines
    dither: int  # (PHASES * (LEVELS + 1),) int64


def _range_masks() -> tuple[np.ndarray, np.ndarray]:
    bits = np.arange(64, dtype=np.uint64)
    columns, lines = np.zeros(64, np.uint64), np.zeros(64, np.uint64)
    for first in range(8):
        for last in range(8):
            for out, at in ((columns, bits % np.uint64(8)), (lines, bits // np.uint64(8))):
                inside = (at >= first) & (at <= last)
                out[8 * first + last] = (inside.astype(np.uint64) << bits).sum(dtype=np.uint64)
    return columns, lines


def _dither() -> np.ndarray:
    """Masks with about level / LEVELS of the bits, spread evenly over the square, in PHASES different orders."""
    masks = np.zeros((PHASES, LEVELS + 1), np.uint64)
    for phase in range(PHASES):
        rank = RANKS[phase % ORDERS].ravel() ^ (phase // ORDERS * 8)
        for level in range(LEVELS + 1):
            on = (rank * LEVELS < level * 64).astype(np.uint64)
            masks[phase, level] = (on << np.arange(64, dtype=np.uint64)).sum(dtype=np.uint64)
    return masks


_COLUMN_MASKS, _LINE_MASKS = _range_masks()
_DITHER_MASKS = _dither()


def scene_of(prefiltered: Prefiltered) -> Scene:
    """Addresses for kernels; `prefiltered` must be kept alive."""
    return Scene(
        prefiltered.points.ctypes.data,
        prefiltered.visibility[0].ctypes.data,
        prefiltered.visibility[1].ctypes.data,
        prefiltered.part_opacity.ctypes.data,
        prefiltered.slot_opacity.ctypes.data,
        int(prefiltered.mixed),
        int(bool((prefiltered.part_opacity != 1).any())),
        _COLUMN_MASKS.ctypes.data,
        _LINE_MASKS.ctypes.data,
        _DITHER_MASKS.ctypes.data,
    )


def allocate(acceleration: Acceleration) -> tuple[Levels, Scratch]:
    """Working memory of one call."""
    depth = acceleration.arrays.levels + 2
    lanes = np.zeros(8 * (BOX_ROWS + ELLIPSE_ROWS + TRIANGLE_ROWS), np.float32)
    levels = Levels(
        np.empty((depth, 12)),
        np.zeros((depth, CONSTANTS), np.float32),
        np.zeros((depth, 4), np.int64),
        np.zeros((depth, 2), np.int64),
        np.zeros(depth, np.int64),
        np.zeros(depth),
    )
    stack = np.empty((acceleration.arrays.stack_size + 16, 2), np.int64)
    at = lanes.ctypes.data
    ellipses = at + 32 * BOX_ROWS
    triangles = ellipses + 32 * ELLIPSE_ROWS
    fronts = np.empty(len(stack), np.float32)
    return levels, Scratch(stack, fronts, levels.constants.ctypes.data, at, ellipses, triangles, lanes)


@device
def set_cone(levels, cones, n):
    """Row 0 of levels.matrix: cone_from_world."""
    m = levels.matrix
    ox, oy, oz = cones.origin[n, 0], cones.origin[n, 1], cones.origin[n, 2]
    for r in range(3):
        a, b, c = cones.axes[n, r, 0], cones.axes[n, r, 1], cones.axes[n, r, 2]
        m[0, 4 * r], m[0, 4 * r + 1], m[0, 4 * r + 2] = a, b, c
        m[0, 4 * r + 3] = -(a * ox + b * oy + c * oz)


@device
def append(levels, level, address, i):
    """Row level + 1 of the matrices: row `level` times placement i of the transforms at an address."""
    m, t, at = levels.matrix, pointer_f64(address), 12 * i
    for r in range(3):
        a, b, c = m[level, 4 * r], m[level, 4 * r + 1], m[level, 4 * r + 2]
        for k in range(3):
            m[level + 1, 4 * r + k] = a * t[at + k] + b * t[at + 4 + k] + c * t[at + 8 + k]
        moved = a * t[at + 3] + b * t[at + 7] + c * t[at + 11]
        m[level + 1, 4 * r + 3] = moved + m[level, 4 * r + 3]


@device
def set_constants(levels, level, address, centers, radii, hierarchy, cones, n, style):
    """Constants of a level for boxes that lie about a centre; address: of levels.constants."""
    m = levels.matrix
    x, y, z = (
        load_f64(centers, 3 * hierarchy),
        load_f64(centers, 3 * hierarchy + 1),
        load_f64(centers, 3 * hierarchy + 2),
    )
    at = CONSTANTS * level
    scale, offset = 0.0, 0.0
    for r in range(3):
        a, b, c = m[level, 4 * r], m[level, 4 * r + 1], m[level, 4 * r + 2]
        moved = a * x + b * y + c * z + m[level, 4 * r + 3]
        scale = max(scale, abs(a) + abs(b) + abs(c))
        store_f32(address, at + MATRIX + 4 * r, np.float32(a))
        store_f32(address, at + MATRIX + 4 * r + 1, np.float32(b))
        store_f32(address, at + MATRIX + 4 * r + 2, np.float32(c))
        if r < 2:
            offset = max(offset, abs(moved))
            store_f32(address, at + MATRIX + 4 * r + 3, np.float32(moved))
        else:
            levels.offset[level] = moved
            # t about the centre, so that it is as precise as the hierarchy, however far that is
            store_f32(address, at + MATRIX + 11, np.float32(0))
            store_f32(address, at + START_X, np.float32(cones.start[n, 0] + cones.spread[n, 0] * moved))
            store_f32(address, at + START_Y, np.float32(cones.start[n, 1] + cones.spread[n, 1] * moved))
            store_f32(address, at + SPREAD_X, np.float32(cones.spread[n, 0]))
            store_f32(address, at + SPREAD_Y, np.float32(cones.spread[n, 1]))
            store_f32(address, at + NEAR, np.float32(cones.t_min[n] - moved))
            store_f32(address, at + FAR, np.float32(cones.t_max[n] - moved))
    widest = max(abs(cones.spread[n, 0]), abs(cones.spread[n, 1]), 1e-9)
    store_f32(address, at + PAD, np.float32(PADDING * (offset + scale * load_f64(radii, hierarchy))))
    store_f32(address, at + SMALL, np.float32(min(style.small, style.wide / widest)))
    store_f32(address, at + REACH, np.float32(style.reach * style.reach))
    store_f32(address, at + SOLID, np.float32(style.solid))
    store_f32(address, at + DENSE, np.float32(style.dense))
    store_f32(address, at + WHOLE, np.float32(style.whole * 4.0))
