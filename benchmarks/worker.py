"""One renderer in one process, at the judge's command: JSON lines in, JSON lines out.

{"scene", "method", "samples", "size", "threads", "overrides"} loads a scene; {"seed", "out"} renders one image of it to
an EXR file and answers with its times and the process's peak memory; {"stop"} ends the process.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import json
import os
import sys
import time
import traceback
from collections.abc import Callable

from blender_addon.headless import peak_memory


def peak_mb() -> float:
    """Peak resident memory of this process so far, and what its tile workers had of their own, in MB."""
    return peak_memory() / 2**20


def seconds(text: str) -> float:
    """Seconds of Blender's "MM:SS.ss" or "HH:MM:SS.ss"."""
    total = 0.0
    for part in text.split(":"):
        total = total * 60 + float(part)
    return total


def cycles_phases(header: dict) -> dict:
    """Cycles' own account, from the EXR's header: rendering apart from sync and the building of its BVH."""
    by_name = {k.rpartition(".")[2]: v for k, v in header.items() if k.startswith("cycles.")}
    if not by_name:
        return {}
    return {"render": seconds(by_name["render_time"]), "samples": int(by_name["samples"])}


@functools.cache
def record_our_stats() -> dict:
    """Register the add-on, and have the engine's render() note down the statistics of each frame it makes; returns the
    record that it fills.
    """
    import blender_addon

    blender_addon.register()
    module = importlib.import_module("pointmr_engine.render")  # the package shows the function by this name

    record: dict = {}
    original = module.render

    def recording(*args, **kwargs):
        start = time.perf_counter()
        frame = original(*args, **kwargs)
        record.clear()
        record.update(frame.stats, engine_s=time.perf_counter() - start)
        return frame

    module.render = recording
    return record


def our_phases(stats: dict) -> dict:
    """The seconds of the rendering phase, from the frame's statistics."""
    render = stats.get("times", {}).get("rendering")
    return {} if render is None else {"render": float(render)}


def register_nothing() -> None:
    """Register a render engine that leaves the image black: what remains is Blender's own time and memory."""
    import bpy

    class Nothing(bpy.types.RenderEngine):
        bl_idname, bl_label = "JUDGE_NOTHING", "Nothing"

        def render(self, depsgraph):
            render = depsgraph.scene_eval.render
            self.end_result(self.begin_result(0, 0, render.resolution_x, render.resolution_y))

    bpy.utils.register_class(Nothing)


class Job:
    """A loaded scene that can be rendered again and again with one method."""

    def __init__(self, order: dict):
        import bpy

        from benchmarks import methods

        self.method = methods.Method(order["method"], order["samples"])
        self.size, self.threads = order["size"], order["threads"]
        if self.method.name == "nothing":
            register_nothing()
        self.stats = record_our_stats() if self.method.name in methods.OURS else {}
        self.baseline = peak_mb()
        source = self.source(order["scene"])
        source.load()
        self.overrides = source.overrides | order["overrides"]
        self.loaded = peak_mb()
        self.blender = bpy.app.version_string

    def source(self, name: str):
        """The Source of a scene's name."""
        from benchmarks import sources

        return sources.find(name)

    def answer(self, order: dict) -> dict:
        """Carry out an order to render."""
        return self.render(order["seed"], order["out"])

    def render(self, seed: int, out: str) -> dict:
        """Render one image to `out`; returns times in seconds and memory in MB."""
        import bpy

        from benchmarks import methods

        scene = bpy.context.scene
        missing = methods.configure(scene, self.method, seed, self.size, self.overrides, self.threads)
        methods.write_exr_settings(scene, out)
        if os.path.exists(out):
            os.remove(out)  # so that a render that fails quietly is not taken for the last one
        start = time.perf_counter()
        bpy.ops.render.render(write_still=True)
        wall = time.perf_counter() - start
        _, header = methods.read_exr(out)
        if self.method.name == "cycles":
            stats = {}
            phases = cycles_phases(header)
            # With data kept from the last render, a changed sample count alone may go unnoticed: never trust it.
            if phases.get("samples", self.method.samples) != self.method.samples:
                raise RuntimeError(
                    f"Cycles rendered {phases['samples']} samples, asked for {self.method.samples}"
                )
        else:
            stats = dict(self.stats)
            phases = our_phases(stats)
        return {
            "total_s": wall,
            "render_s": phases.get("render", wall),
            "before_s": wall - phases["render"] if "render" in phases else float("nan"),
            "peak_mb": peak_mb(),
            "loaded_mb": self.loaded,
            "missing": missing,
            "stats": stats,
        }


def serve(make_job: Callable[[dict], Job]) -> None:
    """Answer orders until told to stop; make_job(order) loads a scene."""
    # Blender writes to file descriptor 1 from C: answers go through a copy, all else to standard error.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    job = None
    for line in sys.stdin:
        order = json.loads(line)
        if order.get("stop"):
            break
        try:
            if "scene" in order:
                job = None
                start = time.perf_counter()
                job = make_job(order)
                answer = {
                    "loaded_s": time.perf_counter() - start,
                    "baseline_mb": job.baseline,
                    "blender": job.blender,
                }
            else:
                answer = job.answer(order)
        except Exception as error:  # the judge reports it and goes on with the other methods
            answer = {"error": f"{type(error).__name__}: {error}", "trace": traceback.format_exc()}
        answers.write(json.dumps(answer, default=str) + "\n")
        answers.flush()
    with contextlib.suppress(Exception):
        answers.close()
    os._exit(0)  # bpy's own tear-down is slow and may crash after a script's scenes


if __name__ == "__main__":
    serve(Job)
