"""Tiles by threads and by forked processes: seconds of an image of a scene that is ready.

    python -m benchmarks.tile_workers [--scenes gn_trees still_life ...] [--size 640x480] [--cones 1] [--rounds 2]

Method `raytrace`, on all cores. One thread, threads and processes render in turn, with the same seed in a round; times
are the least of the rounds, for the machine may have other work. Images are compared bit by bit. Writes
docs/benchmarks/tile-workers.md.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.judge import size_of
from benchmarks.multires.visibility import export
from benchmarks.report import command, markdown
from pointmr_engine import render
from pointmr_engine.image import tile_workers
from pointmr_engine.render import Cache

SCENES = ["gn_trees", "still_life", "fence", "bmw27", "dragon_far"]
COLUMNS = ["scene", "one thread s", "threads s", "processes s", "threads / processes"]


def measure(name: str, o: argparse.Namespace) -> list[str]:
    """A scene's row."""
    scene, settings = export(name, o.size)
    settings = replace(settings, method="raytrace", raytrace=replace(settings.raytrace, cones=o.cones))
    ways = [
        replace(settings, threads=1, processes=False),
        replace(settings, threads=o.threads, processes=False),
        replace(settings, threads=o.threads, processes=True),
    ]
    cache, best = Cache(), [np.inf] * len(ways)
    for k in range(-1, o.rounds):  # a first one to settle
        images = []
        for i, way in enumerate(ways[1:] if k < 0 else ways):
            start = time.perf_counter()
            images.append(render(scene, replace(way, seed=k + 1), cache=cache).passes["combined"])
            if k >= 0:
                best[i] = min(best[i], time.perf_counter() - start)
        if not all(np.array_equal(images[0], image) for image in images):
            raise AssertionError(f"{name}: images differ")
    return [name, *(f"{seconds:.2f}" for seconds in best), f"{best[1] / best[2]:.2f}"]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tile_workers")
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--size", type=size_of, default=(640, 480))
    parser.add_argument("--cones", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--output", type=Path, default=Path("docs/benchmarks/tile-workers.md"))
    o = parser.parse_args(argv)
    tile_workers.WORTH = 0.0  # processes are measured where they would not be chosen, too
    rows = []
    for name in o.scenes:
        rows.append(measure(name, o))
        print(*rows[-1], flush=True)
    lines = [
        "# Tiles by threads and by processes", "", f"Written by `{command('benchmarks.tile_workers', argv)}`, "
        f"with {o.threads} threads or processes.", "", __doc__.split("\n\n")[2].rsplit(" Writes", 1)[0], "",
        markdown(COLUMNS, rows), "",
    ]  # fmt: skip
    o.output.write_text("\n".join(lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
