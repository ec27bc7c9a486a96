"""The decorator of functions that only kernels call: without entries from Python and C they compile much faster."""

from __future__ import annotations

from numba import njit

device = njit(cache=True, nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
