"""Memory of forward mapping: bytes a triangle of each hierarchy, and the peak of whole processes.

    python -m benchmarks.forward.memory [--cases dragon forest_4e8 forest_6e9 land_1e15] [--size 640] [--views 4]

Every case runs in a process of its own. Sets are counted twice: those that the views asked for, and, where
--all-sets is given, those of all levels of all groups.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from benchmarks.forward import scenes
from benchmarks.forward.measuring import arguments, compile_kernels, settings, write
from benchmarks.report import command, markdown
from benchmarks.sources import scenes_folder
from benchmarks.worker import peak_mb
from pointmr_engine import render
from pointmr_engine.render import Cache

CASES = {
    "dragon": lambda v: scenes.dragon(scenes_folder() / "scans/dragon_vrip.ply.gz", v),
    "forest_4e8": lambda v: scenes.forest(5000, v),
    "forest_6e9": lambda v: scenes.forest(72_000, v),
    "land_1e15": lambda v: scenes.land(v),
}
HEADER = [
    "case",
    "unique triangles",
    "placements",
    "instanced triangles",
    "octrees: bytes a triangle",
    "distribution lists",
    "sets, as asked for",
    "all sets",
    "peak MB",
    "MB before",
]


def octree_bytes(octree) -> int:
    return sum(a.nbytes for a in octree.arrays)


def set_bytes(sets) -> int:
    """Of the sets' surfels in use and their table."""
    s = sets.surfels
    return sets.sets.nbytes + sum(a.nbytes // max(1, len(a)) * sets.used for a in s)


def one(name: str, size: int, views: int, all_sets: bool) -> dict:
    """Render a case's views in this process."""
    from benchmarks.forward.speed import every_set
    from pointmr_engine.hierarchy.distribution import build_distribution

    flight = CASES[name](views)
    chosen = settings(size, size * 3 // 4)
    compile_kernels(chosen)
    before = peak_mb()
    cache = Cache()
    for view in flight.views():
        render(view, chosen, cache=cache)
    peak = peak_mb()
    sampler = cache._compiled.sampler
    items = len(sampler.octree.arrays.item)
    sets = next(iter(sampler.sets.values()))
    found = {
        "unique": flight.unique,
        "placements": max(items - flight.unique, 0),  # triangles without area are no items
        "triangles": float(flight.triangles),
        "octree": octree_bytes(sampler.octree) / items,
        "distribution": sum(a.nbytes for a in build_distribution(sampler.octree)) / items,
        "sets": set_bytes(sets) / items,
        "peak_mb": peak,
        "before_mb": before,
    }
    if all_sets:
        sets.require(every_set(sets))
        found["all_sets"] = set_bytes(sets) / items
    return found


def main() -> None:
    o = arguments(__doc__, cases=list(CASES), size=640, views=4, all_sets=False, child="")
    if o.child:
        print(json.dumps(one(o.child, o.size, o.views, o.all_sets)))
        return
    rows = []
    for name in o.cases:
        words = [sys.executable, "-m", "benchmarks.forward.memory", "--child", name, "--size", str(o.size)]
        words += ["--views", str(o.views)] + (["--all-sets"] if o.all_sets else [])
        run = subprocess.run(words, capture_output=True, text=True, cwd=Path(__file__).resolve().parents[2])
        if run.returncode:
            print(f"{name}: {run.stderr.strip().splitlines()[-1] if run.stderr.strip() else run.returncode}")
            continue
        r = json.loads(run.stdout.strip().splitlines()[-1])
        rows.append(
            [
                name,
                f"{r['unique']:,}",
                f"{r['placements']:,}",
                f"{r['triangles']:.2g}",
                f"{r['octree']:.0f}",
                f"{r['distribution']:.0f}",
                f"{r['sets']:.0f}",
                f"{r['all_sets']:.0f}" if "all_sets" in r else "-",
                f"{r['peak_mb']:.0f}",
                f"{r['before_mb']:.0f}",
            ]
        )
        print(rows[-1], flush=True)
    write(
        o.output,
        "forward-memory.md",
        f"# Forward mapping: memory\n\n`{command('benchmarks.forward.memory')}`. Bytes are per item: unique "
        f"triangle or placement. The peak is the whole process's, after {o.views} views of {o.size} x "
        f"{o.size * 3 // 4} pixels; before them it held Python, kernels and the scene.\n\n"
        + markdown(HEADER, rows),
    )


if __name__ == "__main__":
    main()
