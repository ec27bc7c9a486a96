"""World tab: surface nodes, and what the sync reads of Cycles' world settings where Cycles is enabled."""

from __future__ import annotations

import bpy
from bpy.types import Panel

from .common import PointMRPanel, draw_node_input, split_layout


class WorldPanel(PointMRPanel):
    bl_context = "world"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.world is not None


class POINTMR_WORLD_PT_surface(WorldPanel, Panel):
    bl_label = "Surface"

    def draw(self, context):
        layout, world = self.layout, context.world
        layout.use_property_split = True
        if bpy.app.version < (5, 0, 0):
            layout.prop(world, "use_nodes", icon="NODETREE")
            layout.separator()
        if not draw_node_input(layout, world, "Surface"):
            layout.prop(world, "color")


class POINTMR_WORLD_PT_ray_visibility(WorldPanel, Panel):
    bl_label = "Ray Visibility"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return super().poll(context) and hasattr(context.world, "cycles_visibility")

    def draw(self, context):
        visibility = context.world.cycles_visibility
        col = split_layout(self).column()
        for name in ("camera", "diffuse", "glossy", "transmission"):
            col.prop(visibility, name)


class POINTMR_WORLD_PT_settings(WorldPanel, Panel):
    bl_label = "Settings"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return super().poll(context) and hasattr(context.world, "cycles")

    def draw(self, context):
        settings = context.world.cycles
        col = split_layout(self).column()
        col.prop(settings, "sampling_method", text="Sampling")
        sub = col.column()
        sub.active = settings.sampling_method == "MANUAL"
        sub.prop(settings, "sample_map_resolution")


classes = (POINTMR_WORLD_PT_surface, POINTMR_WORLD_PT_ray_visibility, POINTMR_WORLD_PT_settings)
register, unregister = bpy.utils.register_classes_factory(classes)
