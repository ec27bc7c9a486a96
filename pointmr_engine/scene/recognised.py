"""Scenes that follow each other: what is in one as it was in the other is made the same objects.

Whoever reads a scene anew for each frame has new objects for all of it. What was made of them before (render.Cache) is
known by the objects.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial

import numpy as np

from pointmr_engine.scene.group import Group, Instances, unique_groups
from pointmr_engine.scene.scene import Scene

ROUNDED = 2.0 * float(np.finfo(np.float32).eps)  # of the largest value, by which single floats differ at most


def recognised(scene: Scene, earlier: Scene) -> Scene:
    """The scene, with groups, meshes, materials, lamps and world of `earlier` in the place of what is the same as they.

    Arrays of single floats are the same within ROUNDED. Neither scene is changed. Things are looked for by name, in
    their order, and each is found once. Raises SceneError for a group that contains itself.
    """
    same = _Same()
    root = scene.root if scene.root is earlier.root else _recognised_root(scene.root, earlier.root, same)
    lights = [
        earlier.lights[k] if k < len(earlier.lights) and same(light, earlier.lights[k]) else light
        for k, light in enumerate(scene.lights)
    ]
    world = earlier.world if same(scene.world, earlier.world) else scene.world
    return replace(scene, root=root, lights=lights, world=world)


def same_objects(a: Sequence, b: Sequence) -> bool:
    """Whether two sequences hold the same objects in the same order."""
    return len(a) == len(b) and all(x is y for x, y in zip(a, b, strict=True))


def same_light(a: Scene, b: Scene) -> bool:
    """Whether lamps and world of two scenes are the same objects."""
    return a.world is b.world and same_objects(a.lights, b.lights)


class _Same:
    """Compares plain data by content. What has been compared is not compared again."""

    def __init__(self):
        # by their ids, which remain theirs as long as they are kept
        self._found: dict[tuple[int, int], tuple[bool, object, object]] = {}

    def __call__(self, a, b) -> bool:
        if a is b:
            return True
        if type(a) is not type(b):
            return False
        if isinstance(a, np.ndarray):
            return _same_array(a, b)
        if isinstance(a, dict):
            return list(a) == list(b) and all(self(a[key], b[key]) for key in a)
        if isinstance(a, list | tuple):
            return len(a) == len(b) and all(self(x, y) for x, y in zip(a, b, strict=True))
        if is_dataclass(a):
            key = id(a), id(b)
            if key not in self._found:
                same = all(self(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
                self._found[key] = same, a, b
            return self._found[key][0]
        return bool(a == b) or (a != a and b != b)


def _same_array(a: np.ndarray, b: np.ndarray) -> bool:
    if a.dtype != b.dtype or a.shape != b.shape or a.dtype == object:
        return False
    if a.dtype != np.float32:
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if np.array_equal(a, b):
        return True
    # but for a few roundings: Blender's bevels, for one, do not have the same last bits each time they are made
    most = np.abs(a[np.isfinite(a)]).max(initial=0.0)
    return np.allclose(a, b, rtol=0.0, atol=ROUNDED * most, equal_nan=True)


class _Found:
    """Things by name, of which each is found once."""

    def __init__(self, things: Iterable):
        self._named = defaultdict(list)
        for thing in things:
            self._named[thing.name].append(thing)

    def instead_of(self, thing, same):
        """The first of its name for which same(thing, it); the thing itself where there is none."""
        named = self._named[thing.name]
        for k, other in enumerate(named):
            if same(thing, other):
                return named.pop(k)
        return thing


def _recognised_root(root: Group, earlier: Group, same: _Same) -> Group:
    """The group, children before parents; what instead_of is asked for has parts that were recognised before."""
    groups, before = unique_groups(root), unique_groups(earlier)
    made = {id(None): None}  # by the ids of materials, meshes and groups
    found = _Found(_materials_of(before))
    for material in _materials_of(groups):
        made[id(material)] = found.instead_of(material, same)
    found = _Found(_meshes_of(before))
    for mesh in _meshes_of(groups):
        own = replace(mesh, materials=tuple(made[id(m)] for m in mesh.materials))
        made[id(mesh)] = found.instead_of(own, same)
    found = _Found(before)
    for group in groups:
        own = Group(
            group.name,
            [made[id(m)] for m in group.meshes],
            [replace(batch, groups=tuple(made[id(g)] for g in batch.groups)) for batch in group.instances],
        )
        made[id(group)] = found.instead_of(own, partial(_same_group, same=same))
    return made[id(root)]


def _materials_of(groups: list[Group]) -> list:
    every = (m for mesh in _meshes_of(groups) for m in mesh.materials if m is not None)
    return list({id(m): m for m in every}.values())


def _meshes_of(groups: list[Group]) -> list:
    return list({id(m): m for g in groups for m in g.meshes}.values())


def _same_group(a: Group, b: Group, same: _Same) -> bool:
    """Whether a has the very meshes of b, and the same instances of the very groups."""
    return (
        same_objects(a.meshes, b.meshes)
        and len(a.instances) == len(b.instances)
        and all(_same_batch(x, y, same) for x, y in zip(a.instances, b.instances, strict=True))
    )


def _same_batch(a: Instances, b: Instances, same: _Same) -> bool:
    return same_objects(a.groups, b.groups) and all(
        same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a) if f.name != "groups"
    )
