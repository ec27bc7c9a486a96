"""What the user asks of a render: size, quality, bounces, film, passes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from pointmr_engine.scene.errors import SceneError

METHODS = ("raytrace", "forward", "conventional", "distributed")
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

SAMPLINGS = ("static", "dynamic")
DRAWS = ("random", "stratified")
STRATEGIES = ("random", "jittered_grid", "quantised_grid", "neighbourhood")
RECONSTRUCTIONS = ("pixel", "gaussian", "subpixel", "analytic")
SHADINGS = ("simple", "full")
SUBPIXELS = (2, 4, 8)
SAMPLES_PER_PIXEL = (0.05, 64.0)
CONES = (1, 4, 16, 64)
SECONDARY = ("cones", "rays")
VISIBILITY = ("masks", "alpha")
FOOTPRINT = (0.25, 4.0)


@dataclass
class ForwardSettings:
    """Settings of method "forward", which projects surface samples onto the image.

    sampling: "static" takes samples made before the render, of which a hierarchy holds every resolution; "dynamic"
    draws new ones from the triangles for each image.
    samples_per_pixel: density, per pixel's area; samples lie 1/sqrt(samples_per_pixel) pixels apart.
    epsilon: dynamic; a box is sampled at one density where (z_max/z_min)^2 <= 1 + epsilon.
    draws: dynamic; how samples are spread over the surface. strategy: static; which samples are kept.
    failure: the probability that an image of random samples has a hole.
    subpixels: per side of a pixel, for reconstruction "subpixel".
    shading: "full" evaluates materials at every fragment, "simple" takes baked colours under Lambert's law.
    cache_folder: where sample sets are kept between runs; None: nowhere.
    """

    sampling: str = "static"
    samples_per_pixel: float = 1.0
    epsilon: float = 0.5
    failure: float = 1e-3
    draws: str = "stratified"
    strategy: str = "neighbourhood"
    reconstruction: str = "subpixel"
    subpixels: int = 4
    shading: str = "full"
    shadows: bool = True
    backface_culling: bool = False
    occlusion_culling: bool = True
    cache_folder: str | None = None

    def validate(self) -> None:
        """Raise SceneError for a value that no render could honour, naming its field."""
        for name, choices in (
            ("sampling", SAMPLINGS),
            ("draws", DRAWS),
            ("strategy", STRATEGIES),
            ("reconstruction", RECONSTRUCTIONS),
            ("subpixels", SUBPIXELS),
            ("shading", SHADINGS),
        ):
            value = getattr(self, name)
            if value not in choices:
                raise SceneError(f"forward.{name} = {value!r} is not one of {', '.join(map(str, choices))}")
        low, high = SAMPLES_PER_PIXEL
        if not low <= self.samples_per_pixel <= high:
            raise SceneError(f"forward.samples_per_pixel = {self.samples_per_pixel} is outside {low}..{high}")
        if not (self.epsilon > 0.0 and math.isfinite(self.epsilon)):
            raise SceneError(f"forward.epsilon = {self.epsilon} must be positive and finite")
        if not 0.0 < self.failure < 1.0:
            raise SceneError(f"forward.failure = {self.failure} must lie between 0 and 1, both excluded")
        for name in ("shadows", "backface_culling", "occlusion_culling"):
            if getattr(self, name) not in (True, False):
                raise SceneError(f"forward.{name} = {getattr(self, name)!r} is neither True nor False")
        if self.cache_folder is not None and not (isinstance(self.cache_folder, str) and self.cache_folder):
            raise SceneError(f"forward.cache_folder = {self.cache_folder!r} must be a path, or None")


@dataclass
class RaytraceSettings:
    """Settings of method "raytrace": extended rays (cones) through a prefiltered hierarchy.

    cones: per pixel; each is narrower by as much, so that the error falls towards zero with their number.
    footprint: factor of the size of the details that samples are taken for; below 1 finer levels are used.
    secondary: shadows, reflections and refractions by "cones" or by the exact random "rays" of method "distributed".
    visibility: what primary cones see by subpixel "masks", or by lists of coverages that are blended by "alpha".
    cache_folder: where sample sets are kept between runs; None: nowhere.
    """

    cones: int = 1
    footprint: float = 1.0
    secondary: str = "cones"
    visibility: str = "masks"
    cache_folder: str | None = None

    def validate(self) -> None:
        """Raise SceneError for a value that no render could honour, naming its field."""
        for name, choices in (("cones", CONES), ("secondary", SECONDARY), ("visibility", VISIBILITY)):
            value = getattr(self, name)
            if value not in choices:
                raise SceneError(f"raytrace.{name} = {value!r} is not one of {', '.join(map(str, choices))}")
        low, high = FOOTPRINT
        if not low <= self.footprint <= high:
            raise SceneError(f"raytrace.footprint = {self.footprint} is outside {low}..{high}")
        if self.cache_folder is not None and not (isinstance(self.cache_folder, str) and self.cache_folder):
            raise SceneError(f"raytrace.cache_folder = {self.cache_folder!r} must be a path, or None")


@dataclass
class RenderSettings:
    """Settings of one image. Region is in pixels, (x0, y0, x1, y1) from the lower left, None for all."""

    width: int = 640
    height: int = 480
    pixel_aspect: float = 1.0  # pixel width / height
    region: tuple[int, int, int, int] | None = None
    method: str = "raytrace"
    samples: int = 64
    seed: int = 0
    pixel_filter: str = "blackman_harris"
    filter_width: float = 1.5
    max_bounces: int = 12
    diffuse_bounces: int = 0  # 0: direct light alone on diffuse surfaces
    glossy_bounces: int = 4
    transmission_bounces: int = 12
    transparent_max_bounces: int = 8
    film_transparent: bool = False
    film_exposure: float = 1.0
    clamp_direct: float = 0.0
    clamp_indirect: float = 0.0
    caustics_reflective: bool = True
    caustics_refractive: bool = True
    # glossy lobes are made rougher behind directions drawn with less than this density per solid angle (0: none)
    filter_glossy: float = 0.0
    # surfaces less opaque than this let unfiltered passes look through them
    pass_alpha_threshold: float = 0.5
    passes: tuple[str, ...] = ("combined", "depth")
    threads: int = 0  # 0: one per core
    # tiles of rays by processes forked from this one instead of by threads, on Linux, where that is faster
    # (image/tile_workers.py); not for programs that own windows
    processes: bool = False
    forward: ForwardSettings = field(default_factory=ForwardSettings)  # of method "forward" alone
    raytrace: RaytraceSettings = field(default_factory=RaytraceSettings)  # of method "raytrace" alone

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
        if not (self.filter_glossy >= 0.0 and math.isfinite(self.filter_glossy)):
            raise SceneError(f"filter glossy {self.filter_glossy} must be finite, and not negative")
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
        self.forward.validate()
        self.raytrace.validate()
