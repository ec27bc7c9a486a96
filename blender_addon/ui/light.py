"""Light data tab, in the layout that artists know from Cycles. Fields that a Blender version lacks are left
out.
"""

from __future__ import annotations

import bpy
from bpy.types import Panel

from .common import PointMRPanel, split_layout


class LightPanel(PointMRPanel):
    bl_context = "data"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.light is not None


def prop_if_present(layout, data, name, **options):
    """Draw a property that only newer versions of Blender have."""
    if name in data.bl_rna.properties:
        layout.prop(data, name, **options)


class POINTMR_LIGHT_PT_light(LightPanel, Panel):
    bl_label = "Light"

    def draw(self, context):
        layout, light = self.layout, context.light
        layout.row().prop(light, "type", expand=True)
        layout.use_property_split = True
        col = layout.column()
        if "use_temperature" in light.bl_rna.properties:
            row = col.column(align=True, heading="Temperature").row(align=True)
            row.use_property_decorate = False
            row.prop(light, "use_temperature", text="")
            sub = row.row()
            sub.active = light.use_temperature
            sub.prop(light, "temperature", text="")
            col.prop(light, "color", text="Tint" if light.use_temperature else "Color")
        else:
            col.prop(light, "color")
        layout.separator()
        col = layout.column()
        col.prop(light, "energy")
        prop_if_present(col, light, "exposure")
        prop_if_present(col, light, "normalize")
        layout.separator()
        col = layout.column()
        if light.type in {"POINT", "SPOT"}:
            col.prop(light, "shadow_soft_size", text="Radius")
            prop_if_present(col, light, "use_soft_falloff")
        elif light.type == "SUN":
            col.prop(light, "angle")
        elif light.type == "AREA":
            col.prop(light, "shape", text="Shape")
            sub = col.column(align=True)
            if light.shape in {"SQUARE", "DISK"}:
                sub.prop(light, "size")
            else:
                sub.prop(light, "size", text="Size X")
                sub.prop(light, "size_y", text="Y")


class POINTMR_LIGHT_PT_beam_shape(LightPanel, Panel):
    bl_label = "Beam Shape"
    bl_parent_id = "POINTMR_LIGHT_PT_light"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.light.type in {"SPOT", "AREA"}

    def draw(self, context):
        layout, light = self.layout, context.light
        layout.use_property_split = True
        col = layout.column()
        if light.type == "SPOT":
            col.prop(light, "spot_size", text="Angle")
            col.prop(light, "spot_blend", text="Blend", slider=True)
            col.prop(light, "show_cone")
        else:
            prop_if_present(col, light, "spread", text="Spread")


class POINTMR_LIGHT_PT_settings(LightPanel, Panel):
    bl_label = "Settings"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, light = split_layout(self), context.light
        layout.prop(light, "use_shadow", text="Cast Shadow")
        if hasattr(light, "cycles"):
            layout.prop(light.cycles, "use_multiple_importance_sampling", text="Multiple Importance")


classes = (POINTMR_LIGHT_PT_light, POINTMR_LIGHT_PT_beam_shape, POINTMR_LIGHT_PT_settings)
register, unregister = bpy.utils.register_classes_factory(classes)
