"""Where a rival's curve of error against samples crosses a given error: N*, and the time that this takes."""

from __future__ import annotations

import math
from dataclasses import dataclass

# log-log slopes of error against samples that are believed beyond the measured points
STEEPEST, FLATTEST = -2.0, -0.1


@dataclass(frozen=True)
class Crossing:
    """samples and seconds of a rival at an error. how: "measured" between two points, or "extrapolated" beyond them.

    Both are infinite where the curve has levelled off above the error ("never").
    """

    samples: float
    seconds: float
    how: str

    def text(self, value: str = "samples", pattern: str = ".3g") -> str:
        """The samples or the seconds, marked by ~ where extrapolated."""
        if self.how == "never":
            return "never"
        return ("~" if self.how == "extrapolated" else "") + format(getattr(self, value), pattern)


def crossing(points: list[dict], error: float, key: str = "error") -> Crossing | None:
    """Where the curve of `points` (dicts with samples, render_s and the error measure `key`) falls to `error`.

    Straight lines between logarithms. Beyond the points, the line through the two nearest is followed. None if there
    are fewer than two points.
    """
    curve = sorted((p for p in points if p[key] > 0.0), key=lambda p: p["samples"])
    if len(curve) < 2 or error <= 0.0:
        return None
    n = [math.log(p["samples"]) for p in curve]
    e = [math.log(p[key]) for p in curve]
    t = [math.log(p["render_s"]) for p in curve]
    goal = math.log(error)
    if goal > e[0]:
        return _beyond(n, e, t, goal, 0, 1)
    for i in range(len(curve) - 1):
        if e[i + 1] <= goal <= e[i]:
            f = (e[i] - goal) / max(e[i] - e[i + 1], 1e-12)
            return Crossing(
                math.exp(n[i] + f * (n[i + 1] - n[i])), math.exp(t[i] + f * (t[i + 1] - t[i])), "measured"
            )
    last = len(curve) - 1
    return _beyond(n, e, t, goal, last, last - 1)


def _beyond(n, e, t, goal: float, end: int, inner: int) -> Crossing:
    """Follow the line through two points past the one at `end`."""
    slope = (e[end] - e[inner]) / (n[end] - n[inner])
    if slope > FLATTEST:
        # an error that is above a curve that is flat from its start is met by the first point
        never = end > inner
        return (
            Crossing(math.inf, math.inf, "never")
            if never
            else Crossing(math.exp(n[end]), math.exp(t[end]), "extrapolated")
        )
    d = (goal - e[end]) / max(slope, STEEPEST)
    rate = (t[end] - t[inner]) / (n[end] - n[inner])
    return Crossing(math.exp(n[end] + d), math.exp(t[end] + rate * d), "extrapolated")
