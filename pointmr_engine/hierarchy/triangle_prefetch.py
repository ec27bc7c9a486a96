"""Begin to fetch what a kernel will read of a later triangle: neighbours in an image lie far apart in memory.

A triangle's vertex numbers are asked for some turns before its vertices, whose addresses they are, and these some turns
before they are used.
"""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.numerics.pointers import load_i32, prefetch

# turns of a loop before the one that uses a triangle
INDICES, VERTICES = 6, 3


@device
def prefetch_indices(tables, part, triangle):
    """Ask for the vertex numbers and the material slot. tables: PartTables; part, triangle (in its shape): int64."""
    prefetch(tables.triangles[part] + 12 * triangle)
    prefetch(tables.material_index[part] + 4 * triangle)


@device
def prefetch_positions(tables, part, triangle):
    """Ask for the corners; waits for their numbers."""
    for k in range(3 * triangle, 3 * triangle + 3):
        prefetch(tables.positions[part] + 12 * np.int64(load_i32(tables.triangles[part], k)))


@device
def prefetch_normals(tables, part, triangle):
    """Ask for the vertices' normals, if there are any; waits for their numbers."""
    at = tables.normals[part]
    if at == 0:
        return
    for k in range(3 * triangle, 3 * triangle + 3):
        vertex = k if tables.normals_per_corner[part] else np.int64(load_i32(tables.triangles[part], k))
        prefetch(at + 12 * vertex)
