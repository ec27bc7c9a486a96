"""Images made ready to be looked up: premultiplied, with a mip pyramid averaged in linear light."""

from __future__ import annotations

import threading
import weakref
from functools import lru_cache

import numpy as np

from pointmr_engine.scene.texture import Image

EXTENSIONS = ("REPEAT", "EXTEND", "CLIP", "MIRROR")
_lock = threading.Lock()
_made: weakref.WeakKeyDictionary[Image, Texture] = weakref.WeakKeyDictionary()


class Texture:
    """The mip pyramid of an image, finest level first, the texels of all levels in one flat array.

    Texels keep the image's encoding (sRGB stays sRGB), alpha premultiplied, so that the finest level interpolates as
    Cycles does; coarser levels are averages in linear light, encoded again. They are made when they are first needed.
    """

    def __init__(self, image: Image) -> None:
        self.srgb = image.colorspace == "sRGB"
        self.associated = image.alpha in ("STRAIGHT", "PREMULTIPLIED") and image.colorspace != "Non-Color"
        self.scale = 1 / 255 if image.pixels.dtype == np.uint8 else 1.0
        base = np.ascontiguousarray(image.pixels)
        if image.alpha == "NONE" and _translucent(base):
            base = base.copy()
            base[..., 3] = 255 if base.dtype == np.uint8 else 1
        elif image.alpha == "STRAIGHT" and self.associated and _translucent(base):
            base = _premultiply(base)
        self._lock = threading.Lock()
        self._finest = (base.reshape(-1), np.array([(0, base.shape[1], base.shape[0])], np.int64))
        self._pyramid: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def pyramid(self) -> tuple[np.ndarray, np.ndarray]:
        """Texels, flat, and (levels, 3) int64: offset, width and height of each level."""
        with self._lock:
            if self._pyramid is None:
                self._pyramid = self._build()
                texels, levels = self._pyramid
                self._finest = (texels[: 4 * levels[0, 1] * levels[0, 2]], levels[:1].copy())
        return self._pyramid

    def _build(self) -> tuple[np.ndarray, np.ndarray]:
        flat, ((_, width, height),) = self._finest
        levels = [flat.reshape(height, width, 4)]
        linear = None
        apart = self.srgb and self.associated and _translucent(levels[0])
        while max(levels[-1].shape[:2]) > 1:
            linear = (
                _halve_decoded(levels[0], self.srgb, self.scale, apart) if linear is None else _halve(linear)
            )
            levels.append(_encode(linear, self.srgb, flat.dtype, apart))
        sizes = [(level.shape[1], level.shape[0]) for level in levels]
        offsets = np.cumsum([0] + [4 * w * h for w, h in sizes[:-1]])
        table = np.array([(o, w, h) for o, (w, h) in zip(offsets, sizes, strict=True)], np.int64)
        return np.concatenate([np.ascontiguousarray(level).ravel() for level in levels]), table

    def look_up(
        self,
        uv: np.ndarray,
        footprint: np.ndarray,
        extension: str = "REPEAT",
        interpolation: str = "Linear",
        unassociate: bool = False,
    ) -> np.ndarray:
        """RGBA (n, 4) float32, scene-linear, at uv (n, 2), averaged over squares of side `footprint` (n or 1,).

        Colours are premultiplied by alpha unless `unassociate`. interpolation: "Closest", "Linear", "Cubic" or
        "Smart", which is cubic too (a B-spline: it smooths).
        """
        from pointmr_engine.shading.kernels import texture_lookup as kernel

        flags = kernel.SRGB if self.srgb else 0
        if interpolation == "Closest":
            flags |= kernel.CLOSEST
        elif interpolation in ("Cubic", "Smart"):
            flags |= kernel.CUBIC
        if unassociate and self.associated:
            flags |= kernel.UNASSOCIATE
        out = np.empty((len(uv), 4), np.float32)
        uv = np.ascontiguousarray(uv, np.float32)
        footprint = np.ascontiguousarray(footprint, np.float32)
        _, ((_, width, height),) = self._finest
        magnified = not (footprint * np.sqrt(float(width) * float(height)) > 1).any()
        texels, levels = self._finest if magnified else self.pyramid
        kernel.lookup(texels, levels, uv, footprint, EXTENSIONS.index(extension), flags, self.scale, out)
        return out


def texture_of(image: Image) -> Texture:
    """The Texture of an Image, made once."""
    with _lock:
        texture = _made.get(image)
        if texture is None:
            texture = _made[image] = Texture(image)
        return texture


def _translucent(pixels: np.ndarray) -> bool:
    return bool((pixels[..., 3] != (255 if pixels.dtype == np.uint8 else 1)).any())


def _premultiply(pixels: np.ndarray) -> np.ndarray:
    out = pixels.copy()
    if pixels.dtype == np.uint8:
        color = pixels[..., :3].astype(np.uint16) * pixels[..., 3:]
        out[..., :3] = color // 255  # rounded down, as readers of files do
    else:
        out[..., :3] *= pixels[..., 3:]
    return out


def _decode(texels: np.ndarray, srgb: bool, scale: float) -> np.ndarray:
    """float32 linear values; bytes by table."""
    if not srgb:
        return texels.astype(np.float32) * np.float32(scale)
    if texels.dtype == np.uint8:
        codes = np.arange(256, dtype=np.float32) * np.float32(scale)
        linear = np.empty(texels.shape, np.float32)
        np.take(_srgb_to_linear(codes), texels, out=linear, mode="clip")
        linear[..., 3] = texels[..., 3] * np.float32(scale)
        return linear
    linear = texels.copy()
    linear[..., :3] = _srgb_to_linear(texels[..., :3])
    return linear


def _srgb_to_linear(c: np.ndarray) -> np.ndarray:
    c = np.maximum(c, 0)
    return np.where(c < 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _linear_to_srgb(c: np.ndarray) -> np.ndarray:
    return np.where(c < 0.0031308, c * 12.92, 1.055 * np.maximum(c, 1e-9) ** (1 / 2.4) - 0.055)


@lru_cache(maxsize=1)
def _byte_codes() -> np.ndarray:
    """sRGB bytes of linear values in steps of 1 / 65535."""
    return (_linear_to_srgb(np.arange(65536) / 65535) * 255 + 0.5).astype(np.uint8)


def _divide_alpha(texels: np.ndarray) -> np.ndarray:
    """Colours of texels (..., 4) float32 divided by their alpha, where there is any."""
    out = texels.copy()
    alpha = texels[..., 3:]
    np.divide(texels[..., :3], alpha, out=out[..., :3], where=alpha > 0)
    return out


def _times_alpha(texels: np.ndarray) -> np.ndarray:
    out = texels.copy()
    out[..., :3] *= texels[..., 3:]
    return out


def _encode(linear: np.ndarray, srgb: bool, dtype: np.dtype, apart: bool = False) -> np.ndarray:
    """Texels of linear values. apart: colours are encoded without their alpha, and multiplied by it again."""
    if apart:
        straight = _divide_alpha(linear)
        straight[..., :3] = _linear_to_srgb(straight[..., :3])
        out = _times_alpha(straight)
        if dtype == np.uint8:
            return (np.clip(out, 0, 1) * 255 + 0.5).astype(np.uint8)
        return out.astype(np.float32)
    if dtype == np.uint8:
        if not srgb:
            return (np.clip(linear, 0, 1) * 255 + 0.5).astype(np.uint8)
        steps = (np.clip(linear, 0, 1) * 65535 + 0.5).astype(np.uint16)
        out = _byte_codes()[steps]
        out[..., 3] = (linear[..., 3] * 255 + 0.5).astype(np.uint8)
        return out
    out = linear.astype(np.float32, copy=srgb)
    if srgb:
        out[..., :3] = _linear_to_srgb(linear[..., :3])
    return out


def _decode_apart(texels: np.ndarray, scale: float) -> np.ndarray:
    """Linear colours times alpha, float32, of sRGB texels that were multiplied by alpha when they were encoded."""
    straight = _divide_alpha(texels.astype(np.float32) * np.float32(scale))
    straight[..., :3] = _srgb_to_linear(straight[..., :3])
    return _times_alpha(straight)


def _halve_decoded(level: np.ndarray, srgb: bool, scale: float, apart: bool = False) -> np.ndarray:
    """The second level, linear, of the finest one; by bands of rows, so that large images need little room.

    apart: as for `_encode`: averages of colours are weighted by their alpha.
    """
    height = level.shape[0]
    rows = height if height % 2 else 256
    bands = [
        _halve(_decode_apart(band, scale) if apart else _decode(band, srgb, scale))
        for band in (level[y : y + rows] for y in range(0, height, rows))
    ]
    return np.concatenate(bands)


def _halve(level: np.ndarray) -> np.ndarray:
    """The next coarser level: texels averaged in pairs, and in threes where a side is odd, by exact area."""
    return _halve_axis(_halve_axis(level, 0), 1)


def _halve_axis(level: np.ndarray, axis: int) -> np.ndarray:
    n = level.shape[axis]
    if n == 1:
        return level
    a = np.moveaxis(level, axis, 0)
    m = n // 2
    if n % 2 == 0:
        out = (a[0::2] + a[1::2]) * np.float32(0.5)
    else:
        # texel i of m covers [i, i + 1] n / m of the finer ones: two whole ones' worth and a share of a third
        i = np.arange(m, dtype=np.float32)
        shape = (m,) + (1,) * (a.ndim - 1)
        first, last = ((m - i) / n).reshape(shape), ((i + 1) / n).reshape(shape)
        out = a[0 : 2 * m : 2] * first + a[1 : 2 * m : 2] * np.float32(m / n) + a[2 : 2 * m + 1 : 2] * last
    return np.ascontiguousarray(np.moveaxis(out, 0, axis))
