"""PointMR's own instancer: the collection of `object.pointmr`, at the object's origin or on its points."""

from __future__ import annotations

import numpy as np

from . import attributes, transforms, visibility
from .placements import Placed, Rows
from .transforms import matrix


def place(sync, ob, collection) -> list[Placed]:
    """What the instancer shows, in the object's space. `sync` is the InstanceSync that asks."""
    settings = ob.pointmr
    if settings.instance_on == "ORIGIN":
        return sync.collection(collection)
    points = point_transforms(ob, sync.geometry.geometry_set, sync.watch)
    if points is None:
        sync.watch.warn(f"object '{ob.name}': it has no points to instance on")
        return []
    at, index, data = points
    n = len(at)
    rows = Rows(ob.name, sync.lamps, sync.watch)
    whole = sync.collection(collection)
    ids = np.arange(n)
    values = {}
    for name in sorted(sync.geometry.names.instancers):
        stored = data.attributes.get(name)
        if stored is not None and stored.domain == "POINT":
            read = attributes.read_values(stored)
            if read is not None:
                values[name] = read
    if index is None:
        rows.add_many([whole], None, at, [ids], ob.name, values)
    else:
        choices = [whole] + children(sync, collection, settings.reset_children)
        beyond = index >= len(choices) - 1
        if beyond.any():
            sync.watch.warn(
                f"object '{ob.name}': {int(beyond.sum())} points ask for children that collection "
                f"'{collection.name}' does not have (it has {len(choices) - 1}); they take turns"
            )
            index = np.where(beyond, index % max(len(choices) - 1, 1), index)
        choice = np.where(index < 0, 0, index + 1)
        rows.add_many(choices, choice, at, [ids], ob.name, values)
    group = rows.group()
    return [] if group is None else [Placed(group, ob.name, settled=True)]


def children(sync, collection, reset: bool) -> list[list[Placed]]:
    """What each child of a collection shows: its collections, then its objects, each by name.

    reset: a child stands at the point, by its origin (an object) or offset (a collection); else it keeps its place
    within the collection.
    """
    result = []
    offset = np.eye(4)
    if not reset:
        offset[:3, 3] = -np.array(collection.instance_offset)
    for child in sorted(collection.children, key=lambda c: c.name):
        if visibility.is_disabled(child, sync.final):
            result.append([])
        elif reset:
            result.append(sync.collection(child))
        else:  # the parent's offset is what counts, not the child's
            back = np.eye(4)
            back[:3, 3] = np.array(child.instance_offset)
            result.append([p.moved(offset @ back) for p in sync.collection(child)])
    for ob in sorted(collection.objects, key=lambda o: o.name):
        if visibility.is_disabled(ob, sync.final):
            result.append([])
            continue
        source = sync.evaluated(ob)
        own, made = sync.contents(source, collection)
        parts = ([own] if own is not None else []) + made
        result.append(parts if reset else [p.moved(offset @ matrix(source.matrix_world)) for p in parts])
    return result


def point_transforms(ob, geometry_set, watch):
    """(object_from_point (N, 3, 4), index (N,) int64 or None, data with the points) of an evaluated PointMR instancer.

    geometry_set(ob) gives its GeometrySet or None. None where it has no points.
    """
    source = point_data(ob, geometry_set)
    if source is None:
        return None
    positions, normals, data = source
    turn = rotations(data, normals, ob, watch)
    size = scales(data, ob.pointmr, ob, watch)
    at = np.empty((len(positions), 3, 4))
    for i in range(0, len(at), transforms.CHUNK):
        rows = slice(i, i + transforms.CHUNK)
        at[rows, :, :3] = turn(rows) * (size[rows] if len(size) > 1 else size)[:, None, :]
        at[rows, :, 3] = positions[rows]
    return at, indices(data, ob.pointmr, len(at), ob, watch), data


def point_data(ob, geometry_set):
    """(positions (N, 3), normals (N, 3) or None, data with attributes) of the evaluated object, None if it has none."""
    data = ob.data
    if ob.type not in {"MESH", "POINTCLOUD"}:
        gs = geometry_set(ob)
        data = None if gs is None else gs.mesh or gs.pointcloud
    elif ob.type == "MESH" and not len(data.vertices):
        gs = geometry_set(ob)
        data = data if gs is None or gs.pointcloud is None else gs.pointcloud
    if data is None:
        return None
    if data.bl_rna.identifier == "Mesh":
        n, collection, prop = len(data.vertices), data.vertices, "co"
    else:
        n, collection, prop = len(data.points), data.points, "co"
    if n == 0:
        return None
    positions = np.empty(3 * n, np.float32)
    collection.foreach_get(prop, positions)
    normals = None
    if data.bl_rna.identifier == "Mesh" and ob.pointmr.rotation_from == "NORMAL":
        normals = np.empty(3 * n, np.float32)
        data.vertex_normals.foreach_get("vector", normals)
        normals = normals.reshape(n, 3)
    return positions.reshape(n, 3).astype(np.float64), normals, data


def point_attribute(data, name: str, kinds: set[str], ob, watch) -> np.ndarray | None:
    """A point attribute as (N, channels) float32; None where it is absent, with a warning if it is of another kind."""
    found = data.attributes.get(name) if name else None
    if found is None:
        return None
    if found.domain != "POINT" or found.data_type not in kinds:
        watch.warn(
            f"object '{ob.name}': attribute '{name}' must be {' or '.join(sorted(kinds)).lower()} per point, "
            f"not {found.data_type.lower()} per {found.domain.lower()}; ignored"
        )
        return None
    return attributes.read_values(found)


def rotations(data, normals, ob, watch):
    """A function of rows (a slice) that gives the rotations (n, 3, 3) or (1, 3, 3) of these points."""
    settings = ob.pointmr
    if settings.rotation_from == "NORMAL":
        if normals is not None:
            return lambda rows: transforms.track_matrices(normals[rows], "POS_Z", "Y")
        watch.warn(f"object '{ob.name}': its points have no normals")
    elif settings.rotation_from == "ATTRIBUTE":
        values = point_attribute(data, settings.rotation_attribute, {"QUATERNION", "FLOAT_VECTOR"}, ob, watch)
        if values is not None:
            convert = transforms.quaternion_matrices if values.shape[1] == 4 else transforms.euler_matrices
            return lambda rows: convert(np.nan_to_num(values[rows]))
    return lambda rows: np.eye(3)[None]


def scales(data, settings, ob, watch) -> np.ndarray:
    """Scales (N, 1 or 3) or (1, 1) of the points."""
    values = point_attribute(data, settings.scale_attribute, {"FLOAT", "FLOAT_VECTOR"}, ob, watch)
    return np.ones((1, 1)) if values is None else values.astype(np.float64)


def indices(data, settings, n: int, ob, watch) -> np.ndarray | None:
    """Which child of the collection each point shows, (N,) int64, negative: all of it; None for all of it always."""
    values = point_attribute(data, settings.index_attribute, {"INT", "INT8"}, ob, watch)
    if values is None:
        return None
    name = settings.index_attribute
    exact = np.empty(n, np.int32)  # read again: float32 holds whole numbers only up to 2**24
    data.attributes[name].data.foreach_get("value", exact)
    return exact.astype(np.int64)
