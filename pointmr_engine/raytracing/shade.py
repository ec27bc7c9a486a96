"""Materials at hits: programs run per material over the whole queue, and their leaves become lobes."""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing.rays import Hits, Rays
from pointmr_engine.raytracing.surface import Frames, RayState, gather, told_by_hits
from pointmr_engine.scene.settings import RenderSettings
from pointmr_engine.shading import lobes as lobe_kernels
from pointmr_engine.shading.bsdf.layout import Lobes, View
from pointmr_engine.shading.bsdf.widening import filter_glossy, split_lobes, widen_lobes
from pointmr_engine.shading.compiler import Slot
from pointmr_engine.shading.footprint_mean import (
    OBLIQUE,
    POINT,
    SOME,
    Slopes,
    footprint_means,
    nearer_to_mean,
    normals_at_places,
    roughness_at_places,
    slope_variance,
    stretched_means,
    turns,
)
from pointmr_engine.shading.footprint_slopes import TextureSlopes, fill_slopes
from pointmr_engine.shading.leaf_plan import LeafPlan
from pointmr_engine.shading.points import RAY_CAMERA, RAY_DIFFUSE, RAY_SINGULAR
from pointmr_engine.shading.program import Program
from pointmr_engine.shading.values import dot


def allocate_view(n: int) -> View:
    """Room for n views."""
    return View(
        np.zeros((n, 3), np.float32),
        np.zeros((n, 3), np.float32),
        np.zeros((n, 3), np.float32),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
    )


@uncounted
def fill_view(rays: Rays, kind, frames: Frames, out: View, n):
    """How rays 0..n see the surfaces that they hit: normals turned to the viewer's side."""
    for k in range(n):
        if frames.material[k] < 0:
            continue
        sign = np.float32(-1) if frames.backfacing[k] else np.float32(1)
        for a in range(3):
            out.incoming[k, a] = -rays.direction[k, a]
            out.normal[k, a] = sign * frames.smooth_normal[k, a]
            out.geometric_normal[k, a] = sign * frames.geometric_normal[k, a]
        out.backfacing[k] = frames.backfacing[k]
        out.diffuse_ray[k] = (kind[k] & RAY_DIFFUSE) != 0


@njit(cache=True, nogil=True, error_model="numpy")
def rows_by_material(material, wanted, n, materials, order):
    """Sort the wanted rows of 0..n by material into `order`; returns where each one's rows start (materials + 1,)."""
    start = np.zeros(materials + 1, np.int64)
    for k in range(n):
        if wanted[k]:
            start[material[k] + 1] += 1
    for m in range(materials):
        start[m + 1] += start[m]
    place = start.copy()
    for k in range(n):
        if wanted[k]:
            m = material[k]
            order[place[m]] = k
            place[m] += 1
    return start


def _without_lobes(state: RayState, n: int) -> RayState:
    """The state of rays 0..n, those that stand for a part of a lobe as narrow as lines.

    For surfaces that light passes: what materials make of a mean of their images is not the mean of what they let
    through, and where lobes are wide, that is off by half.
    """
    wide = (state.kind[:n] & (RAY_CAMERA | RAY_SINGULAR)) == 0
    if not wide.any():
        return state
    width, spread = (np.where(wide, np.float32(0), a[:n]) for a in (state.width, state.spread))
    return state._replace(width=width, spread=spread)


class Means(NamedTuple):
    """Textures of a batch, averaged over footprints."""

    values: list[tuple[np.ndarray, dict]]  # for program.fill_leaves
    slopes: Slopes | None  # of fine textures
    seen: np.ndarray | None  # (n,) int64 of points whose lobes are split ...
    rough: dict  # ... into two: footprint_mean.two_values (3, n) of roughnesses, by name
    rows: np.ndarray | None  # (n,) int64 of points whose lobes are widened ...
    variances: dict  # ... by these variances of slopes, (n,) float32: by the names of the lobes' normals


NO_MEANS = Means([], None, None, {}, None, {})


def _variances_of(plan: LeafPlan, means: Means) -> tuple[np.ndarray, np.ndarray]:
    """Of means.rows, by what slopes vary below a leaf's lobes, and below its coat."""
    none = np.zeros(len(means.rows), np.float32)

    def of(name: str) -> np.ndarray:
        source = plan.normals.get(name)
        return means.variances.get((source.step, source.output), none) if isinstance(source, Slot) else none

    return of("normal"), of("coat_normal")


# variance of slopes in a footprint, up to which a lobe about their mean stands for them. By what they vary besides, one
# place's normal differs from it: bumps have not the tails of such a lobe, in which small lamps would shine far and wide
GENTLE = 0.005
# ... from which on one place's normal stands for all: they lie in every direction, and hide and miss light as they do
STEEPEST = 0.2


class Shader:
    """The scene's materials as compiled programs. Threads may share it."""

    def __init__(self, geometry: Geometry, programs: list[Program], settings: RenderSettings, tables):
        self.geometry = geometry
        self.programs = programs
        self.tables = tables
        self.reflective = settings.caustics_reflective
        self.refractive = settings.caustics_refractive
        self.filter_glossy = settings.filter_glossy
        self.seed = settings.seed
        self.footprints = 1.0  # of rays, to the width of a pixel
        self.bump_correction = [m is None or m.bump_method != "NONE" for m in geometry.materials]
        # materials that add nothing to a path that may not scatter again
        self.dull = np.array([p.opaque and not p.emissive for p in programs] + [True], np.bool_)
        # `transparency_at` reads neither rays nor frames, but for materials
        self.plain_veils = all(told_by_hits(p.transparency_needs) for p in programs)

    def narrowed(self, footprints: float) -> Shader:
        """The same for rays of which so many footprints are as wide as a pixel."""
        shader = copy(self)
        shader.footprints = footprints
        return shader

    def _gather(self, rays, hits, frames, rows, needs, state):
        points = gather(self.geometry, rays, hits, frames, rows, needs, state)
        points.footprints = self.footprints
        return points

    def lobes_at(
        self,
        rays: Rays,
        state: RayState,
        hits: Hits,
        frames: Frames,
        view: View,
        wanted,
        n,
        order,
        out: Lobes,
        slopes: TextureSlopes | None = None,
        detail=None,
    ):
        """Fill the lobes of the wanted rows (n,) bool of 0..n; all others are emptied. slopes: of these rows, where
        textures change across footprints; what was known of others stays. detail (n,) uint8: at how many places
        of their footprints rows see textures (footprint_mean.EVERY, SOME, POINT); None: EVERY.
        """
        lobe_kernels.reset(out, View(*(a[:n] for a in view)))
        start = rows_by_material(frames.material, wanted, n, len(self.programs), order)
        unfiltered = None
        for m, program in enumerate(self.programs):
            rows = order[start[m] : start[m + 1]]
            if not len(rows):
                continue
            seen_by = state
            if not program.opaque:
                seen_by = unfiltered = unfiltered or _without_lobes(state, n)
            points = self._gather(rays, hits, frames, rows, program.needs, seen_by)
            means = self._means(program, rays, hits, frames, view, rows, seen_by, detail)
            values = program.values(points)
            leaves = program.fill_leaves(values, means.values)
            if slopes is not None and means.slopes is not None:
                fill_slopes(program, values, means.values, leaves, means.slopes, rows, slopes)
            for leaf, plan in zip(leaves, program.leaves, strict=True):
                before = out.count[rows] if means.rough or means.variances else None
                lobe_kernels.append(out, leaf, rows, view, self.tables, self.reflective, self.refractive)
                rough = plan.roughness if means.rough else None
                if isinstance(rough, Slot) and (rough.step, rough.output) in means.rough:
                    pairs = means.rough[rough.step, rough.output]
                    split_lobes(
                        out, rows[means.seen], before[means.seen], pairs, view.incoming, self.tables,
                        plan.distribution == "multi_ggx",
                    )  # fmt: skip
                if means.variances:
                    at = rows[means.rows]
                    tails = turns(frames.position[at], self.seed + 1)[0]
                    widen_lobes(out, at, before[means.rows], *_variances_of(plan, means), tails)
        if self.filter_glossy > 0.0:
            rows = np.flatnonzero(wanted[:n] & (state.density[:n] < self.filter_glossy))
            if len(rows):
                filter_glossy(out, rows, state.density[rows], self.filter_glossy)

    def _means(self, program: Program, rays, hits, frames, view, rows, state, detail) -> Means:
        """Textures averaged over the footprints of what is seen directly, in mirrors or through glass: fine ones,
        normals, and images where it is seen obliquely. detail: see lobes_at.
        """
        needs = program.fine_needs, program.rough_needs, program.normal_needs, program.image_needs
        if not any(needs):
            return NO_MEANS
        seen = (state.kind[rows] & (RAY_CAMERA | RAY_SINGULAR)) != 0
        seen &= (state.width[rows] > 0) | (state.spread[rows] > 0)
        if detail is not None:
            seen &= detail[rows] != POINT
        seen = np.flatnonzero(seen)
        if not len(seen):
            return NO_MEANS

        def points(needs: frozenset[str]):
            return lambda index: self._gather(rays, hits, frames, index, needs, state)

        means, slopes, variances, widened, rough = [], None, {}, None, {}
        if program.fine_needs:
            found, rough, slopes = footprint_means(
                program.fine_values,
                points(program.fine_needs),
                rows[seen],
                program.fine_reads,
                self.seed,
                None if detail is None else detail[rows[seen]] == SOME,
                program.rough_names,
            )
            means.append((seen, found))
        if program.rough_needs:
            rough |= roughness_at_places(
                program.rough_values, points(program.rough_needs), rows[seen], program.rough_reads, self.seed
            )
        if program.normal_needs:
            wide, normals = normals_at_places(
                program.normal_values,
                points(program.normal_needs),
                rows[seen],
                program.normal_reads,
                self.seed,
                program.normals_by_images,
            )
            widened, found = seen, {}
            for name, places in normals.items():
                whole = slope_variance(places.mean(0))
                variances[name] = np.where(whole <= STEEPEST, np.minimum(whole, GENTLE), np.float32(0))
                shared = variances[name] / np.maximum(whole, 1e-12)
                found[name] = nearer_to_mean(places, wide[name].mean(0), shared)
            means.append((seen, found))
        if program.image_needs:
            cosine = np.abs(dot(view.geometric_normal[rows[seen]], view.incoming[rows[seen]]))
            oblique = np.flatnonzero(cosine < OBLIQUE)
            if len(oblique):
                found = stretched_means(
                    program.image_values, points(program.image_needs), rows[seen[oblique]], program.image_reads,
                    cosine[oblique],
                )  # fmt: skip
                means.append((seen[oblique], found))
        slopes = slopes and slopes._replace(rows=seen[slopes.rows])
        return Means(means, slopes, seen, rough, widened, variances)

    def transparency_at(
        self, rays: Rays, state: RayState, hits: Hits, frames: Frames, rows: np.ndarray
    ) -> np.ndarray:
        """(len(rows), 3) float32: how much light the surfaces at `rows` let straight through."""
        share = np.zeros((len(rows), 3), np.float32)
        material = frames.material[rows]
        for m in np.unique(material):
            program = self.programs[m]
            if program.opaque:
                continue
            chosen = np.flatnonzero(material == m)
            needs = program.transparency_needs
            points = self._gather(rays, hits, frames, rows[chosen], needs, state)
            share[chosen] = program.transparency(points)
        return share
