"""Eight-wide box and triangle tests as LLVM vector code, which LLVM lowers to whatever the processor has.

Each is an intrinsic: one call inside a kernel, compiled to vector registers with a bit mask as its result. Written as
loops over eight lanes, the masks and the final choice did not vectorise.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

WIDTH = 8
NODE_FLOATS = 6 * WIDTH  # lower x, y, z and upper x, y, z of eight children
BLOCK_FLOATS = 9 * WIDTH  # three vertices, each x, y, z of eight triangles

_f32 = ir.FloatType()
_i64 = ir.IntType(64)
_vector = ir.VectorType(_f32, WIDTH)
_mask = ir.VectorType(ir.IntType(1), WIDTH)


def _data(context, builder, array_type, value):
    return cgutils.create_struct_proxy(array_type)(context, builder, value=value).data


def _at(builder, address):
    return builder.inttoptr(address, _f32.as_pointer())


def _load(builder, data, offset):
    pointer = builder.bitcast(builder.gep(data, [offset]), _vector.as_pointer())
    load = builder.load(pointer)
    load.align = 4
    return load


def _store(builder, value, data, offset):
    pointer = builder.bitcast(builder.gep(data, [offset]), _vector.as_pointer())
    builder.store(value, pointer).align = 4


def _splat(builder, scalar):
    one = builder.insert_element(ir.Constant(_vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(one, ir.Constant(_vector, ir.Undefined), lanes)


def _muladd(builder, a, b, c):
    signature = ir.FunctionType(_vector, [_vector] * 3)
    function = cgutils.get_or_insert_function(builder.module, signature, f"llvm.fmuladd.v{WIDTH}f32")
    return builder.call(function, [a, b, c])


def _larger(builder, a, b):
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def _smaller(builder, a, b):
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


def _bits(builder, mask):
    return builder.zext(builder.bitcast(mask, ir.IntType(WIDTH)), _i64)


@intrinsic
def trailing_zeros(typingctx, mask):
    """Index of the lowest set bit of a non-zero int64."""

    def codegen(context, builder, signature, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), codegen


@intrinsic
def minimum_into(typingctx, target, row, source, source_row):
    """target[row, :8] = min(target[row, :8], source[source_row, :8]) for float32 arrays with rows of eight."""

    def codegen(context, builder, signature, args):
        width = ir.Constant(_i64, WIDTH)
        into = _data(context, builder, signature.args[0], args[0])
        other = _data(context, builder, signature.args[2], args[2])
        at = builder.mul(args[1], width)
        a = _load(builder, into, at)
        b = _load(builder, other, builder.mul(args[3], width))
        _store(builder, _smaller(builder, a, b), into, at)
        return context.get_dummy_value()

    return types.void(target, types.int64, source, types.int64), codegen


@intrinsic
def slab_test(typingctx, boxes, node, near, scale, shift_near, shift_far, t_min, t_max, entry):
    """Boxes of a node's eight children against a ray: bit mask of those hit.

    boxes: address of float32, NODE_FLOATS per node; near: three int64, where in a node the planes lie that the ray
    meets first; scale: three float32, 1 / direction; shift_near, shift_far: three float32, minus the padded origin
    times scale. entry: address of eight float32, which become the distances at which the boxes are met.
    """
    three_i = types.UniTuple(types.int64, 3)
    three_f = types.UniTuple(types.float32, 3)
    f = types.float32

    def codegen(context, builder, signature, args):
        data = _at(builder, args[0])
        out = _at(builder, args[8])
        base = builder.mul(args[1], ir.Constant(_i64, NODE_FLOATS))
        enter, leave = _splat(builder, args[6]), _splat(builder, args[7])
        for axis in range(3):
            offset = builder.extract_value(args[2], axis)
            opposite = builder.sub(ir.Constant(_i64, (3 + 2 * axis) * WIDTH), offset)
            r = _splat(builder, builder.extract_value(args[3], axis))
            first = _load(builder, data, builder.add(base, offset))
            last = _load(builder, data, builder.add(base, opposite))
            t0 = _muladd(builder, first, r, _splat(builder, builder.extract_value(args[4], axis)))
            t1 = _muladd(builder, last, r, _splat(builder, builder.extract_value(args[5], axis)))
            enter = _larger(builder, t0, enter)
            leave = _smaller(builder, t1, leave)
        _store(builder, enter, out, ir.Constant(_i64, 0))
        return _bits(builder, builder.fcmp_ordered("<=", enter, leave))

    return types.int64(
        types.int64, types.int64, three_i, three_f, three_f, three_f, f, f, types.int64
    ), codegen


@intrinsic
def triangle_test(typingctx, blocks, block, axes, origin, shear, t_min, t_max, result):
    """Eight triangles against a ray (Woop, Benthin and Wald 2013): bits 0-7 hit, bits 8-15 met exactly at an edge.

    blocks: address of float32, BLOCK_FLOATS per block. axes: three int64, kx, ky, kz; origin in that order, shear
    (Sx, Sy, Sz). result: address of 24 float32: t in [0:8], weights of vertex 1 and 2 in [8:16] and [16:24]. A triangle
    that is met exactly at an edge counts as hit here; the caller decides it in double precision.
    """
    three_i = types.UniTuple(types.int64, 3)
    three_f = types.UniTuple(types.float32, 3)
    f = types.float32

    def codegen(context, builder, signature, args):
        data = _at(builder, args[0])
        out = _at(builder, args[7])
        base = builder.mul(args[1], ir.Constant(_i64, BLOCK_FLOATS))
        width = ir.Constant(_i64, WIDTH)
        at = [builder.add(base, builder.mul(builder.extract_value(args[2], k), width)) for k in range(3)]
        origin = [_splat(builder, builder.extract_value(args[3], k)) for k in range(3)]
        shear = [_splat(builder, builder.extract_value(args[4], k)) for k in range(3)]
        x, y, z = [], [], []
        for vertex in range(3):
            step = ir.Constant(_i64, vertex * 3 * WIDTH)
            p = [builder.fsub(_load(builder, data, builder.add(at[k], step)), origin[k]) for k in range(3)]
            # products and sums kept apart here: a fused edge function would not change sign exactly with its edge
            x.append(builder.fsub(p[0], builder.fmul(shear[0], p[2])))
            y.append(builder.fsub(p[1], builder.fmul(shear[1], p[2])))
            z.append(builder.fmul(shear[2], p[2]))
        edge = []
        for a, b in ((2, 1), (0, 2), (1, 0)):
            edge.append(builder.fsub(builder.fmul(x[a], y[b]), builder.fmul(y[a], x[b])))
        zero = ir.Constant(_vector, [0.0] * WIDTH)
        least = _smaller(builder, edge[0], _smaller(builder, edge[1], edge[2]))
        most = _larger(builder, edge[0], _larger(builder, edge[1], edge[2]))
        inside = builder.or_(builder.fcmp_ordered(">=", least, zero), builder.fcmp_ordered("<=", most, zero))
        det = builder.fadd(builder.fadd(edge[0], edge[1]), edge[2])
        depth = builder.fadd(
            builder.fadd(builder.fmul(edge[0], z[0]), builder.fmul(edge[1], z[1])),
            builder.fmul(edge[2], z[2]),
        )
        inverse = builder.fdiv(ir.Constant(_vector, [1.0] * WIDTH), det)
        t = builder.fmul(depth, inverse)
        within = builder.and_(
            builder.fcmp_ordered(">=", t, _splat(builder, args[5])),
            builder.fcmp_ordered("<=", t, _splat(builder, args[6])),
        )
        met = builder.or_(
            builder.fcmp_ordered("==", edge[0], zero),
            builder.or_(builder.fcmp_ordered("==", edge[1], zero), builder.fcmp_ordered("==", edge[2], zero)),
        )
        # a triangle seen exactly edge-on in single precision (det = 0) is left to the double precision test, too
        flat = builder.fcmp_ordered("==", det, zero)
        hit = builder.and_(inside, builder.or_(within, flat))
        _store(builder, t, out, ir.Constant(_i64, 0))
        _store(builder, builder.fmul(edge[1], inverse), out, ir.Constant(_i64, WIDTH))
        _store(builder, builder.fmul(edge[2], inverse), out, ir.Constant(_i64, 2 * WIDTH))
        exact = _bits(builder, builder.and_(hit, met))
        return builder.or_(_bits(builder, hit), builder.shl(exact, ir.Constant(_i64, 8)))

    return types.int64(types.int64, types.int64, three_i, three_f, three_f, f, f, types.int64), codegen
