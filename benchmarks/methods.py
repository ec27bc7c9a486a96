"""The same scene set up for Cycles or for one of our methods: same film, bounces, threads; nothing left to chance."""

from __future__ import annotations

from dataclasses import dataclass

ENGINES = {"cycles": "CYCLES", "nothing": "JUDGE_NOTHING"}
OURS = ("conventional", "distributed", "raytrace", "forward")
CONES = (1, 4, 16, 64)
# raise when the settings below change what an image shows: cached references are then rendered anew
PROTOCOL = 3


@dataclass(frozen=True)
class Method:
    """A renderer and its samples (raytrace: cones) per pixel: "cycles", one of our methods, or "nothing": what Blender
    itself takes.
    """

    name: str
    samples: int

    @property
    def label(self) -> str:
        return self.name if self.name in ("conventional", "nothing") else f"{self.name}:{self.samples}"


def parse_methods(words: list[str]) -> list[Method]:
    """["distributed:64,256", "cycles:64", "raytrace:1,4"] -> Methods. Raises ValueError for what is unknown."""
    methods = []
    for word in words:
        name, _, counts = word.partition(":")
        if name not in (*OURS, "cycles", "nothing"):
            raise ValueError(f"method '{name}' is not one of cycles, nothing, {', '.join(OURS)}")
        found = [Method(name, int(c)) for c in (counts or "1").split(",")]
        for method in found:
            if name == "raytrace" and method.samples not in CONES:
                raise ValueError(f"{method.label}: cones per pixel are one of {', '.join(map(str, CONES))}")
        methods += found
    return methods


# What both renderers are told, under Cycles' names. A scene may override any of them.
SHARED = {
    "pixel_filter_type": "BLACKMAN_HARRIS",
    "filter_width": 1.5,
    "film_exposure": 1.0,
    "max_bounces": 12,
    "diffuse_bounces": 0,
    "glossy_bounces": 4,
    "transmission_bounces": 12,
    "volume_bounces": 0,
    "transparent_max_bounces": 8,
    "caustics_reflective": True,
    "caustics_refractive": True,
    "sample_clamp_direct": 0.0,
    "sample_clamp_indirect": 0.0,
    "blur_glossy": 0.0,
}

# What only Cycles has: every shortcut and every bias off, the light tree (its better sampler) on.
CYCLES_ONLY = {
    "device": "CPU",
    "use_adaptive_sampling": False,
    "use_denoising": False,
    "time_limit": 0.0,
    "use_sample_subset": False,
    "use_layer_samples": "IGNORE",
    "light_sampling_threshold": 0.0,
    "direct_light_sampling_type": "MULTIPLE_IMPORTANCE_SAMPLING",
    "use_light_tree": True,
    "min_light_bounces": 0,
    "min_transparent_bounces": 0,
    "use_guiding": False,
    "use_fast_gi": False,
    "scrambling_distance": 1.0,
    "auto_scrambling_distance": False,
    "use_camera_cull": False,
    "use_distance_cull": False,
    "rolling_shutter_type": "NONE",
    "texture_limit_render": "OFF",
    "use_animated_seed": False,
    "film_transparent_glass": False,
    "shading_system": False,
}


def add_bounces(parser) -> None:
    """The options `--max-bounces` and `--diffuse-bounces` of a command; see `bounces`."""
    parser.add_argument("--max-bounces", type=int)
    parser.add_argument("--diffuse-bounces", type=int, help="0 if not given: direct light alone")


def bounces(options) -> dict:
    """Overrides of the settings by what `add_bounces` has read."""
    given = {"max_bounces": options.max_bounces, "diffuse_bounces": options.diffuse_bounces}
    return {name: value for name, value in given.items() if value is not None}


def configure(scene, method: Method, seed: int, size, overrides: dict, threads: int) -> list[str]:
    """Set a bpy scene up for one render; returns the shared settings that the renderer has no property for.

    size: (width, height) in pixels, or None for the scene's own. threads: 0 for one per core.
    """
    render = scene.render
    render.engine = ENGINES.get(method.name, "POINTMR")
    if size:
        render.resolution_x, render.resolution_y = size
        render.resolution_percentage = 100
    render.use_persistent_data = False
    render.use_compositing = False
    render.use_sequencer = False
    render.use_motion_blur = False
    render.use_simplify = False
    render.use_multiview = False
    render.threads_mode = "FIXED" if threads else "AUTO"
    if threads:
        render.threads = threads
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"
    scene.view_settings.exposure, scene.view_settings.gamma = 0.0, 1.0

    if method.name == "nothing":
        return []
    settings = SHARED | overrides
    missing = []
    if method.name == "cycles":
        group = scene.cycles
        for name, value in (CYCLES_ONLY | settings).items():
            setattr(group, name, value)
    else:
        group = scene.pointmr
        group.method = method.name.upper()
        for name, value in settings.items():
            if hasattr(group, name):
                setattr(group, name, value)
            else:
                missing.append(name)
    group.seed = seed
    if method.name == "raytrace":
        group.raytrace_cones = str(method.samples)
    elif method.name == "forward":
        group.forward_samples_per_pixel = method.samples
    elif method.name != "conventional":
        group.samples = method.samples
    return missing


def write_exr_settings(scene, path: str) -> None:
    """Full-precision EXR of the combined pass, so that linear pixels come back as they were."""
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format = "OPEN_EXR"
    image.color_mode = "RGBA"
    image.color_depth = "32"
    image.exr_codec = "ZIP"
    scene.render.use_overwrite = True
    scene.render.use_file_extension = False
    scene.render.filepath = path


def read_exr(path: str):
    """Pixels (height, width, 4) float32, top row first, and the header of an RGBA EXR."""
    import numpy as np
    import OpenEXR

    with OpenEXR.File(path) as file:
        channels = file.channels()
        pixels = (
            channels["RGBA"].pixels if "RGBA" in channels else np.dstack([channels[c].pixels for c in "RGBA"])
        )
        return np.ascontiguousarray(pixels, dtype=np.float32), dict(file.header())
