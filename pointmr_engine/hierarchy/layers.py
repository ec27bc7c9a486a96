"""Attribute layers over all parts of a scene (UV layers, attributes, tangents): where they are, and interpolation."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numba import njit

from pointmr_engine.hierarchy.geometry import Geometry, triangle_materials
from pointmr_engine.hierarchy.tangents import corner_tangents
from pointmr_engine.hierarchy.triangle_prefetch import INDICES, VERTICES, prefetch_indices
from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.pointers import address_of, load_i32, pointer_f32, pointer_i32, prefetch
from pointmr_engine.scene.mesh import Mesh

NONE, VERTEX, CORNER, FACE, CONSTANT = range(5)
FIRST_LOOK = 1 << 10  # triangles, before all
_DOMAINS = {"vertex": VERTEX, "corner": CORNER, "face": FACE, "constant": CONSTANT}


class Layer(NamedTuple):
    """One row per part: where its values are, float32 (count, channels), and what they belong to."""

    address: np.ndarray  # (P,) uint64
    domain: np.ndarray  # (P,) int64: NONE where the mesh lacks the layer
    channels: np.ndarray  # (P,) int64


def uv_layer(mesh: Mesh, name: str) -> np.ndarray | None:
    """(T, 3, 2) of the layer `name`; "" is the active one (or the first)."""
    if name == "" and name not in mesh.uvs:
        name = mesh.active_uv if mesh.active_uv in mesh.uvs else next(iter(mesh.uvs), "")
    return mesh.uvs.get(name)


def _source(geometry: Geometry, part: int, kind: str, name: str) -> tuple[np.ndarray | None, int]:
    mesh = geometry.parts[part]
    if kind == "attribute":
        if name == "" and name not in mesh.attributes:  # the active colours: the first that has four channels
            name = next((n for n, a in mesh.attributes.items() if a.values.shape[1] == 4), "")
        found = mesh.attributes.get(name)
        if found is not None:
            return found.values, _DOMAINS[found.domain]
        return (mesh.uvs[name].reshape(-1, 2), CORNER) if name in mesh.uvs else (None, NONE)
    uv = uv_layer(mesh, name)
    if uv is None or not len(mesh.triangles):
        return None, NONE
    if kind == "tangent":
        return corner_tangents(mesh, uv).reshape(-1, 4), CORNER
    return uv.reshape(-1, 2), CORNER


def layer(geometry: Geometry, kind: str, name: str) -> Layer:
    """The layer of kind "uv", "tangent" or "attribute", made once per Geometry and kept by it."""
    with geometry.lock:
        found = geometry.layers.get((kind, name))
        if found is None:
            n = len(geometry.parts)
            found = Layer(np.zeros(n, np.uint64), np.zeros(n, np.int64), np.zeros(n, np.int64))
            for part in range(n):
                values, domain = _source(geometry, part, kind, name)
                if values is not None and values.size:
                    values = np.ascontiguousarray(values, np.float32)
                    geometry.kept.append(values)
                    found.address[part], found.domain[part] = address_of(values), domain
                    found.channels[part] = values.shape[1]
            geometry.layers[kind, name] = found
    return found


def even_layers(geometry: Geometry, material: int, needs: Iterable[str]) -> frozenset[str]:
    """Those of `needs` ("attribute:NAME") that have one value all over each triangle of a material.

    material: an index into Geometry.materials.
    """
    found = frozenset(need for need in needs if need.startswith("attribute:"))
    if not found:
        return found
    slots = np.flatnonzero(geometry.tables.slot_material == material)
    for part in np.unique(np.searchsorted(geometry.tables.first_slot, slots, side="right") - 1):
        own = np.flatnonzero(triangle_materials(geometry, part) == material)
        found = frozenset(n for n in found if _is_even(geometry, part, own, n.partition(":")[2]))
    return found


def _is_even(geometry: Geometry, part: int, triangles: np.ndarray, name: str) -> bool:
    values, domain = _source(geometry, part, "attribute", name)
    if domain not in (VERTEX, CORNER):
        return True
    mesh = geometry.parts[part]
    for own in np.split(triangles, [FIRST_LOOK]):  # most that differ do so early
        rows = mesh.triangles[own] if domain == VERTEX else 3 * own[:, None] + np.arange(3)
        corners = values[rows]
        if not (corners == corners[:, :1]).all():
            return False
    return True


@device
def _ask_for(tables, layer, p, t):
    """Begin to fetch a triangle's values; waits for the numbers of its vertices."""
    at, size = np.int64(layer.address[p]), 4 * layer.channels[p]
    if layer.domain[p] == VERTEX:
        for k in range(3 * t, 3 * t + 3):
            prefetch(at + size * np.int64(load_i32(tables.triangles[p], k)))
    elif layer.domain[p] != NONE:
        first = 3 * t if layer.domain[p] == CORNER else t
        prefetch(at + size * first)


@njit(cache=True, nogil=True, error_model="numpy")
def interpolate(tables, layer, part, triangle, u, v, out):
    """Values of a layer at surface points (u, v float64) into out (n, channels) float32.

    Missing layers give zeros. Where out has four channels and the layer fewer: one is repeated as a grey, the third
    is 0 if missing and the fourth 1, as Cycles converts attributes to colours.
    """
    wanted, count = out.shape[1], len(part)
    for i in range(count):
        if i + INDICES < count:
            p = np.int64(part[i + INDICES])
            if layer.domain[p] == VERTEX:
                prefetch_indices(tables, p, np.int64(triangle[i + INDICES]) - tables.first_triangle[p])
        if i + VERTICES < count:
            p = np.int64(part[i + VERTICES])
            _ask_for(tables, layer, p, np.int64(triangle[i + VERTICES]) - tables.first_triangle[p])
        p = part[i]
        domain, channels = layer.domain[p], layer.channels[p]
        if domain == NONE:
            for k in range(wanted):
                out[i, k] = np.float32(0)
            continue
        values = pointer_f32(layer.address[p])
        t = np.int64(triangle[i]) - tables.first_triangle[p]
        w0, w1, w2 = 1.0 - u[i] - v[i], u[i], v[i]
        a, b, c = np.int64(0), np.int64(0), np.int64(0)
        if domain == VERTEX:
            corners = pointer_i32(tables.triangles[p])
            a, b, c = np.int64(corners[3 * t]), np.int64(corners[3 * t + 1]), np.int64(corners[3 * t + 2])
        elif domain == CORNER:
            a, b, c = 3 * t, 3 * t + 1, 3 * t + 2
        elif domain == FACE:
            a, b, c = t, t, t
        for k in range(wanted):
            if k < channels:
                out[i, k] = (
                    w0 * values[a * channels + k]
                    + w1 * values[b * channels + k]
                    + w2 * values[c * channels + k]
                )
            elif k == 3:
                out[i, k] = np.float32(1)
            else:
                out[i, k] = out[i, 0] if channels == 1 else np.float32(0)
