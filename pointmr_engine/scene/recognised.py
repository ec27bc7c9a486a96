"""Scenes that follow each other: what is in one as it was in the other is made the same objects.

Whoever reads a scene anew for each frame has new objects for all of it. What was made of them before (render.Cache) is
known by the objects.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import fields, is_dataclass, replace

import numpy as np

from pointmr_engine.scene.group import Group, Instances, unique_groups
from pointmr_engine.scene.scene import Scene

ROUNDED = (
    4.0 * float(np.finfo(np.float32).eps) / 2.0
)  # of the largest value, by which single floats differ at most


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


def same_light(a: Scene, b: Scene) -> bool:
    """Whether lamps and world of two scenes are the same objects."""
    return (
        a.world is b.world
        and len(a.lights) == len(b.lights)
        and all(x is y for x, y in zip(a.lights, b.lights, strict=True))
    )


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
    if a.__array_interface__ == b.__array_interface__:
        return True
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

    def take(self, name: str, is_it):
        """The first of that name of which is_it(thing) is true; None where there is none."""
        named = self._named.get(name, [])
        for k, thing in enumerate(named):
            if is_it(thing):
                return named.pop(k)
        return None


def _recognised_root(root: Group, earlier: Group, same: _Same) -> Group:
    groups, before = unique_groups(root), unique_groups(earlier)
    materials = _recognised_materials(groups, before, same)
    meshes = _recognised_meshes(groups, before, materials, same)
    found, made = _Found(before), {}
    for group in groups:  # children before parents
        own = Group(
            group.name,
            [meshes[id(m)] for m in group.meshes],
            [replace(batch, groups=tuple(made[id(g)] for g in batch.groups)) for batch in group.instances],
        )
        known = found.take(group.name, lambda g, own=own: _same_group(own, g, same))
        if known is None:
            known = own
        made[id(group)] = known
    return made[id(root)]


def _recognised_materials(groups: list[Group], before: list[Group], same: _Same) -> dict:
    """id -> material, of all that meshes of the groups have."""
    found = _Found(_materials_of(before))
    return {id(m): found.take(m.name, lambda b, m=m: same(m, b)) or m for m in _materials_of(groups)}


def _materials_of(groups: list[Group]) -> list:
    every = (m for g in groups for mesh in g.meshes for m in mesh.materials if m is not None)
    return list({id(m): m for m in every}.values())


def _meshes_of(groups: list[Group]) -> list:
    return list({id(m): m for g in groups for m in g.meshes}.values())


def _recognised_meshes(groups: list[Group], before: list[Group], materials: dict, same: _Same) -> dict:
    """id -> mesh, of all that the groups have."""
    found, made = _Found(_meshes_of(before)), {}
    for mesh in _meshes_of(groups):
        own = replace(mesh, materials=tuple(None if m is None else materials[id(m)] for m in mesh.materials))
        made[id(mesh)] = found.take(mesh.name, lambda b, own=own: same(own, b)) or own
    return made


def _same_group(a: Group, b: Group, same: _Same) -> bool:
    """Whether a has the very meshes of b, and the same instances of the very groups."""
    return (
        len(a.meshes) == len(b.meshes)
        and len(a.instances) == len(b.instances)
        and all(x is y for x, y in zip(a.meshes, b.meshes, strict=True))
        and all(_same_batch(x, y, same) for x, y in zip(a.instances, b.instances, strict=True))
    )


def _same_batch(a: Instances, b: Instances, same: _Same) -> bool:
    if len(a.groups) != len(b.groups) or any(x is not y for x, y in zip(a.groups, b.groups, strict=True)):
        return False
    return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a) if f.name != "groups")
