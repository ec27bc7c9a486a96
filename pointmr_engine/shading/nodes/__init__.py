"""Node types, one module per subject. Importing this package registers them all; kernels come when first run."""

from pointmr_engine.shading.nodes import (
    bump,
    color,
    converters,
    environment,
    image_texture,
    inputs,
    lights,
    math,
    noise,
    normals,
    procedural,
    ramps,
    shaders,
    sky,
    texture_coordinates,
    vector,
)
from pointmr_engine.shading.nodes.registry import NODES, SHADERS

__all__ = [
    "NODES",
    "SHADERS",
    "bump",
    "color",
    "converters",
    "environment",
    "image_texture",
    "inputs",
    "lights",
    "math",
    "noise",
    "normals",
    "procedural",
    "ramps",
    "shaders",
    "sky",
    "texture_coordinates",
    "vector",
]
