"""How opaque points of parts are, whoever looks at them and wherever their parts are placed.

Coverage is decided by a part's triangles alone (cut_outs). Where transparency goes by the view, or by the placement, it
has two answers: that of the view along the normal, on the mean of the placements, and the most that is seen from
anywhere, for methods whose rays go on through what passes besides. What is added to what passes (a Transparent BSDF
and an Emission in an Add Shader) is drawn at a small share of the subpixels, and is as much brighter there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.hierarchy.placements import Placements, placements
from pointmr_engine.numerics.run_all import run_all
from pointmr_engine.raytracing.surface import place_points, points_at
from pointmr_engine.shading.points import SurfacePoints
from pointmr_engine.shading.program import Program

# cosines to the normal under which what depends on the view is looked at, the first for its mean
VIEWS = (1.0, -1.0, 0.5, -0.5, 0.1, -0.1)
MOST_PLACEMENTS = 8  # of a part, that are looked at
# of light: from what sends on more, something is added; where it is what passes, what counts as its share, for rays
# tell how much it is
BRIGHTENS, BRIGHTENED = 1.001, 0.01
PIECE = 1 << 16  # points of a thread at once
# shares of subpixels that what is added to what passes covers: where rays go on, as much as it shines between these;
# elsewhere the least, for it hides what it covers
LEAST_ADDED, MOST_ADDED = 1 / 8, 1 / 4


class PartOpacity:
    """Opacity of the parts of a scene under its materials' programs."""

    def __init__(self, geometry: Geometry, programs: list[Program], threads: int = 0) -> None:
        """threads: for many points; 0: one per core."""
        self.geometry, self.programs, self.threads = geometry, programs, threads
        self._placements: dict[int, Placements] = {}
        self._met: set[int] = set()  # materials that points have been looked up of

    def opacity(
        self, material: int, part: int | np.ndarray, triangles: np.ndarray, u: np.ndarray, v: np.ndarray,
        adds: bool = False,
    ) -> np.ndarray:  # fmt: skip
        """(n, 2) opacity, 0..1, of points of parts' triangles (n,) by weights u, v (n,): mean over placements and
        channels, and the most that is seen from anywhere, of the channel that is blocked most.

        part: of all points, or (n,) of each. adds: (n, 5): the same, both with what the program adds, and 1 where
        anybody sees what passes brightened, else 0. Where nothing is ever added, that is blocked but for BRIGHTENED.
        """
        program = self.programs[material]
        result = np.empty((len(triangles), 5 if adds else 2))
        alone = not program.placed or np.ndim(part) == 0

        def fill(own, rows) -> None:
            result[rows] = self._of_part(program, own, triangles[rows], u[rows], v[rows], adds)

        pieces = []
        for p in (part,) if alone else np.unique(part):
            whole = np.arange(len(triangles)) if alone else np.flatnonzero(part == p)
            for at in range(0, len(whole), PIECE):
                rows = whole[at : at + PIECE]
                pieces.append((p if np.ndim(p) == 0 else p[rows], rows))
        if pieces and material not in self._met:  # numba must not meet new types on two threads
            fill(*pieces.pop())
            self._met.add(material)
        run_all(fill, pieces, self.threads)
        return result

    def _of_part(self, program: Program, part, triangles, u, v, adds: bool) -> np.ndarray:
        n = len(triangles)
        needs = program.passed_needs if adds else program.transparency_needs
        mean, least, added, looks = np.zeros(n), np.ones(n), np.zeros(n, np.float32), 0
        brightens = np.zeros((n, 1), np.bool_)
        known = not program.unforeseen and (
            not program.placed or len(self._placed(part).part) <= MOST_PLACEMENTS
        )
        for view, points in self._seen(program, part, triangles, u, v, needs):
            passed, shown = program.passed_and_shown(points) if adds else (program.transparency(points), None)
            clear = np.clip(passed, 0.0, 1.0)
            more = largest(passed) > BRIGHTENS
            brightens[more] = True
            passes = -largest(-clear)
            least = np.minimum(least, passes if program.adds else np.where(more, BRIGHTENED, passes))
            if view == VIEWS[0]:
                mean += (clear[:, 0] + clear[:, 1] + clear[:, 2]) / 3.0
                looks += 1
            if adds:
                added = np.maximum(added, np.where(largest(clear + shown) > BRIGHTENS, largest(shown), 0.0))
        if not known:
            least[:] = 0.0
        found = 1.0 - np.stack((mean / looks, least), 1)
        if not adds:
            return found
        shares = np.stack((np.full(n, LEAST_ADDED), np.clip(added, LEAST_ADDED, MOST_ADDED)), 1)
        return np.concatenate([found, np.maximum(found, shares * (added > 0.0)[:, None]), brightens], 1)

    def looks(self, material: int, part: int) -> int:
        """How often `opacity` looks at each point: from several sides, where the part is placed."""
        program = self.programs[material]
        placed = min(len(self._placed(part).part), MOST_PLACEMENTS) if program.placed else 1
        return len(_views(program)) * max(placed, 1)

    def transparency(
        self, material: int, part: int, triangles: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> np.ndarray:
        """(n, 3) share of light that passes triangles (n,) of a part, seen along their normals, in its own space."""
        program = self.programs[material]
        what = self._samples(part, triangles, u, v, np.eye(4)[:3])
        return program.transparency(points_at(*what, program.transparency_needs))

    def _placed(self, part: int) -> Placements:
        """Of the part's placements the first MOST_PLACEMENTS, and one more."""
        if part not in self._placements:
            wanted = np.zeros(len(self.geometry.parts), np.bool_)
            wanted[part] = True
            self._placements[part] = placements(self.geometry, wanted, MOST_PLACEMENTS + 1)
        return self._placements[part]

    def _seen(self, program, part, triangles, u, v, needs) -> Iterator[tuple[float, SurfacePoints]]:
        """(a view, the points as they look from there) for all views, wherever the part is placed; in its own space
        where that does not matter.
        """
        placed = self._placed(part) if program.placed else None
        there = (
            placed.world_from_part[:MOST_PLACEMENTS] if placed is not None and len(placed.part) else [None]
        )
        for k, world in enumerate(there):
            what = self._samples(part, triangles, u, v, np.eye(4)[:3] if world is None else world)
            for view, viewer in _viewers(what, _views(program)):
                points = points_at(*what, needs, viewer)
                if world is not None:
                    place_points(self.geometry, points, placed, np.full(len(triangles), k), needs)
                yield view, points

    def _samples(self, part, triangles, u, v, world_from_part) -> tuple:
        """What `points_at` takes of points of a part's triangles, besides needs and viewer."""
        geometry, n = self.geometry, len(triangles)
        whole = (geometry.tables.first_triangle[part] + triangles).astype(np.int32)
        part = np.full(n, part, np.int32)
        return geometry, part, whole, u, v, np.broadcast_to(world_from_part, (n, 3, 4))


def largest(rgb: np.ndarray) -> np.ndarray:
    """(n,) of (n, 3): of three, numpy takes ten times as long along an axis."""
    return np.maximum(np.maximum(rgb[:, 0], rgb[:, 1]), rgb[:, 2])


def _views(program: Program) -> tuple[float, ...]:
    """Those of VIEWS that may show different transparency."""
    if not program.faces:
        return VIEWS[:1]
    return VIEWS if program.turns_with_view else VIEWS[:2]


def _viewers(what: tuple, views: tuple[float, ...]) -> Iterator[tuple[float, np.ndarray | None]]:
    """(view, where points are seen from under it (n, 3), None: along their normals)."""
    yield views[0], None
    if len(views) == 1:
        return
    at = points_at(*what, frozenset({"position", "geometric_normal"}))
    normal = at.geometric_normal.astype(np.float64)
    beside = np.cross(normal, np.eye(3)[np.abs(normal).argmin(1)])
    beside /= np.maximum(np.linalg.norm(beside, axis=1, keepdims=True), 1e-30)
    for view in views[1:]:
        yield view, at.position + view * normal + math.sqrt(1.0 - view * view) * beside
