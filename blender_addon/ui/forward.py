"""Render tab: forward mapping's own panels, of which each shows only what matters for the chosen sampling."""

from __future__ import annotations

from bpy.types import Panel

from .common import PointMRPanel, split_layout


class ForwardPanel(PointMRPanel):
    """Shown while the method is forward mapping."""

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.scene.pointmr.method == "FORWARD"


class POINTMR_RENDER_PT_forward(ForwardPanel, Panel):
    bl_label = "Forward Mapping"

    def draw(self, context):
        settings = context.scene.pointmr
        layout = split_layout(self)
        layout.row().prop(settings, "forward_sampling", expand=True)
        if settings.forward_sampling == "STATIC":
            layout.prop(settings, "forward_strategy")
            if settings.forward_strategy == "RANDOM":  # no other strategy leaves holes
                layout.prop(settings, "forward_failure")
            layout.prop(settings, "forward_keep_sets")
        else:
            layout.prop(settings, "forward_draws")
            layout.prop(settings, "forward_failure")
            layout.prop(settings, "forward_epsilon")


class POINTMR_RENDER_PT_forward_image(ForwardPanel, Panel):
    bl_label = "Image"
    bl_parent_id = "POINTMR_RENDER_PT_forward"

    def draw(self, context):
        settings = context.scene.pointmr
        layout = split_layout(self)
        layout.prop(settings, "forward_reconstruction")
        if settings.forward_reconstruction in ("SUBPIXEL", "ANALYTIC"):
            layout.row().prop(settings, "forward_subpixels", expand=True)


class POINTMR_RENDER_PT_forward_shading(ForwardPanel, Panel):
    bl_label = "Shading"
    bl_parent_id = "POINTMR_RENDER_PT_forward"

    def draw(self, context):
        settings = context.scene.pointmr
        layout = split_layout(self)
        layout.row().prop(settings, "forward_shading", text="Materials", expand=True)
        layout.prop(settings, "forward_shadows")


class POINTMR_RENDER_PT_forward_culling(ForwardPanel, Panel):
    bl_label = "Culling"
    bl_parent_id = "POINTMR_RENDER_PT_forward"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        settings = context.scene.pointmr
        col = split_layout(self).column(heading="Leave Out", align=True)
        col.prop(settings, "forward_occlusion_culling", text="Hidden Surfaces")
        col.prop(settings, "forward_backface_culling", text="Backfaces")


classes = (
    POINTMR_RENDER_PT_forward,
    POINTMR_RENDER_PT_forward_image,
    POINTMR_RENDER_PT_forward_shading,
    POINTMR_RENDER_PT_forward_culling,
)
