"""First use: while the renderer compiles its kernels in order of use, a second process compiles them from the end.

numba compiles in one thread only and keeps what it compiled on disk, where it looks before it compiles anything: so
the two meet in the middle, and a machine with two cores waits little more than half as long. The second process
only ever adds files to the kernels' cache. It ends with the renderer, however that ends, for it then reads the end
of its standard input; where it cannot be started nothing is lost but time.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from functools import cached_property
from pathlib import Path

import numpy as np

from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.settings import RenderSettings

_BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.stdin.readline()); "
    "from pointmr_engine.warm import serve; serve()"
)
_SIZE = 16  # room for points; hardly any is used


def is_cold() -> bool:
    """Whether the kernel that a render compiles last is not on disk."""
    from pointmr_engine.raytracing.paths import move

    try:
        folder = Path(move._cache.cache_path)
    except AttributeError:  # another numba, or one told not to compile
        return False
    tag = f"paths.move-*.py{sys.version_info.major}{sys.version_info.minor}*.nbi"
    return next(folder.glob(tag), None) is None


def is_python(executable: str | None) -> bool:
    """Whether this is a Python interpreter, by its name: a program that embeds Python may name itself instead."""
    return (
        bool(executable) and re.fullmatch(r"python[\d.]*(\.exe)?", Path(executable).name.lower()) is not None
    )


def describe(scene: Scene, programs: list, settings: RenderSettings) -> dict:
    """What of the kernels a scene with these materials needs, as plain values for the second process."""
    lamps = [light.kind for light in scene.lights]
    return {
        "leaves": sorted({leaf.kind for p in programs for leaf in p.leaves}),
        "max_lobes": max((p.max_lobes for p in programs), default=1),
        "transparent": any(not p.opaque for p in programs),
        "emissive": any(p.emissive for p in programs),
        "lamps": lamps,
        "met_lamps": any(light.radius > 0 or light.kind in ("SUN", "AREA") for light in scene.lights),
        "passes": list(settings.passes),
        "several_bounces": settings.max_bounces > 0,
    }


class Helper:
    """The second process: `start` lets it import, `begin` says what to compile, `stop` ends it. None of them raises."""

    def __init__(self):
        self._process: subprocess.Popen | None = None

    def start(self, python: str | None = None) -> None:
        """Start the process where it helps: kernels are not on disk yet, and there are a core and a Python for it."""
        python = python or sys.executable
        if not is_python(python) or getattr(sys, "frozen", False) or (os.cpu_count() or 1) < 2:
            return
        if not is_cold():
            return
        environment = dict(os.environ)
        numba = sys.modules.get("numba")
        if numba is not None and numba.config.CACHE_DIR:
            environment["NUMBA_CACHE_DIR"] = numba.config.CACHE_DIR
        try:
            self._process = subprocess.Popen(
                [python, "-c", _BOOT],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=environment,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
            here = str(Path(__file__).resolve().parents[1])
            self._write([here, *(p for p in sys.path if p)])
        except OSError:
            self.stop()

    def _write(self, value) -> None:
        self._process.stdin.write(json.dumps(value).encode() + b"\n")
        self._process.stdin.flush()

    def begin(self, wanted: dict) -> None:
        """Compile what `describe` said."""
        if self._process is not None:
            try:
                self._write(wanted)
            except (OSError, ValueError):
                self.stop()

    def stop(self) -> None:
        """End the process, between two files. Later calls do nothing."""
        process, self._process = self._process, None
        if process is None:
            return
        try:
            process.stdin.close()
        except OSError:
            pass
        try:
            process.wait(2.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def wait(self) -> None:
        """Until all is compiled."""
        if self._process is not None:
            self._process.wait()


def serve() -> None:
    """The second process: reads what is wanted, compiles it, and ends at once when its input does."""
    import threading

    line = sys.stdin.readline()
    if not line:
        return
    saving = threading.Lock()

    def watch():
        while sys.stdin.readline():
            pass
        with saving:
            os._exit(0)

    threading.Thread(target=watch, daemon=True).start()
    save_beside(saving)
    compile_all(json.loads(line))


def save_beside(saving) -> None:
    """Let this process' kernels be written to files of its own.

    numba numbers a function's files and notes each in an index before it writes it. Two processes that compile one
    function for different types at once could give both the same number, and one would load the other's code. So
    this process takes numbers at random, and notes a file only when it is there.
    """
    import secrets

    from numba.core.caching import IndexDataCacheFile

    def save(self, key, data):
        with saving:
            if key in self._load_index():
                return
            name = self._data_name(1_000_000 + secrets.randbits(40))
            self._save_data(name, data)
            overloads = self._load_index()
            overloads[key] = name
            self._save_index(overloads)

    IndexDataCacheFile.save = save


def compile_all(wanted: dict) -> None:
    """Compile the kernels of `wanted` (see `describe`), the last used first."""
    kernels = _Kernels(wanted)
    kernels.scatter()
    if wanted["lamps"] or wanted["emissive"]:
        kernels.direct_light()
    kernels.bounces()
    for kind in wanted["leaves"]:
        kernels.leaf(kind)
    kernels.film()
    kernels.light_sampling()
    kernels.met_lights()
    kernels.frames()
    kernels.camera_rays()


class _Kernels:
    """A render of a small scene, whose stages are called for no paths: types cannot differ from the renderer's."""

    def __init__(self, wanted: dict):
        from pointmr_engine.image.film import Film
        from pointmr_engine.raytracing.integrator import Workspace

        self.wanted = wanted
        self.settings = RenderSettings(16, 16, samples=1, passes=tuple(wanted["passes"]))
        self.space = Workspace(self._stage(), _SIZE)
        self.tile = Film(self.settings).tile((0, 0, 4, 4))
        self.now, self.then = self.space.queues
        self.alive = np.zeros(_SIZE, np.bool_)
        self.none = np.zeros(0, np.int64)  # rows

    @cached_property
    def scene(self) -> Scene:
        from pointmr_engine import Camera, Group, Light, Mesh, emission, principled, uniform_world

        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
        material = emission("shining", (1, 1, 1), 1.0) if self.wanted["emissive"] else principled("plain")
        mesh = Mesh("triangle", corners, np.array([[0, 1, 2]], np.int32), materials=(material,))
        lights = [Light(kind, np.eye(4), power=1.0, radius=0.1) for kind in sorted(set(self.wanted["lamps"]))]
        return Scene(Group("root", [mesh]), Camera(np.eye(4)), lights, uniform_world((1, 1, 1)))

    @cached_property
    def geometry(self):
        from pointmr_engine.hierarchy.geometry import compile_geometry

        return compile_geometry(self.scene)

    @cached_property
    def programs(self) -> list:
        from pointmr_engine.shading.program import compile_graph

        return [compile_graph(m.graph) for m in self.geometry.materials]

    @cached_property
    def lights(self):
        from pointmr_engine.raytracing.lights import build_lights

        return build_lights(self.scene, self.geometry, self.programs)

    def _stage(self):
        """The renderer's Stage, without its hierarchy and lights."""
        from pointmr_engine.needs import Needs
        from pointmr_engine.raytracing.camera import compile_camera
        from pointmr_engine.raytracing.integrator import Stage
        from pointmr_engine.raytracing.path_arrays import limits_of
        from pointmr_engine.raytracing.shade import Shader
        from pointmr_engine.shading.bsdf.albedo_tables import load_tables

        wanted, settings = self.wanted, self.settings
        needs = Needs(
            max_lobes=wanted["max_lobes"],
            light_samples=True,
            stray_light=True,
            transparent_shadows=wanted["transparent"],
            window=False,
            lens=False,
            surface_passes=tuple(p for p in settings.passes if p not in ("combined", "sample_count")),
        )
        shader = Shader(self.geometry, self.programs, settings, load_tables())
        camera = compile_camera(self.scene.camera, settings)
        return Stage(None, shader, None, camera, settings, needs, limits_of(settings), np.zeros(1, np.int32))

    def scatter(self) -> None:
        self.space.move(self.now, self.then, 0, self.alive)
        self.space.scatter(self.now, 0, self.alive, 1)

    def direct_light(self) -> None:
        from pointmr_engine.raytracing.frames import veil_frames
        from pointmr_engine.raytracing.light_sampling import LightSamples

        if self.wanted["transparent"]:
            veil_frames(self.geometry, self.space.veil_hits, 0, self.space.veil_frames)
            self.space.dim(self.space.waiting[:0], np.zeros(0, np.int64), np.zeros((0, 3), np.float32))
        self.space.settle(0)
        if self.space.raises:
            self.space.raise_origins(0)
        none = LightSamples(*(a[:0] for a in self.space.light_samples))
        self.space.connect(self.now, 0, none)
        self.space.choose_points(self.now, 0, self.alive, 1)

    def bounces(self) -> None:
        if self.wanted["transparent"] or self.wanted["several_bounces"]:
            self.space.roulette(self.now, 0, self.alive, 1)
        self.space.finish(self.now, 0, self.alive)

    def leaf(self, kind: int) -> None:
        from pointmr_engine.shading import lobes
        from pointmr_engine.shading.leaves import COLUMNS, Leaf

        view, shader = self.space.view, self.space.stage.shader
        leaf = Leaf(kind, np.zeros((1, len(COLUMNS[kind])), np.float32))
        lobes.append(self.space.lobes, leaf, np.zeros(1, np.int64), view, shader.tables)

    def film(self) -> None:
        from pointmr_engine.image import film
        from pointmr_engine.raytracing import paths

        space, s = self.space, self.space.samples
        film.add_light(self.tile, s.pixel, s.radiance, s.transparency, 0, 0)
        paths.add_radiance(self.now, s, space.stage.limits, np.zeros((0, 3), np.float32), np.zeros(0), 0)

    def light_sampling(self) -> None:
        self.space.stage.lights = self.lights
        if self.lights.empty:
            return
        self.space.sample_lights(0)

    def met_lights(self) -> None:
        rows, now, hits = self.none, self.now, self.space.hits
        origin, direction = now.rays.origin[rows], now.rays.direction[rows]
        normal, transmissive = now.origin_normal[rows], now.origin_transmissive[rows]
        if self.wanted["emissive"]:
            self.lights.emitter_pdf(
                hits.path[rows], hits.triangle[rows], origin, normal, transmissive, direction, hits.t[rows]
            )
        self.lights.world_pdf(origin, normal, transmissive, direction)
        self.lights.seen_lamps(
            origin, direction, now.rays.t_min[:0], hits.t[:0], now.rays.visibility[:0], normal, transmissive,
            now.bsdf_pdf[:0], np.zeros((0, 3), np.float32),
        )  # fmt: skip

    def frames(self) -> None:
        from pointmr_engine.raytracing.frames import frames
        from pointmr_engine.raytracing.shade import fill_view, rows_by_material

        space = self.space
        rows_by_material(space.frames.material, self.alive, 0, 1, space.order)
        fill_view(self.now.rays, self.now.state.kind, space.frames, space.view, 0)
        frames(self.geometry, self.now.rays, space.hits, space.frames, 0, 0)

    def camera_rays(self) -> None:
        self.space.start(0, 0, 0, 0, 0, 0)
