"""Render tab: method, sampling, light paths, film, performance. Laid out as Cycles' panels are."""

from __future__ import annotations

import bpy
from bpy.types import Panel

from . import forward, raytrace
from .common import PointMRPanel, split_layout


class POINTMR_RENDER_PT_sampling(PointMRPanel, Panel):
    bl_label = "Sampling"

    def draw(self, context):
        split_layout(self).prop(context.scene.pointmr, "method")


class POINTMR_RENDER_PT_sampling_viewport(PointMRPanel, Panel):
    bl_label = "Viewport"
    bl_parent_id = "POINTMR_RENDER_PT_sampling"

    def draw(self, context):
        settings = context.scene.pointmr
        layout = split_layout(self)
        if settings.method == "RAYTRACE":
            layout.row().prop(settings, "raytrace_preview_cones", text="Cones per Pixel", expand=True)
        else:
            layout.prop(settings, "preview_samples", text="Samples")


class POINTMR_RENDER_PT_sampling_render(PointMRPanel, Panel):
    bl_label = "Render"
    bl_parent_id = "POINTMR_RENDER_PT_sampling"

    def draw(self, context):
        settings = context.scene.pointmr
        layout = split_layout(self)
        layout.active = settings.method != "CONVENTIONAL"
        if settings.method == "RAYTRACE":
            layout.row().prop(settings, "raytrace_cones", text="Cones per Pixel", expand=True)
        elif settings.method == "FORWARD":
            layout.prop(settings, "forward_samples_per_pixel", text="Samples per Pixel")
        else:
            layout.prop(settings, "samples", text="Samples")


class POINTMR_RENDER_PT_sampling_advanced(PointMRPanel, Panel):
    bl_label = "Advanced"
    bl_parent_id = "POINTMR_RENDER_PT_sampling"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        settings = context.scene.pointmr
        row = split_layout(self).row(align=True)
        row.prop(settings, "seed")
        row.prop(settings, "use_animated_seed", text="", icon="TIME")


class POINTMR_RENDER_PT_light_paths(PointMRPanel, Panel):
    bl_label = "Light Paths"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.scene.pointmr.method != "FORWARD"  # which follows no rays

    def draw(self, context):
        self.layout.operator("pointmr.take_from_cycles", icon="IMPORT")


class POINTMR_RENDER_PT_light_paths_max_bounces(PointMRPanel, Panel):
    bl_label = "Max Bounces"
    bl_parent_id = "POINTMR_RENDER_PT_light_paths"

    def draw(self, context):
        settings = context.scene.pointmr
        layout = split_layout(self)
        layout.column(align=True).prop(settings, "max_bounces", text="Total")
        col = layout.column(align=True)
        col.prop(settings, "diffuse_bounces", text="Diffuse")
        col.prop(settings, "glossy_bounces", text="Glossy")
        col.prop(settings, "transmission_bounces", text="Transmission")
        layout.column(align=True).prop(settings, "transparent_max_bounces", text="Transparent")


class POINTMR_RENDER_PT_light_paths_clamping(PointMRPanel, Panel):
    bl_label = "Clamping"
    bl_parent_id = "POINTMR_RENDER_PT_light_paths"

    def draw(self, context):
        settings = context.scene.pointmr
        col = split_layout(self).column(align=True)
        col.prop(settings, "sample_clamp_direct", text="Direct Light")
        col.prop(settings, "sample_clamp_indirect", text="Indirect Light")


class POINTMR_RENDER_PT_light_paths_caustics(PointMRPanel, Panel):
    bl_label = "Caustics"
    bl_parent_id = "POINTMR_RENDER_PT_light_paths"

    def draw(self, context):
        settings = context.scene.pointmr
        layout = split_layout(self)
        layout.prop(settings, "blur_glossy")
        col = layout.column(heading="Caustics", align=True)
        col.prop(settings, "caustics_reflective", text="Reflective")
        col.prop(settings, "caustics_refractive", text="Refractive")


class POINTMR_RENDER_PT_simplify(PointMRPanel, Panel):
    bl_label = "Simplify"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context):
        self.layout.prop(context.scene.render, "use_simplify", text="")

    def draw(self, context):
        pass


class POINTMR_RENDER_PT_simplify_viewport(PointMRPanel, Panel):
    bl_label = "Viewport"
    bl_parent_id = "POINTMR_RENDER_PT_simplify"

    def draw(self, context):
        render = context.scene.render
        layout = split_layout(self)
        layout.active = render.use_simplify
        layout.prop(render, "simplify_subdivision", text="Max Subdivision")
        layout.prop(render, "simplify_child_particles", text="Child Particles")


class POINTMR_RENDER_PT_simplify_render(PointMRPanel, Panel):
    bl_label = "Render"
    bl_parent_id = "POINTMR_RENDER_PT_simplify"

    def draw(self, context):
        render = context.scene.render
        layout = split_layout(self)
        layout.active = render.use_simplify
        layout.prop(render, "simplify_subdivision_render", text="Max Subdivision")
        layout.prop(render, "simplify_child_particles_render", text="Child Particles")


class POINTMR_RENDER_PT_film(PointMRPanel, Panel):
    bl_label = "Film"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout = split_layout(self)
        layout.prop(context.scene.pointmr, "film_exposure")
        layout.prop(context.scene.render, "film_transparent", text="Transparent")


class POINTMR_RENDER_PT_film_pixel_filter(PointMRPanel, Panel):
    bl_label = "Pixel Filter"
    bl_parent_id = "POINTMR_RENDER_PT_film"

    def draw(self, context):
        settings = context.scene.pointmr
        col = split_layout(self).column()
        col.active = settings.method != "CONVENTIONAL"
        col.prop(settings, "pixel_filter_type", text="Type")
        if settings.pixel_filter_type != "BOX":
            col.prop(settings, "filter_width", text="Width")


class POINTMR_RENDER_PT_performance(PointMRPanel, Panel):
    bl_label = "Performance"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        pass


class POINTMR_RENDER_PT_performance_threads(PointMRPanel, Panel):
    bl_label = "Threads"
    bl_parent_id = "POINTMR_RENDER_PT_performance"

    def draw(self, context):
        render = context.scene.render
        col = split_layout(self).column()
        col.prop(render, "threads_mode")
        sub = col.column(align=True)
        sub.enabled = render.threads_mode == "FIXED"
        sub.prop(render, "threads")


class POINTMR_RENDER_PT_performance_final_render(PointMRPanel, Panel):
    bl_label = "Final Render"
    bl_parent_id = "POINTMR_RENDER_PT_performance"

    def draw(self, context):
        split_layout(self).prop(context.scene.render, "use_persistent_data", text="Persistent Data")


class POINTMR_RENDER_PT_performance_viewport(PointMRPanel, Panel):
    bl_label = "Viewport"
    bl_parent_id = "POINTMR_RENDER_PT_performance"

    def draw(self, context):
        split_layout(self).prop(context.scene.render, "preview_pixel_size", text="Pixel Size")


classes = (
    POINTMR_RENDER_PT_sampling,
    POINTMR_RENDER_PT_sampling_viewport,
    POINTMR_RENDER_PT_sampling_render,
    POINTMR_RENDER_PT_sampling_advanced,
    *raytrace.classes,
    *forward.classes,
    POINTMR_RENDER_PT_light_paths,
    POINTMR_RENDER_PT_light_paths_max_bounces,
    POINTMR_RENDER_PT_light_paths_clamping,
    POINTMR_RENDER_PT_light_paths_caustics,
    POINTMR_RENDER_PT_simplify,
    POINTMR_RENDER_PT_simplify_viewport,
    POINTMR_RENDER_PT_simplify_render,
    POINTMR_RENDER_PT_film,
    POINTMR_RENDER_PT_film_pixel_filter,
    POINTMR_RENDER_PT_performance,
    POINTMR_RENDER_PT_performance_threads,
    POINTMR_RENDER_PT_performance_final_render,
    POINTMR_RENDER_PT_performance_viewport,
)
register, unregister = bpy.utils.register_classes_factory(classes)
