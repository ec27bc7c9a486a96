"""Cones of 8 x 8 sub-rays against eight boxes, prefiltered points or triangles at a time, as LLVM vector code.

Cone space is (x lateral, y lateral, t axial). Sub-ray (i, j) with u = (i + 0.5) / 4 - 1 and v likewise runs through
(u (start_x + spread_x t), v (start_y + spread_y t), t); "cells" are the squares that the sub-rays are the middles of.
Masks have bit 8 j + i. All t below are about the hierarchy's centre, and so are start and the ends.
"""

from __future__ import annotations

import math

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pointmr_engine.numerics.simd import BLOCK_FLOATS, NODE_FLOATS, WIDTH, _i64, _load
from pointmr_engine.numerics.simd_terms import Term, Terms

# a row of constants: cone_from_local (3 x 4), the cone, the tolerances, and what decides how points are drawn
(
    MATRIX, START_X, START_Y, SPREAD_X, SPREAD_Y, NEAR, FAR, PAD, SMALL, REACH, SOLID, DENSE, WHOLE,
) = 0, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23  # fmt: skip
CONSTANTS = 24

POINT_ROWS = 16  # of eight float32 a node: centroid, covariance, normals' tensor, solidity of eight children
X, XX, PP, FLATNESS = 0, 3, 9, 15

# rows of eight float32 that `cone_boxes`, `cone_points`, `cone_triangles` leave behind
COLUMNS, LINES, FRONT = 0, 1, 2
BOX_ROWS = 3
U, V, CONIC, OPACITY, DEPTH, ACROSS, ALONG, OFFSET, HALF = 0, 1, 2, 5, 6, 7, 10, 13, 16
ELLIPSE_ROWS = 19
EDGES, NEAREST = 0, 12
TRIANGLE_ROWS = 13

AROUND = 6.0  # variances: an ellipse that holds a rectangle's corners
# of a box's longest side: how thick it is at least, how far it reaches into its neighbours
THICK, EDGE = 0.15, 0.01
_TINY = 1e-30
_SLACK = 1e-4  # of a cell: more than what rounding can move the bounds of a box by


def _cone(t: Terms, constants):
    def constant(c):
        return t.broadcast(constants, c)

    matrix = [[constant(MATRIX + 4 * r + c) for c in range(4)] for r in range(3)]
    start = constant(START_X), constant(START_Y)
    spread = constant(SPREAD_X), constant(SPREAD_Y)
    return constant, matrix, start, spread


def _place(m, x, y, z) -> list[Term]:
    return [r[3].plus_product(r[0], x).plus_product(r[1], y).plus_product(r[2], z) for r in m]


def _centres(low: Term, high: Term) -> tuple[Term, Term]:
    """First and last of the sub-rays 0..7 between two places in cells; first > last where there is none."""
    first = (low - (0.5 + _SLACK))._unary("ceil").at_least(0.0)
    last = (high - (0.5 - _SLACK))._unary("floor").at_most(7.0)
    return first, last


@intrinsic
def cone_boxes(typingctx, boxes, node, constants, out):
    """Boxes of a node's eight children: bits 0-7 those that some sub-ray may meet, 8-15 those that are small.

    boxes: address of float32, NODE_FLOATS a node; constants, out: addresses of float32, out of BOX_ROWS rows of eight:
    8 * first + last of the columns and of the lines of sub-rays that may meet a box (small ones: undefined), and where
    it begins. Small: no larger than SMALL cells; these are in bits 0-7 if they are near the cone.
    """
    i = types.int64

    def codegen(context, builder, signature, args):
        t = Terms(builder)
        data, k, target = (t.pointer(args[n]) for n in (0, 2, 3))
        constant, m, start, spread = _cone(t, k)
        base = builder.mul(args[1], ir.Constant(_i64, NODE_FLOATS))
        planes = [
            Term(builder, _load(builder, data, builder.add(base, ir.Constant(_i64, n * WIDTH))))
            for n in range(6)
        ]
        middle = [(planes[n] + planes[n + 3]) * 0.5 for n in range(3)]
        half = [(planes[n + 3] - planes[n]) * 0.5 for n in range(3)]
        p = _place(m, *middle)
        pad = constant(PAD)
        h = [
            pad.plus_product(r[0].abs(), half[0])
            .plus_product(r[1].abs(), half[1])
            .plus_product(r[2].abs(), half[2])
            for r in m
        ]
        near, far = constant(NEAR), constant(FAR)
        t0, t1 = p[2] - h[2], p[2] + h[2]
        # nothing is inside an unused lane's box, which is not a number
        inside = builder.and_(t1 > near, t0 < far)
        t0, t1 = t0.at_least(near), t1.at_most(far)
        small, close, rows = None, None, []
        for axis in range(2):
            w0 = start[axis].plus_product(spread[axis], t0)
            w1 = start[axis].plus_product(spread[axis], t1)
            here = start[axis].plus_product(spread[axis], p[2].at_least(near).at_most(far))
            low, high = w0.at_most(w1), w0.at_least(w1)
            # behind a focus the cone's sides have changed places; a box around a focus may be met by any sub-ray
            turned, around = high < 0.0, builder.and_(low < 0.0, high > 0.0)
            a, b = p[axis] - h[axis], p[axis] + h[axis]
            zero = t.constant(0.0)
            a, b = (zero - b).where(turned, a), (zero - a).where(turned, b)
            most = a.abs().at_least(b.abs())
            a, b = (zero - most).where(around, a), most.where(around, b)
            low, high = low.abs().at_most(high.abs()).where(turned, low), low.abs().at_least(high.abs())
            most, least = t.constant(4.0) / low.at_least(_TINY), t.constant(4.0) / high.at_least(_TINY)
            a = a * least.where(a > 0.0, most) + 4.0
            b = b * most.where(b > 0.0, least) + 4.0
            first, last = _centres(a, b)
            met = (last - first) > -0.5
            rows.append((first, last, met))
            room = (h[axis] * 8.0) < (here.abs() * constant(SMALL))
            beside = builder.and_(a < 9.0, b > -1.0)
            small = room if small is None else builder.and_(small, room)
            close = beside if close is None else builder.and_(close, beside)
        met = builder.and_(rows[0][2], rows[1][2])
        touched = builder.and_(inside, builder.or_(met, builder.and_(small, close)))
        small = builder.and_(small, touched)
        for axis, row in ((0, COLUMNS), (1, LINES)):
            t.store(rows[axis][0] * 8.0 + rows[axis][1], target, row)
        t.store(t0, target, FRONT)
        return builder.or_(t.bits(touched), builder.shl(t.bits(small), ir.Constant(_i64, WIDTH)))

    return i(i, i, i, i), codegen


@intrinsic
def cone_points(typingctx, points, boxes, node, constants, out):
    """Ellipses of a node's eight prefiltered points; bits of those that may cover a sub-ray.

    points: address of float32, POINT_ROWS * 8 a node; boxes as `cone_boxes`; constants, out: addresses of float32, out
    of ELLIPSE_ROWS rows of eight: middle u, v in cells; a, b, c of a dx^2 + b dx dy + c dy^2 <= 1; share of the
    ellipse that is covered; t. Shares above 2 mark pieces of surface without gaps, for `patch_mask`: that part of its
    plane that lies in its box, of the opacity share - 2. Where the plane is: ACROSS du + ALONG dv + OFFSET, about the
    box's middle; HALF its size.
    """
    i = types.int64

    def codegen(context, builder, signature, args):
        t = Terms(builder)
        data, planes, k, target = (t.pointer(args[n]) for n in (0, 1, 3, 4))
        constant, m, start, spread = _cone(t, k)
        base = builder.mul(args[2], ir.Constant(_i64, POINT_ROWS * WIDTH))
        box = builder.mul(args[2], ir.Constant(_i64, NODE_FLOATS))

        def column(c):
            return Term(builder, _load(builder, data, builder.add(base, ir.Constant(_i64, c * WIDTH))))

        p = _place(m, column(X), column(X + 1), column(X + 2))
        rows, middle = [], []
        for axis in range(2):
            # half a cell is the unit; a focus has no size, so that nothing is drawn there but by exact triangles
            w = start[axis].plus_product(spread[axis], p[2])
            inverse = t.constant(4.0) / w
            u = p[axis] * inverse
            lean = u * spread[axis] * 0.25
            rows.append([inverse * (m[axis][c] - lean * m[2][c]) for c in range(3)])
            middle.append(u + 4.0)
        a, b = rows

        def dot(p, q):
            return (p[0] * q[0]).plus_product(p[1], q[1]).plus_product(p[2], q[2])

        def times(first, v):
            xx, xy, xz, yy, yz, zz = (column(first + n) for n in range(6))
            return (
                (v[0] * xx).plus_product(v[1], xy).plus_product(v[2], xz),
                (v[0] * xy).plus_product(v[1], yy).plus_product(v[2], yz),
                (v[0] * xz).plus_product(v[1], yz).plus_product(v[2], zz),
            )

        va, vb = times(XX, a), times(XX, b)
        s_uu, s_uv, s_vv = dot(va, a), dot(va, b), dot(vb, b)
        g = [a[(n + 1) % 3] * b[(n + 2) % 3] - a[(n + 2) % 3] * b[(n + 1) % 3] for n in range(3)]
        seen = dot(times(PP, g), g).at_least(0.0).sqrt()
        det = (s_uu * s_vv - s_uv * s_uv).at_least(s_uu * s_vv * 1e-6).at_least(1e-20)
        ratio = seen / (det.sqrt() * math.pi)  # of an ellipse of one standard deviation
        flat = column(FLATNESS)
        clear = flat < 0.0
        full = (t.constant(0.0) - flat).where(clear, 1.0)
        flat = t.constant(1.0).where(clear, flat)
        whole = builder.and_(flat > 0.5, ratio > constant(WHOLE) * full)
        reach = t.constant(AROUND).where(whole, constant(REACH))
        opacity = ratio / reach * (constant(DENSE) + flat * (constant(SOLID) - constant(DENSE)))
        opacity = (full + 2.0).where(whole, opacity.at_most(1.0))
        # the normal, for one normal is all that there is: the longest column of its tensor
        xx, xy, xz, yy, yz, zz = (column(PP + n) for n in range(6))
        second = builder.and_(yy > xx, yy > zz)
        third = builder.and_(zz > xx, zz > yy)
        n = [
            xz.where(third, xy.where(second, xx)),
            yz.where(third, yy.where(second, xy)),
            zz.where(third, yz.where(second, xz)),
        ]

        def cross(p, q):
            return [p[(i + 1) % 3] * q[(i + 2) % 3] - p[(i + 2) % 3] * q[(i + 1) % 3] for i in range(3)]

        inverse = t.constant(1.0) / dot(n, g)
        across, along = cross(b, n), cross(n, a)
        sides = [
            Term(builder, _load(builder, planes, builder.add(box, ir.Constant(_i64, side * WIDTH))))
            for side in range(6)
        ]
        half = [(sides[3 + axis] - sides[axis]) * 0.5 for axis in range(3)]
        most = half[0].at_least(half[1]).at_least(half[2])
        for axis in range(3):
            t.store(across[axis] * inverse, target, ACROSS + axis)
            t.store(along[axis] * inverse, target, ALONG + axis)
            t.store(column(X + axis) - (sides[axis] + sides[3 + axis]) * 0.5, target, OFFSET + axis)
            # a thin box is left by the plane of what is not quite flat
            t.store(half[axis].at_least(most * THICK) + most * EDGE, target, HALF + axis)
        scale = t.constant(1.0) / (det * reach)
        wide, high = (s_uu * reach).at_least(0.0).sqrt(), (s_vv * reach).at_least(0.0).sqrt()
        first, last = _centres(middle[0] - wide, middle[0] + wide)
        mask = (last - first) > -0.5
        first, last = _centres(middle[1] - high, middle[1] + high)
        mask = builder.and_(mask, (last - first) > -0.5)
        mask = builder.and_(mask, builder.and_(p[2] > constant(NEAR), p[2] < constant(FAR)))
        mask = builder.and_(mask, seen > 0.0)
        for row, term in (
            (U, middle[0]),
            (V, middle[1]),
            (CONIC, s_vv * scale),
            (CONIC + 1, s_uv * scale * -2.0),
            (CONIC + 2, s_uu * scale),
            (OPACITY, opacity),
            (DEPTH, p[2]),
        ):
            t.store(term, target, row)
        return t.bits(mask)

    return i(i, i, i, i, i), codegen


def _packed(builder, rows):
    """Eight masks of eight lanes as one int64."""
    mask = None
    for j, row in enumerate(rows):
        bits = builder.shl(
            builder.zext(builder.bitcast(row, ir.IntType(WIDTH)), _i64), ir.Constant(_i64, WIDTH * j)
        )
        mask = bits if mask is None else builder.or_(mask, bits)
    return mask


def _lanes(builder, values) -> Term:
    return Term(builder, ir.Constant(ir.VectorType(ir.FloatType(), WIDTH), list(values)))


@intrinsic
def ellipse_mask(typingctx, ellipses, lane):
    """Sub-rays inside one of the ellipses that `cone_points` left at address `ellipses`."""
    i = types.int64

    def codegen(context, builder, signature, args):
        t = Terms(builder)
        at = builder.gep(t.pointer(args[0]), [args[1]])
        u, v, a, b, c = (t.broadcast(at, row * WIDTH) for row in (U, V, CONIC, CONIC + 1, CONIC + 2))
        dx = _lanes(builder, (n + 0.5 for n in range(WIDTH))) - u
        p, q = a * dx * dx, b * dx
        rows = []
        for j in range(8):
            dy = t.constant(j + 0.5) - v
            rows.append(p.plus_product(dy, q.plus_product(c, dy)) < 1.0)
        return _packed(builder, rows)

    return i(i, i), codegen


@intrinsic
def patch_mask(typingctx, ellipses, lane):
    """Sub-rays that meet one of the pieces of surface that `cone_points` left at address `ellipses`."""
    i = types.int64

    def codegen(context, builder, signature, args):
        t = Terms(builder)
        at = builder.gep(t.pointer(args[0]), [args[1]])
        u, v, a, b, c = (t.broadcast(at, row * WIDTH) for row in (U, V, CONIC, CONIC + 1, CONIC + 2))
        dx = _lanes(builder, (n + 0.5 for n in range(WIDTH))) - u
        p, q = a * dx * dx, b * dx
        slabs = []
        for axis in range(3):
            across, along, offset, half = (
                t.broadcast(at, (row + axis) * WIDTH) for row in (ACROSS, ALONG, OFFSET, HALF)
            )
            slabs.append((offset.plus_product(across, dx), along, half))
        rows = []
        for j in range(8):
            dy = t.constant(j + 0.5) - v
            inside = p.plus_product(dy, q.plus_product(c, dy)) < 1.0
            for first, along, half in slabs:
                inside = builder.and_(inside, first.plus_product(along, dy).abs() < half)
            rows.append(inside)
        return _packed(builder, rows)

    return i(i, i), codegen


@intrinsic
def cone_triangles(typingctx, blocks, block, constants, out):
    """A block's eight triangles: bits 0-7 those that may cover a sub-ray, 8-15 those that reach beyond the ends.

    blocks: address of float32, BLOCK_FLOATS a block; constants, out: addresses of float32, out of TRIANGLE_ROWS rows of
    eight: four coefficients each of the three edges' functions, bilinear in u and v (the sub-ray's volume with an edge;
    the same but for the sign in the triangles on its two sides), and the nearest corner's t.
    """
    i = types.int64

    def codegen(context, builder, signature, args):
        t = Terms(builder)
        data, k, target = (t.pointer(args[n]) for n in (0, 2, 3))
        constant, m, start, spread = _cone(t, k)
        base = builder.mul(args[1], ir.Constant(_i64, BLOCK_FLOATS))
        corners = []
        for vertex in range(3):
            xyz = (
                Term(
                    builder,
                    _load(builder, data, builder.add(base, ir.Constant(_i64, (3 * vertex + c) * WIDTH))),
                )
                for c in range(3)
            )
            corners.append(_place(m, *xyz))
        least = corners[0][2].at_most(corners[1][2]).at_most(corners[2][2])
        most = corners[0][2].at_least(corners[1][2]).at_least(corners[2][2])
        # products of coordinates are small, and so are their roundings, about a place close by; one for all eight, so
        # that neighbours agree about their edge
        shift = t.splat(builder.extract_element(corners[0][2].value, ir.Constant(ir.IntType(32), 0)))
        near, far, pad = constant(NEAR), constant(FAR), constant(PAD)
        sx, sy = (start[n].plus_product(spread[n], shift) for n in range(2))
        kx, ky = spread
        twist = kx * sy - ky * sx
        mask = builder.and_(most > (near - pad), least < (far + pad))
        within = builder.and_(least > (near + pad), most < (far - pad))
        # bounds in cells, where all corners are in front
        for axis in range(2):
            front, low, high = None, None, None
            for p in corners:
                w = start[axis].plus_product(spread[axis], p[2])
                u = p[axis] / w
                front = (w > _TINY) if front is None else builder.and_(front, w > _TINY)
                low = u if low is None else low.at_most(u)
                high = u if high is None else high.at_least(u)
            first, last = _centres(low * 4.0 + 4.0, high * 4.0 + 4.0)
            met = builder.or_((last - first) > -0.5, builder.not_(front))
            mask = builder.and_(mask, met)
        local = [(p[0], p[1], p[2] - shift) for p in corners]
        edges = []
        for a, b in ((1, 2), (2, 0), (0, 1)):
            (ax, ay, at), (bx, by, bt) = local[a], local[b]
            # products and sums kept apart, so that the neighbour's are the same but for the sign
            edges.append(
                (
                    ax * by - ay * bx,
                    kx * (ay * bt - at * by) + sx * (ay - by),
                    ky * (at * bx - ax * bt) - sy * (ax - bx),
                    twist * (at - bt),
                )
            )
        # the sign at corner 0 turned to plus: an edge that is met exactly (0 counts as plus) belongs to both sides
        u = corners[0][0] / (start[0].plus_product(spread[0], corners[0][2]))
        v = corners[0][1] / (start[1].plus_product(spread[1], corners[0][2]))
        total = [edges[0][n] + edges[1][n] + edges[2][n] for n in range(4)]
        volume = total[0] + total[1] * u + (total[2] + total[3] * u) * v
        sign = t.constant(-1.0).where(volume < 0.0, 1.0)
        for e in range(3):
            for n in range(4):
                t.store(edges[e][n] * sign, target, EDGES + 4 * e + n)
        t.store(least, target, NEAREST)
        beyond = builder.and_(mask, builder.not_(within))
        return builder.or_(t.bits(mask), builder.shl(t.bits(beyond), ir.Constant(_i64, WIDTH)))

    return i(i, i, i, i), codegen


@intrinsic
def triangle_mask(typingctx, triangles, lane):
    """Sub-rays whose line meets one of the triangles that `cone_triangles` left at address `triangles`."""
    i = types.int64
    integers = ir.VectorType(ir.IntType(32), WIDTH)

    def codegen(context, builder, signature, args):
        t = Terms(builder)
        at = builder.gep(t.pointer(args[0]), [args[1]])
        u = _lanes(builder, ((n + 0.5) / 4 - 1 for n in range(WIDTH)))
        pairs = []
        for e in range(3):
            c = [t.broadcast(at, (EDGES + 4 * e + n) * WIDTH) for n in range(4)]
            pairs.append((c[0].plus_product(c[1], u), c[2].plus_product(c[3], u)))
        rows = []
        for j in range(8):
            v = t.constant((j + 0.5) / 4 - 1)
            e = [builder.bitcast(p.plus_product(q, v).value, integers) for p, q in pairs]
            differ = builder.or_(builder.xor(e[0], e[1]), builder.xor(e[0], e[2]))
            rows.append(builder.icmp_signed(">=", differ, ir.Constant(integers, [0] * WIDTH)))
        return _packed(builder, rows)

    return i(i, i), codegen
