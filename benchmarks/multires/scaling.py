"""Growth with the scene: time and memory against n triangles at constant projected area.

    python -m benchmarks.multires.scaling [--methods raytrace:1 conventional] [--size 320x240] [--rounds 3]

A meadow (benchmarks.forward.scenes.carpet) of 10^5 to 10^15 triangles, whose image stays: each level has 16 times the
triangles at a quarter of the size. And the land of 10^15 triangles. Each point has a process of its own, which renders
a small image first (kernels), then the first image of the scene, then `rounds` more. Writes
docs/benchmarks/raytrace-scaling.md and .png.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.forward.measuring import growth
from benchmarks.judge import size_of
from benchmarks.methods import Method, parse_methods
from benchmarks.report import command, markdown
from benchmarks.worker import peak_mb

ROOT = Path(__file__).resolve().parents[2]
LEVELS = range(1, 10)  # 10^5 to 10^15 triangles, about
HEADER = ["scene", "method", "triangles", "unique", "first image s", "next image s", "peak MB"]


def settings_of(method: Method, size):
    """RenderSettings of a method; "samples" are rays, cones or, for forward mapping, surface samples a pixel."""
    from pointmr_engine import ForwardSettings, RaytraceSettings, RenderSettings

    s = RenderSettings(*size, method=method.name, passes=("combined",))
    if method.name == "raytrace":
        return replace(s, raytrace=RaytraceSettings(cones=method.samples))
    if method.name == "forward":
        return replace(
            s, forward=ForwardSettings(samples_per_pixel=method.samples, subpixels=8, shading="full")
        )
    return replace(s, samples=method.samples)


def one(scene: str, method: Method, size, rounds: int) -> dict:
    """Measure one scene with one method in this process."""
    from benchmarks.forward import scenes
    from pointmr_engine import render
    from pointmr_engine.render import Cache

    chosen = settings_of(method, size)
    small = Cache()
    for _ in range(2):
        render(scenes.carpet(1).scene, replace(chosen, width=64, height=48), cache=small)
    flight = scenes.land() if scene == "land" else scenes.carpet(int(scene))
    view = flight.views()[5 if scene == "land" else 0]
    cache, seconds = Cache(), []
    for _ in range(rounds + 1):
        start = time.perf_counter()
        render(view, chosen, cache=cache)
        seconds.append(time.perf_counter() - start)
    return {
        "scene": "land" if scene == "land" else "meadow",
        "method": method.label,
        "triangles": flight.triangles,
        "unique": flight.unique,
        "first_s": seconds[0],
        "render_s": statistics.median(seconds[1:]),
        "peak_mb": peak_mb(),
    }


def apart(scene: str, method: Method, o) -> dict | None:
    """The same in a process of its own; None, with its words, if it fails."""
    words = [sys.executable, "-m", "benchmarks.multires.scaling", "--one", scene, "--methods"]
    words += [
        f"{method.name}:{method.samples}",
        "--size",
        f"{o.size[0]}x{o.size[1]}",
        "--rounds",
        str(o.rounds),
    ]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        print(f"{scene}, {method.label}: {done.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
        return None
    return json.loads(done.stdout.strip().splitlines()[-1])


def summary(rows: list[dict], label: str) -> str:
    """How a method's time grows over the meadows: as a power of n, and in seconds for each factor of ten."""
    mine = [r for r in rows if r["method"] == label and r["scene"] == "meadow"]
    if len(mine) < 3:
        return f"- {label}: too few points"
    n, t = np.array([r["triangles"] for r in mine], float), np.array([r["render_s"] for r in mine])
    slope, start = np.polyfit(np.log10(n), t, 1)
    return (
        f"- {label}: n^{growth(n, t):.3f}; {start:.3f} s {slope:+.4f} s for each factor of ten; from {n[0]:.1g} to "
        f"{n[-1]:.1g} triangles the time grows {t[-1] / t[0]:.2f}-fold, log n {np.log(n[-1]) / np.log(n[0]):.2f}-fold"
    )


def plot(rows: list[dict], path: Path) -> None:
    """Seconds and MB against triangles, logarithmic below."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(10, 4.0), dpi=100)
    for axis, key, label in zip(axes, ("render_s", "peak_mb"), ("one more image, s", "peak MB"), strict=True):
        for method in dict.fromkeys(r["method"] for r in rows):
            mine = [r for r in rows if r["method"] == method and r["scene"] == "meadow"]
            (line,) = axis.plot([r["triangles"] for r in mine], [r[key] for r in mine], "o-", label=method)
            land = [r for r in rows if r["method"] == method and r["scene"] == "land"]
            color = line.get_color()
            axis.plot([r["triangles"] for r in land], [r[key] for r in land], "*", ms=11, color=color)
        axis.set(xscale="log", xlabel="triangles (star: land)", ylabel=label)
        axis.set_ylim(bottom=0)
        axis.grid(True, alpha=0.3)
        axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks.multires.scaling", description=__doc__.split("\n\n")[0])
    parser.add_argument("--methods", nargs="+", default=["raytrace:1", "conventional"])
    parser.add_argument("--scenes", nargs="+", default=[*map(str, LEVELS), "land"], help="levels, or land")
    parser.add_argument("--size", type=size_of, default=(320, 240))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--docs", type=Path, default=Path("docs/benchmarks"))
    parser.add_argument("--one", help=argparse.SUPPRESS)
    o = parser.parse_args(argv)
    chosen = parse_methods(o.methods)
    if o.one:
        print(json.dumps(one(o.one, chosen[0], o.size, o.rounds)))
        return 0
    o.docs.mkdir(parents=True, exist_ok=True)
    typed = command("benchmarks.multires.scaling", argv)
    rows, failed = [], 0
    for scene in o.scenes:
        for method in chosen:
            row = apart(scene, method, o)
            failed += row is None
            if row is None:
                continue
            rows.append(row)
            print(row, flush=True)
            cells = [
                [r["scene"], r["method"], f"{r['triangles']:.2e}", str(r["unique"]), f"{r['first_s']:.2f}",
                 f"{r['render_s']:.3f}", f"{r['peak_mb']:.0f}"]
                for r in rows
            ]  # fmt: skip
            growths = [summary(rows, m.label) for m in chosen]
            about = __doc__.split("\n\n")[2].partition(" Writes")[0]
            text = ["# Growth with the scene", f"`{typed}`", about, "\n".join(growths)]
            text += ["![growth](raytrace-scaling.png)", markdown(HEADER, cells)]
            (o.docs / "raytrace-scaling.md").write_text("\n\n".join(text) + "\n")
            plot(rows, o.docs / "raytrace-scaling.png")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
