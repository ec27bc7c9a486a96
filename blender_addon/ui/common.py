"""What PointMR's panels share."""

from __future__ import annotations

ENGINE = "POINTMR"


class PointMRPanel:
    """Base of panels in the Properties editor that show only while PointMR is the engine."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {ENGINE}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES


def split_layout(panel):
    """The panel's layout with labels on the left, as Blender's own settings have it."""
    layout = panel.layout
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout


def draw_node_input(layout, owner, socket: str) -> bool:
    """Show the node tree that feeds `socket` of the output node of a material, world or light; False without
    one.
    """
    from bpy_extras.node_utils import find_node_input

    tree = owner.node_tree if getattr(owner, "use_nodes", True) else None
    if tree is None:
        return False
    node = tree.get_output_node("CYCLES") or tree.get_output_node("ALL")
    found = find_node_input(node, socket) if node is not None else None
    if found is None:
        layout.label(text="No output node" if node is None else "Incompatible output node")
    else:
        layout.template_node_view(tree, node, found)
    return True
