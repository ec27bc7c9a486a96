"""The same work on many items, by threads: for numpy and kernels, which leave Python's lock alone."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait

TOLD = 0.1  # seconds between reports


def run_all(
    work: Callable,
    items: Sequence,
    threads: int | None = None,
    progress: Callable[[float], object] | None = None,
) -> None:
    """work(*item) for all items, each on some thread, in no order. threads: at once; None or 0: one per core.

    progress(fraction) is called from this thread, and may raise to cancel: what is under way ends first. Raises what
    `work` raises.
    """
    count = min(threads or os.cpu_count() or 1, len(items))
    if count < 2:
        for k, item in enumerate(items):
            if progress:
                progress(k / len(items))
            work(*item)
        return
    pool = ThreadPoolExecutor(count, thread_name_prefix="pointmr-all")
    try:
        pending = {pool.submit(work, *item) for item in items}
        while pending:
            if progress:
                progress(1.0 - len(pending) / len(items))
            finished, pending = wait(pending, timeout=TOLD, return_when=FIRST_EXCEPTION)
            for future in finished:
                future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
