"""Cones behind curved mirrors and clear glass: the footprint itself, as the surface bends it, and not a lobe as wide.

Neighbours' footprints lie side by side behind the surface, too: what is mirrored has no gaps, and no tails.
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.cones.cones import perpendicular, set_axes
from pointmr_engine.multires.cones.footprint import as_cone, mirrored, refracted, roughened, tilt
from pointmr_engine.multires.lobes.lobe_paths import begin_cone
from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf.layout import GLASS, KIND_MASK, REFLECTION, REFRACTION
from pointmr_engine.shading.bsdf.vector import cross, dot

OWN = 0.3  # squared roughness of its own that a lobe may have, against what curvature adds
BEYOND = 8.0  # distance at which a cone is as wide as the footprint, in distances at which that has doubled its width
BEFORE = 2.0  # how far a footprint's rim may lie off the plane of its middle, in slopes times half widths
BENT = 4.0  # times the slope that it came with, from which a mirrored footprint is as if it came from a point
RIM = 0.4  # change of the normal over a footprint's half, against the cosine of incidence, up to which it is one
WIDEST = 0.7  # slope of a footprint's half width, beyond which it is a lobe


@device
def own_variance(kind, rough, curved):
    """Variance of a lobe's own slopes where it is little else than a mirror, or clear glass, that bends; else negative.

    rough: its roughness, widened by `curved`, the variance of the normals in its footprint.
    """
    base = kind & KIND_MASK
    mirror = base == REFLECTION or base == REFRACTION or base == GLASS
    if not (mirror and curved > 0.0 and rough * rough < (1.0 + OWN) * 2.0 * curved):
        return -1.0
    return max(0.5 * rough * rough - curved, 0.0)


@device
def _along(shape, k, a, b):
    """a . S b for the shape operator S of row k."""
    s = shape[k]
    return (
        a[0] * (s[0] * b[0] + s[1] * b[1] + s[2] * b[2])
        + a[1] * (s[1] * b[0] + s[3] * b[1] + s[4] * b[2])
        + a[2] * (s[2] * b[0] + s[4] * b[1] + s[5] * b[2])
    )


@device
def open_curved(cones, m, out, shape, k, own, normal, outward, incoming, d, eta):
    """The cone of path m: its footprint behind the surface; False where that is too wide for one, or at a rim.

    shape (N, 6): curvature.shape_operator, of which row k counts; own: own_variance; outward: the normal of the
    surface itself; incoming: unit vector to where the path came from; d: the direction in which it leaves; eta: 0 of a
    mirror, else the index of refraction before over that after.
    """
    cosine = max(dot(normal, incoming), 1e-3)
    plane = perpendicular(-incoming[0], -incoming[1], -incoming[2], normal[0], normal[1], normal[2])
    across = cross(normal, plane)
    operator = (
        _along(shape, k, plane, plane),
        _along(shape, k, plane, across),
        _along(shape, k, across, across),
    )
    half, slope = 0.5 * np.float64(out.state.width[m]), 0.5 * np.float64(out.state.spread[m])
    place, spread = (half, 0.0, 0.0, half), (slope, 0.0, 0.0, slope)
    tilted = tilt(place, cosine, operator)
    if tilted[0] * tilted[0] + tilted[1] * tilted[1] > RIM * RIM * cosine * cosine:
        return False
    if eta == 0.0:
        spread = mirrored(place, spread, cosine, operator)
        spread = roughened(spread, 4.0 * own, 4.0 * cosine * cosine * own)
    else:
        place, spread = refracted(place, spread, cosine, eta, operator)
        own *= (1.0 - eta) * (1.0 - eta)
        spread = roughened(spread, own, own)
    widest = math.sqrt(
        max(spread[0] * spread[0] + spread[1] * spread[1], spread[2] * spread[2] + spread[3] * spread[3])
    )
    if not (0.0 < widest < WIDEST and half > 0.0):
        return False
    c, s, start_x, start_y, spread_x, spread_y = as_cone(place, spread, BEYOND * half / widest)
    if eta != 0.0:
        s = -s  # behind a refraction the second axis is counted from the other side
    set_axes(cones, m, plane[0], plane[1], plane[2], d[0], d[1], d[2])
    for a in range(3):
        x, y = cones.axes[m, 0, a], cones.axes[m, 1, a]
        cones.axes[m, 0, a], cones.axes[m, 1, a] = c * x + s * y, c * y - s * x
    # sub-rays beside each other on coarse triangles would start below them: mirrors that bend need hardly any place
    if eta == 0.0 and widest > BENT * slope:
        start_x = start_y = 0.0
    begin_cone(cones, m, out, normal, outward, start_x, start_y, spread_x, spread_y, BEFORE * widest)
    return True
