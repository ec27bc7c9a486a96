"""Frames of one .blend file over several processes, each a `pointmr` worker that keeps the file open.

A worker reads frame numbers from its standard input, one per line, and answers with one JSON object per line:
{"event": "progress" | "message" | "done" | "failed", "frame": ..., ...}. A worker that dies takes only its frame along.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from pathlib import Path

GRACE = 5.0  # seconds that workers get to stop by themselves


def parse_frames(text: str) -> list[int]:
    """Frames of a list such as "1-24", "1,3,5-9" or "1-100/10" (every tenth), sorted, each once. Else ValueError."""
    frames: set[int] = set()
    for item in text.split(","):
        span, _, step = item.strip().partition("/")
        first, dash, last = span.partition("-")
        if not first.isdigit() or (dash and not last.isdigit()) or (step and not step.isdigit()):
            raise ValueError(f"'{item.strip()}' is not a frame or a range of frames such as 1-24")
        start, stop = int(first), int(last or first)
        if stop < start or (step and int(step) < 1):
            raise ValueError(f"the range '{item.strip()}' is empty")
        frames.update(range(start, stop + 1, int(step or 1)))
    return sorted(frames)


def share(frames: list[int], part: str | None) -> list[int]:
    """Every Nth frame from the Kth on for part "K/N", so that N machines share a job; all frames for None."""
    if part is None:
        return frames
    k, slash, n = part.partition("/")
    if not (slash and k.isdigit() and n.isdigit() and 1 <= int(k) <= int(n)):
        raise ValueError(f"'{part}' is not K/N with 1 <= K <= N")
    return frames[int(k) - 1 :: int(n)]


class Worker:
    """One process and the frame that it is busy with (None: idle)."""

    def __init__(self, command: list[str], events: queue.Queue):
        self.frame: int | None = None
        self.ending = False
        # a session of its own: Ctrl-C reaches the parent only, which then stops its workers in order
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
        self.process = subprocess.Popen(command, env=_environment(), start_new_session=True, **pipes)
        threading.Thread(target=self._listen, args=(events,), daemon=True).start()

    def _listen(self, events: queue.Queue) -> None:
        for line in self.process.stdout:
            try:
                event = json.loads(line)
            except ValueError:
                continue  # a line that some library printed
            events.put((self, event))
        events.put((self, {"event": "ended", "code": self.process.wait()}))

    def start(self, frame: int) -> None:
        """Hand it a frame."""
        self.frame = frame
        try:
            self.process.stdin.write(f"{frame}\n")
            self.process.stdin.flush()
        except OSError:
            pass  # it has died: the "ended" event says so

    def finish(self) -> None:
        """No more frames: it ends by itself."""
        self.ending = True
        try:
            self.process.stdin.close()
        except OSError:
            pass

    def stop(self) -> None:
        """Ask it to drop its frame."""
        if self.process.poll() is None:
            if sys.platform == "win32":
                self.process.terminate()
            else:
                self.process.send_signal(signal.SIGINT)


def _environment() -> dict[str, str]:
    """This process' environment, in which a child finds the same packages, whatever folder it starts in."""
    root = str(Path(__file__).resolve().parents[1])
    path = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{path}" if path else root}


def worker_command(arguments: list[str]) -> list[str]:
    """The command line of a worker with `pointmr render`'s arguments."""
    return [sys.executable, "-m", "blender_addon.cli", "render", *arguments, "--worker"]


def render_frames(
    command: list[str], frames: Iterable[int], jobs: int, on_event: Callable[[dict], None]
) -> tuple[list[int], list[int]]:
    """Render `frames` with up to `jobs` workers; returns the frames (done, failed).

    on_event hears of every worker event, on this thread. A worker that dies fails its frame, and is replaced while
    frames remain. KeyboardInterrupt stops the workers, which leave no half file, and is raised again.
    """
    waiting = list(frames)
    events: queue.Queue = queue.Queue()
    done: list[int] = []
    failed: list[int] = []
    workers: set[Worker] = set()

    def feed(worker: Worker) -> None:
        if waiting:
            worker.start(waiting.pop(0))
        else:
            worker.frame = None
            worker.finish()

    try:
        for _ in range(min(jobs, len(waiting))):
            worker = Worker(command, events)
            workers.add(worker)
            feed(worker)
        while workers:
            worker, event = events.get()
            kind = event.get("event")
            if kind == "ended":
                workers.discard(worker)
                if worker.frame is not None:
                    failed.append(worker.frame)
                    reason = f"its process ended with code {event['code']}"
                    on_event({"event": "failed", "frame": worker.frame, "error": reason})
                if waiting and not worker.ending:
                    worker = Worker(command, events)
                    workers.add(worker)
                    feed(worker)
                continue
            if kind in ("done", "failed"):
                (done if kind == "done" else failed).append(event["frame"])
                worker.frame = None
                on_event(event)
                if event.get("fatal"):
                    waiting.clear()  # what stopped this frame stops them all
                feed(worker)
            else:
                on_event(event)
    except KeyboardInterrupt:
        for worker in workers:
            worker.stop()
        for worker in workers:
            try:
                worker.process.wait(GRACE)
            except subprocess.TimeoutExpired:
                worker.process.kill()
        raise
    return sorted(done), sorted(failed)
