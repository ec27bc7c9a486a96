"""Frames of an animation: what each takes alone, and what it takes after another, with Persistent Data.

    python -m benchmarks.animation [--scenes gn_trees dragon_far ...] [--methods raytrace forward] [--size 320x240]

Blender renders each scene several times in a row, by its own render call: alone (nothing is kept), with a camera that
has moved since the image before, and with a ball that has moved, too. Times are all of the call: what Blender does,
reading the scene, building, rendering. The first image of each way is not counted; the least of the others is. Writes
docs/benchmarks/animation.md.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

from benchmarks.judge import size_of
from benchmarks.methods import Method, configure
from benchmarks.multires.scenes import source
from benchmarks.report import command, markdown

SCENES = ["gn_trees", "dragon_far", "forest_cut", "bmw27", "hair"]
METHODS = ["raytrace", "forward"]
COLUMNS = ["scene", "method", "alone s", "camera moves s", "alone / it", "ball moves s", "alone / it"]
STEP = 0.01  # metres that the camera, or the ball, moves from frame to frame


def measure(name: str, method: str, o: argparse.Namespace) -> list[str]:
    """A row: a scene by a method."""
    import bpy

    from blender_addon.headless import FrameObserver, run_render

    subject = source(name)
    subject.load()
    scene = bpy.context.scene
    configure(scene, Method(method, 1), 1, o.size, subject.overrides, o.threads)
    ball = _ball(scene)

    def least(persistent: bool, moved) -> float:
        scene.render.use_persistent_data = persistent
        times = []
        for _ in range(o.rounds + 1):
            moved.location.x += STEP
            start = time.perf_counter()
            run_render(FrameObserver())
            times.append(time.perf_counter() - start)
        return min(times[1:])

    alone = least(False, scene.camera)
    camera = least(True, scene.camera)
    rolling = least(True, ball)
    cells = [
        f"{alone:.2f}",
        f"{camera:.2f}",
        f"{alone / camera:.2f}",
        f"{rolling:.2f}",
        f"{alone / rolling:.2f}",
    ]
    return [name, method, *cells]


def _ball(scene):
    """A small ball before the camera."""
    import bpy
    from mathutils import Vector

    bpy.ops.mesh.primitive_uv_sphere_add(segments=16, ring_count=8, radius=0.02)
    ball = bpy.context.object
    ball.location = scene.camera.matrix_world @ Vector((0.0, 0.0, -1.0))
    return ball


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.animation")
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS)
    parser.add_argument("--size", type=size_of, default=(320, 240))
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--output", type=Path, default=Path("docs/benchmarks/animation.md"))
    o = parser.parse_args(argv)

    import blender_addon

    blender_addon.register()
    rows = []
    for name in o.scenes:
        for method in o.methods:
            rows.append(measure(name, method, o))
            print(*rows[-1], flush=True)
    how = f"Written by `{command('benchmarks.animation', argv)}`, with {o.threads} threads."
    about = __doc__.split("\n\n")[2].rsplit(" Writes", 1)[0]
    table = markdown(COLUMNS, rows)
    o.output.write_text("\n\n".join(["# Frames of an animation", how, about, table]) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
