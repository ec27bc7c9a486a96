"""Cones of lobes: what they stand for, how likely a lobe sends light in a direction, and how well cones look there."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.multires.cones.cones import Cones
from pointmr_engine.numerics.jit import device
from pointmr_engine.raytracing.path_arrays import Paths
from pointmr_engine.shading.bsdf.layout import IOR
from pointmr_engine.shading.bsdf.microfacet import distribution
from pointmr_engine.shading.bsdf.vector import combine, dot, normalized

# LobeCones.alpha of rays: passing, or what a cone was
STRAIGHT, THROUGH_MIRROR, WITHIN_LOBE = -1.0, -2.0, -3.0
BY_LOBE = 0.0  # Paths.bsdf_pdf until the direction within the lobe is chosen
# of sub-rays beside a lobe's core, what they are worth there: the lobe differs within their cells
OF_REST = 1.0 / 16.0


class LobeCones(NamedTuple):
    """The cones of N paths, and the lobes that they stand for."""

    cones: Cones
    # (N,) float32 roughness: 0 a mirror, or clear; below 0: a ray instead of a cone, as below
    alpha: np.ndarray
    normal: np.ndarray  # (N, 3) float32 of the lobe where it reflects; 0 where it transmits
    # (N, 3) float32 to where the path came from; of a lobe that transmits: the direction that it favours
    incoming: np.ndarray
    # (N,) int8: 0 the whole lobe; 1 its core, whose next row is 2: what the same lobe sends beside its core
    part: np.ndarray
    # (N, 64) float32 of the sub-rays; they sum to 1, over core and rest together, less what is lost below the surface
    weights: np.ndarray
    ray: np.ndarray  # (N,) bool: a ray will do, however strong the lobe
    rough: np.ndarray  # (N,) float32: of rays within lobes, the lobes' roughness
    blur: np.ndarray  # (N,) float32: of chaotic glass, half the angle over which it blurs lamps; else 0
    behind: np.ndarray  # (N, 3) float32: of rays, factors of what surfaces reflect (lobe_rays.behind_glossy)
    beckmann: np.ndarray  # (N,) bool: whose slopes are as a Gaussian has them, and not as GGX
    # (N,) bool: of curved mirrors and clear glass: the footprint itself, all of which weighs alike
    even: np.ndarray
    # (N, 3) float32: geometric normal where light goes on; lobes that bumps tilt end at its plane
    side: np.ndarray


def allocate_lobe_cones(n: int, cones: Cones) -> LobeCones:
    """Room for n."""
    f = np.float32
    return LobeCones(
        cones,
        np.empty(n, f),
        np.empty((n, 3), f),
        np.empty((n, 3), f),
        np.zeros(n, np.int8),
        np.empty((n, 64), f),
        np.zeros(n, np.bool_),
        np.zeros(n, f),
        np.zeros(n, f),
        np.ones((n, 3), f),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
        np.zeros((n, 3), f),
    )


@device
def lobe_pdf(alpha2, normal, incoming, direction):
    """Density per solid angle of a GGX lobe's reflections, microfacets chosen by their area; 0 below the surface."""
    cosine = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
    x, y, z = direction[0] + incoming[0], direction[1] + incoming[1], direction[2] + incoming[2]
    length = math.sqrt(x * x + y * y + z * z)
    if not (cosine > 0.0 and length > 0.0):
        return 0.0
    h = (normal[0] * x + normal[1] * y + normal[2] * z) / length
    d = h * h * (alpha2 - 1.0) + 1.0
    return max(
        alpha2 * h / (math.pi * d * d * 2.0 * length), 0.0
    )  # |wi + wo| is twice the cosine between wi and h


@device
def inverse_ior(lobes, k, j):
    """Index of refraction before the surface over that behind it, of lobe j of point k."""
    ior = np.float64(lobes.data[k, j, IOR])
    return 1.0 / ior if ior > 0.0 else 1.0


@device
def refraction(normal, incoming, inverse, rough):
    """(direction, roughness of the mirror that spreads as much, whether it refracts) of a lobe that transmits.

    inverse: inverse_ior. Where all is reflected, what its roughness lets through goes along the surface.
    """
    cosine = dot(normal, incoming)
    square = 1.0 - inverse * inverse * (1.0 - cosine * cosine)
    along = inverse * cosine - math.sqrt(max(square, 0.0))
    d = combine(along, normal, -inverse, incoming)
    if not square > 0.0:
        d = normalized(d, normal)
    return d, 0.5 * abs(1.0 - inverse) * rough, square > 0.0


@device
def refracted_pdf(alpha2, axis, direction):
    """Density per solid angle of what a rough surface refracts about `axis`, about as wide as a mirror's lobe.

    alpha: roughness of the mirror that spreads as much. GGX's slopes of half vectors, of a viewer along the normal;
    0 beyond a right angle.
    """
    cosine = dot(axis, direction)
    if not cosine > 0.0:
        return 0.0
    return distribution(
        False, (1.0 - cosine * cosine) / (cosine * cosine) / (4.0 * alpha2), 0.0, 1.0, alpha2
    ) / (4.0 * cosine * cosine * cosine)


@device
def pdf_of(lobes: LobeCones, k, alpha, direction):
    """Density of cone k's lobe, of roughness alpha, in a direction; inf where it is sharp."""
    n, w = lobes.normal, lobes.incoming
    nx, ny, nz = np.float64(n[k, 0]), np.float64(n[k, 1]), np.float64(n[k, 2])
    if not alpha > 0.0:
        return math.inf
    incoming = (np.float64(w[k, 0]), np.float64(w[k, 1]), np.float64(w[k, 2]))
    if nx * nx + ny * ny + nz * nz == 0.0:
        return refracted_pdf(alpha * alpha, incoming, direction)
    return lobe_pdf(alpha * alpha, (nx, ny, nz), incoming, direction)


@device
def slopes_of(cones, k, b):
    """Slopes (u, v) of sub-ray b of cone k."""
    u, v = ((b & 7) + 0.5) * 0.25 - 1.0, ((b >> 3) + 0.5) * 0.25 - 1.0
    return u * np.float64(cones.spread[k, 0]), v * np.float64(cones.spread[k, 1])


@device
def in_square(c, m, x, y, z):
    """Whether a direction lies in the square that cone m covers."""
    t = x * c.axes[m, 2, 0] + y * c.axes[m, 2, 1] + z * c.axes[m, 2, 2]
    u = x * c.axes[m, 0, 0] + y * c.axes[m, 0, 1] + z * c.axes[m, 0, 2]
    v = x * c.axes[m, 1, 0] + y * c.axes[m, 1, 1] + z * c.axes[m, 1, 2]
    return t > 0.0 and abs(u) <= c.spread[m, 0] * t and abs(v) <= c.spread[m, 1] * t


@device
def looks_within(lobes: LobeCones, m, direction):
    """Sub-rays per solid angle that cone m has in a direction, 0 beyond it: how well it finds what shines there.

    inf where it is the footprint, which tells all.
    """
    if lobes.alpha[m] <= 0.0 or lobes.even[m]:
        return math.inf
    x, y, z = direction
    c = lobes.cones
    if not in_square(c, m, x, y, z):
        return 0.0
    t = x * c.axes[m, 2, 0] + y * c.axes[m, 2, 1] + z * c.axes[m, 2, 2]
    worth = OF_REST if lobes.part[m] == 2 else 1.0
    return worth * 16.0 / (np.float64(c.spread[m, 0]) * np.float64(c.spread[m, 1]) * t * t * t)


@device
def looks_of(lobes: LobeCones, m, direction):
    """The same of the lobe whose first cone is m."""
    found = looks_within(lobes, m, direction)
    if found > 0.0 or lobes.part[m] == 0:
        return found
    return looks_within(lobes, m + 1, direction)


@device
def finds_lights(paths: Paths, lobes: LobeCones, m):
    """Whether cone m is one of a reflection that finds what shines (scatter_lobes: cone_of)."""
    n = lobes.normal
    reflects = n[m, 0] != 0 or n[m, 1] != 0 or n[m, 2] != 0
    return lobes.alpha[m] > 0 and reflects and paths.bsdf_pdf[m] == math.inf and lobes.blur[m] == 0
