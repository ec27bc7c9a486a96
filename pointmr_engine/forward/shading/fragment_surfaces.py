"""Fragments as surface points in world space: what material programs and lobes read, as a ray's hit would give it."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.drawing.draw import Entries
from pointmr_engine.forward.drawing.surfel_lanes import FLAT, ROUND
from pointmr_engine.forward.drawing.transforms import Transforms
from pointmr_engine.forward.reconstruction.fragments import Fragments
from pointmr_engine.forward.shading.placement_values import PlacementValues
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.scene.group import HOLDOUT

NO_EYES = np.empty((0, 2))  # all fragments are seen from the lens' centre


@uncounted
def place_fragments(view, pixel, world_from_camera, octree, tables, transforms: Transforms, fragments: Fragments, first,
                    eyes, count, rays, hits, width):  # fmt: skip
    """Rays and hits 0..count of fragments first..first + count: as if a camera ray had met each.

    view: of the image; pixel: the width of a pixel, at distance 1 along the view axis or in metres (orthographic);
    width (N,) float32: the pixel's footprint there, metres. octree: OctreeArrays; tables: PartTables;
    transforms: the tile's; eyes (F, 2) float64: points of the lens that see the fragments, or of none: its centre.
    """
    c, matrix = world_from_camera, transforms.matrix
    for k in range(count):
        f = first + k
        x, y, z = fragments.position[f, 0], fragments.position[f, 1], fragments.position[f, 2]
        if len(eyes) > 0:
            x, y = x - eyes[f, 0], y - eyes[f, 1]
        if view.perspective:
            far = math.sqrt(x * x + y * y + z * z)
            inverse = 1.0 / far if far > 0.0 else 0.0
            slant = far / z if z > 0.0 else 1.0
            hits.t[k] = far - view.near * slant
            width[k] = pixel * far / (slant * math.sqrt(slant))
            x, y, z = x * inverse, y * inverse, z * inverse
        else:
            hits.t[k] = z - view.near
            width[k] = pixel
            x, y, z = 0.0, 0.0, 1.0
        for r in range(3):
            rays.direction[k, r] = c[r, 0] * x + c[r, 1] * y + c[r, 2] * z
        part, row = np.int64(fragments.part[f]), np.int64(fragments.row[f])
        hits.part[k] = part
        hits.triangle[k] = tables.first_triangle[part] + fragments.triangle[f]
        hits.u[k] = fragments.place[f, 0]
        hits.v[k] = fragments.place[f, 1]
        group = np.int64(transforms.group[row])
        for r in range(3):
            for s in range(4):
                value = c[r, 0] * matrix[row, s] + c[r, 1] * matrix[row, 4 + s] + c[r, 2] * matrix[row, 8 + s]
                if s == 3:
                    value += c[r, 3]
                hits.world_from_part[k, r, s] = value
            for s in range(3):
                hits.world_from_part[k, r, 3] -= hits.world_from_part[k, r, s] * octree.group_center[group, s]


@uncounted
def place_values(values: PlacementValues, fragments: Fragments, first, count, hits):
    """What the placements of fragments first..first + count say, into hits 0..count."""
    for k in range(count):
        row = np.int64(fragments.row[first + k])
        hits.path[k] = values.path[row]
        hits.seed[k] = values.seed[row]
        hits.object_index[k] = values.object_index[row]
        hits.instance[k] = values.instance[row]
        hits.holdout[k] = (values.flags[row] & HOLDOUT) != 0
        for c in range(4):
            hits.color[k, c] = values.color[row, c]


@uncounted
def surfel_frames(
    world_from_camera, entries: Entries, fragments: Fragments, first, count, rays, frames, flat, spread
):
    """Surfels' own positions and normals instead of those of the triangles that represent them; triangles' normals.

    frames: as raytracing.frames has filled them from the triangles. flat (N,) float32: 1 where the piece is flat, 0
    where it faces all directions. spread (N,) float32: variance of the slopes of the piece's normals, per axis
    (Toksvig; von Mises and Fisher's kappa of the mean normal's length). Normals of triangles are written back to the
    fragments, in camera space.
    """
    c = world_from_camera
    for k in range(count):
        f = first + k
        nx, ny, nz = (
            np.float64(fragments.normal[f, 0]),
            np.float64(fragments.normal[f, 1]),
            np.float64(fragments.normal[f, 2]),
        )
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        if entries.surfel[fragments.entry[f]] < 0:
            flat[k] = 1.0
            spread[k] = 0.0
            for r in range(3):
                fragments.normal[f, r] = (
                    c[0, r] * frames.smooth_normal[k, 0]
                    + c[1, r] * frames.smooth_normal[k, 1]
                    + c[2, r] * frames.smooth_normal[k, 2]
                )
            continue
        flat[k] = min(max((length - ROUND) / (FLAT - ROUND), 0.0), 1.0)
        square = min(length * length, 1.0)
        spread[k] = min((1.0 - square) / max(length * (3.0 - square), 1e-6), 2.0)
        inverse = 1.0 / length if length > 0.0 else 0.0
        nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
        x, y, z = fragments.position[f, 0], fragments.position[f, 1], fragments.position[f, 2]
        facing = 0.0
        for r in range(3):
            normal = c[r, 0] * nx + c[r, 1] * ny + c[r, 2] * nz
            facing += normal * rays.direction[k, r]
            frames.smooth_normal[k, r] = normal
            frames.geometric_normal[k, r] = normal
            frames.position[k, r] = c[r, 0] * x + c[r, 1] * y + c[r, 2] * z + c[r, 3]
        frames.backfacing[k] = facing > 0.0
