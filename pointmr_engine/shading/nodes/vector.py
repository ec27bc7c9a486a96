"""Vector Math, Mapping, Vector Rotate, Vector Transform and Vector Map Range."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.transforms import inverse_linear
from pointmr_engine.shading.nodes.math import STEPS, _power, _sign, remap, wrap
from pointmr_engine.shading.nodes.registry import FLOAT, VECTOR, Call, From, node
from pointmr_engine.shading.values import (
    cross,
    divide,
    dot,
    length,
    normalize,
    rotate_around,
    rotation_from_euler,
    transform_direction,
    transform_point,
    transform_transposed,
)


def _project(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return divide(dot(a, b), dot(b, b))[:, None] * b


def _refract(a: np.ndarray, n: np.ndarray, eta: np.ndarray) -> np.ndarray:
    cosine = dot(n, a)
    k = 1 - eta * eta * (1 - cosine * cosine)
    bent = eta[:, None] * a - (eta * cosine + np.sqrt(np.maximum(k, 0)))[:, None] * n
    return np.where((k < 0)[:, None], 0, bent)


def _reflect(a: np.ndarray, n: np.ndarray) -> np.ndarray:
    return a - 2 * dot(a, n)[:, None] * n


TO_VECTOR = {
    "ADD": lambda a, b, c, s: a + b,
    "SUBTRACT": lambda a, b, c, s: a - b,
    "MULTIPLY": lambda a, b, c, s: a * b,
    "DIVIDE": lambda a, b, c, s: divide(a, b),
    "MULTIPLY_ADD": lambda a, b, c, s: a * b + c,
    "CROSS_PRODUCT": lambda a, b, c, s: cross(a, b),
    "PROJECT": lambda a, b, c, s: _project(a, b),
    "REFLECT": lambda a, b, c, s: _reflect(a, normalize(b)),
    "REFRACT": lambda a, b, c, s: _refract(a, normalize(b), s),
    "FACEFORWARD": lambda a, b, c, s: np.where((dot(c, b) < 0)[:, None], a, -a),
    "SCALE": lambda a, b, c, s: a * s[:, None],
    "NORMALIZE": lambda a, b, c, s: normalize(a),
    "ABSOLUTE": lambda a, b, c, s: np.abs(a),
    "POWER": lambda a, b, c, s: _power(a, b),
    "SIGN": lambda a, b, c, s: _sign(a),
    "MINIMUM": lambda a, b, c, s: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c, s: np.maximum(a, b),
    "FLOOR": lambda a, b, c, s: np.floor(a),
    "CEIL": lambda a, b, c, s: np.ceil(a),
    "FRACTION": lambda a, b, c, s: a - np.floor(a),
    "MODULO": lambda a, b, c, s: np.where(b != 0, np.fmod(a, np.where(b != 0, b, 1)), 0),
    "WRAP": lambda a, b, c, s: wrap(a, b, c),
    "SNAP": lambda a, b, c, s: np.floor(divide(a, b)) * b,
    "SINE": lambda a, b, c, s: np.sin(a),
    "COSINE": lambda a, b, c, s: np.cos(a),
    "TANGENT": lambda a, b, c, s: np.tan(a),
}
TO_VALUE = {
    "DOT_PRODUCT": lambda a, b: dot(a, b),
    "DISTANCE": lambda a, b: length(a - b),
    "LENGTH": lambda a, b: length(a),
}


@node(
    "vector_math",
    {"vector": (VECTOR, 0.0), "vector_b": (VECTOR, 0.0), "vector_c": (VECTOR, 0.0), "scale": (FLOAT, 1.0)},
    {"vector": VECTOR, "value": FLOAT},
    stepped=lambda params: params.get("operation") in STEPS,
)
def _vector_math(c: Call) -> dict[str, np.ndarray]:
    """params: operation as Blender names it."""
    operation = c.params.get("operation", "ADD")
    a, b = c["vector"], c["vector_b"]
    if operation in TO_VALUE:
        return {"value": TO_VALUE[operation](a, b), "vector": np.zeros((1, 3), np.float32)}
    function = TO_VECTOR.get(operation, TO_VECTOR["ADD"])
    return {"vector": function(a, b, c["vector_c"], c["scale"]), "value": np.zeros(1, np.float32)}


@node(
    "mapping",
    {
        "vector": (VECTOR, 0.0),
        "location": (VECTOR, 0.0),
        "rotation": (VECTOR, 0.0),
        "scale": (VECTOR, 1.0),
    },
    {"vector": VECTOR},
)
def _mapping(c: Call) -> np.ndarray:
    """params: type "POINT", "TEXTURE", "VECTOR" or "NORMAL"."""
    kind = c.params.get("type", "POINT")
    v, scale = c["vector"], c["scale"]
    m = rotation_from_euler(c["rotation"])
    if kind == "TEXTURE":
        return divide(transform_transposed(m, v - c["location"]), scale)
    if kind == "NORMAL":
        return normalize(transform_direction(m, divide(v, scale)))
    turned = transform_direction(m, v * scale)
    return turned if kind == "VECTOR" else turned + c["location"]


@node(
    "vector_rotate",
    {
        "vector": (VECTOR, 0.0),
        "center": (VECTOR, 0.0),
        "axis": (VECTOR, (0.0, 0.0, 1.0)),
        "angle": (FLOAT, 0.0),
        "rotation": (VECTOR, 0.0),
    },
    {"vector": VECTOR},
)
def _vector_rotate(c: Call) -> np.ndarray:
    """params: type "AXIS_ANGLE", "X_AXIS", "Y_AXIS", "Z_AXIS" or "EULER_XYZ"; invert."""
    kind = c.params.get("type", "AXIS_ANGLE")
    invert = c.params.get("invert", False)
    v = c["vector"] - c["center"]
    if kind == "EULER_XYZ":
        m = rotation_from_euler(c["rotation"])
        return (transform_transposed(m, v) if invert else transform_direction(m, v)) + c["center"]
    axis = c["axis"]
    if kind != "AXIS_ANGLE":
        axis = np.array([[kind == "X_AXIS", kind == "Y_AXIS", kind == "Z_AXIS"]], np.float32)
    angle = -c["angle"] if invert else c["angle"]
    turned = rotate_around(v, normalize(axis), angle) + c["center"]
    return np.where((length(axis) == 0)[:, None], c["vector"], turned)


def _transform_reads(params: dict, wanted: frozenset[str]) -> list[str]:
    spaces = {params.get("from", "WORLD"), params.get("to", "OBJECT")}
    if len(spaces) == 1:
        return []
    return ["world_from_part"] * ("OBJECT" in spaces) + ["camera_from_world"] * ("CAMERA" in spaces)


def _inverse(m: np.ndarray) -> np.ndarray:
    linear = inverse_linear(m)
    return np.concatenate([linear, -np.einsum("...ij,...j->...i", linear, m[..., 3])[..., None]], -1)


@node("vector_transform", {"vector": (VECTOR, 0.5)}, {"vector": VECTOR}, reads=_transform_reads)
def _vector_transform(c: Call) -> np.ndarray:
    """params: type "POINT", "VECTOR" or "NORMAL"; from and to "WORLD", "OBJECT" or "CAMERA"."""
    kind = c.params.get("type", "VECTOR")
    source, target = c.params.get("from", "WORLD"), c.params.get("to", "OBJECT")
    v = c["vector"]
    if source == target:
        return v
    p = c.points
    if source == "OBJECT" and p.world_from_part is not None:
        v = _apply(kind, p.world_from_part, v)
    elif source == "CAMERA":
        v = _apply(kind, _inverse(p.camera_from_world), v)
    if target == "OBJECT" and p.world_from_part is not None:
        v = _apply(kind, _inverse(p.world_from_part), v)
    elif target == "CAMERA":
        v = _apply(kind, p.camera_from_world, v)
    return v.astype(np.float32)


def _apply(kind: str, m: np.ndarray, v: np.ndarray) -> np.ndarray:
    if kind == "POINT":
        return transform_point(m, v)
    if kind == "VECTOR":
        return transform_direction(m, v)
    return normalize(transform_transposed(inverse_linear(m), v))


@node("identity_vector", {"vector": (VECTOR, From("normal"))}, {"vector": VECTOR})
def _identity(c: Call) -> np.ndarray:
    return c["vector"]


@node(
    "vector_map_range",
    {
        "vector": (VECTOR, 0.0),
        "from_min": (VECTOR, 0.0),
        "from_max": (VECTOR, 1.0),
        "to_min": (VECTOR, 0.0),
        "to_max": (VECTOR, 1.0),
        "steps": (VECTOR, 4.0),
    },
    {"vector": VECTOR},
)
def _vector_map_range(c: Call) -> np.ndarray:
    """params: interpolation and clamp as map_range."""
    kind = c.params.get("interpolation", "LINEAR")
    low, high = c["to_min"], c["to_max"]
    t = remap(kind, divide(c["vector"] - c["from_min"], c["from_max"] - c["from_min"]), c["steps"])
    result = low + t * (high - low)
    if c.params.get("clamp") and kind in ("LINEAR", "STEPPED"):
        result = np.clip(result, np.minimum(low, high), np.maximum(low, high))
    return result
