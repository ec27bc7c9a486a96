"""Leaf shaders: their sockets, and which columns of a leaf they fill."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading import leaves as L
from pointmr_engine.shading.nodes.registry import (
    COLOR,
    FLOAT,
    SHADERS,
    VECTOR,
    Call,
    From,
    ShaderType,
    node,
)

_NORMAL = (VECTOR, From("normal"))
_TANGENT = (VECTOR, From("tangent"))
_UNIT = (0.0, 1.0)
_POSITIVE = (0.0, None)
_IOR = (1e-5, None)
_FILM = {"thin_film_thickness": (FLOAT, 0.0), "thin_film_ior": (FLOAT, 1.33)}


def _shader(kind: str, leaf: int, inputs: dict, **options) -> None:
    SHADERS[kind] = ShaderType(kind, leaf, inputs, **options)


# the trees' inner nodes: never leaves themselves
_shader("mix_shader", -1, {"fac": (FLOAT, 0.5)})
_shader("add_shader", -1, {})

_shader(
    "principled",
    L.PRINCIPLED,
    {
        "base_color": (COLOR, (0.8, 0.8, 0.8)),
        "metallic": (FLOAT, 0.0),
        "roughness": (FLOAT, 0.5),
        "ior": (FLOAT, 1.5),
        "alpha": (FLOAT, 1.0),
        "normal": _NORMAL,
        "diffuse_roughness": (FLOAT, 0.0),
        "subsurface_weight": (FLOAT, 0.0),
        "specular_ior_level": (FLOAT, 0.5),
        "specular_tint": (COLOR, (1.0, 1.0, 1.0)),
        "anisotropic": (FLOAT, 0.0),
        "anisotropic_rotation": (FLOAT, 0.0),
        "tangent": _TANGENT,
        "transmission_weight": (FLOAT, 0.0),
        "coat_weight": (FLOAT, 0.0),
        "coat_roughness": (FLOAT, 0.03),
        "coat_ior": (FLOAT, 1.5),
        "coat_tint": (COLOR, (1.0, 1.0, 1.0)),
        "coat_normal": _NORMAL,
        "sheen_weight": (FLOAT, 0.0),
        "sheen_roughness": (FLOAT, 0.5),
        "sheen_tint": (COLOR, (1.0, 1.0, 1.0)),
        "emission_color": (COLOR, (1.0, 1.0, 1.0)),
        "emission_strength": (FLOAT, 0.0),
        **_FILM,
    },
    anisotropy="anisotropic",
    limits={
        "base_color": _POSITIVE,
        "metallic": _UNIT,
        "roughness": _UNIT,
        "ior": _IOR,
        "alpha": _UNIT,
        "diffuse_roughness": _UNIT,
        "subsurface_weight": _UNIT,
        "specular_ior_level": _POSITIVE,
        "specular_tint": _POSITIVE,
        "anisotropic": _UNIT,
        "transmission_weight": _UNIT,
        "coat_weight": _POSITIVE,
        "coat_roughness": _UNIT,
        "coat_ior": (1.0, None),
        "coat_tint": _POSITIVE,
        "sheen_weight": _POSITIVE,
        "sheen_roughness": _UNIT,
        "sheen_tint": _POSITIVE,
        "thin_film_ior": _IOR,
    },
)
_COLOR = (COLOR, (0.8, 0.8, 0.8))
_shader(
    "diffuse",
    L.DIFFUSE,
    {"color": _COLOR, "roughness": (FLOAT, 0.0), "normal": _NORMAL},
    tint="color",
    limits={"roughness": _UNIT},
)
_shader(
    "glossy",
    L.GLOSSY,
    {
        "color": _COLOR,
        "roughness": (FLOAT, 0.5),
        "anisotropy": (FLOAT, 0.0),
        "rotation": (FLOAT, 0.0),
        "normal": _NORMAL,
        "tangent": _TANGENT,
    },
    tint="color",
    anisotropy="anisotropy",
    limits={"roughness": _UNIT, "anisotropy": (-0.99, 0.99)},
)
_shader(
    "metallic",
    L.METALLIC,
    {
        "base_color": (COLOR, (0.617, 0.577, 0.540)),
        "edge_tint": (COLOR, (0.695, 0.726, 0.770)),
        "roughness": (FLOAT, 0.5),
        "anisotropy": (FLOAT, 0.0),
        "rotation": (FLOAT, 0.0),
        "normal": _NORMAL,
        "tangent": _TANGENT,
        **_FILM,
    },
    anisotropy="anisotropy",
    limits={
        "base_color": _UNIT,
        "edge_tint": _UNIT,
        "roughness": _UNIT,
        "anisotropy": _UNIT,
        "thin_film_ior": _IOR,
    },
)
_shader(
    "glass",
    L.GLASS,
    {
        "color": (COLOR, (1.0, 1.0, 1.0)),
        "roughness": (FLOAT, 0.0),
        "ior": (FLOAT, 1.5),
        "normal": _NORMAL,
        **_FILM,
    },
    tint="color",
    limits={"color": _POSITIVE, "roughness": _UNIT, "ior": _IOR, "thin_film_ior": _IOR},
)
_shader(
    "refraction",
    L.REFRACTION,
    {
        "color": (COLOR, (1.0, 1.0, 1.0)),
        "roughness": (FLOAT, 0.0),
        "ior": (FLOAT, 1.45),
        "normal": _NORMAL,
    },
    tint="color",
    limits={"roughness": _UNIT, "ior": _IOR},
)
_shader("transparent", L.TRANSPARENT, {"color": (COLOR, (1.0, 1.0, 1.0))}, tint="color")
_shader("translucent", L.TRANSLUCENT, {"color": _COLOR, "normal": _NORMAL}, tint="color")
_shader(
    "emission",
    L.EMISSION,
    {"color": (COLOR, (1.0, 1.0, 1.0)), "strength": (FLOAT, 1.0)},
    tint="color",
    strength="strength",
)
_shader(
    "background",
    L.BACKGROUND,
    {"color": _COLOR, "strength": (FLOAT, 1.0)},
    tint="color",
    strength="strength",
)
_shader(
    "sheen",
    L.SHEEN,
    {"color": _COLOR, "roughness": (FLOAT, 0.5), "normal": _NORMAL},
    tint="color",
    limits={"roughness": _UNIT},
)
_shader("subsurface", L.SUBSURFACE, {"color": _COLOR, "normal": _NORMAL}, tint="color")
_shader("holdout", L.HOLDOUT, {})
_shader(
    "toon",
    L.DIFFUSE,
    {"color": _COLOR, "roughness": (FLOAT, 0.0), "normal": _NORMAL},
    tint="color",
    warning="Toon BSDF is shown as a diffuse BSDF",
)
_shader(
    "hair",
    L.GLOSSY,
    {
        "color": (COLOR, (0.017513, 0.005763, 0.002059)),
        "roughness": (FLOAT, 0.3),
        "anisotropy": (FLOAT, 0.0),
        "rotation": (FLOAT, 0.0),
        "normal": _NORMAL,
        "tangent": _TANGENT,
    },
    tint="color",
    anisotropy="anisotropy",
    limits={"roughness": _UNIT},
    warning="hair BSDFs are shown as a glossy BSDF",
)


# ---- weights and limits, which the compiler inserts


@node("weight:share", {"fac": (FLOAT, 0.5)}, {"first": FLOAT, "second": FLOAT})
def _share(c: Call) -> dict[str, np.ndarray]:
    t = np.clip(c["fac"], 0.0, 1.0)
    return {"first": 1 - t, "second": t}


@node("weight:product", {"a": (FLOAT, 1.0), "b": (FLOAT, 1.0)}, {"value": FLOAT})
@node("weight:product_color", {"a": (COLOR, 1.0), "b": (COLOR, 1.0)}, {"value": COLOR})
def _product(c: Call) -> np.ndarray:
    return c["a"] * c["b"]


@node("weight:sum", {"a": (FLOAT, 0.0), "b": (FLOAT, 0.0)}, {"value": FLOAT})
@node("weight:sum_color", {"a": (COLOR, 0.0), "b": (COLOR, 0.0)}, {"value": COLOR})
def _sum(c: Call) -> np.ndarray:
    return c["a"] + c["b"]


@node("limit", {"value": (FLOAT, 0.0)}, {"value": FLOAT})
@node("limit_color", {"value": (COLOR, 0.0)}, {"value": COLOR})
def _limit(c: Call) -> np.ndarray:
    return np.clip(c["value"], c.params["low"], c.params["high"])


@node(
    "conductor",
    {"ior": (VECTOR, 1.0), "extinction": (VECTOR, 1.0)},
    {"base_color": COLOR, "edge_tint": COLOR},
)
def _conductor(c: Call) -> dict[str, np.ndarray]:
    """Reflectance of a metal of index n + i k seen straight on, and its tint at 82 degrees (F82) over Schlick's."""
    n, k = np.maximum(c["ior"], 0), np.maximum(c["extinction"], 0)

    def reflectance(cosine: float) -> np.ndarray:
        size, two_nc, c2 = n * n + k * k, 2 * n * cosine, cosine * cosine
        parallel = (size * c2 - two_nc + 1) / (size * c2 + two_nc + 1)
        return (parallel + (size - two_nc + c2) / (size + two_nc + c2)) / 2

    f0, f82 = reflectance(1.0), reflectance(1 / 7)
    schlick = f0 + (1 - f0) * (6 / 7) ** 5
    return {"base_color": f0, "edge_tint": np.clip(f82 / np.maximum(schlick, 1e-6), 0, 1)}
