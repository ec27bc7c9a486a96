"""Paths that begin at a tile's fragments: what the primary cones see goes on as random rays, stratified in each pixel.

The surfaces are those of the fragments, with their footprints and distributions of normals; from there the integrator
of raytracing/ carries the light: shadow rays, reflections, refractions and the bounces behind them.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.drawing.cut_out_cover import let_through
from pointmr_engine.forward.drawing.cut_outs import NARROW, look_where_opaque
from pointmr_engine.forward.reconstruction.fragments import cell_at
from pointmr_engine.forward.shading.fragment_surfaces import place_fragments, place_values, surfel_frames
from pointmr_engine.forward.shading.holes_in_footprints import holes_in_footprints
from pointmr_engine.forward.shading.lobe_light import widen_by_normals
from pointmr_engine.image.film import TileSums
from pointmr_engine.multires.fragments.curvature import go_to_middles, spread_of_curvature
from pointmr_engine.multires.fragments.looks import aim_at_points
from pointmr_engine.multires.fragments.texture_slopes import slopes_in_image
from pointmr_engine.multires.fragments.transparency import UNKNOWN, close_transparency
from pointmr_engine.multires.paths.path_pool import PathPool
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.rng import pixel_seed, sample_1d
from pointmr_engine.raytracing import walk
from pointmr_engine.raytracing.frames import sub_frames
from pointmr_engine.raytracing.integrator import Stage, Workspace
from pointmr_engine.raytracing.path_arrays import Samples, start_paths
from pointmr_engine.raytracing.rays import Rays, allocate_hits, allocate_rays
from pointmr_engine.raytracing.surface import RayState, allocate_frames, frames
from pointmr_engine.scene.group import CAMERA
from pointmr_engine.shading.footprint_slopes import allocate_texture_slopes

# fragments at once: of fewer, the tails of paths and shadow rays cost more than what they shade
BATCH = 12288
TOGETHER = 8  # fragments for each cone of a pixel whose samples are one run
MOST_NUMBER = (1 << 31) - 1
WHOLE_RUNS = 32  # first of the curves of whole runs
MARGIN = 64  # pixels beyond the image that tiles may have
PARTS = 2  # of the room for paths: so many may become of one, what its cone sees and what escapes
FEW, MANY = 1024, 4096  # paths that wait for those of other batches, and those that do not wait any longer
FLATNESS = 0.95  # of a piece, below which it is a clump that has no normal of its own
VEIL_CHANCES = 0x5EE  # first dimension set of the looks' numbers
VEILS = 8  # transparent surfaces that a look at a clump passes at most


@device
def _spread_bits(n):
    """The lowest 14 bits of n, a zero before each."""
    n = np.uint32(n) & np.uint32(0x3FFF)
    n = (n | (n << np.uint32(8))) & np.uint32(0x00FF00FF)
    n = (n | (n << np.uint32(4))) & np.uint32(0x0F0F0F0F)
    n = (n | (n << np.uint32(2))) & np.uint32(0x33333333)
    return (n | (n << np.uint32(1))) & np.uint32(0x55555555)


@uncounted
def count_in_pixels(fragments, subpixels, count, own):
    """own (rows, columns) int32: how many of a tile's fragments 0..count each of its pixels has."""
    own[:] = 0
    for k in range(count):
        i, j = cell_at(fragments.x[k], fragments.y[k], subpixels, own.shape)
        own[j, i] += 1


@device
def _curve_of(n, own, together):
    """The run that number n of a pixel's `own` belongs to, its length, and the number in it.

    Runs of `together`, and what is left in runs of smaller powers of two: each is stratified by itself.
    """
    whole = own // together * together
    if n < whole:
        return WHOLE_RUNS + n // together, together, n % together
    n -= whole
    curve, size = np.int64(0), together // 2
    while own & size == 0 or n >= size:
        n -= own & size
        curve, size = curve + 1, size // 2
    return curve, size, n


@uncounted
def number_samples(
    fragments, left, low, subpixels, together, first, count, samples, seed, own, used, pixel
):  # fmt: skip
    """Pixels of fragments first..first + count, and their seeds and numbers, as samples 0..count.

    They are numbered along Morton curves through the image, on which a pixel takes as many numbers as a run of its
    fragments has: what lies side by side has samples that are stratified together (Ahmed and Wonka 2020,
    "Screen-Space Blue-Noise Diffusion of Monte Carlo Sampling Error via Hierarchical Ordering of Pixels"), so that what
    neighbours share, and what the pixel filter averages, has less noise than of samples by chance. There is a curve for
    each length of runs: one with regular gaps would miss the same part of its samples everywhere. Pixels that are
    thousands apart may have the same numbers.

    together: the longest run, a power of two; own, used (rows, columns) int32: the tile's pixels' fragments, all and so
    far; left, low: the tile's first subpixel. pixel (N,) int64: number of each one's pixel in the tile.
    """
    for k in range(count):
        i, j = cell_at(fragments.x[first + k], fragments.y[first + k], subpixels, used.shape)
        x, y = left // subpixels + i, low // subpixels + j
        samples.x[k], samples.y[k] = x, y
        along = np.int64(_spread_bits(x + MARGIN)) + 2 * np.int64(_spread_bits(y + MARGIN))
        curve, size, number = _curve_of(np.int64(used[j, i]), np.int64(own[j, i]), together)
        samples.number[k] = (along * size + number) & MOST_NUMBER
        samples.seed[k] = pixel_seed(curve, np.int64(0), np.int64(seed))
        pixel[k] = j * used.shape[1] + i
        used[j, i] += 1


@uncounted
def start_rays(rays, hits, frame, count):
    """Origins of the camera rays that would meet the hits 0..count."""
    for k in range(count):
        for a in range(3):
            rays.origin[k, a] = frame.position[k, a] - hits.t[k] * rays.direction[k, a]
        rays.t_min[k] = 0.0
        rays.t_max[k] = math.inf
        rays.skip_triangle[k] = -1
        rays.skip_path[k] = 0


@uncounted
def fill_chances(tables, seed, number, slot, step, out):
    """out (N,) float64: a number in 0..1 for the samples `slot` (N,), others for each step."""
    for i in range(len(slot)):
        out[i] = sample_1d(tables, seed[slot[i]], VEIL_CHANCES + step, number[slot[i]])


class FragmentPaths(Workspace):
    """One thread's paths from fragments. settings.samples of the stage says how much of a lobe one ray stands for."""

    def __init__(self, stage: Stage, room: int = 0):
        n = max(room, BATCH)
        super().__init__(stage, n)
        self.batch = BATCH  # fragments at once
        self.flat, self.spread = np.empty(n, np.float32), np.empty(n, np.float32)
        self.curved = np.zeros(n, np.float32)  # of `spread`: by how smooth triangles bend
        self.gaps = np.zeros(n, np.float32)  # what is added for small lamps
        self.shape = np.zeros((n, 6), np.float32)  # curvature.shape_operator of these
        self.pixel, self.in_pixel = np.empty(n, np.int64), np.empty((0, 0), np.int32)
        self.coloured, self.let_pass = np.zeros(n, np.bool_), np.zeros(n, np.float32)
        self.by_view = np.zeros(n, np.bool_)
        self.clear = np.full((n, 3), UNKNOWN, np.float32)
        self.holed, self.place = np.zeros(n, np.bool_), np.empty((n, 2), np.float32)
        self.masked = np.zeros(0, np.int64)  # of those with holes, whose holes have no colour: Program.masked
        self.hit = None  # rows and places of hits, while their textures are read elsewhere
        self.own_slopes = allocate_texture_slopes(n)
        self.alpha = np.empty((n, max(stage.needs.max_lobes, 1), 2), np.float32)
        # of all fragments whose paths are under way; self.samples: of one batch, while its first surfaces are lit
        self.every = self.samples
        self.held, self.pieces = 0, []  # how many, and (first fragment, first sample, how many) of each batch
        # paths behind first surfaces that move on together, so few that nothing is left out of what they see
        self.together = max(n // PARTS - 1, 1) if room else n  # PathPool.give may give one more
        self.fresh, self.tail = PathPool(n + self.together, room > 0), PathPool(FEW + MANY, room > 0)
        none = np.zeros((0, 3))
        self.tile = TileSums(
            none, none, none, none, *(np.zeros(0),) * 5, np.zeros(4, np.int64), np.zeros(1, np.int64)
        )

    def start_tile(self, space, count: int) -> None:
        """Begin with the fragments 0..count of a tile (forward.tiles.Workspace)."""
        self.space = space
        self.texture_slopes = None if space.textures is None else self.own_slopes
        if self.in_pixel.shape != space.used.shape:
            self.in_pixel = np.empty_like(space.used)
        count_in_pixels(space.fragments, np.int64(space.image.subpixels), np.int64(count), self.in_pixel)
        space.used[:] = 0
        self._forget()

    def _forget(self) -> None:
        self.held, self.pieces = 0, []
        self.fresh.empty()
        self.tail.empty()

    def trace(self, hierarchy, values, first: int, count: int) -> None:
        """Send out the paths of fragments first..first + count of the tile; `finish_tile` has what they bring."""
        space = self.space
        image, f = space.image, space.fragments
        now, then = self.queues
        if self.held + count > self.size:
            self._settle_paths()
        base = self.held
        self.samples = Samples(*(a[base : base + count] for a in self.every))
        samples, hits, first_, n_ = self.samples, self.hits, np.int64(first), np.int64(count)
        start_paths(now, count)
        samples.radiance[:count] = 0.0
        samples.transparency[:count] = 0.0
        number_samples(
            f, np.int64(space.left), np.int64(space.low), np.int64(image.subpixels),
            np.int64(TOGETHER * (image.subpixels // image.cone) ** 2), first_, n_, samples,
            np.int64(image.settings.seed), self.in_pixel, space.used, self.pixel,
        )  # fmt: skip
        if len(hierarchy.cut_outs.mask):
            sampler = image.sampler
            holes, material = look_where_opaque(
                sampler.opacity, hierarchy.cut_outs, image.coloured, f, first, count
            )
            let_through(hierarchy.cut_outs, f, first_, n_, self.let_pass)
        to_world = image.camera.world_from_camera
        place_fragments(
            image.view, image.footprint, to_world, hierarchy.octree, hierarchy.parts, space.scratch.transforms, f,
            first_, space.eyes, n_, now.rays, hits, now.state.width,
        )  # fmt: skip
        self.holed[:count] = False
        space.widen_footprints(first, now.state.width[:count])
        if len(hierarchy.cut_outs.mask):
            near = np.empty(len(holes), np.bool_)
            holes_in_footprints(
                hierarchy.cut_outs, self.stage.shader.geometry.tables, hits, now.rays.direction, now.state.width, f,
                first_, holes, near,
            )  # fmt: skip
            holes = holes[near]
            masked = image.masked[material[near]]
            now.state.width[holes[~masked]] *= NARROW
            self.holed[holes] = True
            self.masked = holes[masked]
        place_values(values, f, first_, n_, hits)
        frame = self.frames
        frames(self.stage.shader.geometry, now.rays, hits, frame, 0, count)
        entries = space.scratch.entries
        triangles = np.flatnonzero(entries.surfel[f.entry[first : first + count]] < 0)
        self.place[:count, 0], self.place[:count, 1] = hits.u[:count], hits.v[:count]
        go_to_middles(
            self.stage.shader.geometry.tables, hits, f, first_, triangles, np.int64(len(triangles)), self.holed,
            now.rays.direction, to_world, frame.smooth_normal, self.place, np.empty((3, 3)),
        )  # fmt: skip
        own = [a[:count].copy() for a in (frame.smooth_normal, frame.geometric_normal, frame.backfacing)]
        position = frame.position[:count].copy()
        surfel_frames(to_world, entries, f, first_, n_, now.rays, frame, self.flat, self.spread)
        # rays leave a real point of the piece, with what is around it: its centroid may lie inside
        frame.position[:count] = position
        clump = np.flatnonzero(self.flat[:count] < FLATNESS)
        # a clump faces all ways: the triangle that represents it stands for one of them
        for target, normals in zip(
            (frame.smooth_normal, frame.geometric_normal, frame.backfacing), own, strict=True
        ):
            target[clump] = normals[clump]
        self.spread[clump], self.flat[clump] = 0.0, 1.0
        self.curved[:count], self.gaps[:count], self.shape[:count] = 0.0, 0.0, 0.0
        self.own_slopes.known[:count] = False
        self.coloured[:count] = False
        self.coloured[triangles] = True
        self.by_view[:count] = image.by_view[frame.material[:count]]
        self.coloured[:count] |= self.by_view[:count]
        tables = self.stage.shader.geometry.tables
        spread_of_curvature(
            tables, hits, frame.smooth_normal, now.rays.direction, now.state.width, f.count[first : first + count],
            np.float64(space.cell**2), f.geometric[first : first + count], triangles, np.int64(len(triangles)),
            self.curved, self.spread, self.gaps, self.shape, np.empty((3, 3)),
        )  # fmt: skip
        self._look_at_clumps(space, hierarchy, now, first, clump)
        start_rays(now.rays, hits, self.frames, n_)
        if image.view.perspective:  # the footprint goes on growing behind mirrors
            now.state.spread[:count] = now.state.width[:count] / np.maximum(hits.t[:count], 1e-30)
            now.state.width[:count] = 0.0
        else:
            now.state.spread[:count] = 0.0
        self.first, self.count = first, count
        self.hit = triangles, hits.u[triangles], hits.v[triangles]
        hits.u[triangles], hits.v[triangles] = self.place[triangles].T
        self.clear[:count] = UNKNOWN
        self.clear[self.masked] = self.stage.shader.transparency_at(
            now.rays, now.state, hits, frame, self.masked
        )
        n = self.meet(self.tile, now, then, count, 0)
        if space.textures is not None:
            slopes_in_image(
                image.view, image.camera.camera_from_world, f, first_, self.own_slopes, np.float64(space.cell), n_,
                space.textures,
            )  # fmt: skip
        then.slot[:n] += base
        self.leave(then, n, base, count)
        self.samples = self.every
        self.held += count
        self.pieces.append((first, base, count))
        self.fresh.take(then, self.waiting_cones(), n, 1)
        while self.fresh.count > self.together:
            self._follow_pool(self.fresh, FEW, self.together)

    def leave(self, then, n: int, base: int, count: int) -> None:
        """Paths 0..n go on from `count` first surfaces, whose samples begin at `base`: a place to tell them apart."""

    def waiting_cones(self):
        """LobeCones of the paths that go on, or None."""
        return None

    def _follow_pool(self, pool: PathPool, few: int, most: int | None = None) -> None:
        now, then = self.queues
        n, bounce = pool.give(now, self.waiting_cones(), most)
        self._follow(now, then, n, bounce, few)

    def _follow(self, now, then, n: int, bounce: int, few: int) -> None:
        """Move the paths 0..n of `now` on, from surface to surface, until at most `few` are left: these wait.

        Not at the first bounce, whose cones are not those of the others.
        """
        while n > (few if bounce > 1 else 0):
            n = self._bounce(self.tile, now, then, n, bounce)
            now, then = then, now
            bounce += 1
        if n:
            self.tail.take(now, self.waiting_cones(), n, bounce)
        if self.tail.count > MANY:
            self._follow_pool(self.tail, FEW)

    def _settle_paths(self) -> None:
        """Follow all paths to their ends, and give the fragments what they have brought."""
        self._follow_pool(self.fresh, FEW)
        self._follow_pool(self.tail, 0)
        for first, base, count in self.pieces:
            self.receive(first, base, count)
        self._forget()

    def receive(self, first: int, base: int, count: int) -> None:
        """Give the fragments first..first + count what the samples from `base` on have found."""
        space, held = self.space, self.every.transparency[base : base + count]
        light = self.every.radiance[base : base + count]
        if not np.isfinite(light.sum()):  # one would spoil all pixels about it
            np.nan_to_num(light, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        space.light[first : first + count] = light
        if held.any():
            if space.held is None:
                space.held = np.zeros(len(space.light), np.float32)
            space.held[first : first + count] = np.minimum(held, 1.0)

    def finish_tile(self, count: int) -> None:
        """Radiance of the tile's fragments 0..count, which have all been traced, to space.light."""
        self._settle_paths()

    def _look_at_clumps(self, space, hierarchy, now, first: int, rows: np.ndarray) -> None:
        """Represent clumps by what the camera sees of them: the first surface behind a subpixel that shows each.

        A piece's own representative may be hidden in it, or seen from its edge, and lie in another light than what is
        seen. One that is drawn with gaps is not looked through besides.
        """
        if not len(rows):
            return
        hits, frame, camera_rays = self.hits, self.frames, now.rays
        rays, seen = allocate_rays(len(rows)), allocate_hits(len(rows))
        space.look(first, rows, camera_rays.direction, rays)
        rays.visibility[:] = CAMERA
        rays.skip_triangle[:] = -1
        space.end_looks(hierarchy, first, rows, hits, rays)
        self._look(now, rows, rays, seen)
        passed = np.flatnonzero((seen.triangle < 0) & np.isfinite(rays.t_max))
        if len(passed):
            again, met = Rays(*(a[passed] for a in rays)), allocate_hits(len(passed))
            aim_at_points(frame.position, rows[passed], camera_rays.direction, again)
            self._look(now, rows[passed], again, met)
            for target, values in zip(seen, met, strict=True):
                target[passed] = values
        self.counters["clump_rays"] += len(rows) + len(passed)
        found = np.flatnonzero(seen.triangle >= 0)
        if not len(found):
            return
        at = rows[found]
        for target, values in zip(hits, seen, strict=True):
            target[at] = values[found]
        sub_frames(self.stage.shader.geometry, camera_rays, hits, at, frame)

    def _look(self, now, rows: np.ndarray, rays, seen) -> None:
        """First surfaces that the rays meet, and do not pass by chance as they are transparent, to `seen`."""
        stage, todo = self.stage, np.arange(len(rows))
        for veil in range(VEILS):
            part, met = Rays(*(a[todo] for a in rays)), allocate_hits(len(todo))
            walk.intersect(stage.acceleration, part, met)
            for target, values in zip(seen, met, strict=True):
                target[todo] = values
            hit = np.flatnonzero(met.triangle >= 0)
            if not stage.needs.transparent_shadows or not len(hit):
                return
            surface = allocate_frames(len(todo))
            frames(stage.shader.geometry, part, met, surface)
            state = RayState(*(a[rows[todo]] for a in now.state[:-1]), now.state.camera_from_world)
            state.width[:] = 0.0  # unfiltered, as shadow rays pass (integrator._pass_through)
            state.spread[:] = 0.0
            clear = stage.shader.transparency_at(part, state, met, surface, hit).mean(1)
            slot = now.slot[rows[todo[hit]]]
            chance = np.empty(len(hit))
            fill_chances(stage.tables, self.samples.seed, self.samples.number, slot, np.int64(veil), chance)
            passes = hit[clear > chance]
            todo = todo[passes]
            if not len(todo):
                return
            rays.t_min[todo] = met.t[passes] + surface.offset[passes]
            rays.skip_triangle[todo], rays.skip_path[todo] = met.triangle[passes], met.path[passes]

    def _widen_by_normals(self, n: int, keep: bool) -> None:
        """`lobe_light.widen_by_normals` of points 0..n."""
        tables = self.stage.shader.tables
        widen_by_normals(self.lobes, self.spread, self.alpha, self.view.incoming, tables, keep, np.int64(n))

    def shaded(self, now, n: int, bounce: int) -> None:
        if bounce == 0:
            triangles, self.hits.u[triangles], self.hits.v[triangles] = self.hit
            # what their rays meet is not averaged besides
            now.state.width[self.masked] *= NARROW
            now.state.spread[self.masked] *= NARROW
            self._widen_by_normals(n, True)
            close_transparency(
                self.lobes,
                now.throughput,
                self.coloured,
                self.by_view,
                self.let_pass,
                self.clear,
                np.int64(n),
            )
