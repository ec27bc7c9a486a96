"""Blender's meshes to engine meshes: exact arrays, read in bulk, each once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointmr_engine.scene.mesh import GENERATED, Attribute, Mesh

from . import attributes
from .attributes import Requests
from .derived import DERIVED, derived


class SlotMaterials:
    """Materials by slot, as Blender resolves them (object or data, the view layer's override first)."""

    def __init__(self, material_sync, override=None):
        self._sync, self._override = material_sync, override
        self._requests: dict[int, Requests] = {}

    def of_object(self, ob, mesh) -> tuple:
        """bpy Materials of an object's slots; None for an empty one. `mesh` is what its modifiers made."""
        own, slots = mesh.materials, ob.material_slots
        if not len(own) and not len(slots):
            return (self._override,)
        result = []
        for i in range(max(len(own), len(slots))):
            if i < len(slots) and slots[i].link == "OBJECT":
                result.append(slots[i].material)
            else:
                result.append(own[i] if i < len(own) else slots[i].material)
        return self._overridden(result)

    def of_data(self, data) -> tuple:
        """bpy Materials of geometry that no object owns (of geometry nodes)."""
        return self._overridden(list(data.materials)) if len(data.materials) else (self._override,)

    def _overridden(self, materials: list) -> tuple:
        return tuple(materials) if self._override is None else (self._override,) * len(materials)

    def engine(self, materials: tuple, strands: bool = False) -> tuple:
        """The engine's materials; of strands, those that these are made of."""
        return tuple(self._sync.of_strands(m) if strands else self._sync.get(m) for m in materials)

    def requests(self, materials: tuple) -> Requests:
        """What these materials read of their mesh."""
        return attributes.merge(self._request(m) for m in materials if m is not None)

    def _request(self, material) -> Requests:
        key = material.as_pointer()
        if key not in self._requests:
            tree = material.node_tree
            self._requests[key] = attributes.requests(tree) if tree is not None else attributes.NOTHING
        return self._requests[key]


class MeshSync:
    """Reads meshes and keeps them, so that objects that share a mesh share its arrays."""

    def __init__(self, slot_materials: SlotMaterials, watch):
        self.slot_materials, self.watch = slot_materials, watch
        self._bare: dict[int, tuple[Mesh | None, dict]] = {}
        self._made: dict[tuple, Mesh | None] = {}

    def get(
        self, mesh, materials: tuple, owner: str, stable: bool = True, terminator_offset: float = 0.0
    ) -> Mesh | None:
        """The engine's mesh for a bpy Mesh with these bpy Materials, None (and a warning) if nothing can be rendered.

        owner: the object's name, for messages. stable: the mesh lives as long as the export, and can be known again.
        terminator_offset: that of the object.
        """
        key = (
            mesh.as_pointer(),
            tuple(m.as_pointer() if m is not None else 0 for m in materials),
            terminator_offset,
        )
        if stable and key in self._made:
            return self._made[key]
        self.watch.poll()
        if stable and key[0] in self._bare:
            bare, arrays = self._bare[key[0]]
        else:
            bare, arrays = read_mesh(mesh, owner, self.watch)
            if stable:
                self._bare[key[0]] = bare, arrays
        result = None
        if bare is not None:
            wanted = self.slot_materials.requests(materials)
            add_requested(mesh, bare, wanted, arrays, owner, self.watch)
            index = bare.material_index
            if index is not None and len(materials) <= int(index.max(initial=0)):
                index = np.minimum(index, len(materials) - 1)
            result = replace(
                bare,
                materials=self.slot_materials.engine(materials),
                material_index=index,
                terminator_offset=terminator_offset,
            )
        if stable:
            self._made[key] = result
        return result


def floats(collection, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """A float property of all elements, as float32."""
    out = np.empty(int(np.prod(shape)), np.float32)
    collection.foreach_get(name, out)
    return out.reshape(shape)


def read(attribute, prop: str, dtype, shape: tuple[int, ...]) -> np.ndarray:
    """A Blender attribute's values. Far faster than the properties of vertices, loops and polygons."""
    out = np.empty(int(np.prod(shape)), dtype)
    attribute.data.foreach_get(prop, out)
    return out.reshape(shape)


def read_mesh(mesh, owner: str, watch) -> tuple[Mesh | None, dict]:
    """(a Mesh without materials, index arrays that attributes need), or (None, {}) where there are no triangles.

    Normals are None for flat meshes, per vertex for smooth ones, per corner for the rest.
    """
    name = mesh.name if mesh.name == owner or not mesh.name else f"{owner}/{mesh.name}"
    mesh.calc_loop_triangles()
    v, t = len(mesh.vertices), len(mesh.loop_triangles)
    if t == 0:
        return None, {}
    positions = read(mesh.attributes["position"], "vector", np.float32, (v, 3))
    polygons = np.empty(t, np.int32)
    mesh.loop_triangle_polygons.foreach_get("value", polygons)
    if 3 * t == len(mesh.loops):
        loops = np.arange(3 * t, dtype=np.int32)  # triangles only
    else:
        loops = np.empty(3 * t, np.int32)
        mesh.loop_triangles.foreach_get("loops", loops)
    triangles = read(mesh.attributes[".corner_vert"], "value", np.int32, (len(mesh.loops),))[loops].reshape(
        t, 3
    )
    if triangles.min() < 0 or triangles.max() >= v:
        bad = ((triangles < 0) | (triangles >= v)).any(1)
        watch.warn(
            f"object '{owner}': {int(bad.sum())} triangles refer to vertices that do not exist; skipped"
        )
        triangles[bad] = 0  # no area: never hit
    loops = loops.reshape(t, 3)
    bare = Mesh(name, positions, triangles, read_normals(mesh, positions, triangles, loops, polygons))
    bare.material_index = read_material_index(mesh, polygons)
    finite = np.isfinite(positions).all(1)
    if not finite.all():
        hit = int((~finite)[triangles].any(1).sum())
        first = int(np.argmin(finite))
        watch.warn(f"object '{owner}': vertex {first} is not finite; {hit} triangles are skipped")
    centre, half = np.array(mesh.texspace_location), np.array(mesh.texspace_size)
    bare.generated = np.array([centre - half, centre + half], np.float64)
    active = next((layer for layer in mesh.uv_layers if layer.active_render), None)
    arrays = {"loops": loops, "polygons": polygons}
    if active is not None:
        bare.active_uv = active.name
        add_uv(bare, active, loops)
    return bare, arrays


def read_material_index(mesh, polygons: np.ndarray) -> np.ndarray | None:
    """Slot of each triangle, (T,) int32; None where all are in the first."""
    source = mesh.attributes.get("material_index")
    if source is None or source.domain != "FACE" or source.data_type != "INT":
        return None
    slots = read(source, "value", np.int32, (len(mesh.polygons),))
    return np.maximum(slots, 0)[polygons] if slots.any() else None


def read_normals(mesh, positions, triangles, loops, polygons) -> np.ndarray | None:
    """Normals as scene.mesh.Mesh wants them, from Blender's, flat faces being as flat as their triangles."""
    if mesh.normals_domain == "FACE":
        return None
    if mesh.normals_domain == "POINT":
        return finite_normals(floats(mesh.vertex_normals, "vector", (len(positions), 3)))
    corners = floats(mesh.corner_normals, "vector", (len(mesh.loops), 3))
    normals = corners[loops]
    sharp = mesh.attributes.get("sharp_face")
    if sharp is not None and sharp.domain == "FACE" and sharp.data_type == "BOOLEAN":
        flat = np.empty(len(mesh.polygons), bool)
        sharp.data.foreach_get("value", flat)
        rows = flat[polygons]
        p = positions[triangles[rows]]
        across = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        length = np.sqrt((across * across).sum(1, keepdims=True))
        good = length[:, 0] > 0
        rows = np.flatnonzero(rows)[good]
        normals[rows] = (across[good] / length[good])[:, None, :]
    return finite_normals(normals)


def finite_normals(normals: np.ndarray) -> np.ndarray:
    """The same array, up where a normal is not finite or zero."""
    bad = ~(np.abs(normals).sum(-1) > 0) | ~np.isfinite(normals).all(-1)
    if bad.any():
        normals[bad] = (0.0, 0.0, 1.0)
    return normals


def add_uv(bare: Mesh, layer, loops: np.ndarray) -> None:
    """Read a UV layer into `bare.uvs`, non-finite coordinates as 0."""
    uv = floats(layer.uv, "vector", (len(layer.uv), 2))[loops]
    if not np.isfinite(uv).all():
        uv = np.nan_to_num(uv, nan=0.0, posinf=0.0, neginf=0.0)
    bare.uvs[layer.name] = uv


def add_requested(mesh, bare: Mesh, wanted: Requests, arrays: dict, owner: str, watch) -> None:
    """Read what materials ask for and `bare` does not have yet: UV layers, attributes, undeformed coordinates.

    The active colour attribute is also kept under "", by which the Color Attribute node asks for it.
    """
    for name in sorted(wanted.geometry):
        if name and name in mesh.uv_layers:
            if name not in bare.uvs:
                add_uv(bare, mesh.uv_layers[name], arrays["loops"])
        elif name not in bare.attributes:
            if name in DERIVED.values():
                bare.attributes[name] = derived(name, mesh, bare.triangles, bare.positions)
                continue
            if name:
                source = mesh.attributes.get(name)
            else:
                i = mesh.color_attributes.render_color_index
                source = mesh.color_attributes[i] if 0 <= i < len(mesh.color_attributes) else None
            if source is None:
                continue  # zero, as in Cycles
            value = mesh_attribute_or_warn(source, arrays, owner, watch)
            if value is not None:
                bare.attributes[name] = value
    if wanted.generated and GENERATED not in bare.attributes and "undeformed" not in arrays:
        arrays["undeformed"] = True
        own = floats(mesh.vertices, "undeformed_co", bare.positions.shape)
        if not np.array_equal(own, bare.positions):
            low, high = bare.generated
            size = np.where(high > low, high - low, np.inf)
            rest = np.where(np.isfinite(size), (own - low) / size, 0.5)
            bare.attributes[GENERATED] = Attribute(rest.astype(np.float32), "vertex")


def mesh_attribute_or_warn(source, arrays: dict, owner: str, watch) -> Attribute | None:
    """The engine's attribute; where Blender's cannot be read, None and a warning."""
    value = attributes.mesh_attribute(source, arrays["loops"], arrays["polygons"])
    if value is None:
        watch.warn(
            f"object '{owner}': attribute '{source.name}' ({source.data_type.lower()} per {source.domain.lower()}) "
            "cannot be read by shaders"
        )
    return value
