"""Instances of an object's children on its vertices or faces, as arrays."""

from __future__ import annotations

import numpy as np

from . import transforms
from .meshes import floats, read
from .transforms import matrix


def dupli_frames(ob, mesh):
    """What an instancer's vertices or faces give to each of its children: (frames, positions (N, 3)).

    frames: faces' linear parts (N, 3, 3); vertex normals (N, 3), or None for vertices that do not rotate.
    """
    if not len(mesh.vertices):
        return None, np.empty((0, 3), np.float32)
    positions = read(mesh.attributes["position"], "vector", np.float32, (len(mesh.vertices), 3))
    if ob.instance_type == "VERTS":
        if not ob.use_instance_vertices_rotation:
            return None, positions
        return floats(mesh.vertex_normals, "vector", positions.shape), positions
    starts, totals = np.empty((2, len(mesh.polygons)), np.int32)
    mesh.polygons.foreach_get("loop_start", starts)
    mesh.polygons.foreach_get("loop_total", totals)
    corners = np.empty(0, np.int32)
    if len(mesh.loops):
        corners = read(mesh.attributes[".corner_vert"], "value", np.int32, (len(mesh.loops),))
    scale = ob.instance_faces_scale if ob.use_instance_faces_scale else None
    return transforms.face_frames(positions, starts, totals, corners, scale)


def child_transforms(ob, child, relative: np.ndarray, frames, positions: np.ndarray) -> np.ndarray:
    """Placements (N, 3, 4) of a child in its instancer's space; relative (4, 4): instancer_from_child."""
    linear, start = relative[:3, :3], relative[:3, 3]
    out = np.empty((len(positions), 3, 4))
    if ob.instance_type == "FACES":
        linear = linear @ matrix(child.matrix_parent_inverse)[:3, :3]
    for i in range(0, len(out), transforms.CHUNK):
        rows = slice(i, i + transforms.CHUNK)
        own = linear
        if ob.instance_type == "FACES":
            own = linear @ frames[rows]
        elif frames is not None:
            own = linear @ transforms.track_matrices(frames[rows], child.track_axis, child.up_axis)
        out[rows, :, :3] = own
        out[rows, :, 3] = positions[rows] + start
    return out
