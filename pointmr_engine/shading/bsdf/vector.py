"""Vectors as tuples of three float64: the arithmetic that scattering needs."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.jit import device


@device
def row3(array, i):
    """Row i of an (n, 3) array as float64."""
    return np.float64(array[i, 0]), np.float64(array[i, 1]), np.float64(array[i, 2])


@device
def load3(data, i, j, column):
    """Three columns of lobe j of point i as float64."""
    return (
        np.float64(data[i, j, column]),
        np.float64(data[i, j, column + 1]),
        np.float64(data[i, j, column + 2]),
    )


@device
def store3(data, i, j, column, v):
    """Write three columns of lobe j of point i."""
    data[i, j, column] = v[0]
    data[i, j, column + 1] = v[1]
    data[i, j, column + 2] = v[2]


@device
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@device
def cross(a, b):
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@device
def scale(s, a):
    """s * a."""
    return s * a[0], s * a[1], s * a[2]


@device
def combine(s, a, t, b):
    """s * a + t * b."""
    return s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2]


@device
def multiply(a, b):
    """Componentwise product."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@device
def mean(a):
    """Mean of the components."""
    return (a[0] + a[1] + a[2]) / 3.0


@device
def normalized(a, fallback):
    """a to unit length; fallback where a has none or is not finite."""
    length = math.sqrt(dot(a, a))
    if length > 0.0 and length < math.inf:
        return scale(1.0 / length, a)
    return fallback


@device
def to_world(x, y, z, tangent, bitangent, normal):
    """Local coordinates to world."""
    return (
        x * tangent[0] + y * bitangent[0] + z * normal[0],
        x * tangent[1] + y * bitangent[1] + z * normal[1],
        x * tangent[2] + y * bitangent[2] + z * normal[2],
    )


@device
def basis(normal):
    """Two tangents to a unit normal, without branches on the direction (Duff et al. 2017)."""
    sign = math.copysign(1.0, normal[2])
    a = -1.0 / (sign + normal[2])
    b = normal[0] * normal[1] * a
    return (
        (1.0 + sign * normal[0] * normal[0] * a, sign * b, -sign * normal[0]),
        (b, sign + normal[1] * normal[1] * a, -normal[1]),
    )


@device
def tangent_towards(normal, direction):
    """Unit tangent to `normal` in the plane of `direction`; any tangent where they are parallel."""
    side = cross(normal, direction)
    length = math.sqrt(dot(side, side))
    if not length > 1e-7:
        return basis(normal)[0]
    side = scale(1.0 / length, side)
    return cross(side, normal)


@device
def rotate_about(v, axis, angle):
    """v turned about a unit axis (Rodrigues)."""
    c = math.cos(angle)
    s = math.sin(angle)
    k = cross(axis, v)
    d = dot(axis, v) * (1.0 - c)
    return (
        c * v[0] + s * k[0] + d * axis[0],
        c * v[1] + s * k[1] + d * axis[1],
        c * v[2] + s * k[2] + d * axis[2],
    )


@device
def cosine_hemisphere(normal, u1, u2):
    """A direction about `normal` with density cos / pi."""
    radius = math.sqrt(u1)
    phi = 2.0 * math.pi * u2
    tangent, bitangent = basis(normal)
    return to_world(
        radius * math.cos(phi),
        radius * math.sin(phi),
        math.sqrt(max(1.0 - u1, 0.0)),
        tangent,
        bitangent,
        normal,
    )


@device
def unit_interval(x):
    """x as float64, clamped to 0..1."""
    return min(max(np.float64(x), 0.0), 1.0)


@device
def positive3(block, r, column):
    """Three columns of row r of a leaf's block as float64, none below 0."""
    return (
        max(np.float64(block[r, column]), 0.0),
        max(np.float64(block[r, column + 1]), 0.0),
        max(np.float64(block[r, column + 2]), 0.0),
    )
