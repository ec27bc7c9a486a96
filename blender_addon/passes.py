"""The passes of a view layer: one list, for registering them with Blender, for asking the engine, and for
writing results.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import bpy


class RenderPass(NamedTuple):
    """name: Blender's. key: the engine's, in `Frame.passes`. channels: one letter each. kind: "COLOR",
    "VECTOR" or "VALUE".
    """

    name: str
    key: str
    channels: str
    kind: str


def list_passes(view_layer: bpy.types.ViewLayer) -> Iterator[RenderPass]:
    """Every pass that `view_layer` asks for and the engine has, Combined first."""
    # Blender 5.0 spelled out the names that earlier versions abbreviate; compositor files rely on each
    # version's own.
    long = bpy.app.version >= (5, 0, 0)
    yield RenderPass("Combined", "combined", "RGBA", "COLOR")
    if view_layer.use_pass_z:
        yield RenderPass("Depth", "depth", "Z", "VALUE")
    if view_layer.use_pass_position:
        yield RenderPass("Position", "position", "XYZ", "VECTOR")
    if view_layer.use_pass_normal:
        yield RenderPass("Normal", "normal", "XYZ", "VECTOR")
    if view_layer.use_pass_object_index:
        yield RenderPass("Object Index" if long else "IndexOB", "object_index", "X", "VALUE")
    if view_layer.use_pass_material_index:
        yield RenderPass("Material Index" if long else "IndexMA", "material_index", "X", "VALUE")
    if view_layer.use_pass_diffuse_color:
        yield RenderPass("Diffuse Color" if long else "DiffCol", "diffuse_color", "RGB", "COLOR")
    if view_layer.use_pass_emit:
        yield RenderPass("Emission" if long else "Emit", "emission", "RGB", "COLOR")
    own = getattr(view_layer, "pointmr", None)
    if own is not None and own.pass_debug_sample_count:
        yield RenderPass("Debug Sample Count", "sample_count", "X", "VALUE")


def engine_passes(view_layer: bpy.types.ViewLayer) -> tuple[str, ...]:
    """The engine's keys of `list_passes`, for `RenderSettings.passes`."""
    return tuple(p.key for p in list_passes(view_layer))
