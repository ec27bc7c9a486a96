"""Rows of subpixels against a depth buffer, eight at a time, as LLVM vector code (see numerics.simd)."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pointmr_engine.numerics.simd import (
    WIDTH,
    _bits,
    _f32,
    _i64,
    _larger,
    _load,
    _muladd,
    _smaller,
    _splat,
    _store,
    _vector,
)  # fmt: skip

_i32 = ir.IntType(32)
_integers = ir.VectorType(_i32, WIDTH)


def _lanes_splat(builder, scalar):
    """An int64 as int32 in all lanes."""
    low = builder.trunc(scalar, _i32)
    one = builder.insert_element(ir.Constant(_integers, ir.Undefined), low, ir.Constant(_i32, 0))
    return builder.shuffle_vector(
        one, ir.Constant(_integers, ir.Undefined), ir.Constant(_integers, [0] * WIDTH)
    )


def _first(builder, count):
    """Mask of the first `count` lanes."""
    lanes = ir.Constant(_integers, list(range(WIDTH)))
    return builder.icmp_signed("<", lanes, _lanes_splat(builder, count))


def _ramp(builder, start, step):
    """start, start + step, start + 2 step ..."""
    lanes = ir.Constant(_vector, [float(k) for k in range(WIDTH)])
    return _muladd(builder, lanes, _splat(builder, step), _splat(builder, start))


def _eight_at(builder, address):
    """Eight float32 at an address."""
    return _load(builder, builder.inttoptr(address, _f32.as_pointer()), ir.Constant(_i64, 0))


def _write(builder, depth, ids, offset, inside, nearness, entry):
    """Write nearness and entry at eight subpixels where `inside` is set and they are nearer; mask of those written."""
    depths = builder.inttoptr(depth, _f32.as_pointer())
    numbers = builder.inttoptr(ids, _i32.as_pointer())
    old = _load(builder, depths, offset)
    mask = builder.and_(inside, builder.fcmp_ordered(">", nearness, old))
    bits = _bits(builder, mask)
    with builder.if_then(builder.icmp_unsigned("!=", bits, ir.Constant(_i64, 0))):
        _store(builder, builder.select(mask, nearness, old), depths, offset)
        pointer = builder.bitcast(builder.gep(numbers, [offset]), _integers.as_pointer())
        before = builder.load(pointer)
        before.align = 4
        builder.store(builder.select(mask, _lanes_splat(builder, entry), before), pointer).align = 4
    return bits


@intrinsic
def cover_eight(typingctx, depth, ids, offset, count, nearness, slope, entry, threshold, opacity):
    """Write `entry` to the subpixels that it is nearest in: up to eight of a row; returns the mask of those written.

    depth: address of float32 nearness (larger is nearer), ids: address of int32, both indexed from `offset`; eight
    values must be readable there, of which the first `count` may change. nearness, slope: float32, at the first one
    and its growth from one to the next. threshold: address of eight float32; only where they are below `opacity` is
    it drawn.
    """
    f, i = types.float32, types.int64

    def codegen(context, builder, signature, args):
        drawn = builder.fcmp_ordered("<", _eight_at(builder, args[7]), _splat(builder, args[8]))
        inside = builder.and_(_first(builder, args[3]), drawn)
        return _write(builder, args[0], args[1], args[2], inside, _ramp(builder, args[4], args[5]), args[6])

    return types.int64(types.uint64, types.uint64, i, i, f, f, i, types.uint64, f), codegen


@intrinsic
def cover_eight_within(
    typingctx, depth, ids, offset, shifts, x, y, lean, spread, inverse, plane, entry, threshold, opacity
):
    """As cover_eight, at those of eight subpixels that an ellipse holds: (x - lean y)^2 <= spread (1 - inverse y^2).

    shifts: address of eight float32, which are added to each one's y. x, y: of the first from the ellipse's middle,
    x growing by 1 from one to the next. plane: three float32, nearness in the middle and its growth along x and y.
    """
    f, i, u = types.float32, types.int64, types.uint64

    def codegen(context, builder, signature, args):
        drawn = builder.fcmp_ordered("<", _eight_at(builder, args[11]), _splat(builder, args[12]))
        at_x = _ramp(builder, args[4], ir.Constant(_f32, 1.0))
        at_y = builder.fadd(_eight_at(builder, args[3]), _splat(builder, args[5]))
        lean, spread, inverse = (_splat(builder, args[k]) for k in (6, 7, 8))
        away = builder.fsub(at_x, builder.fmul(lean, at_y))
        reach = builder.fsub(spread, builder.fmul(builder.fmul(spread, inverse), builder.fmul(at_y, at_y)))
        within = builder.fcmp_ordered("<=", builder.fmul(away, away), reach)
        nearness, along, up = (_splat(builder, builder.extract_value(args[9], k)) for k in range(3))
        nearness = _muladd(builder, up, at_y, _muladd(builder, along, at_x, nearness))
        return _write(builder, args[0], args[1], args[2], builder.and_(within, drawn), nearness, args[10])

    return i(u, u, i, u, f, f, f, f, f, types.UniTuple(f, 3), i, u, f), codegen


@intrinsic
def cover_eight_between(typingctx, depth, ids, offset, shifts, x, y, corners, edges, plane, bounds, entry):
    """As cover_eight, at those of eight subpixels that a triangle holds (float32 all).

    shifts: address of eight float32, which are added to each one's y. x, y: of the first, x growing by 1 from one to
    the next. corners: y of the lowest, the middle and the highest one, a <= y < c being inside. edges: (x at y, its
    growth along y) of a to c, of a to b, which counts below b, and of b to c, which counts from there on; inside is
    what lies right of one, or on it, and left of the other. plane: nearness of the first at y, its growth along x and
    along y; bounds: what it is kept between.
    """
    f, i, u = types.float32, types.int64, types.uint64

    def codegen(context, builder, signature, args):
        def part(k, n):
            return _splat(builder, builder.extract_value(args[k], n))

        shift = _eight_at(builder, args[3])
        at_x = _ramp(builder, args[4], ir.Constant(_f32, 1.0))
        at_y = builder.fadd(shift, _splat(builder, args[5]))
        whole, lower, upper = (_muladd(builder, shift, part(7, k + 1), part(7, k)) for k in (0, 2, 4))
        other = builder.select(builder.fcmp_ordered("<", at_y, part(6, 1)), lower, upper)
        inside = builder.fcmp_ordered(">=", at_x, _smaller(builder, whole, other))
        for test in (
            builder.fcmp_ordered("<", at_x, _larger(builder, whole, other)),
            builder.fcmp_ordered(">=", at_y, part(6, 0)),
            builder.fcmp_ordered("<", at_y, part(6, 2)),
        ):
            inside = builder.and_(inside, test)
        nearness = _ramp(builder, builder.extract_value(args[8], 0), builder.extract_value(args[8], 1))
        nearness = _larger(builder, _muladd(builder, shift, part(8, 2), nearness), part(9, 0))
        nearness = _smaller(builder, nearness, part(9, 1))
        return _write(builder, args[0], args[1], args[2], inside, nearness, args[10])

    three = types.UniTuple(f, 3)
    return i(u, u, i, u, f, f, three, types.UniTuple(f, 6), three, types.UniTuple(f, 2), i), codegen


@intrinsic
def is_open(typingctx, depth, offset, stride, rows, count, nearness):
    """Whether any of rows x count values is at most `nearness`: 1 or 0.

    depth: address of float32; offset: of the first value; stride: from a row to the next; count: up to eight, but eight
    must be readable.
    """
    f, i = types.float32, types.int64

    def codegen(context, builder, signature, args):
        depths = builder.inttoptr(args[0], _f32.as_pointer())
        inside, limit = _first(builder, args[4]), _splat(builder, args[5])
        end = builder.add(args[1], builder.mul(args[2], args[3]))
        start = builder.block
        loop, done = builder.append_basic_block("row"), builder.append_basic_block("done")
        builder.branch(loop)
        builder.position_at_end(loop)
        at = builder.phi(_i64)
        at.add_incoming(args[1], start)
        mask = builder.and_(inside, builder.fcmp_ordered("<=", _load(builder, depths, at), limit))
        found = builder.icmp_unsigned("!=", _bits(builder, mask), ir.Constant(_i64, 0))
        following = builder.add(at, args[2])
        at.add_incoming(following, loop)
        over = builder.icmp_signed(">=", following, end)
        builder.cbranch(builder.or_(found, over), done, loop)
        builder.position_at_end(done)
        return builder.zext(found, _i64)

    return i(types.uint64, i, i, i, i, f), codegen


@intrinsic
def is_open_in_eight(typingctx, depth, offset, stride, rows, count, nearness):
    """As is_open for up to eight rows, all of which are looked at: without branches, which small shapes mispredict."""
    f, i = types.float32, types.int64

    def codegen(context, builder, signature, args):
        depths = builder.inttoptr(args[0], _f32.as_pointer())
        at, least = args[1], None
        for row in range(WIDTH):
            values = _load(builder, depths, at)
            least = values if least is None else _smaller(builder, values, least)
            more = builder.icmp_signed("<", ir.Constant(_i64, row + 1), args[3])
            at = builder.select(more, builder.add(at, args[2]), at)
        mask = builder.and_(
            _first(builder, args[4]), builder.fcmp_ordered("<=", least, _splat(builder, args[5]))
        )
        return builder.zext(builder.icmp_unsigned("!=", _bits(builder, mask), ir.Constant(_i64, 0)), _i64)

    return i(types.uint64, i, i, i, i, f), codegen


@intrinsic
def count_open(typingctx, depth, offset, stride, rows, count, nearness):
    """How many of rows x count values are at most `nearness`; arguments as for is_open."""
    f, i = types.float32, types.int64

    def codegen(context, builder, signature, args):
        depths = builder.inttoptr(args[0], _f32.as_pointer())
        inside, limit = _first(builder, args[4]), _splat(builder, args[5])
        end = builder.add(args[1], builder.mul(args[2], args[3]))
        start = builder.block
        loop, done = builder.append_basic_block("row"), builder.append_basic_block("done")
        builder.branch(loop)
        builder.position_at_end(loop)
        at, total = builder.phi(_i64), builder.phi(_i64)
        at.add_incoming(args[1], start)
        total.add_incoming(ir.Constant(_i64, 0), start)
        mask = builder.and_(inside, builder.fcmp_ordered("<=", _load(builder, depths, at), limit))
        summed = builder.add(total, builder.ctpop(_bits(builder, mask)))
        following = builder.add(at, args[2])
        at.add_incoming(following, loop)
        total.add_incoming(summed, loop)
        builder.cbranch(builder.icmp_signed(">=", following, end), done, loop)
        builder.position_at_end(done)
        return summed

    return i(types.uint64, i, i, i, i, f), codegen


@intrinsic
def farthest_row(typingctx, depth, offset, count, far):
    """min(far, depth[offset : offset + count]) for count a multiple of eight; depth: address of float32."""
    f, i = types.float32, types.int64

    def codegen(context, builder, signature, args):
        depths = builder.inttoptr(args[0], _f32.as_pointer())
        start = builder.block
        loop, done = builder.append_basic_block("row"), builder.append_basic_block("done")
        least = _splat(builder, args[3])
        builder.branch(loop)
        builder.position_at_end(loop)
        at = builder.phi(_i64)
        value = builder.phi(_vector)
        at.add_incoming(ir.Constant(_i64, 0), start)
        value.add_incoming(least, start)
        row = _load(builder, depths, builder.add(args[1], at))
        smaller = builder.select(builder.fcmp_ordered("<", row, value), row, value)
        following = builder.add(at, ir.Constant(_i64, WIDTH))
        at.add_incoming(following, loop)
        value.add_incoming(smaller, loop)
        builder.cbranch(builder.icmp_signed("<", following, args[2]), loop, done)
        builder.position_at_end(done)
        result = args[3]
        for k in range(WIDTH):
            lane = builder.extract_element(smaller, ir.Constant(_i32, k))
            result = builder.select(builder.fcmp_ordered("<", lane, result), lane, result)
        return result

    return f(types.uint64, i, i, f), codegen
