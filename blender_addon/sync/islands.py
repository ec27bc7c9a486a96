"""Islands of meshes, the parts that edges connect: Geometry's Random Per Island, as Cycles draws it."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.disjoint_sets import join_edges, roots_of
from pointmr_engine.scene.mesh import Attribute

from .seeds import hash_one

ISLAND = ".random_per_island"  # by which materials ask for it, an attribute like others


def random_per_island(mesh, triangles: np.ndarray) -> Attribute:
    """A number in 0..1 for each of the triangles (T, 3) of vertices of a bpy Mesh, by its island."""
    count = len(mesh.vertices)
    edges = np.empty(2 * len(mesh.edges), np.int32)
    mesh.attributes[".edge_verts"].data.foreach_get("value", edges)
    parent, rank = np.arange(count, dtype=np.int32), np.zeros(count, np.int32)
    join_edges(edges.reshape(-1, 2), parent, rank)
    roots = np.empty(len(triangles), np.int32)
    roots_of(np.ascontiguousarray(triangles[:, 0]), parent, roots)
    values = hash_one(roots.astype(np.uint32)).astype(np.float32) / np.float32(0xFFFFFFFF)
    return Attribute(values[:, None], "face")
