"""Which fragments of triangles with holes have holes in their footprints: of these materials are read at one place, of
the others they are averaged as of any surface."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.forward.drawing.cut_out_cover import cell_of, cut_out_of
from pointmr_engine.numerics.jit import device, uncounted
from pointmr_engine.numerics.pointers import pointer_f32, pointer_i32
from pointmr_engine.shading.bsdf.vector import cross, dot, row3

CELLS = 16  # a footprint that reaches as many cells away is not searched: it may have holes
FLATTEST = 0.1  # cosine of the angle of view from which on footprints are as long as there


@device
def _edges(tables, p, t, m):
    """The edges from corner 0 to corners 1 and 2 of triangle t of part p, placed by m (3, 4), in world space."""
    corners, positions = pointer_i32(tables.triangles[p]), pointer_f32(tables.positions[p])
    a, b, c = 3 * np.int64(corners[3 * t]), 3 * np.int64(corners[3 * t + 1]), 3 * np.int64(corners[3 * t + 2])
    e0 = e1 = e2 = f0 = f1 = f2 = 0.0
    for s in range(3):
        o = np.float64(positions[a + s])
        e, f = positions[b + s] - o, positions[c + s] - o
        e0, e1, e2 = e0 + m[0, s] * e, e1 + m[1, s] * e, e2 + m[2, s] * e
        f0, f1, f2 = f0 + m[0, s] * f, f1 + m[1, s] * f, f2 + m[2, s] * f
    return (e0, e1, e2), (f0, f1, f2)


@device
def _all_opaque(cells, start, side, p, q, across, along):
    """Whether the cells up to `across` from column p and `along` from row q are all opaque."""
    for j in range(max(q - along, 0), min(q + along, side - 1) + 1):
        for i in range(max(p - across, 0), min(p + across, side - 1 - j) + 1):
            if cells[start + j * side + i] < 255:
                return False
    return True


@uncounted
def holes_in_footprints(cut_outs, tables, hits, direction, width, fragments, first, rows, out):
    """out (n,) bool: whether fragments first + rows (n,) int64, of triangles with holes, may have some in footprints.

    hits: Hits, of which transforms are read; direction (N, 3) float64 from the viewer, of unit length; width (N,)
    float32: of footprints, across the direction, metres.
    """
    for n in range(len(rows)):
        out[n] = True
        k = rows[n]
        f = first + k
        part, triangle = np.int64(fragments.part[f]), np.int64(fragments.triangle[f])
        mask = cut_out_of(cut_outs, part, triangle)
        side = np.int64(cut_outs.side[mask])
        b, c = _edges(tables, part, triangle, hits.world_from_part[k])
        normal = cross(b, c)
        area = math.sqrt(dot(normal, normal))
        facing = abs(dot(normal, row3(direction, k)))
        # how far the footprint reaches in cells: a weight is 1 over the height of the triangle above the opposite edge
        reach = side * np.float64(width[k]) / max(facing, FLATTEST * area) if area > 0.0 else math.inf
        across, along = reach * math.sqrt(dot(c, c)), reach * math.sqrt(dot(b, b))
        if max(across, along) < CELLS:
            p, q = cell_of(np.float64(fragments.place[f, 0]), np.float64(fragments.place[f, 1]), side)
            start = np.int64(cut_outs.start[mask])
            if _all_opaque(cut_outs.cells, start, side, p, q, np.int64(across) + 1, np.int64(along) + 1):
                out[n] = False
