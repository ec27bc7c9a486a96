"""Decorators of kernels that allocate nothing. LLVM merges each of them into its callers."""

from __future__ import annotations

from numba import njit

# forceinline: numba hands every array over as seven words, so a function that takes a NamedTuple of arrays and is not
# inlined costs hundreds of stores at each call, several times what most of them compute; LLVM, which sees only that
# they are long, leaves many of them apart. (numba's own inlining, before types are known, compiles many times slower.)
_KERNEL = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False, "forceinline": True}
_INNER = _KERNEL | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

# numba counts references to every array of a NamedTuple at each call that is not inlined, on counters that all threads
# share. Functions that only read and write arrays they were handed need no counting: small ones take half the time.
uncounted = njit(**_KERNEL)

# The same for functions that only kernels call: without entries from Python and C they also compile much faster.
device = njit(**_INNER)
