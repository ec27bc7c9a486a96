"""Instances read one by one from `depsgraph.object_instances`: for Blender before 4.5, which has no geometry sets."""

from __future__ import annotations

from . import seeds, visibility
from .geometry import has_nodes, instances_particles, terminator_offset
from .transforms import matrix


def has_geometry_sets() -> bool:
    """Whether this Blender can give geometry sets."""
    import bpy

    return hasattr(bpy.types.Object, "evaluated_geometry")


def needs_expansion(sync, ob, path: frozenset = frozenset()) -> bool:
    """Whether what a top-level object natively instances is only known to Blender's own expansion."""
    if ob.as_pointer() in path:
        return False
    path |= {ob.as_pointer()}
    if has_nodes(ob) or instances_particles(ob):
        return True
    members = []
    if ob.instance_type == "COLLECTION" and ob.instance_collection is not None:
        members = [o for o, _ in visibility.collection_members(ob.instance_collection, sync.final)]
    elif ob.instance_type in {"VERTS", "FACES"}:
        members = sync._children(ob, None)
    return any(needs_expansion(sync, sync.evaluated(o), path) for o in members)


def place(sync, objects: list, rows) -> set[int]:
    """Add to `rows` all that those of `objects` show that need it, expanded; return their pointers."""
    wanted = {ob.as_pointer(): ob for ob in objects if needs_expansion(sync, ob)}
    if not wanted:
        return set()
    flags = {key: sync._view_layer_flags(ob) for key, ob in wanted.items()}
    meshes: dict[int, object] = {}
    for item in sync.depsgraph.object_instances:
        sync.watch.poll()
        ob = item.object
        top = (item.parent or ob).as_pointer() if item.is_instance else ob.as_pointer()
        if top not in wanted:
            continue
        if item.is_instance and ob.type == "MESH" and ob.data is not None:
            # geometry nodes hand out objects that live for this step only: keep what their mesh gave
            key = ob.data.as_pointer()
            if key not in meshes:
                meshes_of = sync.geometry.meshes
                materials = meshes_of.slot_materials.of_object(ob, ob.data)
                mesh = meshes_of.get(ob.data, materials, ob.name, False, terminator_offset(ob))
                meshes[key] = sync.geometry.group_of_mesh(mesh)
            group = meshes[key]
            own = None if group is None else sync.geometry.placed(ob, group)
        elif ob.type == "MESH" or (item.is_instance and ob.type == "LIGHT") or not item.is_instance:
            own = sync.geometry.own(ob) if ob.type in {"MESH", "LIGHT", "CURVES", "POINTCLOUD"} else None
        else:
            own = None
        if own is None:
            continue
        seen, holdout = flags[top]
        seed = item.random_id & 0xFFFFFFFF if item.is_instance else 0
        world = matrix(item.matrix_world)
        color = tuple((item.parent or ob).color) if item.is_instance else own.color
        placed = own.moved(world)._replace(
            visibility=visibility.below(own.visibility, seen, holdout), color=color
        )
        rows.add(placed, seed or seeds.object_seed(ob.name))
    return set(wanted)
