"""Render settings from scene.render, scene.pointmr and the view layer's passes."""

from __future__ import annotations

import math

import bpy

from pointmr_engine.scene.settings import (
    FILTERS,
    METHODS,
    PASSES,
    ForwardSettings,
    RaytraceSettings,
    RenderSettings,
)

from .. import preferences

# engine's name -> property of scene.pointmr
PLAIN = {
    "samples": "samples",
    "max_bounces": "max_bounces",
    "diffuse_bounces": "diffuse_bounces",
    "glossy_bounces": "glossy_bounces",
    "transmission_bounces": "transmission_bounces",
    "transparent_max_bounces": "transparent_max_bounces",
    "film_exposure": "film_exposure",
    "clamp_direct": "sample_clamp_direct",
    "clamp_indirect": "sample_clamp_indirect",
    "caustics_reflective": "caustics_reflective",
    "caustics_refractive": "caustics_refractive",
    "filter_glossy": "blur_glossy",
    "filter_width": "filter_width",
}


def render_settings(scene, view_layer=None, *, report=None) -> RenderSettings:
    """The engine's settings; see `settings_from_blender`."""
    render = scene.render
    settings = RenderSettings()
    settings.width, settings.height = image_size(render)
    settings.pixel_aspect = render.pixel_aspect_x / render.pixel_aspect_y
    settings.region = region(render)
    settings.film_transparent = render.film_transparent
    settings.threads = render.threads if render.threads_mode == "FIXED" else 0
    settings.processes = bpy.app.background
    own = getattr(scene, "pointmr", None)
    if own is not None:
        for name, source in PLAIN.items():
            if hasattr(own, source):
                setattr(settings, name, getattr(own, source))
        settings.method = known(own.method.lower(), METHODS, settings.method, "method", report)
        settings.pixel_filter = known(
            own.pixel_filter_type.lower(), FILTERS, settings.pixel_filter, "pixel filter", report
        )
        settings.seed = animated_seed(own, scene)
        settings.forward = forward_settings(own)
        settings.raytrace = raytrace_settings(own)
    layer = view_layer if view_layer is not None else scene.view_layers[0]
    if getattr(layer, "samples", 0) > 0:
        settings.samples = layer.samples
    settings.passes = layer_passes(layer)
    return settings


# fields of the engine's ForwardSettings; the properties of scene.pointmr are called forward_...
FORWARD_NUMBERS = ("samples_per_pixel", "epsilon", "failure")
FORWARD_CHOICES = ("sampling", "draws", "strategy", "reconstruction", "shading")
FORWARD_SWITCHES = ("shadows", "backface_culling", "occlusion_culling")


def forward_settings(own) -> ForwardSettings:
    """Forward mapping's part of the settings, of scene.pointmr."""
    values = {name: getattr(own, f"forward_{name}") for name in FORWARD_NUMBERS + FORWARD_SWITCHES}
    values |= {name: getattr(own, f"forward_{name}").lower() for name in FORWARD_CHOICES}
    folder = preferences.sample_folder() if own.forward_keep_sets else None
    return ForwardSettings(**values, subpixels=int(own.forward_subpixels), cache_folder=folder)


def raytrace_settings(own) -> RaytraceSettings:
    """Multi-resolution raytracing's part of the settings, of scene.pointmr."""
    return RaytraceSettings(
        cones=int(own.raytrace_cones),
        footprint=own.raytrace_footprint,
        secondary=own.raytrace_secondary.lower(),
        visibility=own.raytrace_visibility.lower(),
        cache_folder=preferences.sample_folder() if own.raytrace_keep_sets else None,
    )


def known(value: str, choices: tuple[str, ...], default: str, what: str, report) -> str:
    """`value`, or `default` and a warning where the engine does not have it."""
    if value in choices:
        return value
    if report is not None:
        report("WARNING", f"{what} '{value}' is not available; '{default}' is used")
    return default


def animated_seed(own, scene) -> int:
    """The seed, another one for each frame if it is animated."""
    if not getattr(own, "use_animated_seed", False):
        return own.seed
    return (own.seed + scene.frame_current * 0x9E3779B1 + int(scene.frame_subframe * 0x7FFFFFFF)) & 0x7FFFFFFF


def image_size(render) -> tuple[int, int]:
    """(width, height) of the whole image in pixels, before any border."""
    scale = render.resolution_percentage
    return max(render.resolution_x * scale // 100, 1), max(render.resolution_y * scale // 100, 1)


def region(render) -> tuple[int, int, int, int] | None:
    """The render border in pixels, rounded as Blender does, at least one pixel; None without a border.

    With `use_crop_to_border` the image is the region; without, the rest of the image stays empty.
    """
    if not render.use_border:
        return None
    width, height = image_size(render)
    x0, x1 = border(render.border_min_x, render.border_max_x, width)
    y0, y1 = border(render.border_min_y, render.border_max_y, height)
    return x0, y0, x1, y1


def border(low: float, high: float, size: int) -> tuple[int, int]:
    """One side of the border in pixels."""
    start = min(max(math.floor(low * size + 1e-4), 0), size - 1)
    stop = min(max(math.floor(high * size + 1e-4), start + 1), size)
    return start, stop


def layer_passes(layer) -> tuple[str, ...]:
    """The engine's passes for a view layer's."""
    wanted = {
        "combined": True,
        "depth": layer.use_pass_z,
        "position": layer.use_pass_position,
        "normal": layer.use_pass_normal,
        "diffuse_color": layer.use_pass_diffuse_color,
        "emission": layer.use_pass_emit,
        "object_index": layer.use_pass_object_index,
        "material_index": layer.use_pass_material_index,
        "sample_count": getattr(getattr(layer, "pointmr", None), "pass_debug_sample_count", False),
    }
    return tuple(p for p in PASSES if wanted.get(p, False))
