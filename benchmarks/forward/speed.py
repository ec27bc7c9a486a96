"""Frames a second along flights through forests of 4 * 10^8, 6 * 10^9 and 10^15 triangles, and what comes
before the first.

    python -m benchmarks.forward.speed [--cases static_4e8 static_1e15 ...] [--rounds 3] [--views 24] [--size 640]

Full reconstruction, simple shading, nothing reused from image to image but the hierarchies. A view's time is the
median over the rounds that follow a first one, which builds the sample sets that its views ask for.
"""

from __future__ import annotations

import json
import statistics
import time

import numpy as np

from benchmarks.forward import scenes
from benchmarks.forward.measuring import OUT, arguments, compile_kernels, fly, settings, write
from benchmarks.report import command, markdown
from benchmarks.sources import scenes_folder
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.hierarchy.octree import build_octree
from pointmr_engine.hierarchy.sample_sets import NOT_YET, SampleSets
from pointmr_engine.shading.program import compile_graph

# name -> (what flies, settings, the talk's figure of 2004)
MOVING = {"samples_per_pixel": 0.25, "subpixels": 2}  # the viewport's density while one moves
CASES = {
    "moving_4e8": (lambda v: scenes.forest(5000, v), MOVING, "4 frames/s"),
    "moving_6e9": (lambda v: scenes.forest(72_000, v), MOVING, "-"),
    "moving_1e15": (lambda v: scenes.land(v), MOVING, "5-10 frames/s"),
    "static_4e8": (lambda v: scenes.forest(5000, v), {}, "4 frames/s"),
    "static_6e9": (lambda v: scenes.forest(72_000, v), {}, "-"),
    "static_1e15": (lambda v: scenes.land(v), {}, "5-10 frames/s"),
    "random_4e8": (
        lambda v: scenes.forest(5000, v),
        {"sampling": "dynamic", "draws": "random", "failure": 1e-3},
        "0.8-3.9 s",
    ),
    "stratified_4e8": (
        lambda v: scenes.forest(5000, v),
        {"sampling": "dynamic", "draws": "stratified"},
        "0.8-3.9 s",
    ),
    "random_6e9": (
        lambda v: scenes.forest(72_000, v),
        {"sampling": "dynamic", "draws": "random", "failure": 1e-3},
        "0.4-81 s",
    ),
    "stratified_6e9": (
        lambda v: scenes.forest(72_000, v),
        {"sampling": "dynamic", "draws": "stratified"},
        "0.4-81 s",
    ),
}
HEADER = [
    "case",
    "triangles",
    "frames/s",
    "s: median",
    "least",
    "most",
    "processor s",
    "first image s",
    "all sets of the flight s",
    "2004",
]
COUNTED = ("nodes", "hidden", "sets", "surfels", "triangles", "instances", "points", "fragments")


def baker(geometry):
    """What looks up materials for sample sets, without the rest of a render."""
    from pointmr_engine.forward.baked.baking import Baker
    from pointmr_engine.scene.material import Material

    plain = Material("no material")
    return Baker(geometry, [compile_graph((m or plain).graph) for m in geometry.materials])


def preprocess(root, all_sets: bool, rounds: int = 3) -> dict:
    """Seconds to build a root's octrees and distribution lists, and all sample sets of all levels that can be built."""
    from pointmr_engine.hierarchy.distribution import build_distribution
    from pointmr_engine.scene.scene import Scene

    best = {"octree": np.inf, "distribution": np.inf, "sets": np.inf}
    for _ in range(rounds):
        clock = time.perf_counter()
        geometry = compile_geometry(Scene(root))
        octree = build_octree(geometry)
        laps = {"octree": time.perf_counter() - clock}
        clock = time.perf_counter()
        build_distribution(octree)
        laps["distribution"] = time.perf_counter() - clock
        if all_sets:
            clock = time.perf_counter()
            sets = SampleSets(octree, baker(geometry))
            sets.require(every_set(sets))
            laps["sets"] = time.perf_counter() - clock
        best = {k: min(best[k], laps.get(k, np.inf)) for k in best}
    return best


def every_set(sets: SampleSets) -> list[tuple[int, int]]:
    """All (group, level) that have a set to build, coarse levels last, which are made of finer ones."""
    nodes = np.flatnonzero(sets.sets[:, 0] == NOT_YET)
    pairs = np.unique(np.stack([sets.node_group[nodes], sets.octree.arrays.level[nodes]], 1), axis=0)
    return [(int(g), int(level)) for g, level in pairs[np.lexsort((-pairs[:, 1], pairs[:, 0]))]]


def main() -> None:
    o = arguments(__doc__, cases=list(CASES), rounds=3, views=24, size=640, skip_preprocessing=False)
    rows, counts, record = [], [], {}
    for name in o.cases:
        make, options, before = CASES[name]
        r = fly(make(o.views), settings(o.size, o.size * 3 // 4, **options), o.rounds)
        middle = statistics.median(r["wall"])
        rows.append(
            [
                name,
                f"{r['triangles']:.2g}",
                f"{1 / middle:.1f}",
                f"{middle:.3f}",
                f"{min(r['wall']):.3f}",
                f"{max(r['wall']):.3f}",
                f"{statistics.median(r['processor']):.3f}",
                f"{r['first_image']:.2f}",
                f"{r['first_round'] - sum(r['wall']):.1f}",
                before,
            ]
        )
        counts.append([name, *(f"{r['counters'].get(k, 0):.3g}" for k in COUNTED)])
        record[name] = {
            k: r[k] for k in ("triangles", "wall", "processor", "first_image", "first_round", "counters")
        }
        print(rows[-1], flush=True)
    parts = [
        f"# Forward mapping: speed\n\n`{command('benchmarks.forward.speed')}`, {o.size} x {o.size * 3 // 4} "
        f"pixels, {o.views} views.",
        "Full reconstruction, simple shading, nothing reused from image to image but the hierarchies. The last column "
        "is what the talk reported in 2004. Times are the median over the rounds for each view; the row's are over its "
        "views.",
        markdown(HEADER, rows),
        "Mean counts of one image:",
        markdown(["case", *COUNTED], counts),
    ]
    if not o.skip_preprocessing:
        compile_kernels(settings())
        lines = []
        tasks = [("tree, 83,736 triangles", scenes.plants.tree("ash", 1, scenes.plants.LEAF), True, "")]
        tasks.append(("the same and 5,000 instances on ground", single_kind(5000), True, "8 s"))
        folder = scenes_folder()
        if folder and (folder / "scans/dragon_vrip.ply.gz").is_file():
            tasks.append(
                (
                    "dragon, 871,414 triangles",
                    scenes.dragon(folder / "scans/dragon_vrip.ply.gz").root,
                    True,
                    "",
                )
            )
        for label, root, sets, before in tasks:
            laps = preprocess(root, sets, o.rounds)
            lines.append([label, *(f"{laps[k]:.2f}" for k in ("octree", "distribution", "sets")), before])
            print(lines[-1], flush=True)
        parts += [
            'Before the first image, seconds; "all sets" are those of every level, '
            "while a render builds only what its views need:",
            markdown(["scene", "octrees", "distribution lists", "all sets", "2004"], lines),
        ]
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "speed.json").write_text(json.dumps(record))
    write(o.output, "forward-speed.md", "\n\n".join(parts))


def single_kind(trees: int):
    """A forest of one kind of tree, as the talk's 90,000 triangles and instances."""
    root = scenes.forest(trees, 1).root
    batch = root.instances[0]
    batch.groups, batch.group_index = batch.groups[:1], None
    return root


if __name__ == "__main__":
    main()
