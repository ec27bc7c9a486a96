"""Object tab: visibility to cameras and rays, and PointMR's instancer."""

from __future__ import annotations

import bpy
from bl_ui.properties_object import has_geometry_visibility
from bpy.types import Panel

from .. import instancer
from .common import PointMRPanel, split_layout


class ObjectPanel(PointMRPanel):
    bl_context = "object"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.object is not None


class POINTMR_OBJECT_PT_instancer(ObjectPanel, Panel):
    bl_label = "PointMR Instancer"

    def draw(self, context):
        instancer.draw_panel(split_layout(self), context)


class POINTMR_OBJECT_PT_visibility(ObjectPanel, Panel):
    bl_label = "Visibility"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, ob = split_layout(self), context.object
        layout.prop(ob, "hide_select", text="Selectable", invert_checkbox=True, toggle=False)
        col = layout.column(heading="Show In")
        col.prop(ob, "hide_viewport", text="Viewports", invert_checkbox=True, toggle=False)
        col.prop(ob, "hide_render", text="Renders", invert_checkbox=True, toggle=False)
        if has_geometry_visibility(ob):
            col = layout.column(heading="Mask")
            col.prop(ob, "is_holdout")
            col.prop(ob, "is_shadow_catcher")
        elif ob.type == "LIGHT":
            layout.column(heading="Mask").prop(ob, "is_shadow_catcher")


class POINTMR_OBJECT_PT_ray_visibility(ObjectPanel, Panel):
    bl_label = "Ray Visibility"
    bl_parent_id = "POINTMR_OBJECT_PT_visibility"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and (
            has_geometry_visibility(context.object) or context.object.type == "LIGHT"
        )

    def draw(self, context):
        ob = context.object
        col = split_layout(self).column()
        for name in ("camera", "diffuse", "glossy", "transmission"):
            col.prop(ob, f"visible_{name}", text=name.capitalize())
        if ob.type != "LIGHT":
            col.prop(ob, "visible_shadow", text="Shadow")


classes = (POINTMR_OBJECT_PT_instancer, POINTMR_OBJECT_PT_visibility, POINTMR_OBJECT_PT_ray_visibility)
register, unregister = bpy.utils.register_classes_factory(classes)
