"""The scene's geometry, each unique thing once: meshes, groups, instances and materials, as tables for kernels."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pointmr_engine.scene.group import Group, Instances, unique_groups
from pointmr_engine.scene.material import Material
from pointmr_engine.scene.mesh import Mesh
from pointmr_engine.scene.scene import Scene


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


class BatchTables(NamedTuple):
    """One row per batch of instances (a scene Instances). A record is one placement, numbered through all batches.

    Optional values lie in one array for all batches: value = array[first + stride * i], i the place in the batch;
    first < 0: the batch has none.
    """

    first_record: np.ndarray  # (B + 1,) int64
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
    lower: np.ndarray  # (3,) float64 bounds of the finite triangles, in the mesh's space; inf where there are none
    upper: np.ndarray  # (3,) float64


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


def compile_geometry(scene: Scene, needs: frozenset[str] | None = None) -> Geometry:
    """The unique parts of `scene`; `needs` (the union of what materials ask for) is only used to convert early.

    Raises SceneError for a group that contains itself or a malformed mesh; what can be tolerated is skipped and named
    in `Geometry.warnings`. Mesh and instance arrays are borrowed where their dtype allows it: do not change them while
    the Geometry is in use.
    """
    raise NotImplementedError
