"""Material tab: surface nodes and settings. Slots and preview are Blender's own panels."""

from __future__ import annotations

import bpy
from bpy.types import Panel

from .common import PointMRPanel, draw_node_input, split_layout


class MaterialPanel(PointMRPanel):
    bl_context = "material"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.material is not None and not context.material.grease_pencil


class POINTMR_MATERIAL_PT_surface(MaterialPanel, Panel):
    bl_label = "Surface"

    def draw(self, context):
        layout, material = self.layout, context.material
        layout.use_property_split = True
        if bpy.app.version < (5, 0, 0):  # from 5.0 on, materials always have nodes
            layout.prop(material, "use_nodes", icon="NODETREE")
            layout.separator()
        if not draw_node_input(layout, material, "Surface"):
            layout.prop(material, "diffuse_color", text="Base Color")
            layout.prop(material, "metallic")
            layout.prop(material, "specular_intensity", text="Specular")
            layout.prop(material, "roughness")


class POINTMR_MATERIAL_PT_settings(MaterialPanel, Panel):
    bl_label = "Settings"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, material = split_layout(self), context.material
        layout.prop(material, "pass_index")
        if hasattr(material, "cycles"):
            layout.prop(material.cycles, "emission_sampling")


classes = (POINTMR_MATERIAL_PT_surface, POINTMR_MATERIAL_PT_settings)
register, unregister = bpy.utils.register_classes_factory(classes)
