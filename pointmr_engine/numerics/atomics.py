"""Updates of memory that several threads share, in one step each."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


@intrinsic
def atomic_max_u64(typingctx, address, index, value):
    """Kernel function: the uint64 at address + 8 index becomes the larger of itself and value."""
    if not (isinstance(address, types.Integer) and isinstance(index, types.Integer)):
        return None

    def codegen(context, builder, signature, args):
        pointer = builder.inttoptr(args[0], ir.IntType(64).as_pointer())
        builder.atomic_rmw("umax", builder.gep(pointer, [args[1]]), args[2], "monotonic")
        return context.get_dummy_value()

    return types.void(address, types.int64, types.uint64), codegen
