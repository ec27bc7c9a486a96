"""Affine transforms as 12 float64, row by row (3, 4): composition and rays, for kernels that read them by pointer."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import uncounted

SINGULAR = 1e-12  # volume of a matrix's columns, relative to a box of their lengths, below which it is not invertible


@uncounted
def determinant(m, at):
    """Determinant of the linear part of the transform at m[at : at + 12]."""
    return (
        m[at] * (m[at + 5] * m[at + 10] - m[at + 6] * m[at + 9])
        - m[at + 1] * (m[at + 4] * m[at + 10] - m[at + 6] * m[at + 8])
        + m[at + 2] * (m[at + 4] * m[at + 9] - m[at + 5] * m[at + 8])
    )


@uncounted
def is_singular(m, at):
    """True for a transform that cannot be inverted or has a value that is not finite."""
    box = 1.0
    for column in range(3):
        x, y, z = m[at + column], m[at + 4 + column], m[at + 8 + column]
        box *= np.sqrt(x * x + y * y + z * z)
    moved = m[at + 3] + m[at + 7] + m[at + 11]
    d = abs(determinant(m, at))
    return not (np.isfinite(box) and np.isfinite(moved) and box > 0.0 and d > SINGULAR * box)


@uncounted
def ray_into(m, at, ox, oy, oz, dx, dy, dz):
    """A ray of the parent's space in the child's, for the transform parent_from_child at m[at : at + 12]."""
    a, b, c = m[at], m[at + 1], m[at + 2]
    d, e, f = m[at + 4], m[at + 5], m[at + 6]
    g, h, i = m[at + 8], m[at + 9], m[at + 10]
    c00, c01, c02 = e * i - f * h, c * h - b * i, b * f - c * e
    c10, c11, c12 = f * g - d * i, a * i - c * g, c * d - a * f
    c20, c21, c22 = d * h - e * g, b * g - a * h, a * e - b * d
    s = 1.0 / (a * c00 + b * c10 + c * c20)
    x, y, z = (ox - m[at + 3]) * s, (oy - m[at + 7]) * s, (oz - m[at + 11]) * s
    dx *= s
    dy *= s
    dz *= s
    return (
        c00 * x + c01 * y + c02 * z,
        c10 * x + c11 * y + c12 * z,
        c20 * x + c21 * y + c22 * z,
        c00 * dx + c01 * dy + c02 * dz,
        c10 * dx + c11 * dy + c12 * dz,
        c20 * dx + c21 * dy + c22 * dz,
    )


@uncounted
def append_transform(out, m, at):
    """out (3, 4) = out * (the transform at m[at : at + 12]), in place."""
    for r in range(3):
        x, y, z = out[r, 0], out[r, 1], out[r, 2]
        for c in range(3):
            out[r, c] = x * m[at + c] + y * m[at + 4 + c] + z * m[at + 8 + c]
        out[r, 3] += x * m[at + 3] + y * m[at + 7] + z * m[at + 11]


@uncounted
def cofactors(m, out):
    """Cofactor matrix of m's linear part, signed so that it carries outside normals to outside normals.

    m (3, 4) float64, out (3, 3) float64: out @ normal is the transformed normal, not of unit length.
    """
    for r in range(3):
        r1, r2 = (r + 1) % 3, (r + 2) % 3
        for c in range(3):
            c1, c2 = (c + 1) % 3, (c + 2) % 3
            out[r, c] = m[r1, c1] * m[r2, c2] - m[r1, c2] * m[r2, c1]
    if m[0, 0] * out[0, 0] + m[0, 1] * out[0, 1] + m[0, 2] * out[0, 2] < 0.0:
        for r in range(3):
            for c in range(3):
                out[r, c] = -out[r, c]


def inverse_linear(m: np.ndarray) -> np.ndarray:
    """Inverse of the linear parts (..., 3, 3) by cofactors; zero for singular ones.

    np.linalg.inv raises for a stack in which one is singular, and takes a call of LAPACK for each.
    """
    a = m[..., :3]
    x, y, z = a[..., 0, :], a[..., 1, :], a[..., 2, :]
    rows = []
    for i, j in ((1, 2), (2, 0), (0, 1)):  # the products of columns i and j; np.cross is many times slower
        rows.append(
            np.stack(
                [
                    y[..., i] * z[..., j] - z[..., i] * y[..., j],
                    z[..., i] * x[..., j] - x[..., i] * z[..., j],
                    x[..., i] * y[..., j] - y[..., i] * x[..., j],
                ],
                -1,
            )
        )
    det = np.einsum("...i,...i->...", a[..., 0], rows[0])
    scale = np.where(det == 0, 0.0, 1.0 / np.where(det == 0, 1.0, det))
    return np.stack(rows, -2) * scale[..., None, None]
