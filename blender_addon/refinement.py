"""Which pictures a viewport asks for, one after the other: a first one at once, then better ones, then their mean.

A schedule is a generator: it yields Steps and is sent the seconds that the last one took.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import replace
from typing import NamedTuple

COARSEST = 4  # pixels of the first picture are at most this wide
SMOOTH_SECONDS = 0.15  # a first picture that comes within this time needs no coarser one before it
PATIENT_SECONDS = 1.0  # a picture that takes longer is preceded by one of half its resolution
LONGEST_BATCH = 16  # rays per pixel and pass, so that refinement stays visible
# samples per pixel of forward mapping's passes
FORWARD_FIRST, FORWARD_SECOND, FORWARD_FINEST = 0.25, 1.0, 4.0
CONES = (1, 4, 16, 64)  # of raytracing's


class Step(NamedTuple):
    """One picture: pixels `scale` screen pixels wide; samples (or cones) per pixel; whether it is averaged with others
    such; whether forward mapping makes it for another method.
    """

    scale: int
    samples: float
    averaged: bool
    sketched: bool = False


Schedule = Generator[Step, float, None]


def ray_steps(total: int, pixel_size: int) -> Schedule:
    """Coarse pixels, finer ones, then batches of `total` samples per pixel."""
    scale = max(COARSEST, pixel_size)
    while scale > pixel_size:
        seconds = yield Step(scale, 1, False)
        # each finer step costs four times as much: go straight to full pixels where that is quick
        scale = pixel_size if 4 * seconds < SMOOTH_SECONDS else max(scale // 2, pixel_size)
    done = 0
    while done < total:
        count = min(max(done, 1), LONGEST_BATCH, total - done)
        yield Step(pixel_size, count, True)
        done += count


class ForwardPace:
    """Remembers, from view to view of one scene, how long forward mapping takes for a first picture."""

    def __init__(self):
        self._seconds = math.inf  # for one of full pixels
        self._scene = None

    def steps(self, scene, forward, total: int, pixel_size: int) -> Schedule:
        """A first picture of few samples, of full pixels if these were quick before; a better one; then the best.

        forward: the engine's ForwardSettings. Dynamic samples are others in each pass: their mean over `total` samples
        per pixel is the best picture. Static ones are the same for all seeds: one pass, as dense as the final image.
        """
        scale, seconds = yield from self._first(scene, pixel_size, sketched=False)
        while scale // 2 > pixel_size and seconds * (scale / pixel_size) ** 2 > PATIENT_SECONDS:
            scale //= 2
            seconds = yield Step(scale, FORWARD_SECOND, False)
        if total > FORWARD_SECOND:
            seconds = yield Step(pixel_size, FORWARD_SECOND, False)
            self._seconds = min(self._seconds, seconds)
        if forward.sampling == "static":
            passes, samples = 1, min(total, max(forward.samples_per_pixel, FORWARD_FINEST))
        else:
            passes = math.ceil(total / FORWARD_FINEST)
            samples = total / passes
        for _ in range(passes):
            yield Step(pixel_size, samples, True)

    def sketched_steps(self, scene, cones: int, pixel_size: int) -> Schedule:
        """For method raytrace: a first picture by forward mapping; then one cone a pixel, and ever more up to `cones`.

        Each picture of more cones is better than the mean of all that came before: none is averaged.
        """
        scale, _ = yield from self._first(scene, pixel_size, sketched=True)
        if scale > 2 * pixel_size:  # forward mapping was slow, so cones are slower still
            yield Step(2 * pixel_size, 1, False)
        for count in CONES:
            if count <= cones:
                yield Step(pixel_size, count, count == cones)

    def _first(self, scene, pixel_size: int, sketched: bool) -> Generator[Step, float, tuple[int, float]]:
        """A first picture, of full pixels if those of the same scene were quick; returns its scale and seconds."""
        known, coarse = scene is self._scene, max(COARSEST, pixel_size)
        scale = pixel_size
        while scale < coarse and not self._seconds * (pixel_size / scale) ** 2 < SMOOTH_SECONDS:
            scale = min(2 * scale, coarse)
        seconds = yield Step(scale, FORWARD_FIRST, False, sketched)
        if known:
            self._learn(seconds, scale, pixel_size)
        else:  # which also built its hierarchies
            self._scene, self._seconds = scene, math.inf
        return scale, seconds

    def _learn(self, seconds: float, scale: int, pixel_size: int) -> None:
        if scale == pixel_size:
            self._seconds = seconds
        else:  # part of the time does not depend on the pixels, so this is at most
            self._seconds = min(self._seconds, seconds * (scale / pixel_size) ** 2)


def with_samples(settings, step: Step, number: int):
    """The engine's settings for the pass of this number, with the step's samples per pixel."""
    settings = replace(settings, seed=settings.seed + 1000003 * number)
    if step.sketched:
        forward = replace(
            settings.forward,
            sampling="static",
            reconstruction="subpixel",
            subpixels=2,
            shading="simple",
            shadows=False,
            cache_folder=settings.raytrace.cache_folder,
        )
        settings = replace(settings, method="forward", forward=forward)
    if settings.method == "forward":
        return replace(settings, forward=replace(settings.forward, samples_per_pixel=step.samples))
    if settings.method == "raytrace":
        return replace(settings, raytrace=replace(settings.raytrace, cones=int(step.samples)))
    return replace(settings, samples=int(step.samples))
