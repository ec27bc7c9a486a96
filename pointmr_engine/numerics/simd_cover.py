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
        limits = builder.inttoptr(args[7], _f32.as_pointer())
        drawn = builder.fcmp_ordered(
            "<", _load(builder, limits, ir.Constant(_i64, 0)), _splat(builder, args[8])
        )
        inside = builder.and_(_first(builder, args[3]), drawn)
        return _write(builder, args[0], args[1], args[2], inside, _ramp(builder, args[4], args[5]), args[6])

    return types.int64(types.uint64, types.uint64, i, i, f, f, i, types.uint64, f), codegen


@intrinsic
def cover_eight_within(
    typingctx, depth, ids, offset, shift, reach, nearness, slope, entry, threshold, opacity
):
    """As cover_eight, at those of eight subpixels k = 0 .. 7 with (shift + k)^2 <= reach (float32)."""
    f, i = types.float32, types.int64

    def codegen(context, builder, signature, args):
        limits = builder.inttoptr(args[8], _f32.as_pointer())
        drawn = builder.fcmp_ordered(
            "<", _load(builder, limits, ir.Constant(_i64, 0)), _splat(builder, args[9])
        )
        away = builder.fadd(ir.Constant(_vector, [float(k) for k in range(WIDTH)]), _splat(builder, args[3]))
        within = builder.fcmp_ordered("<=", builder.fmul(away, away), _splat(builder, args[4]))
        return _write(
            builder, args[0], args[1], args[2], builder.and_(within, drawn),
            _ramp(builder, args[5], args[6]), args[7],
        )  # fmt: skip

    return types.int64(types.uint64, types.uint64, i, f, f, f, f, i, types.uint64, f), codegen


@intrinsic
def cover_eight_between(
    typingctx, depth, ids, offset, centre, left, right, nearness, slope, least, most, entry
):
    """As cover_eight, at those of eight subpixels k = 0 .. 7 with left <= centre + k < right (float32).

    least, most: float32 bounds that nearness is kept between.
    """
    f, i = types.float32, types.int64

    def codegen(context, builder, signature, args):
        at = builder.fadd(ir.Constant(_vector, [float(k) for k in range(WIDTH)]), _splat(builder, args[3]))
        inside = builder.and_(
            builder.fcmp_ordered(">=", at, _splat(builder, args[4])),
            builder.fcmp_ordered("<", at, _splat(builder, args[5])),
        )
        value = _larger(builder, _ramp(builder, args[6], args[7]), _splat(builder, args[8]))
        value = _smaller(builder, value, _splat(builder, args[9]))
        return _write(builder, args[0], args[1], args[2], inside, value, args[10])

    return types.int64(types.uint64, types.uint64, i, f, f, f, f, f, f, f, i), codegen


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
