"""The scene's geometry, each unique thing once: meshes, groups, instances and materials, as tables for kernels."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.pointers import address_of
from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.group import Group, Instances, count_triangles, unique_groups, validate_batch
from pointmr_engine.scene.material import Material
from pointmr_engine.scene.mesh import Mesh
from pointmr_engine.scene.scene import Scene

UNKNOWN = -1  # in Geometry.closed
LARGEST = 1e12  # metres; beyond it single precision products overflow, and a vertex counts as not finite


class PartTables(NamedTuple):
    """One row per part (a Mesh with its materials). Addresses are those of arrays that the Geometry keeps alive."""

    shape: np.ndarray  # (P,) int32: parts with equal positions and triangles share a shape
    first_triangle: np.ndarray  # (P,) int32: scene-wide index of the shape's triangle 0
    center: np.ndarray  # (P, 3) float64: stored positions are relative to it
    radius: np.ndarray  # (P,) float64: largest distance of a coordinate from the centre
    positions: np.ndarray  # (P,) uint64 address of (V, 3) float32
    triangles: np.ndarray  # (P,) uint64 address of (T, 3) int32
    normals: np.ndarray  # (P,) uint64 address of float32, 0: flat
    normals_per_corner: np.ndarray  # (P,) bool: (T, 3, 3) instead of (V, 3)
    material_index: np.ndarray  # (P,) uint64 address of (T,) int32, 0: all in slot 0
    first_slot: np.ndarray  # (P,) int32: the part's first row in `slot_material`
    slots: np.ndarray  # (P,) int32, at least 1
    slot_material: np.ndarray  # (slots,) int32 index into Geometry.materials
    generated: np.ndarray  # (P, 2, 3) float64, the box of generated coordinates
    terminator_offset: np.ndarray  # (P,) float32, 0 where shadow rays start on the triangles


class BatchTables(NamedTuple):
    """One row per batch of instances (a scene Instances). A record is one placement, numbered through all batches.

    Optional values lie in one array for all batches: value = array[first + stride * i], i the place in the batch;
    first < 0: the batch has none.
    """

    first_record: np.ndarray  # (B + 1,) int64
    has_attributes: np.ndarray  # (B,) bool: the batch has attributes for instance_attribute needs
    transforms: np.ndarray  # (B,) uint64 address of (N, 3, 4) float64
    group: np.ndarray  # (B, 2) int64 first, stride into `group_values`; first < 0: all are `group_first`
    group_first: np.ndarray  # (B,) int32: row of `batch_groups` with the batch's group 0
    batch_groups: np.ndarray  # (sum of groups,) int32 index of unique groups
    visibility: np.ndarray  # (B, 2) int64
    object_index: np.ndarray  # (B, 2) int64
    seed: np.ndarray  # (B, 2) int64
    color: np.ndarray  # (B, 2) int64
    group_values: np.ndarray  # int32
    visibility_values: np.ndarray  # uint8
    object_index_values: np.ndarray  # int32
    seed_values: np.ndarray  # uint32
    color_values: np.ndarray  # (K, 4) float32


@dataclass(eq=False)
class Shape:
    """Unique triangle data: what a mesh acceleration structure is built over, in the mesh's space about `center`."""

    positions: np.ndarray  # (V, 3) float32, relative to center
    triangles: np.ndarray  # (T, 3) int32
    center: np.ndarray  # (3,) float64
    radius: float
    first_triangle: int  # scene-wide index of triangle 0
    # (3,) float64 bounds of the finite triangles, in the mesh's space; inf where there are none
    lower: np.ndarray
    upper: np.ndarray  # (3,) float64

    @cached_property
    def closed(self) -> bool:
        """Whether its surfaces bound bodies, but for small openings."""
        from pointmr_engine.hierarchy.closed_shapes import is_closed  # kernels that few scenes need

        return is_closed(self.positions, self.triangles)


@dataclass(eq=False)
class Geometry:
    """The scene as tables. `parts[i]` is the Mesh of part i; `shapes[tables.shape[i]]` its triangles.

    `groups` has children before parents (the root last); `group_parts[g]` lists the parts of group g, and
    `group_batches[g]` its batches. `materials` has each Material once; None stands for a slot without one.
    """

    parts: list[Mesh] = field(default_factory=list)
    shapes: list[Shape] = field(default_factory=list)
    groups: list[Group] = field(default_factory=list)
    group_parts: list[list[int]] = field(default_factory=list)
    group_batches: list[list[int]] = field(default_factory=list)
    batches: list[Instances] = field(default_factory=list)
    materials: list[Material | None] = field(default_factory=list)
    tables: PartTables | None = None
    instances: BatchTables | None = None
    warnings: list[str] = field(default_factory=list)
    unique_triangles: int = 0
    instanced_triangles: int = 0
    depth: int = 0
    kept: list[np.ndarray] = field(default_factory=list)  # arrays that the tables borrow
    layers: dict = field(default_factory=dict)  # attribute layers made so far (hierarchy.layers)
    lock: threading.Lock = field(default_factory=threading.Lock)
    closed: np.ndarray | None = None  # (P,) int8: Shape.closed of each part, UNKNOWN until something asks

    def find_closed(self, part: int) -> None:
        """Note whether a part is closed."""
        with self.lock:
            self.closed[part] = self.shapes[self.tables.shape[part]].closed


def compile_geometry(scene: Scene, needs: Iterable[str] = ()) -> Geometry:
    """The unique parts of `scene`.

    Of attribute layers, those that `needs` names (as surface.gather has it) are prepared at once; others when something
    first asks for them.

    Raises SceneError for a group that contains itself, a malformed mesh or a malformed batch of instances; what can be
    tolerated is skipped and named in `Geometry.warnings`. Mesh and instance arrays are borrowed where their dtype
    allows it: do not change them while the Geometry is in use.
    """
    from pointmr_engine.hierarchy import layers  # which needs this module

    geometry = Geometry(groups=unique_groups(scene.root))
    part_of: dict[int, int] = {}
    batch_of: dict[int, int] = {}
    for group in geometry.groups:
        rows = []
        for mesh in group.meshes:
            if id(mesh) not in part_of:
                part_of[id(mesh)] = len(geometry.parts)
                geometry.warnings += mesh.validate()
                geometry.parts.append(mesh)
            rows.append(part_of[id(mesh)])
        geometry.group_parts.append(rows)
        rows = []
        for batch in group.instances:
            if id(batch) not in batch_of:
                batch_of[id(batch)] = len(geometry.batches)
                validate_batch(batch, group)
                geometry.batches.append(batch)
            rows.append(batch_of[id(batch)])
        geometry.group_batches.append(rows)
    _tabulate(geometry)
    geometry.instances = _batch_tables(geometry)
    geometry.unique_triangles = sum(len(s.triangles) for s in geometry.shapes)
    _, geometry.instanced_triangles, geometry.depth = count_triangles(scene.root)
    for need in needs or ():
        kind, _, name = need.partition(":")
        if kind in ("uv", "tangent", "attribute"):
            layers.layer(geometry, kind, name)
    return geometry


def slot_materials(geometry: Geometry, part: int) -> np.ndarray:
    """(S,) int32: the materials of a part's slots, as indices into Geometry.materials."""
    tables = geometry.tables
    first = int(tables.first_slot[part])
    return np.asarray(tables.slot_material[first : first + int(tables.slots[part])])


def triangle_materials(geometry: Geometry, part: int) -> np.ndarray:
    """(T,) int32: the material of each of a part's triangles, as an index into Geometry.materials."""
    mesh, slots = geometry.parts[part], slot_materials(geometry, part)
    if mesh.material_index is None:
        return np.full(len(mesh.triangles), slots[0], np.int32)
    return slots[np.clip(mesh.material_index, 0, len(slots) - 1)].astype(np.int32)


def with_parts(geometry: Geometry, parts: list[Mesh]) -> Geometry:
    """The same scene with other meshes in the places of its parts, of as many triangles and the same materials."""
    made = replace(geometry, parts=parts, shapes=[], materials=[], kept=list(geometry.kept), layers={})
    _tabulate(made)
    return made


def _tabulate(geometry: Geometry) -> None:
    """Tables of the parts, of which nobody knows yet whether they are closed."""
    geometry.tables = _part_tables(geometry)
    geometry.closed = np.full(len(geometry.parts), UNKNOWN, np.int8)


def _identity(array: np.ndarray) -> tuple:
    return (array.__array_interface__["data"][0], array.shape, array.strides, array.dtype.str)


def _borrow(geometry: Geometry, array: np.ndarray | None, dtype) -> int:
    if array is None or array.size == 0:
        return 0
    array = np.ascontiguousarray(array, dtype)
    geometry.kept.append(array)
    return address_of(array)


def _compile_shape(mesh: Mesh, first_triangle: int) -> Shape:
    triangles = np.ascontiguousarray(mesh.triangles, np.int32)
    positions = mesh.positions
    used = np.zeros(len(positions), np.bool_)
    used[triangles.ravel()] = True
    used &= (np.abs(positions) <= LARGEST).all(1)
    if not used.any():
        return Shape(
            np.zeros(positions.shape, np.float32), triangles, np.zeros(3), 0.0, first_triangle,
            np.full(3, np.inf), np.full(3, -np.inf),
        )  # fmt: skip
    kept = positions if used.all() else positions[used]
    lower, upper = kept.min(0).astype(np.float64), kept.max(0).astype(np.float64)
    center, half = (lower + upper) / 2, float((upper - lower).max()) / 2
    if positions.dtype == np.float32 and np.abs(center).max() <= half:
        # near enough to its origin that shifting would gain nothing: use the array as it is
        center = np.zeros(3)
        stored = np.ascontiguousarray(positions)
    else:
        stored = np.ascontiguousarray(positions - center, np.float32)
    radius = float(max(np.abs(lower - center).max(), np.abs(upper - center).max()))
    return Shape(stored, triangles, center, radius, first_triangle, lower, upper)


def _part_tables(geometry: Geometry) -> PartTables:
    shape_of: dict[tuple, int] = {}
    material_of: dict[int, int] = {}
    rows = {name: [] for name in PartTables._fields}
    first_triangle = 0
    for mesh in geometry.parts:
        key = (*_identity(mesh.positions), *_identity(mesh.triangles))
        if key not in shape_of:
            shape_of[key] = len(geometry.shapes)
            geometry.shapes.append(_compile_shape(mesh, first_triangle))
            first_triangle += len(mesh.triangles)
            if first_triangle >= 2**31:
                raise SceneError(f"mesh '{mesh.name}': more than 2^31 unique triangles in the scene")
        index = shape_of[key]
        shape = geometry.shapes[index]
        rows["shape"].append(index)
        rows["first_triangle"].append(shape.first_triangle)
        rows["center"].append(shape.center)
        rows["radius"].append(shape.radius)
        rows["positions"].append(address_of(shape.positions))
        rows["triangles"].append(address_of(shape.triangles))
        rows["normals"].append(_borrow(geometry, mesh.normals, np.float32))
        rows["normals_per_corner"].append(mesh.normals is not None and mesh.normals.ndim == 3)
        rows["first_slot"].append(len(rows["slot_material"]))
        materials = mesh.materials or (None,)
        rows["slots"].append(len(materials))
        rows["material_index"].append(
            _borrow(geometry, mesh.material_index, np.int32) if len(materials) > 1 else 0
        )
        for material in materials:
            if id(material) not in material_of:
                material_of[id(material)] = len(geometry.materials)
                geometry.materials.append(material)
            rows["slot_material"].append(material_of[id(material)])
        box = np.stack([shape.lower, shape.upper]) if mesh.generated is None else np.asarray(mesh.generated)
        rows["terminator_offset"].append(0.0 if mesh.normals is None else mesh.terminator_offset)
        rows["generated"].append(np.where(np.isfinite(box), box, 0.0))
    return PartTables(
        shape=np.array(rows["shape"], np.int32),
        first_triangle=np.array(rows["first_triangle"], np.int32),
        center=np.array(rows["center"], np.float64).reshape(-1, 3),
        radius=np.array(rows["radius"], np.float64),
        positions=np.array(rows["positions"], np.uint64),
        triangles=np.array(rows["triangles"], np.uint64),
        normals=np.array(rows["normals"], np.uint64),
        normals_per_corner=np.array(rows["normals_per_corner"], np.bool_),
        material_index=np.array(rows["material_index"], np.uint64),
        first_slot=np.array(rows["first_slot"], np.int32),
        slots=np.array(rows["slots"], np.int32),
        slot_material=np.array(rows["slot_material"], np.int32),
        generated=np.array(rows["generated"], np.float64).reshape(-1, 2, 3),
        terminator_offset=np.array(rows["terminator_offset"], np.float32),
    )


def _optional(batches: list[Instances], name: str, dtype, shape: tuple = ()) -> tuple[np.ndarray, np.ndarray]:
    """(first, stride) per batch and the values of all batches that have them; a single array is not copied."""
    where = np.full((len(batches), 2), -1, np.int64)
    arrays, first = [], 0
    for i, batch in enumerate(batches):
        values = getattr(batch, name)
        if values is not None and len(values):
            values = np.ascontiguousarray(values, dtype).reshape(len(values), *shape)
            where[i] = first, int(len(values) > 1)
            arrays.append(values)
            first += len(values)
    if len(arrays) == 1:
        return where, arrays[0]
    return where, np.concatenate(arrays) if arrays else np.zeros((0, *shape), dtype)


def _batch_tables(geometry: Geometry) -> BatchTables:
    group_of = {id(g): i for i, g in enumerate(geometry.groups)}
    batches = geometry.batches
    lengths = np.array([0] + [len(b) for b in batches], np.int64)
    if lengths.sum() >= 2**31:
        raise SceneError("more than 2^31 instances in the scene")
    group_rows: list[int] = []
    group_first = []
    for batch in batches:
        group_first.append(len(group_rows))
        group_rows += [group_of[id(g)] for g in batch.groups]
    optional = {
        "group": _optional(batches, "group_index", np.int32),
        "visibility": _optional(batches, "visibility", np.uint8),
        "object_index": _optional(batches, "object_index", np.int32),
        "seed": _optional(batches, "seed", np.uint32),
        "color": _optional(batches, "color", np.float32, (4,)),
    }
    return BatchTables(
        first_record=np.cumsum(lengths),
        has_attributes=np.array([bool(b.attributes) for b in batches], np.bool_),
        transforms=np.array([_borrow(geometry, b.transforms, np.float64) for b in batches], np.uint64),
        group_first=np.array(group_first, np.int32),
        batch_groups=np.array(group_rows, np.int32),
        **{name: where for name, (where, _) in optional.items()},
        **{f"{name}_values": values for name, (_, values) in optional.items()},
    )
