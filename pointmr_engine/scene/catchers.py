"""Shadow catchers: objects that are not seen, but for the shadows that others throw on them.

A picture with catchers is made of three (as in Cycles): of the objects, of the catchers as everything lights and shades
them, and of the catchers as if there were nothing else. They differ in nothing but who is seen by whom.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointmr_engine.scene.group import (
    CAMERA,
    HOLDOUT,
    SHADOW_CATCHER,
    VISIBLE,
    Group,
    Instances,
    instance,
    unique_groups,
    validate_batch,
)

OBJECTS, CAUGHT, ALONE = range(3)  # the pictures


def _marks(batch: Instances) -> np.ndarray:
    """(N,) bool, or (1,) for all: which placements of a batch are catchers."""
    if batch.visibility is None:
        return np.zeros(1, np.bool_)
    return (np.asarray(batch.visibility, np.uint8) & SHADOW_CATCHER) != 0


def has_catchers(root: Group) -> bool:
    """Whether anything below `root` is a shadow catcher."""
    return any(_marks(batch).any() for group in unique_groups(root) for batch in group.instances)


def separate(root: Group) -> tuple[Group, list[Instances]]:
    """(the same scene, its batches that decide): no group below their placements holds both catchers and others.

    Groups in which nothing is marked are shared with `root`; where nothing is, it is (root, []). Raises SceneError for
    a malformed batch or a group that contains itself.
    """
    if not has_catchers(root):
        return root, []
    mixed: dict[int, Group] = {}
    deciding: list[Instances] = []
    for group in unique_groups(root):
        inner = any(_marks(b).any() or any(id(c) in mixed for c in b.groups) for b in group.instances)
        if inner or group is root:
            for batch in group.instances:
                validate_batch(batch, group)
            batches = [_explicit(batch, mixed, deciding) for batch in group.instances]
            if group.meshes:
                own = instance(Group(group.name, group.meshes), visibility=VISIBLE)
                deciding.append(own)
                batches.append(own)
            mixed[id(group)] = Group(group.name, [], batches)
    return mixed[id(root)], deciding


def _explicit(batch: Instances, mixed: dict[int, Group], deciding: list[Instances]) -> Instances:
    """The batch with a visibility for each placement, and what is mixed below those that are no catchers replaced."""
    n = len(batch)
    bits = np.full(n, VISIBLE, np.uint8)
    if batch.visibility is not None:
        bits[:] = batch.visibility
    index = np.zeros(n, np.int32) if batch.group_index is None else np.asarray(batch.group_index, np.int32)
    groups = list(batch.groups)
    for k, child in enumerate(batch.groups):
        rows = (index == k) & ((bits & SHADOW_CATCHER) == 0)
        if id(child) in mixed and rows.any():
            index = np.where(rows, np.int32(len(groups)), index)
            groups.append(mixed[id(child)])
    found = replace(batch, groups=tuple(groups), group_index=index, visibility=bits)
    deciding.append(found)
    return found


def visibility(batch: Instances, mixed: np.ndarray, picture: int) -> np.ndarray:
    """(N,) uint8: the bits of a deciding batch in one of the pictures. mixed (N,) bool: what is below decides."""
    bits = np.asarray(batch.visibility, np.uint8)
    caught, own = (bits & SHADOW_CATCHER) != 0, bits & np.uint8(~SHADOW_CATCHER & 0xFF)
    if picture == OBJECTS:
        return np.where(caught, own | np.uint8(HOLDOUT), own)
    hidden = own | np.uint8(HOLDOUT)
    if picture == ALONE:
        hidden = (own & np.uint8(CAMERA)) | np.uint8(HOLDOUT)
    return np.where(caught | mixed, own, hidden)


def decide(deciding: list[Instances], picture: int) -> dict[int, np.ndarray]:
    """id of each deciding batch -> its visibility (N,) uint8 in one of the pictures."""
    holders = {id(b) for b in deciding}
    found = {}
    for batch in deciding:
        holds = np.array([any(id(b) in holders for b in g.instances) for g in batch.groups], np.bool_)
        mixed = np.zeros(len(batch), np.bool_) if batch.group_index is None else holds[batch.group_index]
        found[id(batch)] = visibility(batch, mixed, picture)
    return found
