"""Direct light of wide lamps: their open light, times the share that a cone from every point finds free.

A cone knows of surfaces only that they hide. What it meets that lets light through is asked for by rays instead, from
the same point, which take its colour and its holes as they are.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.shading.lamp_points import sees_a_part
from pointmr_engine.forward.shading.lobe_light import NO_GAPS
from pointmr_engine.multires.cones.cones import allocate_cones
from pointmr_engine.multires.cones.lamp_cones import (
    ALL,
    NOTHING,
    TERMS,
    lamp_cones,
    lit_from_behind,
    raise_points,
    take_shares,
)
from pointmr_engine.multires.paths.shadow_edges import LARGE
from pointmr_engine.multires.paths.sharing_paths import SharingPaths
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import R2
from pointmr_engine.raytracing import paths
from pointmr_engine.raytracing.integrator import NEXT
from pointmr_engine.raytracing.lamps import SPOT, TAN_SPREAD, sample_lamp
from pointmr_engine.raytracing.path_arrays import allocate_samples
from pointmr_engine.scene.group import SHADOW
from pointmr_engine.shading.bsdf.vector import dot, row3

# rays of a fragment to a lamp behind something that light passes; of a small one, and behind it, one
LOOKS = 4
PLACES = 8  # of a lamp that lights a point in part, of which a ray chooses one
_SHORT = 1.0 - 1e-6  # of the way to a lamp


@device
def _places_of(lamps, i, p, normal, whole):
    """Among how many places of lamp i a ray from p chooses: one, if all of them light p."""
    row = lamps.values[i]
    uneven = row[SPOT] != 0.0 or row[TAN_SPREAD] < math.inf
    if uneven or (not whole and sees_a_part(lamps, i, p[0], p[1], p[2], normal)):
        return np.int64(PLACES)
    return np.int64(1)


@device
def _towards_lamp(lamps, i, p, normal, behind, u):
    """(dx, dy, dz, distance, irradiance) of a place of lamp i, chosen from a few by the light that they send to p.

    What a place stands for is their mean (resampled importance sampling; Talbot, Cline and Egbert 2005): of a lamp that
    the surface's plane cuts, or its beam's edge, a place by chance may send nothing. u (3,): in 0..1.
    """
    places = _places_of(lamps, i, p, normal, behind == ALL)
    chosen, total, chance = (0.0, 0.0, 1.0, 0.0), 0.0, u[0]
    a, b = np.float64(u[1]), np.float64(u[2])
    for _ in range(places):
        dx, dy, dz, distance, pdf, scale = sample_lamp(
            lamps, i, p[0], p[1], p[2], normal[0], normal[1], normal[2], behind == ALL, a, b
        )
        a, b = (a + R2[0]) % 1.0, (b + R2[1]) % 1.0
        cosine = dot(normal, (dx, dy, dz))
        if not pdf > 0.0 or (cosine <= 0.0 and behind == NOTHING):
            continue
        light = abs(cosine) * scale / pdf
        if not (light > 0.0 and math.isfinite(light)):
            continue
        total += light
        share = light / total
        if chance < share:
            chosen, chance = (dx, dy, dz, distance), chance / share
        else:
            chance = (chance - share) / (1.0 - share)
    return chosen[0], chosen[1], chosen[2], chosen[3], total / places


@uncounted
def lamp_rays(lamps, i, position, below, lobes, behind, offset, hits, depth, rows, u, count, out, total):
    """Shadow rays from points rows[0..count] to places of lamp i; returns how many. u (N, 3): in 0..1, which places.

    Each brings the irradiance that it stands for, by the points' normals, which is added to total (N,) float64, by
    point. position (N, 3) float64, and below, where rays start that go behind the surface; behind (N,) uint8:
    lamp_cones.lit_from_behind; offset (N,) float64; depth (N,): surfaces that let the path through before. out:
    direct_light.ShadowRays, of which a ray's slot is its point.
    """
    n = np.int64(0)
    for j in range(count):
        k = np.int64(rows[j])
        dx, dy, dz, distance, light = _towards_lamp(
            lamps, i, row3(position, k), row3(lobes.normal, k), behind[k], u[j]
        )
        if not light > 0.0:
            continue
        total[k] += light
        out.slot[n] = out.source[n] = k
        out.whole[n] = light
        out.passed[n] = depth[k]
        out.raised[n] = False
        start = position if dot(row3(lobes.normal, k), (dx, dy, dz)) > 0.0 else below
        for a in range(3):
            out.light[n, a] = light
            out.matt[n, a] = out.glossy[n, a] = 0.0
            out.rays.origin[n, a] = start[k, a]
        out.rays.direction[n, 0], out.rays.direction[n, 1], out.rays.direction[n, 2] = dx, dy, dz
        out.rays.t_min[n] = offset[k]
        out.rays.t_max[n] = distance * _SHORT
        out.rays.visibility[n] = SHADOW
        above = dot(row3(lobes.geometric_normal, k), (dx, dy, dz)) > 0.0
        out.rays.skip_triangle[n] = hits.triangle[k] if above else -1
        out.rays.skip_path[n] = hits.path[k]
        n += 1
    return n


class WideLamps(SharingPaths):
    """Paths whose surfaces see wide lamps by cones. light: ConeLight, what all threads share."""

    def __init__(self, stage, light, room: int):
        super().__init__(stage, light, room)
        n = room
        self.width = np.empty(n, np.float32)
        self.behind_lit = np.empty(n, np.uint8)
        self.raised, self.lowered = np.empty((2, n, 3))
        self.received, self.open = np.zeros((2, n, 3), np.float32)
        self.ones = np.ones(n)
        self.open_gaps = NO_GAPS  # FragmentPaths.gaps, of what is seen directly
        # of each lamp's light, what arrives on the viewer's side of a surface, and behind it
        self.share, self.beneath = np.ones((2, len(light.lamps.shape), n), np.float32)
        self.rows = np.empty(2 * n, np.int32)
        self.terms = np.empty((2 * n, TERMS))
        self.cones = allocate_cones(2 * n)
        self.masks = np.empty(2 * n, np.uint64)
        self.passes = self.stage.needs.transparent_shadows and len(light.lamps.shape) > 0
        if self.passes:
            self.through, self.total = allocate_samples(n), np.zeros(n)

    def light_wide_lamps(self, now, n: int, bounce: int) -> None:
        """Add the light of lamps that take cones."""
        lobes, lamps, count = self.lobes, self.light.lamps, np.int64(n)
        self.open_gaps = self.gaps if bounce == 0 else NO_GAPS
        self.received[:n] = 0.0
        reach = np.where(np.isfinite(self.hits.t[:n]), self.hits.t[:n], 0.0)
        self.width[:n] = now.state.width[:n] + now.state.spread[:n] * reach
        lit_from_behind(lobes, self.behind_lit, count)
        for i in range(len(lamps.shape)):
            rows = self._shadow(i, n)
            if len(rows):
                self._add_through(now, i, rows, n, bounce)
        self._shade(self.share, self.beneath, n, self.received)
        paths.add_radiance(now, self.samples, self.stage.limits, self.received[:n], self.ones[:n], n)

    def _shade(self, share, beneath, n: int, out) -> None:
        """Add what points 0..n send of the lamps to the viewer, of whose light `share` (lamps, N) arrives, to out;
        `beneath` (lamps, N) of what of them is behind the surface."""
        self.light.split.shade(
            self.lobes, self.view.incoming, self.frames.position, self.flat, self.alpha, self.open_gaps, share, beneath,
            0, n, out,
        )  # fmt: skip

    def _starts(self, i: int, n: int) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) where what points 0..n send to lamp i starts, and where what they send behind their surface does."""
        if not self.raises:
            return self.frames.position, self.frames.position
        self._raise(i, n, 1.0, self.raised)
        if not (self.behind_lit[:n] == ALL).any():
            return self.raised, self.raised
        self._raise(i, n, -1.0, self.lowered)
        return self.raised, self.lowered

    def _raise(self, i: int, n: int, side: float, out: np.ndarray) -> None:
        """lamp_cones.raise_points of points 0..n, to out (N, 3)."""
        raise_points(
            self.light.lamps, np.int64(i), self.stage.shader.geometry.tables, self.hits, self.frames,
            self.lobes.normal, self.lobes.count, np.int64(n), side, *self.triangle, out,
        )  # fmt: skip

    def _shadow(self, i: int, n: int) -> np.ndarray:
        """Fill the share of lamp i that arrives at points 0..n; returns those that see it through something: 0."""
        lamps, masks, rows = self.light.lamps, self.masks, self.rows
        share, beneath = self.share[i], self.beneath[i]
        share[:n] = beneath[:n] = 1.0
        if not lamps.cast_shadow[i]:
            return rows[:0]
        m = lamp_cones(
            lamps, np.int64(i), *self._starts(i, n), self.lobes.normal, self.behind_lit, self.width,
            self.frames.offset, self.lobes.count, np.int64(n), self.cones, rows, self.terms,
        )  # fmt: skip
        self.counters["lamp_cones"] += m
        through = rows[:0]
        if not m:
            return through
        self.light.blocked(self.cones, m, masks)
        if self.passes:
            met = np.flatnonzero(masks[:m])
            m, everything = len(met), masks[met]
            for a in (*self.cones, self.terms, rows):
                a[:m] = a[met]
            self.light.blocked(self.cones, m, masks, solid=True)
            through = np.unique(rows[:m][masks[:m] != everything])
        take_shares(
            masks, lamps, np.int64(i), self.cones, self.terms, self.behind_lit, rows, np.int64(m), share, beneath,
        )  # fmt: skip
        share[through] = beneath[through] = 0.0
        return through

    def _add_through(self, now, i: int, rows: np.ndarray, n: int, bounce: int) -> None:
        """Add what points `rows` send of lamp i, seen through surfaces by rays, to what points 0..n have received."""
        split, own, samples = self.light.split, self.through, self.samples
        slots, starts = now.slot[rows], self._starts(i, n)
        own.seed[rows], own.number[rows] = samples.seed[slots], samples.number[slots]
        own.radiance[rows], self.total[rows] = 0.0, 0.0
        chosen = np.zeros(n, np.bool_)
        chosen[rows] = True
        for look in range(LOOKS if bounce == 0 else 1):
            if look == 1:
                chosen[self.space.fragments.count[self.first : self.first + n] < LARGE] = False
            m = self.choose_points(now, n, chosen, bounce)
            self.shift_points(m, (i + 1 + look * len(self.share)) * NEXT)
            rays = lamp_rays(
                split.alone[i], np.int64(0), *starts, self.lobes, self.behind_lit, self.frames.offset, self.hits,
                now.state.transparent_depth, self.lit_rows, self.lit_u, np.int64(m), self.shadows, self.total,
            )  # fmt: skip
            self.samples = own  # their slots are points
            self.follow_shadow_rays(now, rays)
            self.samples = samples
        share = np.zeros_like(self.share)
        share[i, rows] = 1.0
        self.open[rows] = 0.0
        self._shade(share, share, n, self.open)
        arrived = own.radiance[rows] / np.maximum(self.total[rows], 1e-300)[:, None]
        self.received[rows] += self.open[rows] * arrived.astype(np.float32)
