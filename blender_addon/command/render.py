"""`pointmr render`: frames of a .blend file to image files, here or in several processes."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

from .. import batch
from ..headless import (
    FAILED,
    UNWRITABLE,
    CommandError,
    FrameObserver,
    Options,
    apply_options,
    check_blend,
    check_writable,
    interruptible,
    open_blend,
    option_of,
    output_files,
    output_path,
    peak_memory,
    render_frame,
)
from .report import Report, count, plain


def _options(a: argparse.Namespace) -> Options:
    output = a.output or str(Path("out") / a.file.with_suffix(".exr").name)
    names = (
        "method",
        "samples",
        "size",
        "camera",
        "seed",
        "threads",
        "as_cycles",
        "scripts",
        "compositing",
        "png",
        "half",
    )
    return Options(a.file, output, **{name: getattr(a, name) for name in names}, own=_own(a))


def _own(a: argparse.Namespace) -> dict[str, str | bool]:
    """The options of single methods that were given."""
    methods = ("forward_", "raytrace_")
    return {name: value for name, value in vars(a).items() if name.startswith(methods) and value is not None}


def command_render(a: argparse.Namespace) -> int:
    """`pointmr render`."""
    options = _options(a)
    check_blend(a.file)
    check_writable(output_path(options.output, 1, False))
    if a.stats is not None:
        check_writable(a.stats)
    if a.worker:
        return run_worker(options, a)
    opened = None
    frames = a.frames
    if frames is None:
        opened = Opened(options, a.verbose)
        frames = [opened.scene.frame_current]
    several = a.frames is not None and len(frames) > 1
    try:
        frames = batch.share(frames, a.part)
    except ValueError as error:
        raise CommandError(str(error)) from error
    kept = []
    if a.keep_existing:
        kept = [f for f in frames if all(p.exists() for p in output_files(options, f, several))]
        frames = [f for f in frames if f not in set(kept)]
        if kept:
            print(f"kept {count(len(kept), 'frame')} that exist")
    report = Report(options, several, len(frames))
    failed = []
    try:
        if a.jobs > 1 and len(frames) > 1:
            failed = render_in_processes(a, frames, several, report)
        elif frames:
            failed = render_here(opened or Opened(options, a.verbose), frames, several, report)
    finally:
        report.close()
        if a.stats is not None:
            write_stats(a.stats, report.frames, kept, failed)
    return FAILED if failed else 0


class Opened:
    """The .blend file, open, and how long that took."""

    def __init__(self, options: Options, verbose: bool):
        start = time.perf_counter()
        self.options, self.verbose = options, verbose
        self.scene = open_blend(options.file, options.scripts, verbose)
        self.seconds = time.perf_counter() - start


def render_here(opened: Opened, frames: list[int], several: bool, report: Report) -> list[int]:
    """Render frames one after the other in this process; returns those that failed (input errors are raised)."""
    options = opened.options
    apply_options(opened.scene, options)
    keep_between(opened.scene, several)
    warn_about_scripts(report, options)
    failed = []
    frame = frames[0]
    observer = FrameObserver(lambda fraction, text: report.progress(frame, fraction, text), report.message)
    with interruptible(observer):
        for frame in frames:
            report.begin(frame)
            try:
                files = output_files(options, frame, several)
                rendered = render_frame(opened.scene, frame, files, options, observer, opened.verbose)
                if frame == frames[0]:
                    rendered.seconds = {"open": opened.seconds, **rendered.seconds}
                report.done(vars(rendered), peak_memory())
            except CommandError as error:
                if error.code != FAILED or len(frames) == 1:
                    raise
                report.failed(frame, str(error))
                failed.append(frame)
    return failed


def render_in_processes(a: argparse.Namespace, frames, several: bool, report: Report) -> list[int]:
    """Render frames in `--jobs` processes; returns those that failed."""
    arguments = [str(a.file), "--output", _options(a).output]
    for name in ("method", "samples", "camera", "seed"):
        if getattr(a, name) is not None:
            arguments += [f"--{name}", str(getattr(a, name))]
    if a.size is not None:
        arguments += ["--size", f"{a.size[0]}x{a.size[1]}"]
    threads = a.threads if a.threads is not None else max((os.cpu_count() or 1) // a.jobs, 1)
    arguments += ["--threads", str(threads)]
    switches = ("as_cycles", "png", "half", "compositing", "scripts")
    arguments += [f"--{name.replace('_', '-')}" for name in switches if getattr(a, name)]
    for name, value in _own(a).items():
        option = option_of(name)
        arguments += (
            [f"--{'' if value else 'no-'}{option}"] if isinstance(value, bool) else [f"--{option}", value]
        )
    arguments += ["--frames", f"{frames[0]}-{frames[-1]}"] if several else []

    def on_event(event: dict) -> None:
        kind = event["event"]
        if kind == "progress":
            report.progress(event["frame"], event["fraction"], event["text"])
        elif kind == "message":
            report.message(event["level"], event["text"])
        elif kind == "done":
            report.done(event["rendered"], event["memory"])
        else:
            report.failed(event["frame"], event["error"])

    return batch.render_frames(batch.worker_command(arguments), frames, a.jobs, on_event)[1]


def run_worker(options: Options, a: argparse.Namespace) -> int:
    """Render the frames that come on standard input, for `batch.render_frames`."""
    out = os.fdopen(os.dup(1), "w", buffering=1)  # standard output itself belongs to Blender
    os.dup2(2, 1)

    def send(event: str, **values) -> None:
        out.write(json.dumps({"event": event, **values}, default=plain) + "\n")

    state = {"frame": 0, "told": 0.0}

    def progress(fraction: float, text: str) -> None:
        if time.monotonic() - state["told"] > 0.2:
            state["told"] = time.monotonic()
            send("progress", frame=state["frame"], fraction=fraction, text=text)

    observer = FrameObserver(progress, lambda level, text: send("message", level=level, text=text))
    scene = None
    with interruptible(observer):
        for line in sys.stdin:
            frame = state["frame"] = int(line)
            try:
                if scene is None:
                    scene = open_blend(options.file, options.scripts)
                    apply_options(scene, options)
                    keep_between(scene, a.frames is not None)
                files = output_files(options, frame, a.frames is not None)
                rendered = render_frame(scene, frame, files, options, observer)
                send("done", frame=frame, rendered=vars(rendered), memory=peak_memory())
            except CommandError as error:
                send("failed", frame=frame, error=str(error), fatal=error.code != FAILED)
    return 0


def keep_between(scene, several: bool) -> None:
    """Of several frames, what one made of the scene is there for the next (PointMRRender)."""
    if several:
        scene.render.use_persistent_data = True


def warn_about_scripts(report: Report, options: Options) -> None:
    """Say that the file wanted to run Python and was not let."""
    import bpy

    if bpy.app.autoexec_fail and not bpy.app.autoexec_fail_quiet and not options.scripts:
        report.message(
            "WARNING", f"the file's scripts did not run ({bpy.app.autoexec_fail_message}); see --scripts"
        )


def write_stats(path: Path, frames: list[dict], kept: list[int], failed: list[int]) -> None:
    """Write every frame's times, memory and counters as JSON."""
    from pointmr_engine.image.files import whole_file
    from pointmr_engine.scene.errors import SceneError

    document = {"frames": sorted(frames, key=lambda f: f["frame"]), "kept": kept, "failed": failed}
    try:
        with whole_file(path) as part:
            part.write_text(json.dumps(document, indent=1, default=plain) + "\n")
    except SceneError as error:
        raise CommandError(str(error), UNWRITABLE) from error
