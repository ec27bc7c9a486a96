"""Small readable scenes, each isolating one feature, as builder functions on bpy.

A builder is a function with no arguments, marked @feature, that fills the empty scene it is given. Its name is the
scene's name, its docstring says what would look wrong if the feature were.
"""

from __future__ import annotations

from benchmarks.features import (
    bsdf,
    displacement,
    film,
    images,
    instances,
    lenses,
    lights,
    patterns,
    principled,
    textures,
)
from benchmarks.features.registry import FEATURES, source

__all__ = [
    "FEATURES",
    "bsdf",
    "displacement",
    "film",
    "images",
    "instances",
    "lenses",
    "lights",
    "patterns",
    "principled",
    "source",
    "textures",
]
