"""PointMR's instancer: `object.pointmr`, its operators, and its bounds in the viewport.

Blender expands every native instance before a render engine is asked. A pointer to a collection in a property group is
evaluated, but not expanded: so what `object.pointmr.instance_collection` places reaches the engine as it is, nested.
"""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, PointerProperty, StringProperty

from . import bounds, convert

INSTANCE_ON = (
    ("ORIGIN", "Origin", "One instance, at the object's origin", 0),
    ("POINTS", "Points", "One instance on each point of the object's evaluated geometry", 1),
)
ROTATION_FROM = (
    ("ATTRIBUTE", "Attribute", "Rotate by a point attribute: a rotation, or a vector of Euler angles", 0),
    ("NORMAL", "Normal", "Turn the z axis along the points' normals", 1),
    ("NONE", "None", "Do not rotate", 2),
)


def _changed(self, _context) -> None:
    self.id_data.update_tag()


def _collection_changed(self, _context) -> None:
    ob = self.id_data
    ob.instance_type = ob.instance_type  # renews the relations, which a pointer in a property group does not
    ob.update_tag()


class PointMRObjectSettings(bpy.types.PropertyGroup):
    """PointMR's instancer, at `object.pointmr`: places a collection without Blender expanding it."""

    instance_collection: PointerProperty(
        name="Collection",
        description="Collection to place; its objects, and what they instance in turn, reach the renderer unexpanded",
        type=bpy.types.Collection,
        update=_collection_changed,
    )
    instance_on: EnumProperty(
        name="Instance On",
        description="Where the collection is placed",
        items=INSTANCE_ON,
        default="ORIGIN",
        update=_changed,
    )
    rotation_from: EnumProperty(
        name="Rotation",
        description="How instances on points are rotated",
        items=ROTATION_FROM,
        default="ATTRIBUTE",
        update=_changed,
    )
    rotation_attribute: StringProperty(
        name="Rotation Attribute",
        description="Point attribute: a rotation, or a vector of Euler angles in radians",
        default="rotation",
        update=_changed,
    )
    scale_attribute: StringProperty(
        name="Scale Attribute",
        description="Point attribute: a number, or a vector with a scale for each axis",
        default="scale",
        update=_changed,
    )
    index_attribute: StringProperty(
        name="Index Attribute",
        description=(
            "Point attribute: which child of the collection is placed, counting its collections, then its objects, "
            "each by name; below 0, or without the attribute, the whole collection"
        ),
        default="index",
        update=_changed,
    )
    reset_children: BoolProperty(
        name="Reset Children",
        description="Place a child picked by index by its own origin, not by where it stands in the collection",
        default=True,
        update=_changed,
    )
    show_bounds: BoolProperty(
        name="Show Bounds",
        description="Show the instances as boxes in the viewport",
        default=True,
        update=_changed,
    )
    native_source: PointerProperty(
        name="Native Instancer",
        description="The object whose instances were turned into these points",
        type=bpy.types.Object,
    )


def draw_panel(layout, context) -> None:
    """The instancer's settings of the active object."""
    settings = context.object.pointmr
    layout.prop(settings, "instance_collection")
    if settings.instance_collection is not None:
        layout.prop(settings, "instance_on")
        if settings.instance_on == "POINTS":
            layout.prop(settings, "rotation_from")
            if settings.rotation_from == "ATTRIBUTE":
                layout.prop(settings, "rotation_attribute")
            layout.prop(settings, "scale_attribute")
            layout.prop(settings, "index_attribute")
            layout.prop(settings, "reset_children")
        layout.prop(context.object, "show_instancer_for_render", text="Render Instancer")
        layout.prop(settings, "show_bounds")
    row = layout.row(align=True)
    row.operator(convert.InstancerFromNative.bl_idname, text="From Native")
    row.operator(convert.InstancerToNative.bl_idname, text="To Native")


def register() -> None:
    bpy.utils.register_class(PointMRObjectSettings)
    bpy.types.Object.pointmr = PointerProperty(type=PointMRObjectSettings)
    convert.register()
    bounds.register()


def unregister() -> None:
    bounds.unregister()
    convert.unregister()
    del bpy.types.Object.pointmr
    bpy.utils.unregister_class(PointMRObjectSettings)
