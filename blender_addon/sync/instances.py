"""Objects and what they instance, as Groups that keep Blender's nesting: nothing is expanded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.scene.group import HOLDOUT, VISIBLE, Group

from . import attributes, children, expanded, instancer_points, seeds, visibility
from .geometry import GeometrySync, instances_particles, is_missing, makes_geometry, pointmr_collection
from .placements import IDENTITY, Placed, Rows
from .transforms import matrix


class Contents(NamedTuple):
    """An object in its own space: its geometry or lamp, and what it instances."""

    own: Placed | None
    made: list[Placed]


NOTHING = Contents(None, [])


class InstanceSync:
    """Walks objects, collections and geometry sets, each once. `root()` gives the scene's root group.

    Blender's rules for what is shown where are followed (tests hold them against `depsgraph.object_instances`), but
    for its limit of eight levels. `geometry.lamps` holds the lamps that were met.
    """

    def __init__(self, depsgraph, meshes, watch, property_names=attributes.NOTHING):
        self.depsgraph, self.watch = depsgraph, watch
        self.final = visibility.is_final(depsgraph)
        self.geometry = GeometrySync(meshes, watch, self.final, depsgraph.view_layer_eval, property_names)
        self.lamps = self.geometry.lamps
        self._contents: dict[tuple[int, int], Contents] = {}
        self._collections: dict[int, list[Placed]] = {}
        self._path: list[tuple[int, str]] = []
        self._top: list | None = None

    # The top level

    def root(self) -> Group:
        """Everything that the view layer shows, in world space."""
        rows = Rows("Scene", self.lamps, self.watch, instanced=False)
        objects = self.top_objects()
        done = self._expand(objects, rows)
        for i, ob in enumerate(objects):
            self.watch.poll(i / len(objects), f"objects {i}/{len(objects)}")
            if visibility.instanced_by_parent(ob) or ob.as_pointer() in done:
                continue
            own, made = self.contents(ob, None)
            if own is None and not made:
                continue
            seen, holdout = self._view_layer_flags(ob)
            if not seen & VISIBLE and not holdout:
                continue
            world = matrix(ob.matrix_world)
            if own is not None:
                seed = seeds.object_seed(own.name)
                rows.add(
                    own.moved(world)._replace(visibility=visibility.below(own.visibility, seen, holdout)),
                    seed,
                )
            for p in made:
                if p.settled:
                    seed = 0
                else:
                    seed = seeds.instance_seed(p.name, p.ids or (0,), ob.name)
                seen_below = visibility.below(p.visibility, seen, holdout)
                rows.add(p.moved(world)._replace(visibility=seen_below, color=tuple(ob.color)), seed)
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
        if not visibility.shows_itself(ob, is_instancer, self.final):
            own = self.geometry.strands(ob)
        elif ob.type != "META" or context is None:  # metaballs melt into one, they are not instanced
            own = self.geometry.own(ob)
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

    # What an object instances

    def _made(self, ob, context) -> tuple[list[Placed], bool]:
        """(what the object instances, in its own space; whether it counts as an instancer)."""
        made: list[Placed] = []
        is_instancer = bool(ob.is_instancer or len(ob.particle_systems))
        pointmr = pointmr_collection(ob)
        if pointmr is not None:
            is_instancer = True
            made += instancer_points.place(self, ob, pointmr)
        if visibility.is_disabled(ob, self.final):
            return made, is_instancer  # a hidden object that is instanced shows itself, but not its instances
        native = None
        if makes_geometry(ob):
            gs = self.geometry.geometry_set(ob)
            if gs is not None and len(gs.instance_references()):
                is_instancer = True
                native = self._set_instances(gs, ob, context, ())
        if native is None and instances_particles(ob):
            gs = self.geometry.geometry_set(ob)
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
        if is_missing(collection):
            self.watch.warn(f"collection '{collection.name}': its library file is missing; left out")
        self._path.append((key, collection.name))
        try:
            parts = self._collection_parts(collection)
        finally:
            self._path.pop()
        if len(parts) > 1:
            rows = Rows(collection.name, self.lamps, self.watch)
            for p in parts:
                rows.add(p, seeds.instance_seed(p.name, p.ids))
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
            gs = None if context is not None else self.geometry.geometry_set(ob)
            if gs is None:
                self.watch.warn(
                    f"object '{ob.name}': vertex instances of a {ob.type.lower()} object cannot be read"
                )
                return []
            return self._set_instances(gs, ob, context, ())
        frames, positions = children.dupli_frames(ob, ob.data)
        rows = Rows(ob.name, self.lamps, self.watch)
        to_object = np.linalg.pinv(matrix(ob.matrix_world))
        for child in self._children(ob, context):
            self.watch.poll()
            at = children.child_transforms(
                ob, child, to_object @ matrix(child.matrix_world), frames, positions
            )
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
        for name in sorted(self.geometry.names.instancers):
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
            own = self.geometry.own(source)
            return [] if own is None else [own]
        own, made = self.contents(source, context)
        return ([own] if own is not None else []) + made

    def _nested_set(self, gs, ob, context) -> list[Placed]:
        """What an instanced geometry set shows: geometry that belongs to `ob`, and instances."""
        self.geometry.keep(gs)
        parts: list[Placed] = []
        if gs.volume is not None:
            self.watch.warn(f"object '{ob.name}': volumes made by geometry nodes are not supported; left out")
        group = self.geometry.group_of_parts(
            gs.name or ob.name,
            self.geometry.set_mesh(gs, ob),
            [] if gs.pointcloud is None else [gs.pointcloud],
            lambda data: (None, data),
        )
        if group is not None:
            parts.append(self.geometry.placed(ob, group, (0,)))
        outer = (len(parts),) if parts else ()
        made = self._set_instances(gs, ob, context, outer)
        return parts + [p._replace(settled=False) for p in made]


def read_transforms(cloud) -> np.ndarray:
    """The instance transforms of an instances point cloud, (N, 3, 4) float64."""
    flat = np.empty(16 * len(cloud.points), np.float32)
    cloud.attributes["instance_transform"].data.foreach_get("value", flat)
    return np.ascontiguousarray(flat.reshape(-1, 4, 4)[:, :, :3].transpose(0, 2, 1), np.float64)


def unique_ids(ids: np.ndarray) -> np.ndarray:
    """Stored ids, or the instances' numbers where ids repeat."""
    return ids if len(np.unique(ids)) == len(ids) else np.arange(len(ids))
