"""The list of cases, and how functions become some."""

from __future__ import annotations

from node_planes import Case, Tree

EXACT = 2e-5  # of float32 arithmetic in another order
LOOSE = 2e-3
CASES: dict[str, tuple[Case, float]] = {}


def case(name: str, tolerance: float = EXACT):
    """Register a function over a Tree as a case."""

    def register(function: Case) -> Case:
        CASES[name] = (function, tolerance)
        return function

    return register


def offset(t: Tree, socket, scale: float = 0.2, shift: float = 0.5):
    """scale * vector + shift, so that signed values can be seen."""
    node = t.node("VectorMath", {0: socket, 1: (scale,) * 3, 2: (shift,) * 3}, operation="MULTIPLY_ADD")
    return node.outputs[0]
