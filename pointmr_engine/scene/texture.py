"""Images that textures read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointmr_engine.scene.errors import SceneError

COLORSPACES = ("sRGB", "Linear", "Non-Color")
ALPHA_MODES = ("STRAIGHT", "PREMULTIPLIED", "CHANNEL_PACKED", "NONE")


@dataclass(eq=False)
class Image:
    """Pixels (height, width, 4) float32 or uint8, bottom row first, as the file has them (not yet decoded to linear).

    colorspace "sRGB" is decoded to scene-linear Rec.709 when it is read; "Linear" and "Non-Color" are taken as is.
    alpha "STRAIGHT", "PREMULTIPLIED", "CHANNEL_PACKED" or "NONE". Identity is the object: share it between nodes.
    """

    name: str
    pixels: np.ndarray
    colorspace: str = "sRGB"
    alpha: str = "STRAIGHT"

    def __post_init__(self) -> None:
        p = self.pixels
        if p.ndim != 3 or p.shape[2] != 4 or p.dtype not in (np.uint8, np.float32) or 0 in p.shape:
            raise SceneError(
                f"image '{self.name}': pixels must be (h, w, 4) uint8 or float32, not {p.dtype} {p.shape}"
            )
        if self.colorspace not in COLORSPACES:
            raise SceneError(
                f"image '{self.name}': colour space '{self.colorspace}' is not one of {COLORSPACES}"
            )
        if self.alpha not in ALPHA_MODES:
            raise SceneError(f"image '{self.name}': alpha mode '{self.alpha}' is not one of {ALPHA_MODES}")
