"""What is placed where: the rows of instances that become a Group, and the lamps among them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pointmr_engine.scene.group import VISIBLE, Group, Instances

from . import seeds
from .transforms import compose, usable

IDENTITY = np.eye(4)


class Placed(NamedTuple):
    """A group, and the values that its placement gives to it (see scene.group.Instances)."""

    group: Group
    name: str  # of the Blender object (or collection) behind it, source of its seed
    ids: tuple[
        int, ...
    ] = ()  # its index at the levels of instancing that were passed already, innermost first
    matrix: np.ndarray | None = None  # (4, 4), None: identity
    visibility: int = VISIBLE
    object_index: int = 0
    color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    attributes: dict | None = None  # name -> tuple of 1 to 4 floats
    settled: bool = False  # its instances carry their final seeds, if it is placed at the top level

    def moved(self, matrix: np.ndarray, *ids: int) -> Placed:
        """The same, seen from one level further out."""
        own = matrix if self.matrix is None else matrix @ self.matrix
        return self._replace(matrix=own, ids=self.ids + ids, settled=False)


class LampTree:
    """Which groups hold lamps, directly or below: kept apart from the geometry, for lamps are not instanced."""

    def __init__(self):
        self.lamps: dict[int, list] = {}  # id(group) -> objects at the group's origin
        self.below: dict[int, list[tuple[Group, np.ndarray, int]]] = {}  # -> (group, transforms, visibility)
        self._kept: list[Group] = []

    def lamp(self, ob) -> Group:
        """A group that holds nothing but this light object."""
        group = Group(ob.name)
        self._kept.append(group)
        self.lamps[id(group)] = [ob]
        return group

    def link(self, parent: Group, child: Group, transforms: np.ndarray, visibility: int) -> None:
        """Say that `parent` places `child`, which is lit, at transforms (N, 3, 4)."""
        self._kept.append(parent)
        self.below.setdefault(id(parent), []).append((child, transforms, visibility))

    def lit(self, group: Group) -> bool:
        return id(group) in self.lamps or id(group) in self.below

    def expand(self, root: Group, limit: int) -> tuple[list[tuple[object, np.ndarray, int]], int]:
        """All lamps as (object, world_from_lamp (4, 4), visibility), at most `limit`; and how many there are in all."""
        counts: dict[int, int] = {}

        def count(group: Group) -> int:
            if id(group) not in counts:
                counts[id(group)] = len(self.lamps.get(id(group), ())) + sum(
                    len(t) * count(child) for child, t, _ in self.below.get(id(group), ())
                )
            return counts[id(group)]

        found: list[tuple[object, np.ndarray, int]] = []

        def visit(group: Group, matrix: np.ndarray, visibility: int) -> None:
            for ob in self.lamps.get(id(group), ()):
                found.append((ob, matrix, visibility))
            for child, transforms, own in self.below.get(id(group), ()):
                for t in transforms:
                    if len(found) >= limit:
                        return
                    visit(child, matrix @ np.vstack([t, [0, 0, 0, 1]]), visibility & own)

        total = count(root)
        visit(root, np.eye(4), 255)
        return found[:limit], total


class Rows:
    """Placements on their way to become one Group.

    instanced: its parts have the colour of what instances them at the top level, as Blender has it, not their own.
    """

    def __init__(self, name: str, lamp_tree: LampTree, watch, instanced: bool = True):
        self.name, self._tree, self._watch = name, lamp_tree, watch
        self._instanced = instanced
        self._instances: list[Instances] = []
        self._lit: list[tuple[Group, np.ndarray, int]] = []
        self._single: list[Placed] = []
        self._single_seeds: list[int] = []

    def add(self, placed: Placed, seed: int) -> None:
        """One placement, at placed.matrix; seed 0 inherits."""
        self._single.append(placed)
        self._single_seeds.append(seed)

    def add_many(self, choices, choice, transforms, ids, root=None, attributes=None, name="") -> None:
        """N placements of what `choices` (lists of Placed, perhaps empty) hold.

        choice (N,): index into choices, None: all 0. transforms (N, 3, 4). ids: levels for the seeds, integers or (N,).
        attributes: name -> (N, channels) float32, read at the instances.
        """
        for k in range(max((len(c) for c in choices), default=0)):
            some = np.array([len(c) > k for c in choices])
            # everything in the first choice that has this many: rows are kept as they are
            if choice is None or (some.all() and len(choices) == 1):
                rows, which = slice(None), np.zeros(len(transforms), np.int64)
            elif some.all():
                rows, which = slice(None), choice
            else:
                rows = np.flatnonzero(some[choice])
                which = choice[rows]
            compact = np.cumsum(some) - 1
            table = [c[k] for c in choices if len(c) > k]
            which = compact[which] if len(choices) > 1 else which
            levels = [i if np.ndim(i) == 0 else i[rows] for i in ids]
            seed = placed_seeds(table, which, levels, root)
            values = {n: v[rows] for n, v in (attributes or {}).items()}
            self._emit(table, which, transforms[rows], seed, values, name or self.name)

    def _emit(self, table, which, transforms, seed, attributes, name) -> None:
        """Make Instances of rows: table[which[i]] at transforms[i]."""
        if any(p.matrix is not None for p in table):
            if len(table) == 1:
                transforms = compose(transforms, table[0].matrix)
            else:
                m = np.stack([IDENTITY if p.matrix is None else p.matrix for p in table])[which]
                own = transforms
                transforms = own[:, :, :3] @ m[:, :3, :]
                transforms[:, :, 3] += own[:, :, 3]
        good = usable(transforms)
        if not good.all():
            bad = int(len(good) - good.sum())
            what = table[int(which[int(np.argmin(good))])].name
            count = "1 placement has" if bad == 1 else f"{bad} placements have"
            self._watch.warn(f"'{what}' in '{name}': {count} a singular or non-finite matrix; skipped")
            transforms, which, seed = transforms[good], which[good], seed[good]
            attributes = {n: v[good] for n, v in attributes.items()}
        for i in [i for i, p in enumerate(table) if self._tree.lit(p.group)]:
            at = transforms if len(table) == 1 else transforms[which == i]
            if len(at):
                self._lit.append((table[i].group, at, table[i].visibility))
        solid = np.array([bool(p.group.meshes or p.group.instances) for p in table], bool)
        if not solid.all():
            keep = solid[which]
            transforms, which, seed = transforms[keep], which[keep], seed[keep]
            attributes = {n: v[keep] for n, v in attributes.items()}
        if not len(transforms):
            return
        groups = {id(p.group): p.group for p in table if p.group.meshes or p.group.instances}
        number = {key: i for i, key in enumerate(groups)}
        index = None
        if len(groups) > 1:
            index = np.array([number.get(id(p.group), 0) for p in table], np.int32)[which]
        own = {n for p in table if p.attributes for n in p.attributes} - set(attributes)
        for n in own:
            attributes = {**attributes, n: property_rows(table, n)[which]}
        self._instances.append(
            Instances(
                tuple(groups.values()),
                np.ascontiguousarray(transforms, np.float64),
                index,
                per_row([p.visibility for p in table], which, np.uint8),
                per_row([p.object_index for p in table], which, np.int32),
                seed.astype(np.uint32),
                None if self._instanced else per_row([p.color for p in table], which, np.float32),
                attributes,
                name,
            )
        )

    def group(self) -> Group | None:
        """The finished group, None if there is nothing in it."""
        by_names: dict[tuple, list[int]] = {}
        for i, p in enumerate(self._single):
            by_names.setdefault(tuple(sorted(p.attributes)) if p.attributes else (), []).append(i)
        for rows in by_names.values():
            table = [self._single[i] for i in rows]
            transforms = np.stack([IDENTITY if p.matrix is None else p.matrix for p in table])[:, :3, :]
            table = [p._replace(matrix=None) for p in table]
            seed = np.array([self._single_seeds[i] for i in rows], np.uint32)
            self._emit(table, np.arange(len(table)), transforms, seed, {}, self.name)
        if not self._instances and not self._lit:
            return None
        group = Group(self.name, [], self._instances)
        for child, transforms, visibility in self._lit:
            self._tree.link(group, child, transforms, visibility)
        return group


def placed_seeds(table: list[Placed], which: np.ndarray, levels: list, root: str | None) -> np.ndarray:
    """Seeds (N,) of the rows table[which] at the instancing levels `levels`, which follow those of each Placed."""
    hashes = np.array([seeds.hash_string(p.name) for p in table], np.uint32)
    patterns = sorted({p.ids for p in table})
    out = np.empty(len(which), np.uint32)
    for ids in patterns:
        if len(patterns) == 1:
            rows, level = slice(None), levels
        else:
            rows = np.array([p.ids == ids for p in table])[which]
            level = [i if np.ndim(i) == 0 else i[rows] for i in levels]
        out[rows] = seeds.instance_seeds(hashes[which[rows]], [*ids, *level], root)
    return out


def per_row(values: list, which: np.ndarray, dtype) -> np.ndarray:
    """values[which] as an array, of length 1 where all values are equal."""
    if all(v == values[0] for v in values):
        return np.array(values[:1], dtype)
    return np.array(values, dtype)[which]


def property_rows(table: list[Placed], name: str) -> np.ndarray:
    """An object property of each Placed, (len(table), channels) float32, 0 where it is missing."""
    found = [(p.attributes or {}).get(name, ()) for p in table]
    out = np.zeros((len(table), max(len(v) for v in found)), np.float32)
    for row, v in zip(out, found, strict=True):
        row[: len(v)] = v
    return out
