"""Named values: what materials ask of meshes, objects and instancers, and how Blender's attributes are read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.scene.mesh import Attribute

from .derived import DERIVED, STRAND

# data type -> (channels, property of an element, dtype in foreach_get)
LAYOUTS = {
    "FLOAT": (1, "value", np.float32),
    "INT": (1, "value", np.int32),
    "INT8": (1, "value", np.int32),
    "BOOLEAN": (1, "value", bool),
    "FLOAT2": (2, "vector", np.float32),
    "INT16_2D": (2, "value", np.int32),
    "INT32_2D": (2, "value", np.int32),
    "FLOAT_VECTOR": (3, "vector", np.float32),
    "FLOAT_COLOR": (4, "color", np.float32),
    "BYTE_COLOR": (4, "color", np.float32),  # read as linear: Blender converts
    "QUATERNION": (4, "value", np.float32),
}
DOMAINS = {"POINT": "vertex", "CORNER": "corner", "FACE": "face"}


class Requests(NamedTuple):
    """Names that materials read. "" among `geometry` is the active colour attribute."""

    geometry: frozenset[str]
    objects: frozenset[str]
    instancers: frozenset[str]
    generated: bool


NOTHING = Requests(frozenset(), frozenset(), frozenset(), False)


def requests(node_tree) -> Requests:
    """What a shader node tree may ask for, groups included, whether connected or not."""
    geometry: set[str] = set()
    objects: set[str] = set()
    instancers: set[str] = set()
    generated = False
    trees, seen = [node_tree], set()
    while trees:
        tree = trees.pop()
        if tree is None or tree.as_pointer() in seen:
            continue
        seen.add(tree.as_pointer())
        for node in tree.nodes:
            kind = node.bl_idname
            if kind == "ShaderNodeAttribute":
                by_type = {"GEOMETRY": geometry, "OBJECT": objects, "INSTANCER": instancers}
                by_type.get(node.attribute_type, set()).add(node.attribute_name)
                if node.attribute_type == "INSTANCER":
                    objects.add(node.attribute_name)  # an instancer without it is asked for its property
            elif kind == "ShaderNodeNewGeometry":
                geometry.update(name for output, name in DERIVED.items() if node.outputs[output].is_linked)
            elif kind == "ShaderNodeHairInfo":
                geometry.update(name for output, name in STRAND.items() if node.outputs[output].is_linked)
            elif kind == "ShaderNodeVertexColor":
                geometry.add(node.layer_name)
            elif kind in ("ShaderNodeUVMap", "ShaderNodeNormalMap", "ShaderNodeTangent"):
                geometry.add(node.uv_map or "")
                generated |= kind == "ShaderNodeTangent" and node.direction_type == "RADIAL"
            elif kind == "ShaderNodeTexCoord":
                generated |= node.outputs["Generated"].is_linked
            elif kind.startswith("ShaderNodeTex") and "Vector" in node.inputs:
                generated |= not node.inputs["Vector"].is_linked
            elif getattr(node, "node_tree", None) is not None:
                trees.append(node.node_tree)
    return Requests(frozenset(geometry), frozenset(objects), frozenset(instancers), generated)


def merge(items) -> Requests:
    """Everything that any of the Requests asks for."""
    result = NOTHING
    for r in items:
        result = Requests(
            result.geometry | r.geometry,
            result.objects | r.objects,
            result.instancers | r.instancers,
            result.generated or r.generated,
        )
    return result


def read_values(attribute) -> np.ndarray | None:
    """A Blender attribute's values as (count, channels) float32, None for a type that shaders cannot read."""
    layout = LAYOUTS.get(attribute.data_type)
    if layout is None:
        return None
    channels, prop, dtype = layout
    values = np.empty(len(attribute.data) * channels, dtype)
    attribute.data.foreach_get(prop, values)
    return values.reshape(-1, channels).astype(np.float32, copy=False)


def mesh_attribute(attribute, loops: np.ndarray, polygons: np.ndarray) -> Attribute | None:
    """The engine's attribute for triangles of corners `loops` (T, 3) and faces `polygons` (T,); None if unreadable."""
    domain = DOMAINS.get(attribute.domain)
    values = None if domain is None else read_values(attribute)
    if values is None:
        return None
    if domain == "corner":
        values = values[loops.ravel()]
    elif domain == "face":
        values = values[polygons]
    return Attribute(np.ascontiguousarray(values), domain)


def object_value(ob, name: str) -> tuple[float, ...] | None:
    """An object's custom or built-in property (its own, else its data's), as 1 to 4 floats; None if it has none."""
    for owner in (ob, ob.data):
        if owner is None:
            continue
        value = owner.get(name)
        if value is None:
            try:
                value = owner.path_resolve(name)
            except (ValueError, TypeError):
                continue
        if isinstance(value, (int, float)):  # bool too
            return (float(value),)
        try:
            numbers = tuple(float(x) for x in value)[:4]
        except (TypeError, ValueError):
            continue
        if numbers:
            return numbers
    return None
