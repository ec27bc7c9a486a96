"""Light by cones: at every surface, shadows, the world and what lobes see are each found by cones, without chance.

A workspace of raytracing's integrator whose three stages are replaced: direct light is the exact light of lamps and
world times the share that shadow cones find open; scattering sends a cone for every lobe; what the cones meet goes on
as paths with the weight of their coverage.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointmr_engine.forward.baking import materials_of
from pointmr_engine.forward.lobe_light import shade_lamps, shade_world, widen_by_normals
from pointmr_engine.forward.world_light import world_lobe
from pointmr_engine.hierarchy.prefilter import prefilter
from pointmr_engine.multires.cone_hits import Merging, allocate_fragments, gather
from pointmr_engine.multires.cone_walk import visible
from pointmr_engine.multires.cones import Cones, allocate_cones
from pointmr_engine.multires.fragment_paths import BATCH, FragmentPaths, close_transparency
from pointmr_engine.multires.lamp_cones import cell_weights, lamp_cones, take_shares
from pointmr_engine.multires.lobe_view import allocate_lobe_cones, follow_cones, weigh_sub_rays
from pointmr_engine.multires.scatter import WEAK, keep_lobes, scatter_lobes
from pointmr_engine.multires.world_cones import FACES, WorldCells, open_shares, world_cones
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing import paths, walk
from pointmr_engine.raytracing.integrator import Stage
from pointmr_engine.raytracing.lamps import DISTANT, POINT, compile_lamps
from pointmr_engine.raytracing.paths import BACKDROP
from pointmr_engine.raytracing.surface import frames
from pointmr_engine.scene.group import CAMERA, GLOSSY, TRANSMISSION
from pointmr_engine.shading.bsdf.layout import HAS_DIFFUSE, HAS_TRANSMISSION

_WEIGHTS = cell_weights()
ROOM = 4 * BATCH  # paths at once: fragments of a tile, and what the cones of each see
MOST = 6  # fragments of a cone
OPACITY_LOOKS = 256  # triangles of a part at which its materials' opacity is looked up


class ConeLight:
    """What the threads of an image share: lamps, the world in cells, and the hierarchy that cones walk."""

    def __init__(self, scene, sampler, stage):
        world = sampler.world_light
        self.world = world
        self.lamps = compile_lamps([*scene.lights, *world.suns])[0]
        self.cells = WorldCells(world.diffuse)
        self.acceleration = stage.acceleration
        if sampler.prefiltered is None:
            opacity = mean_opacity(sampler)
            whole = prefilter(stage.acceleration)
            clear = whole if (opacity == 1.0).all() else prefilter(stage.acceleration, opacity)
            sampler.prefiltered = clear, whole
        # shadows pass what is transparent by its mean opacity; lobes see surfaces, whose shading lets them through
        self.prefiltered, self.prefiltered_whole = sampler.prefiltered
        self.lights = stage.lights
        self.emitters = stage.lights.emitters_alone

    def stage(self, stage: Stage) -> Stage:
        """The integrator's stage for cones: random light samples look for emissive surfaces only, at diffuse lobes."""
        lights = self.lights if self.emitters is None else self.emitters
        return replace(
            stage,
            lights=lights,
            needs=replace(stage.needs, light_samples=True),
            limits=stage.limits._replace(diffuse_by_lights=True),
        )

    def blocked(self, cones: Cones, count: int, masks: np.ndarray) -> None:
        """masks (N,) uint64: the sub-rays of cones 0..count that something stops."""
        visible(self.acceleration, self.prefiltered, cones, masks, None, 0, count)


def mean_opacity(sampler) -> np.ndarray:
    """(materials,) mean opacity of each material, over the middles of a few of its triangles where it varies."""
    opacity = np.array([float(p.opaque) for p in sampler.programs] + [1.0])[: len(sampler.geometry.materials)]
    for p in range(len(sampler.geometry.parts)):
        tables = sampler.geometry.tables
        slots = tables.slot_material[tables.first_slot[p] : tables.first_slot[p] + tables.slots[p]]
        if all(sampler.programs[m].opaque for m in slots):
            continue
        count = len(sampler.geometry.shapes[tables.shape[p]].triangles)
        if not count:
            continue
        triangle = np.unique(np.linspace(0, count - 1, OPACITY_LOOKS).astype(np.int32))
        some = np.full(len(triangle), p, np.int32), triangle, *np.full((3, len(triangle)), 1 / 3, np.float32)
        alpha = sampler.baker(*some).alpha
        material = np.empty(len(triangle), np.int32)
        materials_of(tables, *some[:2], material)
        for m in np.unique(material):
            opacity[m] = alpha[material == m].mean()
    return opacity


class ConePaths(FragmentPaths):
    """One thread's paths by cones. light: method.ConeLight, what all threads share."""

    def __init__(self, stage, light):
        super().__init__(light.stage(stage), ROOM)
        n = ROOM
        self.light = light
        self.width = np.empty(n, np.float32)
        self.both = np.empty(n, np.bool_)
        self.received = np.zeros((n, 3), np.float32)
        self.ones = np.ones(n)
        self.share = np.ones((len(light.lamps.shape), n), np.float32)
        self.rows = np.empty(n, np.int32)
        self.shifts = np.empty((n, 2))
        self.cones = allocate_cones(n)
        self.lobe_cones, self.next_cones = (allocate_lobe_cones(n, allocate_cones(n)) for _ in range(2))
        self.met = paths.allocate_paths(n, self.stage.camera.camera_from_world)
        self.met_fragments = allocate_fragments(n)
        self.escaped = np.empty(n, np.uint64)
        self.then = self.met
        self.masks = np.empty(n, np.uint64)
        self.lobe_alpha = np.zeros(n, np.float32)
        self.going = 0

    def shaded(self, now, n: int, bounce: int) -> None:
        if bounce:
            self.flat[:n] = 1.0
            self.spread[:n] = 0.0
        widen_by_normals(self.lobes, self.spread, self.alpha, np.int64(n))
        if bounce == 0:
            close_transparency(self.lobes, now.throughput, np.int64(n))

    def roulette(self, now, n: int, alive, bounce: int) -> None:
        """Nothing: what is weak is left to chance where it is scattered."""

    def _direct_light(self, now, n: int, alive, bounce: int) -> None:
        self._scatter(now, n, alive, bounce)
        lobes, count = self.lobes, np.int64(n)
        lobes.count[:n][~alive] = 0
        keep_lobes(lobes, self.alpha, False, count)
        self.received[:n] = 0.0
        reach = np.where(np.isfinite(self.hits.t[:n]), self.hits.t[:n], 0.0)
        self.width[:n] = now.state.width[:n] + now.state.spread[:n] * reach
        np.not_equal(lobes.flags[:n] & HAS_TRANSMISSION, 0, out=self.both[:n])
        lamps = self.light.lamps
        if len(lamps.shape):
            for i in np.flatnonzero(lamps.cast_shadow):
                self._shadow(int(i), n)
            shade_lamps(
                lobes, self.view.incoming, self.frames.position, self.flat, self.alpha, lamps, self.share,
                np.int64(0), count, self.received,
            )  # fmt: skip
        keep_lobes(lobes, self.alpha, True, count)
        world = self.light.world
        if self.light.cells.light.any():
            share = self._open(n)
            shade_world(
                lobes, self.view.incoming, self.flat, self.stage.shader.tables, world.diffuse, world.glossy,
                world.transmission, share, count, self.received,
            )  # fmt: skip
        paths.add_radiance(now, self.samples, self.stage.limits, self.received[:n], self.ones[:n], n)
        if self.light.emitters is not None:
            super()._direct_light(now, n, alive, bounce)

    def _shadow(self, i: int, n: int) -> None:
        """The share of lamp i that arrives at points 0..n."""
        lamps = self.light.lamps
        self.share[i, :n] = 1.0
        m = lamp_cones(
            lamps, np.int64(i), self.frames.position, self.lobes.geometric_normal, self.both, self.width,
            self.frames.offset, self.lobes.count, np.int64(n), self.cones, self.rows, self.shifts,
        )  # fmt: skip
        if not m:
            return
        self.counters["sharp_cones" if lamps.shape[i] in (POINT, DISTANT) else "area_cones"] += m
        self.light.blocked(self.cones, m, self.masks)
        take_shares(self.masks, _WEIGHTS, lamps.shape[i], self.rows, self.shifts, np.int64(m), self.share[i])

    def _open(self, n: int) -> np.ndarray:
        """(n, 2, 3) shares of the world's light in front of points 0..n and behind them."""
        cells = self.light.cells
        wanted = (self.lobes.flags[:n] & HAS_DIFFUSE) != 0
        masks = np.zeros((n, FACES), np.uint64)
        step = len(self.masks) // FACES
        source = np.empty(step * FACES, np.int32)
        for first in range(0, n, step):
            here = np.s_[first : min(first + step, n)]
            m = world_cones(
                cells.axes, self.frames.position[here], self.lobes.normal[here], wanted[here], self.both[here],
                self.width[here], self.frames.offset[here], np.int64(len(wanted[here])), self.cones, source,
            )  # fmt: skip
            if m:
                self.counters["world_cones"] += m
                self.light.blocked(self.cones, m, self.masks)
                masks[here].reshape(-1)[source[:m]] = self.masks[:m]
        share = np.empty((n, 2, 3), np.float32)
        open_shares(cells.direction, cells.light, masks, self.lobes.normal, self.both, np.int64(n), share)
        return share

    def _scatter(self, now, n: int, alive, bounce: int) -> None:
        """Paths behind the surfaces, and their cones."""
        weak = WEAK
        while True:
            self.going = scatter_lobes(
                now, self.samples, self.hits, self.frames, self.lobes, self.stage.limits, self.stage.tables,
                self.stage.shader.tables, np.int64(bounce), weak, alive, np.int64(n), np.int64(ROOM // 3), self.then,
                self.next_cones,
            )  # fmt: skip
            if self.going >= 0:
                break
            weak *= 2.0
        if self.going:
            self.counters["lobe_cones"] += self.going

    def scatter(self, now, n: int, alive, bounce: int) -> None:
        """Nothing: `_direct_light` has done it, for it drops lobes."""

    def move(self, now, then, n: int, alive) -> int:
        self.lobe_cones, self.next_cones = self.next_cones, self.lobe_cones
        return self.going

    def meet(self, tile, now, then, n: int, bounce: int) -> int:
        self.then = then
        return super().meet(tile, now, then, n, bounce)

    def _bounce(self, tile, now, then, n: int, bounce: int) -> int:
        """What the cones of n paths see is met; returns how many paths go on from there, in `then`."""
        light, lobes, met, hits = self.light, self.lobe_cones, self.met, self.hits
        weigh_sub_rays(lobes, np.int64(n))
        most = max(1, min(MOST, ROOM // n - 1))
        merging = Merging(most=most, seed=self.stage.settings.seed + bounce)
        met.rays.skip_triangle[:] = -1
        count = gather(
            light.acceleration, light.prefiltered_whole, lobes.cones, self.met_fragments, met.rays, hits, self.escaped,
            None, 0, n, merging=merging,
        )  # fmt: skip
        counts = follow_cones(
            now, lobes, self.met_fragments, self.escaped, np.int64(count), np.int64(n), np.int64(ROOM), met, hits,
            self.lobe_alpha,
        )  # fmt: skip
        total = sum(counts)
        if counts[2]:
            walk.intersect(light.acceleration, met.rays, hits, total - counts[2], total)
        self.counters["lobe_fragments"] += counts[0]
        frames(self.stage.shader.geometry, met.rays, hits, self.frames, 0, total)
        return self.meet(tile, met, now, total, bounce) if total else 0

    def _met_lights(self, now, rays, n: int, alive, bounce: int) -> None:
        """What camera rays and lobes see besides surfaces: lamps, where nothing widens the view, and the world."""
        light, stage = self.light, self.stage
        if len(light.lights.arrays.met_lamps):
            sharp = np.ones(n, np.bool_) if bounce == 0 else self.lobe_alpha[:n] <= 0.0
            met = np.zeros((n, 3), np.float32)
            light.lights.seen_lamps(
                rays.origin, rays.direction, self.hits.t[:n], rays.visibility, now.origin_normal[:n],
                now.origin_transmissive[:n], now.bsdf_pdf[:n], met,
            )  # fmt: skip
            paths.add_radiance(now, self.samples, stage.limits, met, sharp.astype(np.float64), n)
        missed = ~alive
        if not missed.any():
            return
        if stage.settings.film_transparent:
            paths.see_through(now, self.samples, missed, n)
            missed &= (now.flags[:n] & BACKDROP) == 0
        if light.lights.environment.black:
            return
        radiance = np.zeros((n, 3), np.float32)
        for bit, maps in (
            (CAMERA, None),
            (GLOSSY, light.world.glossy),
            (TRANSMISSION, light.world.transmission),
        ):
            rows = np.flatnonzero(missed & (rays.visibility == bit))
            if not len(rows):
                continue
            sharp = np.ones(len(rows), np.bool_) if maps is None else self.lobe_alpha[rows] <= 0.0
            exact, wide = rows[sharp], rows[~sharp]
            if len(exact):
                radiance[exact] = light.lights.world_radiance(rays.direction[exact], bit)
            if len(wide):
                look_at_world(maps, rays.direction, self.lobe_alpha, wide, radiance)
        paths.add_radiance(now, self.samples, stage.limits, radiance, self.ones[:n], n)


@uncounted
def look_at_world(maps, direction, alpha, rows, out):
    """Radiance of the world that lobes of roughness alpha (N,) see in direction (N, 3) to rows of out (N, 3)."""
    for i in range(len(rows)):
        k = rows[i]
        r, g, b = world_lobe(maps, np.float64(alpha[k]), direction[k, 0], direction[k, 1], direction[k, 2])
        out[k, 0], out[k, 1], out[k, 2] = r, g, b
