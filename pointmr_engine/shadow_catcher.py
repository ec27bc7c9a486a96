"""Pictures with shadow catchers: rendered as three, of one compiled scene, and put together as Cycles does."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from pointmr_engine.scene.catchers import ALONE, CAUGHT, OBJECTS, decide
from pointmr_engine.scene.group import Group, Instances
from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.settings import RenderSettings

PICTURES = (OBJECTS, CAUGHT, ALONE)


def render(
    scene: Scene, compiled, deciding: list[Instances], settings: RenderSettings, clock, picture, compile_scene
):
    """(frame, counters, needs) of a scene with catchers; passes other than the combined one are those of the objects.

    compiled: render.Compiled of the scene, whose root is of `catchers.separate`, as `deciding`. clock: render's;
    picture(scene, compiled, settings, clock) renders one picture, and compile_scene(scene, settings) prepares another
    scene.
    """
    clock.pictures = len(PICTURES) + (not settings.film_transparent)
    frames, counted, needs = [], Counter(), {}
    for which in PICTURES:
        clock.picture = which
        lit = scene_of(scene, which)
        seen = seen_in(compiled, lit, deciding, which)
        frame, counters, own_needs = picture(lit, seen, settings_of(settings, which), clock)
        frames.append(frame)
        counted.update(counters)
        needs = needs or own_needs
    behind = None
    if not settings.film_transparent:
        clock.picture = len(frames)
        empty = Scene(Group("nothing"), scene.camera, [], scene.world)
        plain = replace(settings, passes=("combined",))
        behind = picture(empty, compile_scene(empty, plain), plain, clock)[0].passes["combined"]
    result = frames[0]
    result.passes["combined"] = combine(*(frame.passes["combined"] for frame in frames), behind)
    clock.picture, clock.pictures = 0, 1
    return result, counted, needs


def scene_of(scene: Scene, picture: int) -> Scene:
    """The scene with the lamps of a picture: catchers alone are lit by those only that are theirs."""
    if picture == ALONE:
        return replace(scene, lights=[lamp for lamp in scene.lights if lamp.lights_catchers])
    return scene


def settings_of(settings: RenderSettings, picture: int) -> RenderSettings:
    """Of the objects, all passes; of catchers their light and how much of a pixel they cover."""
    passes = settings.passes if picture == OBJECTS else ("combined",)
    forward = settings.forward
    if picture == ALONE:  # shadow maps show all that the camera may see
        forward = replace(forward, shadows=False)
    return replace(settings, film_transparent=True, passes=passes, forward=forward)


def seen_in(compiled, scene: Scene, deciding: list[Instances], picture: int):
    """A compiled scene (render.Compiled) as it is seen in a picture. Triangles, hierarchies and samples are shared.

    deciding: of `catchers.separate`, whose root was compiled.
    """
    bits = decide(deciding, picture)
    geometry = compiled.geometry
    batches = [replace(b, visibility=bits[id(b)]) if id(b) in bits else b for b in geometry.batches]
    values = geometry.instances.visibility_values.copy()
    for (first, stride), batch in zip(geometry.instances.visibility, batches, strict=True):
        if first >= 0:
            end = first + (len(batch.visibility) if stride else 1)
            values[first:end] = batch.visibility[: end - first]
    tables = geometry.instances._replace(visibility_values=values)
    geometry = replace(geometry, batches=batches, instances=tables)
    acceleration, lights, sampler = None, compiled.lights, None
    if compiled.acceleration is not None:
        from pointmr_engine.hierarchy.acceleration import Acceleration
        from pointmr_engine.raytracing.lights import build_lights

        old = compiled.acceleration
        acceleration = Acceleration(geometry, old.arrays._replace(instances=tables), old.warnings)
        if picture == ALONE:  # else nothing that shines is hidden from what it lights
            lights = build_lights(scene, geometry, compiled.programs, compiled.lights.environment)
    if compiled.sampler is not None:
        sampler = compiled.sampler.of_geometry(geometry)
    return compiled._replace(geometry=geometry, acceleration=acceleration, lights=lights, sampler=sampler)


def combine(
    objects: np.ndarray, caught: np.ndarray, alone: np.ndarray, behind: np.ndarray | None
) -> np.ndarray:
    """(H, W, 4) float32 premultiplied: objects over what catchers add of shadow.

    objects, caught, alone (H, W, 4), premultiplied, before a transparent film; behind (H, W, 3): what an opaque film
    shows there, None: the film is transparent, and shadows are black of an opacity. That is 1 less the mean of what is
    left of the catchers' light (Cycles: film_calculate_shadow_catcher).
    """
    light, full = caught[..., :3].astype(np.float64), alone[..., :3].astype(np.float64)
    share = np.clip(caught[..., 3:].astype(np.float64), 0.0, 1.0)
    lit = full > 0.0
    left = np.divide(light, full, out=np.zeros_like(light), where=lit)
    count = lit.sum(-1, keepdims=True)
    grey = np.divide(left.sum(-1, keepdims=True), count, out=np.ones_like(share), where=count > 0)
    left = np.where(lit, left, grey)  # a channel without light is as dark as the others
    opacity = np.clip(objects[..., 3:].astype(np.float64), 0.0, 1.0)
    covered = np.where(share > 0.0, np.minimum(opacity + share, 1.0), 0.0)
    left = (1.0 - covered) + covered * left
    alpha = opacity + (1.0 - opacity) * (1.0 - np.clip(left.mean(-1, keepdims=True), 0.0, 1.0))
    colour = objects[..., :3].astype(np.float64)
    if behind is not None:
        colour = colour + (1.0 - alpha) * behind[..., :3]
        alpha = np.ones_like(alpha)
    return np.concatenate((colour, alpha), -1).astype(np.float32)
