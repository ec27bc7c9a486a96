"""One scene measured: every method with every number of samples, in turn, against the reference."""

from __future__ import annotations

import contextlib
import statistics
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks import pictures
from benchmarks.methods import Method
from benchmarks.metrics import deviation
from benchmarks.multires.renderers import Renderer
from benchmarks.processes import WorkerError

SEED = 11
TICK = 0.005  # seconds: Cycles tells hundredths, and 0.00 of a small image


def measure(subject: str, methods: list[Method], size, runs: int, threads: int, out: Path) -> list[dict]:
    """Rows, one a method and number of samples, with "images" and the medians of `runs` timed rounds, or a "failure".

    Each method has one process. All prepare first, anew for each number of samples where that changes what is prepared;
    then they render round by round, a first round to settle.
    """
    rows = [{"method": m.name, "samples": m.samples, "label": m.label} for m in methods]
    answers: dict[str, list[dict]] = {m.label: [] for m in methods}
    images: dict[str, list[np.ndarray]] = {m.label: [] for m in methods}
    folder = out / "renders" / subject
    with contextlib.ExitStack() as stack:
        renderers = {}
        for name in dict.fromkeys(m.name for m in methods):
            renderers[name] = stack.enter_context(Renderer(folder / f"{name}.log"))
            try:
                renderers[name].open(subject, name, size, threads)
            except WorkerError as error:
                fail(rows, name, error)
        prepared = set()
        for row in rows:  # ours: preparation and first image, in a cache of its own
            name = row["method"]
            if (
                "failure" in row
                or name == "cycles"
                or (name in prepared and name not in ("raytrace", "forward"))
            ):
                continue
            try:
                path = folder / f"{name}-{row['samples']}-first"
                _, row["first"] = renderers[name].image(path, row["samples"], SEED, fresh=True)
                prepared.add(name)
            except WorkerError as error:
                fail(rows, name, error, row)
        for run in range(runs + 1):
            for row in rows:
                if "failure" in row:
                    continue
                path = folder / f"{row['method']}-{row['samples']}-{run}"
                try:
                    pixels, answer = renderers[row["method"]].image(path, row["samples"], SEED + run)
                except WorkerError as error:
                    fail(rows, row["method"], error, row)
                    continue
                images[row["label"]].append(pixels)
                answers[row["label"]].append(answer)
        for row in rows:
            if "failure" not in row:
                summarise(row, answers[row["label"]], rows)
                row["images"] = images[row["label"]]
    return rows


def fail(rows: list[dict], method: str, error: WorkerError, only: dict | None = None) -> None:
    """Note a failure: of one row, or of all rows of a method that could not load or whose process has ended."""
    ended = "ended" in str(error) or "no answer" in str(error)
    for row in rows:
        if row is only or (row["method"] == method and (only is None or ended)):
            row.setdefault("failure", str(error))


def summarise(row: dict, answers: list[dict], rows: list[dict]) -> None:
    """Times (s) and memory (MB) of a row. render_s: one more image of a scene that is ready, least..most in "range_s".
    prepare_s: reading the scene and all that the first image takes more than a later one.
    """
    seconds = [max(a["render_s"], TICK) for a in answers[1:]]
    row["render_s"], row["range_s"] = statistics.median(seconds), [min(seconds), max(seconds)]
    row["peak_mb"] = max(a["peak_mb"] for a in answers)
    row["stats"] = answers[-1].get("stats", {})
    row["missing"], row["warnings"] = answers[-1].get("missing"), answers[-1].get("warnings", [])
    before = statistics.median(a["before_s"] for a in answers)
    if row["method"] == "cycles":
        row["prepare_s"] = before
        return
    first = row.pop("first", None)
    if first is None:  # what rays need does not depend on their number
        row["prepare_s"] = next(r["prepare_s"] for r in rows if r["method"] == row["method"])
    else:
        row["prepare_s"] = before + max(first["render_s"] - row["render_s"], 0.0)


def judge(subject: str, rows: list[dict], halves: list[np.ndarray], out: Path) -> None:
    """Replace the images of the rows by their errors, and write pictures of them beside the reference."""
    truth = np.mean(halves, axis=0)
    for row in rows:
        images = row.pop("images", None)
        if images is None:
            continue
        row |= asdict(deviation(images, halves))
        row["error"] = row["rel_mse"] - row["reference_noise"]
        path = out / "pictures" / f"{subject}-{row['label'].replace(':', '-')}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        pictures.comparison(images[0], truth, subject, row["label"]).save(path)
