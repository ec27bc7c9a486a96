"""8-bit PNG in sRGB, as Blender's Standard view shows an image."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pointmr_engine.image.files import whole_file
from pointmr_engine.image.frame import Frame


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Scene-linear Rec.709 to sRGB: float32 of the same shape, clipped to 0..1."""
    x = np.clip(np.asarray(linear, np.float32), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 0.0031308), 1 / 2.4) - 0.055)


def to_bytes(combined: np.ndarray) -> np.ndarray:
    """Premultiplied linear RGBA (h, w, 4) to sRGB bytes with unassociated alpha, of the same shape."""
    alpha = np.clip(combined[..., 3:], 0.0, 1.0)
    color = np.divide(
        combined[..., :3], alpha, out=np.array(combined[..., :3], np.float32), where=alpha > 0.0
    )
    return np.round(255.0 * np.concatenate([to_srgb(color), alpha], -1)).astype(np.uint8)


def write(path: str | Path, frame: Frame, transparent: bool | None = None) -> None:
    """Write the combined pass; with alpha if `transparent`, None meaning: if any pixel is not opaque.

    Needs Pillow (extra `cli`). Written beside and renamed; raises SceneError, naming the path, if it cannot be written.
    """
    from PIL import Image

    pixels = to_bytes(frame.whole().passes["combined"])[::-1]
    if transparent is None:
        transparent = bool((pixels[..., 3] < 255).any())
    if not transparent:
        pixels = pixels[..., :3]
    with whole_file(path) as part:
        Image.fromarray(np.ascontiguousarray(pixels)).save(part, format="PNG", compress_level=3)
