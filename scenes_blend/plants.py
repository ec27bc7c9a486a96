"""Plants, leaf to tree, for the scenes: each level instances the one below, so that a tree of millions is a few meshes.

A level's own axis is +x (trees: +z), its upper side +z. Lengths in metres.
"""

from __future__ import annotations

import bpy
import numpy as np
from parts import add, collection, grid_faces, mesh, point_mesh

GOLDEN = np.pi * (3 - np.sqrt(5))


def frames(directions: np.ndarray, up=(0, 0, 1)) -> np.ndarray:
    """Euler angles (N, 3) of rotations that turn +x to the directions, and +z as far up as that allows."""
    x = directions / np.linalg.norm(directions, axis=1)[:, None]
    up = np.broadcast_to(np.asarray(up, float), x.shape)
    y = np.cross(up, x)
    size = np.linalg.norm(y, axis=1)[:, None]
    y = np.where(size > 1e-4, y / np.maximum(size, 1e-9), (0, 1, 0))
    z = np.cross(x, y)
    return np.stack(
        [np.arctan2(y[:, 2], z[:, 2]), np.arcsin(np.clip(-x[:, 2], -1, 1)), np.arctan2(x[:, 1], x[:, 0])], 1
    )


def tube(path: np.ndarray, radius: np.ndarray, sides: int) -> tuple[np.ndarray, np.ndarray]:
    """(positions, quads) of a tube along a path."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    side = np.cross(tangent, (0.13, 0.95, 0.28))
    side /= np.linalg.norm(side, axis=1)[:, None]
    other = np.cross(tangent, side)
    a = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(a)[:, None] * side[:, None] + np.sin(a)[:, None] * other[:, None]
    points = (path[:, None] + radius[:, None, None] * ring).reshape(-1, 3)
    return points, grid_faces(len(path), sides, wrap=True)


def placed(shape: np.ndarray, at: np.ndarray, euler: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """A shape's points (K, 3) at N places, (N, K, 3)."""
    (rx, ry, rz), one = euler.T, np.ones(len(at))
    zero = 0 * one

    def turn(*rows):
        return np.stack([np.stack(r, -1) for r in rows], 1)

    x = turn((one, zero, zero), (zero, np.cos(rx), -np.sin(rx)), (zero, np.sin(rx), np.cos(rx)))
    y = turn((np.cos(ry), zero, np.sin(ry)), (zero, one, zero), (-np.sin(ry), zero, np.cos(ry)))
    z = turn((np.cos(rz), -np.sin(rz), zero), (np.sin(rz), np.cos(rz), zero), (zero, zero, one))
    return np.einsum("nij,kj->nki", z @ y @ x, shape) * scale[:, None, None] + at[:, None]


# Placing


def scatter(name, to, source, at, rotation, scale, index=None, native=False) -> bpy.types.Object:
    """An object that places a collection on points: by geometry nodes (native), or by PointMR's instancer.

    rotation (N, 3) Euler angles; scale (N,); index (N,): which of the source's child collections, None for the whole.
    """
    at, rotation = np.asarray(at, float), np.asarray(rotation, float)
    values = {"rotation": rotation, "scale": np.broadcast_to(np.asarray(scale, float), len(at))}
    if index is not None:
        values["index"] = np.asarray(index, np.int32)
    ob = add(name, point_mesh(name, at, **values), to)
    if native:
        modifier = ob.modifiers.new("Instances", "NODES")
        modifier.node_group = instance_nodes(source, index is not None)
    else:
        ob.pointmr.instance_collection = source
        ob.pointmr.instance_on = "POINTS"
    return ob


def instance_nodes(source: bpy.types.Collection, choose: bool) -> bpy.types.NodeTree:
    """A geometry node group: the collection (or its children, by the point attribute "index") on each point."""
    tree = bpy.data.node_groups.new(f"{source.name} on points", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    enter, leave = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    info, place = tree.nodes.new("GeometryNodeCollectionInfo"), tree.nodes.new("GeometryNodeInstanceOnPoints")
    info.inputs["Collection"].default_value = source
    info.inputs["Separate Children"].default_value = info.inputs["Reset Children"].default_value = choose
    place.inputs["Pick Instance"].default_value = choose
    link = tree.links.new
    link(place.inputs["Points"], enter.outputs[0])
    link(place.inputs["Instance"], info.outputs[0])
    wanted = [("rotation", "FLOAT_VECTOR", "Rotation"), ("scale", "FLOAT", "Scale")]
    if choose:
        wanted.append(("index", "INT", "Instance Index"))
    for attribute, kind, socket in wanted:
        read = tree.nodes.new("GeometryNodeInputNamedAttribute")
        read.data_type, read.inputs["Name"].default_value = kind, attribute
        link(place.inputs[socket], next(s for s in read.outputs if s.enabled))
    link(leave.inputs[0], place.outputs[0])
    return tree


# Levels


def leaf_shape(length: float, width: float) -> tuple[np.ndarray, np.ndarray]:
    """A folded, drooping leaf of 8 triangles."""
    p = np.array([(0, 0, 0), (0.32, 0.5, 0.06), (0.34, 0, -0.02), (0.32, -0.5, 0.06), (0.70, 0.36, 0.0),
                  (0.70, 0, -0.07), (0.70, -0.36, 0.0), (1, 0, -0.18)], float)  # fmt: skip
    p *= (length, width, length)
    t = [(0, 2, 1), (0, 3, 2), (1, 2, 5), (1, 5, 4), (2, 3, 6), (2, 6, 5), (4, 5, 7), (5, 6, 7)]
    return p, np.array(t)


def leafy_twig(name, leaf, bark, rng, count=24, length=0.42, size=0.075, droop=0.0):
    """A twig mesh with leaves around it."""
    t = np.linspace(0, 1, 4)
    path = np.stack([length * t, 0.03 * np.sin(3 * t), -droop * length * t**2], 1)
    p, quads = tube(path, 0.004 * (1 - 0.7 * t), 3)
    stem = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    s = np.linspace(0.15, 1.0, count)
    roll = GOLDEN * np.arange(count) + rng.normal(0, 0.3, count)
    ahead = 0.5 + 0.4 * s
    d = np.stack([ahead, np.cos(roll), 0.45 * np.sin(roll) + 0.12 - droop], 1)
    base = np.stack([np.interp(s, t, path[:, i]) for i in range(3)], 1)
    shape, faces = leaf_shape(1.0, 0.62)
    euler = frames(d) + rng.normal(0, 0.25, (count, 3))
    leaves = placed(shape, base, euler, size * rng.uniform(0.75, 1.2, count))
    all_faces = (faces + len(p) + len(shape) * np.arange(count)[:, None, None]).reshape(-1, 3)
    material_index = np.r_[np.ones(len(stem)), np.zeros(len(all_faces))]
    return mesh(name, np.concatenate([p, leaves.reshape(-1, 3)]), np.concatenate([stem, all_faces]), [leaf, bark],
                material_index=material_index)  # fmt: skip


def needle_shoot(name, needle, bark, rng, count=90, length=0.30, size=0.026):
    """A conifer's shoot: needles of three triangles around a stem."""
    t = np.linspace(0, 1, 3)
    path = np.stack([length * t, 0 * t, 0.02 * np.sin(3 * t)], 1)
    p, quads = tube(path, 0.0035 * (1 - 0.6 * t), 3)
    stem = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    s = np.linspace(0.03, 1.0, count)
    roll = GOLDEN * np.arange(count)
    d = np.stack([np.full(count, 0.75), np.cos(roll), 0.6 * np.sin(roll) + 0.25], 1)
    base = np.stack([np.interp(s, t, path[:, i]) for i in range(3)], 1)
    shape = np.array([(0, 0.09, 0), (0, -0.05, 0.07), (0, -0.05, -0.07), (1, 0, 0.08)])
    faces = np.array([(0, 1, 3), (1, 2, 3), (2, 0, 3)])
    needles = placed(
        shape, base, frames(d) + rng.normal(0, 0.12, (count, 3)), size * rng.uniform(0.8, 1.15, count)
    )
    all_faces = (faces + len(p) + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)
    material_index = np.r_[np.ones(len(stem)), np.zeros(len(all_faces))]
    return mesh(name, np.concatenate([p, needles.reshape(-1, 3)]), np.concatenate([stem, all_faces]), [needle, bark],
                material_index=material_index)  # fmt: skip


def holding(name: str, *data) -> bpy.types.Collection:
    """A collection, to be instanced, with one object for each mesh."""
    c = collection(name)
    for i, d in enumerate(data):
        add(f"{name} {i}" if i else name, d, c)
    return c


def axis(length, radius, bend, rng, sides, steps, taper=0.85):
    """(path, tube's positions, quads) of a curved, tapering axis along +x that bends by z."""
    t = np.linspace(0, 1, steps)
    path = np.stack([length * t, length * 0.04 * np.sin(4 * t + rng.uniform(0, 6)), length * bend * t**2], 1)
    path[:, 1] -= path[0, 1]
    return path, *tube(path, radius * (1 - taper * t) + 1e-4, sides)


def branching(
    name,
    source,
    bark,
    rng,
    count,
    length,
    radius,
    bend=0.0,
    spread=0.9,
    flat=0.45,
    start=0.1,
    size=(0.7, 1.0),
    lift=0.15,
):
    """A branch along +x whose `count` children stand around its axis, each smaller toward the tip. A collection."""
    path, p, quads = axis(length, radius, bend, rng, 5, 6)
    c = holding(name, mesh(f"{name} bark", p, quads, [bark]))
    s = np.linspace(start, 1.0, count)
    roll = GOLDEN * np.arange(count) + rng.normal(0, 0.25, count)
    outward = spread * (1 - 0.65 * s)
    d = np.stack([0.6 + 0.4 * s, outward * np.cos(roll), flat * outward * np.sin(roll) + lift], 1)
    base = np.stack([np.interp(s, np.linspace(0, 1, len(path)), path[:, i]) for i in range(3)], 1)
    scale = rng.uniform(*size, count) * (1.05 - 0.4 * s)
    scatter(f"{name} parts", c, source, base, frames(d), scale, native=True)
    return c


def broadleaf(name, limb, bark, rng, height, radius, crown, count, base=0.3, trunk=0.02, upward=0.5):
    """A tree along +z: limbs around a trunk, their length following a crown of that radius. A collection."""
    t = np.linspace(0, 1, 12)
    lean = rng.normal(0, 0.02, 2)
    path = np.stack(
        [height * (lean[0] * t**2 + 0.012 * np.sin(5 * t)), height * lean[1] * t**2, -3 + (height + 2) * t], 1
    )
    flare = 1 + 0.8 * np.exp(-np.maximum(path[:, 2], 0) / 0.5)
    p, quads = tube(path, height * trunk * flare * (1 - 0.9 * t) + 0.01, 12)
    c = holding(name, mesh(f"{name} trunk", p, quads, [bark]))
    s = base + (0.97 - base) * np.linspace(0, 1, count) ** 0.9
    roll = GOLDEN * np.arange(count) + rng.normal(0, 0.2, count)
    in_crown = (s - base) / (1 - base)
    reach = np.sqrt(np.clip(1 - (2 * in_crown - 0.85) ** 2 / 1.35, 0.05, 1))
    rise = upward * (0.25 + 1.6 * in_crown)
    d = np.stack([np.cos(roll), np.sin(roll), rise], 1)
    at = np.stack([np.interp(s, t, path[:, i]) for i in range(2)] + [s * height], 1)
    scale = crown / radius * reach * rng.uniform(0.85, 1.1, count)
    scatter(f"{name} limbs", c, limb, at, frames(d), scale)
    return c


def conifer(name, branch, bark, rng, height, reach, whorls, per_whorl=6, base=0.06):
    """A spruce along +z: whorls of drooping branches, shorter toward the top; `reach` is the branch's length."""
    t = np.linspace(0, 1, 10)
    path = np.stack([0 * t, 0 * t, -3 + (height + 3) * t], 1)
    flare = 1 + 0.6 * np.exp(-np.maximum(path[:, 2], 0) / 0.4)
    p, quads = tube(path, height * 0.013 * flare * (1 - 0.97 * t), 10)
    c = holding(name, mesh(f"{name} trunk", p, quads, [bark]))
    s = base + (0.985 - base) * (np.arange(whorls * per_whorl) // per_whorl / (whorls - 1)) ** 0.92
    n = len(s)
    s = np.clip(s + rng.normal(0, 0.006, n), base, 0.985)
    roll = 2 * np.pi * (np.arange(n) % per_whorl) / per_whorl + 0.7 * (np.arange(n) // per_whorl)
    roll += rng.normal(0, 0.16, n)
    long = height * 0.15 * (1 - s) ** 0.78 * rng.uniform(0.8, 1.1, n) + 0.18
    d = np.stack([np.cos(roll), np.sin(roll), -0.30 + 0.95 * s**2 + rng.normal(0, 0.05, n)], 1)
    at = np.stack([0 * s, 0 * s, s * height], 1)
    scatter(f"{name} branches", c, branch, at, frames(d), long / reach)
    return c


# Undergrowth


def blades(name, material, rng, count, height, width, spread) -> bpy.types.Mesh:
    """A tuft of bent grass blades, five triangles each."""
    shape = np.array([(0, -0.5, 0), (0, 0.5, 0), (0.08, -0.45, 0.4), (0.08, 0.45, 0.4), (0.30, -0.3, 0.78),
                      (0.30, 0.3, 0.78), (0.62, 0, 1.0)]) * (height, width, height)  # fmt: skip
    faces = np.array([(0, 1, 3), (0, 3, 2), (2, 3, 5), (2, 5, 4), (4, 5, 6)])
    a, r = rng.uniform(0, 2 * np.pi, count), spread * np.sqrt(rng.random(count))
    at = np.stack([r * np.cos(a), r * np.sin(a), 0 * a], 1)
    euler = np.stack([0 * a, rng.normal(0, 0.18, count), a + rng.normal(0, 0.8, count)], 1)
    p = placed(shape, at, euler, rng.uniform(0.5, 1.1, count))
    return mesh(
        name, p.reshape(-1, 3), (faces + 7 * np.arange(count)[:, None, None]).reshape(-1, 3), [material]
    )


def fern(name, material, rng, fronds=11, pairs=18, length=0.85) -> bpy.types.Mesh:
    """A fern: arching fronds with leaflets on both sides."""
    points, faces, first = [], [], 0
    shape = np.array([(0, 0, 0), (0.4, 0.11, 0.01), (0.4, -0.11, 0.01), (1, 0, -0.06)])
    small = np.array([(0, 2, 1), (1, 2, 3)])
    s = np.linspace(0.12, 1.0, pairs)
    for k in range(fronds):
        turn, steep = 2 * np.pi * k / fronds + rng.normal(0, 0.15), rng.uniform(0.75, 1.15)
        size = length * rng.uniform(0.75, 1.1)
        x, z = size * (s**1.15) * np.cos(steep * 0.55), size * (steep * s - 0.72 * s**2.3) * 0.9
        along = np.stack([np.gradient(x), 0 * s, np.gradient(z)], 1)
        along /= np.linalg.norm(along, axis=1)[:, None]
        for side in (-1, 1):
            d = np.stack([0.35 * along[:, 0], side * np.ones(pairs), 0.35 * along[:, 2] - 0.1], 1)
            at = np.stack([x, 0 * s, z], 1)
            wide = size * 0.24 * np.clip(np.sin(np.pi * np.clip(s * 0.86 + 0.12, 0, 1)), 0.08, 1)
            p = placed(shape, at, frames(d), wide).reshape(-1, 3)
            c, q = np.cos(turn), np.sin(turn)
            points.append(np.stack([c * p[:, 0] - q * p[:, 1], q * p[:, 0] + c * p[:, 1], p[:, 2]], 1))
            faces.append((small + first + 4 * np.arange(pairs)[:, None, None]).reshape(-1, 3))
            first += 4 * pairs
    return mesh(name, np.concatenate(points), np.concatenate(faces), [material])


def rock(name, material, rng, roughness=0.28) -> bpy.types.Mesh:
    """A boulder of about a metre: a sphere cut by planes, with small dents."""
    import bmesh

    b = bmesh.new()
    bmesh.ops.create_icosphere(b, subdivisions=4, radius=1.0)
    p = np.array([v.co for v in b.verts])
    faces = np.array([[v.index for v in f.verts] for f in b.faces])
    b.free()
    for _ in range(14):
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        over = np.maximum(p @ d - rng.uniform(0.55, 0.9), 0)
        p = p - over[:, None] * d * 0.92
    for scale in (2.0, 5.0, 11.0):
        w = rng.normal(size=(6, 3)) * scale
        dent = np.sin(p @ w.T + rng.uniform(0, 6, 6)).mean(1)
        p = p * (1 + roughness * 0.35 / scale * dent)[:, None]
    return mesh(name, p * (0.62, 0.5, 0.4), faces, [material])
