"""Images by dynamic sampling: every tile draws new random points, and where pixels are missing, more of them.

Triangles that would need many points are drawn as they are, points are small discs in the planes of their triangles,
and both go through the tile's depth buffer (talk: "Dynamic Sampling", "Image Reconstruction").
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.reconstruction.holes import holes
from pointmr_engine.forward.selection.dynamic import PointScratch, sample_tile
from pointmr_engine.forward.selection.point_draws import Draws, World
from pointmr_engine.forward.selection.sample_count import hole_probability, points_per_pixel
from pointmr_engine.forward.tiles import Workspace

AGAIN = 2  # times that missing pixels are sampled again at most: many are gaps that the scene has
KEPT = 0.3  # points: what expects more is drawn as a triangle: half the error of 1.0 in a forest, for a fifth more time
COVER = 2.5  # area of all discs over that of the surface: a share of e^-2.5 of random ones would stay open
WIDE = 8.0  # pixels: larger boxes are not sampled as a whole where hidden ones are left out
TINY = 0.5  # pixels: smaller boxes are, whatever their depths, ...
TINY_AREA = 1.0  # ... for so many pixels at most, however much surface is folded into them


def make_draws(options, subpixels: int, pixels: float) -> Draws:
    """How an image of so many pixels is sampled under ForwardSettings; subpixels: per side of a pixel."""
    area = pixels * max(options.samples_per_pixel, 1.0)
    density = options.samples_per_pixel * points_per_pixel(options.draws, area, options.failure)
    # as if four points a sample were seen: more of them are, which closes the gaps that chance leaves
    seen = min(density, 4.0 * options.samples_per_pixel)
    radius = subpixels * math.sqrt(COVER / (math.pi * seen))
    if options.reconstruction == "pixel" and options.samples_per_pixel >= 1.0:
        radius = 0.0  # the pixel that a point lies in is all that it shows
    wide = WIDE * subpixels if options.occlusion_culling else math.inf
    return Draws(
        density / subpixels**2, 1.0 + options.epsilon, KEPT, wide, TINY * subpixels, TINY_AREA * density,
        radius, options.draws == "stratified", options.backface_culling,
    )  # fmt: skip


class PointSpace(Workspace):
    """One thread's buffers for tiles of random points."""

    def __init__(self, image):
        super().__init__(image)
        self.scratch = PointScratch(self.target, image.sampler.geometry.depth)

    def begin(self, image) -> None:
        """Turn to another image, for which these buffers fit (method.Image.fits)."""
        super().begin(image)
        x0, y0, x1, y1 = image.region
        self.how = make_draws(image.settings.forward, image.subpixels, (x1 - x0) * (y1 - y0))
        self.missed = hole_probability(image.settings.forward.draws, self.how.density * image.subpixels**2)
        self.holes = self.drawn_again = 0

    def counts(self) -> dict:
        """Counters of the tiles drawn."""
        return super().counts() | {"holes": self.holes, "drawn_again": self.drawn_again}

    def draw(self, bounds, hierarchy) -> None:
        """Draw a tile x0, y0, x1, y1 of pixels."""
        self.start_tile(bounds)
        self._sample(hierarchy, 0)
        image, apron = self.image, self.image.apron
        for k in range(AGAIN):
            missing = holes(self._nearness(), image.view, image.subpixels)
            if k == 0:
                inner = missing[apron : missing.shape[0] - apron, apron : missing.shape[1] - apron]
                self.holes += int(inner.sum())
            # gaps of the scene, but for less than the probability of a hole that is allowed to the whole image
            if missing.sum() * self.missed <= image.settings.forward.failure:
                break
            if not self._sample_again(hierarchy, missing, k + 1):
                break

    def _nearness(self) -> np.ndarray:
        """(rows, columns) float32 of the tile's pixels: the nearest that their subpixels show, 0: nothing."""
        s = self.image.subpixels
        depth = self.target.depth[: self.height, : self.width]
        return depth.reshape(self.height // s, s, self.width // s, s).max((1, 3))

    def _sample(self, hierarchy, turn: int) -> None:
        image = self.image
        world = World(
            hierarchy.octree, image.sampler.distribution, hierarchy.corners, hierarchy.parts, hierarchy.instances,
            hierarchy.cut_outs,
        )  # fmt: skip
        self.entries = sample_tile(
            image.view, world, image.camera.camera_from_world, self.how,
            image.settings.seed + (turn << 32),
            (self.left, self.low, self.left + self.width, self.low + self.height), self.scratch,
            image.settings.forward.occlusion_culling, image.subpixels, turn > 0,
        )  # fmt: skip

    def _sample_again(self, hierarchy, missing: np.ndarray, turn: int) -> bool:
        """Sample the pixels that are missing alone; returns whether anything new was seen."""
        target, s, entries, drawn = self.target, self.image.subpixels, self.entries, self._drawn()
        depth = target.depth[: self.height, : self.width]
        there = ~missing.repeat(s, 0).repeat(s, 1)
        kept = depth[there]
        depth[there] = np.inf
        target.stale.fill(1)
        target.farthest.fill(0.0)
        self._sample(hierarchy, turn)
        depth[there] = kept
        self.drawn_again += self._drawn() - drawn
        return self.entries > entries

    def _drawn(self) -> int:
        return int(self.scratch.counters[self.scratch.names.index("points_drawn")])
