"""Blender's images to engine images, each once."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from pointmr_engine.scene.texture import Image

MAGENTA = (1.0, 0.0, 1.0, 1.0)
_LINEAR = {"Linear Rec.709", "Linear", "scene_linear", "Linear BT.709", "Linear sRGB"}
_SRGB = {"sRGB", "sRGB OETF", "srgb_texture"}


class ImageSync:
    """Reads images and keeps them. report(level, message) is told of images that cannot be read."""

    def __init__(self, report) -> None:
        self._report = report
        self._images: dict[tuple, Image] = {}

    def get(self, image, image_user=None, frame: int = 1) -> Image | None:
        """The engine's image for a bpy Image; magenta, with a named warning, where its file is missing.

        Of a sequence or movie the frame that `image_user` stands on (else `frame`); of UDIM tiles the first.
        """
        if image is None:
            return None
        if image.source in ("SEQUENCE", "MOVIE") and image_user is not None:
            frame = image_user.frame_current
        key = (image.name_full, frame if image.source in ("SEQUENCE", "MOVIE") else 0)
        if key not in self._images:
            self._images[key] = self._read(image, frame)
        return self._images[key]

    def _read(self, image, frame: int) -> Image:
        name = image.name_full
        if image.source == "TILED" and len(image.tiles) > 1:
            self._report(
                "WARNING", f"image '{name}': only the first of its {len(image.tiles)} UDIM tiles is used"
            )
        if image.source == "SEQUENCE":
            read = self._read_sequence(image, frame)
            if read is not None:
                return read
        try:
            return self._pixels(image)
        except (RuntimeError, MemoryError, ValueError) as error:
            where = image.filepath or "no file"
            self._report("WARNING", f"image '{name}' cannot be read ({where}): {error}; magenta is shown")
            return missing(name)

    def _pixels(self, image) -> Image:
        loaded = image.has_data
        width, height = image.size
        if not width or not height:
            raise RuntimeError("it is missing or empty")
        channels = image.channels
        values = np.empty(width * height * channels, np.float32)
        image.pixels.foreach_get(values)
        is_float = image.is_float
        settings = image.colorspace_settings
        color, alpha = self._colorspace(image.name_full, settings, is_float), _alpha(image, is_float)
        if not loaded and image.source == "FILE" and not image.is_dirty:
            image.buffers_free()
        return Image(image.name_full, _rgba(values.reshape(height, width, channels), is_float), color, alpha)

    def _colorspace(self, name: str, settings, is_float: bool) -> str:
        if settings.is_data:
            return "Non-Color"
        # Blender has made float images scene-linear when it loaded them
        if is_float or settings.name in _LINEAR:
            return "Linear"
        if settings.name not in _SRGB:
            self._report("WARNING", f"image '{name}': colour space '{settings.name}' is read as sRGB")
        return "sRGB"

    def _read_sequence(self, image, frame: int) -> Image | None:
        """The file of one frame, through a short-lived image of its own; None where that fails."""
        path = Path(bpy.path.abspath(image.filepath, library=image.library))
        digits = len(path.stem) - len(path.stem.rstrip("0123456789"))
        if not digits:
            return None
        numbered = path.with_name(f"{path.stem[:-digits]}{frame:0{digits}d}{path.suffix}")
        if not numbered.exists():
            self._report("WARNING", f"image '{image.name_full}': frame {frame} is missing ({numbered.name})")
            return missing(image.name_full)
        single = None
        try:
            single = bpy.data.images.load(str(numbered))
            single.colorspace_settings.name = image.colorspace_settings.name
            single.alpha_mode = image.alpha_mode
            return self._pixels(single)
        except (RuntimeError, AttributeError) as error:
            self._report("WARNING", f"image '{image.name_full}': frame {frame}: {error}")
            return None
        finally:
            if single is not None:
                bpy.data.images.remove(single)


def missing(name: str) -> Image:
    """The one-pixel magenta that stands for an image that is not there."""
    return Image(name, np.array([[MAGENTA]], np.float32), "Linear", "STRAIGHT")


def _alpha(image, is_float: bool) -> str:
    if image.alpha_mode in ("NONE", "CHANNEL_PACKED"):
        return image.alpha_mode
    # whatever the file has, Blender keeps bytes straight and floats premultiplied
    return "PREMULTIPLIED" if is_float else "STRAIGHT"


def _rgba(values: np.ndarray, is_float: bool) -> np.ndarray:
    """(h, w, 4), bytes where Blender had bytes."""
    if not is_float:
        values *= 255
        values += 0.5
        values = np.clip(values, 0, 255, out=values).astype(np.uint8)
    opaque = values.dtype.type(1 if is_float else 255)
    height, width, channels = values.shape
    if channels == 4:
        return values
    out = np.full((height, width, 4), opaque, values.dtype)
    out[..., :3] = values[..., :3] if channels >= 3 else values[..., :1]
    if channels == 2:
        out[..., 3] = values[..., 1]
    return out
