"""Scale: scenes whose triangles outnumber memory, ours beside Cycles and beside Blender alone.

    python -m benchmarks.scale [--instances 1000000] [--forest scenes_blend/forest_1e15.blend]

1. The forest of 10^15 triangles, `conventional` at 640x480: time after compilation, and peak memory.
2. A million native instances of one mesh of 80,000 triangles: the first image in a new process (kernels already
   compiled on disk), by ours, by Cycles, and by an engine that draws nothing.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from benchmarks.methods import Method
from benchmarks.processes import Worker, WorkerError
from benchmarks.report import cell, command, markdown

HEADER = [
    "scene",
    "renderer",
    "first image s",
    "next image s",
    "of it rendering s",
    "peak MB",
    "MB before rendering",
]


def build_million(path: Path, instances: int) -> None:
    """Write a .blend with `instances` vertex instances of a ring of 80,000 triangles on a wavy field."""
    import bpy
    import numpy as np

    from benchmarks.features import stage

    stage.empty_scene()
    side = round(instances**0.5)
    x, y = np.meshgrid(np.arange(side) - side / 2, np.arange(side), indexing="xy")
    generator = np.random.default_rng(1)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(side * side)])
    points += generator.uniform(-0.3, 0.3, points.shape)
    points[:, 2] += 3.0 * np.sin(points[:, 0] * 0.05) * np.sin(points[:, 1] * 0.04)
    mesh = bpy.data.meshes.new("Field")
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", points.astype(np.float32).ravel())
    mesh.update()
    field = stage.link(bpy.data.objects.new("Field", mesh))
    bpy.ops.mesh.primitive_torus_add(
        major_segments=200, minor_segments=200, major_radius=0.3, minor_radius=0.12
    )
    ring = bpy.context.object
    ring.rotation_euler = (0.6, 0.3, 0.0)
    ring.data.materials.append(stage.principled(Base_Color=stage.COPPER, Roughness=0.4))
    ring.parent = field
    field.instance_type, field.show_instancer_for_render = "VERTS", False
    stage.world((0.4, 0.5, 0.65))
    stage.lamp("SUN", 3.0, (-3, -3, 5), angle=0.02)
    stage.camera((0, -12, 7), (0, 40, 0), 35, clip_end=1e5)
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)


def first_image(scene: Path, method: Method, size, threads: int, out: Path, again: bool) -> list[str]:
    """The row of one renderer: first image in a new process, and the next one."""
    log = out / f"{scene.stem}-{method.name}.log"
    try:
        with Worker(log) as worker:
            worker.load(str(scene), method, size, threads)
            first = worker.render(1, out / f"{scene.stem}-{method.name}.exr")
            following = worker.render(2, out / f"{scene.stem}-{method.name}-2.exr") if again else {}
    except WorkerError as error:
        return [scene.stem, method.label, str(error), *["-"] * 4]
    last = following or first
    return [
        scene.stem,
        method.label,
        cell(first["total_s"], ".2f"),
        cell(following.get("total_s"), ".2f"),
        cell(last["render_s"], ".2f"),
        cell(last["peak_mb"], ".0f"),
        cell(last["loaded_mb"], ".0f"),
    ]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks.scale", description=__doc__.split("\n\n")[0])
    parser.add_argument("--instances", type=int, default=1_000_000)
    parser.add_argument("--forest", type=Path, default=Path("scenes_blend/forest_1e15.blend"))
    parser.add_argument("--method", default="conventional")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/scale"))
    parser.add_argument("--docs", type=Path, default=Path("docs/benchmarks"))
    options = parser.parse_args(argv)
    options.out.mkdir(parents=True, exist_ok=True)
    rows, ours = [], Method(options.method, 1)
    if options.forest.is_file():
        rows.append(
            first_image(options.forest.resolve(), ours, (640, 480), options.threads, options.out, again=True)
        )
        print(rows[-1], flush=True)
    million = (options.out / f"instances_{options.instances}.blend").resolve()
    if not million.is_file():
        build_million(million, options.instances)
    # kernels onto the disk
    compiled = first_image(million, ours, (64, 48), options.threads, options.out, again=False)
    print("warm-up", compiled, flush=True)
    for method in (Method("nothing", 1), ours, Method("cycles", 1)):
        rows.append(first_image(million, method, (320, 240), options.threads, options.out, again=True))
        print(rows[-1], flush=True)
    typed = command("benchmarks.scale", argv)
    text = f"# Scale\n\n`{typed}`\n\n{__doc__.partition('1. ')[1]}{__doc__.partition('1. ')[2]}\n"
    text += markdown(HEADER, rows) + "\n"
    options.docs.mkdir(parents=True, exist_ok=True)
    (options.docs / "scale.md").write_text(text)
    (options.out / "scale.json").write_text(
        json.dumps([dict(zip(HEADER, r, strict=True)) for r in rows], indent=1)
    )
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
