"""The settings of forward mapping, `scene.pointmr.forward_...`: what is sampled, how it becomes an image, at what cost.

Names after the prefix are those of the engine's `ForwardSettings`. Enum items carry fixed numbers, which never change.
"""

from __future__ import annotations

from bpy.props import BoolProperty, EnumProperty, FloatProperty

SAMPLINGS = (
    (
        "STATIC",
        "Static",
        "Samples are made once, at every resolution, and taken from memory for each image: "
        "the fastest images, after a preparation that grows with the scene's different meshes",
        0,
    ),
    (
        "DYNAMIC",
        "Dynamic",
        "Samples are drawn from the triangles anew for each image: hardly any preparation or memory, slower images",
        1,
    ),
)

DRAWS = (
    ("RANDOM", "Random", "Independent points: needs the most of them for an image without holes", 0),
    ("STRATIFIED", "Stratified", "One point in each of many equal shares of the surface: fewer gaps", 1),
)

STRATEGIES = (
    ("RANDOM", "Random", "Random points: quick to prepare, the largest sample sets, holes are possible", 0),
    ("JITTERED_GRID", "Grid", "One random point in each cell of a grid: quick to prepare, many samples", 1),
    (
        "QUANTISED_GRID",
        "Quantised Grid",
        "The centre of each cell of a grid that the surface meets: a quarter of the grid's samples, "
        "but moved off the surface",
        2,
    ),
    (
        "NEIGHBOURHOOD",
        "Neighbourhood",
        "Points that others nearby already cover are left out: the fewest samples and so the fastest images, "
        "the longest preparation",
        3,
    ),
)

RECONSTRUCTIONS = (
    ("PIXEL", "Pixel", "Each pixel shows its nearest sample: fastest, with jagged edges", 0),
    (
        "GAUSSIAN",
        "Gaussian",
        "A Gaussian mean of the samples that are not hidden: smooth, a little blurred",
        1,
    ),
    (
        "SUBPIXEL",
        "Subpixel",
        "Samples are small ellipses in a depth buffer finer than the pixels: sharp edges that are smooth, "
        "at a cost that grows with the subpixels",
        2,
    ),
    (
        "ANALYTIC",
        "Analytic",
        "As Subpixel, but what is larger than a pixel is covered exactly, by its edges: the best image, the slowest",
        3,
    ),
)

SUBPIXELS = (
    (
        "2",
        "2 x 2",
        "4 depths for each pixel: twice as fast, for moving through a scene; edges are rougher",
        2,
    ),
    ("4", "4 x 4", "16 depths for each pixel", 4),
    ("8", "8 x 8", "64 depths for each pixel: finer edges, four times the memory", 8),
)

SHADINGS = (
    (
        "SIMPLE",
        "Simple",
        "Colours are evaluated once, when the samples are made, and lit as matte surfaces: the fastest images; "
        "no reflections or highlights",
        0,
    ),
    ("FULL", "Full", "Materials are evaluated at what is visible, for this view: as in the other methods", 1),
)


class ForwardProperties:
    """Mixed into the scene's settings."""

    forward_sampling: EnumProperty(
        name="Sampling",
        description="Where the surface samples come from",
        items=SAMPLINGS,
        default="STATIC",
    )
    forward_samples_per_pixel: FloatProperty(
        name="Samples per Pixel",
        description="Surface samples for each pixel's area. More give a sharper and more exact image; "
        "time grows in proportion",
        min=0.05,
        max=64.0,
        soft_max=16.0,
        default=1.0,
    )
    forward_epsilon: FloatProperty(
        name="Depth Tolerance",
        description="How unevenly near and far parts of one box may be sampled. Larger values visit fewer boxes "
        "but draw up to this share of points more than needed",
        min=0.01,
        max=16.0,
        soft_max=2.0,
        default=0.5,
    )
    forward_failure: FloatProperty(
        name="Failure Probability",
        description="Probability that an image made of random samples has a hole. Smaller values take more samples",
        min=1e-9,
        max=0.5,
        default=1e-3,
        precision=6,
    )
    forward_draws: EnumProperty(
        name="Draws",
        description="How the points are spread over the surface",
        items=DRAWS,
        default="STRATIFIED",
    )
    forward_strategy: EnumProperty(
        name="Strategy",
        description="Which of many candidate points are kept as samples",
        items=STRATEGIES,
        default="NEIGHBOURHOOD",
    )
    forward_reconstruction: EnumProperty(
        name="Reconstruction",
        description="How projected samples become pixels",
        items=RECONSTRUCTIONS,
        default="SUBPIXEL",
    )
    forward_subpixels: EnumProperty(
        name="Subpixels",
        description="Resolution of the depth buffer within a pixel",
        items=SUBPIXELS,
        default="4",
    )
    forward_shading: EnumProperty(
        name="Shading",
        description="What is evaluated of materials for each image",
        items=SHADINGS,
        default="FULL",
    )
    forward_shadows: BoolProperty(
        name="Shadows",
        description="Shadows by depth maps, for which the scene is sampled once more from each lamp",
        default=True,
    )
    forward_backface_culling: BoolProperty(
        name="Backface Culling",
        description="Leave out surfaces seen from behind: half the samples of closed objects, "
        "but open surfaces vanish from that side",
        default=False,
    )
    forward_occlusion_culling: BoolProperty(
        name="Occlusion Culling",
        description="Leave out what lies hidden behind nearer objects. The image is the same, "
        "and sooner done where much is hidden",
        default=True,
    )
    forward_keep_sets: BoolProperty(
        name="Keep Samples on Disk",
        description="Write sample sets to disk, so that the next render of the same meshes need not make them again. "
        "Their folder is set in the add-on's preferences",
        default=False,
    )
