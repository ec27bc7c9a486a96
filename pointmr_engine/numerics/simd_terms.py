"""Arithmetic on eight float32 at a time, written as formulas: terms build LLVM vector code when they are combined."""

from __future__ import annotations

from llvmlite import ir
from numba.core import cgutils

from pointmr_engine.numerics.simd import WIDTH, _f32, _i64, _vector

_i32 = ir.IntType(32)


class Terms:
    """Makes terms for one builder."""

    def __init__(self, builder):
        self.builder = builder

    def constant(self, value: float) -> Term:
        return Term(self.builder, ir.Constant(_vector, [value] * WIDTH))

    def splat(self, scalar) -> Term:
        """One float32 in all lanes."""
        b = self.builder
        one = b.insert_element(ir.Constant(_vector, ir.Undefined), scalar, ir.Constant(_i32, 0))
        zeros = ir.Constant(ir.VectorType(_i32, WIDTH), [0] * WIDTH)
        return Term(b, b.shuffle_vector(one, ir.Constant(_vector, ir.Undefined), zeros))

    def pointer(self, address):
        return self.builder.inttoptr(address, _f32.as_pointer())

    def broadcast(self, pointer, index: int) -> Term:
        """pointer[index] in all lanes."""
        return self.splat(self.builder.load(self.builder.gep(pointer, [ir.Constant(_i64, index)])))

    def gather(self, pointer, first, stride: int, column: int) -> Term:
        """pointer[(first + lane) * stride + column] in each lane."""
        b = self.builder
        start = b.add(b.mul(first, ir.Constant(_i64, stride)), ir.Constant(_i64, column))
        value = ir.Constant(_vector, ir.Undefined)
        for lane in range(WIDTH):
            at = b.gep(pointer, [b.add(start, ir.Constant(_i64, lane * stride))])
            value = b.insert_element(value, b.load(at), ir.Constant(_i32, lane))
        return Term(b, value)

    def store(self, term: Term, pointer, row: int) -> None:
        """pointer[8 * row + lane] = term."""
        b = self.builder
        at = b.bitcast(b.gep(pointer, [ir.Constant(_i64, row * WIDTH)]), _vector.as_pointer())
        b.store(term.value, at).align = 4

    def bits(self, mask):
        """The mask as an int64, lane 0 in the lowest bit."""
        return self.builder.zext(self.builder.bitcast(mask, ir.IntType(WIDTH)), _i64)


class Term:
    """A vector of eight float32, and what can be done with it; comparisons give masks."""

    def __init__(self, builder, value):
        self.builder, self.value = builder, value

    def _make(self, value) -> Term:
        return Term(self.builder, value)

    def _other(self, other):
        return other.value if isinstance(other, Term) else ir.Constant(_vector, [float(other)] * WIDTH)

    def __add__(self, other):
        return self._make(self.builder.fadd(self.value, self._other(other)))

    def __sub__(self, other):
        return self._make(self.builder.fsub(self.value, self._other(other)))

    def __mul__(self, other):
        return self._make(self.builder.fmul(self.value, self._other(other)))

    def __truediv__(self, other):
        return self._make(self.builder.fdiv(self.value, self._other(other)))

    def plus_product(self, a: Term, b: Term) -> Term:
        """self + a * b, fused where the processor can."""
        signature = ir.FunctionType(_vector, [_vector] * 3)
        name = f"llvm.fmuladd.v{WIDTH}f32"
        function = cgutils.get_or_insert_function(self.builder.module, signature, name)
        return self._make(self.builder.call(function, [a.value, b.value, self.value]))

    def _unary(self, name: str) -> Term:
        signature = ir.FunctionType(_vector, [_vector])
        function = cgutils.get_or_insert_function(self.builder.module, signature, f"llvm.{name}.v{WIDTH}f32")
        return self._make(self.builder.call(function, [self.value]))

    def sqrt(self) -> Term:
        return self._unary("sqrt")

    def abs(self) -> Term:
        return self._unary("fabs")

    def at_least(self, low) -> Term:
        """max(self, low); low where self is not a number."""
        low = self._other(low)
        return self._make(
            self.builder.select(self.builder.fcmp_ordered(">", self.value, low), self.value, low)
        )

    def at_most(self, high) -> Term:
        """min(self, high); high where self is not a number."""
        high = self._other(high)
        return self._make(
            self.builder.select(self.builder.fcmp_ordered("<", self.value, high), self.value, high)
        )

    def __gt__(self, other):
        return self.builder.fcmp_ordered(">", self.value, self._other(other))

    def __lt__(self, other):
        return self.builder.fcmp_ordered("<", self.value, self._other(other))

    def where(self, mask, other) -> Term:
        """self where the mask is set, other elsewhere."""
        return self._make(self.builder.select(mask, self.value, self._other(other)))
