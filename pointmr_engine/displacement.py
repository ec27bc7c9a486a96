"""True displacement: vertices moved by their materials, before hierarchies are built over them.

What Cycles does without adaptive subdivision, and of meshes alone: each vertex moves once, by the material of its first
triangle, as far as the graph says there, along its own normal, even where its triangles are shaded flat. So detail is
what the mesh has vertices for; a Subdivision Surface modifier gives it more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointmr_engine.hierarchy.geometry import Geometry, with_parts
from pointmr_engine.hierarchy.layers import uv_layer
from pointmr_engine.hierarchy.tangents import corner_tangents
from pointmr_engine.raytracing.surface import points_at
from pointmr_engine.scene.material import RESTING, RESTING_NORMAL, resting_tangent
from pointmr_engine.scene.mesh import GENERATED, Attribute, Mesh
from pointmr_engine.shading.displacement import Displacement

FLAT = 1e-4  # of corners that have normals of their own, from that of the triangle: it is flat


def displaced(geometry: Geometry) -> tuple[Geometry, list[str]]:
    """(the geometry with displaced meshes in their parts' places, warnings); itself where nothing is displaced.

    Textures are read unfiltered, in the mesh's own space: "world" and "object" displacement are the same there.
    Materials of method "DISPLACEMENT" shade the moved surface, those of "BOTH" the resting one, which is smooth if its
    mesh is flat, with their displacement as bump.
    """
    programs: dict[int, Displacement] = {}
    warnings: list[str] = []
    for material in geometry.materials:
        if material is not None and material.moves_vertices:
            program = programs[id(material)] = Displacement(material.graph)
            warnings += [f"material '{material.name}', displacement: {w}" for w in program.warnings]
    if not programs:
        return geometry, warnings
    parts, made = list(geometry.parts), {}
    for p, mesh in enumerate(parts):
        if any(m is not None and m.reads_resting for m in mesh.materials):
            at_rest = Attribute(mesh.positions.astype(np.float32, copy=False), "vertex")
            mesh = parts[p] = replace(mesh, attributes=mesh.attributes | {RESTING: at_rest})
        if mesh.displaceable and any(id(m) in programs for m in mesh.materials):
            # parts that share arrays and materials go on sharing
            key = (
                *(id(a) for a in (mesh.positions, mesh.triangles, mesh.normals, mesh.material_index)),
                *(id(uv) for uv in mesh.uvs.values()),
                mesh.active_uv,
                mesh.materials,
            )
            if key not in made:
                made[key] = *_displace(geometry, p, mesh, programs, warnings), _frames_at_rest(mesh)
            positions, normals, frames = made[key]
            attributes = {GENERATED: _generated(geometry, p, mesh)} | mesh.attributes | frames
            parts[p] = replace(mesh, positions=positions, normals=normals, attributes=attributes)
    return with_parts(geometry, parts), warnings


def _displace(geometry: Geometry, p: int, mesh: Mesh, programs: dict, warnings: list[str]):
    """(positions, normals) of part p, moved."""
    slots = np.zeros(len(mesh.triangles), np.int64)
    if mesh.material_index is not None and len(mesh.materials) > 1:
        slots = np.clip(mesh.material_index, 0, len(mesh.materials) - 1)
    moves = np.array([id(m) in programs for m in mesh.materials])[slots]
    corners = np.flatnonzero(np.repeat(moves, 3))
    vertices, first = np.unique(
        np.ascontiguousarray(mesh.triangles, np.int64).ravel()[corners], return_index=True
    )
    corner = corners[first]  # of each vertex, the first in a triangle that moves it
    upright = mesh.normals
    if upright is None or upright.ndim == 3:  # triangles about a vertex have normals of their own
        upright = _vertex_normals(mesh)
    offset = np.zeros((len(vertices), 3))
    for slot, material in enumerate(mesh.materials):
        rows = np.flatnonzero(slots[corner // 3] == slot)
        if id(material) in programs and len(rows):
            up = upright[vertices[rows]]
            offset[rows] = _offsets(geometry, p, corner[rows], up, programs[id(material)])
    lost = ~np.isfinite(offset).all(1)
    if lost.any():
        warnings.append(
            f"mesh '{mesh.name}': {int(lost.sum())} vertices have no finite displacement; they stay"
        )
        offset[lost] = 0.0
    positions = mesh.positions.copy()
    positions[vertices] += offset.astype(positions.dtype)
    shades_moved = np.array([m is not None and m.shades_moved for m in mesh.materials])[slots]
    return positions, _normals(mesh, positions, shades_moved, moves & ~shades_moved, upright)


def _generated(geometry: Geometry, p: int, mesh: Mesh) -> Attribute:
    """Generated coordinates of the resting vertices, which they keep."""
    lower, upper = geometry.tables.generated[p]
    size = np.where(upper != lower, upper - lower, np.inf)
    return Attribute(((mesh.positions - lower) / size).astype(np.float32), "vertex")


def _frames_at_rest(mesh: Mesh) -> dict[str, Attribute]:
    """Normals and tangents of the resting mesh, as far as its materials' normal maps read them."""
    layers = frozenset().union(*(m.mapped_at_rest for m in mesh.materials if m is not None))
    if not layers:
        return {}
    normals = np.zeros((len(mesh.triangles), 3, 3), np.float32)
    if mesh.normals is not None:
        normals[:] = _corners(mesh, mesh.positions, mesh.normals)
        if mesh.normals.ndim == 3:
            own = _of_triangles(mesh, mesh.positions)[:, None]
            normals[(np.abs(normals - own) < FLAT).all((1, 2))] = 0.0
    found = {RESTING_NORMAL: Attribute(normals.reshape(-1, 3))}
    for name in layers:
        uv = uv_layer(mesh, name)
        if uv is not None:
            found[resting_tangent(name)] = Attribute(corner_tangents(mesh, uv).reshape(-1, 4))
    return found


def _offsets(
    geometry: Geometry, p: int, corner: np.ndarray, normal: np.ndarray, program: Displacement
) -> np.ndarray:
    """(n, 3) of the vertices at corners (n,) of part p, 3 to a triangle, whose normals are (n, 3)."""
    n = len(corner)
    triangle = corner // 3 + int(geometry.tables.first_triangle[p])
    points = points_at(
        geometry, np.full(n, p, np.int32), triangle.astype(np.int32), (corner % 3 == 1).astype(np.float32),
        (corner % 3 == 2).astype(np.float32), np.broadcast_to(np.eye(4)[:3], (n, 3, 4)), program.needs,
    )  # fmt: skip
    if points.normal is not None:
        points.normal = normal.astype(np.float32)
    return program.offset(points)


def _normals(
    mesh: Mesh, positions: np.ndarray, moved: np.ndarray, resting: np.ndarray, upright: np.ndarray
) -> np.ndarray | None:
    """Normals of the moved mesh, in the layout of the mesh's own, or per corner where that cannot hold them.

    moved (T,): triangles that shade the moved surface; those beside them that are not displaced share its normals.
    resting (T,): triangles that keep the normals that they had; of a flat mesh these are `upright` (V, 3).
    """
    old = mesh.normals
    kept = upright if old is None else old
    if resting.all():
        return kept
    new = None if old is None else _smooth(mesh, positions, old, moved)
    if not resting.any():
        return new
    return np.where(resting[:, None, None], _corners(mesh, positions, kept), _corners(mesh, positions, new))


def _corners(mesh: Mesh, positions: np.ndarray, normals: np.ndarray | None) -> np.ndarray:
    """(T, 3, 3) float32: normals per corner, of flat triangles their own."""
    if normals is None:
        return np.repeat(_of_triangles(mesh, positions)[:, None], 3, 1).astype(np.float32)
    return normals if normals.ndim == 3 else normals[mesh.triangles]


def _smooth(mesh: Mesh, positions: np.ndarray, old: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Means of the normals of `moved` triangles about each vertex; of corners, among those that had one normal.

    What touches none of these triangles is as it was.
    """
    group = mesh.triangles.ravel().astype(np.int64)
    count = len(positions)
    if old.ndim == 3:  # sharp edges part the corners of a vertex
        x, y, z = (np.round(np.clip(old, -1, 1).reshape(-1, 3) * 1000.0) + 1000.0).astype(np.int64).T
        kinds, group = np.unique(group << 33 | x << 22 | y << 11 | z, return_inverse=True)
        count = len(kinds)
    faces = np.repeat(_of_triangles(mesh, positions) * moved[:, None], 3, 0)
    mean = _unit(_sums(faces, group, count))
    found = (mean if old.ndim == 2 else mean[group].reshape(old.shape)).astype(np.float32)
    unknown = (found == 0.0).all(-1)
    found[unknown] = old[unknown]  # of vertices without such triangles, and where these cancel
    return found


def _vertex_normals(mesh: Mesh) -> np.ndarray:
    """(V, 3) float32: means of the corners' normals about each vertex, weighted by their angles, as Blender's of flat
    triangles; up where there are none.
    """
    corners = mesh.positions[mesh.triangles].astype(np.float64)
    leave, arrive = (_unit(np.roll(corners, -k, 1) - corners) for k in (1, 2))
    angle = np.arccos(np.clip((leave * arrive).sum(-1), -1.0, 1.0))
    weighted = (_corners(mesh, mesh.positions, mesh.normals) * angle[..., None]).reshape(-1, 3)
    normals = _unit(_sums(weighted, mesh.triangles.ravel(), len(mesh.positions))).astype(np.float32)
    normals[(normals == 0.0).all(1)] = (0.0, 0.0, 1.0)
    return normals


def _of_triangles(mesh: Mesh, positions: np.ndarray) -> np.ndarray:
    """(T, 3) float64 unit normals; 0 of what has no area."""
    a, b, c = (positions[mesh.triangles[:, k]].astype(np.float64) for k in range(3))
    return _unit(np.cross(b - a, c - a))


def _sums(vectors: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """(count, 3): sums of the vectors (N, 3) of each group (N,)."""
    return np.stack([np.bincount(group, vectors[:, c], count) for c in range(3)], 1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of length 1; 0 of those that have none."""
    length = np.sqrt((vectors * vectors).sum(-1, keepdims=True))
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
