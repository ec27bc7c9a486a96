"""Renders without a window: opens a .blend file in the bpy module, sets what was asked for, and writes the images.

It goes through Blender's own render call, for only that evaluates a scene as F12 does (render visibility, render
levels of modifiers). An observer takes the engine's frames on their way, so that files hold exactly what the engine
computed.
"""

from __future__ import annotations

import os
import platform
import re
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

from . import kernel_cache
from .observer import Observer, follow

BAD_INPUT, FAILED, UNWRITABLE, INTERRUPTED = 2, 1, 3, 130  # exit codes
_MAGIC = (b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b")  # plain, zstandard, gzip


class CommandError(Exception):
    """What ends a command, in words for the user; `code` is the exit code."""

    def __init__(self, message: str, code: int = BAD_INPUT):
        super().__init__(message)
        self.code = code


@dataclass
class Options:
    """What a render was asked for; None: as the file has it."""

    file: Path
    output: str  # pattern: #### is the frame number
    method: str | None = None
    samples: int | None = None
    size: tuple[int, int] | None = None
    camera: str | None = None
    seed: int | None = None
    threads: int | None = None
    as_cycles: bool = False  # what PointMR shares with Cycles' settings, as those have it
    scripts: bool = False
    compositing: bool = False
    png: bool = False
    half: bool = False
    own: dict[str, str | bool] = field(default_factory=dict)  # a method's property of scene.pointmr: as typed


@dataclass
class Rendered:
    """One frame: the files written, seconds by phase, counts and warnings."""

    frame: int
    files: list[str]
    seconds: dict[str, float] = field(default_factory=dict)
    stats: dict = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def output_path(pattern: str, frame: int, several: bool) -> Path:
    """`pattern` with its last run of # replaced by the frame number; without one it is added if frames are `several`.

    A path without an image extension gets .exr.
    """
    path = Path(pattern)
    name = path.name if path.suffix.lower() in (".exr", ".png") else path.name + ".exr"
    runs = list(re.finditer("#+", name))
    if runs:
        a, b = runs[-1].span()
        name = f"{name[:a]}{frame:0{b - a}d}{name[b:]}"
    elif several:
        stem, suffix = os.path.splitext(name)
        name = f"{stem}_{frame:04d}{suffix}"
    return path.with_name(name)


def output_files(options: Options, frame: int, several: bool) -> list[Path]:
    """The files of one frame: what was named, and a PNG beside it on request."""
    path = output_path(options.output, frame, several)
    return [path, path.with_suffix(".png")] if options.png and path.suffix.lower() == ".exr" else [path]


def check_blend(path: Path) -> None:
    """Raise CommandError unless `path` is a file that begins as .blend files do."""
    if not path.exists():
        raise CommandError(f"no such file: {path}")
    if not path.is_file():
        raise CommandError(f"not a file: {path}")
    try:
        with path.open("rb") as file:
            head = file.read(8)
    except OSError as error:
        raise CommandError(f"cannot read {path}: {error.strerror}") from error
    if not head.startswith(_MAGIC):
        raise CommandError(f"not a .blend file: {path}")


def check_writable(path: Path) -> None:
    """Make the folder of `path` and raise CommandError if no file can be made there, before time is spent."""
    import tempfile

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
        if path.is_dir():
            raise IsADirectoryError(21, "it is a folder")
    except OSError as error:
        raise CommandError(f"cannot write {path}: {error.strerror or error}", UNWRITABLE) from error


@contextmanager
def quiet(active: bool = True) -> Iterator[None]:
    """Blender's own lines on standard output go nowhere meanwhile."""
    if not active:
        yield
        return
    sys.stdout.flush()
    saved, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(saved, 1)
        os.close(saved)
        os.close(nowhere)


def load_bpy():
    """The bpy module with PointMR registered in it."""
    try:
        import bpy
    except ImportError as error:
        raise CommandError(
            f"Blender's Python module does not load ({error}); install it with: pip install 'pointmr[blender]'"
        ) from error
    from . import register

    register()
    return bpy


def open_blend(path: Path, scripts: bool, verbose: bool = False):
    """Open a .blend file and return its scene. Its Python scripts and drivers run only if `scripts`."""
    check_blend(path)
    with quiet(not verbose):
        bpy = load_bpy()
        bpy.context.preferences.filepaths.use_scripts_auto_execute = scripts
        try:
            bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False, use_scripts=scripts)
        except RuntimeError as error:
            raise CommandError(f"Blender cannot open {path}: {_plain(error)}") from error
    return bpy.context.scene


def _plain(error: BaseException) -> str:
    """A Blender error's words, without its prefixes and line ends."""
    return "; ".join(line.removeprefix("Error: ").strip() for line in str(error).splitlines() if line.strip())


def apply_options(scene, options: Options) -> None:
    """Set what was asked for on Blender's scene. Raises CommandError, naming what the file does not have."""
    import bpy

    scene.render.engine = "POINTMR"
    scene.render.use_sequencer = False
    scene.render.use_compositing = options.compositing
    own = scene.pointmr
    if options.as_cycles:
        from .operators import take_from_cycles

        try:
            take_from_cycles(scene)
        except ValueError as error:
            raise CommandError(str(error)) from error
    if options.method is not None:
        set_property(own, "method", options.method)
    if options.samples is not None:
        own.samples = options.samples
        if own.method == "FORWARD":
            set_property(own, "forward_samples_per_pixel", str(options.samples), "samples")
        elif own.method == "RAYTRACE":
            raise CommandError(
                "--samples is not of method raytrace, which takes --cones; or choose another --method"
            )
    for name, value in options.own.items():
        method, option = name.partition("_")[0], option_of(name)
        if own.method != method.upper():
            raise CommandError(f"--{option} is of method {method}, not {own.method.lower()}")
        set_property(own, name, value, option)
    if options.seed is not None:
        own.seed, own.use_animated_seed = options.seed, False
    if options.size is not None:
        scene.render.resolution_x, scene.render.resolution_y = options.size
        scene.render.resolution_percentage = 100
    if options.threads is not None:
        scene.render.threads_mode = "AUTO" if options.threads == 0 else "FIXED"
        scene.render.threads = max(options.threads, 1)
    cameras = [ob.name for ob in scene.objects if ob.type == "CAMERA"]
    if options.camera is not None:
        if options.camera not in cameras:
            raise CommandError(f"no camera '{options.camera}'; there are: {', '.join(cameras) or 'none'}")
        scene.camera = bpy.data.objects[options.camera]
        for marker in scene.timeline_markers:
            marker.camera = None  # a bound marker would take the camera back
    if scene.camera is None:
        hint = f"; choose one with --camera: {', '.join(cameras)}" if cameras else ""
        raise CommandError(f"scene '{scene.name}' has no camera{hint}")


def option_of(name: str) -> str:
    """The command's option for a method's property of scene.pointmr; the main method's have no prefix."""
    return name.removeprefix("raytrace_").replace("_", "-")


def set_property(group, name: str, value: str | bool, option: str = "") -> None:
    """Set a property as typed on the command line. Raises CommandError for what Blender would refuse or clamp.

    option: the option's name, if it is not the property's.
    """
    what = option or name.replace("_", "-")
    rna = group.bl_rna.properties[name]
    if rna.type == "ENUM":
        choices = [item.identifier for item in rna.enum_items]
        if str(value).upper() not in choices:
            raise CommandError(f"no {what} '{value}'; there are: {', '.join(choices).lower()}")
        value = str(value).upper()
    elif rna.type == "FLOAT":
        try:
            number = float(value)
        except ValueError as error:
            raise CommandError(f"--{what}: '{value}' is not a number") from error
        # they are single floats
        low, high = (float(f"{limit:.6g}") for limit in (rna.hard_min, rna.hard_max))
        if not low <= number <= high:
            raise CommandError(f"--{what}: {value} is outside {low:g} to {high:g}")
        value = number
    setattr(group, name, value)


class FrameObserver(Observer):
    """Keeps one render's frames, counts, messages and times, and passes on progress."""

    def __init__(self, on_progress=None, on_message=None, export_only: bool = False):
        self.on_progress, self.on_message, self.export_only = on_progress, on_message, export_only
        self.interrupted = False
        self.begin()

    def begin(self) -> None:
        """Forget the last render; the clock starts."""
        self.frames: dict[str, object] = {}
        self.scenes: dict[str, object] = {}
        self.settings = None
        self.errors: list[str] = []
        self.warnings: list[str] = []
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, phase: str) -> None:
        """Count the time since the last lap as `phase`."""
        now = time.perf_counter()
        self.seconds[phase] = self.seconds.get(phase, 0.0) + now - self._last
        self._last = now

    def stopped(self) -> bool:
        return self.interrupted or (self.export_only and bool(self.scenes))

    def reading(self, layer):
        self.lap("blender")

    def exported(self, layer, scene, settings):
        self.lap("sync")
        self.settings = settings
        self.scenes[layer] = scene if self.export_only else None

    def finished(self, layer, frame):
        self.lap("render")
        self.frames[layer] = frame

    def progress(self, fraction, text):
        if self.on_progress is not None:
            self.on_progress(fraction, text)

    def message(self, level, text):
        text = text.removeprefix("PointMR: ")
        if level == "ERROR":
            self.errors.append(text)
        elif level == "WARNING":
            self.warnings.append(text)
        if self.on_message is not None:
            self.on_message(level, text)


class interruptible:
    """Ctrl-C asks the observer's render to stop, at once and cleanly; a second one ends the process."""

    def __init__(self, observer: FrameObserver):
        self.observer = observer

    def __enter__(self):
        def stop(*_):
            self.observer.interrupted = True
            signal.signal(signal.SIGINT, signal.SIG_DFL)

        self.previous = signal.signal(signal.SIGINT, stop)
        return self

    def __exit__(self, kind, error, trace):
        signal.signal(signal.SIGINT, self.previous)
        if kind is None and self.observer.interrupted:
            raise KeyboardInterrupt


def run_render(observer: FrameObserver, verbose: bool = False) -> None:
    """Blender's render call with `observer` following. Raises KeyboardInterrupt, or CommandError with the cause."""
    import bpy

    observer.begin()
    follow(observer)
    try:
        with quiet(not verbose):
            bpy.ops.render.render()
    except RuntimeError as error:
        observer.errors = observer.errors or [_plain(error)]
    finally:
        follow(None)
    if observer.interrupted:
        raise KeyboardInterrupt
    if observer.errors and not (observer.export_only and observer.scenes):
        raise CommandError(observer.errors[0], FAILED)


def render_frame(
    scene, frame: int, files: list[Path], options: Options, observer: FrameObserver, verbose=False
):
    """Render one frame of the open file and write it; returns a Rendered. Errors as `run_render`, unwritable files."""
    from pointmr_engine.image import exr
    from pointmr_engine.scene.errors import SceneError

    cold = kernel_cache.is_cold()
    scene.frame_current = frame
    run_render(observer, verbose)
    if not observer.frames:
        raise CommandError("Blender rendered nothing: no view layer is enabled for rendering", FAILED)
    first = next(iter(observer.frames.values()))
    aspect = scene.render.pixel_aspect_x / scene.render.pixel_aspect_y
    try:
        for path in files:
            if path.suffix.lower() == ".png":
                save_view(scene, path)
            else:
                metadata = {"Camera": scene.camera.name, "Frame": f"{frame:03d}", "Scene": scene.name}
                exr.write(path, observer.frames, half=options.half, pixel_aspect=aspect, metadata=metadata)
    except SceneError as error:
        raise CommandError(str(error), UNWRITABLE) from error
    observer.lap("write")
    stats = dict(first.stats, cold=cold, settings=asdict(observer.settings))
    return Rendered(frame, [str(p) for p in files], dict(observer.seconds), stats, observer.warnings)


def save_view(scene, path: Path) -> None:
    """Blender's render result as an 8-bit PNG through the scene's own view transform (as its Save Image does)."""
    import bpy

    from pointmr_engine.image.files import whole_file

    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_depth = "PNG", "8"
    image.color_mode = "RGBA" if scene.render.film_transparent else "RGB"
    with whole_file(path) as part:
        bpy.data.images["Render Result"].save_render(str(part), scene=scene)


def peak_memory() -> int:
    """Peak resident memory of this process, and of those that rendered tiles for it what was their own, in bytes."""
    from pointmr_engine.image.tile_workers import most_memory

    if sys.platform == "win32":
        import psutil

        return psutil.Process().memory_info().peak_wset
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most_memory() + (peak if platform.system() == "Darwin" else peak * 1024)
