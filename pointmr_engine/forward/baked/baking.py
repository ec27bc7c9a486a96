"""What a sample keeps of its material: the part that the surface alone decides, reduced to colour, emission and
alpha."""

from __future__ import annotations

import numpy as np

from pointmr_engine.forward.baked.triangle_normals import interpolated_normal
from pointmr_engine.hierarchy.candidates import Look
from pointmr_engine.hierarchy.geometry import Geometry
from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.pointers import load_i32
from pointmr_engine.raytracing.surface import points_at
from pointmr_engine.shading.leaves import reduce_leaves
from pointmr_engine.shading.points import RAY_CAMERA, SurfacePoints
from pointmr_engine.shading.program import Program


class Baker:
    """Materials at surface points in their mesh's space; see hierarchy.sample_sets.Looks. Threads may share it."""

    def __init__(self, geometry: Geometry, programs: list[Program]):
        self.geometry, self.programs = geometry, programs
        self._constant: dict[int, tuple] = {}

    def constant_looks(self) -> np.ndarray:
        """(materials, 7) float32: albedo, emission and 1 of the materials that are the same everywhere; else 0."""
        looks = np.zeros((max(1, len(self.programs)), 7), np.float32)
        for m, program in enumerate(self.programs):
            if not program.needs:
                albedo, emission, _ = reduce_leaves(program.evaluate(SurfacePoints(count=1)), 1)
                looks[m, :3], looks[m, 3:6], looks[m, 6] = albedo[0], emission[0], 1
        return looks

    def __call__(self, part, triangle, u, v, width, ray_kind: int = RAY_CAMERA) -> Look:
        """Looks of points (n,) of triangles in their shapes, averaged over `width` (n,) metres where images are.

        ray_kind: bits RAY_* of the rays that look, for materials that ask.
        """
        geometry = self.geometry
        n = len(part)
        look = Look(
            np.empty((n, 3), np.float32),
            np.zeros((n, 3), np.float32),
            np.zeros((n, 3), np.float32),
            np.ones(n, np.float32),
        )
        part, triangle = np.ascontiguousarray(part, np.int32), np.ascontiguousarray(triangle, np.int32)
        u, v = np.ascontiguousarray(u, np.float32), np.ascontiguousarray(v, np.float32)
        material = np.empty(n, np.int32)
        _normals_and_materials(geometry.tables, part, triangle, u, v, look.normal, material)
        present = np.flatnonzero(np.bincount(material, minlength=1))
        for m in present.tolist():
            program = self.programs[m]
            rows = slice(None) if len(present) == 1 else np.flatnonzero(material == m)
            if not program.needs:
                if m not in self._constant:
                    self._constant[m] = reduce_leaves(program.evaluate(SurfacePoints(count=1)), 1)
                albedo, emission, alpha = self._constant[m]
            else:
                chosen = np.arange(n) if isinstance(rows, slice) else rows
                points = points_at(
                    geometry, part[chosen], triangle[chosen] + geometry.tables.first_triangle[part[chosen]],
                    u[chosen], v[chosen], np.broadcast_to(np.eye(4)[:3], (len(chosen), 3, 4)), program.needs,
                )  # fmt: skip
                if points.footprint is not None:
                    points.footprint = np.ascontiguousarray(width[chosen], np.float32)
                if points.ray_kind is not None:
                    points.ray_kind[:] = ray_kind
                albedo, emission, alpha = reduce_leaves(program.evaluate(points), len(chosen))
            look.albedo[rows] = albedo
            if emission.any():
                look.emission[rows] = emission
            if (alpha != 1.0).any():
                look.alpha[rows] = alpha
        return look


@uncounted
def _normals_and_materials(tables, part, triangle, u, v, normal, material):
    for k in range(len(part)):
        p, t = np.int64(part[k]), np.int64(triangle[k])
        slot = np.int64(0)
        if tables.material_index[p] != 0:
            slot = load_i32(tables.material_index[p], t)
            slot = min(max(slot, np.int64(0)), np.int64(tables.slots[p]) - 1)
        material[k] = tables.slot_material[tables.first_slot[p] + slot]
        x, y, z = interpolated_normal(tables, p, t, np.float64(u[k]), np.float64(v[k]))
        length = np.sqrt(x * x + y * y + z * z)
        scale = 1.0 / length if length > 0.0 else 0.0
        normal[k, 0], normal[k, 1], normal[k, 2] = x * scale, y * scale, z * scale


@uncounted
def materials_of(tables, part, triangle, out):
    """Material (index into Geometry.materials) of triangles (n,) in their shapes, into out (n,) int32; tables:
    PartTables."""
    for k in range(len(part)):
        p = np.int64(part[k])
        slot = np.int64(0)
        if tables.material_index[p] != 0:
            slot = load_i32(tables.material_index[p], np.int64(triangle[k]))
            slot = min(max(slot, np.int64(0)), np.int64(tables.slots[p]) - 1)
        out[k] = tables.slot_material[tables.first_slot[p] + slot]
