"""Which boxes of the octrees are sampled as a whole, and which triangles are too large to be (talk: "Depth
Approximation").

A walk from the root through nested instances takes a box where its density can be one number: where
(z_max / z_min)^2 <= 1 + epsilon, no triangle in it expects more than a few points, and it looks no larger than what
culling needs; or where it is smaller than a fraction of a pixel. Otherwise it looks at the box's own items one by one
and goes on below it. What is outside the view is left.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.projection import inverse_depth, pixels_per_area, widest_slope
from pointmr_engine.forward.transforms import (
    Transforms,
    allocate_transforms,
    compose,
    compose_root,
    grow_transforms,
)
from pointmr_engine.hierarchy.distribution import Distribution
from pointmr_engine.hierarchy.nesting import area_scale
from pointmr_engine.hierarchy.octree import Octree
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.pointers import pointer_f32, pointer_f64, pointer_i32
from pointmr_engine.raytracing.camera import CameraArrays

TINY = 0.5  # pixels: a box whose sides look no longer is taken whatever its depths
TINY_AREA = 1.0  # pixels of area that it is sampled for at most, however much surface is folded into it
WIDE = 5.0  # pixels: a box that looks longer is not taken whole: small ones are hidden as a whole more often
CUT = 4.0  # pixels: the same where it reaches out of the image
_RUN = 64.0  # points


class View(NamedTuple):
    """What a walk needs to know of the image."""

    camera: CameraArrays
    planes: np.ndarray  # (4,) float64: least x, y, largest x, y of the region on the plane z = 1
    region: np.ndarray  # (4,) int64: x0, y0, x1, y1 in pixels of the whole image
    limits: (
        np.ndarray
    )  # (5,) float64: 1 + epsilon, points per pixel, KEPT, widest slope, back-face culling (0, 1)


class Boxes(NamedTuple):
    """K intervals of items, each sampled at one density."""

    row: np.ndarray  # (K,) int32 of the transforms
    interval: np.ndarray  # (K, 2) int32: first item, end
    area: np.ndarray  # (K,) float64: bound of the surface's size in pixels, orientation left out
    nearest: np.ndarray  # (K,) float32: bound of the inverse depth of all in it
    rectangle: np.ndarray  # (K, 4) int32: pixels x0, y0, x1, y1 that it may touch, inside the region


class TriangleList(NamedTuple):
    """Triangles to be rasterised."""

    part: np.ndarray  # (T,) int32
    triangle: np.ndarray  # (T,) int32, in its shape
    transform: np.ndarray  # (T,) int32 row of the transforms


class Selection(NamedTuple):
    """What an image is drawn from."""

    boxes: Boxes  # from front to back
    triangles: TriangleList
    transforms: Transforms
    scale: np.ndarray  # (rows,) float64: bound of the factor by which a row's matrix scales areas
    uniform: np.ndarray  # (rows,) bool: it is exact
    eye: View
    visited: int  # nodes looked at


class _Work(NamedTuple):
    stack: np.ndarray  # (S, 2) int32: node, row
    scale: np.ndarray
    uniform: np.ndarray
    used: np.ndarray  # (5,) int64: of stack, rows, boxes, triangles; nodes visited
    corner: np.ndarray  # (7,) float64: z_min, z_max, x0, y0, x1, y1 in pixels, squared slope


def make_view(
    camera: CameraArrays, points_per_pixel, epsilon, kept_points, backface_culling, region=None
) -> View:
    """The view of an image's region (x0, y0, x1, y1), None: the whole image."""
    size = camera.size
    region = (0, 0, int(size[0]), int(size[1])) if region is None else region
    corners = np.asarray(region, np.float64).reshape(2, 2)
    planes = (camera.plane[0] + corners * camera.plane[1]).ravel()
    slope = max(widest_slope(camera), math.hypot(*np.abs(planes.reshape(2, 2)).max(0)))
    limits = np.array([1.0 + epsilon, points_per_pixel, kept_points, slope, float(backface_culling)])
    return View(camera, planes, np.array(region, np.int64), limits)


def select_boxes(octree: Octree, distribution: Distribution, view: View) -> Selection:
    """Boxes and triangles that an image needs: O(log tau + h + a), a the surface in pixels."""
    geometry, arrays = octree.geometry, octree.arrays
    group = len(geometry.groups) - 1
    boxes, triangles, transforms = _boxes(1 << 14), _triangles(1 << 12), allocate_transforms(1 << 10)
    work = _Work(
        np.empty((1 << 12, 2), np.int32),
        np.empty(1 << 10),
        np.empty(1 << 10, np.bool_),
        np.zeros(5, np.int64),
        np.empty(7),
    )
    if group >= 0 and arrays.group_root[group] >= 0:
        compose_root(transforms, view.camera.camera_from_world, arrays, np.int64(group), np.int64(0))
        work.scale[0], work.uniform[0] = area_scale(transforms.matrix.ravel(), np.int64(0))
        work.stack[0] = arrays.group_root[group], 0
        work.used[:2] = 1
        while True:
            full = _walk(
                arrays,
                distribution,
                geometry.tables,
                geometry.instances,
                view,
                boxes,
                triangles,
                transforms,
                work,
            )
            if full < 0:
                break
            # as much room again as the node at hand may need, in whatever ran short
            stack, rows, taken, kept = work.used[:4] + full
            if stack > len(work.stack):
                work = work._replace(stack=_longer(work.stack, stack))
            if rows > len(work.scale):
                transforms = grow_transforms(transforms, int(work.used[1]), int(2 * rows))
                work = work._replace(scale=_longer(work.scale, rows), uniform=_longer(work.uniform, rows))
            if taken > len(boxes.row):
                boxes = Boxes(*(_longer(a, taken) for a in boxes))
            if kept > len(triangles.part):
                triangles = TriangleList(*(_longer(a, kept) for a in triangles))
    _, rows, taken, kept, visited = (int(n) for n in work.used)
    boxes = Boxes(*(a[:taken] for a in boxes))
    order = _front_to_back(boxes.nearest, boxes.area * view.limits[1])
    return Selection(
        Boxes(*(a[order] for a in boxes)),
        TriangleList(*(a[:kept] for a in triangles)),
        Transforms(*(a[:rows] for a in transforms)),
        work.scale[:rows],
        work.uniform[:rows],
        view,
        visited,
    )


def _front_to_back(nearest: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Order by depth of runs of boxes that follow each other in the walk, and so in space, _RUN points each."""
    if not len(nearest):
        return np.zeros(0, np.int64)
    run = np.floor(np.cumsum(expected) / _RUN).astype(np.int64)
    starts = np.flatnonzero(np.diff(run, prepend=run[0] - 1))
    depth = np.maximum.reduceat(nearest, starts)
    lengths = np.diff(np.append(starts, len(run)))
    order = np.argsort(-depth, kind="stable")
    lengths = lengths[order]
    before = np.cumsum(lengths) - lengths
    return np.repeat(starts[order] - before, lengths) + np.arange(len(nearest))


def _longer(a: np.ndarray, needed: int) -> np.ndarray:
    out = np.empty((2 * int(needed), *a.shape[1:]), a.dtype)
    out[: len(a)] = a
    return out


def _boxes(n: int) -> Boxes:
    return Boxes(
        np.empty(n, np.int32),
        np.empty((n, 2), np.int32),
        np.empty(n),
        np.empty(n, np.float32),
        np.empty((n, 4), np.int32),
    )


def _triangles(n: int) -> TriangleList:
    return TriangleList(np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.int32))


@uncounted
def _see_corner(view, x, y, z, out, seen):
    """Add one corner to the bounds in `out`; returns `seen` with the bits of the planes that it is inside of."""
    p = view.planes
    camera = view.camera
    out[0] = min(out[0], z)
    out[1] = max(out[1], z)
    w = z if camera.perspective[0] else 1.0
    if x >= p[0] * w:
        seen |= 1
    if y >= p[1] * w:
        seen |= 2
    if x <= p[2] * w:
        seen |= 4
    if y <= p[3] * w:
        seen |= 8
    if z > 0.0 or not camera.perspective[0]:
        sx, sy = x / w, y / w
        out[6] = max(out[6], sx * sx + sy * sy)
        sx = (sx - camera.plane[0, 0]) / camera.plane[1, 0]
        sy = (sy - camera.plane[0, 1]) / camera.plane[1, 1]
        out[2] = min(out[2], sx)
        out[3] = min(out[3], sy)
        out[4] = max(out[4], sx)
        out[5] = max(out[5], sy)
    return seen


@uncounted
def _reset(out):
    for k in range(6):
        out[k] = np.inf if k in (0, 2, 3) else -np.inf
    out[6] = 0.0


@uncounted
def _in_view(view, seen, out):
    return seen == 15 and out[1] >= view.camera.clip[0] and out[0] <= view.camera.clip[1] and out[1] > 0.0


@uncounted
def _see_box(view, m, row, box, node, out):
    """Bounds of a box's image in `out`; False: it is outside the view. All eight corners, so it is tight."""
    _reset(out)
    seen = np.int64(0)
    for k in range(8):
        a = box[node, 0] if k & 1 else box[node, 3]
        b = box[node, 1] if k & 2 else box[node, 4]
        c = box[node, 2] if k & 4 else box[node, 5]
        x = m[row, 0] * a + m[row, 1] * b + m[row, 2] * c + m[row, 3]
        y = m[row, 4] * a + m[row, 5] * b + m[row, 6] * c + m[row, 7]
        z = m[row, 8] * a + m[row, 9] * b + m[row, 10] * c + m[row, 11]
        seen = _see_corner(view, x, y, z, out, seen)
    return _in_view(view, seen, out)


@uncounted
def _see_triangle(view, octree, tables, m, row, group, part, triangle, out):
    """The same for a triangle; returns its area in camera space, negative: not to be seen."""
    p, t = pointer_f32(tables.positions[part]), pointer_i32(tables.triangles[part])
    ox = octree.part_offset[part, 0] - octree.group_center[group, 0]
    oy = octree.part_offset[part, 1] - octree.group_center[group, 1]
    oz = octree.part_offset[part, 2] - octree.group_center[group, 2]
    _reset(out)
    seen = np.int64(0)
    ax = ay = az = ux = uy = uz = vx = vy = vz = 0.0
    for k in range(3):
        i = 3 * np.int64(t[3 * triangle + k])
        a, b, c = p[i] + ox, p[i + 1] + oy, p[i + 2] + oz
        x = m[row, 0] * a + m[row, 1] * b + m[row, 2] * c + m[row, 3]
        y = m[row, 4] * a + m[row, 5] * b + m[row, 6] * c + m[row, 7]
        z = m[row, 8] * a + m[row, 9] * b + m[row, 10] * c + m[row, 11]
        seen = _see_corner(view, x, y, z, out, seen)
        if k == 0:
            ax, ay, az = x, y, z
        elif k == 1:
            ux, uy, uz = x - ax, y - ay, z - az
        else:
            vx, vy, vz = x - ax, y - ay, z - az
    if not _in_view(view, seen, out):
        return -1.0
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    if view.limits[4] != 0.0:
        toward = x * ax + y * ay + z * az if view.camera.perspective[0] else z
        # the product has turned over with the matrix (always by the camera's z, which points into the scene)
        det = m[row, 0] * (m[row, 5] * m[row, 10] - m[row, 6] * m[row, 9])
        det -= m[row, 1] * (m[row, 4] * m[row, 10] - m[row, 6] * m[row, 8])
        det += m[row, 2] * (m[row, 4] * m[row, 9] - m[row, 5] * m[row, 8])
        if toward * det >= 0.0:
            return -1.0
    return 0.5 * math.sqrt(x * x + y * y + z * z)


@uncounted
def _density(view, out):
    """Most pixels that a unit of area may cover, given bounds of where it lies."""
    seen = view.limits[3] * view.limits[3]
    density = pixels_per_area(view.camera)
    if view.camera.perspective[0]:
        z = max(out[0], view.camera.clip[0])
        density *= math.sqrt(1.0 + min(out[6], seen)) / (z * z)
    return density


@uncounted
def _take(view, boxes, used, row, first, end, area, out):
    k = used[2]
    used[2] += 1
    boxes.row[k] = row
    boxes.interval[k, 0] = first
    boxes.interval[k, 1] = end
    boxes.area[k] = area
    boxes.nearest[k] = np.float32(inverse_depth(view.camera, max(out[0], view.camera.clip[0])) * (1.0 + 1e-6))
    for c in range(2):
        low, high = view.region[c], view.region[2 + c]
        boxes.rectangle[k, c] = np.int32(max(low, math.floor(min(max(out[2 + c] - 1e-3, low), high))))
        boxes.rectangle[k, 2 + c] = np.int32(
            min(high, math.floor(min(max(out[4 + c] + 1e-3, low), high)) + 1)
        )


@uncounted
def _whole(view, distribution, node, leaf, row_scale, area, density, out):
    """Whether a node can be sampled at one density; leaf: it has triangles of its own only."""
    limits, region = view.limits, view.region
    near = view.camera.clip[0]
    if out[0] <= near and (view.camera.perspective[0] or out[0] < near):
        return False
    if area <= 0.0:
        return True
    wide = max(out[4] - out[2], out[5] - out[3])
    if wide <= TINY:
        return True
    if view.camera.perspective[0] and out[1] * out[1] > limits[0] * out[0] * out[0]:
        return False
    if distribution.largest[node] * row_scale * density * limits[1] > limits[2]:
        return False
    cut = out[2] < region[0] or out[3] < region[1] or out[4] > region[2] or out[5] > region[3]
    return leaf or wide <= (CUT if cut else WIDE)


@uncounted
def _walk(octree, distribution, tables, instances, view, boxes, triangles, transforms, work):
    """Go on with the stack until it is empty: -1; or the room that the next node may need, where there is none."""
    used, out, m, limits = work.used, work.corner, transforms.matrix, view.limits
    near, perspective = view.camera.clip[0], view.camera.perspective[0]
    while used[0] > 0:
        node, row = np.int64(work.stack[used[0] - 1, 0]), np.int64(work.stack[used[0] - 1, 1])
        first, own_end = np.int64(octree.items[node, 0]), np.int64(octree.items[node, 2])
        end = np.int64(octree.items[node, 3])
        need = own_end - first + 9
        if (
            used[0] + need > len(work.stack)
            or used[1] + need > len(work.scale)
            or used[2] + need > len(boxes.row)
            or used[3] + need > len(triangles.part)
        ):
            return need
        used[0] -= 1
        used[4] += 1
        if not _see_box(view, m, row, octree.box, node, out):
            continue
        group = np.int64(transforms.group[row])
        shift = distribution.shift[group]
        density = _density(view, out)
        leaf = octree.child[node, 1] == 0 and octree.item[first, 0] >= 0
        area = (distribution.sums[end + shift] - distribution.sums[first + shift]) * work.scale[row] * density
        if _whole(view, distribution, node, leaf, work.scale[row], area, density, out):
            if area > 0.0:
                if max(out[4] - out[2], out[5] - out[3]) <= TINY:
                    area = min(area, TINY_AREA)
                _take(view, boxes, used, row, first, end, area, out)
            continue
        for i in range(first, own_end):
            part, k = np.int64(octree.item[i, 0]), np.int64(octree.item[i, 1])
            if part < 0:
                new = used[1]
                child = compose(transforms, row, octree, instances, -1 - part, k, new)
                bound, even = area_scale(pointer_f64(instances.transforms[-1 - part]), 12 * k)
                work.scale[new] = work.scale[row] * bound
                work.uniform[new] = work.uniform[row] and even
                # most instances out of view are found here, before they take a row
                if _see_box(view, m, new, octree.box, np.int64(octree.group_root[child]), out):
                    work.stack[used[0], 0] = octree.group_root[child]
                    work.stack[used[0], 1] = new
                    used[0] += 1
                    used[1] += 1
                continue
            area = _see_triangle(view, octree, tables, m, row, group, part, k, out)
            if area <= 0.0:
                continue
            crossing = out[0] < near or (perspective and out[0] <= 0.0)
            area *= _density(view, out)
            if crossing or area * limits[1] > limits[2]:
                t = used[3]
                used[3] += 1
                triangles.part[t] = part
                triangles.triangle[t] = k
                triangles.transform[t] = row
            else:
                _take(view, boxes, used, row, i, i + 1, area, out)
        for c in range(octree.child[node, 1] - 1, -1, -1):
            work.stack[used[0], 0] = octree.child[node, 0] + c
            work.stack[used[0], 1] = row
            used[0] += 1
    return np.int64(-1)
