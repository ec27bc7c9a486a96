"""Operators: a scene made for Cycles takes its light paths, film and seed over to PointMR."""

from __future__ import annotations

import bpy
from bpy.types import Operator

# properties that mean the same in scene.cycles and scene.pointmr. Numbers of samples do not: a cone is no sample.
SHARED_WITH_CYCLES = (
    "max_bounces",
    "diffuse_bounces",
    "glossy_bounces",
    "transmission_bounces",
    "transparent_max_bounces",
    "caustics_reflective",
    "caustics_refractive",
    "blur_glossy",
    "sample_clamp_direct",
    "sample_clamp_indirect",
    "pixel_filter_type",
    "filter_width",
    "film_exposure",
    "seed",
    "use_animated_seed",
)


def take_from_cycles(scene) -> list[str]:
    """Set what scene.pointmr shares with scene.cycles to its values; returns the names of what changed.

    Raises ValueError where Cycles is not enabled: the scene has no such settings then.
    """
    cycles, own = getattr(scene, "cycles", None), scene.pointmr
    if cycles is None:
        raise ValueError(f"scene '{scene.name}' has no Cycles settings: the Cycles add-on is not enabled")
    changed = []
    for name in SHARED_WITH_CYCLES:
        value = getattr(cycles, name, None)  # Blender versions differ
        if value is not None and value != getattr(own, name):
            setattr(own, name, value)
            changed.append(name)
    return changed


class POINTMR_OT_take_from_cycles(Operator):
    bl_idname = "pointmr.take_from_cycles"
    bl_label = "Take from Cycles"
    bl_description = (
        "Set bounces, caustics, Filter Glossy, clamping, pixel filter, exposure and seed as Cycles has them in this "
        "scene"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return hasattr(context.scene, "cycles")

    def execute(self, context):
        own = context.scene.pointmr
        changed = take_from_cycles(context.scene)
        labels = [own.bl_rna.properties[name].name for name in changed]
        self.report({"INFO"}, f"Taken from Cycles: {', '.join(labels)}" if labels else "All is as in Cycles")
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((POINTMR_OT_take_from_cycles,))
