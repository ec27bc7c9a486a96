"""What users set: `scene.pointmr` (the render settings) and `view_layer.pointmr` (passes beyond Blender's
own).

Names follow Cycles where the meaning is the same, so that scripts and habits carry over. Enum items carry
fixed numbers: files store the number, so an item's number never changes.
"""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty

from .forward_properties import ForwardProperties
from .raytrace_properties import RaytraceProperties

METHODS = (
    (
        "RAYTRACE",
        "Raytracing",
        "Cones as wide as pixels meet surfaces at the resolution that the image can show: "
        "smooth edges, soft shadows and reflections without noise, for scenes of any size",
        0,
    ),
    ("CONVENTIONAL", "Conventional", "One ray through the centre of each pixel: fast, sharp, aliased", 2),
    ("DISTRIBUTED", "Distributed", "Many random rays per pixel over filter, lens, lights and reflections", 3),
    (
        "FORWARD",
        "Forward Mapping",
        "Surface samples, as many as the image can show, are projected onto it: "
        "time depends on the image rather than on the scene; no reflections of other objects",
        1,
    ),
)

PIXEL_FILTERS = (
    ("BOX", "Box", "Box filter, one pixel wide", 0),
    ("GAUSSIAN", "Gaussian", "Gaussian filter", 1),
    ("BLACKMAN_HARRIS", "Blackman-Harris", "Blackman-Harris filter", 2),
)


class PointMRSceneSettings(RaytraceProperties, ForwardProperties, bpy.types.PropertyGroup):
    """Render settings of a scene, at `scene.pointmr`."""

    method: EnumProperty(
        name="Method",
        description="How an image is made from the scene",
        items=METHODS,
        default="RAYTRACE",
    )
    samples: IntProperty(
        name="Samples",
        description="Number of samples to render for each pixel",
        min=1,
        soft_max=4096,
        max=1 << 24,
        default=128,
    )
    preview_samples: IntProperty(
        name="Viewport Samples",
        description="Number of samples to render for each pixel in the viewport",
        min=1,
        soft_max=1024,
        max=1 << 24,
        default=32,
    )
    seed: IntProperty(
        name="Seed",
        description="Seed of the random numbers; the same seed gives the same image",
        min=0,
        default=0,
    )
    use_animated_seed: BoolProperty(
        name="Use Animated Seed",
        description="Use different seed values, and hence noise patterns, at different frames",
        default=False,
    )
    pixel_filter_type: EnumProperty(
        name="Filter Type",
        description="Pixel filter type",
        items=PIXEL_FILTERS,
        default="BLACKMAN_HARRIS",
    )
    filter_width: FloatProperty(
        name="Filter Width",
        description="Pixel filter width",
        min=0.01,
        max=10.0,
        default=1.5,
        subtype="PIXEL",
    )
    max_bounces: IntProperty(
        name="Max Bounces",
        description="Total maximum number of bounces",
        min=0,
        max=1024,
        default=12,
    )
    diffuse_bounces: IntProperty(
        name="Diffuse Bounces",
        description="Maximum number of diffuse reflection bounces, bounded by total maximum. None: direct light alone",
        min=0,
        max=1024,
        default=0,
    )
    glossy_bounces: IntProperty(
        name="Glossy Bounces",
        description="Maximum number of glossy reflection bounces, bounded by total maximum",
        min=0,
        max=1024,
        default=4,
    )
    transmission_bounces: IntProperty(
        name="Transmission Bounces",
        description="Maximum number of transmission bounces, bounded by total maximum",
        min=0,
        max=1024,
        default=12,
    )
    transparent_max_bounces: IntProperty(
        name="Transparent Max Bounces",
        description="Number of transparent surfaces that a ray passes, independent of other bounces",
        min=0,
        max=1024,
        default=8,
    )
    caustics_reflective: BoolProperty(
        name="Reflective Caustics",
        description="Light that reaches rough surfaces by way of reflections",
        default=True,
    )
    caustics_refractive: BoolProperty(
        name="Refractive Caustics",
        description="Light that reaches rough surfaces by way of refractions",
        default=True,
    )
    blur_glossy: FloatProperty(
        name="Filter Glossy",
        description="Make surfaces rougher that are seen by way of rough ones, so that less noise of caustics is "
        "left; less exact. None: as they are",
        min=0.0,
        max=10.0,
        default=1.0,
    )
    film_exposure: FloatProperty(
        name="Exposure",
        description="Image brightness scale",
        min=0.0,
        soft_max=2.0,
        max=10.0,
        default=1.0,
    )
    sample_clamp_direct: FloatProperty(
        name="Clamp Direct",
        description="If not zero, the maximum value of a direct sample; less noise, but less exact",
        min=0.0,
        max=1e8,
        default=0.0,
    )
    sample_clamp_indirect: FloatProperty(
        name="Clamp Indirect",
        description="If not zero, the maximum value of an indirect sample; less noise, but less exact",
        min=0.0,
        max=1e8,
        default=0.0,
    )


class PointMRViewLayerSettings(bpy.types.PropertyGroup):
    """Settings of a view layer, at `view_layer.pointmr`."""

    pass_debug_sample_count: BoolProperty(
        name="Sample Count",
        description="Number of samples that each pixel received",
        default=False,
    )


classes = (PointMRSceneSettings, PointMRViewLayerSettings)


def register() -> None:
    for cls in classes:
        bpy.utils.register_class(cls)
    bpy.types.Scene.pointmr = PointerProperty(type=PointMRSceneSettings)
    bpy.types.ViewLayer.pointmr = PointerProperty(type=PointMRViewLayerSettings)


def unregister() -> None:
    del bpy.types.ViewLayer.pointmr
    del bpy.types.Scene.pointmr
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
