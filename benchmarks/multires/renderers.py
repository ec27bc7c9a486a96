"""The worker processes of a scene, one a method, and references that are kept seed by seed."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

import numpy as np

from benchmarks import methods
from benchmarks.methods import Method, read_exr
from benchmarks.multires.scenes import source, subject_of
from benchmarks.processes import Worker
from benchmarks.sources import text_hash

TIMEOUT = 7200.0  # seconds that one image may take
SEED_SAMPLES = 512  # of one seed of a reference
FIRST_SEED = 7001  # of references, far from the seeds of the renders that are measured


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of all drivers that render: threads, and the folders of renders, references and pages."""
    parser.add_argument("--threads", type=int, default=0, help="0: one per core")
    parser.add_argument("--out", type=Path, default=Path("out/multires"))
    parser.add_argument("--cache", type=Path, default=Path("out/references"))
    parser.add_argument("--docs", type=Path, default=Path("docs/benchmarks"))


class Renderer(Worker):
    """A process that renders a subject with one method, with any number of samples."""

    def __init__(self, log: Path):
        super().__init__(log, TIMEOUT, "benchmarks.multires.worker")

    def open(self, subject: str, method: str, size, threads: int) -> dict:
        """Load a subject. Raises WorkerError."""
        self.suffix = ".exr" if method == "cycles" else ".npy"
        return self.load(subject, Method(method, 1), size, threads)

    def image(self, out: Path, samples: int, seed: int, fresh=False, camera=None) -> tuple[np.ndarray, dict]:
        """(image (h, w, 4) float32, top row first; times and memory). `out`: where it is kept, without a suffix."""
        out = out.resolve().with_name(out.name + self.suffix)
        out.parent.mkdir(parents=True, exist_ok=True)
        motion = None if camera is None else np.asarray(camera).tolist()
        answer = self.ask(
            {"seed": seed, "out": str(out), "samples": samples, "fresh": fresh, "camera": motion}
        )
        return np.load(out) if self.suffix == ".npy" else read_exr(str(out))[0], answer


def seeds_of(samples: int) -> tuple[int, int]:
    """(seeds, samples of each) of a reference: at least two seeds, for its noise is measured by their difference."""
    seeds = max(2, samples // SEED_SAMPLES)
    return seeds, samples // seeds


def reference_files(subject: str, size, samples: int, cache: Path) -> list[Path]:
    """Where the seeds of a reference are kept: under a hash of the scene's content and of every setting."""
    found, how = source(subject), subject_of(subject).reference
    seeds, each = seeds_of(samples)
    settings = methods.SHARED | (methods.CYCLES_ONLY if how == "cycles" else {}) | found.overrides
    key = text_hash(methods.PROTOCOL, found.content, how, size, each, settings)
    return [
        cache / f"{subject.replace(':', '-')}-{size[0]}x{size[1]}-{how}{each}-{key}-{FIRST_SEED + k}.npy"
        for k in range(seeds)
    ]


def reference(subject: str, size, samples: int, threads: int, cache: Path, command: str) -> list[np.ndarray]:
    """Independent images of the reference, one a seed: from the cache, or rendered now. Raises WorkerError."""
    how = subject_of(subject).reference
    each = seeds_of(samples)[1]
    files = reference_files(subject, size, samples, cache)
    missing = [f for f in files if not f.is_file()]
    if missing:
        cache.mkdir(parents=True, exist_ok=True)
        with Renderer(cache / f"{missing[0].stem}.log") as renderer:
            renderer.open(subject, how, size, threads)
            for path in missing:
                seed = int(path.stem.rpartition("-")[2])
                beside = path.with_name(f"{path.stem}.{os.getpid()}")
                pixels, answer = renderer.image(beside, each, seed)
                beside.with_name(beside.name + renderer.suffix).unlink()
                np.save(beside.with_name(beside.name + ".part.npy"), pixels)
                record = {"command": command, "samples": each, "seed": seed, "render_s": answer["render_s"]}
                path.with_suffix(".json").write_text(json.dumps(record))
                os.replace(beside.with_name(beside.name + ".part.npy"), path)
                print(f"reference {path.name}: {answer['render_s']:.1f} s", flush=True)
    return [np.load(f) for f in files]
