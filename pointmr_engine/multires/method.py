"""Multi-resolution raytracing as a method: primary cones walk the hierarchy together, tile by tile; what they see is
merged into surfaces, and each of those sends its own cones on.

The primary cones of a tile resolve visibility per subpixel, 8 x 8 of them in a cone, from samples a sixth of a
footprint apart (forward/selection/walk.py): the hierarchy is walked once for all of them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pointmr_engine.forward.baked.baking import materials_of
from pointmr_engine.forward.method import Image
from pointmr_engine.forward.reconstruction.pixel_filter import Slopes, allocate_slopes
from pointmr_engine.forward.shading.fragment_surfaces import NO_EYES
from pointmr_engine.forward.tiles import Workspace
from pointmr_engine.multires.cone_light import ConeLight
from pointmr_engine.multires.cones.opacity_micromap import with_micromap
from pointmr_engine.multires.fragments.looks import look_where_seen
from pointmr_engine.multires.fragments.merge import choose_seen, merge_fragments, renumber, thin_margin
from pointmr_engine.multires.fragments.representatives import (
    bring_forward,
    choose_representatives,
    lend_light,
)
from pointmr_engine.multires.fragments.slopes import COLUMNS, find_slopes
from pointmr_engine.multires.fragments.texture_slopes import take_texture_slopes
from pointmr_engine.multires.paths.cone_paths import ConePaths
from pointmr_engine.multires.paths.fragment_paths import BATCH, FragmentPaths
from pointmr_engine.multires.sharing.light_sharing import REACH
from pointmr_engine.raytracing.integrator import Stage
from pointmr_engine.scene.settings import ForwardSettings, RenderSettings

SUBPIXELS = 8  # per side of a cone
WIDTH = 96  # cones per side of a tile with its margins: larger ones shade less twice, and take more memory
CELL = 4  # subpixels per side of the part of a cone in which fragments merge
# samples per cone's footprint. By alpha, surfels' Gaussians are wider than their spacing already
DENSITY, DENSITY_OF_ALPHA = 32.0, 4.0
FRAGMENTS = 4  # of a cone, about: what one ray of a fragment's lobes stands for


def primary_settings(settings: RenderSettings, alpha: bool) -> RenderSettings:
    """The same settings with the forward mapping of the primary cones; alpha: a subpixel is a whole cell."""
    chosen = settings.raytrace
    side = math.isqrt(chosen.cones)
    forward = ForwardSettings(
        subpixels=(SUBPIXELS // CELL if alpha else SUBPIXELS) * side,
        samples_per_pixel=(DENSITY_OF_ALPHA if alpha else DENSITY) * chosen.cones / chosen.footprint**2,
        shadows=False,
        cache_folder=chosen.cache_folder,
    )
    return replace(settings, forward=forward)


class TracedImage(Image):
    """One image of method "raytrace": everything that its tiles share."""

    def __init__(self, sampler, scene, stage: Stage, settings: RenderSettings):
        if stage.needs.transparent_shadows:
            stage = replace(stage, acceleration=with_micromap(stage.acceleration, sampler))
        side = math.isqrt(settings.raytrace.cones)
        self.stage = stage = replace(stage, shader=stage.shader.narrowed(side * SUBPIXELS / CELL))
        self.light = ConeLight(scene, sampler, stage) if settings.raytrace.secondary == "cones" else None
        alpha = settings.raytrace.visibility == "alpha"
        if alpha and stage.needs.lens:
            alpha = False
            self.warnings = ["visibility by alpha knows no depth of field: subpixel masks are used instead"]
        super().__init__(sampler, scene, stage.camera, primary_settings(settings, alpha))
        # pixels about the tile that its own share light with: taps of no weight
        self.beside = math.ceil(REACH / side) if self.light is not None and self.light.shares else 0
        self.taps = np.pad(self.taps, self.beside * self.subpixels)
        self.apron += self.beside
        self.cone = self.subpixels // side  # subpixels per side of a cone
        self.footprint = self.pixel / side * CELL / SUBPIXELS  # of the parts of cones that are shaded
        self.hardly = 0.0
        # of materials, and of none
        self.shining = stage.lights.shining(len(sampler.geometry.materials) + 1)
        self.tile = max(WIDTH // side - 2 * self.apron, 2)
        self.space_of = TracedTiles
        self.views: list = []  # from points of the lens (multires.lens.lens.LensView); none: a pinhole is enough
        if stage.needs.lens:
            from pointmr_engine.multires.lens.lens_tiles import split_lens

            split_lens(self)
        if alpha:
            from pointmr_engine.multires.alpha.alpha_tiles import use_alpha

            use_alpha(self)

    def choose_shading(self):
        return TracedShading(self)

    def choose_cut_outs(self):
        """Colours pass by rays, but where the film wants one opacity of all."""
        self.coloured = not self.settings.film_transparent
        return self.sampler.densest_cut_outs if self.coloured else super().choose_cut_outs()

    @property
    def fits(self) -> tuple:
        return *super().fits, self.space_of.__name__, len(self.views)

    def needs(self) -> dict:
        return super().needs() | {
            "lens": self.stage.needs.lens,
            "lens_views": max(len(self.views), 1),
            "prefiltered_points": self.sampler.prefiltered is not None,
        }


class TracedShading:
    """Light of fragments by paths that go on from them. Threads may share it."""

    def __init__(self, image: TracedImage):
        self.image = image

    def shade(self, space: TracedTiles, hierarchy, count: int) -> None:
        """Fill space.light[:count]; see forward.shading.materials.FullShading."""
        paths, values = self.paths(space), space.placement_values(hierarchy)
        paths.start_tile(space, count)
        for first in range(0, count, BATCH):
            paths.trace(hierarchy, values, first, min(BATCH, count - first))
        paths.finish_tile(count)
        space.lend(count)

    def paths(self, space: TracedTiles) -> FragmentPaths:
        """The thread's paths, made when it first shades."""
        if space.shading is None:
            image = self.image
            light = image.light
            space.shading = FragmentPaths(image.stage) if light is None else ConePaths(image.stage, light)
        return space.shading


class TracedTiles(Workspace):
    """One thread's buffers for tiles."""

    def __init__(self, image: TracedImage):
        super().__init__(image)
        n = len(self.fragments.entry)
        self.into, self.largest = np.empty(n, np.int32), np.empty(n, np.int32)
        self.seen = np.empty((n, 2), np.float32)
        # of all fragments, of which there are `all`, the one that each has its light from
        self.stands, self.all = np.empty(n, np.int32), 0
        # in parts of the light of those that are shaded; None: not asked for
        self.textures = allocate_slopes(n)
        self.eyes = NO_EYES  # that see the fragments
        side = len(self.target.ids) // image.subpixels + 1
        self.used = np.zeros((side, side), np.int32)

    @staticmethod
    def cell_of(image) -> int:
        return CELL

    def look(self, first: int, rows: np.ndarray, direction: np.ndarray, rays) -> None:
        """Aim rays at fragments first + rows, through places of the image that show them: looks.look_where_seen."""
        image = self.image
        look_where_seen(
            image.view, np.int64(self.left), np.int64(self.low), image.camera.world_from_camera, self.fragments,
            np.int64(first), rows, self.seen, direction, rays,
        )  # fmt: skip

    def lend(self, count: int) -> None:
        """Give the fragments behind the first `count` the light of those that stand for them."""
        lend_light(self.light, self.stands, np.int64(count), np.int64(self.all))
        if self.held is not None:
            self.held[count : self.all] = self.held[self.stands[count : self.all]]

    def _slopes(self, count: int) -> Slopes:
        image, shaded, count = self.image, count, max(count, self.all)
        sums, slopes = np.empty((count, COLUMNS), np.float32), allocate_slopes(count)
        find_slopes(
            self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(self.cell),
            image.view.perspective, np.float64(image.footprint), self.fragments, self.light, np.int64(count), sums,
            slopes,
        )  # fmt: skip
        take_texture_slopes(self.textures, self.light, np.int64(shaded), slopes)
        return slopes

    def _fragments(self, hierarchy) -> int:
        count = super()._fragments(hierarchy)
        image = self.image
        merged = merge_fragments(
            self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(self.cell),
            image.view.perspective, np.float64(image.footprint), self.fragments, np.int64(count), self.into,
            self.largest,
        )  # fmt: skip
        if image.beside:
            merged = thin_margin(
                self.target.ids, np.int64(self.width), np.int64(self.height),
                np.int64(image.beside * image.subpixels), np.int64(image.cone), self.fragments, np.int64(merged),
                self.into, self.largest,
            )  # fmt: skip
        shaded = self._stand_in(hierarchy, merged)
        choose_seen(
            self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(self.left), np.int64(self.low),
            self.target.shift, np.int64(merged), self.largest, self.seen,
        )  # fmt: skip
        return shaded

    def _stand_in(self, hierarchy, count: int) -> int:
        """Put the fragments that are to be shaded before those that borrow their light; returns how many."""
        self.all = count
        f, material = self.fragments, np.empty(count, np.int32)
        materials_of(hierarchy.parts, f.part[:count], f.triangle[:count], material)
        shape = self.height // self.cell, self.width // self.cell
        choose_representatives(
            f, np.int64(count), self.image.shining[material], np.int64(self.cell), shape, np.int64(self.left),
            np.int64(self.low), np.int64(self.image.settings.seed), self.stands,
        )  # fmt: skip
        shaded = bring_forward(f, np.int64(count), self.stands, self.into, self.largest)
        renumber(self.target.ids, np.int64(self.width), np.int64(self.height), self.into)
        return shaded
