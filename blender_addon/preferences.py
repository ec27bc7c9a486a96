"""The add-on's preferences: how the viewport renders, and where compiled kernels and sample sets are kept."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, IntProperty, StringProperty

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
    compile_ahead: BoolProperty(
        name="Compile Ahead",
        description="Compile what is missing in the background after Blender has started, before a render needs it",
        default=True,
    )
    sample_folder: StringProperty(
        name="Sample Sets",
        description="Folder for the sample sets of scenes that keep them; empty: a folder in the user's cache",
        subtype="DIR_PATH",
        default="",
    )

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "viewport_threads")
        layout.prop(self, "compile_ahead")
        layout.prop(self, "sample_folder", placeholder=default_sample_folder())
        row = layout.row()
        row.label(text=f"Compiled kernels: {kernel_cache.folder()}")
        row.operator(POINTMR_OT_clear_kernel_cache.bl_idname, text="Clear")


def viewport_threads() -> int:
    """The preference, or its default where the add-on runs without preferences (the bpy module)."""
    found = _found()
    return found.viewport_threads if found else 0


def compile_ahead() -> bool:
    """Whether kernels may be compiled before a render needs them."""
    found = _found()
    return found.compile_ahead if found else False


def sample_folder() -> str:
    """The folder for sample sets that outlast a run: the preference, or else one in the user's cache."""
    found = _found()
    chosen = found.sample_folder if found else ""
    return bpy.path.abspath(chosen) if chosen else default_sample_folder()


def default_sample_folder() -> str:
    return str(kernel_cache.user_cache_folder() / "pointmr" / "samples")


def _found() -> PointMRPreferences | None:
    addon = bpy.context.preferences.addons.get(__package__)
    return addon.preferences if addon else None


classes = (POINTMR_OT_clear_kernel_cache, PointMRPreferences)
register, unregister = bpy.utils.register_classes_factory(classes)
