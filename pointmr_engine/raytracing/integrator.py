"""The tile integrator: paths move through the stages of a wavefront, bounce after bounce, until none is left.

It serves `distributed` (many random paths a pixel) and `conventional` (one, through the pixel's centre and the lens'
centre): they differ in the settings that they hand over. A workspace belongs to one thread.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from pointmr_engine.hierarchy.acceleration import Acceleration
from pointmr_engine.image import film
from pointmr_engine.needs import Needs
from pointmr_engine.numerics.rng import sobol_tables
from pointmr_engine.raytracing import direct_light, paths, walk
from pointmr_engine.raytracing.camera import CameraArrays, sample_rays, window_coordinates
from pointmr_engine.raytracing.frames import allocate_frames, frames, veil_frames
from pointmr_engine.raytracing.light_sampling import LightSamples, allocate_light_samples
from pointmr_engine.raytracing.lights import Lights
from pointmr_engine.raytracing.path_arrays import (
    BACKDROP,
    FINAL,
    PASSES_DONE,
    Limits,
    allocate_paths,
    allocate_samples,
    allocate_scattered,
    lay_out,
    start_paths,
)
from pointmr_engine.raytracing.rays import Rays, allocate_hits
from pointmr_engine.raytracing.shade import Shader, allocate_view, fill_view
from pointmr_engine.raytracing.surface import RayState, allocate_ray_state
from pointmr_engine.raytracing.terminator import raise_origins
from pointmr_engine.raytracing.walk_veils import NOTED, allocate_veils, begin_veils
from pointmr_engine.scene.group import CAMERA, DIFFUSE, GLOSSY, TRANSMISSION
from pointmr_engine.scene.settings import RenderSettings
from pointmr_engine.shading import lobes as lobe_kernels
from pointmr_engine.shading.points import RAY_DIFFUSE, RAY_REFLECTION, RAY_SHADOW

BATCH = 65536  # paths that move together: enough to make numpy's overhead small, few enough for the cache
AT_ONCE = 1024  # surfaces that shadow rays pass in one step, where fewer rays wait: as for BATCH
# Roberts' low-discrepancy steps in three dimensions
NEXT = np.array([0.8191725134, 0.6710436067, 0.5497004779])


@dataclass(eq=False)
class Stage:
    """All that the integrator reads; the same for every thread."""

    acceleration: Acceleration
    shader: Shader
    lights: Lights
    camera: CameraArrays
    settings: RenderSettings
    needs: Needs
    limits: Limits
    materials_index: np.ndarray  # (materials,) int32 pass index
    tables: tuple = field(default_factory=sobol_tables)

    def __post_init__(self):
        if self.settings.method == "conventional":
            self.lights = self.lights.apart
        elif self.settings.method == "distributed" or self.settings.raytrace.secondary == "rays":
            self.lights = self.lights.above


class Workspace:
    """One thread's arrays for batches of up to `n` paths, and its counters."""

    def __init__(self, stage: Stage, n: int):
        camera_from_world = stage.camera.camera_from_world
        self.stage = stage
        self.size = n
        self.samples = allocate_samples(n)
        self.queues = [allocate_paths(n, camera_from_world) for _ in range(2)]
        self.hits = allocate_hits(n)
        self.frames = allocate_frames(n)
        self.view = allocate_view(n)
        self.lobes = lobe_kernels.allocate(n, stage.needs.max_lobes, stage.shader.tables)
        self.order = np.zeros(n, np.int64)
        self.scattered = allocate_scattered(n)
        self.counters: Counter = Counter()
        self.texture_slopes = None  # of first surfaces, for methods that ask
        if stage.needs.light_samples:
            self.lit_rows = np.zeros(n, np.int32)
            self.lit_position = np.zeros((n, 3))
            self.lit_normal = np.zeros((n, 3), np.float32)
            self.lit_transmissive = np.zeros(n, np.bool_)
            self.lit_u = np.zeros((n, 3))
            self.light_samples = allocate_light_samples(n)
            self.shadows = direct_light.allocate_shadow_rays(n)
            self.shadow_hits = allocate_hits(n)
            noted = NOTED if stage.needs.transparent_shadows else 1
            # none where kernels are only compiled
            levels = stage.acceleration.arrays.levels + 1 if stage.acceleration else 1
            self.veils = allocate_veils(n, levels, noted)
            self.waiting = np.zeros(n, np.int64)
            self.triangle = np.zeros((4, 3)), np.zeros((4, 3))
            self.raises = bool(stage.shader.geometry.tables.terminator_offset.any())
        if stage.needs.transparent_shadows and stage.needs.light_samples:
            self.veil_hits, self.veil_frames = allocate_hits(n), allocate_frames(n)
            self.veil_state = allocate_ray_state(n, camera_from_world)

    def render_tile(self, tile: film.TileSums, first: int, count: int) -> None:
        """Add samples first..first+count of all the tile's pixels to its sums. At most `size` paths."""
        n = total = self.start(*(int(v) for v in tile.bounds), first, count)
        now, then = self.queues
        s = self.samples
        self.counters["camera_rays"] += n
        bounce = 0
        while n:
            n = self._bounce(tile, now, then, n, bounce)
            now, then = then, now
            bounce += 1
        film.add_light(tile, s.pixel, s.radiance, s.transparency, 0, total)

    def _bounce(self, tile, now, then, n: int, bounce: int) -> int:
        """Move n paths from surface to surface; returns how many go on, in `then`."""
        stage, hits, surface = self.stage, self.hits, self.frames
        walk.intersect(stage.acceleration, now.rays, hits, 0, n)
        if bounce:
            self.counters["scattered_rays"] += n
        frames(stage.shader.geometry, now.rays, hits, surface, 0, n)
        return self.meet(tile, now, then, n, bounce)

    def meet(self, tile, now, then, n: int, bounce: int) -> int:
        """Shade what n paths have hit, `hits` and `frames`, and send them on; returns how many go on, in `then`."""
        stage, hits, surface = self.stage, self.hits, self.frames
        rays, state = Rays(*(a[:n] for a in now.rays)), now.state
        alive = hits.triangle[:n] >= 0
        self._met_lights(now, rays, n, alive, bounce)
        if bounce and stage.needs.surface_passes:
            self._empty_passes(tile, now, n, alive)
        final = (now.flags[:n] & FINAL) != 0
        np.logical_and(alive, ~(final & stage.shader.dull[surface.material[:n]]), out=alive)
        if not alive.any():
            return 0
        if stage.needs.window and bounce == 0:
            state.window[:n] = window_coordinates(stage.camera, surface.position[:n])
        fill_view(now.rays, state.kind, surface, self.view, n)
        stage.shader.lobes_at(
            now.rays, state, hits, surface, self.view, alive, n, self.order, self.lobes,
            self.texture_slopes if bounce == 0 else None, self.detail(now, n, bounce),
        )  # fmt: skip
        self.shaded(now, n, bounce)
        self.counters["shaded_points"] += int(alive.sum())
        if self.lobes.holdout[:n].any() or (alive & hits.holdout[:n]).any():
            self.hold_out(now, n, alive)
        self._emission(tile, now, rays, n, alive)
        if bounce <= stage.limits.transparent and stage.needs.surface_passes:
            self._surface_passes(tile, now, n, alive)
        self.finish(now, n, alive)
        if bounce:  # until then nothing is weak
            self.roulette(now, n, alive, bounce)
        if stage.needs.light_samples:
            self._direct_light(now, n, alive, bounce)
        self.scatter(now, n, alive, bounce)
        return self.move(now, then, n, alive)

    def detail(self, now, n: int, bounce: int) -> np.ndarray | None:
        """(n,) uint8: at how many places of their footprints paths see textures (Shader.lobes_at); None: at every."""
        return None

    def shaded(self, now, n: int, bounce: int) -> None:
        """The lobes of n paths are filled: a place for methods that know more of the surfaces than a ray does."""

    # Stages of their own: a second process compiles them by calling them for no paths at all.

    def start(self, x0: int, y0: int, x1: int, y1: int, first: int, count: int) -> int:
        """Camera paths of a tile's samples, in the first queue; returns how many."""
        n = lay_out(self.samples, x0, y0, x1, y1, first, count)
        stage, s, now = self.stage, self.samples, self.queues[0]
        start_paths(now, n)
        sample_rays(
            stage.camera, stage.tables, stage.settings.seed, s.x, s.y, s.number,
            now.rays, s.seed, now.state.width, now.state.spread, 0, n,
        )  # fmt: skip
        return n

    def hold_out(self, now, n: int, alive) -> None:
        paths.hold_out(now, self.samples, self.hits, self.lobes, alive, n)

    def finish(self, now, n: int, alive) -> None:
        paths.finish_final(now.flags, self.lobes.count, self.lobes.flags, alive, n)

    def roulette(self, now, n: int, alive, bounce: int) -> None:
        paths.roulette(
            now.throughput, now.state.depth, now.flags, now.slot, self.samples.seed, self.samples.number,
            self.stage.tables, bounce, alive, n,
        )  # fmt: skip

    def choose_points(self, now, n: int, alive, bounce: int) -> int:
        return direct_light.choose_points(
            now, self.samples, self.lobes, self.frames, self.stage.tables, bounce, alive, n, self.lit_rows,
            self.lit_position, self.lit_normal, self.lit_transmissive, self.lit_u,
        )  # fmt: skip

    def shift_points(self, m: int, step) -> None:
        """Move the light samples of points 0..m on by `step` in the unit cube, around its borders."""
        u = self.lit_u[:m]
        u += step
        u -= np.floor(u)

    def sample_lights(self, m: int, turn=None) -> LightSamples:
        chosen = LightSamples(*(a[:m] for a in self.light_samples))
        self.stage.lights.sample(
            self.lit_position[:m],
            self.lit_normal[:m],
            self.lit_transmissive[:m],
            self.lit_u[:m],
            chosen,
            turn,
        )
        return chosen

    def connect(self, now, m: int, chosen: LightSamples) -> int:
        return direct_light.connect(
            now, self.hits, self.frames, self.lobes, self.stage.limits, chosen, self.lit_rows, m, self.shadows
        )

    def raise_origins(self, count: int) -> None:
        raise_origins(
            self.stage.shader.geometry.tables, self.hits, self.frames, self.lobes.normal, self.shadows, count,
            *self.triangle,
        )  # fmt: skip

    def settle(self, count: int) -> int:
        return direct_light.settle(
            self.shadows, self.shadow_hits, self.samples, self.stage.limits.transparent, count, self.waiting
        )

    def dim(self, waiting, taken, share) -> int:
        return direct_light.dim(
            self.shadows, self.samples, self.veils, waiting, taken, self.veil_hits, self.veil_frames, share
        )

    def scatter(self, now, n: int, alive, bounce: int) -> None:
        paths.scatter(
            now,
            self.samples,
            self.lobes,
            self.stage.limits,
            self.stage.tables,
            bounce,
            alive,
            n,
            self.scattered,
        )

    def move(self, now, then, n: int, alive) -> int:
        return paths.move(
            now, self.hits, self.frames, self.scattered, self.lobes.normal, self.lobes.flags,
            self.stage.limits, alive, then, n,
        )  # fmt: skip

    def _met_lights(self, now, rays: Rays, n: int, alive, bounce: int) -> None:
        """Lamps that the rays pass, and the world where they hit nothing."""
        stage, lights = self.stage, self.stage.lights
        if len(lights.arrays.met_lamps):
            met = np.zeros((n, 3), np.float32)
            lights.seen_lamps(
                rays.origin, rays.direction, rays.t_min, self.hits.t[:n], rays.visibility, now.origin_normal[:n],
                now.origin_transmissive[:n], self.pdf_of_lamps(now, n, bounce), met,
            )  # fmt: skip
            paths.add_radiance(now, self.samples, stage.limits, met, np.ones(n), n)
        missed = ~alive
        if not missed.any():
            return
        if stage.settings.film_transparent:
            paths.see_through(now, self.samples, missed, n)
            missed &= (now.flags[:n] & BACKDROP) == 0
        if lights.environment.black:
            return
        radiance = np.zeros((n, 3), np.float32)
        weight = np.zeros(n)
        for bit in (CAMERA, DIFFUSE, GLOSSY, TRANSMISSION):
            rows = np.flatnonzero(missed & (rays.visibility == bit))
            if not len(rows):
                continue
            radiance[rows], weight[rows] = self.seen_world(now, rays, rows, bit)
        paths.add_radiance(now, self.samples, stage.limits, radiance, weight, n)

    def pdf_of_lamps(self, now, n: int, bounce: int) -> np.ndarray:
        """(n,) density of the rays against that of light samples: inf where lamps are met alone, 0 where not at all."""
        return now.bsdf_pdf[:n]

    def seen_world(
        self, now, rays: Rays, rows: np.ndarray, bit: int
    ) -> tuple[np.ndarray, np.ndarray | float]:
        """(radiance, weight) of the world for the rays `rows`, which are of one kind and hit nothing."""
        lights, direction = self.stage.lights, rays.direction[rows]
        radiance = lights.world_radiance(direction, bit)
        if bit == CAMERA:
            return radiance, 1.0
        return radiance, lights.world_weight(
            rays.origin[rows], now.origin_normal[rows], now.origin_transmissive[rows], direction,
            now.bsdf_pdf[rows],
        )  # fmt: skip

    def _emission(self, tile, now, rays: Rays, n: int, alive) -> None:
        """Light that the surfaces emit, weighed against the light samples that could have found it."""
        emission = self.lobes.emission[:n]
        rows = np.flatnonzero(alive & emission.any(1))
        if not len(rows):
            return
        weight = np.zeros(n)
        hits = self.hits
        weight[rows] = self.stage.lights.emitter_weight(
            hits.path[rows], hits.triangle[rows], rays.origin[rows], now.origin_normal[rows],
            now.origin_transmissive[rows], rays.direction[rows], hits.t[rows], now.bsdf_pdf[rows],
        )  # fmt: skip
        paths.add_radiance(now, self.samples, self.stage.limits, emission, weight, n)
        if len(tile.emission):
            first = rows[(now.flags[rows] & BACKDROP) != 0]
            film.add_averages(
                tile.emission, self.samples.pixel[now.slot[first]], emission[first] * now.throughput[first], 0,
                len(first),
            )  # fmt: skip

    def _empty_passes(self, tile, now, n: int, alive) -> None:
        """Nothing, where a pixel's first ray ends behind surfaces too transparent for the unfiltered passes."""
        rows = np.flatnonzero(~alive & ((now.flags[:n] & (BACKDROP | PASSES_DONE)) == BACKDROP))
        rows = rows[self.samples.number[now.slot[rows]] == 0]
        if len(rows):
            film.write_nothing(tile, self.samples.pixel[now.slot[rows]], 0, len(rows))

    def _surface_passes(self, tile, now, n: int, alive) -> None:
        """What the passes keep of the first surfaces, those that transparent ones let through included."""
        rows = np.flatnonzero(alive & ((now.flags[:n] & BACKDROP) != 0))
        if not len(rows):
            return
        samples, surface, lobes = self.samples, self.frames, self.lobes
        pixel = samples.pixel[now.slot[rows]]
        if len(tile.diffuse_color):
            film.add_averages(
                tile.diffuse_color, pixel, lobes.diffuse_color[rows] * now.throughput[rows], 0, len(rows)
            )
        open_rows = (now.flags[rows] & PASSES_DONE) == 0
        rows, pixel = rows[open_rows], pixel[open_rows]
        first = samples.number[now.slot[rows]] == 0
        if first.any():
            at = rows[first]
            position = surface.position[at]
            film.write_first(
                tile, pixel[first], _depths(self.stage.camera, position), position, self.hits.object_index[at],
                self.stage.materials_index[surface.material[at]], 0, len(at),
            )  # fmt: skip
        alpha = 1.0 - np.clip(lobes.transparency[rows], 0, 1).mean(1)
        solid = alpha >= self.stage.settings.pass_alpha_threshold
        rows, pixel = rows[solid], pixel[solid]
        if len(tile.normal):
            normal = np.zeros((len(rows), 3), np.float32)
            paths.average_normals(lobes, rows, normal)
            film.add_averages(tile.normal, pixel, normal, 0, len(rows))
        now.flags[rows] |= PASSES_DONE

    def _direct_light(self, now, n: int, alive, bounce: int) -> None:
        """One light sample in every turn for each point that can use one, and the shadow rays to it."""
        m = self.choose_points(now, n, alive, bounce)
        for k, turn in enumerate(self.stage.lights.turns if m else ()):
            if k:  # each turn has its own place in the unit cube
                self.shift_points(m, NEXT)
            self._look_at_light(now, m, turn)

    def _look_at_light(self, now, m: int, turn) -> None:
        stage = self.stage
        chosen = self.sample_lights(m, turn)
        stage.lights.emission_at(chosen, self.lit_position)
        count = self.connect(now, m, chosen)
        if self.raises and count:
            self.raise_origins(count)
        self.follow_shadow_rays(now, count)

    def follow_shadow_rays(self, now, count: int) -> None:
        """Add the light of shadow rays 0..count that arrives, less what the surfaces that they pass keep of it."""
        stage = self.stage
        begin_veils(self.veils, count)
        while count:
            walk.shadow(stage.acceleration, self.shadows.rays, self.shadow_hits, 0, count, self.veils)
            self.counters["shadow_rays"] += count
            left = self.settle(count)
            count = self._pass_through(now, left) if left else 0

    def _pass_through(self, now, left: int) -> int:
        """Dim the waiting shadow rays by the surfaces that they pass next; returns how many go on.

        By one where many wait; by several at once where few do, though chance may end a ray before the last of them.
        """
        stage, waiting, hits, surface = self.stage, self.waiting[:left], self.veil_hits, self.veil_frames
        passed = self.shadows.passed[waiting].astype(np.int64)
        most = max(min(AT_ONCE, self.size) // left, 1)
        taken = walk.take_veils(
            stage.acceleration, self.veils, waiting, np.minimum(stage.limits.transparent - passed, most), hits
        )
        ray = np.repeat(waiting, taken)
        rays, state, n = self.shadows.rays, self.veil_state, len(ray)
        if stage.shader.plain_veils:
            veil_frames(stage.shader.geometry, hits, n, surface)
        else:
            rays = Rays(*(a[ray] for a in rays))
            frames(stage.shader.geometry, rays, hits, surface, 0, n)
            self._fill_veil_state(
                now, ray, np.repeat(passed - np.cumsum(taken) + taken, taken) + np.arange(n)
            )
        share = stage.shader.transparency_at(rays, state, hits, surface, np.arange(n))
        return self.dim(waiting, taken, share)

    def _fill_veil_state(self, now, ray: np.ndarray, passed: np.ndarray) -> None:
        """What the shadow rays `ray` (n,) tell surfaces, behind `passed` (n,) others."""
        state: RayState = self.veil_state
        n, source = len(ray), self.shadows.source[ray]
        for name in ("depth", "diffuse_depth", "glossy_depth", "transmission_depth"):
            getattr(state, name)[:n] = getattr(now.state, name)[source]
        # those that stand for rays that surfaces scatter (direct_light.connect)
        scattered = self.shadows.rays.visibility[ray] == DIFFUSE
        state.kind[:n] = np.where(scattered, RAY_DIFFUSE | RAY_REFLECTION, RAY_SHADOW)
        state.depth[:n] += scattered
        state.diffuse_depth[:n] += scattered
        state.transparent_depth[:n] = passed
        # unfiltered: what materials make of a mean of their images is not the mean of what they let through
        state.width[:n] = 0.0
        state.spread[:n] = 0.0


def _depths(camera: CameraArrays, position: np.ndarray) -> np.ndarray:
    m = camera.camera_from_world[2]
    return position @ m[:3] + m[3]
