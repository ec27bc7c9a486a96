"""Blender's images to engine images, each once."""

from __future__ import annotations

from pointmr_engine.scene.texture import Image


class ImageSync:
    """Reads images and keeps them. report(level, message) is told of images that cannot be read."""

    def __init__(self, report) -> None:
        raise NotImplementedError

    def get(self, image, image_user=None, frame: int = 1) -> Image | None:
        """The engine's image for a bpy Image; magenta, with a named warning, where its file is missing."""
        raise NotImplementedError
