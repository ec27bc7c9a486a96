"""Prefiltered points: what the surface below every child of an eight-wide hierarchy amounts to, seen from afar.

A point is the surface's area, centroid, covariance and normals (the tensor of sum A n n^T), exact for triangles and
merged upwards by the parallel-axis rule; through instances by their transforms.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy.acceleration import EMPTY, Acceleration, aligned_empty
from pointmr_engine.hierarchy.nesting import placed_group
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.pointers import address_of, load_f32, pointer_f64
from pointmr_engine.numerics.simd_cone import FLATNESS, POINT_ROWS, PP, XX, X
from pointmr_engine.scene.group import VISIBLE

# of 3 tr(M V) / (A tr V), 0 where all normals stand on the surface's extent, 1 where they stand anyhow: up to where
# points are drawn as surface, from where as clumps
SURFACE, CLUMP = 0.05, 0.3
# columns of points while they are merged: sums as their names say, the area that is covered and the room that its parts
# have to cover (means over all directions), the area if all were opaque, and within a shape the sum A n
_AREA, _MU, _V, _M, _SEEN, _ROOM, _SOLID, _NORMAL, _RAW = 0, 1, 4, 10, 16, 17, 18, 19, 22
DISK = 0.8660254037844386


class Prefiltered(NamedTuple):
    """One point for every child of every node of an Acceleration; K nodes."""

    # (K, 16, 8) float32, of eight children: x, y, z of the centroid about the hierarchy's centre; covariance xx, xy,
    # xz, yy, yz, zz per area; the tensor P, likewise, such that what it covers along unit w is sqrt(w^T P w); and 1
    # for flat ones to 0 for clumps, or minus the opacity of flat ones that can be seen through. Areas are one side's,
    # times opacity.
    points: np.ndarray
    # (2, K, 8) uint8: visibility bits that some, and that all, of what is below a child has
    visibility: np.ndarray
    mixed: bool  # False: everything is visible to all rays
    part_opacity: np.ndarray  # (parts,) float32, -1: look at the slot
    slot_opacity: np.ndarray  # (slots,) float32
    # (groups, 22) float64: area, centroid about the group's centre, covariance, sum A n n^T, and what `_overlap` uses
    group_raw: np.ndarray


@device
def _add(total, raw):
    """Merge one point into another, in place: (22,) float64."""
    a, b = total[_AREA], raw[_AREA]
    if not b > 0.0:
        return
    s = a + b
    share, cross = b / s, a * b / (s * s)
    dx, dy, dz = raw[_MU] - total[_MU], raw[_MU + 1] - total[_MU + 1], raw[_MU + 2] - total[_MU + 2]
    d = (dx * dx, dx * dy, dx * dz, dy * dy, dy * dz, dz * dz)
    for k in range(6):
        total[_V + k] = (1.0 - share) * total[_V + k] + share * raw[_V + k] + cross * d[k]
        total[_M + k] += raw[_M + k]
    total[_MU] += share * dx
    total[_MU + 1] += share * dy
    total[_MU + 2] += share * dz
    total[_AREA] = s
    total[_SEEN] += raw[_SEEN]
    total[_ROOM] += raw[_ROOM]
    total[_SOLID] += raw[_SOLID]
    for k in range(_NORMAL, _NORMAL + 3):
        total[k] += raw[k]


@device
def _triangle(blocks, at, opacity, raw):
    """raw = the triangle whose corners lie from float32 `at` on, 8 apart; False: it has no area."""
    p = (
        (load_f32(blocks, at), load_f32(blocks, at + 8), load_f32(blocks, at + 16)),
        (load_f32(blocks, at + 24), load_f32(blocks, at + 32), load_f32(blocks, at + 40)),
        (load_f32(blocks, at + 48), load_f32(blocks, at + 56), load_f32(blocks, at + 64)),
    )
    ax, ay, az = np.float64(p[0][0]), np.float64(p[0][1]), np.float64(p[0][2])
    bx, by, bz = p[1][0] - ax, p[1][1] - ay, p[1][2] - az
    cx, cy, cz = p[2][0] - ax, p[2][1] - ay, p[2][2] - az
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    double = np.sqrt(nx * nx + ny * ny + nz * nz)
    area = 0.5 * double * opacity
    if not (area > 0.0 and np.isfinite(area)):
        return False
    mx, my, mz = (bx + cx) / 3.0, (by + cy) / 3.0, (bz + cz) / 3.0
    raw[_AREA], raw[_SEEN] = area, 0.5 * area
    raw[_MU], raw[_MU + 1], raw[_MU + 2] = ax + mx, ay + my, az + mz
    # about the mean: (v_i - mu)(v_i - mu)^T of the three corners, with corner 0 at the origin
    bx, by, bz, cx, cy, cz = bx - mx, by - my, bz - mz, cx - mx, cy - my, cz - mz
    raw[_V] = (mx * mx + bx * bx + cx * cx) / 12.0
    raw[_V + 1] = (mx * my + bx * by + cx * cy) / 12.0
    raw[_V + 2] = (mx * mz + bx * bz + cx * cz) / 12.0
    raw[_V + 3] = (my * my + by * by + cy * cy) / 12.0
    raw[_V + 4] = (my * mz + by * bz + cy * cz) / 12.0
    raw[_V + 5] = (mz * mz + bz * bz + cz * cz) / 12.0
    s = area / (double * double)
    raw[_M], raw[_M + 1], raw[_M + 2] = s * nx * nx, s * nx * ny, s * nx * nz
    raw[_M + 3], raw[_M + 4], raw[_M + 5] = s * ny * ny, s * ny * nz, s * nz * nz
    raw[_ROOM] = raw[_SEEN]
    raw[_SOLID] = 0.5 * double
    half = 0.5 * opacity
    raw[_NORMAL], raw[_NORMAL + 1], raw[_NORMAL + 2] = half * nx, half * ny, half * nz
    return True


@device
def _congruent(c, s, out, at):
    """out[at : at + 6] = c S c^T for the symmetric S in s and the 3 x 3 matrix in the tuple c, row by row."""
    xx, xy, xz, yy, yz, zz = s
    k = at
    for i in range(3):
        x = c[3 * i] * xx + c[3 * i + 1] * xy + c[3 * i + 2] * xz
        y = c[3 * i] * xy + c[3 * i + 1] * yy + c[3 * i + 2] * yz
        z = c[3 * i] * xz + c[3 * i + 1] * yz + c[3 * i + 2] * zz
        for j in range(i, 3):
            out[k] = c[3 * j] * x + c[3 * j + 1] * y + c[3 * j + 2] * z
            k += 1


@device
def _placed(address, i, child, child_center, parent_center, raw):
    """raw = a child group's point in its parent, through placement i of the transforms at an address.

    Normals keep their share of the area on the average only: exact where all areas grow alike.
    """
    m = pointer_f64(address)
    at = 12 * i
    a, b, c = m[at], m[at + 1], m[at + 2]
    d, e, f = m[at + 4], m[at + 5], m[at + 6]
    g, h, k = m[at + 8], m[at + 9], m[at + 10]
    x, y, z = child[_MU] + child_center[0], child[_MU + 1] + child_center[1], child[_MU + 2] + child_center[2]
    raw[_MU] = a * x + b * y + c * z + (m[at + 3] - parent_center[0])
    raw[_MU + 1] = d * x + e * y + f * z + (m[at + 7] - parent_center[1])
    raw[_MU + 2] = g * x + h * y + k * z + (m[at + 11] - parent_center[2])
    _congruent(
        (a, b, c, d, e, f, g, h, k),
        (child[_V], child[_V + 1], child[_V + 2], child[_V + 3], child[_V + 4], child[_V + 5]),
        raw, _V,
    )  # fmt: skip
    cofactors = (
        e * k - f * h, f * g - d * k, d * h - e * g,
        c * h - b * k, a * k - c * g, b * g - a * h,
        b * f - c * e, c * d - a * f, a * e - b * d,
    )  # fmt: skip
    _congruent(
        cofactors,
        (child[_M], child[_M + 1], child[_M + 2], child[_M + 3], child[_M + 4], child[_M + 5]),
        raw, _M,
    )  # fmt: skip
    squared = raw[_M] + raw[_M + 3] + raw[_M + 5]
    grown = np.sqrt(squared / child[_AREA]) if child[_AREA] > 0.0 else 0.0
    raw[_AREA] = grown * child[_AREA]
    raw[_SEEN] = grown * child[_SEEN]
    raw[_ROOM] = grown * child[_ROOM]
    raw[_SOLID] = grown * child[_SOLID]
    for n in range(6):
        raw[_M + n] = raw[_M + n] / grown if grown > 0.0 else 0.0
    for n in range(3):  # shapes are whole here: what they hide of themselves is off
        raw[_NORMAL + n] = 0.0


@device
def _flatness(raw):
    """1 for what lies across its normals, as a surface does; 0 for what faces all ways."""
    v, m = _V, _M
    along = raw[v] * raw[m] + raw[v + 3] * raw[m + 3] + raw[v + 5] * raw[m + 5]
    along += 2.0 * (raw[v + 1] * raw[m + 1] + raw[v + 2] * raw[m + 2] + raw[v + 4] * raw[m + 4])
    size = (raw[v] + raw[v + 3] + raw[v + 5]) * raw[_AREA]
    bulk = 3.0 * along / size if size > 0.0 else 0.0
    return min(max((CLUMP - bulk) / (CLUMP - SURFACE), 0.0), 1.0)


@device
def _room(raw):
    """Mean area of the projections of the covariance's ellipse, of two standard deviations, over all directions."""
    xx, xy, xz, yy, yz, zz = raw[_V], raw[_V + 1], raw[_V + 2], raw[_V + 3], raw[_V + 4], raw[_V + 5]
    minors = yy * zz - yz * yz + xx * zz - xz * xz + xx * yy - xy * xy
    det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    third = (xx + yy + zz) / 3.0
    bulk = min(max(det / (third * third * third), 0.0), 1.0) if third > 0.0 else 0.0
    # the root mean square, and what it is more than the mean: nothing for a ball, 2 / sqrt(3) for a disk
    return 4.0 * np.pi * np.sqrt(max(minors, 0.0) / 3.0) * (DISK + (1.0 - DISK) * bulk)


@device
def _overlap(raw):
    """Take off what the parts of a node cover of each other.

    Parts cover a share of their room, and lie in as many layers as their rooms together are more than the node's.
    """
    room = _room(raw)
    if raw[_ROOM] > room and room > 0.0:
        layers, share = raw[_ROOM] / room, min(raw[_SEEN] / raw[_ROOM], 1.0)
        raw[_SEEN] = room * (1.0 - (1.0 - share) ** layers)
    raw[_ROOM] = max(room, raw[_SEEN])


@device
def _hide_backs(raw):
    """Take off what a part of a closed surface hides of itself: its back, or its front where there is less of that.

    Of a ball half of what faces all ways, a quarter of its area, as Cauchy's theorem has it for all that is convex.
    """
    x, y, z = raw[_NORMAL], raw[_NORMAL + 1], raw[_NORMAL + 2]
    if raw[_AREA] > 0.999 * raw[_SOLID]:
        raw[_SEEN] = min(raw[_SEEN], 0.25 * (raw[_AREA] + np.sqrt(x * x + y * y + z * z)))


@device
def _store(points, node, c, raw):
    """Write a point as kernels read it."""
    area = raw[_AREA]
    for r in range(POINT_ROWS):
        points[node, r, c] = np.float32(0)
    for k in range(3):
        points[node, X + k, c] = np.float32(raw[_MU + k])
    if not area > 0.0:
        return
    for k in range(6):
        points[node, XX + k, c] = np.float32(raw[_V + k])
    # sqrt(A w^T M w) is the root mean square of the normals' cosines, which is more than their mean: by nothing for one
    # normal, by 2 / sqrt(3) for all directions alike
    one = 0.0
    for k in range(6):
        one += raw[_M + k] * raw[_M + k] * (1.0 if k == 0 or k == 3 or k == 5 else 2.0)
    spread = min(max(1.5 * (1.0 - one / (area * area)), 0.0), 1.0)
    factor = (1.0 - (1.0 - DISK) * spread) * (2.0 * raw[_SEEN] / area)
    for k in range(6):
        points[node, PP + k, c] = np.float32(factor * factor * area * raw[_M + k])
    flat, opacity = _flatness(raw), area / raw[_SOLID]
    if opacity < 0.999:
        flat = -opacity if flat > 0.5 else 0.0
    points[node, FLATNESS, c] = np.float32(flat)


@uncounted
def _shape_points(
    children, first, stop, blocks, block_triangles, first_triangle, opacity, closed, points, raw, one
):
    """Points of a shape's nodes first..stop, the root first; raw (K, 22): of what nodes stand for.

    closed: Shape.closed.
    """
    for node in range(stop - 1, first - 1, -1):
        for k in range(_RAW):
            raw[node, k] = 0.0
        for c in range(8):
            child = np.int64(children[node, c])
            for k in range(_RAW):
                one[0, k] = 0.0
            if child >= 0:
                for k in range(_RAW):
                    one[0, k] = raw[child, k]
            elif child != EMPTY:
                block = ~child
                for lane in range(8):
                    triangle = np.int64(block_triangles[block, lane])
                    if triangle >= 0:
                        share = 1.0
                        if len(opacity) > 0:
                            share = np.float64(opacity[triangle - first_triangle])
                        if _triangle(blocks, 72 * block + lane, share, one[1]):
                            _add(one[0], one[1])
                _overlap(one[0])
                if closed:
                    _hide_backs(one[0])
            _store(points, node, c, one[0])
            _add(raw[node], one[0])
        _overlap(raw[node])
        if closed:
            _hide_backs(raw[node])


@device
def _item(
    w, records, batches, item, parent, group_center, group_raw, group_flags, part_raw, part_center, one
):
    """one[0] = the point of an item of group `parent`; returns the visibility bits (some, all) below it."""
    record = np.int64(records[item])
    if record < 0:
        part = ~record
        for k in range(_RAW):
            one[0, k] = part_raw[part, k]
        for k in range(3):
            one[0, _MU + k] += part_center[part, k] - group_center[parent, k]
        return np.int64(VISIBLE), np.int64(VISIBLE)
    batch = np.int64(batches[item])
    i = record - w.first_record[batch]
    child = placed_group(w, batch, i)
    _placed(w.transforms[batch], i, group_raw[child], group_center[child], group_center[parent], one[0])
    own = np.int64(VISIBLE)
    at = w.visibility[batch, 0]
    if at >= 0:
        own = np.int64(w.visibility_values[at + w.visibility[batch, 1] * i]) & VISIBLE
    return own & group_flags[child, 0], own & group_flags[child, 1]


@uncounted
def _group_points(children, first, stop, w, records, batches, parent, group_center, group_raw, group_flags, part_raw,
                  part_center, points, visibility, raw, flags, one):  # fmt: skip
    """Points of a group's nodes first..stop, the root first, as _shape_points."""
    for node in range(stop - 1, first - 1, -1):
        for k in range(_RAW):
            raw[node, k] = 0.0
        some, every = np.int64(0), np.int64(VISIBLE)
        for c in range(8):
            child = np.int64(children[node, c])
            for k in range(_RAW):
                one[0, k] = 0.0
            if child != EMPTY:
                if child >= 0:
                    for k in range(_RAW):
                        one[0, k] = raw[child, k]
                    a, b = np.int64(flags[child, 0]), np.int64(flags[child, 1])
                else:
                    a, b = _item(w, records, batches, ~child, parent, group_center, group_raw, group_flags, part_raw,
                                 part_center, one)  # fmt: skip
                visibility[0, node, c], visibility[1, node, c] = np.uint8(a), np.uint8(b)
                some |= a
                every &= b
            _store(points, node, c, one[0])
            _add(raw[node], one[0])
        _overlap(raw[node])
        flags[node, 0], flags[node, 1] = some, every


@uncounted
def _single(
    w, records, batches, item, parent, group_center, group_raw, group_flags, part_raw, part_center, one
):
    """The point and the bits of a group that has one item only and so no node."""
    a, b = _item(
        w, records, batches, item, parent, group_center, group_raw, group_flags, part_raw, part_center, one
    )
    for k in range(_RAW):
        group_raw[parent, k] = one[0, k]
    group_flags[parent, 0], group_flags[parent, 1] = a, b


def prefilter(acceleration: Acceleration, opacity: np.ndarray | None = None) -> Prefiltered:
    """The points of a whole scene.

    opacity: (len(geometry.materials),) float, each material's mean opacity, 1 (the default) for what is opaque. Parts
    that share their triangles but not their materials share points of their mean opacity.
    """
    arrays, geometry = acceleration.arrays, acceleration.geometry
    tables, k = arrays.parts, len(arrays.children)
    points = aligned_empty((k, POINT_ROWS, 8), np.float32)
    visibility = np.full((2, k, 8), VISIBLE, np.uint8)
    raw, flags = np.zeros((k, _RAW)), np.full((k, 2), VISIBLE, np.int64)
    n_groups = len(arrays.group_root)
    group_raw, group_flags = np.zeros((n_groups, _RAW)), np.full((n_groups, 2), VISIBLE, np.int64)
    slot_opacity, part_opacity = _opacities(arrays, geometry, opacity)
    one = np.zeros((2, _RAW))
    # hierarchies follow each other: one ends where the next root is
    roots = np.sort(np.concatenate([arrays.shape_root, arrays.group_root, [k]]).astype(np.int64))
    shape_raw = np.zeros((max(len(arrays.shape_root), 1), _RAW))
    blocks = address_of(arrays.blocks)

    def end(root: int) -> int:
        return int(roots[np.searchsorted(roots, root, "right")])

    for s, root in enumerate(arrays.shape_root):
        if root >= 0:
            shares = _triangle_opacity(geometry, s, part_opacity, slot_opacity)
            shape = geometry.shapes[s]
            _shape_points(arrays.children, int(root), end(root), blocks, arrays.block_triangles, shape.first_triangle,
                          shares, shape.closed, points, raw, one)  # fmt: skip
            shape_raw[s] = raw[root]
    part_raw = np.ascontiguousarray(shape_raw[tables.shape]) if len(tables.shape) else shape_raw[:0]
    for g, root in enumerate(arrays.group_root):
        common = (g, arrays.group_center, group_raw, group_flags, part_raw, tables.center)
        items = (arrays.instances, arrays.item_record, arrays.item_batch)
        if root >= 0:
            _group_points(arrays.children, int(root), end(root), *items, *common, points, visibility, raw, flags,
                          one)  # fmt: skip
            group_raw[g], group_flags[g] = raw[root], flags[root]
        elif root != EMPTY:
            _single(*items, int(~root), *common, one)
    mixed = bool((visibility != VISIBLE).any())
    return Prefiltered(points, visibility, mixed, part_opacity, slot_opacity, group_raw)


def area_of(points: np.ndarray) -> np.ndarray:
    """(K, 8) float32: area of (K, 16, 8) points, times opacity, less what their parts hide of each other."""
    p = points[:, PP : PP + 6].astype(np.float64)
    trace = p[:, 0] + p[:, 3] + p[:, 5]
    square = (p * p).sum(1) + (p[:, [1, 2, 4]] ** 2).sum(1)
    with np.errstate(invalid="ignore", divide="ignore"):
        spread = np.clip(1.5 * (1.0 - square / trace**2), 0.0, 1.0)
    return np.where(trace > 0, np.sqrt(trace) / (1.0 - (1.0 - np.sqrt(0.75)) * spread), 0.0).astype(
        np.float32
    )


def _opacities(arrays, geometry, opacity) -> tuple[np.ndarray, np.ndarray]:
    """(of every slot, of every part: -1 where its slots differ)."""
    tables = arrays.parts
    slots = np.ones(len(tables.slot_material), np.float32)
    if opacity is not None:
        opacity = np.asarray(opacity, np.float32)
        if opacity.shape != (len(geometry.materials),):
            raise ValueError(f"opacity has shape {opacity.shape}, expected ({len(geometry.materials)},)")
        slots = opacity[tables.slot_material]
    part = np.full(len(tables.shape), -1, np.float32)
    for p, (first, count) in enumerate(zip(tables.first_slot, tables.slots, strict=True)):
        used = slots[first : first + count] if tables.material_index[p] else slots[first : first + 1]
        if (used == used[0]).all():
            part[p] = used[0]
    return slots, part


def _triangle_opacity(geometry, shape: int, part_opacity, slot_opacity) -> np.ndarray:
    """(T,) float32 opacity of a shape's triangles, () if all are opaque."""
    tables = geometry.tables
    parts = np.flatnonzero(tables.shape == shape)
    if (part_opacity[parts] == 1).all():
        return np.zeros(0, np.float32)
    total = np.zeros(len(geometry.shapes[shape].triangles), np.float32)
    for p in parts:
        if part_opacity[p] >= 0:
            total += part_opacity[p]
            continue
        slot = np.clip(geometry.parts[p].material_index, 0, tables.slots[p] - 1)
        total += slot_opacity[tables.first_slot[p] + slot]
    return total / np.float32(len(parts))
