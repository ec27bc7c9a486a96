"""Blender's start-up scene, small, and its rendered files."""

from __future__ import annotations

import bpy
import numpy as np
import OpenEXR

import blender_addon

WIDTH, HEIGHT = 64, 48


def startup_scene(method: str, samples: int) -> bpy.types.Scene:
    """A cube, a lamp, a camera, to be rendered by PointMR to multilayer EXR files on a transparent film."""
    bpy.ops.wm.read_factory_settings(use_empty=False)
    blender_addon.register()
    scene = bpy.context.scene
    render = scene.render
    render.engine = "POINTMR"
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    render.film_transparent = True
    scene.pointmr.method, scene.pointmr.samples = method, samples
    settings = render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    return scene


def render(scene, path) -> dict[str, np.ndarray]:
    """Render to `path` (EXR); channels by name without the layer's, top row first."""
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        parts = {name: c.pixels for part in file.parts for name, c in part.channels.items()}
    return {name.removeprefix("ViewLayer."): pixels for name, pixels in parts.items()}


def combined(channels) -> np.ndarray:
    """(height, width, 4) of the combined pass."""
    return np.stack([channels[f"Combined.{c}"] for c in "RGBA"], -1)
