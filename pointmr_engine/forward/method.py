"""Forward mapping as a method: visible samples of every tile, shaded and filtered into a frame."""

from __future__ import annotations

import copy
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from functools import cached_property
from time import thread_time

import numpy as np

from pointmr_engine.forward.baked.baking import Baker
from pointmr_engine.forward.drawing.cut_outs import build_cut_outs, have_same_cut_outs
from pointmr_engine.forward.drawing.part_opacity import PartOpacity
from pointmr_engine.forward.drawing.subpixels import make_view
from pointmr_engine.forward.reconstruction import scattered
from pointmr_engine.forward.reconstruction.pixel_filter import filter_taps
from pointmr_engine.forward.selection.near_cut_outs import NearCutOuts
from pointmr_engine.forward.selection.walk import HARDLY, Hierarchy
from pointmr_engine.forward.shading.emissive_lamps import emissive_lamps
from pointmr_engine.forward.shading.lambert import SimpleShading
from pointmr_engine.forward.shading.world_light import WorldLight
from pointmr_engine.forward.tiles import TILE, WIDE_TILE, Workspace
from pointmr_engine.hierarchy.distribution import Distribution, build_distribution
from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.hierarchy.octree import build_octree, triangle_corners
from pointmr_engine.hierarchy.sample_sets import SampleSets
from pointmr_engine.image.frame import Frame
from pointmr_engine.image.tile_workers import can_fork, finished_tiles, share_passes, worth_a_fork
from pointmr_engine.raytracing.camera import CameraArrays
from pointmr_engine.raytracing.compile_lamps import compile_lamps
from pointmr_engine.raytracing.environment import Environment
from pointmr_engine.raytracing.lamps_in_view import LampsInView
from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.settings import ForwardSettings, RenderSettings


class Sampler:
    """What forward mapping keeps of a scene between images: octrees, sample sets, materials and world.

    earlier: that of another scene, from which is taken what was made of groups and parts that are the same objects.
    """

    def __init__(
        self,
        geometry: Geometry,
        programs: list,
        environment: Environment,
        progress=None,
        earlier: Sampler | None = None,
        threads: int = 0,
    ):
        self.geometry, self.programs = geometry, programs
        self.octree = build_octree(geometry, progress)
        self.baker = Baker(geometry, programs)
        self.looks = self.baker.constant_looks()
        self.put_under(environment)
        self.opacity = PartOpacity(geometry, programs, threads)
        self.micromap = None  # by multires.cones.opacity_micromap, when shadow rays first pass surfaces
        if earlier is not None and have_same_cut_outs(earlier.opacity, self.opacity):
            self.cut_outs, self.densest_cut_outs = earlier.cut_outs, earlier.densest_cut_outs
            self.near_cut_outs = earlier.near_cut_outs.of(self.opacity)
            self.micromap = earlier.micromap
        else:
            self.cut_outs, self.densest_cut_outs, sources = build_cut_outs(self.opacity, progress)
            self.near_cut_outs = NearCutOuts(sources)
        self.emissive_lamps = emissive_lamps(geometry, programs)
        self.corners = triangle_corners(self.octree)
        self.prefiltered = None  # by hierarchy.prefilter, when the first cone asks (cone_light.ConeLight)
        self.warm = False  # an image has been rendered: what its tiles ask for is there
        self.sets: dict[tuple, SampleSets] = {}
        self._earlier_sets = {} if earlier is None else earlier.sets
        # of a core, that each tile of the last image took, by what its buffers fit
        self.seconds: dict[tuple, dict[tuple, float]] = {} if earlier is None else earlier.seconds
        self._spaces: dict[tuple, list[Workspace]] = {}  # of finished images, by what their buffers fit
        self._lock = threading.Lock()

    def put_under(self, environment: Environment | None) -> None:
        """Forget the scene's lights, and take this world's; None: another, which is to come."""
        self.environment = environment
        self.world_light = None if environment is None else WorldLight(environment)
        self.ambient = None if environment is None else self.world_light.mean
        self.lights = None  # by cone_light.sampled_lights, where lights of the scene are left to chance

    def of_geometry(self, geometry: Geometry) -> Sampler:
        """A sampler of the same scene whose placements have other visibility; octrees and samples are shared."""
        other = copy.copy(self)
        other.geometry = geometry
        other.emissive_lamps = emissive_lamps(geometry, self.programs)
        other.prefiltered = other.lights = None
        other.seconds, other._spaces, other._lock = {}, {}, threading.Lock()
        return other

    def space(self, image: Image) -> Workspace:
        """Buffers for a thread that draws tiles of `image`: those of an earlier image, where they fit."""
        with self._lock:
            kept = self._spaces.get(image.fits, [])
            space = kept.pop() if kept else None
        if space is None:
            return image.space()
        space.begin(image)
        return space

    def keep(self, image: Image, spaces: list[Workspace]) -> None:
        """Keep the buffers of an image that is finished; those of other kinds are dropped."""
        for space in spaces:
            space.rest()
        with self._lock:
            self._spaces = {image.fits: spaces}

    @cached_property
    def distribution(self) -> Distribution:
        """What dynamic sampling draws from."""
        return build_distribution(self.octree)

    def sets_of(self, options: ForwardSettings) -> SampleSets:
        """The static sample sets that these settings ask for."""
        key = (
            options.strategy,
            options.failure if options.strategy == "random" else 0.0,
            options.cache_folder,
        )
        if key not in self.sets:
            self.sets[key] = SampleSets(
                self.octree,
                self.baker,
                options.strategy,
                failure=options.failure,
                folder=options.cache_folder,
            )
            if key in self._earlier_sets:
                self.sets[key].adopt(self._earlier_sets[key])
            self._earlier_sets = {}
        return self.sets[key]


class Image:
    """One image: everything that its tiles share."""

    warnings: list[str] = []  # what was asked for and could not be had
    apart = False  # tiles run enough Python to be rendered by processes, where the settings want it
    coloured = False  # cut-outs are those of the channel that is blocked most; the others' light goes on

    def __init__(self, sampler: Sampler, scene: Scene, camera: CameraArrays, settings: RenderSettings):
        self.sampler, self.camera, self.settings = sampler, camera, settings
        options = settings.forward
        self.subpixels = {"pixel": 1, "gaussian": scattered.CELLS}.get(
            options.reconstruction, options.subpixels
        )
        self.spacing = self.subpixels / options.samples_per_pixel**0.5
        self.sets = sampler.sets_of(options)
        # the opacity that triangles with holes are drawn by
        self.cut_outs = sampler.densest_cut_outs if self.coloured else sampler.cut_outs
        self.sigma = scattered.sigma(options.samples_per_pixel)
        kind = "box" if options.reconstruction == "pixel" else settings.pixel_filter
        self.taps = filter_taps(kind, settings.filter_width, self.subpixels)
        self.apron = (len(self.taps) // self.subpixels - 1) // 2
        if options.reconstruction == "gaussian":
            self.apron = scattered.reach(self.sigma)
        octree = sampler.octree
        root = len(sampler.geometry.groups) - 1
        z = depth_range(camera.camera_from_world, octree.lower[root], octree.upper[root])
        self.view = make_view(camera, self.subpixels, z)
        self.pixel = self.subpixels / (self.view.scale_x * self.view.scale_y) ** 0.5
        all_lights = [*scene.lights, *sampler.world_light.suns, *sampler.emissive_lamps]
        self.scene_lights = sorted(all_lights, key=lambda light: light.graph is not None)
        self.lamps = compile_lamps(self.scene_lights)[0]
        self.in_view = LampsInView(scene.lights)
        self.shadows = options.shadows and bool(self.lamps.cast_shadow.any())
        self.shading = self.choose_shading()
        self.hardly = HARDLY if options.shading == "simple" else 0.0
        self.tile = WIDE_TILE if self.subpixels <= 2 else TILE
        # what tiles show that was found before them, and their buffers
        self.drawn, self.space_of = None, Workspace
        self.region = settings.region or (0, 0, settings.width, settings.height)
        index = [0 if m is None else m.pass_index for m in sampler.geometry.materials]
        self.material_index = np.array(index, np.float32)

    def choose_shading(self):
        """What lights the image's fragments: an object with shade(workspace, hierarchy, number of fragments)."""
        if self.settings.forward.shading == "simple":
            return SimpleShading(self)
        from pointmr_engine.forward.shading.materials import FullShading

        return FullShading(self)

    def build(self, nodes: np.ndarray, tell) -> None:
        """Build the sample sets that `nodes` wait for."""
        levels = self.sampler.octree.arrays.level[nodes]
        pairs = np.unique(np.stack([self.sets.node_group[nodes], levels], 1), axis=0)
        self.sets.require(pairs, lambda fraction: tell(0.0, None), self.settings.threads)

    @property
    def fits(self) -> tuple:
        """What buffers must have been made for to serve this image."""
        options = self.settings.forward
        return (
            type(self).__name__,
            options.sampling,
            options.reconstruction == "analytic",
            self.subpixels,
            self.apron,
            self.tile,
            self.settings.forward.shading,
            self.shadows,
        )

    def prepare(self, tell) -> None:
        """What comes before the tiles; tell() may raise to cancel."""
        size = self.settings.width, self.settings.height
        self.cut_outs = self.sampler.near_cut_outs.refined(
            self.cut_outs, self.cut_outs is self.sampler.densest_cut_outs, self.view, self.hierarchy(),
            self.camera.camera_from_world, size, self.subpixels, tell,
        )  # fmt: skip
        if self.settings.forward.reconstruction == "analytic":
            from pointmr_engine.forward.analytic import PolygonSpace, VisiblePolygons

            self.drawn, self.space_of = VisiblePolygons(self), PolygonSpace
            self.drawn.find(tell)
        elif self.settings.forward.sampling == "dynamic":
            from pointmr_engine.forward.points_method import PointSpace

            self.space_of = PointSpace

    def space(self) -> Workspace:
        """A thread's buffers for tiles."""
        return self.space_of(self)

    def finish(self) -> None:
        """Let go of what refers back to the image: such rings of large arrays would wait for Python's collector."""
        self.drawn = self.shading = None

    def needs(self) -> dict:
        """What this image required, for the frame's statistics."""
        return {
            "sample_sets": len(self.sets.built),
            "samples": self.sets.used,
            **self.sets.statistics(),
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
            self.cut_outs,
        )


def depth_range(camera_from_world: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> tuple[float, float]:
    """Smallest and largest depth along the view axis of a box in world space."""
    if not np.isfinite(lower).all():
        return 0.0, 1.0
    axis = camera_from_world[2]
    middle = axis[:3] @ (0.5 * (lower + upper)) + axis[3]
    half = np.abs(axis[:3]) @ (0.5 * (upper - lower))
    return float(middle - half), float(middle + half)


_warm = threading.Event()  # every kernel of a tile has run in this process


def render_image(
    image: Image, frame: Frame, tell: Callable[[float, tuple[int, int, np.ndarray] | None], None]
) -> Counter:
    """Fill the frame's passes; returns counters.

    tell(fraction, (x, y, pixels) of a finished tile in the frame or None) is called from this thread, and may raise to
    cancel.
    """
    x0, y0, x1, y1 = image.region
    # tiles begin at multiples of their size in the whole image, whatever region of it is rendered
    side = image.tile
    tiles = [
        (max(x, x0), max(y, y0), min(x + side, x1), min(y + side, y1))
        for y in range(y0 // side * side, y1, side)
        for x in range(x0 // side * side, x1, side)
    ]
    image.prepare(lambda: tell(0.0, None))
    threads, sampler = image.settings.threads, image.sampler
    apart = image.apart and image.settings.processes and can_fork(len(tiles), threads)
    counters: Counter = Counter(image.drawn.counts if image.drawn is not None else {})
    spaces: list[Workspace] = []  # that no thread uses
    total, left, missing, stop = len(tiles), set(tiles), [], threading.Event()
    seconds: dict[tuple, float] = {}  # of a core, by tile
    known = sampler.seconds.get(image.fits, {})

    def work(bounds):
        begun = thread_time()
        try:
            space = spaces.pop()
        except IndexError:
            space = sampler.space(image)
        before, hierarchy = _counts(space), image.hierarchy()
        found = space.draw(bounds, hierarchy)
        if found is None:
            found = space.shade(bounds, hierarchy, frame)
        counted = _counts(space)
        counted.subtract(before)
        spaces.append(space)
        return bounds, found, counted, thread_time() - begun

    def render(tiles, apart):
        with closing(finished_tiles(work, tiles, threads, apart, frame.warnings, stop)) as finished:
            for tile in finished:
                if tile is not None:
                    bounds, found, counted, seconds[tile[0]] = tile
                    counters.update(counted)
                    if found is None:
                        left.discard(bounds)
                        x, y = bounds[0] - x0, bounds[1] - y0
                        block = frame.passes["combined"][y : bounds[3] - y0, x : bounds[2] - x0]
                        tell(1.0 - len(left) / total, (x, y, block.copy()))
                    else:
                        missing.append(found)
                tell(1.0 - len(left) / total, None)

    try:
        while left:
            # longest first, as the last image had them, or cores would wait for one that began last
            tiles, missing = sorted(left, key=lambda tile: (-known.get(tile, 0.0), tile)), []
            # one alone: numba's dispatchers must not meet new types on two threads at once, and what it asks to be made
            # for all the image, processes would have to make one by one
            if not _warm.is_set() or (apart and not sampler.warm):
                render([tiles.pop(len(tiles) // 2)], False)
            if tiles:  # which mostly miss sets, too, if that one does
                fork = apart and not missing and worth_a_fork(tiles, known)
                if fork:
                    share_passes(frame)
                render(tiles, fork)
            if missing:
                image.build(np.unique(np.concatenate(missing)), tell)
            else:
                _warm.set()
                sampler.warm = True
    finally:
        image.finish()
    sampler.seconds[image.fits] = seconds
    sampler.keep(image, spaces)
    return counters


def _counts(space: Workspace) -> Counter:
    counts = Counter(space.counts())
    counts.update(getattr(space.shading, "counters", {}))
    return counts
