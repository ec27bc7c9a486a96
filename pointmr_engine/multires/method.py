"""Multi-resolution raytracing as a method: primary cones walk the hierarchy together, tile by tile; what they see is
merged into surfaces, and each of those sends its own cones on.

The primary cones of a tile resolve visibility per subpixel, 8 x 8 of them in a cone, from samples a sixth of a
footprint apart (forward/selection/walk.py): the hierarchy is walked once for all of them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pointmr_engine.forward.method import Image
from pointmr_engine.multires.cone_light import ConeLight
from pointmr_engine.multires.cones.opacity_micromap import with_micromap
from pointmr_engine.multires.paths.cone_paths import ConePaths
from pointmr_engine.multires.paths.fragment_paths import FragmentPaths
from pointmr_engine.multires.sharing.light_sharing import REACH
from pointmr_engine.multires.tiles import CELL, TracedTiles
from pointmr_engine.raytracing.integrator import Stage
from pointmr_engine.scene.settings import ForwardSettings, RenderSettings

SUBPIXELS = 8  # per side of a cone
# a tile with its margins is so many cones wide, and so many times as wide as these, at least: larger ones shade less
# twice, and take more memory
WIDTH, MARGINS = 96, 6
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

    apart = coloured = True

    def __init__(self, sampler, scene, stage: Stage, settings: RenderSettings):
        if stage.needs.transparent_shadows:
            stage = replace(stage, acceleration=with_micromap(stage.acceleration, sampler))
        side = math.isqrt(settings.raytrace.cones)
        self.stage = stage = replace(stage, shader=stage.shader.narrowed(side * SUBPIXELS / CELL))
        self.light = ConeLight(sampler, stage) if settings.raytrace.secondary == "cones" else None
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
        self.masked = np.array([p.masked for p in sampler.programs], np.bool_)  # Program.masked, by material
        # of materials, and of none
        self.by_view = np.array([*(p.turns for p in sampler.programs), False], np.bool_)
        self.shining = stage.lights.shining(len(sampler.geometry.materials) + 1)
        margins = 2 * self.apron
        self.tile = max(WIDTH // side, MARGINS * margins) - margins
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
        for first in range(0, count, paths.batch):
            paths.trace(hierarchy, values, first, min(paths.batch, count - first))
        paths.finish_tile(count)
        space.lend(count)

    def paths(self, space: TracedTiles) -> FragmentPaths:
        """The thread's paths, made when it first shades."""
        if space.shading is None:
            image = self.image
            light = image.light
            space.shading = FragmentPaths(image.stage) if light is None else ConePaths(image.stage, light)
        return space.shading
