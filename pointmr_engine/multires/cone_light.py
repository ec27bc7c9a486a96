"""Which lights take cones, which take rays, and what the cones walk: `ConeLight`, which an image's threads share."""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import numpy as np

from pointmr_engine.forward.shading.varying_lamps import SplitLamps
from pointmr_engine.hierarchy.prefilter import prefilter
from pointmr_engine.multires.cones.cone_walk import visible
from pointmr_engine.multires.cones.cones import Cones
from pointmr_engine.multires.lens.lens import refracts, sharpest
from pointmr_engine.multires.sharing.world_rays import WORTH
from pointmr_engine.raytracing.compile_lamps import compile_lamps
from pointmr_engine.raytracing.emitter_search import leaves_haze, sampled_sides
from pointmr_engine.raytracing.integrator import Stage
from pointmr_engine.raytracing.lamps import CONE, DISTANT, POINT, SUN, TAN_SPREAD
from pointmr_engine.raytracing.lights import LAMP, WORLD, build_lights

# shadow rays of a fragment to the world, to emitters, to one of many lights
WORLD_RAYS, EMITTER_RAYS, MANY_RAYS = 4, 2, 4  # of a point; of first surfaces to the world: see world_rays
FEW = 2  # wide lamps take cones, and sharp ones a ray each, if there are no more of them
SHARP = 0.02  # half angle (rad) up to which a sun takes rays
# tangent of the half angle up to which an area light's spread makes its shadows too narrow for cones
SOFT = 0.3


class ConeLight:
    """What the threads of an image share: which lights take cones and which take rays, and what cones walk.

    Wide lamps take a cone from every point. Sharp ones, the world and emissive surfaces take shadow rays, a few for
    each of a pixel's fragments, in one stratified set: measured, they cost less there than cones that find as much.
    """

    def __init__(self, sampler, stage):
        world = sampler.world_light
        self.world = world
        self.acceleration = stage.acceleration
        self.lights = lights = stage.lights
        arrays = lights.arrays
        lamps = len(arrays.lamps.shape)
        wide = sorted(
            (k for k in range(lamps) if _is_wide(arrays.lamps, k)), key=lambda k: arrays.lamps.varying[k]
        )
        turns: list = [(LAMP, k) for k in range(lamps) if k not in wide]
        # what differs from place to place of a lamp is seen by lobes, and by rays, each at its place
        patterned = any(nodes.patterned for nodes in lights.nodes.values())
        worlds = [(WORLD, 0)] * (arrays.tree.leaf_of_world != -1)
        self.many = len(wide) > FEW or len(turns) > FEW or patterned
        if self.many:
            wide, self.rays = [], lights.asked([*worlds, *[None] * MANY_RAYS], lamps_apart=False)
        else:
            of_emitters = [None] * (EMITTER_RAYS if len(arrays.emitters.path) else 0)
            self.rays = lights.asked([*turns, *worlds, *of_emitters])
        # rays that pass leaves are dear
        dear = 2 if stage.needs.transparent_shadows else 1
        self.worth, self.world_rays = WORTH / dear, WORLD_RAYS // dear
        # what is faint takes one sample of each light, or of all: of many, or where it brings little for its time
        each = not (self.many or dear > 1 or len(arrays.emitters.path))
        self.weak = lights.apart if each else lights
        self.shares_world = (WORLD, 0) in self.rays.turns
        self.shares_lamps = None in self.rays.turns
        self.shares_lobes = bool(np.isfinite(sharpest(sampler.programs)).any()) and stage.limits.glossy > 0
        self.shares_refractions = (
            self.shares_lobes and stage.limits.transmission > 0 and refracts(sampler.programs)
        )
        self.shares_bounces = lights.haze or min(stage.limits.diffuse, stage.limits.bounces) > 0
        # a mirror never shows a lamp that is a point
        self.points = not bool(arrays.lamps.mis.all())
        self.extended = (lamps > 0 or len(arrays.emitters.path) > 0) and not self.points
        self.bends = self.extended and lamps > 0 and not self.many
        of = arrays.lamps.source
        taking_cones = [lights.lamps[of[k]] for k in wide]
        self.lamps = compile_lamps(taking_cones)[0]
        self.split = SplitLamps(taking_cones, self.lamps)
        self._sampler, self._lock = sampler, threading.Lock()

    @property
    def shares(self) -> bool:
        """Whether fragments hear what their neighbours receive."""
        return self.shares_world or self.shares_lamps or self.shares_lobes or self.shares_bounces

    def prefiltered(self) -> tuple:
        """What cones walk: surfaces that let no light through, and all surfaces; made when the first cone asks."""
        sampler = self._sampler
        with self._lock:
            if sampler.prefiltered is None:
                used = len(sampler.geometry.materials)
                opaque = np.array([float(p.opaque) for p in sampler.programs] + [1.0])[:used]
                whole = prefilter(self.acceleration)
                solid = whole if opaque.all() else prefilter(self.acceleration, opaque)
                sampler.prefiltered = solid, whole
        return sampler.prefiltered

    def stage(self, stage: Stage, lights) -> Stage:
        """The integrator's stage whose light samples ask `lights`."""
        return replace(
            stage,
            lights=lights,
            needs=replace(stage.needs, light_samples=True),
            limits=stage.limits._replace(diffuse_by_lights=True, seeks=self.lights.haze),
        )

    def blocked(self, cones: Cones, count: int, masks: np.ndarray, solid: bool = False) -> None:
        """masks (N,) uint64: the sub-rays of cones 0..count that something stops, or that no light passes (`solid`)."""
        visible(self.acceleration, self.prefiltered()[0 if solid else 1], cones, masks, None, 0, count)


def sampled_lights(scene, sampler, lights):
    """The scene's `lights` as cones need them: what is left to chance is sampled, the world's sun is a lamp. Kept."""
    materials = zip(sampler.geometry.materials, sampler.programs, strict=True)
    environment = lights.environment
    differ = environment.unsampled or environment.sun is not None
    differ = differ or any(sampled_sides(m, p) != sampled_sides(m, p, every=True) for m, p in materials)
    if not differ and not leaves_haze(sampler.geometry, sampler.programs):
        return lights
    if sampler.lights is None:
        sampler.lights = build_lights(scene, sampler.geometry, sampler.programs, environment, every=True)
    return sampler.lights


def _is_wide(lamps, k: int) -> bool:
    """Whether lamp k has wide penumbras, and is more to a point than a small part of itself, as narrow beams are."""
    row, shape = lamps.values[k], lamps.shape[k]
    if shape == SUN:
        return row[CONE] > 1.0 - math.cos(SHARP)
    return shape not in (POINT, DISTANT) and row[TAN_SPREAD] > SOFT
