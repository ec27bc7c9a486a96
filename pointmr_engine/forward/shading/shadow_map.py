"""Shadows of lamps: the same sampler, seen from the lamp, once for every tile of the image.

The fragments of a tile fill a small box as the lamp sees them; a depth buffer over it resolves what the tile's own
pixels do, wherever they lie, and holds the samples that such pixels would show. Fragments of very different size get
maps of their own. Comparisons are averaged over a pixel's footprint (percentage-closer filtering; Reeves, Salesin,
Cook 1987), or over the penumbra that the mean depth of what blocks the lamp suggests (Fernando 2005).
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.drawing.subpixels import View, allocate_target, clear
from pointmr_engine.forward.selection.walk import WAITING, Hierarchy, Scratch, walk
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.raytracing.lamps import (
    AX,
    AZ,
    CONE,
    DISTANT,
    ELLIPSE,
    HALF_U,
    HALF_V,
    PX,
    PZ,
    RADIUS,
    RECTANGLE,
    SPOT,
    SPOT_CONE,
    SUN,
    Lamps,
)

SIDE = 512  # texels of a map at most
PER_PIXEL = 2.0  # texels over a pixel's footprint
CLASS = 3.0  # fragments whose footprints differ by a larger factor get separate maps
WIDEST = 14.0  # texels: the largest penumbra
LIKELY = 0.5  # of the widest penumbra that a lamp could give: what a map's texels are made for ...
COARSEST = 1.5  # ... if they need not be larger than so many footprints
EVEN = 0.9998  # squared length of a mean normal from which a piece counts as a plane, as triangles are
OFFSET, OFFSET_OF_TRIANGLES = 1.0, 0.25  # footprints: how far receivers are raised above their surface


class ShadowMaps:
    """One thread's maps. share (lamps, F) float32: how much of each lamp's light arrives at the fragments."""

    def __init__(self, image):
        self.image = image
        self.target = allocate_target(SIDE, SIDE)
        self.scratch = Scratch(self.target)
        self.share = np.ones((len(image.lamps.shape), 1), np.float32)
        self.place, self.plane = np.empty((1, 3)), np.empty((1, 3))
        self.flat = np.empty(1, np.float32)

    def trace(self, hierarchy: Hierarchy, fragments, count: int, wanted: np.ndarray) -> np.ndarray | None:
        """Fill share[:, :count]; returns the nodes whose sample sets are missing, None if there are none.

        wanted (nodes,) uint8, all zero: to work in, left zero.
        """
        lamps = self.image.lamps
        if self.share.shape[1] < count:
            self.share = np.ones((len(lamps.shape), 2 * count), np.float32)
            self.place, self.plane = np.empty((2 * count, 3)), np.empty((2 * count, 3))
            self.flat = np.empty(2 * count, np.float32)
        before = self.scratch.counters[WAITING]
        if count:
            camera = self.image.camera
            position = fragments.position[:count]
            eye = position.mean(0)
            center = camera.world_from_camera[:, :3] @ eye + camera.world_from_camera[:, 3]
            width = np.full(count, self.image.pixel)
            if self.image.view.perspective:
                width *= np.maximum(position[:, 2], 1e-30)
            for lamp in range(len(lamps.shape)):
                self.share[lamp, :count] = 1.0
                if lamps.cast_shadow[lamp]:
                    self._lamp(hierarchy, lamps, lamp, fragments, count, center, width, wanted)
        if self.scratch.counters[WAITING] == before:
            return None
        missing = np.flatnonzero(wanted)
        wanted[missing] = 0
        return missing

    def _lamp(self, hierarchy, lamps: Lamps, lamp: int, fragments, count, center, width, wanted) -> None:
        """All maps of one lamp."""
        row, shape = lamps.values[lamp], lamps.shape[lamp]
        camera = self.image.camera
        share = self.share[lamp]
        distant = shape == SUN or shape == DISTANT
        if distant:
            z = row[AX : AZ + 1]
            # x along the line of sight: that is how floors stretch
            frames = [(_frame(z, camera.world_from_camera[:, 2]), center)]
        else:
            frames = [(axes, row[PX : PZ + 1]) for axes in _FACES]
        left = np.ones(count, np.bool_)
        for axes, origin in frames:
            from_world = np.concatenate([axes, -(axes @ origin)[:, None]], 1)
            from_camera = from_world[:, :3] @ camera.world_from_camera
            from_camera[:, 3] += from_world[:, 3]
            receivers(
                np.ascontiguousarray(from_camera), not distant, fragments.position, fragments.geometric,
                fragments.normal, width, np.int64(count), self.place, self.plane, self.flat,
            )  # fmt: skip
            place = self.place[:count]
            if distant:
                rows, size = np.arange(count), width
                light = math.tan(math.acos(1.0 - row[CONE]))
            else:
                reach = np.abs(place[:, :2]).max(1)
                inside = left & (place[:, 2] > 0.0) & (reach <= 1.0001 * place[:, 2])
                left &= ~inside
                rows = np.flatnonzero(inside)
                rows = rows[_lit(row, shape, axes, place[rows])]
                if not len(rows):
                    continue
                size = width[rows] / place[rows, 2]
                light = row[RADIUS]
                if shape in (RECTANGLE, ELLIPSE):
                    light = math.sqrt(row[HALF_U] * row[HALF_V])
            kind = np.floor(np.log(size / size.min()) / math.log(CLASS)).astype(np.int64)
            for c in np.unique(kind):
                here = kind == c
                self._map(
                    hierarchy,
                    from_world,
                    not distant,
                    rows[here],
                    float(size[here].min()),
                    light,
                    row[RADIUS],
                    share,
                    wanted,
                )

    def _map(self, hierarchy, from_world, perspective, rows, size, light, inside, share, wanted) -> None:
        """One map over the receivers `rows`, whose footprints are at least `size` (metres, or over the depth).

        inside: nothing nearer to the lamp's middle throws a shadow; it is in the lamp.
        """
        place = self.place[rows]
        low, high = place.min(0), place.max(0)
        if perspective:
            flat = place[:, :2] / place[:, 2:]
            low[:2], high[:2] = flat.min(0), flat.max(0)
        if perspective:
            penumbra = LIKELY * light / low[2]
        else:
            penumbra = LIKELY * light * max(low[2] - self._nearest(from_world), 0.0)
        texel = min(max(size / PER_PIXEL, penumbra / WIDEST), COARSEST * size)
        margin = 3.0 + (WIDEST if light > 0.0 else 0.0)
        extent = np.maximum(high[:2] - low[:2], texel)
        texels = np.maximum(extent / (SIDE - 2.0 * margin - 2.0), texel)
        sides = np.minimum(np.ceil(extent / texels + 2.0 * margin), SIDE).astype(np.int64)
        scale = 1.0 / texels
        shift = margin - low[:2] * scale
        if perspective:
            near, far = max(1e-3 * low[2], min(inside, 0.5 * low[2])), 1.001 * high[2]
            view = View(True, *_floats(*scale, *shift, near, far), 0.0, 0.0)
        else:
            first = self._nearest(from_world)
            near, far = min(first, low[2]), high[2] + 8.0 * float(texels.max())
            near -= 1e-3 * (far - near)
            span = far - near
            view = View(False, *_floats(*scale, *shift, near, far, (near + 2.0 * span) / span, 1.0 / span))
        clear(self.target, int(sides[0]))
        finest = float(texels.min())
        walk(
            view, hierarchy, from_world, max(size, finest) / finest, (0, 0, int(sides[0]), int(sides[1])), self.scratch,
            wanted, True,
        )  # fmt: skip
        compare(
            view,
            self.target.depth,
            sides[0],
            sides[1],
            rows,
            self.place,
            self.plane,
            self.flat,
            float(light),
            share,
        )

    def _nearest(self, from_world: np.ndarray) -> float:
        """Least depth of the scene's box along a distant light."""
        octree = self.image.sampler.octree
        root = len(octree.lower) - 1
        if not np.isfinite(octree.lower[root]).all():
            return 0.0
        middle, half = (
            0.5 * (octree.lower[root] + octree.upper[root]),
            0.5 * (octree.upper[root] - octree.lower[root]),
        )
        return float(from_world[2, :3] @ middle + from_world[2, 3] - np.abs(from_world[2, :3]) @ half)


def _floats(*values) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _frame(z: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """(3, 3): rows x, y, z of a frame along the unit vector z, with x as near to `towards` as can be."""
    x = towards - (towards @ z) * z
    if np.linalg.norm(x) < 1e-3:
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


_FACES = [_frame(sign * np.eye(3)[k], np.eye(3)[(k + 1) % 3]) for k in range(3) for sign in (1.0, -1.0)]


def _lit(row: np.ndarray, shape: int, axes: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(n,) bool: the lamp shines that way; place (n, 3) in its frame `axes`."""
    along = place @ (axes @ row[AX : AZ + 1])
    if shape in (RECTANGLE, ELLIPSE):
        return along > 0.0
    if row[SPOT] != 0.0:
        return along >= (1.0 - row[SPOT_CONE] - 1e-3) * np.linalg.norm(place, axis=1)
    return np.ones(len(place), np.bool_)


@uncounted
def receivers(from_camera, perspective, position, geometric, normal, width, count, place, plane, flat):
    """Where fragments 0..count lie as a light sees them: raised above their surfaces, on the side of the light.

    from_camera (3, 4): light_from_camera; perspective: the light is at the origin, else infinitely far towards -z.
    position (F, 3) float64, geometric and normal (F, 3) float32 in camera space, width (F,) of the pixel's footprint.
    place (F, 3), plane (F, 3) float64: filled with positions and unit normals that face the light; flat (F,) float32:
    1 where the piece is flat.
    """
    m = from_camera
    for k in range(count):
        x, y, z = position[k, 0], position[k, 1], position[k, 2]
        nx, ny, nz = np.float64(geometric[k, 0]), np.float64(geometric[k, 1]), np.float64(geometric[k, 2])
        px = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        py = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        pz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        qx = m[0, 0] * nx + m[0, 1] * ny + m[0, 2] * nz
        qy = m[1, 0] * nx + m[1, 1] * ny + m[1, 2] * nz
        qz = m[2, 0] * nx + m[2, 1] * ny + m[2, 2] * nz
        lx, ly, lz = 0.0, 0.0, -1.0
        if perspective:
            inverse = 1.0 / max(math.sqrt(px * px + py * py + pz * pz), 1e-30)
            lx, ly, lz = -px * inverse, -py * inverse, -pz * inverse
        if qx * lx + qy * ly + qz * lz < 0.0:
            qx, qy, qz = -qx, -qy, -qz
        a, b, c = np.float64(normal[k, 0]), np.float64(normal[k, 1]), np.float64(normal[k, 2])
        square = a * a + b * b + c * c
        f = 1.0
        if square > 0.0:
            f = min(max((math.sqrt(square) - 0.5) / 0.45, 0.0), 1.0)
        h = (OFFSET if 0.0 < square < EVEN else OFFSET_OF_TRIANGLES) * width[k]
        place[k, 0] = px + h * (f * qx + (1.0 - f) * lx)
        place[k, 1] = py + h * (f * qy + (1.0 - f) * ly)
        place[k, 2] = pz + h * (f * qz + (1.0 - f) * lz)
        plane[k, 0], plane[k, 1], plane[k, 2] = qx, qy, qz
        flat[k] = f


@device
def _open(depth, width, height, x, y, nearness, slope_x, slope_y):
    """Share of the four texels about (x, y) that nothing nearer than the receiver's plane covers, between them."""
    fx, fy = x - 0.5, y - 0.5
    i, j = math.floor(fx), math.floor(fy)
    s, t = fx - i, fy - j
    total = 0.0
    for b in range(2):
        row = np.int64(j) + b
        wy = t if b == 1 else 1.0 - t
        if row < 0 or row >= height:
            total += wy
            continue
        for a in range(2):
            column = np.int64(i) + a
            wx = s if a == 1 else 1.0 - s
            if column < 0 or column >= width:
                total += wx * wy
                continue
            w = nearness + slope_x * (column + 0.5 - x) + slope_y * (row + 0.5 - y)
            if depth[row, column] <= w:
                total += wx * wy
    return total


@uncounted
def compare(view, depth, width, height, rows, place, plane, flat, light, share):
    """Share of a lamp's light that arrives at the receivers `rows`, into share (F,) float32.

    depth: of the map of `view`, width x height texels; light: tangent of a distant light's half angle, or a lamp's
    radius.
    """
    for r in range(len(rows)):
        k = rows[r]
        x, y, z = place[k, 0], place[k, 1], place[k, 2]
        nx, ny, nz = plane[k, 0], plane[k, 1], plane[k, 2]
        slope_x = slope_y = 0.0
        if view.perspective:
            w = 1.0 / z
            sx, sy = x * w * view.scale_x + view.shift_x, y * w * view.scale_y + view.shift_y
            texel = max(1.0 / view.scale_x, 1.0 / view.scale_y)  # over the depth
            facing = nx * x + ny * y + nz * z
            steepest = 8.0 * texel * w
            if facing != 0.0:
                slope_x, slope_y = nx / (facing * view.scale_x), ny / (facing * view.scale_y)
        else:
            w = view.depth_shift - z * view.depth_scale
            sx, sy = x * view.scale_x + view.shift_x, y * view.scale_y + view.shift_y
            texel = max(1.0 / view.scale_x, 1.0 / view.scale_y)
            steepest = 8.0 * texel * view.depth_scale
            if nz != 0.0:
                slope_x = view.depth_scale * nx / (nz * view.scale_x)
                slope_y = view.depth_scale * ny / (nz * view.scale_y)
        fade = np.float64(flat[k])
        slope_x = min(max(slope_x, -steepest), steepest) * fade
        slope_y = min(max(slope_y, -steepest), steepest) * fade
        radius = 1.0
        if light > 0.0:
            # what blocks the lamp, and how wide its penumbra is here
            reach = WIDEST
            if view.perspective:
                reach = min(reach, light * w / texel * 4.0)
            reach = max(reach, 1.0)
            blocked, found = 0.0, 0
            for b in range(-4, 5):
                for a in range(-4, 5):
                    dx, dy = a * 0.25 * reach, b * 0.25 * reach
                    i, j = np.int64(math.floor(sx + dx)), np.int64(math.floor(sy + dy))
                    if i < 0 or j < 0 or i >= width or j >= height:
                        continue
                    here = np.float64(depth[j, i])
                    if here > w + slope_x * (i + 0.5 - sx) + slope_y * (j + 0.5 - sy):
                        blocked += here
                        found += 1
            if found == 0:
                share[k] = 1.0
                continue
            blocked /= found
            if view.perspective:
                radius = light * (blocked - w) / texel
            else:
                radius = light * (blocked - w) / view.depth_scale / texel
            radius = min(max(radius, 1.0), WIDEST)
        steps = min(np.int64(math.ceil(radius)), np.int64(6))
        total, taps = 0.0, 0
        for b in range(-steps, steps + 1):
            for a in range(-steps, steps + 1):
                if a * a + b * b > (steps + 0.4) * (steps + 0.4):
                    continue
                step = radius / steps
                total += _open(
                    depth,
                    width,
                    height,
                    sx + a * step,
                    sy + b * step,
                    w + slope_x * a * step + slope_y * b * step,
                    slope_x,
                    slope_y,
                )
                taps += 1
        share[k] = total / taps
