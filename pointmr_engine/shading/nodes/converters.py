"""Implicit conversions, and nodes that take values apart or put them together."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading.kernels.hsv import fill_hsl, fill_hsv, fill_rgb
from pointmr_engine.shading.nodes.registry import COLOR, FLOAT, VECTOR, Call, node
from pointmr_engine.shading.values import luminance, stack


@node("convert:color_to_float", {"value": (COLOR, 0.0)}, {"value": FLOAT})
@node("rgb_to_bw", {"color": (COLOR, 0.5)}, {"value": FLOAT})
def _color_to_float(c: Call) -> np.ndarray:
    (color,) = c.inputs.values()
    return luminance(color)


@node("convert:vector_to_float", {"value": (VECTOR, 0.0)}, {"value": FLOAT})
def _vector_to_float(c: Call) -> np.ndarray:
    v = c["value"]
    return (v[:, 0] + v[:, 1] + v[:, 2]) * np.float32(1 / 3)


@node("convert:float_to_vector", {"value": (FLOAT, 0.0)}, {"value": VECTOR})
@node("convert:float_to_color", {"value": (FLOAT, 0.0)}, {"value": COLOR})
def _float_to_vector(c: Call) -> np.ndarray:
    return np.repeat(c["value"][:, None], 3, axis=1)


@node("separate_xyz", {"vector": (VECTOR, 0.0)}, {"x": FLOAT, "y": FLOAT, "z": FLOAT})
def _separate_xyz(c: Call) -> dict[str, np.ndarray]:
    v = c["vector"]
    return {"x": v[:, 0], "y": v[:, 1], "z": v[:, 2]}


@node("combine_xyz", {"x": (FLOAT, 0.0), "y": (FLOAT, 0.0), "z": (FLOAT, 0.0)}, {"vector": VECTOR})
def _combine_xyz(c: Call) -> np.ndarray:
    return stack(c["x"], c["y"], c["z"])


@node("value", {"value": (FLOAT, 0.0)}, {"value": FLOAT})
@node("rgb", {"color": (COLOR, 0.5)}, {"color": COLOR})
def _same(c: Call) -> np.ndarray:
    (value,) = c.inputs.values()
    return value


def _filled(kernel, colors: np.ndarray) -> np.ndarray:
    """(n, 3) float32 that a kernel of kernels.hsv makes of (n, 3) colours."""
    out = np.empty((len(colors), 3), np.float32)
    kernel(np.ascontiguousarray(colors, np.float32), out)
    return out


def rgb_to_hsv(rgb: np.ndarray) -> np.ndarray:
    """Hue 0..1, saturation and value of (n, 3) colours."""
    return _filled(fill_hsv, rgb)


def rgb_to_hsl(rgb: np.ndarray) -> np.ndarray:
    """Hue 0..1, saturation and lightness of (n, 3) colours."""
    return _filled(fill_hsl, rgb)


def hsv_to_rgb(hsv: np.ndarray) -> np.ndarray:
    """(n, 3) colours from hue 0..1 (1 is 0 again), saturation and value."""
    return _filled(fill_rgb, hsv)


def hsl_to_rgb(hsl: np.ndarray) -> np.ndarray:
    """(n, 3) colours from hue 0..1, saturation and lightness."""
    h, s, lightness = hsl[:, 0], hsl[:, 1], hsl[:, 2]
    base = np.abs(h[:, None] * 6 - np.array([3, 2, 4], np.float32))
    base = np.clip(np.array([-1, 2, 2], np.float32) + base * np.array([1, -1, -1], np.float32), 0, 1)
    chroma = ((1 - np.abs(2 * lightness - 1)) * s)[:, None]
    return (base - 0.5) * chroma + lightness[:, None]


_RGB = {"red": FLOAT, "green": FLOAT, "blue": FLOAT}


@node("separate_color", {"color": (COLOR, 0.8)}, _RGB)
def _separate_color(c: Call) -> dict[str, np.ndarray]:
    """params: mode "RGB", "HSV" or "HSL"."""
    mode = c.params.get("mode", "RGB")
    v = c["color"]
    v = rgb_to_hsv(v) if mode == "HSV" else rgb_to_hsl(v) if mode == "HSL" else v
    return {"red": v[:, 0], "green": v[:, 1], "blue": v[:, 2]}


@node("combine_color", {"red": (FLOAT, 0.0), "green": (FLOAT, 0.0), "blue": (FLOAT, 0.0)}, {"color": COLOR})
def _combine_color(c: Call) -> np.ndarray:
    """params: mode "RGB", "HSV" or "HSL"."""
    mode = c.params.get("mode", "RGB")
    v = stack(c["red"], c["green"], c["blue"])
    return hsv_to_rgb(v) if mode == "HSV" else hsl_to_rgb(v) if mode == "HSL" else v
