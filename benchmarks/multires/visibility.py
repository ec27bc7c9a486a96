"""Visibility of primary cones by subpixel masks and by alpha, side by side: error and processor time.

    python -m benchmarks.multires.visibility [--scenes forest dragon_near gn_trees] [--size 80x60]
        [--cones 1 4] [--rounds 5] [--reference-samples 256]

The reference is method `distributed` with other seeds, so that only what cones do differs. Both ways render in turn, in
one thread, with the same seeds; times are medians of processor seconds. Errors are relative mean squares; the variance
is what seeds change, and the rest is bias. Writes docs/benchmarks/visibility.md.
"""

from __future__ import annotations

import argparse
import statistics
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.forward import scenes
from benchmarks.judge import size_of
from benchmarks.metrics import EPSILON, over_backdrop, relative_square
from benchmarks.report import markdown
from pointmr_engine import RenderSettings, render
from pointmr_engine.render import Cache

WAYS = ("masks", "alpha")
SEED, REFERENCE_SEED = 11, 9001
COLUMNS = ["scene", "cones", "visibility", "relMSE", "variance", "bias", "mean light", "processor s"]
RATIOS = ["scene", "cones", "error of masks / alpha", "time of masks / alpha"]


def forest():
    """5,000 trees under a sun and an even sky, both with shadows."""
    scene = scenes.forest(5000).views()[5]
    scene.lights = [replace(light, cast_shadow=True, angle=0.01) for light in scene.lights]
    scene.world.visibility = 255
    return scene


def export(name: str, size: tuple[int, int]):
    """(Scene, RenderSettings) of a subject, or of the forest, in one thread."""
    if name == "forest":
        return forest(), RenderSettings(*size, threads=1, passes=("combined",))
    import bpy

    import blender_addon
    from benchmarks import methods
    from benchmarks.multires.scenes import source as source_of
    from benchmarks.sources import exported

    blender_addon.register()

    source = source_of(name)
    source.load()
    methods.configure(bpy.context.scene, methods.Method("raytrace", 1), 0, size, source.overrides, 1)
    scene, settings, _ = exported()
    return scene, replace(settings, passes=("combined",))


def measure(name: str, o: argparse.Namespace) -> list[dict]:
    """Rows of a scene, a way and number of cones each."""
    scene, settings = export(name, o.size)

    def image(cache, **values) -> np.ndarray:
        return over_backdrop(render(scene, replace(settings, **values), cache=cache).passes["combined"])

    cache, half = Cache(), o.reference_samples // 2
    halves = [image(cache, method="distributed", samples=half, seed=REFERENCE_SEED + k) for k in range(2)]
    truth = np.mean(halves, 0)
    noise = relative_square((halves[0] - halves[1]) / 2, truth)
    rows = [{"scene": name, "cones": n, "way": w, "images": [], "times": []} for n in o.cones for w in WAYS]
    cache = Cache()
    for k in range(-1, o.rounds):  # a first one to settle
        for row in rows:
            chosen = replace(settings.raytrace, cones=row["cones"], visibility=row["way"])
            start = time.process_time()
            seen = image(cache, method="raytrace", raytrace=chosen, seed=SEED + k)
            if k >= 0:
                row["times"].append(time.process_time() - start)
                row["images"].append(seen)
    for row in rows:
        images = np.stack(row.pop("images"))
        row["error"] = float(np.mean([relative_square(i - truth, truth) for i in images])) - noise
        row["variance"] = float(np.mean(images.var(0, ddof=1) / (truth**2 + EPSILON)))
        row["mean"] = float(images.mean() / truth.mean()) - 1.0
        row["seconds"] = statistics.median(row.pop("times"))
    return rows


def page(rows: list[dict], command: str) -> str:
    """The page in Markdown."""
    table = [
        [
            r["scene"], str(r["cones"]), r["way"], f"{r['error']:.5f}", f"{r['variance']:.5f}",
            f"{r['error'] - r['variance']:.5f}", f"{r['mean']:+.2%}", f"{r['seconds']:.2f}",
        ]
        for r in rows
    ]  # fmt: skip
    ratios = []
    for masks, alpha in zip(rows[::2], rows[1::2], strict=True):
        error, seconds = masks["error"] / alpha["error"], masks["seconds"] / alpha["seconds"]
        ratios.append([masks["scene"], str(masks["cones"]), f"{error:.2f}", f"{seconds:.2f}"])
    return "\n".join(
        [
            "# Visibility by masks and by alpha", "", f"Written by `{command}`.", "",
            __doc__.split("\n\n")[2].rsplit(" Writes", 1)[0], "", markdown(RATIOS, ratios), "",
            markdown(COLUMNS, table), "",
        ]
    )  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.multires.visibility")
    parser.add_argument("--scenes", nargs="+", default=["forest", "dragon_near", "gn_trees"])
    parser.add_argument("--size", type=size_of, default=(80, 60))
    parser.add_argument("--cones", nargs="+", type=int, default=[1, 4])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--reference-samples", type=int, default=256)
    parser.add_argument("--output", type=Path, default=Path("docs/benchmarks/visibility.md"))
    o = parser.parse_args(argv)
    rows = []
    for name in o.scenes:
        rows += measure(name, o)
        print(*rows[-2 * len(o.cones) :], sep="\n", flush=True)
    command = f"python -m benchmarks.multires.visibility --scenes {' '.join(o.scenes)} --size {o.size[0]}x{o.size[1]}"
    command += f" --cones {' '.join(map(str, o.cones))} --rounds {o.rounds}"
    o.output.write_text(page(rows, f"{command} --reference-samples {o.reference_samples}"))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
