"""Objects and what they instance, as Groups that keep Blender's nesting: nothing is expanded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.scene.group import HOLDOUT, VISIBLE, Group

from . import attributes, curves, seeds, transforms, visibility
from .placements import IDENTITY, LampTree, Placed, Rows
from .transforms import matrix

SILENT = {"EMPTY", "ARMATURE", "LATTICE", "CAMERA", "SPEAKER", "LIGHT_PROBE"}  # no surface of their own
UNSUPPORTED = {"VOLUME": "volumes", "GREASEPENCIL": "grease pencil", "GPENCIL": "grease pencil"}


class Contents(NamedTuple):
    """An object in its own space: its geometry or lamp, and what it instances."""

    own: Placed | None
    made: list[Placed]


NOTHING = Contents(None, [])


class InstanceSync:
    """Walks objects, collections and geometry sets, each once. `root()` gives the scene's root group.

    Blender's rules for what is shown where are followed (tests hold them against `depsgraph.object_instances`), but
    for its limit of eight levels. `lamps` holds the lamps that were met.
    """

    def __init__(self, depsgraph, meshes, watch, property_names=attributes.NOTHING):
        self.depsgraph, self.meshes, self.watch = depsgraph, meshes, watch
        self.final = visibility.is_final(depsgraph)
        self.names = property_names  # of objects and instancers, that any material of the file reads
        self.lamps = LampTree()
        self._contents: dict[tuple[int, int], Contents] = {}
        self._own: dict[int, Placed | None] = {}
        self._shared_geometry: dict[tuple, Group | None] = {}
        self._collections: dict[int, list[Placed]] = {}
        self._path: list[tuple[int, str]] = []
        self._top: list | None = None
        self._kept: list = []  # geometry sets: their meshes die with them

    # The top level

    def root(self) -> Group:
        """Everything that the view layer shows, in world space."""
        rows = Rows("Scene", self.lamps, self.watch)
        objects = self.top_objects()
        expanded = self._expand(objects, rows)
        for i, ob in enumerate(objects):
            self.watch.poll(i / len(objects), f"objects {i}/{len(objects)}")
            if visibility.instanced_by_parent(ob) or ob.as_pointer() in expanded:
                continue
            own, made = self.contents(ob, None)
            if own is None and not made:
                continue
            seen, holdout = self._view_layer_flags(ob)
            if not seen and not holdout:
                continue
            world = matrix(ob.matrix_world)
            if own is not None:
                seed = seeds.object_seed(own.name)
                rows.add(own.moved(world)._replace(visibility=own.visibility & seen | holdout), seed)
            for p in made:
                if p.settled:
                    seed = 0
                else:
                    seed = int(seeds.instance_seeds(p.name, p.ids or (0,), ob.name)[0])
                rows.add(p.moved(world)._replace(visibility=p.visibility & seen | holdout), seed)
        return rows.group() or Group("Scene")

    def top_objects(self) -> list:
        """Evaluated objects that the view layer places in the world."""
        if self._top is None:
            self._top = visibility.layer_objects(self.depsgraph)
        return self._top

    def _view_layer_flags(self, ob) -> tuple[int, int]:
        """(ray visibility, HOLDOUT or 0) that a top-level object gives to itself and to all that it instances."""
        layer, original = self.depsgraph.view_layer, ob.original
        try:
            holdout = original.holdout_get(view_layer=layer)
            indirect = original.indirect_only_get(view_layer=layer)
        except RuntimeError:  # an object of a background scene
            holdout, indirect = ob.is_holdout, False
        seen = visibility.ray_visibility(ob)
        if indirect and not holdout:
            seen &= ~1
        return seen, HOLDOUT if holdout else 0

    def _expand(self, objects, rows) -> set[int]:
        """Where Blender has no API for geometry sets: place expanded what needs one; their pointers."""
        from . import expanded

        if expanded.has_geometry_sets():
            return set()
        return expanded.place(self, objects, rows)

    # One object

    def contents(self, ob, context) -> Contents:
        """The object's own geometry and what it instances. context: the collection that it is instanced with."""
        key = (ob.as_pointer(), context.as_pointer() if context is not None else 0)
        if key in self._contents:
            return self._contents[key]
        if self._enters_itself(key[0], f"object '{ob.name}'"):
            return NOTHING
        self.watch.poll()
        self._path.append((key[0], ob.name))
        try:
            made, is_instancer = self._made(ob, context)
        finally:
            self._path.pop()
        own = None
        if visibility.shows_itself(ob, is_instancer, self.final) and not (
            ob.type == "META" and context is not None
        ):
            own = self.own(ob)
        self._contents[key] = Contents(own, made)
        return self._contents[key]

    def _enters_itself(self, pointer: int, what: str) -> bool:
        names = [name for p, name in self._path if p == pointer]
        if not names:
            return False
        chain = [name for _, name in self._path]
        chain = chain[chain.index(names[0]) :] + [names[0]]
        self.watch.warn(f"{what} instances itself and is left out there: {' -> '.join(chain)}")
        return True

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

    def _read_own(self, ob) -> Placed | None:
        kind = ob.type
        if kind == "LIGHT":
            return self.placed(ob, self.lamps.lamp(ob))
        if kind in SILENT:
            return None
        if kind in UNSUPPORTED:
            self.watch.warn(f"object '{ob.name}': {UNSUPPORTED[kind]} are not supported; left out")
            return None
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
            mesh = self.meshes.get(ob.data, self.meshes.slot_materials.of_object(ob, ob.data), ob.name)
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
                return self._group_of_mesh(mesh)
            meshes = ([mesh] if mesh is not None else []) + extra
        elif kind in {"CURVE", "FONT", "SURFACE", "META"}:
            key = (
                kind,
                ob.data.as_pointer(),
                *(s.material.as_pointer() for s in ob.material_slots if s.material),
            )
            plain = kind != "META" and not len(ob.modifiers)
            if plain and key in self._shared_geometry:
                return self._shared_geometry[key]
            mesh = self._converted(ob)
            group = self._group_of_mesh(mesh)
            if plain:
                self._shared_geometry[key] = group
            return group
        elif kind == "CURVES":
            gs = self.geometry_set(ob)
            data = ob.data if gs is None else gs.curves
            if data is not None:
                hair = curves.hair_curves(data, ob.name)
                if hair is not None:
                    slots = self.meshes.slot_materials
                    hair.materials = slots.engine(slots.of_object(ob, data))
                    meshes.append(hair)
            if gs is not None and gs.mesh is not None:
                meshes += self._set_mesh(gs, ob)
        elif kind == "POINTCLOUD":
            gs = self.geometry_set(ob)
            if gs is None:
                clouds = [ob.data]
            else:
                clouds = [gs.pointcloud] if gs.pointcloud is not None else []
                meshes += self._set_mesh(gs, ob)
        else:
            self.watch.warn(f"object '{ob.name}': objects of type {kind.lower()} are not supported; left out")
        return self._group_of_parts(ob.name, meshes, clouds, lambda data: (ob, data))

    def _group_of_mesh(self, mesh) -> Group | None:
        if mesh is None:
            return None
        key = ("mesh", id(mesh))
        if key not in self._shared_geometry:
            self._shared_geometry[key] = Group(mesh.name, [mesh])
        return self._shared_geometry[key]

    def _group_of_parts(self, name: str, meshes: list, clouds: list, owner) -> Group | None:
        slots = self.meshes.slot_materials
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
                mesh, self.meshes.slot_materials.of_object(ob, mesh), ob.name, stable=False
            )
        finally:
            ob.to_mesh_clear()

    def _set_mesh(self, gs, owner) -> list:
        """The mesh of a geometry set, as a list of one or none."""
        data = gs.mesh
        if data is None:
            return []
        mesh = self.meshes.get(data, self.meshes.slot_materials.of_data(data), owner.name, stable=False)
        return [] if mesh is None else [mesh]

    def _hair(self, ob) -> list:
        """The object's particle hair, as tubes."""
        result = []
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
            mesh = curves.particle_hair(ob, system, modifier, inverse, self.final, self.watch)
            if mesh is not None:
                slots = self.meshes.slot_materials
                materials = slots.of_object(ob, ob.data)
                mesh.materials = slots.engine(
                    materials[max(0, min(settings.material, len(materials)) - 1) :][:1]
                )
                result.append(mesh)
        return result

    def geometry_set(self, ob):
        """The object's evaluated GeometrySet, kept alive; None where Blender has none to give."""
        if not hasattr(ob, "evaluated_geometry"):
            return None
        try:
            gs = ob.evaluated_geometry()
        except RuntimeError:
            return None
        self._kept.append(gs)
        return gs

    # What an object instances

    def _made(self, ob, context) -> tuple[list[Placed], bool]:
        """(what the object instances, in its own space; whether it counts as an instancer)."""
        made: list[Placed] = []
        is_instancer = bool(ob.is_instancer or len(ob.particle_systems))
        pointmr = pointmr_collection(ob)
        if pointmr is not None:
            from . import instancer_points

            is_instancer = True
            made += instancer_points.place(self, ob, pointmr)
        if visibility.is_disabled(ob, self.final):
            return (
                made,
                is_instancer,
            )  # an instanced source that is hidden shows itself, but not its instances
        native = None
        if makes_geometry(ob):
            gs = self.geometry_set(ob)
            if gs is not None and len(gs.instance_references()):
                is_instancer = True
                # legacy instances come this way too, where modifiers make none
                native = self._set_instances(
                    gs, ob, context, (), plain=instances_particles(ob) and not has_nodes(ob)
                )
        if native is None and instances_particles(ob):
            gs = self.geometry_set(ob)
            native = [] if gs is None else self._set_instances(gs, ob, context, (0,), plain=True)
        if native is None and ob.instance_type in {"VERTS", "FACES"}:
            native = self._child_instances(ob, context)
        if native is None and ob.instance_type == "COLLECTION" and ob.instance_collection is not None:
            native = self.collection(ob.instance_collection)
        return made + (native or []), is_instancer

    def collection(self, collection) -> list[Placed]:
        """What instancing a collection shows, relative to its offset: the shared group, or its only part itself."""
        key = collection.as_pointer()
        if key in self._collections:
            return self._collections[key]
        if self._enters_itself(key, f"collection '{collection.name}'"):
            return []
        self._path.append((key, collection.name))
        try:
            parts = self._collection_parts(collection)
        finally:
            self._path.pop()
        if len(parts) > 1:
            rows = Rows(collection.name, self.lamps, self.watch)
            for p in parts:
                rows.add(p, int(seeds.instance_seeds(p.name, p.ids)[0]))
            group = rows.group()
            parts = [] if group is None else [Placed(group, collection.name)]
        self._collections[key] = parts
        return parts

    def _collection_parts(self, collection) -> list[Placed]:
        offset = IDENTITY.copy()
        offset[:3, 3] = -np.array(collection.instance_offset)
        parts = []
        for ob, index in visibility.collection_members(collection, self.final):
            self.watch.poll()
            parts += self.member(self.evaluated(ob), offset, index, collection)
        return parts

    def member(self, ob, offset: np.ndarray, index: int, context) -> list[Placed]:
        """What an object shows as a member of an instanced collection."""
        own, made = self.contents(ob, context)
        if own is None and not made:
            return []
        place = offset @ matrix(ob.matrix_world)
        shown = (
            [own.moved(place, index)] if own is not None and not visibility.instanced_by_parent(ob) else []
        )
        return shown + [p.moved(place, index) for p in made]

    def evaluated(self, ob):
        return ob if visibility.is_evaluated(ob) else ob.evaluated_get(self.depsgraph)

    def _child_instances(self, ob, context) -> list[Placed]:
        """Instances of the object's children on its vertices or faces."""
        if ob.type != "MESH":
            gs = None if context is not None else self.geometry_set(ob)
            if gs is None:
                self.watch.warn(
                    f"object '{ob.name}': vertex instances of a {ob.type.lower()} object cannot be read"
                )
                return []
            return self._set_instances(gs, ob, context, ())
        frames, positions = dupli_frames(ob, ob.data)
        rows = Rows(ob.name, self.lamps, self.watch)
        to_object = np.linalg.pinv(matrix(ob.matrix_world))
        for child in self._children(ob, context):
            self.watch.poll()
            at = child_transforms(ob, child, to_object @ matrix(child.matrix_world), frames, positions)
            own, made = self.contents(child, context)
            parts = ([own] if own is not None else []) + made
            rows.add_many([parts], None, at, [np.arange(len(at))], ob.name)
        group = rows.group()
        return [] if group is None else [Placed(group, ob.name, settled=True)]

    def _children(self, ob, context) -> list:
        """Descendants that the object instances: in the instanced collection, else in the view layer."""
        if context is None:
            candidates = self.top_objects()
        else:
            candidates = [self.evaluated(o) for o, _ in visibility.collection_members(context, self.final)]
        pointer, result = ob.as_pointer(), []
        for c in candidates:
            parent = c.parent
            while parent is not None and parent.as_pointer() != pointer:
                parent = parent.parent
            if parent is not None and c.type != "META":
                result.append(c)
        return result

    # Geometry sets

    def _set_instances(self, gs, ob, context, outer_ids: tuple, plain: bool = False) -> list[Placed]:
        """A geometry set's instances, in the object's space. plain: instanced objects show only themselves."""
        cloud = gs.instances_pointcloud()
        if cloud is None or not len(cloud.points):
            return []
        self.watch.poll()
        n = len(cloud.points)
        at = read_transforms(cloud)
        choice = np.zeros(n, np.int32)
        cloud.attributes[".reference_index"].data.foreach_get("value", choice)
        parts = [self._reference(r, ob, context, plain) for r in gs.instance_references()]
        ids = np.arange(n)
        if not plain and "id" in cloud.attributes:
            stored = np.empty(n, np.int32)
            cloud.attributes["id"].data.foreach_get("value", stored)
            ids = unique_ids(stored)
        if n == 1:
            one = np.vstack([at[0], [0, 0, 0, 1]])
            return [p.moved(one, int(ids[0]), *outer_ids) for p in parts[int(choice[0])]]
        values = {}
        for name in sorted(self.names.instancers):
            source = cloud.attributes.get(name)
            read = None if source is None else attributes.read_values(source)
            if read is not None:
                values[name] = read
        rows = Rows(ob.name, self.lamps, self.watch)
        rows.add_many(parts, None if len(parts) == 1 else choice, at, [ids, *outer_ids], ob.name, values)
        group = rows.group()
        return [] if group is None else [Placed(group, ob.name, settled=True)]

    def _reference(self, reference, ob, context, plain: bool) -> list[Placed]:
        """What an instance reference (None, Object, Collection or GeometrySet) shows."""
        if reference is None:
            return []
        if hasattr(reference, "instance_references"):
            return self._nested_set(reference, ob, context)
        if reference.bl_rna.identifier == "Collection":
            return self.collection(reference)
        source = self.evaluated(reference)
        if plain:
            own = self.own(source)
            return [] if own is None else [own]
        own, made = self.contents(source, context)
        return ([own] if own is not None else []) + made

    def _nested_set(self, gs, ob, context) -> list[Placed]:
        """What an instanced geometry set shows: geometry that belongs to `ob`, and instances."""
        self._kept.append(gs)
        parts: list[Placed] = []
        if gs.volume is not None:
            self.watch.warn(f"object '{ob.name}': volumes made by geometry nodes are not supported; left out")
        group = self._group_of_parts(
            gs.name or ob.name,
            self._set_mesh(gs, ob),
            [] if gs.pointcloud is None else [gs.pointcloud],
            lambda data: (None, data),
        )
        if group is not None:
            parts.append(self.placed(ob, group, (0,)))
        outer = (len(parts),) if parts else ()
        made = self._set_instances(gs, ob, context, outer)
        return parts + [p._replace(settled=False) for p in made]


def dupli_frames(ob, mesh):
    """What an instancer's vertices or faces give to each of its children: (frames, positions (N, 3)).

    frames: faces' linear parts (N, 3, 3); vertex normals (N, 3), or None for vertices that do not rotate.
    """
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", positions)
    positions = positions.reshape(-1, 3)
    if ob.instance_type == "VERTS":
        if not ob.use_instance_vertices_rotation:
            return None, positions
        normals = np.empty(positions.size, np.float32)
        mesh.vertex_normals.foreach_get("vector", normals)
        return normals.reshape(-1, 3), positions
    starts, totals = np.empty((2, len(mesh.polygons)), np.int32)
    mesh.polygons.foreach_get("loop_start", starts)
    mesh.polygons.foreach_get("loop_total", totals)
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    scale = ob.instance_faces_scale if ob.use_instance_faces_scale else None
    return transforms.face_frames(positions, starts, totals, corners, scale)


def child_transforms(ob, child, relative: np.ndarray, frames, positions: np.ndarray) -> np.ndarray:
    """Placements (N, 3, 4) of a child in its instancer's space; relative (4, 4): instancer_from_child."""
    linear = relative[:3, :3]
    if ob.instance_type == "FACES":
        linear = linear @ matrix(child.matrix_parent_inverse)[:3, :3] @ frames
    elif frames is not None:
        linear = linear @ transforms.track_matrices(-frames, child.track_axis, child.up_axis)
    return transforms.affine(linear, positions + relative[:3, 3])


def read_transforms(cloud) -> np.ndarray:
    """The instance transforms of an instances point cloud, (N, 3, 4) float64."""
    flat = np.empty(16 * len(cloud.points), np.float32)
    cloud.attributes["instance_transform"].data.foreach_get("value", flat)
    return np.ascontiguousarray(flat.reshape(-1, 4, 4)[:, :, :3].transpose(0, 2, 1), np.float64)


def unique_ids(ids: np.ndarray) -> np.ndarray:
    """Stored ids, or the instances' numbers where ids repeat."""
    return ids if len(np.unique(ids)) == len(ids) else np.arange(len(ids))


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


__all__ = ["Contents", "InstanceSync", "VISIBLE"]
