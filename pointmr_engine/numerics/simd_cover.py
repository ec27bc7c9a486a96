"""Rows of subpixels against a depth buffer, eight at a time, as LLVM vector code (see numerics.simd)."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pointmr_engine.numerics.simd import WIDTH, _bits, _f32, _i64, _load, _muladd, _splat, _store, _vector

_i32 = ir.IntType(32)
_integers = ir.VectorType(_i32, WIDTH)


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
        depths = builder.inttoptr(args[0], _f32.as_pointer())
        numbers = builder.inttoptr(args[1], _i32.as_pointer())
        limits = builder.inttoptr(args[7], _f32.as_pointer())
        lane = ir.Constant(_vector, [float(k) for k in range(WIDTH)])
        new = _muladd(builder, lane, _splat(builder, args[5]), _splat(builder, args[4]))
        old = _load(builder, depths, args[2])
        count = builder.trunc(args[3], _i32)
        one = builder.insert_element(ir.Constant(_integers, ir.Undefined), count, ir.Constant(_i32, 0))
        zeros = ir.Constant(_integers, [0] * WIDTH)
        counts = builder.shuffle_vector(one, ir.Constant(_integers, ir.Undefined), zeros)
        inside = builder.icmp_signed("<", ir.Constant(_integers, list(range(WIDTH))), counts)
        drawn = builder.fcmp_ordered(
            "<", _load(builder, limits, ir.Constant(_i64, 0)), _splat(builder, args[8])
        )
        mask = builder.and_(builder.and_(inside, drawn), builder.fcmp_ordered(">", new, old))
        _store(builder, builder.select(mask, new, old), depths, args[2])
        pointer = builder.bitcast(builder.gep(numbers, [args[2]]), _integers.as_pointer())
        before = builder.load(pointer)
        before.align = 4
        number = builder.insert_element(
            ir.Constant(_integers, ir.Undefined), builder.trunc(args[6], _i32), ir.Constant(_i32, 0)
        )
        numbers8 = builder.shuffle_vector(number, ir.Constant(_integers, ir.Undefined), zeros)
        builder.store(builder.select(mask, numbers8, before), pointer).align = 4
        return _bits(builder, mask)

    return types.int64(types.uint64, types.uint64, i, i, f, f, i, types.uint64, f), codegen


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
