"""The film: samples of a tile are summed by kernels, and finished tiles become a Frame.

Every tile is summed by one thread in the order of its queue, in float64, so that the image does not depend on the
number of threads. What is averaged over a pixel's samples and what is taken from its first one follows Cycles: depth,
position and the indices come from sample 0, which goes through the pixel's centre; all else is the filtered average.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.image.frame import CHANNELS, NOTHING, Frame
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.scene.settings import RenderSettings

__all__ = ["Film", "Frame", "TileSums", "add_light", "add_averages", "write_first", "clamp_light"]


class TileSums(NamedTuple):
    """Sums over the samples of a tile's P = width * height pixels, row by row from the lowest one.

    An array whose pass was not asked for has no rows, and the kernels leave it alone.
    """

    combined: np.ndarray  # (P, 4) float64: radiance RGB, alpha
    emission: np.ndarray  # (P, 3) float64
    diffuse_color: np.ndarray  # (P, 3) float64
    normal: np.ndarray  # (P, 3) float64
    depth: np.ndarray  # (P,) float32, 1e10: nothing
    position: np.ndarray  # (P, 3) float32
    object_index: np.ndarray  # (P,) float32
    material_index: np.ndarray  # (P,) float32
    samples: np.ndarray  # (P,) float64: number of samples
    bounds: np.ndarray  # (4,) int64: x0, y0, x1, y1 in the whole image
    bad: np.ndarray  # (1,) int64: samples that were not finite, and were taken as black


@uncounted
def clamp_light(r, g, b, limit):
    """A contribution (r, g, b) scaled down so that its mean does not exceed `limit`; 0 means no limit.

    The limit is `clamp_direct` for what the first surface after the camera shows or receives, else `clamp_indirect`.
    """
    total = abs(r) + abs(g) + abs(b)
    if limit > 0.0 and total > 3.0 * limit:
        scale = 3.0 * limit / total
        return r * scale, g * scale, b * scale
    return r, g, b


@uncounted
def add_light(tile: TileSums, pixel, radiance, transparency, start, stop):
    """Add finished paths start..stop to the combined pass, each as one sample of its pixel.

    pixel (N,) int32: index in the tile; radiance (N, 3) float: premultiplied; transparency (N,) float: 1 - alpha, the
    share of the ray that saw a transparent film's background or a holdout. Not finite: counted, and black.
    """
    for k in range(start, stop):
        p = pixel[k]
        tile.samples[p] += 1.0
        r, g, b = float(radiance[k, 0]), float(radiance[k, 1]), float(radiance[k, 2])
        alpha = 1.0 - float(transparency[k])
        if math.isfinite(r) and math.isfinite(g) and math.isfinite(b) and math.isfinite(alpha):
            tile.combined[p, 0] += r
            tile.combined[p, 1] += g
            tile.combined[p, 2] += b
            tile.combined[p, 3] += alpha
        else:
            tile.bad[0] += 1


@uncounted
def add_averages(sums, pixel, values, start, stop):
    """Add values (N, 3) to a tile's `emission`, `diffuse_color` or `normal` sums; what is not finite is left out.

    Divided by the pixel's number of samples in the end, so a sample that adds nothing counts as zero.
    """
    if sums.shape[0] == 0:
        return
    for k in range(start, stop):
        a, b, c = float(values[k, 0]), float(values[k, 1]), float(values[k, 2])
        if math.isfinite(a) and math.isfinite(b) and math.isfinite(c):
            p = pixel[k]
            sums[p, 0] += a
            sums[p, 1] += b
            sums[p, 2] += c


@uncounted
def write_first(tile: TileSums, pixel, depth, position, object_index, material_index, start, stop):
    """Set the unfiltered passes of the pixels of surfaces start..stop, which sample 0 of each pixel sees.

    pixel (N,) int32; depth (N,) float: along the view axis; position (N, 3) float, world; object_index, material_index
    (N,) int32. Called again for the same pixel it overwrites: surfaces less opaque than the settings'
    `pass_alpha_threshold` are written, too, until one that is opaque enough has been.
    """
    for k in range(start, stop):
        p = pixel[k]
        if tile.depth.shape[0] > 0:
            tile.depth[p] = depth[k]
        if tile.position.shape[0] > 0:
            for a in range(3):
                tile.position[p, a] = position[k, a]
        if tile.object_index.shape[0] > 0:
            tile.object_index[p] = object_index[k]
        if tile.material_index.shape[0] > 0:
            tile.material_index[p] = material_index[k]


@uncounted
def write_nothing(tile: TileSums, pixel, start, stop):
    """Set the unfiltered passes to "nothing there", for rays of sample 0 that leave through what is transparent."""
    for k in range(start, stop):
        p = pixel[k]
        if tile.depth.shape[0] > 0:
            tile.depth[p] = NOTHING
        if tile.position.shape[0] > 0:
            tile.position[p, :] = 0.0
        if tile.object_index.shape[0] > 0:
            tile.object_index[p] = 0.0
        if tile.material_index.shape[0] > 0:
            tile.material_index[p] = 0.0


def allocate_tile(bounds: tuple[int, int, int, int], passes: tuple[str, ...]) -> TileSums:
    """Empty sums for the pixels x0 <= x < x1, y0 <= y < y1 of the whole image."""
    x0, y0, x1, y1 = bounds
    n = (x1 - x0) * (y1 - y0)

    def rows(name: str) -> int:
        return n if name in passes else 0

    return TileSums(
        np.zeros((n, 4)),
        np.zeros((rows("emission"), 3)),
        np.zeros((rows("diffuse_color"), 3)),
        np.zeros((rows("normal"), 3)),
        np.full(rows("depth"), NOTHING, np.float32),
        np.zeros((rows("position"), 3), np.float32),
        np.zeros(rows("object_index"), np.float32),
        np.zeros(rows("material_index"), np.float32),
        np.zeros(n),
        np.array(bounds, np.int64),
        np.zeros(1, np.int64),
    )


class Film:
    """Collects the tiles of one image. `finish_tile` may be called from any thread, once for every tile."""

    def __init__(self, settings: RenderSettings):
        """An empty film of the settings' region; its frame has the settings' passes, and "combined" in any case."""
        self.settings = settings
        self.region = settings.region or (0, 0, settings.width, settings.height)
        x0, y0, x1, y1 = self.region
        names = ("combined", *(p for p in settings.passes if p != "combined"))
        self.frame = Frame(x1 - x0, y1 - y0, region=settings.region)
        self.frame.full_width, self.frame.full_height = settings.width, settings.height
        for name in names:
            self.frame.passes[name] = np.zeros((y1 - y0, x1 - x0, CHANNELS[name]), np.float32)
        if "depth" in names:
            self.frame.passes["depth"].fill(NOTHING)
        self.bad: dict[tuple, int] = {}  # samples that were not finite, by tile

    def tiles(self, size: int) -> list[tuple[int, int, int, int]]:
        """Bounds of the tiles, at most size x size, that cover the region, in whole-image pixels, top row first."""
        x0, y0, x1, y1 = self.region
        rows = [(max(y1 - (j + 1) * size, y0), y1 - j * size) for j in range(-(-(y1 - y0) // size))]
        columns = [(x, min(x + size, x1)) for x in range(x0, x1, size)]
        return [(left, low, right, high) for low, high in rows for left, right in columns]

    def tile(self, bounds: tuple[int, int, int, int]) -> TileSums:
        """Empty sums for one tile."""
        return allocate_tile(bounds, self.settings.passes)

    def finish_tile(self, tile: TileSums) -> None:
        """Turn a tile's sums into pixels: averages, exposure, alpha. Pixels without a sample stay as they are."""
        x0, y0, x1, y1 = (int(v) for v in tile.bounds)
        rows, columns = y1 - y0, x1 - x0
        exposure = self.settings.film_exposure
        weight = np.where(tile.samples > 0, 1.0 / np.maximum(tile.samples, 1.0), 0.0)[:, None]
        combined = tile.combined * weight
        combined[:, :3] *= exposure
        combined[:, 3] = np.clip(combined[:, 3], 0.0, 1.0)
        values = {
            "combined": combined,
            "emission": tile.emission * (weight * exposure) if len(tile.emission) else None,
            "diffuse_color": tile.diffuse_color * weight if len(tile.diffuse_color) else None,
            "normal": tile.normal * weight if len(tile.normal) else None,
            "depth": tile.depth,
            "position": tile.position,
            "object_index": tile.object_index,
            "material_index": tile.material_index,
            "sample_count": tile.samples,
        }
        left, low = x0 - self.region[0], y0 - self.region[1]
        for name, target in self.frame.passes.items():
            block = np.asarray(values[name], np.float64).reshape(rows, columns, -1)
            with np.errstate(over="ignore"):
                block = block.astype(np.float32)
            if not np.isfinite(block).all():  # sums of finite samples may still leave float32's range
                block = np.nan_to_num(
                    block, nan=0.0, posinf=np.finfo(np.float32).max, neginf=-np.finfo(np.float32).max
                )
            target[low : low + rows, left : left + columns] = block
        self.bad[x0, y0, x1, y1] = int(tile.bad[0])

    def result(self) -> Frame:
        """The frame, with `bad_samples` in its stats and a warning if there were any."""
        self.frame.stats["bad_samples"] = bad = sum(self.bad.values())
        if bad:
            self.frame.warnings.append(f"{bad} samples were not finite and were taken as black")
        return self.frame
