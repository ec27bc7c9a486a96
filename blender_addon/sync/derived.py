"""What Cycles derives from a mesh for its Geometry node: Random Per Island, and Pointiness."""

from __future__ import annotations

import numpy as np

from pointmr_engine.scene.mesh import Attribute

from .seeds import hash_one

# by which materials ask for them, attributes like others
ISLAND, POINTINESS = ".random_per_island", ".pointiness"
DERIVED = {"Random Per Island": ISLAND, "Pointiness": POINTINESS}  # by the node's outputs
# of strands of hair, by outputs of the Hair Info node
STRAND = {
    "Is Strand": ".is_strand",
    "Intercept": ".intercept",
    "Length": ".length",
    "Thickness": ".thickness",
    "Random": ".strand_random",
}


def derived(name: str, mesh, triangles: np.ndarray, positions: np.ndarray) -> Attribute:
    """The attribute of that name of a bpy Mesh: triangles (T, 3) of vertices at positions (V, 3)."""
    edges = np.empty(2 * len(mesh.edges), np.int32)
    if len(edges):
        mesh.attributes[".edge_verts"].data.foreach_get("value", edges)
    edges = edges.reshape(-1, 2)
    if name == ISLAND:
        return random_per_island(edges, triangles, len(positions))
    normals = np.empty(3 * len(positions), np.float32)
    mesh.vertex_normals.foreach_get("vector", normals)
    return pointiness(edges, positions, normals.reshape(-1, 3))


def pointiness(edges: np.ndarray, positions: np.ndarray, normals: np.ndarray) -> Attribute:
    """By how much vertices stick out: the angle between normal and edges over half a turn, blurred once along these.

    edges (E, 2), positions and normals (V, 3). Vertices at one place count as one.
    """
    _, first, place = np.unique(positions, axis=0, return_index=True, return_inverse=True)
    place, count = place.ravel(), len(first)
    normal = _sums(place, normals.astype(np.float64), count)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    edges = np.unique(np.sort(place[edges], 1), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]
    at = positions[first].astype(np.float64)
    along = at[edges[:, 1]] - at[edges[:, 0]]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
    both, ends = np.concatenate([along, -along]), edges.T.ravel()
    number = np.bincount(ends, minlength=count)
    mean = _sums(ends, both, count) / np.maximum(number, 1)[:, None]
    angle = np.arccos(np.clip((normal * mean).sum(1), -1.0, 1.0)) / np.pi
    angle[number == 0] = 0.0
    beside = np.bincount(ends, angle[edges[:, ::-1].T.ravel()], count)
    blurred = (angle + beside) / (number + 1)
    return Attribute(blurred[place].astype(np.float32)[:, None], "vertex")


def _sums(rows: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """(count, 3): sums of the values (N, 3) of each row (N,)."""
    return np.stack([np.bincount(rows, values[:, k], count) for k in range(3)], 1)


def random_per_island(edges: np.ndarray, triangles: np.ndarray, count: int) -> Attribute:
    """A number in 0..1 for each of the triangles (T, 3) of `count` vertices, by the part that edges (E, 2) connect."""
    # kernels, which registering the add-on does not load
    from pointmr_engine.numerics.disjoint_sets import connected

    roots = connected(edges, triangles[:, 0], count)
    values = hash_one(roots.astype(np.uint32)).astype(np.float32) / np.float32(0xFFFFFFFF)
    return Attribute(values[:, None], "face")
