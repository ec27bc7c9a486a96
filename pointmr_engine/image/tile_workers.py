"""Who renders an image's tiles: threads, or processes forked from this one.

Between its kernels a tile runs Python, and numpy on short arrays. Threads take turns at that (the interpreter's lock),
and each turn finds its data in the other core's cache. Forked processes share the scene, which nobody changes
meanwhile, and have an interpreter each, but take 0.2 s to start and to end (`python -m benchmarks.tile_workers`
measures both).
"""

from __future__ import annotations

import ctypes
import gc
import math
import mmap
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, ProcessPoolExecutor, ThreadPoolExecutor, wait
from multiprocessing import active_children, get_context
from pathlib import Path
from time import monotonic

import numpy as np

from pointmr_engine.image.frame import Frame

TOLD = 0.1  # seconds after which callers hear that nothing is finished
MEASURED = 2.0  # seconds between looks at the memory of processes
TILES = 2  # for each process at least: fewer are not worth to fork for
WORTH = 6.0  # seconds of a core: less work is done by threads before processes have made up for their start
_PR_SET_PDEATHSIG = 1

Bounds = tuple[int, int, int, int]
_most = 0
_work: Callable | None = None  # what a forked process does with a tile


def can_fork(tiles: int, threads: int) -> bool:
    """Whether so many tiles are rendered by processes where that is asked for: on Linux, and by more than one."""
    count = threads or os.cpu_count() or 1
    return sys.platform == "linux" and 1 < count and TILES * count <= tiles


def worth_a_fork(tiles: Iterable[Bounds], seconds: Mapping[Bounds, float]) -> bool:
    """Whether tiles will take WORTH, by the seconds of a core that some took; True where none are known."""
    pixels = sum(map(_area, seconds))
    rate = sum(seconds.values()) / pixels if pixels else math.inf
    return sum(seconds.get(tile, rate * _area(tile)) for tile in tiles) >= WORTH


def _area(bounds: Bounds) -> int:
    return (bounds[2] - bounds[0]) * (bounds[3] - bounds[1])


def most_memory() -> int:
    """Bytes that all forked processes together had of their own at most, besides what they share with this one."""
    return _most


def shared_zeros(shape: tuple[int, ...], dtype=np.float32) -> np.ndarray:
    """An array that processes forked from now on write into, too."""
    count = int(np.prod(shape))
    memory = mmap.mmap(-1, max(count * np.dtype(dtype).itemsize, 1))
    return np.frombuffer(memory, dtype, count).reshape(shape)


def share_passes(frame: Frame) -> None:
    """Move a frame's passes to memory that forked processes write into."""
    for name, values in frame.passes.items():
        frame.passes[name] = shared_zeros(values.shape, values.dtype)
        frame.passes[name][:] = values


def finished_tiles(
    work: Callable[[Bounds], object],
    tiles: list[Bounds],
    threads: int,
    apart: bool,
    warnings: list[str],
    stop: threading.Event,
) -> Iterator[object | None]:
    """What `work` returns for each of the tiles, in the order in which they finish; now and then None.

    threads: at once; 0: one per core. apart: by processes forked from this one, in which what `work` changes is theirs
    alone but for shared memory, and from which what it returns is pickled. If one of them is ended, threads go on, and
    `warnings` say so. Raises what `work` raises. Closing the iterator (contextlib.closing) ends all workers: processes
    at once, threads when their `work` returns, which may look at `stop`.
    """
    count = max(min(threads or os.cpu_count() or 1, len(tiles)), 1)
    others, measured = set(active_children()), monotonic()

    def unless_stopped(bounds: Bounds):
        return None if stop.is_set() else work(bounds)

    if apart:
        pool, task = ProcessPoolExecutor(count, get_context("fork"), _begin, (work,)), _run
    else:
        pool, task = ThreadPoolExecutor(count, thread_name_prefix="pointmr"), unless_stopped
    pending, broken = {}, []
    try:
        pending = {pool.submit(task, bounds): bounds for bounds in tiles}
        while pending:
            finished, _ = wait(pending, timeout=TOLD, return_when=FIRST_COMPLETED)
            if apart and monotonic() > measured + MEASURED:
                _measure(set(active_children()) - others)
                measured = monotonic()
            for future in finished:
                bounds = pending.pop(future)
                if isinstance(future.exception(), BrokenExecutor):
                    broken.append(bounds)
                else:
                    yield future.result()
            yield None
    finally:
        if pending:
            stop.set()
            for process in set(active_children()) - others if apart else ():
                process.kill()
        pool.shutdown(wait=True, cancel_futures=True)
    if broken:
        warnings.append("a process that rendered tiles was ended, by lack of memory perhaps: threads went on")
        yield from finished_tiles(work, broken, threads, False, warnings, stop)


def _begin(work: Callable) -> None:
    """A forked process starts: it leaves Ctrl-C to its parent, and ends with it."""
    global _work
    _work = work
    gc.freeze()  # looking at what is shared would copy it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _run(bounds: Bounds) -> object:
    return _work(bounds)


def _measure(processes: set) -> None:
    global _most
    own = 0
    for process in processes:
        try:
            lines = Path(f"/proc/{process.pid}/smaps_rollup").read_text().splitlines()
        except OSError:  # it has just ended
            continue
        own += sum(int(line.split()[1]) for line in lines if line.startswith("Private_"))
    _most = max(_most, 1024 * own)
