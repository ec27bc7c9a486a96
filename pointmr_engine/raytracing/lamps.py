"""Lamps: point, spot, area and sun lights, sampled by the solid angle that they fill, and met by rays.

A lamp's radiance is `radiance[i] * scale`, where `scale` depends on direction and distance only. Delta lamps (those
without extent) have a density of 1 and a scale that stands for radiance times solid angle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.warps import (
    concentric_disk,
    cosine_hemisphere,
    one_minus_cos_of_sine,
    rectangle_solid_angle,
    spherical_rectangle,
    uniform_cone,
)

POINT, SPHERE, DISC, RECTANGLE, ELLIPSE, DISTANT, SUN = range(7)

# columns of Lamps.values
PX, PY, PZ = 0, 1, 2  # centre
# unit sides of area lights; the direction in which the lamp shines
UX, UY, UZ, VX, VY, VZ, AX, AY, AZ = range(3, 12)
LOCAL = 12  # nine columns: local_from_world, row by row, of spots
(RADIUS, HALF_U, HALF_V, SPOT, COS_HALF, SMOOTH, SPOT_CONE, TAN_SPREAD, SPREAD_SCALE, CONE) = range(21, 31)
COLUMNS = 31

_TINY_SOLID_ANGLE = 1e-7  # below it a rectangle is sampled by area: as good, and exact
_INF = math.inf


class Lamps(NamedTuple):
    """L lamps, one row each."""

    shape: np.ndarray  # (L,) uint8: the kinds above. POINT and DISTANT are delta lamps
    values: np.ndarray  # (L, COLUMNS) float64
    # (L, 3) float64: radiance; POINT: intensity; DISTANT, areas without spread: irradiance
    radiance: np.ndarray
    mis: np.ndarray  # (L,) bool: rays chosen by a BSDF can meet it
    cast_shadow: np.ndarray  # (L,) bool
    visibility: np.ndarray  # (L,) uint8, bits of scene.group
    source: np.ndarray  # (L,) int32: index into scene.lights
    varying: np.ndarray  # (L,) bool: nodes decide about a factor of the radiance (lamp_nodes)
    factor: np.ndarray  # (L,) float64: of the radiance, roughly what nodes make of it


def is_beam(lamps: Lamps, k: int) -> bool:
    """Whether lamp k shines into a part of its half space alone: a spot, or an area light with a spread."""
    return lamps.values[k, SPOT] != 0.0 or math.isfinite(lamps.values[k, TAN_SPREAD])


@uncounted
def spot_attenuation(row, dx, dy, dz):
    """Share of a spot's intensity that leaves against the unit direction d (from the lit point to the lamp)."""
    x = -(row[LOCAL] * dx + row[LOCAL + 1] * dy + row[LOCAL + 2] * dz)
    y = -(row[LOCAL + 3] * dx + row[LOCAL + 4] * dy + row[LOCAL + 5] * dz)
    z = row[LOCAL + 6] * dx + row[LOCAL + 7] * dy + row[LOCAL + 8] * dz
    length = math.sqrt(x * x + y * y + z * z)
    return spot_at(row, z / length) if length > 0.0 else 0.0


@uncounted
def spot_at(row, cosine):
    """Share of a spot's intensity at an angle to its axis, by the cosine, where it is not scaled."""
    t = min(1.0, max(0.0, (cosine - row[COS_HALF]) * row[SMOOTH]))
    return t * t * (3.0 - 2.0 * t)


@uncounted
def _round_cone(row, shape, d2):
    """1 - cos of the half angle that a sphere or a disc facing the point fills, at squared distance d2 (> r^2)."""
    r2 = row[RADIUS] * row[RADIUS]
    if shape == SPHERE:
        return one_minus_cos_of_sine(r2 / d2)
    h2 = r2 + d2
    return r2 / (h2 + math.sqrt(h2 * d2))


@uncounted
def _sphere_distance(px, py, pz, row, dx, dy, dz):
    """Distance along the unit direction to a sphere: its front from outside, its back from inside; -1: missed."""
    cx, cy, cz = row[PX] - px, row[PY] - py, row[PZ] - pz
    along = cx * dx + cy * dy + cz * dz
    sx, sy, sz = cx - along * dx, cy - along * dy, cz - along * dz
    r2 = row[RADIUS] * row[RADIUS]
    s2 = sx * sx + sy * sy + sz * sz
    if s2 > r2:
        return -1.0
    half = math.sqrt(r2 - s2)
    if cx * cx + cy * cy + cz * cz > r2:
        return along - half
    return along + half


@uncounted
def _sample_round(row, shape, px, py, pz, nx, ny, nz, transmissive, u1, u2):
    """sample_lamp for points, spheres and discs that face the point."""
    cx, cy, cz = row[PX] - px, row[PY] - py, row[PZ] - pz
    d2 = cx * cx + cy * cy + cz * cz
    r2 = row[RADIUS] * row[RADIUS]
    d = math.sqrt(d2)
    spot = row[SPOT] != 0.0
    if shape == SPHERE and d2 <= r2:
        if transmissive:
            dx, dy, dz, _ = uniform_cone(0.0, 0.0, 1.0, 2.0, u1, u2)
            pdf = 1.0 / (4.0 * math.pi)
        else:
            dx, dy, dz, c = cosine_hemisphere(nx, ny, nz, u1, u2)
            pdf = c / math.pi
        return dx, dy, dz, max(0.0, _sphere_distance(px, py, pz, row, dx, dy, dz)), pdf, 1.0
    if d == 0.0:
        return 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    ax, ay, az = cx / d, cy / d, cz / d
    if shape == POINT:
        scale = 1.0 / d2
        if spot:
            scale *= spot_attenuation(row, ax, ay, az)
        return ax, ay, az, d, 1.0, scale
    cone = _round_cone(row, shape, d2)
    if cone == 0.0:
        return ax, ay, az, d, 0.0, 0.0
    if spot and shape == SPHERE and row[SPOT_CONE] < cone:
        # near a wide sphere only part of it shines this way: sample the beam instead
        cone = row[SPOT_CONE]
        dx, dy, dz, h = uniform_cone(-row[AX], -row[AY], -row[AZ], cone, u1, u2)
        t = _sphere_distance(px, py, pz, row, dx, dy, dz)
        if t <= 0.0:
            return dx, dy, dz, 0.0, 0.0, 0.0
    else:
        dx, dy, dz, h = uniform_cone(ax, ay, az, cone, u1, u2)
        if shape == SPHERE:
            t = d * (1.0 - h) - math.sqrt(max(0.0, r2 - d2 * h * (2.0 - h)))
        else:
            t = d / (1.0 - h)
    scale = 1.0
    if spot:
        scale = spot_attenuation(row, dx, dy, dz)
    return dx, dy, dz, t, 1.0 / (2.0 * math.pi * cone), scale


@uncounted
def _area_region(row, shape, x, y, h):
    """Part of an area light that can light a point: (shape, centre u, v, half sides), half side 0 if none.

    x, y, h: the point in the light's frame, h > 0 in front. With a spread only a circle around the foot point shines
    here; the smallest of that circle, the light's ellipse and the box around both is taken.
    """
    a, b = row[HALF_U], row[HALF_V]
    tangent = row[TAN_SPREAD]
    if tangent == _INF:
        return shape, 0.0, 0.0, a, b
    r = h * tangent
    u0, u1 = max(x - r, -a), min(x + r, a)
    v0, v1 = max(y - r, -b), min(y + r, b)
    if u0 >= u1 or v0 >= v1:
        return shape, 0.0, 0.0, 0.0, 0.0
    box = (u1 - u0) * (v1 - v0)
    if shape == ELLIPSE:
        if math.pi * r * r <= min(box, math.pi * a * b):
            return ELLIPSE, x, y, r, r
        if math.pi * a * b <= box:
            return ELLIPSE, 0.0, 0.0, a, b
    return RECTANGLE, 0.5 * (u0 + u1), 0.5 * (v0 + v1), 0.5 * (u1 - u0), 0.5 * (v1 - v0)


@uncounted
def spread_at(row, cosine):
    """Share of the radiance that an area light sends at an angle to its axis, by the cosine."""
    tangent = row[TAN_SPREAD]
    if tangent == _INF:
        return 1.0
    if cosine <= 0.0:
        return 0.0
    return max(0.0, (tangent - math.sqrt(max(0.0, 1.0 - cosine * cosine)) / cosine) * row[SPREAD_SCALE])


@uncounted
def _inside_area(row, shape, x, y):
    if shape == ELLIPSE:
        x /= row[HALF_U]
        y /= row[HALF_V]
        return x * x + y * y <= 1.0
    return abs(x) <= row[HALF_U] and abs(y) <= row[HALF_V]


@uncounted
def area_point(row, px, py, pz):
    """The point in an area light's frame: along its sides and in front of it."""
    cx, cy, cz = px - row[PX], py - row[PY], pz - row[PZ]
    x = cx * row[UX] + cy * row[UY] + cz * row[UZ]
    y = cx * row[VX] + cy * row[VY] + cz * row[VZ]
    return x, y, cx * row[AX] + cy * row[AY] + cz * row[AZ]


@uncounted
def _sample_area(row, shape, px, py, pz, u1, u2):
    """sample_lamp for area lights."""
    x, y, h = area_point(row, px, py, pz)
    if h <= 0.0:
        return 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    if row[TAN_SPREAD] == 0.0:
        lit = 1.0 if _inside_area(row, shape, x, y) else 0.0
        return -row[AX], -row[AY], -row[AZ], h, lit, 1.0
    region, cu, cv, a, b = _area_region(row, shape, x, y, h)
    if a == 0.0:
        return 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    solid_angle = 0.0
    if region == RECTANGLE:
        solid_angle = rectangle_solid_angle(cu - a - x, cu + a - x, cv - b - y, cv + b - y, h)
        if solid_angle > _TINY_SOLID_ANGLE:
            du, dv = spherical_rectangle(
                cu - a - x, cu + a - x, cv - b - y, cv + b - y, h, solid_angle, u1, u2
            )
        else:
            du, dv = cu - x + a * (2.0 * u1 - 1.0), cv - y + b * (2.0 * u2 - 1.0)
    else:
        du, dv = concentric_disk(u1, u2)
        du, dv = cu - x + a * du, cv - y + b * dv
    t = math.sqrt(du * du + dv * dv + h * h)
    scale = spread_at(row, h / t)
    if region != shape or row[TAN_SPREAD] != _INF:
        # a hair's breadth outside is still the light: rounding at its very edge
        if not _inside_area(row, shape, (x + du) * (1.0 - 1e-9), (y + dv) * (1.0 - 1e-9)):
            scale = 0.0
    pdf = _area_density(region, solid_angle, a, b, h, t)
    dx = (du * row[UX] + dv * row[VX] - h * row[AX]) / t
    dy = (du * row[UY] + dv * row[VY] - h * row[AY]) / t
    dz = (du * row[UZ] + dv * row[VZ] - h * row[AZ]) / t
    return dx, dy, dz, t, pdf, scale


@uncounted
def _area_density(region, solid_angle, a, b, h, t):
    """Density per solid angle of a point at distance t on a region; solid_angle 0 if the region is an ellipse."""
    if region == RECTANGLE:
        if solid_angle > _TINY_SOLID_ANGLE:
            return 1.0 / solid_angle
        return t * t * t / (h * 4.0 * a * b)
    return t * t * t / (h * math.pi * a * b)


@uncounted
def sample_lamp(lamps, i, px, py, pz, nx, ny, nz, transmissive, u1, u2):
    """Choose a direction from p to lamp i: (dx, dy, dz, distance, pdf, scale). pdf 0: nothing can be sampled.

    n: the surface's unit normal, used inside spheres only.
    """
    row = lamps.values[i]
    shape = lamps.shape[i]
    if shape <= DISC:
        return _sample_round(row, shape, px, py, pz, nx, ny, nz, transmissive, u1, u2)
    if shape <= ELLIPSE:
        return _sample_area(row, shape, px, py, pz, u1, u2)
    if shape == SUN:
        dx, dy, dz, _ = uniform_cone(-row[AX], -row[AY], -row[AZ], row[CONE], u1, u2)
        return dx, dy, dz, _INF, 1.0 / (2.0 * math.pi * row[CONE]), 1.0
    return -row[AX], -row[AY], -row[AZ], _INF, 1.0, 1.0


@uncounted
def intersect_lamp(lamps, i, px, py, pz, dx, dy, dz):
    """Distance at which the ray from p meets lamp i (inf for suns), or -1. Delta lamps are never met."""
    row = lamps.values[i]
    shape = lamps.shape[i]
    if shape == SPHERE:
        return _sphere_distance(px, py, pz, row, dx, dy, dz)
    if shape == DISC:
        cx, cy, cz = row[PX] - px, row[PY] - py, row[PZ] - pz
        d2 = cx * cx + cy * cy + cz * cz
        along = cx * dx + cy * dy + cz * dz
        if along <= 0.0:
            return -1.0
        t = d2 / along
        if t * t - d2 > row[RADIUS] * row[RADIUS]:
            return -1.0
        return t
    if shape == RECTANGLE or shape == ELLIPSE:
        x, y, h = area_point(row, px, py, pz)
        approach = -(dx * row[AX] + dy * row[AY] + dz * row[AZ])
        if approach <= 0.0 or h <= 0.0 or row[TAN_SPREAD] == 0.0:
            return -1.0
        t = h / approach
        x += t * (dx * row[UX] + dy * row[UY] + dz * row[UZ])
        y += t * (dx * row[VX] + dy * row[VY] + dz * row[VZ])
        return t if _inside_area(row, shape, x, y) else -1.0
    if shape == SUN:
        ex, ey, ez = dx + row[AX], dy + row[AY], dz + row[AZ]
        return _INF if 0.5 * (ex * ex + ey * ey + ez * ez) <= row[CONE] else -1.0
    return -1.0


@uncounted
def lamp_pdf_scale(lamps, i, px, py, pz, nx, ny, nz, transmissive, dx, dy, dz, t):
    """(pdf, scale) of the point of lamp i that the ray from p meets at distance t: what `sample_lamp` would say."""
    row = lamps.values[i]
    shape = lamps.shape[i]
    if shape == SPHERE or shape == DISC:
        cx, cy, cz = row[PX] - px, row[PY] - py, row[PZ] - pz
        d2 = cx * cx + cy * cy + cz * cz
        if shape == SPHERE and d2 <= row[RADIUS] * row[RADIUS]:
            if transmissive:
                return 1.0 / (4.0 * math.pi), 1.0
            return max(0.0, dx * nx + dy * ny + dz * nz) / math.pi, 1.0
        cone = _round_cone(row, shape, d2)
        scale = 1.0
        if row[SPOT] != 0.0:
            scale = spot_attenuation(row, dx, dy, dz)
            if shape == SPHERE:
                cone = min(cone, row[SPOT_CONE])
        return 1.0 / (2.0 * math.pi * cone), scale
    if shape == RECTANGLE or shape == ELLIPSE:
        x, y, h = area_point(row, px, py, pz)
        scale = spread_at(row, h / t)
        region, cu, cv, a, b = _area_region(row, shape, x, y, h)
        if a == 0.0 or scale == 0.0:
            return 0.0, scale
        solid_angle = 0.0
        if region == RECTANGLE:
            solid_angle = rectangle_solid_angle(cu - a - x, cu + a - x, cv - b - y, cv + b - y, h)
        return _area_density(region, solid_angle, a, b, h, t), scale
    if shape == SUN:
        return 1.0 / (2.0 * math.pi * row[CONE]), 1.0
    return 0.0, 0.0
