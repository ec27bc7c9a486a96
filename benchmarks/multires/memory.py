"""Memory and preparation of method "raytrace": bytes a triangle of each hierarchy, and seconds until a scene is ready.

    python -m benchmarks.multires.memory [--scenes dragon_near gn_trees ...] [--size 640x480]

Every scene is read from Blender in a process of its own. Bytes are per unique triangle or placement: of rays' boxes,
of the prefiltered points of all their children, of the octrees, and of the sample sets that the image asked for. Ready
is what the first image takes more than the second, kernels compiled before; beside it what reading the scene takes.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.forward.measuring import write
from benchmarks.forward.memory import octree_bytes, set_bytes
from benchmarks.judge import size_of
from benchmarks.multires.scenes import SUBJECTS
from benchmarks.report import command, markdown
from benchmarks.worker import peak_mb

DEFAULT = ["dragon_near", "dragon_far", "gn_trees", "hair", "fence", "forest_1e15"]
HEADER = ["scene", "unique triangles", "placements", "instanced triangles", "rays' boxes", "prefiltered points",
          "octrees", "sample sets", "read s", "ready s", "first image s", "second s", "peak MB"]  # fmt: skip


def array_bytes(arrays) -> int:
    """Of all arrays of a NamedTuple, each once."""
    seen = {a.ctypes.data: a.nbytes for a in arrays if isinstance(a, np.ndarray)}
    return sum(seen.values())


def one(name: str, size) -> dict:
    """Measure a scene in this process."""
    from benchmarks.multires.worker import Ours
    from pointmr_engine import render
    from pointmr_engine.hierarchy.prefilter import prefilter
    from pointmr_engine.render import Cache

    order = {"method": "raytrace", "scene": name, "size": list(size), "overrides": {}, "threads": 0}
    subject = Ours(order)
    chosen = subject.chosen({"seed": 11, "samples": 1})
    render(subject.scene, chosen, cache=Cache())  # compiles kernels, or loads them
    cache, seconds = Cache(), []
    for _ in range(2):
        start = time.perf_counter()
        frame = render(subject.scene, chosen, cache=cache)
        seconds.append(time.perf_counter() - start)
    peak = peak_mb()
    sampler, acceleration = cache._compiled.sampler, cache._compiled.acceleration
    items = len(sampler.octree.arrays.item)
    points = sampler.prefiltered[1] if sampler.prefiltered else prefilter(acceleration)
    sets = next(iter(sampler.sets.values()))
    unique = int(frame.stats["unique_triangles"])
    return {
        "unique": unique,
        "placements": max(items - unique, 0),
        "triangles": float(frame.stats["triangles"]),
        "boxes": array_bytes(acceleration.arrays) / items,
        "points": (points.points.nbytes + points.visibility.nbytes) / items,
        "octree": octree_bytes(sampler.octree) / items,
        "sets": set_bytes(sets) / items,
        "read": subject.export_s,
        "seconds": seconds,
        "peak_mb": peak,
    }


def row_of(name: str, r: dict) -> list[str]:
    first, second = r["seconds"]
    return [
        name, f"{r['unique']:,}", f"{r['placements']:,}", f"{r['triangles']:.2g}",
        *(f"{r[k]:.0f}" for k in ("boxes", "points", "octree", "sets")),
        *(f"{s:.1f}" for s in (r["read"], max(first - second, 0.0), first, second)), f"{r['peak_mb']:.0f}",
    ]  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks.multires.memory", description=__doc__.split("\n\n")[0])
    parser.add_argument("--scenes", nargs="+", choices=list(SUBJECTS), default=DEFAULT)
    parser.add_argument("--size", type=size_of, default=(640, 480))
    parser.add_argument("--docs", type=Path, default=Path("docs/benchmarks"))
    parser.add_argument("--child", help=argparse.SUPPRESS)
    o = parser.parse_args(argv)
    if o.child:
        print(json.dumps(one(o.child, o.size)))
        return 0
    rows, failed = [], 0
    for name in o.scenes:
        words = [sys.executable, "-m", "benchmarks.multires.memory", "--child", name]
        words += ["--size", f"{o.size[0]}x{o.size[1]}"]
        run = subprocess.run(words, capture_output=True, text=True)
        if run.returncode:
            said = run.stderr.strip().splitlines() or [str(run.returncode)]
            print(f"{name}: {said[-1]}", file=sys.stderr)
            failed += 1
            continue
        rows.append(row_of(name, json.loads(run.stdout.strip().splitlines()[-1])))
    if rows:
        about = __doc__.split("\n\n")[2]
        title = '# Method "raytrace": memory and preparation'
        typed = f"`{command('benchmarks.multires.memory', argv)}`, {o.size[0]} x {o.size[1]}"
        write(o.docs, "raytrace-memory.md", "\n\n".join([title, typed, about, markdown(HEADER, rows)]))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
