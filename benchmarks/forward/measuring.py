"""What all of these benchmarks do: one process that renders a flight, its times and its memory, plots."""

from __future__ import annotations

import argparse
import statistics
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.forward.scenes import Flight
from benchmarks.worker import peak_mb
from pointmr_engine import ForwardSettings, Frame, RenderSettings, render
from pointmr_engine.render import Cache

DOCS = Path(__file__).resolve().parents[2] / "docs" / "benchmarks"
OUT = Path(__file__).resolve().parents[2] / "out" / "forward"


def settings(
    width: int = 640, height: int = 480, seed: int = 0, threads: int = 0, **forward
) -> RenderSettings:
    """Forward mapping with simple shading and no shadows, else as a user finds it; `forward`: settings of its own."""
    options = ForwardSettings(**{"shading": "simple", "shadows": False} | forward)
    return RenderSettings(width, height, method="forward", seed=seed, threads=threads, forward=options)


def timed(scene, chosen: RenderSettings, cache: Cache) -> tuple[float, float, Frame]:
    """(wall seconds, processor seconds, frame) of one image."""
    wall, processor = time.perf_counter(), time.process_time()
    frame = render(scene, chosen, cache=cache)
    return time.perf_counter() - wall, time.process_time() - processor, frame


def compile_kernels(chosen: RenderSettings) -> None:
    """Have numba compile what a render needs, on a tiny scene, so that no first image is blamed for it."""
    from benchmarks.forward.scenes import carpet

    cache, flight = Cache(), carpet(2, 1)
    for _ in range(2):
        render(flight.scene, replace(chosen, width=96, height=72), cache=cache)


def fly(flight: Flight, chosen: RenderSettings, rounds: int, cache: Cache | None = None) -> dict:
    """Render every view of a flight: a first round that builds what the views ask for, then `rounds` timed ones.

    Returns seconds a view (medians over the rounds), first image, hierarchies and sets built, counters, memory.
    """
    cache = cache or Cache()
    compile_kernels(chosen)
    views = flight.views()
    start = time.perf_counter()
    first = [timed(v, chosen, cache) for v in views]
    first_round = time.perf_counter() - start
    laps = [[timed(v, chosen, cache) for v in views] for _ in range(rounds)]
    wall = [statistics.median(lap[i][0] for lap in laps) for i in range(len(views))]
    processor = [min(lap[i][1] for lap in laps) for i in range(len(views))]
    frames = [lap[2] for lap in laps[-1]]
    if chosen.forward.sampling == "dynamic" and frames[-1].stats["needs"].get("sample_sets"):
        raise RuntimeError("dynamic sampling was asked for, but static sets were drawn")
    counters = {
        k: float(np.mean([f.stats["counters"].get(k, 0) for f in frames]))
        for k in frames[0].stats["counters"]
    }
    return {
        "name": flight.name,
        "triangles": flight.triangles,
        "unique": flight.unique,
        "wall": wall,
        "processor": processor,
        "first_image": first[0][0],
        "hierarchies": first[0][2].stats["times"].get("building hierarchies", float("nan")),
        "first_round": first_round,
        "counters": counters,
        "needs": frames[-1].stats["needs"],
        "peak_mb": peak_mb(),
        "frames": frames,
        "cache": cache,
    }


def arguments(text: str, **defaults) -> argparse.Namespace:
    """Options of a benchmark: --rounds, --views, --output, and those named; lists take several values."""
    parser = argparse.ArgumentParser(description=text.split("\n\n")[0])
    parser.add_argument("--output", type=Path, default=DOCS, help="folder of tables and plots")
    for name, value in defaults.items():
        flag = "--" + name.replace("_", "-")
        if isinstance(value, bool):
            parser.add_argument(flag, action="store_true")
        elif isinstance(value, list):
            parser.add_argument(flag, nargs="+", type=type(value[0]), default=value)
        else:
            parser.add_argument(flag, type=type(value), default=value)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    return options


def write(folder: Path, name: str, text: str) -> None:
    """Write a Markdown page beside its plots, whole or not at all, and show it."""
    path = folder / name
    beside = path.with_suffix(".part")
    beside.write_text(text.rstrip() + "\n")
    beside.rename(path)
    print(text)


def plot(path: Path, panels: list[dict], columns: int = 2) -> None:
    """Panels of curves in one PNG: each with title, xlabel, ylabel, curves (label -> (x, y) or (x, y, style)),
    xscale, yscale.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = -(-len(panels) // columns)
    figure, axes = pyplot.subplots(rows, columns, figsize=(5.4 * columns, 3.9 * rows), dpi=110, squeeze=False)
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, panel in zip(axes.flat, panels, strict=False):
        for label, (x, y, *style) in panel["curves"].items():
            axis.plot(x, y, style[0] if style else "o-", label=label)
        axis.set(
            title=panel["title"],
            xlabel=panel["xlabel"],
            ylabel=panel["ylabel"],
            xscale=panel.get("xscale", "log"),
            yscale=panel.get("yscale", "linear"),
        )
        if panel.get("yscale", "linear") == "linear":
            axis.set_ylim(bottom=0)
        axis.grid(True, which="major", alpha=0.3)
        axis.legend(fontsize=8)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    pyplot.close(figure)


def growth(x, y) -> float:
    """Exponent of the power law y ~ x^p that fits best."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
