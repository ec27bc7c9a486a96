"""Scenes drawn at random from a seed, called random_SEED: what no list of features thinks of.

    python -m benchmarks.overlay --scenes random_1-40 --method raytrace --samples 4 --no-write

A seed's scene changes when these modules do.
"""

from __future__ import annotations

import inspect
import re
from random import Random

SIZE = (128, 96)
NAME = re.compile(r"random_(\d+)(?:-(\d+))?")


def expand(name: str) -> list[str]:
    """["random_3", "random_4"] of "random_3-4", [] of what names no random scene."""
    found = NAME.fullmatch(name)
    if not found:
        return []
    first, last = int(found[1]), int(found[2] or found[1])
    return [f"random_{seed}" for seed in range(first, last + 1)]


def build(seed: int) -> None:
    """Fill bpy's scene with what the seed draws."""
    import bpy

    from benchmarks.features import stage
    from benchmarks.random_scenes import lighting, objects, shaders

    dice = Random(seed)
    stage.empty_scene()
    objects.objects(shaders.materials(dice), dice)
    lighting.lamps(dice)
    lighting.world(dice)
    lighting.camera(dice)
    bpy.context.scene.frame_set(dice.randint(1, objects.LAST_FRAME))


def source(name: str):
    """The random scene as a Source of the judge."""
    from benchmarks.features import stage
    from benchmarks.random_scenes import lighting, objects, shaders
    from benchmarks.sources import Source, text_hash

    seed = int(NAME.fullmatch(name)[1])
    content = text_hash(seed, *map(inspect.getsource, (build, lighting, objects, shaders, stage)))
    return Source(name, lambda: build(seed), content, SIZE, kind="random")
