"""Hair and point clouds as triangles: tubes along strands, spheres at points."""

from __future__ import annotations

import numpy as np

from pointmr_engine.scene.group import Group, Instances
from pointmr_engine.scene.mesh import Mesh

SIDES = 4
MAX_HAIR_KEYS = 4_000_000  # above this, particle hair is thinned out, with a warning


def tubes(
    name: str, points: np.ndarray, starts: np.ndarray, counts: np.ndarray, radius: np.ndarray
) -> Mesh | None:
    """Open tubes of SIDES sides along strands of points.

    points (P, 3), radius (P,); strand s holds counts[s] points from starts[s] on. None if no strand has two points.
    """
    long = counts > 1
    starts, counts = starts[long].astype(np.int64), counts[long].astype(np.int64)
    if not len(starts):
        return None
    total = int(counts.sum())
    first = np.cumsum(counts) - counts
    strand = np.repeat(np.arange(len(counts)), counts)
    pick = np.arange(total) - first[strand] + starts[strand]
    p, r = points[pick].astype(np.float64), radius[pick].astype(np.float64)
    row = np.arange(total)
    last = first + counts - 1
    ahead, behind = row + 1, row - 1
    ahead[last], behind[first] = last, first
    tangent = unit(p[ahead] - p[behind])
    # one reference axis per strand, the one it runs along least: the tube does not twist
    run = np.abs(p[last] - p[first])
    reference = np.eye(3)[np.argmin(run, 1)][strand]
    side = unit(np.cross(tangent, reference))
    up = np.cross(tangent, side)
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    normal = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    positions = (p[:, None] + normal * r[:, None, None]).reshape(-1, 3)
    lower = np.delete(row, last)[:, None] * SIDES + np.arange(SIDES)
    right = np.delete(row, last)[:, None] * SIDES + (np.arange(SIDES) + 1) % SIDES
    triangles = np.stack([lower, right, right + SIDES, lower, right + SIDES, lower + SIDES], 2).reshape(-1, 3)
    return Mesh(
        name,
        positions.astype(np.float32),
        triangles.astype(np.int32),
        normal.reshape(-1, 3).astype(np.float32),
    )


def unit(v: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) at length 1, x where they have none."""
    length = np.sqrt((v * v).sum(1, keepdims=True))
    return np.where(length > 0, v / np.where(length > 0, length, 1), [1.0, 0.0, 0.0])


def read_points(data, name: str, channels: int, count: int, default: float) -> np.ndarray:
    """A point attribute of Curves or PointCloud as (count, channels) float32, `default` where it is missing."""
    attribute = data.attributes.get(name)
    if attribute is None or attribute.domain != "POINT":
        return np.full((count, channels), default, np.float32)
    out = np.empty(count * channels, np.float32)
    attribute.data.foreach_get("vector" if channels == 3 else "value", out)
    return out.reshape(count, channels)


def hair_curves(data, name: str) -> Mesh | None:
    """Blender's hair Curves as tubes through their points (radius attribute, 5 mm where there is none)."""
    n = len(data.points)
    offsets = np.empty(len(data.curves) + 1, np.int32)
    data.curve_offset_data.foreach_get("value", offsets)
    points = read_points(data, "position", 3, n, 0.0)
    radius = read_points(data, "radius", 1, n, 0.005)[:, 0]
    return tubes(name, points, offsets[:-1], np.diff(offsets), radius)


def particle_hair(ob, system, modifier, world_to_object: np.ndarray, final: bool, watch) -> Mesh | None:
    """A particle system's strands in the object's space, as tubes; None where there are none."""
    settings = system.settings
    parents, children = len(system.particles), len(system.child_particles)
    first = 0 if children == 0 or settings.use_parent_particles else parents
    strands = range(first, parents + children)
    steps = 2 ** (settings.render_step if final else settings.display_step) + 1
    every = max(1, -(-len(strands) * steps // MAX_HAIR_KEYS))
    if every > 1:
        watch.warn(
            f"object '{ob.name}': hair '{system.name}' has {len(strands)} strands; one in {every} is rendered"
        )
        strands = strands[::every]
    keys, counts = [], []
    for strand in strands:
        watch.poll()
        n = 0
        for step in range(steps):
            co = system.co_hair(ob, particle_no=strand, step=step)
            if n and co.length_squared == 0.0:
                break  # past the strand's end
            keys.append(co[:])
            n += 1
        counts.append(n)
    if not keys:
        return None
    points = np.array(keys, np.float64) @ world_to_object[:3, :3].T + world_to_object[:3, 3]
    counts = np.array(counts)
    starts = np.cumsum(counts) - counts
    along = (np.arange(len(points)) - np.repeat(starts, counts)) / np.repeat(
        np.maximum(counts - 1, 1), counts
    )
    shape = settings.shape  # -1 thins early, 1 late
    along = along ** (1.0 / (1.0 + shape) if shape < 0 and shape > -1 else 1.0 - shape if shape < 1 else 1e-3)
    radius = 0.5 * settings.radius_scale * (settings.root_radius * (1 - along) + settings.tip_radius * along)
    if settings.use_close_tip:
        radius[starts + counts - 1] = 0.0
    return tubes(f"{ob.name}/{system.name}", points, starts, counts, radius)


def sphere(segments: int = 16, rings: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """(positions, triangles) of a unit sphere."""
    polar = np.pi * np.arange(1, rings) / rings
    around = 2 * np.pi * np.arange(segments) / segments
    body = np.stack(
        [
            np.sin(polar)[:, None] * np.cos(around),
            np.sin(polar)[:, None] * np.sin(around),
            np.repeat(np.cos(polar)[:, None], segments, 1),
        ],
        2,
    ).reshape(-1, 3)
    positions = np.concatenate([[[0, 0, 1]], body, [[0, 0, -1]]])
    i, j = np.arange(segments), (np.arange(segments) + 1) % segments
    a = 1 + np.arange(rings - 2)[:, None] * segments
    quads = np.stack(
        [
            np.stack([a + i, a + segments + i, a + segments + j], 2),
            np.stack([a + i, a + segments + j, a + j], 2),
        ]
    ).reshape(-1, 3)
    south = len(positions) - 1
    base = 1 + (rings - 2) * segments
    caps = [np.stack([0 * i, 1 + i, 1 + j], 1), np.stack([0 * i + south, base + j, base + i], 1)]
    return positions.astype(np.float32), np.concatenate([caps[0], quads, caps[1]]).astype(np.int32)


def point_cloud(data, name: str, materials: tuple) -> Group | None:
    """A PointCloud as instances of a sphere (radius attribute, 1 cm where there is none)."""
    n = len(data.points)
    if n == 0:
        return None
    positions, triangles = sphere()
    ball = Group(f"{name} point", [Mesh(name, positions, triangles, positions, materials=materials)])
    transforms = np.zeros((n, 3, 4))
    radius = np.maximum(read_points(data, "radius", 1, n, 0.01)[:, 0], 1e-9)
    for axis in range(3):
        transforms[:, axis, axis] = radius
    transforms[:, :, 3] = read_points(data, "position", 3, n, 0.0)
    return Group(name, [], [Instances((ball,), transforms, name=name)])
