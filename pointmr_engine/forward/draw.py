"""What a walk draws: sample sets as ellipses, and triangles as they are, through a placement's transform."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.forward.subpixels import cover_ellipse, cover_triangle
from pointmr_engine.hierarchy.surfels import AREA, NX, NY, NZ, XX, XY, XZ, YY, YZ, ZZ, X, Y, Z
from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.pointers import load_f32, load_i32

REACH = 2.2  # an ellipse's radii in standard deviations of its piece: 2, where a disk has its edge, and a tenth to close gaps
SOLID = 1.25  # times a piece's projected area over its ellipse's: from 1 on it is drawn without gaps
FLAT, ROUND = (
    0.95,
    0.5,
)  # lengths of a mean normal from and below which a piece counts as flat and as all directions


class Entries(NamedTuple):
    """What was drawn into a tile and was the nearest somewhere, in the order of drawing."""

    surfel: np.ndarray  # (E,) int64 row of the surfels; -1 - item of the octree for a triangle
    row: np.ndarray  # (E,) int32 row of the transforms


@device
def to_target(view, x, y, z):
    """(subpixel x, subpixel y, nearness) of a camera-space point in front of the camera."""
    if view.perspective:
        w = 1.0 / z
        return x * w * view.scale_x + view.shift_x, y * w * view.scale_y + view.shift_y, w
    return (
        x * view.scale_x + view.shift_x,
        y * view.scale_y + view.shift_y,
        view.depth_shift - z * view.depth_scale,
    )


@device
def draw_set(view, target, width, height, left, low, matrix, row, scale, rows, first, count, entries, used):
    """Draw surfels first..first + count under matrix[row]; returns the number of entries then used.

    width, height: subpixels of the tile, whose corner is the image's subpixel (left, low). scale: the largest stretch of
    the matrix. Entries must have room for `count` more.
    """
    m00, m01, m02, m03 = matrix[row, 0], matrix[row, 1], matrix[row, 2], matrix[row, 3]
    m10, m11, m12, m13 = matrix[row, 4], matrix[row, 5], matrix[row, 6], matrix[row, 7]
    m20, m21, m22, m23 = matrix[row, 8], matrix[row, 9], matrix[row, 10], matrix[row, 11]
    c00, c01, c02 = m11 * m22 - m12 * m21, m12 * m20 - m10 * m22, m10 * m21 - m11 * m20
    c10, c11, c12 = m21 * m02 - m22 * m01, m22 * m00 - m20 * m02, m20 * m01 - m21 * m00
    c20, c21, c22 = m01 * m12 - m02 * m11, m02 * m10 - m00 * m12, m00 * m11 - m01 * m10
    # how much areas grow that face all directions
    grow = math.sqrt((c00 * c00 + c01 * c01 + c02 * c02 + c10 * c10 + c11 * c11 + c12 * c12
                      + c20 * c20 + c21 * c21 + c22 * c22) / 3.0)  # fmt: skip
    fx, fy = view.scale_x, view.scale_y
    widest = 1.5 * REACH * max(fx, fy) * scale
    for i in range(first, first + count):
        x, y, z = np.float64(rows[i, X]), np.float64(rows[i, Y]), np.float64(rows[i, Z])
        px = m00 * x + m01 * y + m02 * z + m03
        py = m10 * x + m11 * y + m12 * z + m13
        pz = m20 * x + m21 * y + m22 * z + m23
        if not (pz > view.near and pz < view.far):
            continue
        sx, sy, w = to_target(view, px, py, pz)
        sx -= left
        sy -= low
        xx, xy, xz = np.float64(rows[i, XX]), np.float64(rows[i, XY]), np.float64(rows[i, XZ])
        yy, yz, zz = np.float64(rows[i, YY]), np.float64(rows[i, YZ]), np.float64(rows[i, ZZ])
        size = math.sqrt(xx + yy + zz)
        inverse = w if view.perspective else 1.0
        reach = widest * size * inverse
        if sx + reach < 0.0 or sy + reach < 0.0 or sx - reach > width or sy - reach > height:
            continue
        ux, uy = (px * w, py * w) if view.perspective else (0.0, 0.0)
        kx, ky = fx * inverse, fy * inverse
        a0, a1, a2 = kx * (m00 - ux * m20), kx * (m01 - ux * m21), kx * (m02 - ux * m22)
        b0, b1, b2 = ky * (m10 - uy * m20), ky * (m11 - uy * m21), ky * (m12 - uy * m22)
        v0, v1, v2 = a0 * xx + a1 * xy + a2 * xz, a0 * xy + a1 * yy + a2 * yz, a0 * xz + a1 * yz + a2 * zz
        s_xx = v0 * a0 + v1 * a1 + v2 * a2
        s_xy = v0 * b0 + v1 * b1 + v2 * b2
        v0, v1, v2 = b0 * xx + b1 * xy + b2 * xz, b0 * xy + b1 * yy + b2 * yz, b0 * xz + b1 * yz + b2 * zz
        s_yy = v0 * b0 + v1 * b1 + v2 * b2
        nx, ny, nz = np.float64(rows[i, NX]), np.float64(rows[i, NY]), np.float64(rows[i, NZ])
        gx = c00 * nx + c01 * ny + c02 * nz
        gy = c10 * nx + c11 * ny + c12 * nz
        gz = c20 * nx + c21 * ny + c22 * nz
        facing = gx * px + gy * py + gz * pz if view.perspective else gz
        # the piece's area in the image: exact for flat ones, half for those that face all directions
        density = kx * ky * (inverse if view.perspective else 1.0)
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        flat = min(max((length - ROUND) / (FLAT - ROUND), 0.0), 1.0)
        area = np.float64(rows[i, AREA])
        seen = flat * abs(facing) * density + (1.0 - flat) * 0.5 * grow * kx * ky
        det = s_xx * s_yy - s_xy * s_xy
        opacity = 2.0
        if det > 0.0:
            ratio = area * seen / (4.0 * math.pi * math.sqrt(det))
            if ratio * SOLID < 1.0 or flat < 1.0:
                opacity = flat * ratio * SOLID + (1.0 - flat) * (1.0 - math.exp(-ratio))
        q = REACH * REACH
        slope_x = slope_y = 0.0
        if flat > 0.5 and facing != 0.0:
            if view.perspective:
                slope_x, slope_y = gx / (facing * fx), gy / (facing * fy)
                room = w * w * REACH * size * scale
            else:
                slope_x, slope_y = view.depth_scale * gx / (gz * fx), view.depth_scale * gy / (gz * fy)
                room = view.depth_scale * REACH * size * scale
            steep = REACH * (abs(slope_x) * math.sqrt(s_xx) + abs(slope_y) * math.sqrt(s_yy))
            if steep > room:
                slope_x *= room / steep
                slope_y *= room / steep
        phase = (np.int64(i) * np.int64(40503)) >> np.int64(7)
        if cover_ellipse(
            target, width, height, sx, sy, q * s_xx, q * s_xy, q * s_yy, w, slope_x, slope_y, used, opacity,
            phase & np.int64(63),
        ):  # fmt: skip
            entries.surfel[used] = i
            entries.row[used] = row
            used += 1
    return used


@device
def corner(tables, part, triangle, vertex, offset, k):
    """Coordinate k of a triangle's vertex, plus offset[k]; tables: PartTables."""
    v = load_i32(tables.triangles[part], 3 * triangle + vertex)
    return np.float64(load_f32(tables.positions[part], 3 * v + k)) + offset[k]


@device
def draw_triangle(view, target, width, height, left, low, corners, entry):
    """Draw the triangle with corners (3, 3) in camera space, clipped at the near plane; whether it was written."""
    inside = 0
    for k in range(3):
        if corners[k, 2] >= view.near:
            inside += 1
    if inside == 0:
        return False
    if inside == 3:
        x0, y0, w0 = to_target(view, corners[0, 0], corners[0, 1], corners[0, 2])
        x1, y1, w1 = to_target(view, corners[1, 0], corners[1, 1], corners[1, 2])
        x2, y2, w2 = to_target(view, corners[2, 0], corners[2, 1], corners[2, 2])
        return cover_triangle(
            target,
            width,
            height,
            (x0 - left, x1 - left, x2 - left),
            (y0 - low, y1 - low, y2 - low),
            (w0, w1, w2),
            entry,
        )
    written = False
    # a fan from the first point of the clipped polygon, which has three or four
    count = 0
    fx = fy = fw = bx = by = bw = 0.0
    for k in range(3):
        n = k + 1 if k < 2 else 0
        za, zb = corners[k, 2], corners[n, 2]
        for part in range(2):
            if part == 0:
                if za < view.near:
                    continue
                x, y, z = corners[k, 0], corners[k, 1], za
            else:
                if (za < view.near) == (zb < view.near):
                    continue
                t = (view.near - za) / (zb - za)
                x = corners[k, 0] + t * (corners[n, 0] - corners[k, 0])
                y = corners[k, 1] + t * (corners[n, 1] - corners[k, 1])
                z = view.near
            sx, sy, w = to_target(view, x, y, z)
            sx -= left
            sy -= low
            if count == 0:
                fx, fy, fw = sx, sy, w
            elif count >= 2:
                if cover_triangle(target, width, height, (fx, bx, sx), (fy, by, sy), (fw, bw, w), entry):
                    written = True
            bx, by, bw = sx, sy, w
            count += 1
    return written
