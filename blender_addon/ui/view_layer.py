"""View layer tab: the passes."""

from __future__ import annotations

import bpy
from bpy.types import Panel

from .common import PointMRPanel, split_layout


class POINTMR_RENDER_PT_passes(PointMRPanel, Panel):
    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context):
        pass


class POINTMR_RENDER_PT_passes_data(PointMRPanel, Panel):
    bl_label = "Data"
    bl_context = "view_layer"
    bl_parent_id = "POINTMR_RENDER_PT_passes"

    def draw(self, context):
        layer = context.view_layer
        layout = split_layout(self)
        col = layout.column(heading="Include", align=True)
        col.prop(layer, "use_pass_combined")
        col.prop(layer, "use_pass_z")
        col.prop(layer, "use_pass_position")
        col.prop(layer, "use_pass_normal")
        col = layout.column(heading="Indexes", align=True)
        col.prop(layer, "use_pass_object_index")
        col.prop(layer, "use_pass_material_index")
        col = layout.column(heading="Debug", align=True)
        col.prop(layer.pointmr, "pass_debug_sample_count")


class POINTMR_RENDER_PT_passes_light(PointMRPanel, Panel):
    bl_label = "Light"
    bl_context = "view_layer"
    bl_parent_id = "POINTMR_RENDER_PT_passes"

    def draw(self, context):
        layer = context.view_layer
        layout = split_layout(self)
        layout.column(heading="Diffuse", align=True).prop(layer, "use_pass_diffuse_color", text="Color")
        layout.column(heading="Other", align=True).prop(layer, "use_pass_emit", text="Emission")


classes = (POINTMR_RENDER_PT_passes, POINTMR_RENDER_PT_passes_data, POINTMR_RENDER_PT_passes_light)
register, unregister = bpy.utils.register_classes_factory(classes)
