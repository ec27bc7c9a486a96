"""Error against time: method "raytrace" beside Cycles, `distributed` and `conventional`, on scenes simple and complex.

    python -m benchmarks.multires.curves [--scenes gn_trees ...] [--size 320x240] [--cones 1 4 16]
        [--rivals cycles:1,4,16,64 distributed:1,4,16,64 conventional] [--reference-samples 1024] [--references-only]

Writes docs/benchmarks/raytrace-WIDTHxHEIGHT.md with all scenes that were measured so far at this size, and a plot a
scene.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys

from benchmarks.judge import size_of
from benchmarks.methods import Method, parse_methods
from benchmarks.multires import measuring, page
from benchmarks.multires.renderers import add_options, reference, seeds_of
from benchmarks.multires.scenes import SUBJECTS
from benchmarks.processes import WorkerError
from benchmarks.report import command


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="benchmarks.multires.curves", description=__doc__.split("\n\n")[0])
    parser.add_argument("--scenes", nargs="+", choices=list(SUBJECTS), default=list(SUBJECTS))
    parser.add_argument("--size", type=size_of, default=(320, 240), help="WIDTHxHEIGHT")
    parser.add_argument("--ours", default="raytrace", help="the method that is judged: raytrace or forward")
    parser.add_argument("--cones", nargs="+", type=int, default=[1, 4, 16], help="qualities of --ours")
    parser.add_argument(
        "--rivals", nargs="*", default=["cycles:1,4,16,64", "distributed:1,4,16,64", "conventional"]
    )
    parser.add_argument("--reference-samples", type=int, default=1024, help="in seeds of 512, at least two")
    parser.add_argument(
        "--references-only", action="store_true", help="render what is missing, measure nothing"
    )
    parser.add_argument("--runs", type=int, default=3, help="timed rounds, after one to settle")
    add_options(parser)
    options = parser.parse_args(argv)
    options.methods = [Method(options.ours, n) for n in options.cones] + parse_methods(options.rivals)
    return options


def measure(subject: str, o: argparse.Namespace, typed: str) -> dict:
    """One scene's result, JSON-able. Raises WorkerError if there is no reference."""
    halves = reference(subject, o.size, o.reference_samples, o.threads, o.cache, typed)
    impossible = {"cycles"} if SUBJECTS[subject].reference != "cycles" else set()
    methods = [m for m in o.methods if m.name not in impossible]
    rows = measuring.measure(subject, methods, o.size, o.runs, o.threads, o.out)
    measuring.judge(subject, rows, halves, o.out)
    seeds, each = seeds_of(o.reference_samples)
    return {
        "scene": subject,
        "command": typed,
        "size": list(o.size),
        "ours": o.ours,
        "reference": f"{SUBJECTS[subject].reference}, {seeds} seeds of {each} samples",
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "threads": o.threads or os.cpu_count(),
        "rows": rows,
    }


def main(argv: list[str] | None = None) -> int:
    o = arguments(argv)
    typed = command("benchmarks.multires.curves", argv)
    results = o.out / "curves" / f"{o.size[0]}x{o.size[1]}-{o.ours}"
    results.mkdir(parents=True, exist_ok=True)
    failed = 0
    for subject in o.scenes:
        try:
            if o.references_only:
                reference(subject, o.size, o.reference_samples, o.threads, o.cache, typed)
                continue
            result = measure(subject, o, typed)
        except (FileNotFoundError, WorkerError) as error:
            print(f"{subject}: {error}", file=sys.stderr)
            failed += 1
            continue
        (results / f"{subject}.json").write_text(json.dumps(result, indent=1, default=str))
        failed += sum("failure" in row for row in result["rows"])
        print(page.section(result), flush=True)
        known = [json.loads(f.read_text()) for s in SUBJECTS if (f := results / f"{s}.json").is_file()]
        page.write(known, o.docs)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
