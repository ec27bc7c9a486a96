"""Images of Blender's scene by PointMR's methods and by Cycles, with the same settings."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from benchmarks import methods


def image(path: Path, method: str, samples: int, size: tuple[int, int], **settings) -> np.ndarray:
    """(height, width, 3) float64, of (width, height) pixels, by way of the EXR file `path`; settings: of both alike."""
    scene = bpy.context.scene
    methods.configure(scene, methods.Method(method, samples), 1, size, settings, 2)
    methods.write_exr_settings(scene, str(path))
    bpy.ops.render.render(write_still=True)
    return methods.read_exr(str(path))[0][..., :3].astype(float)
