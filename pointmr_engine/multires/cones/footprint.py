"""Footprints of cones on their way: through free flight, at mirrors and refraction, at curved and rough surfaces.

A footprint is two linear maps from (u, v) in [-1, 1]^2, as tuples of four numbers, row by row: `place`, to the lateral
position in metres across the axis, and `slope`, to the change of direction. At surfaces the first lateral axis lies in
the plane of incidence and the second across it; after a mirror or a refraction the axes are those of the new direction,
the first still in the plane of incidence and on the same side of the surface point, the second the same.

Curvatures are a symmetric operator (k_pp, k_ps, k_ss) along the surface, positive where the side that the ray comes
from is convex. Kernel functions; all in float64.
"""

from __future__ import annotations

import math

from pointmr_engine.numerics.jit import uncounted

_TINY = 1e-30


@uncounted
def travel(place, slope, distance):
    """`place` after a distance; the slope stays."""
    return (
        place[0] + distance * slope[0],
        place[1] + distance * slope[1],
        place[2] + distance * slope[2],
        place[3] + distance * slope[3],
    )


@uncounted
def turned(m, c, s):
    """The same map with its lateral axes turned by an angle of cosine c and sine s."""
    return c * m[0] + s * m[2], c * m[1] + s * m[3], c * m[2] - s * m[0], c * m[3] - s * m[1]


@uncounted
def tilt(place, cos_i, k):
    """How the normal changes over a footprint that falls on a surface at an angle of cosine cos_i: a map of (u, v)."""
    a, b = place[0] / cos_i, place[1] / cos_i
    return (
        k[0] * a + k[1] * place[2],
        k[0] * b + k[1] * place[3],
        k[1] * a + k[2] * place[2],
        k[1] * b + k[2] * place[3],
    )


@uncounted
def mirrored(place, slope, cos_i, k):
    """Slope after a mirror; the place stays (its axes are mirrored, too)."""
    n = tilt(place, cos_i, k)
    return (
        slope[0] + 2.0 * n[0],
        slope[1] + 2.0 * n[1],
        slope[2] + 2.0 * cos_i * n[2],
        slope[3] + 2.0 * cos_i * n[3],
    )


@uncounted
def refracted_cosine(cos_i, eta):
    """Cosine of the angle after a refraction, eta the index before over that after; negative: reflected totally."""
    squared = 1.0 - eta * eta * (1.0 - cos_i * cos_i)
    return math.sqrt(squared) if squared >= 0.0 else -1.0


@uncounted
def refracted(place, slope, cos_i, eta, k):
    """(place, slope) after a refraction that is not total; eta: the index before over that after."""
    cos_t = refracted_cosine(cos_i, eta)
    n = tilt(place, cos_i, k)
    wider, along, bend = cos_t / cos_i, eta * cos_i / cos_t, eta * cos_i - cos_t
    return (
        (wider * place[0], wider * place[1], place[2], place[3]),
        (
            along * slope[0] + bend / cos_t * n[0],
            along * slope[1] + bend / cos_t * n[1],
            eta * slope[2] + bend * n[2],
            eta * slope[3] + bend * n[3],
        ),
    )


@uncounted
def _root(xx, xy, yy):
    """The symmetric square root of a positive symmetric matrix."""
    d = math.sqrt(max(xx * yy - xy * xy, 0.0))
    t = math.sqrt(max(xx + yy + 2.0 * d, _TINY))
    return (xx + d) / t, xy / t, (yy + d) / t


@uncounted
def roughened(slope, variance_p, variance_s):
    """Slope with variances of direction added, in the plane of incidence and across it.

    Of a rough mirror: 4 sigma^2 and 4 cos^2(i) sigma^2 for slopes of the surface of variance sigma^2 (alpha^2 / 2 of
    Beckmann's); normals of what was merged add theirs in the same way.
    """
    xx = slope[0] * slope[0] + slope[1] * slope[1]
    xy = slope[0] * slope[2] + slope[1] * slope[3]
    yy = slope[2] * slope[2] + slope[3] * slope[3]
    a, b, c = _root(xx, xy, yy)
    det = a * c - b * b
    # slope = root * turn: the turn is kept, so that places and slopes stay correlated as they were
    turn = (1.0, 0.0, 0.0, 1.0)
    if det > 1e-12 * (a * a + c * c):
        turn = (
            (c * slope[0] - b * slope[2]) / det,
            (c * slope[1] - b * slope[3]) / det,
            (a * slope[2] - b * slope[0]) / det,
            (a * slope[3] - b * slope[1]) / det,
        )
    a, b, c = _root(xx + 3.0 * variance_p, xy, yy + 3.0 * variance_s)
    return (
        a * turn[0] + b * turn[2],
        a * turn[1] + b * turn[3],
        b * turn[0] + c * turn[2],
        b * turn[1] + c * turn[3],
    )


@uncounted
def as_cone(place, slope, distance):
    """(c, s, start x, start y, spread x, spread y): the cone of multires.cones.cones that has the footprint's size.

    c, s: cosine and sine of the angle by which its axes are turned from the footprint's, those of the ellipse at
    `distance`. Its variances there, and at its start along the same axes, are the footprint's.
    """
    w = travel(place, slope, distance)
    xx, xy, yy = w[0] * w[0] + w[1] * w[1], w[0] * w[2] + w[1] * w[3], w[2] * w[2] + w[3] * w[3]
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    c, s = math.cos(angle), math.sin(angle)
    a, w = turned(place, c, s), turned(w, c, s)
    start_x, start_y = math.sqrt(a[0] * a[0] + a[1] * a[1]), math.sqrt(a[2] * a[2] + a[3] * a[3])
    end_x, end_y = math.sqrt(w[0] * w[0] + w[1] * w[1]), math.sqrt(w[2] * w[2] + w[3] * w[3])
    # a footprint that has gone through a focus comes out with its sides exchanged
    if a[0] * w[0] + a[1] * w[1] < 0.0:
        end_x = -end_x
    if a[2] * w[2] + a[3] * w[3] < 0.0:
        end_y = -end_y
    return c, s, start_x, start_y, (end_x - start_x) / distance, (end_y - start_y) / distance
