"""What a running export says to its caller: messages by name, progress, and whether to stop."""

from __future__ import annotations

import time
from collections.abc import Callable

Report = Callable[[str, str], None]


class Cancelled(Exception):
    """The user stopped the export; nothing that it built may be used."""


class Watch:
    """Messages (each once), progress and cancel of one export.

    report(level, message): level "INFO", "WARNING" or "ERROR"; the message names the object.
    cancel() -> bool is asked at most every 0.1 s. progress(fraction 0..1, text).
    """

    INTERVAL = 0.1

    def __init__(self, report: Report | None, cancel=None, progress=None):
        self._report, self._cancel, self._progress = report, cancel, progress
        self._said: set[tuple[str, str]] = set()
        self._asked = 0.0
        self.messages: list[tuple[str, str]] = []

    def say(self, level: str, message: str) -> None:
        """Pass a message on, once."""
        if (level, message) in self._said:
            return
        self._said.add((level, message))
        self.messages.append((level, message))
        if self._report is not None:
            self._report(level, message)

    def warn(self, message: str) -> None:
        self.say("WARNING", message)

    def error(self, message: str) -> None:
        self.say("ERROR", message)

    def poll(self, fraction: float | None = None, text: str = "") -> None:
        """Raise Cancelled if the user wants to stop; tell the progress if given. Cheap: call it in every loop."""
        now = time.monotonic()
        if now - self._asked < self.INTERVAL:
            return
        self._asked = now
        if self._cancel is not None and self._cancel():
            raise Cancelled
        if fraction is not None and self._progress is not None:
            self._progress(fraction, text)
