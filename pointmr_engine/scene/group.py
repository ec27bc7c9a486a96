"""Groups and instances: a directed acyclic graph of any depth, never flattened."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.mesh import Mesh

# Ray visibility and object flags, one byte per instance; combined along a path by AND (visibility) and OR (HOLDOUT,
# SHADOW_CATCHER).
CAMERA, DIFFUSE, GLOSSY, TRANSMISSION, SHADOW, VOLUME_SCATTER, HOLDOUT, SHADOW_CATCHER = (
    1 << k for k in range(8)
)
VISIBLE = CAMERA | DIFFUSE | GLOSSY | TRANSMISSION | SHADOW | VOLUME_SCATTER


@dataclass(eq=False)
class Instances:
    """N placements of Groups inside a parent Group, as arrays.

    groups: the Groups placed; group_index (N,) int32 into it, None meaning all 0.
    transforms (N, 3, 4) float64, parent_from_group (affine, the last row 0 0 0 1 left out).
    What follows is None, or one value per instance (the first axis may also be 1 for all):
    visibility (N,) uint8, the bits above; None: VISIBLE, no holdout and no shadow catcher
    object_index (N,) int32: the object's pass index, -1 to inherit the parent's; None inherits
    seed (N,) uint32: source of Object Info's random value; 0 inherits; seeds combine along a path by hashing
    color (N, 4) float32: Object Info's colour; None inherits (white at the root)
    attributes: name -> (N, channels) float32, read by Attribute nodes of type "instancer" or "object".
    name: what the user calls it, for messages.
    """

    groups: tuple[Group, ...]
    transforms: np.ndarray
    group_index: np.ndarray | None = None
    visibility: np.ndarray | None = None
    object_index: np.ndarray | None = None
    seed: np.ndarray | None = None
    color: np.ndarray | None = None
    attributes: dict[str, np.ndarray] = field(default_factory=dict)
    name: str = ""

    def __len__(self) -> int:
        return len(self.transforms)

    def times_used(self) -> np.ndarray:
        """(groups,) int64: how many placements each of `groups` has."""
        which = np.zeros(len(self), np.int64) if self.group_index is None else self.group_index
        return np.bincount(which, minlength=len(self.groups))


def instance(group: Group, transform: np.ndarray | None = None, **values) -> Instances:
    """One placement of `group`; transform 4x4 or 3x4 parent_from_group, identity by default.

    Further keyword arguments are those of Instances, given as one value each.
    """
    m = np.eye(4) if transform is None else np.asarray(transform, np.float64)
    dtypes = {"visibility": np.uint8, "object_index": np.int32, "seed": np.uint32, "color": np.float32}
    arrays = {k: np.asarray([v], dtypes[k]) if k in dtypes else v for k, v in values.items()}
    return Instances((group,), np.ascontiguousarray(m[None, :3, :4]), **arrays)


@dataclass(eq=False)
class Group:
    """Meshes (in the group's space) and instances of other groups. Identity is the object: share it to instance it."""

    name: str
    meshes: list[Mesh] = field(default_factory=list)
    instances: list[Instances] = field(default_factory=list)


def _named(batch: Instances, group: Group) -> str:
    """A batch of `group` in messages."""
    return f"instances '{batch.name}' in group '{group.name}'"


def validate_batch(batch: Instances, group: Group) -> None:
    """Raise SceneError for a malformed batch of `group`, naming both."""
    where = _named(batch, group)
    m, n = batch.transforms, len(batch.transforms)
    if m.ndim != 3 or m.shape[1:] != (3, 4):
        raise SceneError(f"{where}: transforms of shape {m.shape}, expected (N, 3, 4)")
    if n and not batch.groups:
        raise SceneError(f"{where}: no group to place")
    for name in ("group_index", "visibility", "object_index", "seed", "color"):
        values = getattr(batch, name)
        if values is not None and len(values) not in (1, n):
            raise SceneError(f"{where}: {len(values)} values of {name} for {n} placements")
    index = batch.group_index
    if index is not None and len(index) and (index.min() < 0 or index.max() >= len(batch.groups)):
        raise SceneError(f"{where}: group_index outside 0..{len(batch.groups) - 1}")


def unique_groups(root: Group) -> list[Group]:
    """All groups reachable from `root`, each once, children before parents (root last).

    Raises SceneError when a group contains itself, naming the cycle, and where what it holds is of another kind.
    """
    done: dict[int, Group] = {}
    on_path: dict[int, Group] = {}
    stack: list[tuple[Group, Iterator[Group]]] = []

    on_path[id(root)] = root
    stack.append((root, _children(root)))
    while stack:
        g, rest = stack[-1]
        child = next(rest, None)
        if child is None:
            stack.pop()
            del on_path[id(g)]
            done[id(g)] = g
        elif id(child) in on_path:
            names = [p.name for p in on_path.values()]
            names = names[names.index(child.name) :] + [child.name]
            raise SceneError("group contains itself: " + " -> ".join(names))
        elif id(child) not in done:
            on_path[id(child)] = child
            stack.append((child, _children(child)))
    return list(done.values())


def _children(group: Group) -> Iterator[Group]:
    """The groups that `group` places. Raises SceneError for what is not of the kind that its place is for."""
    for mesh in group.meshes:
        if not isinstance(mesh, Mesh):
            raise SceneError(f"group '{group.name}': {type(mesh).__name__} among its meshes, expected Mesh")
    for batch in group.instances:
        if not isinstance(batch, Instances):
            raise SceneError(
                f"group '{group.name}': {type(batch).__name__} among its instances, expected Instances"
            )
        if isinstance(batch.groups, Group):
            raise SceneError(f"{_named(batch, group)}: groups is a Group, expected a tuple of them")
        for child in batch.groups:
            if not isinstance(child, Group):
                kind = type(child).__name__
                raise SceneError(f"{_named(batch, group)}: {kind} among its groups, expected Group")
            yield child


def count_triangles(root: Group) -> tuple[int, int, int]:
    """(unique triangles, instanced triangles, depth of nesting), as exact Python integers."""
    total: dict[int, int] = {}
    depth: dict[int, int] = {}
    unique: dict[int, int] = {}
    for g in unique_groups(root):
        own = 0
        for m in g.meshes:
            own += len(m.triangles)
            unique[id(m.triangles)] = len(m.triangles)
        deepest = 0
        for inst in g.instances:
            own += sum(int(n) * total[id(c)] for n, c in zip(inst.times_used(), inst.groups, strict=True))
            deepest = max([deepest] + [depth[id(c)] + 1 for c in inst.groups])
        total[id(g)], depth[id(g)] = own, deepest
    return sum(unique.values()), total[id(root)], depth[id(root)]
