"""A render in a thread of its own: Blender's thread stays free to show progress and to hear Esc at once.

No function here touches bpy: what a job holds (scene, settings, pixels) is the engine's plain data, so a job
that was cancelled may outlive the RenderEngine that started it.
"""

from __future__ import annotations

import threading

from . import kernel_cache


class RenderJob:
    """One call of the engine's `render`, running in the background from construction on.

    fraction 0..1 and text: how far it is. frame: the result, None until done. error: the exception that ended
    it. cache: the engine's, which a job has to itself.
    """

    def __init__(self, scene, settings, cache=None):
        self.fraction = 0.0
        self.text = ""
        self.frame = None
        self.error: BaseException | None = None
        self._tiles: list = []
        self._lock = threading.Lock()
        self._cancelled = threading.Event()
        self._finished = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(scene, settings, cache), name="PointMR render", daemon=True
        )
        self._thread.start()

    def _run(self, scene, settings, cache) -> None:
        try:
            self.text = "Loading kernels"
            kernel_cache.prepare()
            from pointmr_engine.render import render

            if not self._cancelled.is_set():
                self.frame = render(scene, settings, progress=self._progress, cache=cache)
        except BaseException as error:  # handed to the thread that waits for it
            if not self._cancelled.is_set():
                self.error = error
        finally:
            self._finished.set()

    def _progress(self, fraction: float, text: str, tile=None) -> bool:
        self.fraction, self.text = fraction, text
        if tile is not None:
            with self._lock:
                self._tiles.append(tile)
        return self._cancelled.is_set()

    def take_tiles(self) -> list:
        """The engine's Tiles (x, y, pixels) finished since the last call."""
        with self._lock:
            tiles, self._tiles = self._tiles, []
        return tiles

    def cancel(self) -> None:
        """Ask the job to stop; it does at its next progress call. Its result is to be ignored."""
        self._cancelled.set()

    @property
    def cancelled(self) -> bool:
        return self._cancelled.is_set()

    @property
    def done(self) -> bool:
        return self._finished.is_set()

    def wait(self, seconds: float) -> bool:
        """Wait until done, at most `seconds`; whether it is done."""
        return self._finished.wait(seconds)
