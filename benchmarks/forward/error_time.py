"""Error against run time: forward mapping beside `conventional`, `distributed` and Cycles on the same scenes.

    python -m benchmarks.forward.error_time [--scenes forest dragon gn_trees] [--size 640] [--reference-samples 1024]

All show Lambertian surfaces under one sun without shadow, by the same pixel filter; the reference is Cycles' with two
seeds, kept in out/forward/. Times are those of the rendering phase, the median of the rounds after a first one;
hierarchies, sample sets and Cycles' own are built before. Scene "land", of 10^15 triangles, has its reference from
`distributed`.
"""

from __future__ import annotations

import json
import os
import statistics
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks import pictures
from benchmarks.forward import blend, scenes
from benchmarks.forward.measuring import OUT, arguments, plot, settings, write
from benchmarks.methods import Method, read_exr
from benchmarks.metrics import deviation
from benchmarks.processes import Worker, WorkerError
from benchmarks.reference import HALF_SEEDS, reference
from benchmarks.report import command, markdown
from benchmarks.sources import find, text_hash
from pointmr_engine import RenderSettings, Scene, render
from pointmr_engine.render import Cache

DENSITIES = (0.1, 0.25, 1.0, 4.0, 16.0, 64.0)  # samples a pixel of forward mapping
DYNAMIC = (1.0, 4.0, 16.0, 64.0)
RAYS = (1, 4, 16, 64)
DEFAULT = "static:1"
COLUMNS = (
    ("render s", "render_s", ".3f"),
    ("relMSE", "rel_mse", ".2e"),
    ("bias", "bias", ".1e"),
    ("FLIP", "flip", ".4f"),
    ("alpha error", "alpha", ".4f"),
)


def load(name: str) -> Scene:
    """The scene for our methods."""
    if name == "land":
        return scenes.land().views()[5]
    return blend.named(name) or blend.from_blend(name)


def our_methods(width: int, height: int, kinds: list[str]) -> list[tuple[str, str, RenderSettings]]:
    """(method, label, settings) of every point of our curves."""
    found = []
    if "static" in kinds:
        for n in DENSITIES:
            more = {"subpixels": 8} if n > 1 else {}
            found.append(("static", f"static:{n:g}", settings(width, height, samples_per_pixel=n, **more)))
    if "dynamic" in kinds:
        for n in DYNAMIC:
            more = {"sampling": "dynamic", "subpixels": 8 if n > 4 else 4}
            found.append(("dynamic", f"dynamic:{n:g}", settings(width, height, samples_per_pixel=n, **more)))
    if "conventional" in kinds:
        found.append(("conventional", "conventional", RenderSettings(width, height, method="conventional")))
    if "distributed" in kinds:
        for n in RAYS:
            found.append(
                (
                    "distributed",
                    f"distributed:{n}",
                    RenderSettings(width, height, method="distributed", samples=n),
                )
            )
    return found


def ours(scene: Scene, chosen: RenderSettings, cache: Cache, rounds: int) -> tuple[list[np.ndarray], float]:
    """(images of the rounds, seconds of the rendering phase); a first round builds and compiles."""
    frames = []
    for k in range(rounds + 1):
        chosen.seed = 11 + k
        frames.append(render(scene, chosen, cache=cache))
    dynamic = chosen.method == "forward" and chosen.forward.sampling == "dynamic"
    if dynamic and frames[-1].stats["needs"].get("sample_sets"):
        raise RuntimeError("dynamic sampling was asked for, but static sets were drawn")
    seconds = statistics.median(f.stats["times"]["rendering"] for f in frames[1:])
    return [f.passes["combined"] for f in frames[1:]], seconds


def cycles(path: Path, samples: int, size, rounds: int) -> tuple[list[np.ndarray], float]:
    """The same by Cycles, in a process of its own."""
    out = path.with_suffix(f".{os.getpid()}.exr")
    images, seconds = [], []
    with Worker(path.with_suffix(".log")) as worker:
        worker.load(str(path), Method("cycles", samples), size)
        try:
            for k in range(rounds + 1):
                answer = worker.render(11 + k, out)
                if k:
                    images.append(read_exr(str(out))[0][::-1])
                    seconds.append(answer["render_s"])
        finally:
            out.unlink(missing_ok=True)
    return images, statistics.median(seconds)


def truth(name: str, scene: Scene, size, samples: int) -> list[np.ndarray]:
    """Two independent halves of the reference, bottom row first."""
    if name != "land":
        path = blend.ensure(name, OUT)
        return [h[::-1] for h in reference(find(str(path)), size, samples, 0, OUT / "references").halves]
    key = text_hash(
        name, size, samples, Path(scenes.__file__).read_text(), Path(scenes.plants.__file__).read_text()
    )
    path = OUT / "references" / f"{name}-{key}.npz"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        halves = [
            render(
                scene, RenderSettings(*size, method="distributed", samples=samples // 2, seed=seed)
            ).passes["combined"]
            for seed in HALF_SEEDS
        ]
        beside = path.with_suffix(f".{os.getpid()}.npz")
        np.savez_compressed(beside, halves=np.stack(halves))
        beside.rename(path)
    with np.load(path) as stored:
        return list(stored["halves"])


def measure(name: str, o) -> list[dict]:
    """One row for every point of every curve."""
    size = (o.size, o.size * 3 // 4)
    scene = load(name)
    halves = truth(name, scene, size, o.reference_samples)
    rows = []

    def add(method, label, images, seconds):
        d = asdict(deviation(images, halves))
        rows.append({"scene": name, "method": method, "label": label, "render_s": seconds} | d)
        sheet = pictures.comparison(images[0][::-1], np.mean(halves, 0)[::-1], name, label)
        path = OUT / "pictures" / f"{name}-{label.replace(':', '-')}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        sheet.save(path)
        print(
            {k: rows[-1][k] for k in ("scene", "label", "render_s", "rel_mse", "bias", "flip", "alpha")},
            flush=True,
        )

    caches: dict[str, Cache] = {}
    for method, label, chosen in our_methods(*size, o.methods):
        cache = caches.setdefault("rays" if method in ("conventional", "distributed") else method, Cache())
        add(method, label, *ours(scene, chosen, cache, o.rounds))
    if "cycles" in o.methods and name != "land":
        for n in RAYS:
            try:
                add("cycles", f"cycles:{n}", *cycles(blend.ensure(name, OUT), n, size, o.rounds))
            except WorkerError as error:
                print(f"cycles:{n}: {error}")
    return rows


def equal_error(rows: list[dict], method: str, target: dict) -> str:
    """What a rival takes for the error of `target`, read off its curve on a log-log plot."""
    curve = sorted((r for r in rows if r["method"] == method), key=lambda r: r["rel_mse"])
    if len(curve) < 2:
        return "-"
    error = np.log([r["rel_mse"] for r in curve])
    seconds = np.log([r["render_s"] for r in curve])
    goal = np.log(target["rel_mse"])
    if goal > error[-1]:
        return f"< {np.exp(seconds[-1]):.2f}"
    if goal < error[0]:
        return f"> {np.exp(seconds[0]):.2f}"
    return f"{np.exp(np.interp(goal, error, seconds)):.2f}"


def main() -> None:
    o = arguments(
        __doc__,
        scenes=["forest", "dragon", "gn_trees"],
        size=640,
        reference_samples=1024,
        rounds=2,
        methods=["static", "dynamic", "conventional", "distributed", "cycles"],
    )
    of = {"size": [o.size, o.size * 3 // 4], "reference_samples": o.reference_samples}
    record = OUT / "error_time.json"
    known = json.loads(record.read_text()) if record.is_file() else []
    rows = [r for r in known if r["scene"] not in o.scenes and of.items() <= r.items()]  # of earlier runs
    for name in o.scenes:
        rows += [r | of for r in measure(name, o)]
        OUT.mkdir(parents=True, exist_ok=True)
        record.write_text(json.dumps(rows))
    panels, summary = [], []
    names = list(dict.fromkeys(r["scene"] for r in rows))
    for name in names:
        mine = [r for r in rows if r["scene"] == name]
        for key, label in (("rel_mse", "relative MSE"), ("flip", "mean FLIP")):
            panels.append(
                {
                    "title": f"{name}: {label}",
                    "xlabel": "rendering phase, s",
                    "ylabel": label,
                    "yscale": "log",
                    "curves": {
                        m: tuple([r[k] for r in mine if r["method"] == m] for k in ("render_s", key))
                        for m in dict.fromkeys(r["method"] for r in mine)
                    },
                }
            )
        default = next((r for r in mine if r["label"] == DEFAULT), None)
        if default:
            rivals = [equal_error(mine, m, default) for m in ("distributed", "cycles")]
            summary.append(
                [
                    name,
                    f"{default['flip']:.4f}",
                    f"{default['rel_mse']:.2e}",
                    f"{default['render_s']:.3f}",
                    *rivals,
                ]
            )
    plot(o.output / "forward-error-time.png", panels)
    table = markdown(
        ["scene", "method:samples", *(c[0] for c in COLUMNS)],
        [[r["scene"], r["label"], *(format(r[k], f) for _, k, f in COLUMNS)] for r in rows],
    )
    typed = f"--scenes {' '.join(names)} --size {o.size} --reference-samples {o.reference_samples}".split()
    text = [
        f"# Forward mapping: error against run time\n\n`{command('benchmarks.forward.error_time', typed)}`, "
        f"{o.size} x {o.size * 3 // 4} pixels, reference of {o.reference_samples} samples.",
        "One sun without shadow, Lambertian surfaces, the same pixel filter; relMSE = mean((I-R)^2/(R^2+0.01)), "
        "bias is relMSE less the noise of image and reference. Seconds of the rendering phase alone.",
        "![error against run time](forward-error-time.png)",
        "The default quality, and the seconds that rivals take for the same relMSE:",
        markdown(["scene", "FLIP", "relMSE", "render s", "distributed s", "Cycles s"], summary),
        table,
    ]
    write(o.output, "forward-error-time.md", "\n\n".join(text))


if __name__ == "__main__":
    main()
