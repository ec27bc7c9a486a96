"""Edges of sharp lamps' shadows: where they cross a pixel, fragments ask for the lamp at several of their points.

One ray from the middle of each fragment finds the edges; only there more are worth it (adaptive supersampling, Whitted
1980).
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.fragments.looks import look_around, same_surface
from pointmr_engine.multires.paths.fragment_paths import FragmentPaths
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing import walk
from pointmr_engine.raytracing.lamps import is_beam
from pointmr_engine.raytracing.lights import LAMP
from pointmr_engine.raytracing.rays import allocate_hits, allocate_rays
from pointmr_engine.raytracing.surface import allocate_frames, frames
from pointmr_engine.scene.group import CAMERA

LOOKS = 8  # more points of a fragment
LARGE = 8  # subpixels from which a fragment is worth more than one point
NEXT_LOOK = np.array([0.7549, 0.5698, 0.6180])  # from look to look, in the unit cube of the lamp's points
DIFFERENT = 0.1  # of a lamp's light: shares of neighbours between which an edge lies


@uncounted
def find_edges(pixel, shape, open_light, light, subpixels, beam, count, low, high, edge):
    """edge (N,) bool: of fragments 0..count, those that are large and lie where the lamp is partly hidden.

    pixel (N,) int64: their pixels' numbers in a tile of `shape` (rows, columns); open_light (N,) float64: what they
    receive of the lamp without shadows, 0 where nothing; light (N,) float64: with them. beam: only parts of the lamp
    may shine on a fragment, which may have received nothing by chance: chosen by what they received, they would be too
    dark. low, high (rows, columns) float64 to work in.
    """
    rows, columns = shape
    low[:] = math.inf
    high[:] = -math.inf
    for k in range(count):
        edge[k] = False
        if open_light[k] > 0.0:
            share = light[k] / open_light[k]
            j, i = pixel[k] // columns, pixel[k] % columns
            low[j, i] = min(low[j, i], share)
            high[j, i] = max(high[j, i], share)
    for k in range(count):
        if not (beam or open_light[k] > 0.0) or subpixels[k] < LARGE:
            continue
        j, i = pixel[k] // columns, pixel[k] % columns
        least, most = math.inf, -math.inf
        for q in range(max(j - 1, 0), min(j + 2, rows)):
            for p in range(max(i - 1, 0), min(i + 2, columns)):
                least, most = min(least, low[q, p]), max(most, high[q, p])
        edge[k] = most - least > DIFFERENT


@uncounted
def sum_by_source(light, source, count, out):
    """Add the channels of light (N, 3) of shadow rays 0..count to out (M,), at their sources (N,)."""
    for i in range(count):
        out[source[i]] += light[i, 0] + light[i, 1] + light[i, 2]


class EdgePaths(FragmentPaths):
    """Paths from fragments whose direct light follows the edges of sharp shadows."""

    def __init__(self, stage, room: int):
        super().__init__(stage, room)
        self.alive = None  # (n,) of the fragments whose edges matter, while they are lit
        self.part = 1.0  # of a light sample
        self.open_light, self.measures = np.zeros(len(self.flat)), False  # of a lamp; while it is looked for
        self.low, self.high = np.empty((0, 0)), np.empty((0, 0))

    def start_tile(self, space, count: int) -> None:
        super().start_tile(space, count)
        if self.low.shape != space.used.shape:
            self.low, self.high = np.empty(space.used.shape), np.empty(space.used.shape)

    def _direct_light(self, now, n: int, alive, bounce: int) -> None:
        self.alive = alive if bounce == 0 and len(self.space.seen) else None
        super()._direct_light(now, n, alive, bounce)
        self.alive = None

    def sample_lights(self, m: int, turn=None):
        chosen = super().sample_lights(m, turn)
        if self.part != 1.0:
            chosen.radiance[:] *= self.part
        return chosen

    def connect(self, now, m: int, chosen) -> int:
        count = super().connect(now, m, chosen)
        if self.measures:
            sum_by_source(self.shadows.light, self.shadows.source, np.int64(count), self.open_light)
        return count

    def _look_at_light(self, now, m: int, turn) -> None:
        if self.alive is None or turn is None or turn[0] != LAMP:
            super()._look_at_light(now, m, turn)
            return
        n, radiance, lamps = self.count, self.samples.radiance, self.stage.lights.arrays.lamps
        before = radiance[:n].copy()
        self.open_light[:n], self.measures = 0.0, True
        super()._look_at_light(now, m, turn)
        self.measures = False
        f, space = self.space.fragments, self.space
        got = (radiance[:n] - before).sum(1)
        edge = np.empty(n, np.bool_)
        find_edges(
            self.pixel, space.used.shape, self.open_light, got, f.count[self.first : self.first + n],
            bool(lamps.varying[turn[1]]) or is_beam(lamps, turn[1]), np.int64(n), self.low, self.high, edge,
        )  # fmt: skip
        rows = np.flatnonzero(edge)
        if not len(rows):
            return
        u = self.lit_u[:m].copy()
        self.part = 1.0 / (1 + LOOKS)  # the middle is one of the points
        radiance[rows] = before[rows] + self.part * (radiance[rows] - before[rows])
        kept = [a[rows] for a in _where(self.hits, self.frames)]
        for look in range(LOOKS):
            self._stand(rows, kept)
            self._stand_elsewhere(now, rows, look)
            some = self.choose_points(now, n, edge, 0)
            self.shift_points(some, (look + 1) * NEXT_LOOK)
            super()._look_at_light(now, some, turn)
        self._stand(rows, kept)
        self.part = 1.0
        self.choose_points(now, n, self.alive, 0)  # for the turns to come
        self.lit_u[:m] = u

    def _stand(self, rows: np.ndarray, places) -> None:
        """Put the fragments `rows` where `places` are, as `_where` has them."""
        for target, values in zip(_where(self.hits, self.frames), places, strict=True):
            target[rows] = values

    def _stand_elsewhere(self, now, rows: np.ndarray, look: int) -> None:
        """Put the fragments `rows` on other points of their surfaces, where there are any."""
        space, stage, image = self.space, self.stage, self.space.image
        hits, frame = self.hits, self.frames
        rays, met, found = allocate_rays(len(rows)), allocate_hits(len(rows)), allocate_frames(len(rows))
        look_around(
            image.view, np.int64(space.left), np.int64(space.low), image.camera.world_from_camera, space.fragments,
            np.int64(self.first), rows, np.float64(space.cell), stage.tables, self.samples, now.slot, np.int64(look),
            rays,
        )  # fmt: skip
        rays.visibility[:] = CAMERA
        walk.intersect(stage.acceleration, rays, met)
        self.counters["edge_rays"] += len(rows)
        frames(stage.shader.geometry, rays, met, found)
        alike = np.empty(len(rows), np.bool_)
        width = now.state.spread[: self.count] * hits.t[: self.count] + now.state.width[: self.count]
        same_surface(frame, rows, found, met, width, alike)
        self._stand(rows[alike], [a[alike] for a in _where(met, found)])


def _where(hits, frame) -> tuple:
    """The arrays that say where shadow rays begin."""
    return *hits, frame.position, frame.offset
