"""Who follows renders from outside Blender's window: the command line sets an observer, the engine tells it things."""

from __future__ import annotations


class Observer:
    """Hears of every render, on Blender's thread; this one does nothing, subclasses override what they need.

    layer: a view layer's name; scene, settings, frame: the engine's (pointmr_engine), not Blender's.
    """

    def stopped(self) -> bool:
        """Whether the render, or the export before it, is to end as soon as it can."""
        return False

    def reading(self, layer: str) -> None:
        """Blender has evaluated its scene; the export begins."""

    def exported(self, layer: str, scene, settings) -> None:
        """The export is done, the render comes next."""

    def progress(self, fraction: float, text: str) -> None:
        """How far the render of one layer is, 0..1, and what it is doing; during the export the fraction is 0."""

    def finished(self, layer: str, frame) -> None:
        """A layer's frame is done."""

    def message(self, level: str, text: str) -> None:
        """What the user should know; level "INFO", "WARNING" or "ERROR"."""


current = Observer()


def follow(observer: Observer | None) -> None:
    """Make `observer` the one that hears of renders from now on; None ends it."""
    global current
    current = observer or Observer()
