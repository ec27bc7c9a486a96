"""Math, Clamp and Map Range on floats."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading.nodes.registry import FLOAT, Call, node
from pointmr_engine.shading.values import divide, saturate


def _power(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a ** b; 0 where a root of a negative number is asked for."""
    result = np.power(np.abs(a), b)
    odd = np.fmod(b, 2) != 0
    result = np.where((a < 0) & odd, -result, result)
    result = np.where((a < 0) & (b != np.trunc(b)), 0, result)
    result = np.where(a == 0, 0, result)
    return np.where(b == 0, 1, result)


def _logarithm(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    bad = (a <= 0) | (b <= 0)
    return np.where(bad, 0, divide(np.log(np.where(bad, 1, a)), np.log(np.where(bad, 2, b))))


def wrap(a: np.ndarray, high: np.ndarray, low: np.ndarray) -> np.ndarray:
    """a brought into low..high by whole ranges; low where the range is empty."""
    span = high - low
    return np.where(span != 0, a - span * np.floor(divide(a - low, span)), low)


def _pingpong(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    t = divide(a - b, b * 2)
    return np.where(b != 0, np.abs((t - np.floor(t)) * b * 2 - b), 0)


def _smooth_min(a: np.ndarray, b: np.ndarray, k: np.ndarray) -> np.ndarray:
    h = divide(np.maximum(k - np.abs(a - b), 0), k)
    return np.minimum(a, b) - h * h * h * k / 6


def _sign(a: np.ndarray) -> np.ndarray:
    return np.where(a == 0, 0, np.where(a < 0, -1, 1))


EPSILON = np.finfo(np.float32).eps
OPERATIONS = {
    "ADD": lambda a, b, c: a + b,
    "SUBTRACT": lambda a, b, c: a - b,
    "MULTIPLY": lambda a, b, c: a * b,
    "DIVIDE": lambda a, b, c: divide(a, b),
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "POWER": lambda a, b, c: _power(a, b),
    "LOGARITHM": lambda a, b, c: _logarithm(a, b),
    "SQRT": lambda a, b, c: np.sqrt(np.maximum(a, 0)),
    "INVERSE_SQRT": lambda a, b, c: np.where(a > 0, 1 / np.sqrt(np.where(a > 0, a, 1)), 0),
    "ABSOLUTE": lambda a, b, c: np.abs(a),
    "EXPONENT": lambda a, b, c: np.exp(a),
    "MINIMUM": lambda a, b, c: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c: np.maximum(a, b),
    "LESS_THAN": lambda a, b, c: a < b,
    "GREATER_THAN": lambda a, b, c: a > b,
    "SIGN": lambda a, b, c: _sign(a),
    "COMPARE": lambda a, b, c: (a == b) | (np.abs(a - b) <= np.maximum(c, EPSILON)),
    "SMOOTH_MIN": lambda a, b, c: _smooth_min(a, b, c),
    "SMOOTH_MAX": lambda a, b, c: -_smooth_min(-a, -b, c),
    "ROUND": lambda a, b, c: np.floor(a + np.float32(0.5)),
    "FLOOR": lambda a, b, c: np.floor(a),
    "CEIL": lambda a, b, c: np.ceil(a),
    "TRUNC": lambda a, b, c: np.trunc(a),
    "FRACT": lambda a, b, c: a - np.floor(a),
    "MODULO": lambda a, b, c: np.where(b != 0, np.fmod(a, np.where(b != 0, b, 1)), 0),
    "FLOORED_MODULO": lambda a, b, c: np.where(b != 0, a - np.floor(divide(a, b)) * b, 0),
    "WRAP": lambda a, b, c: wrap(a, b, c),
    "SNAP": lambda a, b, c: np.floor(divide(a, b)) * b,
    "PINGPONG": lambda a, b, c: _pingpong(a, b),
    "SINE": lambda a, b, c: np.sin(a),
    "COSINE": lambda a, b, c: np.cos(a),
    "TANGENT": lambda a, b, c: np.tan(a),
    "ARCSINE": lambda a, b, c: np.arcsin(np.clip(a, -1, 1)),
    "ARCCOSINE": lambda a, b, c: np.arccos(np.clip(a, -1, 1)),
    "ARCTANGENT": lambda a, b, c: np.arctan(a),
    "ARCTAN2": lambda a, b, c: np.where((a == 0) & (b == 0), 0, np.arctan2(a, b)),
    "SINH": lambda a, b, c: np.sinh(a),
    "COSH": lambda a, b, c: np.cosh(a),
    "TANH": lambda a, b, c: np.tanh(a),
    "RADIANS": lambda a, b, c: np.radians(a),
    "DEGREES": lambda a, b, c: np.degrees(a),
}


# what makes stripes and steps of coordinates
STEPS = frozenset(
    ("LESS_THAN", "GREATER_THAN", "SIGN", "COMPARE", "ROUND", "FLOOR", "CEIL", "TRUNC", "FRACT", "FRACTION", "MODULO",
     "FLOORED_MODULO", "WRAP", "SNAP", "PINGPONG")
)  # fmt: skip


@node(
    "math",
    {"value": (FLOAT, 0.5), "value_b": (FLOAT, 0.5), "value_c": (FLOAT, 0.5)},
    {"value": FLOAT},
    stepped=lambda params: params.get("operation") in STEPS,
)
def _math(c: Call) -> np.ndarray:
    """params: operation as Blender names it, clamp."""
    operation = OPERATIONS.get(c.params.get("operation", "ADD"), OPERATIONS["ADD"])
    result = operation(c["value"], c["value_b"], c["value_c"])
    return saturate(result) if c.params.get("clamp") else result


@node("clamp", {"value": (FLOAT, 1.0), "min": (FLOAT, 0.0), "max": (FLOAT, 1.0)}, {"value": FLOAT})
def _clamp(c: Call) -> np.ndarray:
    """params: type "MINMAX" or "RANGE" (which swaps its limits where they are reversed)."""
    low, high = c["min"], c["max"]
    if c.params.get("type") == "RANGE":
        low, high = np.minimum(low, high), np.maximum(low, high)
    return np.minimum(np.maximum(c["value"], low), high)


def remap(kind: str, t: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """A factor 0..1 shaped by an interpolation type of Map Range."""
    if kind == "STEPPED":
        return np.where(steps > 0, divide(np.floor(t * (steps + 1)), steps), 0)
    if kind == "SMOOTHSTEP":
        t = saturate(t)
        return (3 - 2 * t) * t * t
    if kind == "SMOOTHERSTEP":
        t = saturate(t)
        return t * t * t * (t * (t * 6 - 15) + 10)
    return t


@node(
    "map_range",
    {
        "value": (FLOAT, 1.0),
        "from_min": (FLOAT, 0.0),
        "from_max": (FLOAT, 1.0),
        "to_min": (FLOAT, 0.0),
        "to_max": (FLOAT, 1.0),
        "steps": (FLOAT, 4.0),
    },
    {"value": FLOAT},
    stepped=lambda params: params.get("interpolation") == "STEPPED",
)
def _map_range(c: Call) -> np.ndarray:
    """params: interpolation "LINEAR", "STEPPED", "SMOOTHSTEP", "SMOOTHERSTEP"; clamp."""
    kind = c.params.get("interpolation", "LINEAR")
    span = c["from_max"] - c["from_min"]
    low, high = c["to_min"], c["to_max"]
    t = remap(kind, divide(c["value"] - c["from_min"], span), c["steps"])
    result = np.where(span != 0, low + t * (high - low), 0)
    if c.params.get("clamp") and kind in ("LINEAR", "STEPPED"):
        result = np.clip(result, np.minimum(low, high), np.maximum(low, high))
    return result
