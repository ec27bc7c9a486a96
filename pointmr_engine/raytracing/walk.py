"""Rays through nested instances: the closest hit, and shadow rays."""

from __future__ import annotations

from pointmr_engine.hierarchy.acceleration import Acceleration
from pointmr_engine.raytracing.rays import Hits, Rays

BLOCKED = -2  # Hits.triangle of a shadow ray that an opaque triangle stops


def intersect(acceleration: Acceleration, rays: Rays, hits: Hits, start: int = 0, stop: int | None = None) -> None:
    """Closest hits of rays[start:stop] with t_min < t < t_max, written to hits[start:stop].

    Releases the GIL; may run in several threads at once on disjoint ranges. A ray with a direction that is zero or not
    finite hits nothing.
    """
    raise NotImplementedError


def shadow(acceleration: Acceleration, rays: Rays, hits: Hits, start: int = 0, stop: int | None = None) -> None:
    """Shadow rays: hits.triangle is BLOCKED (-2) where any opaque triangle lies in between (other fields undefined).

    Otherwise the closest hit on a triangle whose material may be transparent (see acceleration.set_opaque), or -1.
    """
    raise NotImplementedError
