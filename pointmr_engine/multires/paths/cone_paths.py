"""Light by cones where they are the cheaper way, and by stratified rays elsewhere: `cone_light` decides.

A workspace of raytracing's integrator whose stages are replaced: the direct light of wide lamps is their open light
times the share that shadow cones find free; strong lobes send cones, and what these meet goes on as paths with the
weight of their coverage.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.shading.lobe_light import widen_more
from pointmr_engine.forward.shading.world_light import world_lobe
from pointmr_engine.multires.cones.cone_hits import Merging, allocate_fragments, gather
from pointmr_engine.multires.cones.cones import allocate_cones
from pointmr_engine.multires.lobes.blurred_lamps import blurred_lamps
from pointmr_engine.multires.lobes.diffuse_rays import DIFFUSE_RAYS
from pointmr_engine.multires.lobes.lobe_cones import allocate_lobe_cones
from pointmr_engine.multires.lobes.lobe_lamps import first_fragments, lamps_in_cones
from pointmr_engine.multires.lobes.lobe_paths import BY_SAMPLES
from pointmr_engine.multires.lobes.lobe_rays import ROUGH
from pointmr_engine.multires.lobes.lobe_shares import (
    bend_mirrors,
    keep_lobes,
    restore_lobes,
    sample_widened,
    share_with_lobes,
)
from pointmr_engine.multires.lobes.lobe_view import (
    choose_places,
    follow_cones,
    thin_out,
    weigh_sub_rays,
)
from pointmr_engine.multires.lobes.mirror_chains import follow_footprints
from pointmr_engine.multires.lobes.scatter import STRONG, scatter_lobes
from pointmr_engine.multires.paths.fragment_paths import BATCH
from pointmr_engine.multires.paths.shadow_edges import LARGE
from pointmr_engine.multires.paths.wide_lamps import WideLamps
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing import paths, walk
from pointmr_engine.raytracing.light_sampling import NONE
from pointmr_engine.raytracing.lights import LAMP, TRIANGLE, WORLD
from pointmr_engine.raytracing.path_arrays import NO_LAMPS, SEES_LAMPS, allocate_paths
from pointmr_engine.raytracing.surface import frames
from pointmr_engine.scene.group import DIFFUSE, GLOSSY, TRANSMISSION
from pointmr_engine.shading.bsdf.layout import HAS_TRANSMISSION
from pointmr_engine.shading.footprint_mean import EVERY, POINT, SOME

ROOM = 6 * BATCH  # paths at once: fragments of a tile, and what the cones of each see
# of a lobe's roughness, what a ray within it stands for, at one cone a pixel; with more of them it becomes less (as
# regularized paths do: Kaplanyan and Dachsbacher 2013)
AROUND = 0.5
OF_SKY = 0.5  # of that, where a ray sees the world: its maps have a lobe's tails, which the ray was drawn from, too
MOST = 3  # fragments of a cone
# times the variance by which lobes are widened that is added for lamps that take rays, behind first surfaces, where a
# path stands for more than the part of a lobe that it keeps (AROUND)
BEHIND = 8.0


class ConePaths(WideLamps):
    """One thread's paths by cones. light: ConeLight, what all threads share."""

    def __init__(self, stage, light):
        super().__init__(light.stage(stage, light.rays), light, ROOM)
        n = ROOM
        if light.shares_bounces:  # twice as many rays of each
            self.batch = BATCH // 2
        self.strong_stage, self.weak_stage = self.stage, light.stage(stage, light.weak)
        self.cone_of = np.empty((n, self.alpha.shape[1]), np.int32)
        self.shared = np.empty((n, self.alpha.shape[1], 3), np.float32)
        self.passed = np.empty((2, self.alpha.shape[1], 3))
        self.none = np.zeros(n, np.bool_)
        self.bounced = np.zeros(n)  # diffuse rays of first surfaces
        self.turned = np.zeros(n, np.float32)  # of mirrors behind mirrors: mirror_chains.follow_footprints
        self.chaos = np.zeros(n, np.float32)  # of glass behind the first surface: the same
        self.lobe_cones = allocate_lobe_cones(n, allocate_cones(n))
        # sub-rays are weighed when their cones are followed: one room for their weights will do
        self.next_cones = allocate_lobe_cones(n, allocate_cones(n))._replace(weights=self.lobe_cones.weights)
        self.met = allocate_paths(n, self.stage.camera.camera_from_world)
        self.met_fragments = allocate_fragments(n)
        self.escaped = np.empty(n, np.uint64)
        self.then = self.met
        self.lobe_alpha, self.behind = np.zeros(n, np.float32), np.ones((n, 3), np.float32)
        self.blur = np.zeros(n, np.float32)  # LobeCones.blur, of paths behind first surfaces
        self.limit = ROUGH * self.stage.settings.raytrace.cones**-0.5
        # behind first surfaces, lobes and samples share the lamps but where these have cones
        self.glinting, self.glints = np.inf if light.many else STRONG, False
        self.narrower = self.stage.settings.raytrace.cones**-0.25
        self.around = AROUND * self.narrower
        self.by_ray = np.zeros(n, np.bool_)  # what is met by rays within lobes, and not by their cones
        self.chances = np.zeros(n)  # by which cones choose among their sub-rays
        self.going = 0

    def waiting_cones(self):
        return self.lobe_cones

    def detail(self, now, n: int, bounce: int) -> np.ndarray:
        """Less of what is weak behind a first surface, or small: its noise weighs less than means cost."""
        if bounce:
            return np.where(self._weak(now, n), np.uint8(POINT), np.uint8(EVERY))
        return np.where(self._small(n), np.uint8(SOME), np.uint8(EVERY))

    def shaded(self, now, n: int, bounce: int) -> None:
        if bounce:
            self.flat[:n] = 1.0
            # what arrives is a part of a lobe: surfaces behind it reflect that part, and not a ray
            self.spread[:n] = 0.5 * self.lobe_alpha[:n] ** 2
            if self.light.extended:
                follow_footprints(
                    self.stage.shader.geometry.tables, now, self.hits, self.frames.smooth_normal, self.lobes,
                    self.hits.triangle[:n] >= 0, np.int64(n), self.narrower, self.turned, self.chaos,
                    self.spread, self.shape, np.empty((3, 3)),
                )  # fmt: skip
            self._widen_by_normals(n, False)
        else:
            self.turned[:n] = self.chaos[:n] = 0.0
        super().shaded(now, n, bounce)

    def roulette(self, now, n: int, alive, bounce: int) -> None:
        """What is weak is left to chance where it is scattered; here, lights that rays met have been counted."""
        now.throughput[:n] *= self.behind[:n]

    def _direct_light(self, now, n: int, alive, bounce: int) -> None:
        self.small = self._small(n) if bounce == 0 else None
        bends = bounce == 0 and self.light.bends
        if bounce == 0 and self.light.shares:
            self.shared_light.see(self._cone_widths(now, n))
        if bounce == 0 and self.light.shares_bounces:
            self._count_bounced(n)
        lobes, light = self.lobes, self.light
        if light.extended and (bounce or not light.many):  # of many, the rays of first mirrors bring enough
            sample_widened(lobes, np.int64(n))
        self._scatter(now, n, alive, bounce, self.curved[:n] > 0.0 if bends else self.none)
        lobes.count[:n][~alive] = 0
        if bends:
            bend_mirrors(lobes, self.curved, self.alpha, np.int64(n))
        keep_lobes(lobes, self.alpha, self.chaos, self.cone_of, np.int64(n))
        if bounce:
            weak = alive & self._weak(now, n)
            self.stage, self.glints, self.repeats = self.weak_stage, True, 1
            super()._direct_light(now, n, weak, bounce)
            lobes.count[:n][weak] = 0
            alive = alive & ~weak
        self.stage, self.glints, self.repeats = self.strong_stage, light.many, light.world_rays
        if bounce == 0:
            self.shared_light.begin(
                lobes, now.throughput, self.frames.position, self.bounced[:n], self.first, n
            )
        if light.rays.turns:
            super()._direct_light(now, n, alive, bounce)
        self.small = None
        if len(light.lamps.shape) and lobes.count[:n].any():
            self.light_wide_lamps(now, n, bounce)

    def _look_at_light(self, now, m: int, turn) -> None:
        """As SharingPaths; a lamp of its own finds no gaps between what neighbours' lobes see of a curved surface."""
        behind = self.small is None
        # what is weak shares lamps with its rays, whose lobes are as they are
        if turn is None or turn[0] != LAMP or behind and (self.glints or not self.light.extended):
            super()._look_at_light(now, m, turn)
            return
        count, lobes = np.int64(self.lit_rows[:m].max(initial=-1) + 1), self.lobes
        variance, times = (self.spread, BEHIND) if behind else (self.gaps, 1.0)
        kinds = lobes.kind[:count].copy()
        widen_more(lobes, variance, times, self.alpha, count)
        super()._look_at_light(now, m, turn)
        widen_more(lobes, variance, 0.0, self.alpha, count)
        lobes.kind[:count] = kinds  # mirrors are mirrors again, though they bend

    def sample_lights(self, m: int, turn=None):
        """Light samples: of the world and what shines, lobes see their part themselves (share_with_lobes)."""
        chosen = super().sample_lights(m, turn)
        chosen.mis[:] = False
        # what is asked several times counts once
        if turn == (WORLD, 0):
            chosen.times[:] = self.asked[self.lit_rows[:m]]
        else:
            chosen.times[:] = self.stage.lights.turns.count(turn)
        chosen.visibility[chosen.kind == WORLD] &= DIFFUSE
        if turn is None and len(self.stage.lights.arrays.emitters.path):
            self._leave_insides(m, chosen)
        return chosen

    def _leave_insides(self, m: int, chosen) -> None:
        """No inner side of a closed mesh lights what is seen of it from outside: pieces stand for places that lie below
        others of them, from where it would be seen.
        """
        lights = self.stage.lights
        opaque = self.lobes.flags[self.lit_rows[:m]] & HAS_TRANSMISSION == 0
        found = np.flatnonzero((chosen.kind == TRIANGLE) & opaque)
        rows, index = self.lit_rows[found], chosen.index[found]
        outside = lights.arrays.emitters.outside[index]
        own = (outside != 0.0) & (self.frames.backfacing[rows] == (outside < 0.0))
        own &= (self.hits.path[rows] == chosen.path[found]) & (self.hits.part[rows] == lights.parts_of(index))
        found, index, outside = found[own], index[own], outside[own]
        a, b, c = lights.arrays.emitters.vertices[index].transpose(1, 0, 2)
        leaves = (np.cross(b - a, c - a) * chosen.direction[found]).sum(1) * outside > 0.0
        chosen.kind[found[leaves]] = NONE

    def connect(self, now, m: int, chosen) -> int:
        glints, kind = self.glints, chosen.kind
        shared = glints or bool((kind == TRIANGLE).any()) or self.light.points
        if shared:
            pdf = self._own_pdf(m, chosen)
            share_with_lobes(
                self.lobes, self.view.incoming, self.lit_rows, chosen, pdf, self.light.lights.arrays.lamps.mis,
                glints, self.small is None, self.cone_of, self.next_cones, np.int64(m), self.shared,
            )  # fmt: skip
        if self.asks == LAMP:
            self.shared_light.of_lamps(chosen, self.lit_rows[:m])
        count = super().connect(now, m, chosen)
        if shared:
            restore_lobes(self.lobes, self.lit_rows, chosen, glints, np.int64(m), self.shared)
        return count

    def _own_pdf(self, m: int, chosen) -> np.ndarray:
        """(m,) densities of samples against those of lobes: of emitters as `_emission` asks for them."""
        pdf = np.where(chosen.kind == LAMP, chosen.pdf, 0.0)
        found = np.flatnonzero(chosen.kind == TRIANGLE)
        if len(found):
            pdf[found] = self.strong_stage.lights.emitter_pdf(
                chosen.path[found], chosen.triangle[found], self.lit_position[found], self.lit_normal[found],
                self.lit_transmissive[found], chosen.direction[found], chosen.distance[found],
            )  # fmt: skip
        return pdf

    def _weak(self, now, n: int) -> np.ndarray:
        """(n,) bool: paths behind first surfaces that are worth little; diffuse rays share what they find."""
        return (now.throughput[:n].max(1) < STRONG) | (now.state.diffuse_depth[:n] > 0)

    def _small(self, n: int) -> np.ndarray:
        """(n,) bool: fragments that weigh too little for cones, and for more than half of the rays to the world."""
        return self.space.fragments.count[self.first : self.first + n] < LARGE

    def _count_bounced(self, n: int) -> None:
        """How many diffuse rays the fragments of a batch are worth: as many as they fill of a cone."""
        image, seen = self.space.image, self.space.fragments.count[self.first : self.first + n]
        self.bounced[:n] = seen * (DIFFUSE_RAYS / image.cone**2)

    def _scatter(self, now, n: int, alive, bounce: int, bent) -> None:
        """Paths behind the surfaces, and their cones. bent: see scatter_lobes."""
        glinting = self.glinting if bounce or self.light.many else 0.0
        self.going = scatter_lobes(
            now, self.samples, self.hits, self.frames, self.lobes, self.stage.limits, self.stage.tables,
            self.stage.shader.tables, np.int64(bounce), alive, np.int64(n), np.int64(ROOM), self.then, self.next_cones,
            self.cone_of, self.none if self.small is None else self.small, bent, self.curved, self.shape,
            self.turned, self.chaos, self.limit, glinting, self.shared_light.lobes,
            self.shared_light.refractions, np.int64(self.first), self.bounced, self.passed,
        )  # fmt: skip

    def scatter(self, now, n: int, alive, bounce: int) -> None:
        """Nothing: `_direct_light` has done it, for it drops lobes."""

    def move(self, now, then, n: int, alive) -> int:
        self.lobe_cones, self.next_cones = self.next_cones, self.lobe_cones
        return self.going

    def meet(self, tile, now, then, n: int, bounce: int) -> int:
        self.then = then
        if bounce == 1 and self.shared_light.copies:
            self.shared_light.count_lobe_rays(now.slot, self.hits, n)
        return super().meet(tile, now, then, n, bounce)

    def _bounce(self, tile, now, then, n: int, bounce: int) -> int:
        """What the cones of n paths see is met; returns how many paths go on from there, in `then`."""
        light, lobes, met, hits = self.light, self.lobe_cones, self.met, self.hits
        weigh_sub_rays(lobes, np.int64(n))
        strong = STRONG if bounce == 1 else 1.0
        choose_places(now, self.samples, self.stage.tables, np.int64(bounce), np.int64(n), self.chances)
        thin_out(now, lobes, self.chances, strong, np.int64(n))
        most = max(1, min(MOST if bounce == 1 else 1, ROOM // n - 1))
        merging = Merging(most=most, seed=self.stage.settings.seed + bounce, chances=self.chances)
        met.rays.skip_triangle[:] = -1
        cones = int(np.count_nonzero(lobes.alpha[:n] >= 0))
        self.counters.update(lobe_cones=cones, lobe_rays=n - cones)
        count = 0
        if cones:
            count = gather(
                light.acceleration, light.prefiltered()[1], lobes.cones, self.met_fragments, met.rays, hits,
                self.escaped, None, 0, n, merging=merging, weights=lobes.weights,
            )  # fmt: skip
            if bounce == 1 and len(light.lights.arrays.met_lamps):
                self._see_lamps(now, count, n)
        counts = follow_cones(
            now, lobes, self.met_fragments, self.escaped, np.int64(count), np.int64(n), np.int64(ROOM), met, hits,
            self.lobe_alpha, self.behind, self.blur, self.around,
        )  # fmt: skip
        total = sum(counts)
        self.by_ray[:total] = np.arange(total) >= total - counts[2]
        if counts[2]:
            rays = slice(total - counts[2], total)
            walk.intersect(light.acceleration, met.rays, hits, rays.start, rays.stop)
            self.lobe_alpha[rays][hits.triangle[rays] < 0] *= OF_SKY
        self.counters["lobe_fragments"] += counts[0]
        frames(self.stage.shader.geometry, met.rays, hits, self.frames, 0, total)
        return self.meet(tile, met, then, total, bounce) if total else 0

    def _see_lamps(self, now, count: int, n: int) -> None:
        """Add the lamps that the cones of n paths see, between the `count` fragments that they meet; those of mirrors
        but of lamps with nodes, which rays meet where they are."""
        lights, fragments = self.light.lights, self.met_fragments
        sharp, rough = not lights.nodes, self.light.many
        if not (sharp or rough):
            return
        begin, near = np.empty(n + 1, np.int64), np.empty(len(lights.arrays.met_lamps), np.int32)
        first_fragments(fragments, np.int64(count), begin)

        def find(lamps, met, out, towards) -> None:
            lamps_in_cones(
                lamps, lights.arrays.tree, met, now, self.lobe_cones, fragments, begin, np.int64(n), sharp, rough, near,
                out, towards,
            )  # fmt: skip

        self._add_lamps(now, n, find, self.lobe_cones.cones.origin)

    def _see_blurred(self, now, rays, rows: np.ndarray, n: int, bounce: int) -> None:
        """Add the lamps about the rays `rows` of n, which see them blurred."""

        def find(lamps, met, out, towards) -> None:
            blurred_lamps(
                lamps, met, rays, self.hits.t, now, self.samples, self.stage.tables, np.int64(bounce), self.blur, rows,
                out, towards,
            )  # fmt: skip

        self._add_lamps(now, n, find, rays.origin)

    def _add_lamps(self, now, n: int, find, origin) -> None:
        """Add the lamps that n paths see, those with nodes as these are seen from `origin` (N, 3) on the whole.

        find(lamps, met lamps, out (n, 3) float32, towards (n, 3) float64): adds what is seen of them, and in what
        direction, of no length.
        """
        lights, seen, towards = self.light.lights, np.zeros((n, 3), np.float32), np.zeros((n, 3))
        find(lights.arrays.lamps, lights.arrays.met_lamps, seen, towards)
        for k, nodes in lights.nodes.items():
            own, towards = np.zeros((n, 3), np.float32), np.zeros((n, 3))
            lamps, met, _ = lights.as_if_even(k)
            find(lamps, met, own, towards)
            rows = np.flatnonzero(own.any(1))
            if len(rows):
                there = towards[rows] / np.linalg.norm(towards[rows], axis=1, keepdims=True)
                seen[rows] += own[rows] * nodes.met(origin[rows], there)
        paths.add_radiance(now, self.samples, self.stage.limits, seen, self.ones[:n], n)

    def _met_lights(self, now, rays, n: int, alive, bounce: int) -> None:
        stage, self.stage = self.stage, self.weak_stage  # whose samples share lamps with what lobes see
        super()._met_lights(now, rays, n, alive, bounce)
        self.stage = stage
        blurred = np.flatnonzero(self.blur[:n]) if bounce else ()
        if len(blurred) and len(self.light.lights.arrays.met_lamps):
            self._see_blurred(now, rays, blurred, n, bounce)

    def pdf_of_lamps(self, now, n: int, bounce: int) -> np.ndarray:
        """Lamps are seen where nothing widens the view, or as the part that samples leave to lobes."""
        seen = np.where((now.flags[:n] & NO_LAMPS) != 0, 0.0, np.inf)
        if bounce == 0:
            return seen
        shared = np.where((now.flags[:n] & SEES_LAMPS) != 0, now.bsdf_pdf[:n], 0.0)
        pdf = np.where(self.lobe_alpha[:n] <= 0.0, seen, shared)
        pdf[self.blur[:n] > 0.0] = 0.0  # _see_blurred
        return pdf

    def seen_world(self, now, rays, rows: np.ndarray, bit: int):
        """The world, blurred by the lobes that see it; light samples look for it at diffuse lobes alone."""
        world = self.light.world
        maps = {
            GLOSSY: (world.glossy, world.glossy_rays), TRANSMISSION: (world.transmission, world.transmission_rays)
        }.get(bit)  # fmt: skip
        weight = np.where(now.bsdf_pdf[rows] == BY_SAMPLES, 0.0, 1.0)
        if maps is None:
            return self.stage.lights.world_radiance(rays.direction[rows], bit), weight
        radiance = np.empty((len(rows), 3), np.float32)
        sharp = self.lobe_alpha[rows] <= 0.0
        if sharp.any():
            radiance[sharp] = self.stage.lights.world_radiance(rays.direction[rows[sharp]], bit)
        for some, of in zip((~sharp & ~self.by_ray[rows], ~sharp & self.by_ray[rows]), maps, strict=True):
            if some.any():
                seen = np.empty((int(some.sum()), 3), np.float32)
                look_at_world(of, rays.direction, self.lobe_alpha, rows[some], seen)
                radiance[some] = seen
        return radiance, weight


@uncounted
def look_at_world(maps, direction, alpha, rows, out):
    """World radiance that lobes of roughness alpha (N,) see in direction (N, 3), `rows` of them, to out (R, 3)."""
    for i in range(len(rows)):
        k = rows[i]
        r, g, b = world_lobe(maps, np.float64(alpha[k]), direction[k, 0], direction[k, 1], direction[k, 2])
        out[i, 0], out[i, 1], out[i, 2] = r, g, b
