"""Instances of an object's children on its vertices or faces, as arrays."""

from __future__ import annotations

import numpy as np

from . import transforms
from .transforms import matrix


def dupli_frames(ob, mesh):
    """What an instancer's vertices or faces give to each of its children: (frames, positions (N, 3)).

    frames: faces' linear parts (N, 3, 3); vertex normals (N, 3), or None for vertices that do not rotate.
    """
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", positions)
    positions = positions.reshape(-1, 3)
    if ob.instance_type == "VERTS":
        if not ob.use_instance_vertices_rotation:
            return None, positions
        normals = np.empty(positions.size, np.float32)
        mesh.vertex_normals.foreach_get("vector", normals)
        return normals.reshape(-1, 3), positions
    starts, totals = np.empty((2, len(mesh.polygons)), np.int32)
    mesh.polygons.foreach_get("loop_start", starts)
    mesh.polygons.foreach_get("loop_total", totals)
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    scale = ob.instance_faces_scale if ob.use_instance_faces_scale else None
    return transforms.face_frames(positions, starts, totals, corners, scale)


def child_transforms(ob, child, relative: np.ndarray, frames, positions: np.ndarray) -> np.ndarray:
    """Placements (N, 3, 4) of a child in its instancer's space; relative (4, 4): instancer_from_child."""
    linear = relative[:3, :3]
    if ob.instance_type == "FACES":
        linear = linear @ matrix(child.matrix_parent_inverse)[:3, :3] @ frames
    elif frames is not None:
        linear = linear @ transforms.track_matrices(frames, child.track_axis, child.up_axis)
    return transforms.affine(linear, positions + relative[:3, 3])
