"""The judge: error, time and memory of any method, ours or Cycles', against one reference.

    python -m benchmarks.judge light_spot bmw27 --methods distributed:64,256 cycles:64,256 conventional

Each method with each sample count runs in a process of its own. All processes of a scene are loaded first; then they
render in turn, the first round to warm up, so that a machine that slows down slows all alike.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import statistics
import sys
from dataclasses import asdict
from pathlib import Path

from benchmarks import pictures, report, sources
from benchmarks.methods import Method, add_bounces, bounces, parse_methods, read_exr
from benchmarks.metrics import deviation
from benchmarks.processes import Worker, WorkerError
from benchmarks.reference import reference

FIRST_SEED = 11


def measure(
    source, methods: list[Method], size, runs: int, threads: int, out: Path, overrides: dict
) -> list[dict]:
    """Render a scene with each method in turn: a warm-up round, then `runs` timed rounds, each with its own seed.

    Returns one record a method: images (a list), times (medians, in seconds), memory (MB), or an "failure".
    """
    records = [{"method": m.name, "samples": m.samples, "label": m.label} for m in methods]
    folder = out / "renders" / source.name
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        workers, loaded = {}, {}
        for record, method in zip(records, methods, strict=True):
            log = folder / f"{method.name}-{method.samples}.log"
            worker = stack.enter_context(Worker(log))
            try:
                loaded[record["label"]] = worker.load(source.argument, method, size, threads, overrides)
                workers[record["label"]] = worker
            except WorkerError as error:
                record["failure"] = str(error)
        answers: dict[str, list[dict]] = {label: [] for label in workers}
        for run in range(runs + 1):
            for record in records:
                worker = workers.get(record["label"])
                if worker is None or "failure" in record:
                    continue
                path = folder / f"{record['method']}-{record['samples']}-{run}.exr"
                try:
                    answers[record["label"]].append(
                        worker.render(FIRST_SEED + run, path) | {"path": str(path)}
                    )
                except WorkerError as error:
                    record["failure"] = str(error)
        for record in records:
            if "failure" not in record:
                summarise(record, loaded[record["label"]], answers[record["label"]])
    return records


def summarise(record: dict, loaded: dict, answers: list[dict]) -> None:
    """Fill a record from a worker's answers; the first is the warm-up, whose image still counts for the noise."""
    timed = answers[1:] or answers
    record["images"] = [read_exr(a["path"])[0] for a in answers]
    record["first_s"] = answers[0]["total_s"]
    record["render_s"] = statistics.median(a["render_s"] for a in timed)
    record["before_s"] = statistics.median(a["before_s"] for a in timed)
    record["total_s"] = statistics.median(a["total_s"] for a in timed)
    record["spread"] = max(a["render_s"] for a in timed) / max(min(a["render_s"] for a in timed), 1e-9)
    record["peak_mb"] = max(a["peak_mb"] for a in answers)
    record["loaded_mb"] = answers[0]["loaded_mb"]
    record["missing"] = answers[0]["missing"]
    record["stats"] = answers[-1]["stats"]
    record["blender"] = loaded["blender"]


def judge(name: str, methods: list[Method], options) -> dict:
    """Measure one scene; writes its pictures and plot, and returns its result: JSON-able, with one row a method."""
    source = sources.find(name)
    size = options.size or source.size
    overrides = bounces(options)
    out = Path(options.out)
    cache = Path(options.cache)
    truth = reference(source, size, options.reference_samples, options.threads, cache, overrides)
    records = measure(source, methods, size, options.runs, options.threads, out, overrides)
    result = {
        "scene": source.name,
        "kind": source.kind,
        "size": list(size),
        "reference_samples": options.reference_samples,
        "threads": options.threads,
        "rows": [],
    }
    for record in records:
        images = record.pop("images", None)
        if images is not None:
            record |= asdict(deviation(images, truth.halves))
            noise = record["reference_noise"]
            record["error"] = record["rel_mse"] - (0.0 if math.isnan(noise) else noise)
            sheet = pictures.comparison(images[0], truth.image, source.name, record["label"])
            path = out / "pictures" / f"{source.name}-{record['label'].replace(':', '-')}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            sheet.save(path)
            record["picture"] = str(path)
        result["rows"].append(record)
    good = [r for r in result["rows"] if "failure" not in r]
    if len(good) > 1:
        pictures.plot_error_time(source.name, good, out / "plots" / f"{source.name}.png")
    return result


def size_of(text: str) -> tuple[int, int]:
    """ "320x240" -> (320, 240)."""
    width, _, height = text.lower().partition("x")
    return int(width), int(height)


def arguments(argv: list[str] | None = None):
    parser = argparse.ArgumentParser(prog="benchmarks.judge", description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "scenes", nargs="+", help='.blend files, names of scenes, patterns, "features", "real"'
    )
    parser.add_argument(
        "--methods", nargs="+", default=["distributed:64", "cycles:64"], help="name[:samples,...]"
    )
    parser.add_argument("--size", type=size_of, help="WIDTHxHEIGHT; each scene's own if not given")
    parser.add_argument("--reference-samples", type=int, default=1024)
    add_bounces(parser)
    parser.add_argument("--runs", type=int, default=3, help="timed renders, after one to warm up")
    parser.add_argument("--threads", type=int, default=0, help="0: one per core")
    parser.add_argument("--out", default="out/judge")
    parser.add_argument("--cache", default="out/references", help="where references are kept")
    options = parser.parse_args(argv)
    options.methods = parse_methods(options.methods)
    return options


def main(argv: list[str] | None = None) -> int:
    options = arguments(argv)
    results, failed = [], 0
    for name in sources.names(options.scenes):
        try:
            result = judge(name, options.methods, options)
        except (KeyError, FileNotFoundError, WorkerError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            failed += 1
            continue
        results.append(result)
        failed += sum("failure" in row for row in result["rows"])
        print(report.table([result]), flush=True)
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)
    typed = report.command("benchmarks.judge", argv)
    (out / "judge.json").write_text(json.dumps({"command": typed, "results": results}, indent=1, default=str))
    (out / "judge.md").write_text(f"`{typed}`\n\n{report.table(results)}\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
