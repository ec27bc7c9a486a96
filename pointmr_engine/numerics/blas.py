"""One thread for numpy's linear algebra while images are made."""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController

_lock = threading.Lock()
_renders, _limit = 0, None


@functools.cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()  # looks through all loaded libraries: once


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within, products of arrays run in the thread that asks for them; also a decorator. Renders may overlap.

    A product of a few thousand rows would wake the library's own threads, which then spin: they take the processors
    from the threads that render, and a render in one thread takes as many as there are.
    """
    global _renders, _limit
    with _lock:
        if _renders == 0:
            _limit = _libraries().limit(limits=1, user_api="blas")
        _renders += 1
    try:
        yield
    finally:
        with _lock:
            _renders -= 1
            if _renders == 0:
                _limit.restore_original_limits()
