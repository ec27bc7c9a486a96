"""Image and environment textures."""

from __future__ import annotations

import bpy
import numpy as np
from node_planes import Case, Tree

from node_cases.registry import CASES, case


def image(name: str, kind: str = "byte", alpha: bool = False) -> bpy.types.Image:
    """A small packed picture of smooth noise."""
    width, height = 24, 16
    rng = np.random.default_rng(7)
    values = rng.random((height, width, 4)).astype(np.float32)
    values[..., 3] = np.where(rng.random((height, width)) < 0.3, 0.4, 0.9) if alpha else 1.0
    found = bpy.data.images.new(name, width, height, alpha=alpha, float_buffer=kind == "float")
    found.pixels.foreach_set(values.ravel())
    found.update()
    found.pack()
    return found


def _image(
    projection: str = "FLAT", extension: str = "REPEAT", interpolation: str = "Linear", **options
) -> Case:
    def make(t: Tree):
        inputs = {0: t.coordinates(1.6)}
        node = t.node(
            "TexImage", inputs, projection=projection, extension=extension, interpolation=interpolation
        )
        node.projection_blend = options.get("blend", 0.0)
        name = f"{projection}{extension}{interpolation}{options}"
        node.image = image(name, options.get("kind", "byte"), options.get("alpha", False))
        if options.get("data"):
            node.image.colorspace_settings.name = "Non-Color"
        if options.get("mode"):
            node.image.alpha_mode = options["mode"]
        if options.get("use_alpha"):
            alpha = t.node("CombineXYZ", {0: node.outputs[1]}).outputs[0]
            return t.node("VectorMath", {0: node.outputs[0], 1: alpha}).outputs[0]
        return node.outputs[0]

    return make


for _extension in ("REPEAT", "EXTEND", "CLIP", "MIRROR"):
    CASES[f"image {_extension}"] = (_image(extension=_extension), 1e-4)
CASES["image closest"] = (_image(interpolation="Closest"), 1e-4)
for _extension in ("REPEAT", "EXTEND", "CLIP", "MIRROR"):
    CASES[f"image cubic {_extension}"] = (_image(extension=_extension, interpolation="Cubic"), 1e-4)
CASES["image smart"] = (_image(interpolation="Smart"), 1e-4)
CASES["image data"] = (_image(data=True), 1e-4)
CASES["image float"] = (_image(kind="float"), 1e-4)
CASES["image sphere"] = (_image("SPHERE"), 1e-3)
CASES["image tube"] = (_image("TUBE"), 1e-3)
CASES["image box"] = (_image("BOX"), 1e-4)
CASES["image box blend"] = (_image("BOX", blend=0.7), 1e-3)
for _mode in ("STRAIGHT", "CHANNEL_PACKED", "NONE"):
    CASES[f"image alpha {_mode}"] = (_image(alpha=True, mode=_mode), 6e-3)
    CASES[f"image alpha used {_mode}"] = (_image(alpha=True, mode=_mode, use_alpha=True), 6e-3)
CASES["image alpha float"] = (_image(alpha=True, kind="float", use_alpha=True), 1e-3)


@case("environment", 1e-3)
def _environment(t: Tree):
    node = t.node("TexEnvironment", {0: t.coordinates()})
    node.image = image("environment")
    return node.outputs[0]


@case("environment ball", 1e-3)
def _ball(t: Tree):
    node = t.node("TexEnvironment", {0: t.coordinates()}, projection="MIRROR_BALL")
    node.image = image("ball")
    return node.outputs[0]
