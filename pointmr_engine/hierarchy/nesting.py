"""Steps from a group into the groups placed in it: which group, where, and how areas grow on the way."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.pointers import pointer_f64

_UNIFORM = 1e-7  # relative: lengths and angles that differ by less count as equal
_PAD = 1.0 + 1e-9


@uncounted
def placed_group(instances, batch, placement):
    """Index of the group that placement `placement` of a batch places; instances: BatchTables."""
    row = np.int64(instances.group_first[batch])
    first = instances.group[batch, 0]
    if first >= 0:
        row += np.int64(instances.group_values[first + instances.group[batch, 1] * placement])
    return np.int64(instances.batch_groups[row])


@uncounted
def enter(matrix, parent_row, outer, octree, instances, batch, placement, out_row):
    """matrix[out_row] = matrix[parent_row] * (outer_from_child of the placement); returns the child group.

    matrix (K, 12) float64, each taking positions relative to its group's `octree.group_center`; outer: the group of
    parent_row; octree: OctreeArrays; instances: BatchTables; indices int64.
    """
    group = placed_group(instances, batch, placement)
    t = pointer_f64(instances.transforms[batch])
    at = 12 * placement
    x, y, z = octree.group_center[group, 0], octree.group_center[group, 1], octree.group_center[group, 2]
    # where the child's centre lies, relative to the outer group's
    ox = t[at] * x + t[at + 1] * y + t[at + 2] * z + t[at + 3] - octree.group_center[outer, 0]
    oy = t[at + 4] * x + t[at + 5] * y + t[at + 6] * z + t[at + 7] - octree.group_center[outer, 1]
    oz = t[at + 8] * x + t[at + 9] * y + t[at + 10] * z + t[at + 11] - octree.group_center[outer, 2]
    for r in range(3):
        a, b, c = matrix[parent_row, 4 * r], matrix[parent_row, 4 * r + 1], matrix[parent_row, 4 * r + 2]
        matrix[out_row, 4 * r] = a * t[at] + b * t[at + 4] + c * t[at + 8]
        matrix[out_row, 4 * r + 1] = a * t[at + 1] + b * t[at + 5] + c * t[at + 9]
        matrix[out_row, 4 * r + 2] = a * t[at + 2] + b * t[at + 6] + c * t[at + 10]
        matrix[out_row, 4 * r + 3] = a * ox + b * oy + c * oz + matrix[parent_row, 4 * r + 3]
    return group


@uncounted
def area_scale(m, at):
    """(largest factor by which the linear part of the transform at m[at : at + 12] scales an area, uniform).

    The factor is the product of the two largest singular values. uniform: the map scales all directions alike, so that
    every area grows by exactly this factor.
    """
    xx = m[at] * m[at] + m[at + 4] * m[at + 4] + m[at + 8] * m[at + 8]
    yy = m[at + 1] * m[at + 1] + m[at + 5] * m[at + 5] + m[at + 9] * m[at + 9]
    zz = m[at + 2] * m[at + 2] + m[at + 6] * m[at + 6] + m[at + 10] * m[at + 10]
    xy = m[at] * m[at + 1] + m[at + 4] * m[at + 5] + m[at + 8] * m[at + 9]
    xz = m[at] * m[at + 2] + m[at + 4] * m[at + 6] + m[at + 8] * m[at + 10]
    yz = m[at + 1] * m[at + 2] + m[at + 5] * m[at + 6] + m[at + 9] * m[at + 10]
    mean = (xx + yy + zz) / 3.0
    uneven = max(abs(xx - mean), abs(yy - mean), abs(zz - mean), abs(xy), abs(xz), abs(yz))
    if uneven <= _UNIFORM * mean:
        return mean, True
    # squared: the largest eigenvalue of the cofactor matrix of the Gram matrix (closed form for three by three)
    a, b, c = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
    d, e, f = xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - yz * xx
    q = (a + b + c) / 3.0
    a -= q
    b -= q
    c -= q
    p = np.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
    if p <= 0.0:
        return np.sqrt(q), False
    det = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)
    r = min(1.0, max(-1.0, det / (2.0 * p * p * p)))
    return np.sqrt(q + 2.0 * p * np.cos(np.arccos(r) / 3.0)) * _PAD, False
