"""Colour nodes: Mix and its blend types, Hue/Saturation, Bright/Contrast, Gamma, Invert, Blackbody, Wavelength."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading.nodes.converters import hsv_to_rgb, rgb_to_hsv
from pointmr_engine.shading.nodes.registry import COLOR, FLOAT, VECTOR, Call, node
from pointmr_engine.shading.spectra import RGB_FROM_XYZ, blackbody_rgb, wavelength_xyz
from pointmr_engine.shading.values import divide, mix, saturate, stack


def _overlay(t, a, b):
    low = a * (1 - t + 2 * t * b)
    high = 1 - (1 - t + 2 * t * (1 - b)) * (1 - a)
    return np.where(a < 0.5, low, high)


def _divide(t, a, b):
    return np.where(b != 0, (1 - t) * a + t * divide(a, b), a)


def _dodge(t, a, b):
    rest = 1 - t * b
    return np.where(a == 0, a, np.where(rest <= 0, 1, np.minimum(divide(a, rest), 1)))


def _burn(t, a, b):
    rest = 1 - t + t * b
    return np.where(rest <= 0, 0, np.clip(1 - divide(1 - a, rest), 0, 1))


def _hue(t, a, b):
    hsv, other = rgb_to_hsv(a), rgb_to_hsv(b)
    changed = hsv_to_rgb(np.concatenate([other[:, :1], hsv[:, 1:]], 1))
    return np.where(other[:, 1:2] != 0, mix(a, changed, t), a)


def _saturation(t, a, b):
    hsv, s = rgb_to_hsv(a), rgb_to_hsv(b)[:, 1:2]
    changed = np.concatenate([hsv[:, :1], mix(hsv[:, 1:2], s, t), hsv[:, 2:]], 1)
    return np.where(hsv[:, 1:2] != 0, hsv_to_rgb(changed), a)


def _value(t, a, b):
    hsv, v = rgb_to_hsv(a), rgb_to_hsv(b)[:, 2:]
    return hsv_to_rgb(np.concatenate([hsv[:, :2], mix(hsv[:, 2:], v, t)], 1))


def _color(t, a, b):
    hsv, other = rgb_to_hsv(a), rgb_to_hsv(b)
    changed = hsv_to_rgb(np.concatenate([other[:, :2], hsv[:, 2:]], 1))
    return np.where(other[:, 1:2] != 0, mix(a, changed, t), a)


def _soft_light(t, a, b):
    screen = 1 - (1 - b) * (1 - a)
    return (1 - t) * a + t * ((1 - a) * b * a + a * screen)


# t (n, 1), a and b (n, 3), all with the same n
BLENDS = {
    "MIX": lambda t, a, b: mix(a, b, t),
    "ADD": lambda t, a, b: mix(a, a + b, t),
    "MULTIPLY": lambda t, a, b: mix(a, a * b, t),
    "SUBTRACT": lambda t, a, b: mix(a, a - b, t),
    "SCREEN": lambda t, a, b: 1 - (1 - t + t * (1 - b)) * (1 - a),
    "DIVIDE": _divide,
    "DIFFERENCE": lambda t, a, b: mix(a, np.abs(a - b), t),
    "EXCLUSION": lambda t, a, b: np.maximum(mix(a, a + b - 2 * a * b, t), 0),
    "DARKEN": lambda t, a, b: mix(a, np.minimum(a, b), t),
    "LIGHTEN": lambda t, a, b: mix(a, np.maximum(a, b), t),
    "OVERLAY": _overlay,
    "DODGE": _dodge,
    "BURN": _burn,
    "HUE": _hue,
    "SATURATION": _saturation,
    "VALUE": _value,
    "COLOR": _color,
    "SOFT_LIGHT": _soft_light,
    "LINEAR_LIGHT": lambda t, a, b: a + t * (2 * b - 1),
}


def _mix_passes(params: dict, known: dict[str, np.ndarray]) -> str | None:
    """Plain mixing by a constant 0 or 1 is one of the inputs."""
    if "fac" not in known or params.get("clamp_result") or params.get("non_uniform"):
        return None
    t = known["fac"].ravel()
    if params.get("clamp_factor", True):
        t = np.clip(t, 0, 1)
    if (t == 0).all() and params.get("blend", "MIX") in ("MIX", "ADD", "MULTIPLY", "SUBTRACT", "DARKEN"):
        return "a"
    if (t == 1).all() and params.get("blend", "MIX") == "MIX":
        return "b"
    return None


@node(
    "mix_color",
    {"fac": (FLOAT, 0.5), "a": (COLOR, 0.5), "b": (COLOR, 0.5)},
    {"color": COLOR},
    passes=_mix_passes,
)
def _mix_color(c: Call) -> np.ndarray:
    """params: blend as Blender names it, clamp_factor (True), clamp_result (False)."""
    t, a, b = c["fac"], c["a"], c["b"]
    if c.params.get("clamp_factor", True):
        t = saturate(t)
    n = max(len(t), len(a), len(b))
    a, b = np.broadcast_to(a, (n, 3)), np.broadcast_to(b, (n, 3))
    result = BLENDS.get(c.params.get("blend", "MIX"), BLENDS["MIX"])(t[:, None], a, b)
    return saturate(result) if c.params.get("clamp_result") else result


@node(
    "mix_float",
    {"fac": (FLOAT, 0.5), "a": (FLOAT, 0.0), "b": (FLOAT, 0.0)},
    {"value": FLOAT},
    passes=_mix_passes,
)
def _mix_float(c: Call) -> np.ndarray:
    """params: clamp_factor (True)."""
    t = saturate(c["fac"]) if c.params.get("clamp_factor", True) else c["fac"]
    return mix(c["a"], c["b"], t)


@node(
    "mix_vector",
    {"fac": (FLOAT, 0.5), "fac_vector": (VECTOR, 0.5), "a": (VECTOR, 0.0), "b": (VECTOR, 0.0)},
    {"vector": VECTOR},
    passes=_mix_passes,
)
def _mix_vector(c: Call) -> np.ndarray:
    """params: non_uniform (a factor per component), clamp_factor (True)."""
    t = c["fac_vector"] if c.params.get("non_uniform") else c.vector("fac")
    return mix(c["a"], c["b"], saturate(t) if c.params.get("clamp_factor", True) else t)


@node(
    "hue_saturation",
    {
        "hue": (FLOAT, 0.5),
        "saturation": (FLOAT, 1.0),
        "value": (FLOAT, 1.0),
        "fac": (FLOAT, 1.0),
        "color": (COLOR, 0.8),
    },
    {"color": COLOR},
)
def _hue_saturation(c: Call) -> np.ndarray:
    hsv = rgb_to_hsv(c["color"])
    hue = hsv[:, 0] + c["hue"] + np.float32(0.5)
    hsv = stack(hue - np.floor(hue), saturate(hsv[:, 1] * c["saturation"]), hsv[:, 2] * c["value"])
    return np.maximum(mix(c["color"], hsv_to_rgb(hsv), c.vector("fac")), 0)


@node(
    "bright_contrast",
    {"color": (COLOR, 1.0), "bright": (FLOAT, 0.0), "contrast": (FLOAT, 0.0)},
    {"color": COLOR},
)
def _bright_contrast(c: Call) -> np.ndarray:
    contrast = c.vector("contrast")
    return np.maximum((1 + contrast) * c["color"] + c.vector("bright") - contrast / 2, 0)


@node("gamma", {"color": (COLOR, 1.0), "gamma": (FLOAT, 1.0)}, {"color": COLOR})
def _gamma(c: Call) -> np.ndarray:
    color, gamma = c["color"], c.vector("gamma")
    return np.where(color > 0, np.power(np.maximum(color, 1e-37), gamma), color)


@node("invert", {"fac": (FLOAT, 1.0), "color": (COLOR, 0.0)}, {"color": COLOR})
def _invert(c: Call) -> np.ndarray:
    t = c.vector("fac")
    return t * (1 - c["color"]) + (1 - t) * c["color"]


@node("blackbody", {"temperature": (FLOAT, 1500.0)}, {"color": COLOR})
def _blackbody(c: Call) -> np.ndarray:
    return np.maximum(blackbody_rgb(c["temperature"]), 0)


@node("wavelength", {"wavelength": (FLOAT, 500.0)}, {"color": COLOR})
def _wavelength(c: Call) -> np.ndarray:
    # the factor brings the largest component to about 1
    return np.maximum(wavelength_xyz(c["wavelength"]) @ RGB_FROM_XYZ.T / 2.52, 0)
