"""Objects' own geometry as Groups: meshes, converted curves and text, hair, points; and lamps."""

from __future__ import annotations

import numpy as np

from pointmr_engine.scene.group import Group

from . import attributes, curves, visibility
from .placements import LampTree, Placed
from .transforms import matrix

SILENT = {"EMPTY", "ARMATURE", "LATTICE", "CAMERA", "SPEAKER", "LIGHT_PROBE"}  # no surface of their own
UNSUPPORTED = {"VOLUME": "volumes", "GREASEPENCIL": "grease pencil", "GPENCIL": "grease pencil"}


class GeometrySync:
    """Reads what objects show in their own space, each once; objects with the same mesh share one Group.

    property_names: object and instancer properties that materials ask for. view_layer says whether surfaces and hair
    are wanted. `lamps` gets the lamps that are met.
    """

    def __init__(self, meshes, watch, final: bool, view_layer, property_names: attributes.Requests):
        self.meshes, self.slots, self.watch, self.final = meshes, meshes.slot_materials, watch, final
        self.names = property_names
        self.use_surfaces, self.use_hair = view_layer.use_solid, view_layer.use_strand
        self.lamps = LampTree()
        self._own: dict[int, Placed | None] = {}
        self._shared: dict[tuple, Group | None] = {}
        self._sets: dict[int, object] = {}
        self._kept: list = []

    def own(self, ob) -> Placed | None:
        """The object's own geometry, or its lamp; None where it has neither."""
        key = ob.as_pointer()
        if key not in self._own:
            self._own[key] = None  # should reading fail, it is not tried again
            try:
                self._own[key] = self._read_own(ob)
            except (
                RuntimeError,
                ValueError,
                AttributeError,
                KeyError,
                TypeError,
                IndexError,
                MemoryError,
            ) as error:
                self.watch.error(f"object '{ob.name}' could not be read and is left out: {error}")
        return self._own[key]

    def strands(self, ob) -> Placed | None:
        """The object's particle hair alone: it is seen even where its emitter is not."""
        hair = self._hair(ob) if ob.type == "MESH" else []
        return self.placed(ob, Group(ob.name, hair)) if hair else None

    def _read_own(self, ob) -> Placed | None:
        kind = ob.type
        if is_missing(ob) or is_missing(ob.data):
            self.watch.warn(f"object '{ob.name}': its library file is missing; left out")
            return None
        if kind == "LIGHT":
            return self.placed(ob, self.lamps.lamp(ob))
        if kind in SILENT:
            return None
        if kind in UNSUPPORTED:
            self.watch.warn(f"object '{ob.name}': {UNSUPPORTED[kind]} are not supported; left out")
            return None
        if not self.use_surfaces:
            return self.strands(ob)
        group = self._geometry(ob)
        return None if group is None else self.placed(ob, group, () if kind == "MESH" else (0,))

    def placed(self, ob, group: Group, ids: tuple = ()) -> Placed:
        """A group that stands for (part of) the object, with the object's visibility, index, colour and properties."""
        values = None
        if self.names.objects:
            found = {n: attributes.object_value(ob, n) for n in sorted(self.names.objects)}
            values = {n: v for n, v in found.items() if v is not None} or None
        return Placed(
            group, ob.name, ids, None, visibility.ray_visibility(ob), ob.pass_index, tuple(ob.color), values
        )

    def _geometry(self, ob) -> Group | None:
        """The object's surfaces: its mesh, hair and points; a group shared by all objects with the same mesh."""
        kind = ob.type
        meshes, clouds = [], []
        if kind == "MESH":
            mesh = self.meshes.get(
                ob.data, self.slots.of_object(ob, ob.data), ob.name, True, terminator_offset(ob)
            )
            extra = self._hair(ob)
            gs = self.geometry_set(ob) if makes_geometry(ob) else None
            if gs is not None and gs.pointcloud is not None:
                clouds = [gs.pointcloud]
            if not extra and not clouds:
                if (
                    mesh is None
                    and not ob.is_instancer
                    and not makes_geometry(ob)
                    and not is_pointmr_instancer(ob)
                ):
                    self.watch.warn(f"object '{ob.name}': its mesh has no faces")
                return self.group_of_mesh(mesh)
            meshes = ([mesh] if mesh is not None else []) + extra
        elif kind in {"CURVE", "FONT", "SURFACE", "META"}:
            key = (
                kind,
                ob.data.as_pointer(),
                terminator_offset(ob),
                *(s.material.as_pointer() for s in ob.material_slots if s.material),
            )
            plain = kind != "META" and not len(ob.modifiers)
            if plain and key in self._shared:
                return self._shared[key]
            mesh = self._converted(ob)
            group = self.group_of_mesh(mesh)
            if plain:
                self._shared[key] = group
            return group
        elif kind == "CURVES":
            gs = self.geometry_set(ob)
            data = ob.data if gs is None else gs.curves
            if data is not None:
                materials = self.slots.of_object(ob, data)
                hair = curves.hair_curves(data, ob.name, self.slots.requests(materials))
                if hair is not None:
                    hair.materials = self.slots.engine(materials, strands=True)
                    meshes.append(hair)
            if gs is not None and gs.mesh is not None:
                meshes += self.set_mesh(gs, ob)
        elif kind == "POINTCLOUD":
            gs = self.geometry_set(ob)
            if gs is None:
                clouds = [ob.data]
            else:
                clouds = [gs.pointcloud] if gs.pointcloud is not None else []
                meshes += self.set_mesh(gs, ob)
        else:
            self.watch.warn(f"object '{ob.name}': objects of type {kind.lower()} are not supported; left out")
        return self.group_of_parts(ob.name, meshes, clouds, lambda data: (ob, data))

    def group_of_mesh(self, mesh) -> Group | None:
        if mesh is None:
            return None
        key = ("mesh", id(mesh))
        if key not in self._shared:
            self._shared[key] = Group(mesh.name, [mesh])
        return self._shared[key]

    def group_of_parts(self, name: str, meshes: list, clouds: list, owner) -> Group | None:
        slots = self.slots
        group = Group(name, meshes)
        for data in clouds:
            ob, _ = owner(data)
            materials = slots.of_data(data) if ob is None else slots.of_object(ob, data)
            balls = curves.point_cloud(data, name, slots.engine(materials))
            if balls is not None:
                group.instances += balls.instances
        return group if group.meshes or group.instances else None

    def _converted(self, ob):
        """The mesh of a curve, text, surface or metaball object."""
        mesh = ob.to_mesh()
        if mesh is None:
            return None
        try:
            return self.meshes.get(
                mesh, self.slots.of_object(ob, mesh), ob.name, False, terminator_offset(ob)
            )
        finally:
            ob.to_mesh_clear()

    def set_mesh(self, gs, owner) -> list:
        """The mesh of a geometry set, as a list of one or none."""
        data = gs.mesh
        if data is None:
            return []
        offset = terminator_offset(owner)
        mesh = self.meshes.get(data, self.slots.of_data(data), owner.name, False, offset)
        return [] if mesh is None else [mesh]

    def _hair(self, ob) -> list:
        """The object's particle hair, as tubes."""
        result = []
        if not self.use_hair:
            return result
        for modifier in ob.modifiers:
            if modifier.type != "PARTICLE_SYSTEM" or not (
                modifier.show_render if self.final else modifier.show_viewport
            ):
                continue
            system = modifier.particle_system
            settings = system.settings
            if settings.type != "HAIR" or settings.render_type != "PATH":
                continue
            inverse = np.linalg.inv(matrix(ob.matrix_world))
            materials = self.slots.of_object(ob, ob.data)
            materials = materials[max(0, min(settings.material, len(materials)) - 1) :][:1]
            wanted = self.slots.requests(materials)
            mesh = curves.particle_hair(ob, system, modifier, inverse, self.final, wanted, self.watch)
            if mesh is not None:
                mesh.materials = self.slots.engine(materials, strands=True)
                result.append(mesh)
        return result

    def geometry_set(self, ob):
        """The object's evaluated GeometrySet, kept alive; None where Blender has none to give."""
        key = ob.as_pointer()
        if key not in self._sets:
            self._sets[key] = None
            if hasattr(ob, "evaluated_geometry"):
                try:
                    self._sets[key] = ob.evaluated_geometry()
                except (RuntimeError, TypeError):  # of a kind that has no geometry
                    pass
        return self._sets[key]

    def keep(self, gs) -> None:
        """Keep a nested geometry set alive: its meshes die with it."""
        self._kept.append(gs)


def terminator_offset(ob) -> float:
    """scene.mesh.Mesh.terminator_offset of an object's meshes."""
    return float(getattr(ob, "shadow_terminator_geometry_offset", 0.1))


def is_missing(block) -> bool:
    """Whether a data-block only stands for one whose library file was not found."""
    return block is not None and getattr(block.original, "is_missing", False)


def has_nodes(ob) -> bool:
    return any(m.type == "NODES" for m in ob.modifiers)


def makes_geometry(ob) -> bool:
    """Whether an object's modifiers may make more than one kind of geometry."""
    return ob.type in {"MESH", "CURVE", "FONT", "SURFACE", "CURVES", "POINTCLOUD", "VOLUME"} and has_nodes(ob)


def instances_particles(ob) -> bool:
    """Whether a particle system shows objects at its particles."""
    return any(s.settings.render_type in {"OBJECT", "COLLECTION"} for s in ob.particle_systems)


def pointmr_collection(ob):
    """The collection of PointMR's own instancer, None for an object that is none."""
    own = getattr(ob, "pointmr", None)
    return None if own is None else own.instance_collection


def is_pointmr_instancer(ob) -> bool:
    return pointmr_collection(ob) is not None
