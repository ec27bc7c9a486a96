"""Surfaces that shine, as lamps: the strongest placements of emissive parts become area and point lamps of equal power.

Forward mapping follows no rays that could find them. A part that is nearly flat becomes a rectangle with the same
area, centre and axes; any other a ball with the same area.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.raytracing.emitter_search import find_emitters
from pointmr_engine.raytracing.emitters import BACK, FRONT
from pointmr_engine.scene.light import Light

MOST = 16  # lamps
FLAT = 0.95  # length of the mean normal from which a part counts as flat
SHARE = 1e-3  # of the strongest lamp's power: weaker ones are left out


def emissive_lamps(geometry: Geometry, programs: list) -> list[Light]:
    """Lamps that stand for the emissive surfaces of a scene, strongest first."""
    if not any(p.emissive for p in programs):
        return []
    emitters, _, _, _ = find_emitters(geometry, programs, every=True)
    lamps: list[Light] = []
    if not len(emitters.path):
        return lamps
    corners = emitters.vertices
    normal = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    for place in np.unique(emitters.placement):
        rows = np.flatnonzero((emitters.placement == place) & (area > 0.0))
        if not len(rows):
            continue
        total = area[rows].sum()
        power = math.pi * (emitters.radiance[rows] * area[rows, None]).sum(0)
        if not (power.max() > 0.0 and np.isfinite(power).all()):
            continue
        lamps += _lamps(corners[rows], normal[rows], area[rows], total, power, int(emitters.sides[rows[0]]))
    lamps.sort(key=lambda lamp: -lamp.power)
    return [lamp for lamp in lamps[:MOST] if lamp.power > SHARE * lamps[0].power]


def _lamps(corners, normal, area, total: float, power, sides: int) -> list[Light]:
    """The lamps of one placement: triangles (n, 3, 3), their area vectors and areas; power (3,) of one side."""
    middle = corners.mean(1)
    center = (middle * area[:, None]).sum(0) / total
    peak = float(power.max())
    values = {"color": tuple((power / peak).tolist()), "power": peak, "name": "emissive surface"}
    facing = normal.sum(0)
    m = np.eye(4)
    m[:3, 3] = center
    if np.linalg.norm(facing) < FLAT * total:
        return [Light("POINT", m, radius=math.sqrt(total / (4.0 * math.pi)), soft_falloff=False, **values)]
    z = facing / np.linalg.norm(facing)
    offset = corners - center
    mean = middle - center
    spread = (
        np.einsum("n,nki,nkj->ij", area, offset, offset) + 9.0 * np.einsum("n,ni,nj->ij", area, mean, mean)
    ) / (12.0 * total)
    spread -= np.outer(spread @ z, z)
    spread = 0.5 * (spread + spread.T)
    sizes, axes = np.linalg.eigh(spread)
    x = axes[:, 2] - (axes[:, 2] @ z) * z
    x /= np.linalg.norm(x)
    ratio = math.sqrt(max(sizes[2], 1e-30) / max(sizes[1], 1e-6 * max(sizes[2], 1e-30)))
    size_x, size_y = math.sqrt(total * ratio), math.sqrt(total / ratio)
    found = []
    for side, bit in ((1.0, FRONT), (-1.0, BACK)):
        if sides & bit:
            m = np.eye(4)
            m[:3, 3] = center
            m[:3, 2] = -side * z  # it shines along -z
            m[:3, 0] = x
            m[:3, 1] = np.cross(m[:3, 2], x)
            found.append(Light("AREA", m, shape="RECTANGLE", size_x=size_x, size_y=size_y, **values))
    return found
