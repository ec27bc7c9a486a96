"""Arrays borrowed by address, so that kernels read many arrays of different owners without a copy.

A mesh's normals or a million transforms stay where the scene has them: a table holds one address per mesh, and kernels
index the pointer. Whoever makes such a table must keep the arrays alive (hierarchy.geometry.Geometry does).
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def address_of(array: np.ndarray | None) -> int:
    """Address of a C-contiguous array's first value; 0 for None or an empty array."""
    if array is None or array.size == 0:
        return 0
    if not array.flags.c_contiguous:
        raise ValueError("only contiguous arrays can be borrowed")
    return array.ctypes.data


def _pointer(value_type):
    @intrinsic
    def pointer(typingctx, address):
        if not isinstance(address, types.Integer):
            return None
        result = types.CPointer(value_type)

        def codegen(context, builder, signature, args):
            return builder.inttoptr(args[0], context.get_value_type(result))

        return result(address), codegen

    return pointer


pointer_f32 = _pointer(types.float32)  # kernel functions: an address -> a pointer that can be indexed, flat
pointer_f64 = _pointer(types.float64)
pointer_i32 = _pointer(types.int32)


def _loader(value_type, result_type):
    @intrinsic
    def load(typingctx, address, index):
        if not (isinstance(address, types.Integer) and isinstance(index, types.Integer)):
            return None

        def codegen(context, builder, signature, args):
            pointer = builder.inttoptr(args[0], context.get_value_type(types.CPointer(value_type)))
            value = builder.load(builder.gep(pointer, [args[1]]))
            return context.cast(builder, value, value_type, result_type)

        return result_type(address, types.int64), codegen

    return load


@intrinsic
def prefetch(typingctx, address):
    """Ask for the cache line of an address, which is not waited for and need not be valid."""
    if not isinstance(address, types.Integer):
        return None

    def codegen(context, builder, signature, args):
        return _prefetch(context, builder, args[0])

    return types.void(types.int64), codegen


def _prefetch(context, builder, address):
    byte, word = ir.IntType(8).as_pointer(), ir.IntType(32)
    type_ = ir.FunctionType(ir.VoidType(), [byte, word, word, word])
    function = cgutils.get_or_insert_function(builder.module, type_, "llvm.prefetch.p0")
    to_read, into_all_caches, data = (ir.Constant(word, k) for k in (0, 3, 1))
    builder.call(function, [builder.inttoptr(address, byte), to_read, into_all_caches, data])
    return context.get_dummy_value()


@intrinsic
def prefetch_row(typingctx, array, index):
    """As prefetch, for array[index]; index: int64, of the first axis."""
    if not (isinstance(array, types.Array) and isinstance(index, types.Integer)):
        return None

    def codegen(context, builder, signature, args):
        struct = context.make_array(signature.args[0])(context, builder, value=args[0])
        data = builder.ptrtoint(struct.data, ir.IntType(64))
        step = builder.extract_value(struct.strides, 0)
        address = builder.add(data, builder.mul(args[1], step))
        return _prefetch(context, builder, address)

    return types.void(array, types.int64), codegen


def _storer(value_type):
    @intrinsic
    def store(typingctx, address, index, value):
        if not (isinstance(address, types.Integer) and isinstance(index, types.Integer)):
            return None

        def codegen(context, builder, signature, args):
            pointer = builder.inttoptr(args[0], context.get_value_type(types.CPointer(value_type)))
            builder.store(args[2], builder.gep(pointer, [args[1]]))
            return context.get_dummy_value()

        return types.void(address, types.int64, value_type), codegen

    return store


# kernel functions: load_*(address, index) -> value; integers widen to int64 (unsigned ones to uint64)
load_u8 = _loader(types.uint8, types.int64)
load_i8 = _loader(types.int8, types.int64)
load_i32 = _loader(types.int32, types.int64)
load_i64 = _loader(types.int64, types.int64)
load_u64 = _loader(types.uint64, types.uint64)
load_u32 = _loader(types.uint32, types.uint32)
load_f32 = _loader(types.float32, types.float32)
load_f64 = _loader(types.float64, types.float64)
store_i32 = _storer(types.int32)  # store_*(address, index, value)
store_f32 = _storer(types.float32)
