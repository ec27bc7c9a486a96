"""The front door: a scene and settings become a frame."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, replace
from time import thread_time
from typing import NamedTuple

import numpy as np

from pointmr_engine.image.frame import Frame
from pointmr_engine.numerics.blas import one_blas_thread
from pointmr_engine.scene.group import Group, Instances
from pointmr_engine.scene.recognised import recognised, same_light
from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.settings import RenderSettings
from pointmr_engine.warm import Helper, describe

TILE_SIZES = (128, 64, 32, 16)
MOST_SIZE = 64  # of many samples a pixel
MANY_SAMPLES = 4_000_000  # of an image: worth to fork for, whatever is seen
SPLATTED = ("raytrace", "forward")  # methods that draw samples ...
WALKED = ("raytrace", "conventional", "distributed")  # ... and those that walk rays


class Cancelled(Exception):
    """The progress callback asked to stop."""


class Tile(NamedTuple):
    """A finished part of the image: x, y of its lower left pixel in the rendered region; pixels (h, w, 4) float32."""

    x: int
    y: int
    pixels: np.ndarray


class Compiled(NamedTuple):
    """What is made of a scene's geometry, materials and lights, whatever camera and settings look at it."""

    geometry: object
    programs: list
    acceleration: object  # None where no rays are walked
    lights: object  # likewise
    sampler: object  # forward.method.Sampler, None where nothing is splatted
    warnings: list[str]  # of geometry and materials

    def serves(self, method: str) -> bool:
        """Whether all is there that the method needs."""
        walked = self.acceleration is not None and self.lights is not None
        lit = self.sampler is not None and self.sampler.environment is not None
        return (lit or method not in SPLATTED) and (walked or method not in WALKED)

    def all_warnings(self) -> list[str]:
        """Those of lights and world, too, each once."""
        lit = (self.lights, self.sampler and self.sampler.environment)
        return list(
            dict.fromkeys(self.warnings + [w for kept in lit if kept is not None for w in kept.warnings])
        )

    def without_light(self, same_world: bool) -> Compiled:
        """What is left of it under other lamps, or another world."""
        if self.sampler is not None:
            self.sampler.put_under(self.sampler.environment if same_world else None)
        return self._replace(lights=None)


class Cache:
    """Keeps what `render` compiled of a scene for further renders of it, by other cameras and settings.

    It is used again for scenes of the same objects, and of others with the same content, as frames of an animation
    are (do not change objects in place); where lamps or world alone are others, all but these. A method that needs more
    than was kept adds to it: forward mapping and raytracing share their samples.
    """

    def __init__(self):
        self._seen: Scene | None = None  # the scene that was rendered last, as `recognise` had it
        self._of: Scene | None = None  # what the compiled scene was made of ...
        self._filtered = False  # ... and how
        self._compiled: Compiled | None = None
        self._earlier = None  # the Sampler of the scene before, until the next is compiled
        # a scene's root, and what catchers.separate made of it
        self.separated: tuple[Group, Group, list[Instances]] | None = None

    def recognise(self, scene: Scene) -> Scene:
        """The scene, of the objects of the one before where these are the same in content."""
        if self._seen is not None:
            scene = recognised(scene, self._seen)
        self._seen = scene
        return scene

    def find(self, scene: Scene, filtered: bool) -> Compiled | None:
        """What was kept of this scene, its materials filtered or not, or None."""
        if self._compiled is None or filtered != self._filtered or scene.root is not self._of.root:
            return None
        if not same_light(scene, self._of):
            return self._compiled.without_light(scene.world is self._of.world)
        return self._compiled

    def let_go(self, filtered: bool):
        """Forget what was kept, for there need not be room for it and for another, but for its Sampler: the next scene
        takes from it what it has, too. None where there is none.
        """
        if self._compiled is not None:
            self._earlier, self._compiled = self._compiled.sampler, None
        return self._earlier if filtered == self._filtered else None

    def keep(self, scene: Scene, filtered: bool, compiled: Compiled) -> None:
        self._of, self._filtered, self._compiled, self._earlier = scene, filtered, compiled, None


# numba's dispatchers must not meet new argument types on two threads at once (builds with assertions abort): the first
# tile of a process runs alone.
_warm, _warm_lock = threading.Event(), threading.Lock()

Progress = Callable[[float, str, Tile | None], bool | None]


@one_blas_thread()
def render(
    scene: Scene,
    settings: RenderSettings | None = None,
    progress: Progress | None = None,
    cache: Cache | None = None,
) -> Frame:
    """Render `scene` with the settings' method.

    progress(fraction, text, tile) is called often, from the calling thread; tile is a finished Tile or None. A true
    return value cancels: Cancelled is raised. Raises SceneError for what cannot be rendered, naming it; what was
    skipped or replaced is in the frame's warnings. The image does not depend on the number of threads.
    cache: keeps what was compiled, for the next render of the same scene.
    """
    settings = settings or RenderSettings()
    settings.validate()
    clock = _Clock(progress)
    if settings.method == "conventional":
        settings = replace(settings, samples=1)
    filtered = settings.method != "distributed"  # there the pixel's many rays do it
    if cache is not None:
        clock.phase("comparing scenes")
        scene = cache.recognise(scene)
    scene, deciding = _separated(scene, cache)
    compiled = cache.find(scene, filtered) if cache is not None and scene.camera is not None else None
    helper = Helper()
    try:
        if compiled is None or not compiled.serves(settings.method):
            another = cache is not None and compiled is None
            # no name holds what is let go of, once it has been taken from
            compiled = _compile(
                scene,
                filtered,
                settings,
                clock,
                helper,
                compiled,
                cache.let_go(filtered) if another else None,
            )
            if cache is not None:
                cache.keep(scene, filtered, compiled)
        if deciding:
            from pointmr_engine import shadow_catcher

            def empty(scene, settings):
                return _compile(scene, filtered, settings, clock, helper, None)

            frame, counters, needs = shadow_catcher.render(
                scene, compiled, deciding, settings, clock, _picture, empty
            )
        else:
            frame, counters, needs = _picture(scene, compiled, settings, clock)
    finally:
        helper.stop()
    clock.phase("done")
    geometry = compiled.geometry
    frame.stats.update(
        method=settings.method,
        samples=settings.samples,
        triangles=geometry.instanced_triangles,
        unique_triangles=geometry.unique_triangles,
        nesting=geometry.depth,
        times=clock.times,
        counters=dict(counters),
        needs=needs,
    )
    frame.warnings[:0] = compiled.all_warnings()
    return frame


def _separated(scene: Scene, cache: Cache | None) -> tuple[Scene, list]:
    """The scene with its shadow catchers apart from others, and the batches that decide; none without catchers."""
    from pointmr_engine.scene.catchers import separate

    if cache is None:
        root, deciding = separate(scene.root)
    else:
        if cache.separated is None or cache.separated[0] is not scene.root:
            cache.separated = scene.root, *separate(scene.root)
        _, root, deciding = cache.separated
    return (replace(scene, root=root), deciding) if deciding else (scene, [])


class _Clock:
    """Times the phases, and asks the progress callback whether to go on."""

    def __init__(self, progress: Progress | None):
        self.progress = progress
        self.picture, self.pictures = 0, 1  # which of several pictures of one image is rendered
        self.times: dict[str, float] = {}
        self._phase = ""
        self._start = time.perf_counter()

    def phase(self, name: str) -> None:
        now = time.perf_counter()
        if self._phase:
            self.times[self._phase] = self.times.get(self._phase, 0.0) + now - self._start
        self._phase, self._start = name, now
        self.tell(0.0)

    def tell(self, fraction: float, tile: Tile | None = None) -> None:
        fraction = (self.picture + fraction) / self.pictures
        if self.picture:
            tile = None  # of what is no picture in itself
        if self.progress is not None and self.progress(fraction, self._phase, tile):
            raise Cancelled("the render was cancelled")


def _compile_surfaces(scene: Scene, filtered: bool, clock: _Clock) -> Compiled:
    """Geometry and materials, which every method needs."""
    from pointmr_engine.hierarchy.geometry import compile_geometry
    from pointmr_engine.hierarchy.layers import even_layers
    from pointmr_engine.scene.material import Material
    from pointmr_engine.shading.program import compile_graph

    clock.phase("compiling materials")
    geometry = compile_geometry(scene)
    warnings: list[str] = []
    if any(m is not None and m.moves_vertices for m in geometry.materials):
        from pointmr_engine.displacement import displaced

        geometry, warnings = displaced(geometry)
    plain = Material("no material")
    programs = []
    for index, material in enumerate(geometry.materials):
        graph = (material or plain).surface_graph
        program = compile_graph(graph, filtered=filtered)
        even = even_layers(geometry, index, program.fine_reads | program.normal_reads)
        if even:
            program = compile_graph(graph, filtered=filtered, even=even)
        programs.append(program)
        warnings += [f"material '{(material or plain).name}': {w}" for w in program.warnings]
    return Compiled(geometry, programs, None, None, None, warnings)


def _compile(
    scene: Scene,
    filtered: bool,
    settings: RenderSettings,
    clock: _Clock,
    helper: Helper,
    known: Compiled | None,
    earlier=None,
) -> Compiled:
    """Compile what neither camera nor settings change. known: what another method compiled of the same scene.

    earlier: the Sampler of another scene, some of whose objects this one has, too.
    """
    clock.phase("checking the scene")
    warnings = scene.validate() if known is None else []
    clock.phase("loading kernels")
    splatted, walked = settings.method in SPLATTED, settings.method in WALKED
    if settings.threads != 1 and walked:
        helper.start()
    known = known or _compile_surfaces(scene, filtered, clock)
    geometry, programs, acceleration, lights, sampler, found = known
    warnings += found
    if walked:
        helper.begin(describe(scene, programs, settings))
    environment = next((kept.environment for kept in (lights, sampler) if kept is not None), None)
    if environment is None:
        from pointmr_engine.raytracing.environment import Environment

        clock.phase("reading the world")
        environment = Environment(scene.world)
    if (splatted and sampler is None) or (walked and acceleration is None):
        clock.phase("building hierarchies")
    if splatted and sampler is None:
        from pointmr_engine.forward.method import Sampler

        sampler = Sampler(geometry, programs, environment, clock.tell, earlier, settings.threads)
    elif splatted and sampler.environment is None:
        sampler.put_under(environment)
    if walked and acceleration is None:
        from pointmr_engine.hierarchy.acceleration import build_acceleration, set_opaque

        acceleration = build_acceleration(geometry, progress=clock.tell)
        acceleration = set_opaque(acceleration, np.array([p.opaque for p in programs], np.bool_))
    if walked and lights is None:
        from pointmr_engine.raytracing.lights import build_lights

        clock.phase("gathering lights")
        lights = build_lights(scene, geometry, programs, environment)
    return Compiled(geometry, programs, acceleration, lights, sampler, warnings + geometry.warnings)


def _picture(
    scene: Scene, compiled: Compiled, settings: RenderSettings, clock: _Clock
) -> tuple[Frame, Counter, dict]:
    """The frame, counters, and what was needed."""
    if settings.method in SPLATTED:
        return _splat(scene, compiled, settings, clock)
    stage = _prepare(scene, compiled, settings, clock)
    clock.phase("rendering")
    frame, counters = _render_tiles(stage, settings, clock)
    return frame, counters, asdict(stage.needs)


def _splat(
    scene: Scene, compiled: Compiled, settings: RenderSettings, clock: _Clock
) -> tuple[Frame, Counter, dict]:
    """Methods forward and raytrace: the frame, counters, and what was needed."""
    from pointmr_engine.forward.method import Image, render_image
    from pointmr_engine.image.film import Film
    from pointmr_engine.raytracing.camera import compile_camera

    found: list[str] = []  # by looking at the scene once more
    if settings.method == "raytrace":
        from pointmr_engine.multires.cone_light import sampled_lights
        from pointmr_engine.multires.method import FRAGMENTS, TracedImage

        if settings.raytrace.secondary == "cones":
            lights = sampled_lights(scene, compiled.sampler, compiled.lights)
            found = [w for w in lights.warnings if w not in compiled.all_warnings()]
            compiled = compiled._replace(lights=lights)
        stage = _prepare(scene, compiled, replace(settings, passes=("combined",), samples=FRAGMENTS), clock)
        image = TracedImage(compiled.sampler, scene, stage, settings)
    else:
        image = Image(compiled.sampler, scene, compile_camera(scene.camera, settings), settings)
    frame = Film(settings).frame
    clock.phase("rendering")
    counters = render_image(
        image, frame, lambda fraction, tile: clock.tell(fraction, None if tile is None else Tile(*tile))
    )
    frame.warnings += found + image.warnings + image.sets.take_warnings()
    return frame, counters, image.needs()


def _prepare(scene: Scene, compiled: Compiled, settings: RenderSettings, clock: _Clock):
    """All that the integrator reads, as a Stage."""
    clock.phase("loading kernels")
    from pointmr_engine.needs import decide_needs
    from pointmr_engine.raytracing.camera import compile_camera
    from pointmr_engine.raytracing.integrator import Stage
    from pointmr_engine.raytracing.path_arrays import limits_of
    from pointmr_engine.raytracing.shade import Shader
    from pointmr_engine.shading.bsdf.albedo_tables import load_tables

    geometry, programs, acceleration, lights, *_ = compiled
    camera = compile_camera(scene.camera, settings)
    needs = decide_needs(programs, lights, settings, lens=bool(camera.lens[0] > 0.0))
    index = [0 if m is None else m.pass_index for m in geometry.materials]
    return Stage(
        acceleration,
        Shader(geometry, programs, settings, load_tables()),
        lights,
        camera,
        settings,
        needs,
        limits_of(settings, only_met=lights.only_met),
        np.array(index, np.int32),
    )


def _tile_size(width: int, height: int, samples: int, batch: int) -> int:
    """Tiles small enough to share out among threads; it must not depend on how many there are.

    Of few samples a pixel, tiles are larger: what takes many steps, each for few paths, is paid once a batch.
    """
    for size in TILE_SIZES:
        few = size * size * samples <= batch // 4
        if (few or size <= MOST_SIZE) and -(-width // size) * -(-height // size) >= (4 if few else 16):
            return size
    return TILE_SIZES[-1]


def _render_tiles(stage, settings: RenderSettings, clock: _Clock) -> tuple[Frame, Counter]:
    from pointmr_engine.image.film import Film
    from pointmr_engine.image.tile_workers import (
        can_fork,
        finished_tiles,
        share_passes,
        shared_zeros,
        worth_a_fork,
    )
    from pointmr_engine.raytracing.integrator import BATCH, Workspace

    film = Film(settings)
    x0, y0, x1, y1 = film.region
    tiles = film.tiles(_tile_size(x1 - x0, y1 - y0, settings.samples, BATCH))
    spaces: list[Workspace] = []  # that no thread uses
    stop, total = threading.Event(), (x1 - x0) * (y1 - y0) * settings.samples
    done = shared_zeros((len(tiles),), np.int64)  # samples of each tile
    place = {bounds: k for k, bounds in enumerate(tiles)}
    counters: Counter = Counter()
    apart = settings.processes and can_fork(len(tiles), settings.threads)
    seconds: dict[tuple, float] = {}  # of a core, by tile

    def work(bounds):
        begun = thread_time()
        try:
            space = spaces.pop()
        except IndexError:
            space = Workspace(stage, BATCH)
        space.counters.clear()
        sums, done[place[bounds]] = film.tile(bounds), 0
        pixels = (bounds[2] - bounds[0]) * (bounds[3] - bounds[1])
        chunk = max(1, BATCH // pixels)
        for first in range(0, settings.samples, chunk):
            if stop.is_set():
                return None
            count = min(chunk, settings.samples - first)
            space.render_tile(sums, first, count)
            done[place[bounds]] += pixels * count
        film.finish_tile(sums)
        counted = space.counters.copy()
        spaces.append(space)
        return bounds, counted, film.bad[bounds], thread_time() - begun

    def render(tiles, apart):
        warnings = film.frame.warnings
        with closing(finished_tiles(work, tiles, settings.threads, apart, warnings, stop)) as finished:
            for tile in finished:
                if tile is not None:
                    bounds, counted, film.bad[tile[0]], seconds[tile[0]] = tile
                    left, low, right, high = bounds
                    counters.update(counted)
                    block = film.frame.passes["combined"][low - y0 : high - y0, left - x0 : right - x0]
                    clock.tell(float(done.sum()) / total, Tile(left - x0, low - y0, block.copy()))
                clock.tell(float(done.sum()) / total)

    with _warm_lock:
        if not _warm.is_set():
            render([tiles.pop(len(tiles) // 2)], False)
            _warm.set()
    many = total >= MANY_SAMPLES
    if apart and not many and not seconds:  # one tells how long the others will take
        render([tiles.pop(len(tiles) // 2)], False)
    fork = apart and (many or worth_a_fork(tiles, seconds))
    if fork:
        share_passes(film.frame)
    render(tiles, fork)
    return film.result(), counters
