"""Nested scenes and a flat reference for them: every triangle in world space, every ray against every triangle."""

from __future__ import annotations

import numpy as np

from pointmr_engine.hierarchy.acceleration import build_acceleration
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.numerics.hashing import hash_path
from pointmr_engine.raytracing import walk
from pointmr_engine.raytracing.rays import allocate_hits, allocate_rays
from pointmr_engine.scene.group import Group, Instances
from pointmr_engine.scene.mesh import Mesh
from pointmr_engine.scene.scene import Scene


def random_mesh(rng, triangles: int = 20, size: float = 1.0, center=(0.0, 0.0, 0.0), **values) -> Mesh:
    """Triangles anywhere, of any shape, in float64."""
    corners = rng.normal(size=(triangles, 1, 3)) + 0.3 * rng.normal(size=(triangles, 3, 3))
    positions = corners.reshape(-1, 3) * size + np.asarray(center)
    order = rng.permutation(len(positions))
    back = np.argsort(order)
    return Mesh(
        "random", positions[order], back[np.arange(3 * triangles)].reshape(-1, 3).astype(np.int32), **values
    )


def random_transforms(rng, n: int, scale=(1.0, 1.0), spread: float = 3.0, mirror: bool = True) -> np.ndarray:
    """(n, 3, 4): rotations, non-uniform scales, mirrorings and shifts."""
    q, _ = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    if not mirror:
        q *= np.linalg.det(q)[:, None, None]
    sizes = np.exp(
        rng.uniform(np.log(scale[0]), np.log(scale[1]), (n, 1, 1)) + rng.uniform(-0.5, 0.5, (n, 1, 3))
    )
    return np.concatenate([q * sizes, spread * rng.normal(size=(n, 3, 1))], axis=2)


def sphere(rings: int = 12, segments: int = 16, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A closed sphere with shared vertices: positions (V, 3) float32, triangles (T, 3) int32 wound outwards."""
    theta, phi = np.meshgrid(
        np.arange(1, rings) * np.pi / rings, np.arange(segments) * 2 * np.pi / segments, indexing="ij"
    )
    body = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(
        -1, 3
    )
    positions = np.concatenate([body, [[0, 0, 1]], [[0, 0, -1]]])
    top, bottom = len(body), len(body) + 1
    faces = []
    for s in range(segments):
        nxt = (s + 1) % segments
        faces += [(top, s, nxt), (bottom, (rings - 2) * segments + nxt, (rings - 2) * segments + s)]
        for r in range(rings - 2):
            a, b = r * segments + s, r * segments + nxt
            faces += [(a, a + segments, b), (b, a + segments, b + segments)]
    return (positions * radius).astype(np.float32), np.array(faces, np.int32)


def accelerate(root: Group):
    """(geometry, acceleration) of a root group."""
    geometry = compile_geometry(Scene(root))
    return geometry, build_acceleration(geometry)


def scene_rays(origin, direction, **values):
    """Rays and room for their hits."""
    origin, direction = np.atleast_2d(origin).astype(float), np.atleast_2d(direction).astype(float)
    n = max(len(origin), len(direction))
    rays, hits = allocate_rays(n), allocate_hits(n)
    rays.origin[:] = origin
    rays.direction[:] = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    for name, value in values.items():
        getattr(rays, name)[:] = value
    return rays, hits


def cast(acceleration, origin, direction, **values):
    """Closest hits of rays."""
    rays, hits = scene_rays(origin, direction, **values)
    walk.intersect(acceleration, rays, hits)
    return rays, hits


class Flat:
    """All placed triangles of a scene: corners (N, 3, 3) float64, their scene-wide numbers and paths."""

    def __init__(self, geometry):
        self.geometry = geometry
        self.batch_index = {id(b): i for i, b in enumerate(geometry.batches)}
        corners, numbers, paths = [], [], []

        def visit(group: Group, world: np.ndarray, path: int) -> None:
            for mesh in group.meshes:
                part = next(i for i, m in enumerate(geometry.parts) if m is mesh)
                p = np.asarray(mesh.positions, np.float64)[mesh.triangles]
                corners.append(p @ world[:, :3].T + world[:, 3])
                numbers.append(np.arange(len(p)) + geometry.tables.first_triangle[part])
                paths.append(np.full(len(p), path, np.uint64))
            for batch in group.instances:
                first = geometry.instances.first_record[self.batch_index[id(batch)]]
                for i, m in enumerate(batch.transforms):
                    below = np.concatenate(
                        [world[:, :3] @ m[:, :3], world[:, :3] @ m[:, 3:] + world[:, 3:]], axis=1
                    )
                    child = batch.groups[0 if batch.group_index is None else batch.group_index[i]]
                    visit(child, below, hash_path(np.uint64(path), np.int64(first + i)))

        visit(geometry.groups[-1], np.eye(4)[:3], 0)
        self.corners = np.concatenate(corners)
        self.numbers, self.paths = np.concatenate(numbers), np.concatenate(paths)

    def closest(self, origin, direction, t_min=0.0, t_max=np.inf):
        """(t, row, margin): margin is how far inside the triangle and ahead of the next hit the answer is."""
        a = self.corners[:, 0]
        e1, e2 = self.corners[:, 1] - a, self.corners[:, 2] - a
        with np.errstate(all="ignore"):
            p = np.cross(direction, e2)
            det = (e1 * p).sum(1)
            s = origin - a
            u = (s * p).sum(1) / det
            q = np.cross(s, e1)
            v = q @ direction / det
            t = (e2 * q).sum(1) / det
            inside = np.minimum(np.minimum(u, v), 1 - u - v)
        inside = np.where(np.isfinite(inside), inside, -np.inf)
        # nearly hit: cannot be told
        blurred = np.where((inside > -1e-3) & (t > t_min) & (t < t_max), t, np.inf)
        t = np.where((inside >= 0) & (t > t_min) & (t < t_max), t, np.inf)
        row = int(np.argmin(t))
        others = np.delete(blurred, row)
        gap = (others.min(initial=np.inf) - t[row]) if np.isfinite(t[row]) else -1.0
        clear = (
            np.isinf(blurred).all()
            if np.isinf(t[row])
            else (inside[row] > 1e-3 and gap > 1e-3 * (1 + t[row]))
        )
        return t[row], row, bool(clear)


def nest(rng, depth: int, leaf: Group, n: int = 3, **transforms) -> Group:
    """`depth` levels of n placements each above a leaf group."""
    group = leaf
    for level in range(depth):
        group = Group(f"level {level}", [], [Instances((group,), random_transforms(rng, n, **transforms))])
    return group
