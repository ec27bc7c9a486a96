"""Multilayer OpenEXR in Blender's naming, through the OpenEXR package."""
from __future__ import annotations
from pathlib import Path
import numpy as np
from pointmr_engine.image.frame import Frame


def write(path: str | Path, frame: Frame, layer: str = "ViewLayer", half: bool = False) -> None:
    """Write all passes of `frame` as one multilayer file, ZIP compressed, float32 (colours as half if asked).

    Written beside and renamed, so that `path` is never half a file. Raises SceneError, naming the path, if it cannot be
    written.
    """


def read(path: str | Path) -> dict[str, np.ndarray]:
    """Passes of a multilayer file (ours, or Blender's): name -> (height, width, channels) float32, bottom row first."""
