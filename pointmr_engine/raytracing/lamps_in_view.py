"""Lamps that a camera looks at: they add their light to what lies behind them, as in Cycles, and hide nothing."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.raytracing.compile_lamps import compile_lamps
from pointmr_engine.raytracing.lamp_nodes import lamp_nodes
from pointmr_engine.raytracing.lamps import (
    AX,
    AZ,
    CONE,
    DISTANT,
    ELLIPSE,
    HALF_U,
    HALF_V,
    POINT,
    PX,
    PZ,
    RADIUS,
    RECTANGLE,
    SUN,
    intersect_lamp,
    lamp_pdf_scale,
)
from pointmr_engine.scene.group import CAMERA
from pointmr_engine.scene.light import Light


class LampsInView:
    """Those of a scene's lamps that cameras see. Threads may share it. empty: there are none."""

    def __init__(self, lights: list[Light]) -> None:
        seen = [light for light in lights if light.visibility & CAMERA]
        self._lamps = lamps = compile_lamps(seen)[0]
        shown = (lamps.shape != POINT) & (lamps.shape != DISTANT) & (lamps.mis | (lamps.shape < DISTANT))
        self._shown = np.flatnonzero(shown)
        self._nodes = lamp_nodes(seen, lamps)
        self.empty = not len(self._shown)

    def near(self, position: np.ndarray, direction: np.ndarray, spread: float) -> np.ndarray:
        """(N,) bool: rays that may meet a lamp if they are turned, or moved over their distance to it, by `spread`.

        position (N, 3) float64 world, direction (N, 3) float64 unit; spread in radians.
        """
        found = np.zeros(len(position), np.bool_)
        for k in self._shown:
            row, shape = self._lamps.values[k], self._lamps.shape[k]
            if shape == SUN:
                cosine = math.cos(min(math.acos(max(1.0 - row[CONE], -1.0)) + spread, math.pi))
                found |= -direction @ row[AX : AZ + 1] >= cosine
                continue
            radius = row[RADIUS]
            if shape in (RECTANGLE, ELLIPSE):
                radius = math.hypot(row[HALF_U], row[HALF_V])
            to = row[PX : PZ + 1] - position
            along = np.einsum("ij,ij->i", to, direction)
            beside = np.linalg.norm(to - along[:, None] * direction, axis=1)
            found |= (along > -radius) & (beside <= radius + spread * np.maximum(along, 0.0))
        return found

    def add(self, position: np.ndarray, direction: np.ndarray, reach: np.ndarray, out: np.ndarray) -> None:
        """Add the radiance of lamps nearer than `reach` (N,) float64 along rays to out (N, 3) float32.

        position (N, 3) float64 world, direction (N, 3) float64 unit; reach inf: of suns as well.
        """
        for k in self._shown:
            seen = np.zeros((len(position), 3), np.float32)
            see_lamp(self._lamps, np.int64(k), position, direction, reach, seen)
            rows = np.flatnonzero(seen.any(1))
            if len(rows) and k in self._nodes:
                seen[rows] *= self._nodes[k].met(position[rows], direction[rows])
            out[rows] += seen[rows]


@uncounted
def see_lamp(lamps, k, position, direction, reach, out):
    """out (N, 3) float32: radiance of lamp k where rays meet it within reach (N,) float64."""
    for i in range(len(position)):
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        t = intersect_lamp(lamps, k, px, py, pz, dx, dy, dz)
        if not t > 0.0 or (t >= reach[i] and reach[i] < math.inf):
            continue
        _, scale = lamp_pdf_scale(lamps, k, px, py, pz, -dx, -dy, -dz, False, dx, dy, dz, t)
        if scale > 0.0:
            for c in range(3):
                out[i, c] = lamps.radiance[k, c] * scale
