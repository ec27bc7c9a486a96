"""Forward mapping as a method: visible samples of every tile, shaded and filtered into a frame."""

from __future__ import annotations

import os
import threading
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from pointmr_engine.forward.baking import Baker
from pointmr_engine.forward.fragments import (
    allocate_fragments,
    fill_fragments,
    filter_taps,
    filter_tile,
    find_fragments,
)
from pointmr_engine.forward.lambert import point_lights, shade_lambert
from pointmr_engine.forward.subpixels import allocate_target, clear, make_view
from pointmr_engine.forward.walk import COUNTERS, Hierarchy, Scratch, walk
from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.hierarchy.octree import build_octree
from pointmr_engine.hierarchy.sample_sets import SampleSets
from pointmr_engine.raytracing.camera import CameraArrays
from pointmr_engine.raytracing.environment import Environment
from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.settings import RenderSettings

TILE = 94  # pixels; with one more on each side for the filter, and four subpixels, whole blocks


class Sampler:
    """What forward mapping keeps of a scene between images: octrees, sample sets, materials and world."""

    def __init__(
        self, scene: Scene, geometry: Geometry, programs: list, settings: RenderSettings, progress=None
    ):
        self.geometry, self.programs = geometry, programs
        self.octree = build_octree(geometry, progress)
        self.baker = Baker(geometry, programs)
        self.environment = Environment(scene.world)
        self.ambient = _mean_radiance(self.environment)
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
        self.lights = point_lights(scene.lights, camera.camera_from_world)
        self.ambient = sampler.ambient
        self.counters: Counter = Counter()

    def hierarchy(self) -> Hierarchy:
        """The hierarchy as it is now; further sets may come."""
        geometry = self.sampler.geometry
        return Hierarchy(self.sampler.octree.arrays, self.sets.arrays, geometry.tables, geometry.instances)


def _mean_radiance(environment: Environment) -> np.ndarray:
    """(3,) float64 radiance of the world, averaged over all directions."""
    n = 512
    z = (2 * np.arange(n) + 1) / n - 1
    angle = np.arange(n) * (np.pi * (3 - 5**0.5))
    r = np.sqrt(1 - z * z)
    return (
        environment.radiance(np.stack([r * np.cos(angle), r * np.sin(angle), z], 1))
        .mean(0)
        .astype(np.float64)
    )


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
        self.fragment_of = np.full(1 << 16, -1, np.int32)
        self.light = np.empty((side * side, 3), np.float32)
        self.lines = np.empty((side, TILE, 4), np.float32)
        self.line = np.empty((side, 4), np.float32)
        self.corners = np.empty((3, 3))
        self.background = np.zeros((TILE + 2 * image.apron, TILE + 2 * image.apron, 4), np.float32)

    def draw(self, bounds, hierarchy: Hierarchy, wanted: np.ndarray) -> int:
        """Walk for a tile x0, y0, x1, y1 of pixels; returns the number of entries."""
        image, s, a = self.image, self.image.subpixels, self.image.apron
        x0, y0, x1, y1 = bounds
        self.left, self.low = (x0 - a) * s, (y0 - a) * s
        self.width, self.height = (x1 - x0 + 2 * a) * s, (y1 - y0 + 2 * a) * s
        clear(self.target, self.width)
        self.entries = walk(
            image.view, hierarchy, image.camera.camera_from_world, image.spacing,
            (self.left, self.low, self.left + self.width, self.low + self.height),
            self.scratch, wanted, image.settings.forward.occlusion_culling,
        )  # fmt: skip
        return self.entries

    def shade(self, bounds, hierarchy: Hierarchy, out: np.ndarray) -> None:
        """Shade what the tile shows, and filter it into out (h, w, 4) float32."""
        image, s = self.image, self.image.subpixels
        if len(self.fragment_of) < self.entries:
            self.fragment_of = np.full(2 * self.entries, -1, np.int32)
        entries = self.scratch.entries
        self.fragment_of[: self.entries] = -1
        count = find_fragments(
            self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(s), entries,
            self.fragment_of, self.fragments,
        )  # fmt: skip
        f = self.fragments
        fill_fragments(
            image.view, np.int64(self.left), np.int64(self.low), hierarchy.octree, hierarchy.sets, hierarchy.parts,
            self.scratch.transforms, entries, f, count, self.corners,
        )  # fmt: skip
        self._look_up_triangles(count)
        shade_lambert(
            image.view.perspective, f.position, f.normal, f.albedo, f.emission, image.lights, image.ambient,
            np.zeros((0, 0), np.float32), count, self.light,
        )  # fmt: skip
        self._background(bounds)
        filter_tile(
            self.target.ids, np.int64(self.width), np.int64(self.height), np.int64(s), self.light,
            self.background, image.taps, self.lines, self.line, out,
        )  # fmt: skip

    def _look_up_triangles(self, count: int) -> None:
        f = self.fragments
        rows = np.flatnonzero(~f.normal[:count].any(1))
        if not len(rows):
            return
        width = np.zeros(len(rows), np.float32)
        look = self.image.sampler.baker(
            f.part[rows], f.triangle[rows], f.place[rows, 0], f.place[rows, 1], width
        )
        matrix = self.scratch.transforms.matrix[f.row[rows]].reshape(-1, 3, 4)[:, :, :3]
        cofactors = np.stack([np.cross(matrix[:, (i + 1) % 3], matrix[:, (i + 2) % 3]) for i in range(3)], 1)
        normal = (cofactors * look.normal[:, None, :]).sum(2)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        f.normal[rows] = normal / np.where(length > 0, length, 1)
        f.albedo[rows], f.emission[rows] = look.albedo, look.emission

    def _background(self, bounds) -> None:
        """World radiance of the tile's pixels that are not covered whole."""
        image, s = self.image, self.image.subpixels
        rows, columns = self.height // s, self.width // s
        empty = (self.target.ids[: self.height, : self.width] < 0).reshape(rows, s, columns, s).any((1, 3))
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
        self.background[y, x, :3] = image.sampler.environment.radiance(world)
        self.background[y, x, 3] = 1


def render_image(image: Image, region, clock=None) -> tuple[np.ndarray, Counter]:
    """(pixels (h, w, 4) float32 premultiplied, counters) of the region x0, y0, x1, y1."""
    x0, y0, x1, y1 = region
    out = np.zeros((y1 - y0, x1 - x0, 4), np.float32)
    tiles = [
        (x, y, min(x + TILE, x1), min(y + TILE, y1)) for y in range(y0, y1, TILE) for x in range(x0, x1, TILE)
    ]
    nodes = len(image.sampler.octree.arrays.box)
    local = threading.local()
    spaces: list[Workspace] = []
    lock = threading.Lock()

    def work(bounds):
        if not hasattr(local, "space"):
            local.space = Workspace(image)
            local.wanted = np.zeros(nodes, np.uint8)
            with lock:
                spaces.append(local.space)
        space, wanted = local.space, local.wanted
        hierarchy = image.hierarchy()
        missing = space.scratch.counters[COUNTERS.index("waiting")]
        space.draw(bounds, hierarchy, wanted)
        if space.scratch.counters[COUNTERS.index("waiting")] > missing:
            missing_nodes = np.flatnonzero(wanted)
            wanted[missing_nodes] = 0
            return missing_nodes
        part = out[bounds[1] - y0 : bounds[3] - y0, bounds[0] - x0 : bounds[2] - x0]
        block = np.empty(part.shape, np.float32)
        space.shade(bounds, hierarchy, block)
        part[:] = block
        return None

    threads = image.settings.threads or os.cpu_count() or 1
    with ThreadPoolExecutor(threads) as pool:
        while tiles:
            results = list(pool.map(work, tiles))
            again = [(t, r) for t, r in zip(tiles, results, strict=True) if r is not None]
            if again:
                wanted = np.unique(np.concatenate([r for _, r in again]))
                groups = image.sets.node_group[wanted]
                levels = image.sampler.octree.arrays.level[wanted]
                pairs = np.unique(np.stack([groups, levels], 1), axis=0)
                image.sets.require([(int(g), int(level)) for g, level in pairs])
            tiles = [t for t, _ in again]
    counters = Counter()
    for space in spaces:
        counters.update(dict(zip(COUNTERS, space.scratch.counters.tolist(), strict=True)))
    return out, counters
