"""Full shading: every fragment's material program, its lobes, and the light of lamps and world on them.

Forward mapping follows no rays: mirrors and glass look straight into the world, and emissive surfaces light nothing.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.drawing.cut_out_cover import let_through
from pointmr_engine.forward.drawing.cut_outs import NARROW, look_where_opaque
from pointmr_engine.forward.shading.fragment_surfaces import (
    NO_EYES,
    place_fragments,
    place_values,
    surfel_frames,
)
from pointmr_engine.forward.shading.holes_in_footprints import holes_in_footprints
from pointmr_engine.forward.shading.lobe_light import (
    NO_GAPS,
    NO_SHARES,
    finish,
    shade_world,
    widen_by_normals,
)
from pointmr_engine.forward.shading.placement_values import NEEDS
from pointmr_engine.forward.shading.varying_lamps import SplitLamps
from pointmr_engine.raytracing.camera import window_coordinates
from pointmr_engine.raytracing.frames import frames
from pointmr_engine.raytracing.rays import allocate_hits, allocate_rays
from pointmr_engine.raytracing.shade import Shader, allocate_view, fill_view
from pointmr_engine.raytracing.surface import allocate_frames, allocate_ray_state
from pointmr_engine.scene.group import HOLDOUT
from pointmr_engine.shading import lobes as lobe_kernels
from pointmr_engine.shading.bsdf.albedo_tables import load_tables

BATCH = 8192  # fragments at once: their lobes stay in the cache


class FullShading:
    """Shading "full" of one image. Threads may share it; `Space` holds what each needs for itself."""

    def __init__(self, image):
        sampler = image.sampler
        self.image = image
        self.shader = Shader(sampler.geometry, sampler.programs, image.settings, load_tables())
        self.world = sampler.world_light
        self.lamps = SplitLamps(image.scene_lights, image.lamps)
        self.max_lobes = max((p.max_lobes for p in sampler.programs), default=1)
        needs = frozenset().union(*(p.needs for p in sampler.programs))
        self.window = "window" in needs
        self.instances = any(need.partition(":")[0] in NEEDS for need in needs) or _has_holdouts(
            sampler.geometry
        )
        # of materials, and of none
        adds = np.array([*(p.adds for p in sampler.programs), False], np.bool_)
        self.adds = adds if adds.any() else None

    def shade(self, space, hierarchy, count: int) -> None:
        """Fill space.light[:count] with radiance towards the camera; fragments get their albedo, emission and normals.

        space.held has the share of each that is held out, if any is.
        """
        if space.shading is None:
            space.shading = _Space(self)
        own = space.shading
        if len(own.held) < count:
            own.held = np.empty(2 * count, np.float32)
        values = space.placement_values(hierarchy) if self.instances else None
        some = False
        for first in range(0, count, BATCH):
            n = min(BATCH, count - first)
            some |= self._shade_batch(space, own, hierarchy, values, first, n)
        if some:
            space.held = own.held

    def _shade_batch(self, space, own, hierarchy, values, first: int, n: int) -> bool:
        image, f = self.image, space.fragments
        first_, n_ = np.int64(first), np.int64(n)
        if len(hierarchy.cut_outs.mask):
            sampler = image.sampler
            holed, _ = look_where_opaque(sampler.opacity, hierarchy.cut_outs, image.coloured, f, first, n)
        to_world = image.camera.world_from_camera
        place_fragments(
            image.view, image.pixel, to_world, hierarchy.octree, hierarchy.parts, space.scratch.transforms, f, first_,
            NO_EYES, n_, own.rays, own.hits, own.state.width,
        )  # fmt: skip
        if len(hierarchy.cut_outs.mask):
            near = np.empty(len(holed), np.bool_)
            holes_in_footprints(
                hierarchy.cut_outs, self.shader.geometry.tables, own.hits, own.rays.direction, own.state.width, f,
                first_, holed, near,
            )  # fmt: skip
            own.state.width[holed[near]] *= NARROW
        if values is not None:
            place_values(values, f, first_, n_, own.hits)
        frames(self.shader.geometry, own.rays, own.hits, own.frames, 0, n)
        surfel_frames(
            to_world, space.scratch.entries, f, first_, n_, own.rays, own.frames, own.flat, own.spread
        )
        if self.window:
            own.state.window[:n] = window_coordinates(image.camera, own.frames.position[:n])
        fill_view(own.rays, own.state.kind, own.frames, own.view, n_)
        self.shader.lobes_at(
            own.rays, own.state, own.hits, own.frames, own.view, own.wanted, n_, own.order, own.lobes
        )
        widen_by_normals(own.lobes, own.spread, own.alpha, own.view.incoming, self.shader.tables, True, n_)
        light = space.light[first : first + n]
        light[:] = 0.0
        world = self.world
        if not image.sampler.environment.black:
            shade_world(
                own.lobes, own.view.incoming, own.flat, self.shader.tables, world.diffuse, world.glossy,
                world.transmission, n_, light,
            )  # fmt: skip
        self.lamps.shade(
            own.lobes, own.view.incoming, own.frames.position, own.flat, own.alpha, NO_GAPS, space.shadow, NO_SHARES,
            first, n, light,
        )  # fmt: skip
        if self.adds is not None:
            let_through(hierarchy.cut_outs, f, first_, n_, own.passed)
            own.passed[:n][~self.adds[own.frames.material[:n]]] = 1.0
        return finish(own.lobes, own.hits.holdout, own.passed, f, first_, n_, space.light, own.held)


class _Space:
    """One thread's arrays for a batch of fragments."""

    def __init__(self, shading: FullShading):
        n, lobes = BATCH, shading.max_lobes
        self.rays, self.hits, self.frames = allocate_rays(n), allocate_hits(n), allocate_frames(n)
        self.state = allocate_ray_state(n, shading.image.camera.camera_from_world)
        self.view = allocate_view(n)
        self.lobes = lobe_kernels.allocate(n, lobes, shading.shader.tables)
        self.alpha = np.empty((n, max(lobes, 1), 2), np.float32)
        self.flat, self.spread = np.empty(n, np.float32), np.empty(n, np.float32)
        self.order, self.wanted = np.zeros(n, np.int64), np.ones(n, np.bool_)
        self.held, self.passed = np.empty(n, np.float32), np.ones(n, np.float32)


def _has_holdouts(geometry) -> bool:
    return any(
        b.visibility is not None and bool((np.asarray(b.visibility) & HOLDOUT).any())
        for b in geometry.batches
    )
