"""Stability along a camera path: how far the change from frame to frame is from the reference's.

    python -m benchmarks.multires.path [--scenes gn_trees ...] [--size 160x120] [--frames 60] [--cones 1]
        [--rivals cycles distributed] [--reference-samples 256]

A method that pops between levels changes where the reference does not. For each pair of frames the temporal error is
mean |(ours(t+1) - ours(t)) - (R(t+1) - R(t))| over pixels and channels, over grey and clipped to 0..1 as it is shown.
Each rival gets the number of samples that takes about our time. Seeds stay the same from frame to frame, as both
programs have it unless asked; the reference's do not. Writes docs/benchmarks/raytrace-path.md, contact sheets, and
slices: one row of pixels over time, where popping shows as a break.
"""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmarks import methods, pictures
from benchmarks.judge import size_of
from benchmarks.metrics import over_backdrop
from benchmarks.multires.renderers import Renderer, add_options
from benchmarks.multires.scenes import SUBJECTS, source
from benchmarks.processes import WorkerError
from benchmarks.report import command, markdown
from benchmarks.sources import text_hash

SEED, REFERENCE_SEED = 11, 9001
MOST = 1024  # samples a pixel that a rival is given
SHOWN = 6  # frames of each method on the contact sheet
COLUMNS = [
    "scene",
    "method",
    "s a frame",
    "temporal error",
    "of it reference's noise",
    "worst pair",
    "median pair",
]


def motion(t: float, reach: float) -> np.ndarray:
    """4x4 movement in the camera's own frame at t in 0..1: forward by 0.35 reach, swaying and turning a little."""
    sway = np.sin(2 * np.pi * t)
    yaw = 0.06 * sway
    m = np.eye(4)
    m[0, 0], m[0, 2], m[2, 0], m[2, 2] = np.cos(yaw), np.sin(yaw), -np.sin(yaw), np.cos(yaw)
    m[:3, 3] = (0.06 * reach * sway, 0.03 * reach * sway, -0.35 * reach * t)
    return m


def shown(image: np.ndarray) -> np.ndarray:
    """What a viewer sees of it, linear: over grey, clipped to 0..1, float32 (h, w, 3)."""
    return np.clip(np.nan_to_num(over_backdrop(image)), 0.0, 1.0).astype(np.float32)


def temporal_error(frames: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(T-1,) mean absolute difference between the changes of two films (T, h, w, 3) from frame to frame."""
    return np.abs(np.diff(frames, axis=0) - np.diff(truth, axis=0)).mean(axis=(1, 2, 3))


def film(renderer: Renderer, out: Path, samples: int, views, seeds) -> tuple[np.ndarray, list[float]]:
    """(frames (T, h, w, 3), seconds of each) along the views."""
    frames, seconds = [], []
    for view, seed in zip(views, seeds, strict=True):
        pixels, answer = renderer.image(out, samples, seed, camera=view)
        frames.append(shown(pixels))
        seconds.append(answer["render_s"])
    return np.stack(frames), seconds


def reference(subject: str, o, views) -> np.ndarray:
    """Two films of the reference, (2, T, h, w, 3), from the cache or rendered now."""
    found, how = source(subject), SUBJECTS[subject].reference
    settings = methods.SHARED | methods.CYCLES_ONLY | found.overrides
    moved = [v.round(9).tolist() for v in views]
    key = text_hash(methods.PROTOCOL, found.content, how, o.size, o.reference_samples, settings, moved)
    path = o.cache / f"{subject}-path-{o.size[0]}x{o.size[1]}-{key}.npz"
    if path.is_file():
        return np.load(path)["films"]
    path.parent.mkdir(parents=True, exist_ok=True)
    with Renderer(path.with_suffix(".log")) as renderer:
        renderer.open(subject, how, o.size, o.threads)
        films = []
        for k in range(2):
            seeds = REFERENCE_SEED + 1000 * k + np.arange(len(views))
            work = path.with_suffix(".frame")
            films.append(film(renderer, work, o.reference_samples // 2, views, seeds.tolist())[0])
    np.savez_compressed(path, films=np.stack(films))
    return np.stack(films)


def equal_samples(renderer: Renderer, out: Path, goal: float, view) -> int:
    """The number of samples that take a rival about `goal` seconds: doubled until they do, then interpolated."""
    renderer.image(out, 1, SEED, camera=view)
    n, before = 1, 0.0
    while n < MOST:
        seconds = renderer.image(out, n, SEED, camera=view)[1]["render_s"]
        if seconds >= goal:
            return max(1, round(n / 2 * (1 + (goal - before) / max(seconds - before, 1e-6)))) if n > 1 else 1
        n, before = 2 * n, seconds
    return n


def measure(subject: str, o) -> tuple[list[dict], dict[str, np.ndarray]]:
    """(rows, films by label) of one scene."""
    views = [motion(t, SUBJECTS[subject].reach) for t in np.linspace(0.0, 1.0, o.frames)]
    halves = reference(subject, o, views)
    truth = halves.mean(0)
    rows, films = [], {}
    noise = float(temporal_error(*halves).mean()) / 2  # of the mean of both, from their difference

    def add(label: str, frames: np.ndarray, seconds: list[float]) -> None:
        errors = temporal_error(frames, truth)
        films[label] = frames
        rows.append({"scene": subject, "label": label, "seconds": float(np.median(seconds)), "noise": noise,
                     "errors": errors.tolist()})  # fmt: skip
        print(subject, label, f"{np.median(seconds):.3f} s, temporal error {errors.mean():.5f}", flush=True)

    folder = o.out / "path" / subject
    seeds = [SEED] * o.frames
    with Renderer(folder / "ours.log") as renderer:
        renderer.open(subject, o.ours, o.size, o.threads)
        film(renderer, folder / "ours", o.cones, views, seeds)  # makes what the path needs
        frames, seconds = film(renderer, folder / "ours", o.cones, views, seeds)
    add(f"{o.ours}:{o.cones}", frames, seconds)
    goal = float(np.median(seconds))
    for rival in o.rivals:
        if rival == "cycles" and SUBJECTS[subject].reference != "cycles":
            continue
        try:
            with ExitStack() as stack:
                renderer = stack.enter_context(Renderer(folder / f"{rival}.log"))
                renderer.open(subject, rival, o.size, o.threads)
                samples = equal_samples(renderer, folder / rival, goal, views[0])
                add(f"{rival}:{samples}", *film(renderer, folder / rival, samples, views, seeds))
        except WorkerError as error:
            print(f"{subject}, {rival}: {error}", file=sys.stderr)
    films["reference"] = truth
    return rows, films


def draw(subject: str, films: dict[str, np.ndarray], folder: Path) -> None:
    """The contact sheet: some frames of each method, and below them the slice of its middle row over time."""
    lines = []
    for label, frames in films.items():
        chosen = np.linspace(0, len(frames) - 1, SHOWN).round().astype(int)
        for t in chosen:
            lines.append(pictures.labelled(pictures.to_bytes(frames[t]), f"{label}, frame {t}"))
    pictures.contact_sheet(lines, folder / f"raytrace-path-{subject}.png", SHOWN)
    slices = []
    for label, frames in films.items():
        row = frames[:, int(0.55 * frames.shape[1])]
        tall = np.repeat(np.repeat(pictures.to_bytes(row), 3, 0), 3, 1)
        slices.append(pictures.labelled(tall, f"{label}: one row of pixels, time downward"))
    pictures.contact_sheet(slices, folder / f"raytrace-slices-{subject}.png", 2)


def row_of(row: dict) -> list[str]:
    errors = np.array(row["errors"])
    values = (errors.mean(), row["noise"], errors.max(), np.median(errors))
    return [row["scene"], row["label"], f"{row['seconds']:.3f}", *(f"{v:.5f}" for v in values)]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="benchmarks.multires.path", description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "--scenes", nargs="+", choices=list(SUBJECTS), default=["gn_trees", "dragon_far", "horizon", "fence"]
    )
    parser.add_argument("--size", type=size_of, default=(160, 120))
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--ours", default="raytrace")
    parser.add_argument("--cones", type=int, default=1)
    parser.add_argument("--rivals", nargs="*", default=["cycles", "distributed"])
    parser.add_argument("--reference-samples", type=int, default=256, help="a frame, in two seeds")
    add_options(parser)
    o = parser.parse_args(argv)
    o.docs.mkdir(parents=True, exist_ok=True)
    rows, failed = [], 0
    typed = command("benchmarks.multires.path", argv)
    for subject in o.scenes:
        try:
            mine, films = measure(subject, o)
        except (FileNotFoundError, WorkerError) as error:
            print(f"{subject}: {error}", file=sys.stderr)
            failed += 1
            continue
        rows += mine
        draw(subject, films, o.docs)
        sheets = [
            f"![{s}](raytrace-path-{s}.png)\n\n![{s}](raytrace-slices-{s}.png)"
            for s in dict.fromkeys(r["scene"] for r in rows)
        ]
        about = __doc__.split("\n\n")[2].partition(" Writes")[0]
        text = [
            "# Stability along a camera path",
            f"`{typed}`",
            f"{about}",
            markdown(COLUMNS, map(row_of, rows)),
        ]
        (o.docs / "raytrace-path.md").write_text("\n\n".join([*text, *sheets]) + "\n")
        (o.out / "path.json").write_text(json.dumps(rows))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
