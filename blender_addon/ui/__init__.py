"""Panels: PointMR's own, and Blender's where they apply."""

from __future__ import annotations

import bpy

from . import light, material, object, render, view_layer, world
from .common import ENGINE

_modules = (render, view_layer, material, world, light, object)

# Blender's panels for any engine that PointMR replaces, or whose features it does not have.
EXCLUDED = {
    "DATA_PT_camera_stereoscopy",
    "DATA_PT_falloff_curve",
    "DATA_PT_light",
    "DATA_PT_preview",
    "DATA_PT_spot",
    "MATERIAL_PT_freestyle_line",
    "NODE_DATA_PT_light",
    "NODE_DATA_PT_spot",
    "OBJECT_PT_shading",
    "OBJECT_PT_visibility",
    "RENDER_PT_freestyle",
    "RENDER_PT_output_views",
    "RENDER_PT_simplify",
    "RENDER_PT_simplify_greasepencil",
    "RENDER_PT_simplify_render",
    "RENDER_PT_simplify_viewport",
    "RENDER_PT_stereoscopy",
    "VIEWLAYER_PT_filter",
    "VIEWLAYER_PT_layer_passes",
}

# Panels made for EEVEE that fit any engine with shader nodes and a thin lens.
INCLUDED = {
    "DATA_PT_camera_dof",
    "DATA_PT_camera_dof_aperture",
    "EEVEE_MATERIAL_PT_context_material",
    "MATERIAL_PT_preview",
}


def get_panels():
    """Blender's panel classes that PointMR shares."""
    for cls in bpy.types.Panel.__subclasses__():
        engines = getattr(cls, "COMPAT_ENGINES", None)
        if engines is None or cls.__name__ in EXCLUDED or "freestyle" in cls.__name__:
            continue
        if "BLENDER_RENDER" in engines or cls.__name__ in INCLUDED:
            yield cls


def register() -> None:
    for module in _modules:
        module.register()
    for cls in get_panels():
        cls.COMPAT_ENGINES.add(ENGINE)


def unregister() -> None:
    for cls in get_panels():
        cls.COMPAT_ENGINES.discard(ENGINE)
    for module in reversed(_modules):
        module.unregister()
