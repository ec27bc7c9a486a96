"""References by Cycles from independent seeds, kept on disk by the content of what they show."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import methods
from benchmarks.processes import Worker
from benchmarks.sources import Source, text_hash

HALF_SEEDS = (7001, 7002)  # far from the seeds of the renders that are measured


@dataclass(frozen=True)
class Reference:
    """Independent halves (h, w, 4) of a reference image; their mean is the reference."""

    halves: list[np.ndarray]
    samples: int  # of both halves together

    @property
    def image(self) -> np.ndarray:
        return np.mean(self.halves, axis=0)


def key_of(source: Source, size, samples: int, overrides: dict) -> str:
    """What identifies a reference: the scene's content, size, samples and every setting that shapes the image."""
    settings = methods.SHARED | methods.CYCLES_ONLY | source.overrides | overrides
    return text_hash(methods.PROTOCOL, source.content, size, samples, settings)


def reference(
    source: Source,
    size,
    samples: int,
    threads: int,
    cache: Path,
    overrides: dict | None = None,
    worker: Worker | None = None,
) -> Reference:
    """The reference of a scene: from the cache, or rendered anew as two halves of `samples`, by `worker` if one is
    given and else in a process of its own.
    """
    overrides = overrides or {}
    path = cache / f"{source.name}-{size[0]}x{size[1]}-{key_of(source, size, samples, overrides)}.npz"
    if path.is_file():
        with np.load(path) as stored:
            return Reference(list(stored["halves"]), samples)
    cache.mkdir(parents=True, exist_ok=True)
    if worker is None:
        with Worker(cache / f"{path.stem}.log") as own:
            halves = render_halves(source, size, samples, threads, overrides, own, path)
    else:
        halves = render_halves(source, size, samples, threads, overrides, worker, path)
    beside = path.with_suffix(f".{os.getpid()}.npz")
    np.savez_compressed(beside, halves=np.stack(halves))
    beside.rename(path)
    return Reference(halves, samples)


def render_halves(source, size, samples, threads, overrides, worker, path: Path) -> list[np.ndarray]:
    """Render a scene once with each seed of HALF_SEEDS."""
    method = methods.Method("cycles", max(1, samples // len(HALF_SEEDS)))
    worker.load(source.argument, method, size, threads, overrides)
    out = path.with_suffix(f".{os.getpid()}.exr")
    halves = []
    try:
        for seed in HALF_SEEDS:
            worker.render(seed, out)
            halves.append(methods.read_exr(str(out))[0])
    finally:
        out.unlink(missing_ok=True)
    return halves
