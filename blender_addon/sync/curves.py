"""Blender's hair and point clouds: strands, which become tubes, and spheres at points."""

from __future__ import annotations

import numpy as np

from pointmr_engine.scene.group import Group, Instances
from pointmr_engine.scene.mesh import Mesh

from .attributes import Requests, read_values
from .strands import Strands, tubes

MAX_HAIR_KEYS = 4_000_000  # above this, particle hair is thinned out, with a warning


def read_points(data, name: str, channels: int, count: int, default: float) -> np.ndarray:
    """A point attribute of Curves or PointCloud as (count, channels) float32, `default` where it is missing."""
    attribute = data.attributes.get(name)
    if attribute is None or attribute.domain != "POINT":
        return np.full((count, channels), default, np.float32)
    out = np.empty(count * channels, np.float32)
    attribute.data.foreach_get("vector" if channels == 3 else "value", out)
    return out.reshape(count, channels)


def hair_curves(data, name: str, wanted: Requests) -> Mesh | None:
    """Blender's hair Curves as tubes through their points (radius attribute, 5 mm where there is none)."""
    n = len(data.points)
    offsets = np.empty(len(data.curves) + 1, np.int32)
    data.curve_offset_data.foreach_get("value", offsets)
    points = read_points(data, "position", 3, n, 0.0)
    radius = read_points(data, "radius", 1, n, 0.005)[:, 0]
    of = {"POINT": {}, "CURVE": {}}
    for attribute in data.attributes:
        if attribute.name in wanted.geometry and attribute.domain in of:
            values = read_values(attribute)
            if values is not None:
                of[attribute.domain][attribute.name] = values
    surface = data.attributes.get("surface_uv_coordinate")
    uv = None if surface is None or surface.domain != "CURVE" else read_values(surface)
    return tubes(
        name, Strands(points, radius, offsets[:-1], np.diff(offsets), of["POINT"], of["CURVE"], uv), wanted
    )


def particle_hair(
    ob, system, modifier, world_to_object: np.ndarray, final: bool, wanted: Requests, watch
) -> Mesh | None:
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
    uv = _uv_on_emitter(ob, system, modifier, strands)
    middle, half = np.array(ob.data.texspace_location), np.array(ob.data.texspace_size)
    roots = 0.5 + 0.5 * (points[starts] - middle) / np.where(half > 0.0, half, 1.0)
    grown = Strands(points, radius, starts, counts, {}, {}, uv, roots)
    return tubes(f"{ob.name}/{system.name}", grown, wanted)


def _uv_on_emitter(ob, system, modifier, strands) -> np.ndarray | None:
    """(S, 2) UV coordinates of the mesh where the strands grow, of the layer that is rendered; None without layers."""
    layers = getattr(ob.data, "uv_layers", None)
    if not layers:
        return None
    rendered = next((k for k, layer in enumerate(layers) if layer.active_render), 0)
    parents = len(system.particles)
    uv = np.zeros((len(strands), 2), np.float32)
    for row, strand in enumerate(strands):
        of = system.particles[min(strand, parents - 1)]
        uv[row] = system.uv_on_emitter(modifier, particle=of, particle_no=strand, uv_no=rendered)
    return uv


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
    mesh = Mesh(name, positions, triangles, positions, materials=materials, displaceable=False)
    ball = Group(f"{name} point", [mesh])
    transforms = np.zeros((n, 3, 4))
    radius = np.maximum(read_points(data, "radius", 1, n, 0.01)[:, 0], 1e-9)
    for axis in range(3):
        transforms[:, axis, axis] = radius
    transforms[:, :, 3] = read_points(data, "position", 3, n, 0.0)
    return Group(name, [], [Instances((ball,), transforms, name=name)])
