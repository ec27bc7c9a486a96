"""Sample sets on disk, found again by the content that decides them (content addressing).

A group's key is a hash of its meshes, materials and instances, of the keys of the groups that it places, and of the
constants and the code of sampling; a file holds the sets of one level of it. Nothing else of the scene matters, so that
a tree that stands in another forest finds its sets. Files number parts in the order in which their group reaches them.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import threading
import zipfile
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pointmr_engine.hierarchy import octree
from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.hierarchy.surfels import COLUMNS, Surfels
from pointmr_engine.scene.group import CAMERA

FORMAT = 1  # to be raised when files get another layout
# code that decides what sets hold
_DECIDING = ("hierarchy", "shading", "numerics", "scene", "forward/baked/baking.py")
_CONSTANTS = ("CHAIN", "DIVISIONS", "LEAF_TRIANGLES", "SPACING", "KEPT_POINTS", "INSTANCE_SIZE")


class StoredSets(NamedTuple):
    """The sets of one level of a group, one node after the other."""

    counts: np.ndarray  # (nodes,) int64 surfels of each node's set
    surfels: Surfels


class Unkeepable(TypeError):
    """A value that has no content that could be hashed."""


class SetFiles:
    """Files of a geometry's sample sets in `folder`, which is made when the first is written. Threads may share it.

    decided_by: what else decides the sets, as numbers, strings and tuples. warnings: what could not be read or written.
    """

    def __init__(self, folder: str, geometry: Geometry, decided_by: tuple = ()):
        self.folder, self.geometry = Path(folder), geometry
        self.warnings: list[str] = []
        self.bytes_read = self.bytes_written = 0
        self._hashed: dict[
            int, tuple[object, bytes]
        ] = {}  # arrays and objects, kept so that their ids stay theirs
        self._keys: dict[int, str | None] = {}
        self._parts: dict[int, np.ndarray] = {}
        self._lock = threading.RLock()
        constants = tuple(getattr(octree, name) for name in _CONSTANTS)
        self._common = ("sample sets", FORMAT, _code(), constants, decided_by)

    def path(self, g: int, level: int) -> Path | None:
        """The file of group g at `level`; None for groups whose content cannot be told."""
        key = self.key(g)
        return None if key is None else self.folder / key / f"{level}.npz"

    def load(self, g: int, level: int, nodes: int) -> StoredSets | None:
        """The sets of group g at `level`, which has `nodes` nodes with sets; None where it has none."""
        path = self.path(g, level)
        if path is None or not path.is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}  # a damaged array fails its checksum here
            sets = _checked(arrays, nodes, len(self.parts(g)))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            self._warn(
                f"sample sets: {path} is damaged or not a file of sample sets and is made anew ({error})"
            )
            return None
        source = sets.surfels.source
        source[:, 0] = self.parts(g)[source[:, 0]]
        with self._lock:
            self.bytes_read += path.stat().st_size
        return sets

    def store(self, g: int, level: int, sets: StoredSets) -> None:
        """Keep the sets of group g at `level`. What cannot be written is a warning."""
        path = self.path(g, level)
        if path is None:
            return
        s, parts = sets.surfels, self.parts(g)
        place_of = np.zeros(int(parts.max(initial=0)) + 1, np.int32)
        place_of[parts] = np.arange(len(parts), dtype=np.int32)
        source = s.source.copy()
        source[:, 0] = place_of[source[:, 0]]
        beside = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, beside = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
            with os.fdopen(handle, "wb") as file:
                np.savez(
                    file, counts=sets.counts, row=s.row, emission=s.emission, source=source, place=s.place
                )
                size = file.tell()
            os.replace(beside, path)
            beside = None
            with self._lock:
                self.bytes_written += size
        except OSError as error:
            self._warn(f"sample sets: {path} could not be written ({error})")
        finally:
            if beside is not None:
                Path(beside).unlink(missing_ok=True)

    def _warn(self, message: str) -> None:
        with self._lock:
            self.warnings.append(message)

    # What decides a group's sets

    def key(self, g: int) -> str | None:
        """Hash of all that decides the sets of group g, hexadecimal."""
        with self._lock:
            if g not in self._keys:
                try:
                    self._keys[g] = self._group_digest(g).hex()
                except Unkeepable as error:
                    self._keys[g] = None
                    name = self.geometry.groups[g].name
                    self._warn(f"sample sets of group '{name}' are not kept: {error} has no content to tell")
            return self._keys[g]

    def parts(self, g: int) -> np.ndarray:
        """(P,) int32: the parts that group g reaches, each once, in an order that its content decides."""
        with self._lock:
            if g not in self._parts:
                tables, found = self.geometry.instances, dict.fromkeys(self.geometry.group_parts[g])
                for b in self.geometry.group_batches[g]:
                    first = int(tables.group_first[b])
                    for child in tables.batch_groups[first : first + len(self.geometry.batches[b].groups)]:
                        found |= dict.fromkeys(self.parts(int(child)).tolist())
                self._parts[g] = np.array(list(found), np.int32)
            return self._parts[g]

    def _group_digest(self, g: int) -> bytes:
        geometry, tables = self.geometry, self.geometry.instances
        h = _hasher()
        self._feed(h, self._common)
        local = {part: i for i, part in enumerate(self.parts(g).tolist())}
        for part in geometry.group_parts[g]:
            mesh = geometry.parts[part]
            self._feed(
                h, (local[part], mesh.positions, mesh.triangles, mesh.normals, mesh.uvs, mesh.attributes)
            )
            self._feed(h, (mesh.material_index, mesh.active_uv, mesh.generated, len(mesh.materials)))
            for material in mesh.materials:
                self._feed(h, (None,) if material is None else (material.surface_graph, material.bump_method))
                self._feed(h, None if material is None else material.graph.displacement)
        for b in geometry.group_batches[g]:
            batch = geometry.batches[b]
            seen = None if batch.visibility is None else np.asarray(batch.visibility) & np.uint8(CAMERA)
            self._feed(h, ("batch", batch.transforms, batch.group_index, seen, len(batch.groups)))
            first = int(tables.group_first[b])
            for child in tables.batch_groups[first : first + len(batch.groups)].tolist():
                key = self.key(child)
                if key is None:
                    raise Unkeepable(f"group '{geometry.groups[child].name}'")
                self._feed(h, (key, tuple(local[part] for part in self.parts(child).tolist())))
        return h.digest()

    def _feed(self, h, value) -> None:
        """Add a value to the hash: what it is, how long, and what it holds."""
        if value is None or isinstance(value, (bool, int, float, str, bytes)):
            text = repr(value).encode()
            h.update(b"%s %d:" % (type(value).__name__.encode(), len(text)))
            h.update(text)
        elif isinstance(value, (tuple, list)):
            h.update(b"sequence %d:" % len(value))
            for v in value:
                self._feed(h, v)
        elif isinstance(value, dict):
            h.update(b"mapping %d:" % len(value))
            for k in sorted(value, key=repr):
                self._feed(h, k)
                self._feed(h, value[k])
        elif isinstance(value, (np.ndarray, np.generic)) or is_dataclass(value):
            h.update(self._once(value))
        else:
            raise Unkeepable(type(value).__name__)

    def _once(self, value) -> bytes:
        """Digest of an array or a dataclass, of each object only once."""
        if id(value) in self._hashed:
            return self._hashed[id(value)][1]
        h = _hasher()
        if is_dataclass(value):
            h.update(type(value).__qualname__.encode())
            for field in fields(value):
                self._feed(h, field.name)
                self._feed(h, getattr(value, field.name))
        else:
            if value.dtype.hasobject:
                raise Unkeepable("an array of objects")
            h.update(f"{value.dtype.str} {value.shape}:".encode())
            h.update(np.ascontiguousarray(value).data.cast("B") if value.size else b"")
        self._hashed[id(value)] = value, h.digest()
        return self._hashed[id(value)][1]


@cache
def _code() -> bytes:
    """Hash of the engine's modules that decide sets: another version of them must not find the files of this one."""
    h = _hasher()
    engine = Path(octree.__file__).parents[1]
    for name in _DECIDING:
        found = engine / name
        for path in sorted(found.rglob("*.py")) if found.is_dir() else [found]:
            h.update(path.relative_to(engine).as_posix().encode())
            h.update(path.read_bytes() if path.is_file() else b"")
    return h.digest()


def _hasher():
    return hashlib.blake2b(digest_size=20)


def _checked(arrays: dict[str, np.ndarray], nodes: int, parts: int) -> StoredSets:
    """The sets of a file's arrays. Raises ValueError or KeyError for what cannot be a level of that many nodes."""
    counts, row, emission = arrays["counts"], arrays["row"], arrays["emission"]
    source, place = arrays["source"], arrays["place"]
    n = len(row)
    expected = (
        (counts, np.int64, (nodes,)), (row, np.float32, (n, COLUMNS)), (source, np.int32, (n, 2)),
        (place, np.float32, (n, 2)), (emission, np.float32, (len(emission), 3)),
    )  # fmt: skip
    if any(a.dtype != dtype or a.shape != shape for a, dtype, shape in expected):
        raise ValueError("arrays of other shapes")
    if len(emission) not in (1, n) or (counts < 0).any() or counts.sum() != n:
        raise ValueError("its counts do not match")
    if n and not (np.isfinite(row).all() and 0 <= source[:, 0].min() and source[:, 0].max() < parts):
        raise ValueError("values out of range")
    return StoredSets(counts, Surfels(row, emission, source, place))
