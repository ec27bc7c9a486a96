"""The settings of multi-resolution raytracing, `scene.pointmr.raytrace_...`: how many cones, how fine.

Names after the prefix are those of the engine's `RaytraceSettings`. Enum items carry fixed numbers, which never change.
"""

from __future__ import annotations

from bpy.props import BoolProperty, EnumProperty, FloatProperty

CONES = (
    ("1", "1", "One cone as wide as the pixel: smooth edges and soft shadows without noise, the fastest", 1),
    ("4", "4", "Four narrower cones: a more exact image, at about four times the time", 4),
    ("16", "16", "Sixteen cones: final images with fine detail, hair or sharp reflections", 16),
    ("64", "64", "Sixty-four cones: as a reference", 64),
)

SECONDARY = (
    (
        "CONES",
        "Cones",
        "One widening cone for each lamp and reflection: free of noise; "
        "very soft shadows and blurry reflections are smooth approximations",
        0,
    ),
    (
        "RAYS",
        "Rays",
        "Exact random rays, as in the Distributed method: shadows and reflections are unbiased, but noisy "
        "with few cones per pixel",
        1,
    ),
)


VISIBILITY = (
    (
        "MASKS",
        "Masks",
        "A depth buffer of 8 x 8 subpixels in each cone: what hides what is known exactly",
        0,
    ),
    (
        "ALPHA",
        "Alpha",
        "Surfaces in a cone are blended by how much of it each covers, as if they were independent of each other. "
        "With depth of field, masks are used",
        1,
    ),
)


class RaytraceProperties:
    """Mixed into the scene's settings."""

    raytrace_cones: EnumProperty(
        name="Cones per Pixel",
        description="Cones that each pixel is divided among. More are narrower and see finer detail apart; "
        "one already gives an image without jagged edges",
        items=CONES,
        default="1",
    )
    raytrace_preview_cones: EnumProperty(
        name="Viewport Cones per Pixel",
        description="Cones for each pixel that the viewport ends with when nothing moves",
        items=CONES,
        default="4",
    )
    raytrace_footprint: FloatProperty(
        name="Footprint",
        description="Size of the smallest detail that is looked at, against the size of a cone. "
        "Below 1 images are sharper and take longer, above 1 smoother and sooner done",
        min=0.25,
        max=4.0,
        soft_min=0.5,
        soft_max=2.0,
        default=1.0,
    )
    raytrace_secondary: EnumProperty(
        name="Shadows and Reflections",
        description="What finds shadows, reflections and refractions",
        items=SECONDARY,
        default="CONES",
    )
    raytrace_visibility: EnumProperty(
        name="Visibility",
        description="How cones from the camera find out what is in front",
        items=VISIBILITY,
        default="MASKS",
    )
    raytrace_keep_sets: BoolProperty(
        name="Keep Samples on Disk",
        description="Write sample sets to disk, so that the next render of the same meshes need not make them again. "
        "Their folder is set in the add-on's preferences",
        default=False,
    )
