"""8-bit PNG in sRGB, as Blender's Standard view shows an image."""
from __future__ import annotations
from pathlib import Path
import numpy as np
from pointmr_engine.image.frame import Frame


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Scene-linear Rec.709 to sRGB, float of the same shape, clipped to 0..1."""


def write(path: str | Path, frame: Frame) -> None:
    """Write the combined pass, alpha unassociated. Atomic; raises SceneError, naming the path, if it cannot be written."""
