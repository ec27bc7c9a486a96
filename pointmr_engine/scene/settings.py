"""What the user asks of a render: size, quality, bounces, film, passes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pointmr_engine.scene.errors import SceneError

METHODS = ("conventional", "distributed")
FILTERS = ("box", "gaussian", "blackman_harris")
PASSES = (
    "combined",
    "depth",
    "position",
    "normal",
    "diffuse_color",
    "emission",
    "object_index",
    "material_index",
    "sample_count",
)


@dataclass
class RenderSettings:
    """Settings of one image. Region is in pixels, (x0, y0, x1, y1) from the lower left, None for all."""

    width: int = 640
    height: int = 480
    pixel_aspect: float = 1.0  # pixel width / height
    region: tuple[int, int, int, int] | None = None
    method: str = "distributed"
    samples: int = 64
    seed: int = 0
    pixel_filter: str = "blackman_harris"
    filter_width: float = 1.5
    max_bounces: int = 12
    diffuse_bounces: int = 0  # further diffuse bounces are not built yet: only 0 is accepted
    glossy_bounces: int = 4
    transmission_bounces: int = 12
    transparent_max_bounces: int = 8
    film_transparent: bool = False
    film_exposure: float = 1.0
    clamp_direct: float = 0.0
    clamp_indirect: float = 0.0
    caustics_reflective: bool = True
    caustics_refractive: bool = True
    pass_alpha_threshold: float = (
        0.5  # surfaces less opaque than this let unfiltered passes look through them
    )
    passes: tuple[str, ...] = ("combined", "depth")
    threads: int = 0  # 0: one per core

    def validate(self) -> None:
        """Raise SceneError for a value that no render could honour."""
        if self.width < 1 or self.height < 1:
            raise SceneError(f"image size {self.width}x{self.height}: both sides must be at least 1 pixel")
        if self.method not in METHODS:
            raise SceneError(f"method '{self.method}' is not one of {', '.join(METHODS)}")
        if self.pixel_filter not in FILTERS:
            raise SceneError(f"pixel filter '{self.pixel_filter}' is not one of {', '.join(FILTERS)}")
        if self.pixel_filter != "box" and not 0.01 <= self.filter_width <= 10.0:
            raise SceneError(f"filter width {self.filter_width} is outside 0.01..10 pixels")
        if not (self.pixel_aspect > 0.0 and math.isfinite(self.pixel_aspect)):
            raise SceneError(f"pixel aspect {self.pixel_aspect} must be positive and finite")
        if self.samples < 1:
            raise SceneError(f"samples = {self.samples}: at least 1 is needed")
        unknown = [p for p in self.passes if p not in PASSES]
        if unknown:
            raise SceneError(f"unknown pass '{unknown[0]}'; known are {', '.join(PASSES)}")
        if self.region is not None:
            x0, y0, x1, y1 = self.region
            if not (0 <= x0 < x1 <= self.width and 0 <= y0 < y1 <= self.height):
                raise SceneError(
                    f"region {self.region} is empty or outside the {self.width}x{self.height} image"
                )
