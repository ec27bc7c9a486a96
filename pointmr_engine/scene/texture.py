"""Images that textures read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(eq=False)
class Image:
    """Pixels (height, width, 4) float32 or uint8, bottom row first, as the file has them (before colour space decoding).

    colorspace "sRGB" is decoded to scene-linear Rec.709 when it is read; "Linear" and "Non-Color" are taken as they are.
    alpha "STRAIGHT", "PREMULTIPLIED", "CHANNEL_PACKED" or "NONE". Identity is the object: share it between nodes.
    """

    name: str
    pixels: np.ndarray
    colorspace: str = "sRGB"
    alpha: str = "STRAIGHT"
