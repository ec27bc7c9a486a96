"""Eight surfels at a time from their group's space into the image: places first, then, for those not hidden, ellipses.

The constants of a set (a placement's matrix about the node's middle, the tile) are computed once in float64.
"""

from __future__ import annotations

import math

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pointmr_engine.forward.drawing.subpixel_places import INNER
from pointmr_engine.hierarchy.set_chunks import BALL_REACH
from pointmr_engine.hierarchy.surfels import (
    AREA,
    COLUMNS,
    FLAT,
    NX,
    NY,
    NZ,
    ROUND,
    XX,
    XY,
    XZ,
    YY,
    YZ,
    ZZ,
    X,
    Y,
    Z,
)
from pointmr_engine.numerics.simd import WIDTH, _i64
from pointmr_engine.numerics.simd_terms import Terms

# radii of an ellipse in standard deviations of its piece: a disk's edge is at 2; a tenth closes gaps
REACH = BALL_REACH
SOLID = 1.25  # times a piece's projected area over its ellipse's: from 1 on it is drawn without gaps
SPARSE = 0.4  # of its ellipse: a piece that fills less is drawn as a clump
# of 27 det V / (tr V)^3, 1 for a ball: up to where a piece is a surface; from where a clump
SURFACE, CLUMP = 0.2, 0.6
DENSE = 4.0 / REACH**2  # the same of a clump, which covers its area and no more

# the constants of a set. The last two belong to the target, 0 for subpixels: by how much subpixels see beyond their
# sides, and whether triangles between their centres matter
(
    MIDDLE, MATRIX, COFACTORS, GROW, FOCAL_X, FOCAL_Y, SHIFT_X, SHIFT_Y, WIDTH_OF_TILE, HEIGHT_OF_TILE, NEAR, FAR,
    PERSPECTIVE, DEPTH_SHIFT, DEPTH_SCALE, STRETCH, PAD, ALL_AREAS,
) = 0, 3, 15, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35, 36, 37, 38  # fmt: skip
CONSTANTS = 40

# rows of eight that `place_eight` and `shape_eight` leave behind
PX, PY, PZ, SX, SY, NEARNESS, RADIUS, FRONT, A, B, C, SLOPE_X, SLOPE_Y, OPACITY, SEEN = range(15)
LANE_ROWS = 15


@intrinsic
def place_eight(typingctx, rows, first, constants, out):
    """Places of surfels first..first + 8; returns the mask of those in front of the camera and in the tile.

    rows: address of float32 rows of surfels; constants: address of float32; out: address of LANE_ROWS rows of eight
    float32, of which PX to FRONT are filled: camera space, subpixels in the tile, nearness, bounding radius, nearness
    of the front.
    """
    i = types.int64

    def codegen(context, builder, signature, args):
        t = Terms(builder)
        data, k, target = t.pointer(args[0]), t.pointer(args[2]), t.pointer(args[3])

        def column(c):
            return t.gather(data, args[1], COLUMNS, c)

        def constant(c):
            return t.broadcast(k, c)

        x, y, z = (column(c) - constant(MIDDLE + n) for n, c in enumerate((X, Y, Z)))
        p = []
        for r in range(3):
            m = [constant(MATRIX + 4 * r + c) for c in range(4)]
            p.append(m[3].plus_product(m[0], x).plus_product(m[1], y).plus_product(m[2], z))
        perspective = constant(PERSPECTIVE) > 0.5
        one = t.constant(1.0)
        inverse = one / p[2]
        depth = constant(DEPTH_SHIFT) - p[2] * constant(DEPTH_SCALE)
        scale = inverse.where(perspective, 1.0)
        sx = constant(SHIFT_X).plus_product(p[0] * scale, constant(FOCAL_X))
        sy = constant(SHIFT_Y).plus_product(p[1] * scale, constant(FOCAL_Y))
        size = ((column(XX) + column(YY)) + column(ZZ)).sqrt() * constant(STRETCH) * REACH
        focal = constant(FOCAL_X).abs().at_least(constant(FOCAL_Y).abs())
        # perspective makes what is off the view axis longer, along x by sqrt(1 + (x / z)^2)
        off = (p[0] * scale).abs().at_least((p[1] * scale).abs()).where(perspective, 0.0)
        radius = constant(PAD).plus_product(size * focal * scale.abs(), (t.constant(1.0) + off * off).sqrt())
        front = p[2] - size
        near = constant(NEAR)
        nearness = (
            (one / front)
            .where(front > near, 3e38)
            .where(perspective, constant(DEPTH_SHIFT) - front * constant(DEPTH_SCALE))
        )
        mask = builder.and_(p[2] > near, p[2] < constant(FAR))
        mask = builder.and_(mask, builder.and_((sx + radius) > 0.0, (sy + radius) > 0.0))
        mask = builder.and_(
            mask,
            builder.and_((sx - radius) < constant(WIDTH_OF_TILE), (sy - radius) < constant(HEIGHT_OF_TILE)),
        )
        for row, term in (
            (PX, p[0]),
            (PY, p[1]),
            (PZ, p[2]),
            (SX, sx),
            (SY, sy),
            (RADIUS, radius),
            (FRONT, nearness),
        ):
            t.store(term, target, row)
        t.store(inverse.where(perspective, depth), target, NEARNESS)
        return t.bits(mask)

    return i(types.uint64, i, types.uint64, types.uint64), codegen


@intrinsic
def shape_eight(typingctx, rows, first, constants, out):
    """Ellipses of the surfels that `place_eight` has placed: fills A to SEEN.

    A, B, C: the matrix [[a, b], [b, c]] whose inverse's unit level is the outline, in subpixels^2; SLOPE_*: growth of
    nearness per subpixel; OPACITY: share of the outline's subpixels to be drawn, 1 or more: all. SEEN: area that
    the piece covers, subpixels^2, less than 0 where the image shows its corners clockwise.
    """
    i = types.int64

    def codegen(context, builder, signature, args):
        t = Terms(builder)
        data, k, target = t.pointer(args[0]), t.pointer(args[2]), t.pointer(args[3])
        zero = ir.Constant(_i64, 0)

        def column(c):
            return t.gather(data, args[1], COLUMNS, c)

        def constant(c):
            return t.broadcast(k, c)

        def placed(row):
            return t.gather(target, zero, 1, row * WIDTH)

        px, py, pz, w = placed(PX), placed(PY), placed(PZ), placed(NEARNESS)
        perspective = constant(PERSPECTIVE) > 0.5
        scale = w.where(perspective, 1.0)
        ux, uy = (px * w).where(perspective, 0.0), (py * w).where(perspective, 0.0)
        kx, ky = constant(FOCAL_X) * scale, constant(FOCAL_Y) * scale
        m = [[constant(MATRIX + 4 * r + c) for c in range(3)] for r in range(3)]
        a = [kx * (m[0][c] - ux * m[2][c]) for c in range(3)]
        b = [ky * (m[1][c] - uy * m[2][c]) for c in range(3)]
        xx, xy, xz, yy, yz, zz = (column(c) for c in (XX, XY, XZ, YY, YZ, ZZ))

        def times(v):
            return (
                (v[0] * xx).plus_product(v[1], xy).plus_product(v[2], xz),
                (v[0] * xy).plus_product(v[1], yy).plus_product(v[2], yz),
                (v[0] * xz).plus_product(v[1], yz).plus_product(v[2], zz),
            )

        def dot(p, q):
            return (p[0] * q[0]).plus_product(p[1], q[1]).plus_product(p[2], q[2])

        va, vb = times(a), times(b)
        s_xx, s_xy, s_yy = dot(va, a), dot(va, b), dot(vb, b)
        n = [column(c) for c in (NX, NY, NZ)]
        cof = [[constant(COFACTORS + 3 * r + c) for c in range(3)] for r in range(3)]
        g = [dot(cof[r], n) for r in range(3)]
        facing = dot(g, (px, py, pz)).where(perspective, g[2])
        length = dot(n, n).sqrt()
        flat = ((length - ROUND) * (1.0 / (FLAT - ROUND))).at_least(0.0).at_most(1.0)
        round_ = t.constant(1.0) - flat
        # the piece's area in the image: exact for flat ones, half for those that face all directions
        seen = kx * ky * (flat * facing.abs() * scale + round_ * constant(GROW) * 0.5)
        det = (s_xx * s_yy - s_xy * s_xy).at_least(1e-30)
        disk, area = det.sqrt() * (4.0 * math.pi), column(AREA) * seen.abs()
        ratio = area / disk
        # how much the piece is a surface, however curved, and not a clump: by its extent across
        minor = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        third = (xx + yy + zz) * (1 / 3)
        bulk = minor / (third * third * third).at_least(1e-37)
        solid = ((t.constant(CLUMP) - bulk) * (1.0 / (CLUMP - SURFACE))).at_least(0.0).at_most(1.0)
        clump = t.constant(1.0) - solid
        # a twig with its needles is no surface, however thin
        filled = ((ratio - SPARSE) * (1.0 / (1.0 / SOLID - SPARSE))).at_least(0.0).at_most(1.0) * solid
        opacity = filled * (ratio * SOLID).at_most(2.0) + (t.constant(1.0) - filled) * (
            ratio * DENSE
        ).at_most(1.0)
        shown = solid * area + clump * area.at_most(disk)
        shown = shown.where((facing * kx * ky) > 0.0, t.constant(0.0) - shown)
        unit = t.constant(1.0).where(perspective, constant(DEPTH_SCALE))
        safe = facing.where(builder.and_(facing.abs() > 1e-30, solid > 0.5), 3e38)
        slope_x, slope_y = unit * g[0] / (safe * constant(FOCAL_X)), unit * g[1] / (safe * constant(FOCAL_Y))
        size = ((xx + yy) + zz).sqrt() * constant(STRETCH)
        room = size * (w * w).where(perspective, constant(DEPTH_SCALE))
        steep = (slope_x.abs() * s_xx.at_least(0.0).sqrt()).plus_product(
            slope_y.abs(), s_yy.at_least(0.0).sqrt()
        )
        damp = (room / steep.at_least(1e-30)).at_most(1.0)
        q = REACH * REACH
        for row, term in (
            (A, s_xx * q),
            (B, s_xy * q),
            (C, s_yy * q),
            (SLOPE_X, slope_x * damp),
            (SLOPE_Y, slope_y * damp),
            (OPACITY, opacity),
            (SEEN, shown),
        ):
            t.store(term, target, row)
        return context.get_dummy_value()

    return types.void(types.uint64, i, types.uint64, types.uint64), codegen


# rows of eight that `corners_eight` leaves behind: three subpixel x, three y, three of nearness, the largest nearness,
# the larger side of the bounds, and the subpixels of the tile that look into them: first and last column, first and
# last row
CORNER_X, CORNER_Y, CORNER_W = 0, 3, 6
CORNER_FRONT, CORNER_SMALL, LEFT, RIGHT, LOW, HIGH = range(9, 15)


@intrinsic
def corners_eight(typingctx, corners, first, constants, out):
    """Corners of triangles first..first + 8 in the tile; returns masks: bits 0-7 those to be drawn, 8-15 those to be
    clipped.

    corners: address of float32, nine a triangle. Triangles outside the tile, and between the centres of its
    subpixels, are in neither mask; those that reach behind the near plane are in the second.
    """
    i = types.int64

    def codegen(context, builder, signature, args):
        t = Terms(builder)
        data, k, target = t.pointer(args[0]), t.pointer(args[2]), t.pointer(args[3])

        def constant(c):
            return t.broadcast(k, c)

        m = [[constant(MATRIX + 4 * r + c) for c in range(4)] for r in range(3)]
        middle = [constant(MIDDLE + c) for c in range(3)]
        perspective = constant(PERSPECTIVE) > 0.5
        near, far = constant(NEAR), constant(FAR)
        xs, ys, ws, front, behind = [], [], [], None, None
        for v in range(3):
            x, y, z = (t.gather(data, args[1], 9, 3 * v + c) - middle[c] for c in range(3))
            p = [r[3].plus_product(r[0], x).plus_product(r[1], y).plus_product(r[2], z) for r in m]
            inverse = t.constant(1.0) / p[2]
            scale = inverse.where(perspective, 1.0)
            xs.append(constant(SHIFT_X).plus_product(p[0] * scale, constant(FOCAL_X)))
            ys.append(constant(SHIFT_Y).plus_product(p[1] * scale, constant(FOCAL_Y)))
            ws.append(inverse.where(perspective, constant(DEPTH_SHIFT) - p[2] * constant(DEPTH_SCALE)))
            inside = builder.and_(p[2] > near, p[2] < far)
            front = inside if front is None else builder.and_(front, inside)
            here = p[2] > near
            behind = here if behind is None else builder.or_(behind, here)
        x0, x1 = xs[0].at_most(xs[1]).at_most(xs[2]), xs[0].at_least(xs[1]).at_least(xs[2])
        y0, y1 = ys[0].at_most(ys[1]).at_most(ys[2]), ys[0].at_least(ys[1]).at_least(ys[2])
        # columns and rows that the bounds reach, where their subpixels may look
        areas = constant(ALL_AREAS) > 0.5
        left, right, low, high = (
            bound._unary("floor").where(areas, (bound + inner)._unary(rounded))
            for bound, inner, rounded in (
                (x0, INNER - 1.0, "ceil"), (x1, -INNER, "floor"), (y0, INNER - 1.0, "ceil"), (y1, -INNER, "floor"),
            )
        )  # fmt: skip
        left, right = left.at_least(0.0), right.at_most(constant(WIDTH_OF_TILE) - 1.0)
        low, high = low.at_least(0.0), high.at_most(constant(HEIGHT_OF_TILE) - 1.0)
        seen = builder.and_((right - left) > -0.5, (high - low) > -0.5)
        # as bounds, the clamps let NaN pass
        seen = builder.and_(seen, builder.and_(x1 > 0.0, y1 > 0.0))
        seen = builder.and_(seen, builder.and_(x0 < constant(WIDTH_OF_TILE), y0 < constant(HEIGHT_OF_TILE)))
        for v in range(3):
            t.store(xs[v], target, CORNER_X + v)
            t.store(ys[v], target, CORNER_Y + v)
            t.store(ws[v], target, CORNER_W + v)
        t.store(ws[0].at_least(ws[1]).at_least(ws[2]), target, CORNER_FRONT)
        t.store((x1 - x0).at_least(y1 - y0), target, CORNER_SMALL)
        t.store(left, target, LEFT)
        t.store(right, target, RIGHT)
        t.store(low, target, LOW)
        t.store(high, target, HIGH)
        drawn = t.bits(builder.and_(seen, front))
        crossing = t.bits(builder.and_(behind, builder.not_(front)))
        return builder.or_(drawn, builder.shl(crossing, ir.Constant(_i64, 8)))

    return i(types.uint64, i, types.uint64, types.uint64), codegen
