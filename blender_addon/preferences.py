"""The add-on's preferences: how the viewport renders, and where compiled kernels are kept."""

from __future__ import annotations

import bpy
from bpy.props import IntProperty

from . import kernel_cache


class POINTMR_OT_clear_kernel_cache(bpy.types.Operator):
    """Delete the compiled kernels; they are compiled again at the next render"""

    bl_idname = "pointmr.clear_kernel_cache"
    bl_label = "Clear Compiled Kernels"

    def execute(self, context):
        self.report({"INFO"}, f"Deleted {kernel_cache.clear()} files of compiled kernels")
        return {"FINISHED"}


class PointMRPreferences(bpy.types.AddonPreferences):
    """Preferences of the add-on, under Add-ons in Blender's preferences."""

    bl_idname = __package__

    viewport_threads: IntProperty(
        name="Viewport Threads",
        description="Threads that the rendered viewport may use; 0 leaves one core to Blender's own window",
        min=0,
        max=1024,
        default=0,
    )

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "viewport_threads")
        row = layout.row()
        row.label(text=f"Compiled kernels: {kernel_cache.folder()}")
        row.operator(POINTMR_OT_clear_kernel_cache.bl_idname, text="Clear")


def viewport_threads() -> int:
    """The preference, or its default where the add-on runs without preferences (the bpy module)."""
    addon = bpy.context.preferences.addons.get(__package__)
    return addon.preferences.viewport_threads if addon and addon.preferences else 0


classes = (POINTMR_OT_clear_kernel_cache, PointMRPreferences)
register, unregister = bpy.utils.register_classes_factory(classes)
