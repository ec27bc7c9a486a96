"""Worker processes of the judge: started, loaded, asked for one image after the other, and ended."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from pathlib import Path

from benchmarks.methods import Method

ROOT = Path(__file__).resolve().parents[1]


class WorkerError(RuntimeError):
    """A worker could not load or render; the message is the renderer's own."""


class Worker:
    """One process that holds a scene and renders it with one method, and may load another scene after that.

    Its output goes to the file `log`. `module` is what the process runs. Use as a context manager.
    """

    def __init__(self, log: Path, timeout: float = 1200.0, module: str = "benchmarks.worker"):
        log.parent.mkdir(parents=True, exist_ok=True)
        self.timeout, self.log_path, self.label = timeout, log, ""
        self.log = open(log, "w")
        self.process = subprocess.Popen(
            [sys.executable, "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.log,
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])},
        )

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    def load(self, scene: str, method: Method, size, threads: int = 0, overrides: dict | None = None) -> dict:
        """Load a scene for a method. size: (width, height) or None for the scene's own; threads: 0 for one per core.
        Raises WorkerError when the scene cannot be loaded.
        """
        self.label = f"{scene}, {method.label}"
        order = {"scene": scene, "method": method.name, "samples": method.samples}
        return self.ask(order | {"size": size, "threads": threads, "overrides": overrides or {}})

    def ask(self, order: dict) -> dict:
        """Send one order, wait for its answer. Raises WorkerError with the worker's message, or when it dies."""
        try:
            self.process.stdin.write((json.dumps(order) + "\n").encode())
            self.process.stdin.flush()
        except BrokenPipeError:
            raise WorkerError(f"{self.label}: the process has ended; see {self.log_path}") from None
        ready, _, _ = select.select([self.process.stdout], [], [], self.timeout)
        if not ready:
            raise WorkerError(f"{self.label}: no answer within {self.timeout:.0f} s; see {self.log_path}")
        line = self.process.stdout.readline()
        if not line:
            code = self.process.wait()
            raise WorkerError(f"{self.label}: the process ended with code {code}; see {self.log_path}")
        answer = json.loads(line)
        if "error" in answer:
            self.log.write(answer.get("trace", ""))
            self.log.flush()
            raise WorkerError(f"{self.label}: {answer['error']}")
        return answer

    def render(self, seed: int, out: Path) -> dict:
        """Render one image to an EXR file: times in seconds, memory in MB (benchmarks.worker)."""
        return self.ask({"seed": seed, "out": str(out)})

    def close(self) -> None:
        """End the process."""
        if self.alive:
            try:
                self.process.stdin.write(b'{"stop": true}\n')
                self.process.stdin.close()
                self.process.wait(timeout=5)
            except (OSError, subprocess.TimeoutExpired):
                self.process.kill()
                self.process.wait()
        self.process.stdout.close()
        self.log.close()

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_) -> None:
        self.close()
