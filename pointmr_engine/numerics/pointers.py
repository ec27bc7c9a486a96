"""Arrays borrowed by address, so that kernels read many arrays of different owners without a copy.

A mesh's normals or a million transforms stay where the scene has them: a table holds one address per mesh, and kernels
index the pointer. Whoever makes such a table must keep the arrays alive (hierarchy.geometry.Geometry does).
"""

from __future__ import annotations

import numpy as np
from numba import types
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
