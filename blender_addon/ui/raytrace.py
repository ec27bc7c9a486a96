"""Render tab: multi-resolution raytracing's own panel. How many cones a pixel gets is in the Sampling panels."""

from __future__ import annotations

from bpy.types import Panel

from .common import PointMRPanel, split_layout


class POINTMR_RENDER_PT_raytrace(PointMRPanel, Panel):
    bl_label = "Raytracing"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.scene.pointmr.method == "RAYTRACE"

    def draw(self, context):
        settings = context.scene.pointmr
        layout = split_layout(self)
        layout.prop(settings, "raytrace_footprint")
        layout.row().prop(settings, "raytrace_secondary", text="Reflections", expand=True)
        layout.row().prop(settings, "raytrace_visibility", expand=True)
        layout.prop(settings, "raytrace_keep_sets")


classes = (POINTMR_RENDER_PT_raytrace,)
