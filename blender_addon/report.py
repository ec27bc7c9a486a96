"""Messages to the user: each once, through Blender's report, safe to call from any thread."""

from __future__ import annotations

import threading
from collections.abc import Callable

LEVELS = ("INFO", "WARNING", "ERROR")


class Reporter:
    """Collects messages and hands them to Blender on the thread that may talk to it.

    `reporter(level, message)` may be called from any thread; `flush()` sends what came in through
    `send({level}, message)`, normally `RenderEngine.report`. The same message is sent once in a reporter's
    life; after `LIMIT` warnings one line says how many more there were (a scene of a thousand bad meshes
    stays readable).
    """

    LIMIT = 50

    def __init__(self, send: Callable[[set[str], str], None]):
        self._send = send
        self._lock = threading.Lock()
        self._said: set[tuple[str, str]] = set()
        self._waiting: list[tuple[str, str]] = []
        self._sent_warnings = 0
        self._held_back = 0

    def __call__(self, level: str, message: str) -> None:
        level = level if level in LEVELS else "WARNING"
        with self._lock:
            if (level, message) not in self._said:
                self._said.add((level, message))
                self._waiting.append((level, message))

    def flush(self) -> None:
        """Send what is waiting. Call it only where Blender's API may be used."""
        with self._lock:
            waiting, self._waiting = self._waiting, []
        for level, message in waiting:
            if level == "WARNING":
                if self._sent_warnings >= self.LIMIT:
                    self._held_back += 1
                    continue
                self._sent_warnings += 1
            self._send({level}, message)

    def close(self) -> None:
        """Flush, and tell how many warnings were held back."""
        self.flush()
        if self._held_back:
            self._send({"WARNING"}, f"and {self._held_back} more warnings")
            self._held_back = 0

    @property
    def messages(self) -> list[tuple[str, str]]:
        """All distinct (level, message) so far, sorted."""
        with self._lock:
            return sorted(self._said)
