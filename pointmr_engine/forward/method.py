"""Forward mapping as a method: visible samples of every tile, shaded and filtered into a frame."""

from __future__ import annotations

import os
import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait

import numpy as np

from pointmr_engine.forward.baking import Baker, materials_of
from pointmr_engine.forward.cut_outs import build_cut_outs
from pointmr_engine.forward.emissive_lamps import emissive_lamps
from pointmr_engine.forward.fragments import (
    allocate_fragments,
    fill_fragments,
    fill_normal_matrices,
    filter_taps,
    filter_tile,
    find_fragments,
)
from pointmr_engine.forward.lambert import SimpleShading
from pointmr_engine.forward.placement_values import allocate_placement_values, combine_placements
from pointmr_engine.forward.shadow_map import ShadowMaps
from pointmr_engine.forward.subpixels import allocate_target, clear, make_view
from pointmr_engine.forward.walk import COUNTERS, Hierarchy, Scratch, walk
from pointmr_engine.forward.world_light import WorldLight
from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.hierarchy.octree import build_octree, triangle_corners
from pointmr_engine.hierarchy.sample_sets import SampleSets
from pointmr_engine.image.frame import NOTHING, Frame
from pointmr_engine.raytracing.camera import CameraArrays
from pointmr_engine.raytracing.environment import Environment
from pointmr_engine.raytracing.lamps import compile_lamps
from pointmr_engine.scene.group import CAMERA
from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.settings import RenderSettings

WAITING = COUNTERS.index("waiting")
TILE = 94  # pixels; with one more on each side for the filter, and four subpixels, whole blocks


class Sampler:
    """What forward mapping keeps of a scene between images: octrees, sample sets, materials and world."""

    def __init__(
        self, scene: Scene, geometry: Geometry, programs: list, settings: RenderSettings, progress=None
    ):
        self.geometry, self.programs = geometry, programs
        self.octree = build_octree(geometry, progress)
        self.baker = Baker(geometry, programs)
        self.looks = self.baker.constant_looks()
        self.environment = Environment(scene.world)
        self.cut_outs = build_cut_outs(geometry, programs)
        self.emissive_lamps = emissive_lamps(geometry, programs)
        self.corners = triangle_corners(self.octree)
        self.world_light = WorldLight(self.environment)
        self.ambient = self.world_light.mean
        self.sets: dict[str, SampleSets] = {}

    def sets_of(self, strategy: str, failure: float) -> SampleSets:
        """The static sample sets made by a strategy."""
        if strategy not in self.sets:
            self.sets[strategy] = SampleSets(self.octree, self.baker, strategy, failure=failure)
        return self.sets[strategy]


class Image:
    """One image by static sampling: everything that its tiles share."""

    def __init__(self, sampler: Sampler, scene: Scene, camera: CameraArrays, settings: RenderSettings):
        self.sampler, self.camera, self.settings = sampler, camera, settings
        options = settings.forward
        self.subpixels = options.subpixels
        self.spacing = self.subpixels / options.samples_per_pixel**0.5
        self.sets = sampler.sets_of(options.strategy, options.failure)
        self.taps = filter_taps(settings.pixel_filter, settings.filter_width, self.subpixels)
        self.apron = (len(self.taps) // self.subpixels - 1) // 2
        octree = sampler.octree
        root = len(sampler.geometry.groups) - 1
        z = _depth_range(camera.camera_from_world, octree.lower[root], octree.upper[root])
        self.view = make_view(camera, self.subpixels, z)
        self.pixel = self.subpixels / (self.view.scale_x * self.view.scale_y) ** 0.5
        self.scene_lights = [*scene.lights, *sampler.world_light.suns, *sampler.emissive_lamps]
        self.lamps = compile_lamps(self.scene_lights)[0]
        self.shading = _shading(self)
        self.shadows = options.shadows and bool(self.lamps.cast_shadow.any())
        self.region = settings.region or (0, 0, settings.width, settings.height)
        index = [0 if m is None else m.pass_index for m in sampler.geometry.materials]
        self.material_index = np.array(index, np.float32)

    def build(self, nodes: np.ndarray, tell) -> None:
        """Build the sample sets that `nodes` wait for."""
        levels = self.sampler.octree.arrays.level[nodes]
        pairs = np.unique(np.stack([self.sets.node_group[nodes], levels], 1), axis=0)
        self.sets.require([(int(g), int(level)) for g, level in pairs], lambda fraction: tell(0.0, None))

    def needs(self) -> dict:
        """What this image required, for the frame's statistics."""
        return {
            "sample_sets": len(self.sets.built),
            "samples": self.sets.used,
            "octree_nodes": len(self.sampler.octree.arrays.box),
        }

    def hierarchy(self) -> Hierarchy:
        """The hierarchy as it is now; further sets may come."""
        geometry = self.sampler.geometry
        return Hierarchy(
            self.sampler.octree.arrays,
            self.sets.arrays,
            self.sampler.corners,
            geometry.tables,
            geometry.instances,
            self.sampler.cut_outs,
        )


def _shading(image: Image):
    """What lights the image's fragments: an object with shade(workspace, hierarchy, number of fragments)."""
    if image.settings.forward.shading == "simple":
        return SimpleShading(image)
    from pointmr_engine.forward.materials import FullShading

    return FullShading(image)


def _depth_range(camera_from_world: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> tuple[float, float]:
    """Smallest and largest depth along the view axis of a box in world space."""
    if not np.isfinite(lower).all():
        return 0.0, 1.0
    axis = camera_from_world[2]
    middle = axis[:3] @ (0.5 * (lower + upper)) + axis[3]
    half = np.abs(axis[:3]) @ (0.5 * (upper - lower))
    return float(middle - half), float(middle + half)


class Workspace:
    """One thread's buffers for tiles of an image."""

    def __init__(self, image: Image):
        self.image = image
        side = (TILE + 2 * image.apron) * image.subpixels
        self.target = allocate_target(side, side)
        self.scratch = Scratch(self.target)
        self.fragments = allocate_fragments(side * side)  # at most; untouched pages cost nothing
        self.fragment_of = np.empty(1 << 16, np.int32)
        self.wanted = np.zeros(len(image.sampler.octree.arrays.box), np.uint8)
        self.shaded = 0
        self.shadow = np.zeros(
            (0, 0), np.float32
        )  # (lamps, fragments) share of light that arrives; or nothing
        self.shadow_maps = ShadowMaps(image) if image.shadows else None
        self.placed = allocate_placement_values(0)
        self.light = np.empty((side * side, 3), np.float32)
        self.sums = np.empty((TILE, 4 * side), np.float32)
        self.empty = np.zeros((side // image.subpixels + 1,) * 2, np.uint8)
        self.normals = np.empty((1 << 12, 9))
        self.line = np.empty((side, 4), np.float32)
        self.corners = np.empty((3, 3))
        self.background = np.zeros((TILE + 2 * image.apron, TILE + 2 * image.apron, 4), np.float32)

    def draw(self, bounds, hierarchy: Hierarchy) -> np.ndarray | None:
        """Walk for a tile x0, y0, x1, y1 of pixels; returns the nodes whose sets it misses, None if it is complete."""
        image, s, a = self.image, self.image.subpixels, self.image.apron
        x0, y0, x1, y1 = bounds
        self.left, self.low = (x0 - a) * s, (y0 - a) * s
        self.width, self.height = (x1 - x0 + 2 * a) * s, (y1 - y0 + 2 * a) * s
        clear(self.target, self.width)
        counters = self.scratch.counters
        waiting = counters[WAITING]
        self.entries = walk(
            image.view, hierarchy, image.camera.camera_from_world, image.spacing,
            (self.left, self.low, self.left + self.width, self.low + self.height),
            self.scratch, self.wanted, image.settings.forward.occlusion_culling, s,
        )  # fmt: skip
        if counters[WAITING] == waiting:
            return None
        missing = np.flatnonzero(self.wanted)
        self.wanted[missing] = 0
        return missing

    def shade(self, bounds, hierarchy: Hierarchy, frame: Frame) -> np.ndarray | None:
        """Shade what the tile shows, and filter it into the frame; returns the nodes whose sets shadows miss, as `draw`."""
        image, s = self.image, self.image.subpixels
        if len(self.fragment_of) < self.entries:
            self.fragment_of = np.empty(2 * self.entries, np.int32)
        self.fragment_of[: self.entries] = -1
        ids, f, entries = self.target.ids, self.fragments, self.scratch.entries
        width, height, s = np.int64(self.width), np.int64(self.height), np.int64(s)
        count = find_fragments(ids, width, height, s, entries, self.fragment_of, self.empty, f)
        rows = int(self.scratch.used[1])
        if len(self.normals) < rows:
            self.normals = np.empty((2 * rows, 9))
        fill_normal_matrices(self.scratch.transforms.matrix, np.int64(rows), self.normals)
        fill_fragments(
            image.view, np.int64(self.left), np.int64(self.low), hierarchy.octree, hierarchy.sets, hierarchy.corners,
            hierarchy.parts, image.sampler.looks, self.scratch.transforms, self.normals, entries, f, count,
            self.corners,
        )  # fmt: skip
        self.shaded += count
        if self.shadow_maps is not None:
            missing = self.shadow_maps.trace(hierarchy, f, count, self.wanted)
            if missing is not None:
                return missing
            self.shadow = self.shadow_maps.share
        image.shading.shade(self, hierarchy, count)
        self._background(bounds)
        self._write(bounds, hierarchy, frame)
        return None

    def placement_values(self, hierarchy: Hierarchy):
        """What instances say about the tile's placements, a row each."""
        rows = int(self.scratch.used[1])
        if len(self.placed.path) < rows:
            self.placed = allocate_placement_values(2 * rows)
        combine_placements(self.scratch.transforms, hierarchy.instances, np.int64(rows), self.placed)
        return self.placed

    def _write(self, bounds, hierarchy: Hierarchy, frame: Frame) -> None:
        """All passes of the tile."""
        image, f, s = self.image, self.fragments, self.image.subpixels
        x0, y0 = image.region[:2]
        where = np.s_[bounds[1] - y0 : bounds[3] - y0, bounds[0] - x0 : bounds[2] - x0]
        rows, columns = bounds[3] - bounds[1], bounds[2] - bounds[0]
        nothing = np.zeros_like(self.background)

        def filtered(values, background):
            out = np.empty((rows, columns, 4), np.float32)
            filter_tile(
                self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(s), values, background,
                image.taps, self.sums, self.line, out,
            )  # fmt: skip
            return out

        combined = filtered(self.light, self.background)
        combined[:, :, :3] *= image.settings.film_exposure
        frame.passes["combined"][where] = np.nan_to_num(combined, copy=False)
        middle = image.apron * s + s // 2
        nearest = self.target.ids[middle : self.height : s, middle : self.width : s][:rows, :columns]
        seen, k = nearest >= 0, np.maximum(nearest, 0)
        to_world = image.camera.world_from_camera
        for name, target in frame.passes.items():
            if name in ("emission", "diffuse_color", "normal"):
                values = {"emission": f.emission, "diffuse_color": f.albedo, "normal": f.normal}[name]
                block = filtered(values, nothing)[:, :, :3]
                if name == "emission":
                    block = block * image.settings.film_exposure
                elif name == "normal":
                    block = block @ to_world[:, :3].T
            elif name == "depth":
                block = np.where(seen, f.position[k][..., 2], NOTHING)[..., None]
            elif name == "position":
                block = (f.position[k] @ to_world[:, :3].T + to_world[:, 3]) * seen[..., None]
            elif name == "object_index":
                block = np.zeros((rows, columns, 1), np.float32)
                block[seen, 0] = self.placement_values(hierarchy).object_index[f.row[nearest[seen]]]
            elif name == "material_index":
                block, of = np.zeros((rows, columns, 1), np.float32), nearest[seen]
                material = np.zeros(len(of), np.int32)
                materials_of(hierarchy.parts, f.part[of], f.triangle[of], material)
                block[seen, 0] = image.material_index[material]
            elif name == "sample_count":
                block = np.ones((rows, columns, 1))
            else:
                continue
            target[where] = block

    def _background(self, bounds) -> None:
        """World radiance of the tile's pixels that are not covered whole."""
        image, s = self.image, self.image.subpixels
        rows, columns = self.height // s, self.width // s
        empty = self.empty[:rows, :columns]
        self.background[:rows, :columns] = 0
        if image.settings.film_transparent or not empty.any():
            return
        y, x = np.nonzero(empty)
        view = image.view
        d = np.ones((len(x), 3))
        if view.perspective:
            d[:, 0] = (self.left + (x + 0.5) * s - view.shift_x) / view.scale_x
            d[:, 1] = (self.low + (y + 0.5) * s - view.shift_y) / view.scale_y
            d /= np.linalg.norm(d, axis=1, keepdims=True)
        else:
            d[:, :2] = 0
        world = d @ image.camera.world_from_camera[:, :3].T
        self.background[y, x, :3] = image.sampler.environment.radiance(world, CAMERA)
        self.background[y, x, 3] = 1


def render_image(
    image: Image, frame: Frame, tell: Callable[[float, tuple[int, int, np.ndarray] | None], None]
) -> Counter:
    """Fill the frame's passes; returns counters.

    tell(fraction, (x, y, pixels) of a finished tile in the frame or None) is called from this thread and may raise to cancel.
    """
    x0, y0, x1, y1 = image.region
    tiles = [
        (x, y, min(x + TILE, x1), min(y + TILE, y1)) for y in range(y0, y1, TILE) for x in range(x0, x1, TILE)
    ]
    total, done = len(tiles), 0
    local = threading.local()
    spaces: list[Workspace] = []
    lock = threading.Lock()
    stop = threading.Event()

    def work(bounds):
        if stop.is_set():
            return bounds, None, None
        if not hasattr(local, "space"):
            local.space = Workspace(image)
            with lock:
                spaces.append(local.space)
        hierarchy = image.hierarchy()
        missing = local.space.draw(bounds, hierarchy)
        if missing is None:
            missing = local.space.shade(bounds, hierarchy, frame)
        return bounds, missing, (bounds[0] - x0, bounds[1] - y0)

    pool = ThreadPoolExecutor(image.settings.threads or os.cpu_count() or 1, thread_name_prefix="pointmr")
    try:
        while tiles:
            # numba's dispatchers must not meet new types on two threads at once: the first tile runs alone
            pending = {pool.submit(work, tiles[0])}
            waiting = tiles[1:]
            again: list[tuple[tuple, np.ndarray]] = []
            while pending:
                finished, pending = wait(pending, timeout=0.1, return_when=FIRST_COMPLETED)
                if finished and waiting:
                    pending |= {pool.submit(work, bounds) for bounds in waiting}
                    waiting = []
                for future in finished:
                    bounds, missing, place = future.result()
                    if missing is not None:
                        again.append((bounds, missing))
                    elif place is not None:
                        x, y = place
                        done += 1
                        block = frame.passes["combined"][
                            y : y + bounds[3] - bounds[1], x : x + bounds[2] - bounds[0]
                        ]
                        tell(done / total, (x, y, block.copy()))
                tell(done / total, None)
            if again:
                image.build(np.unique(np.concatenate([m for _, m in again])), tell)
            tiles = sorted(bounds for bounds, _ in again)
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)
    counters = Counter()
    for space in spaces:
        counters.update(dict(zip(COUNTERS, space.scratch.counters.tolist(), strict=True)))
        counters.update(fragments=space.shaded)
    return counters
