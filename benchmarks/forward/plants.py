"""Trees and other plants as triangles: wood of tapered prisms, leaves of two triangles."""

from __future__ import annotations

import numpy as np

from pointmr_engine import Group, Instances, Material, Mesh
from pointmr_engine.scene.graph import Graph, Link, Node

SIDES = 6  # of a branch


def diffuse(name: str, *color: float) -> Material:
    """A Lambertian material of linear colour."""
    node = Node("diffuse", {"color": color, "roughness": 0.0})
    return Material(name, Graph({"bsdf": node}, surface=Link("bsdf", "bsdf")))


BARK = diffuse("bark", 0.17, 0.10, 0.06)
LEAF = diffuse("leaf", 0.10, 0.28, 0.04)
DARK_LEAF = diffuse("dark leaf", 0.04, 0.16, 0.05)
AUTUMN = diffuse("autumn leaf", 0.45, 0.17, 0.03)
STRAW = diffuse("straw", 0.38, 0.33, 0.10)
SOIL = diffuse("soil", 0.22, 0.20, 0.09)


def unit(v: np.ndarray) -> np.ndarray:
    """(..., 3) vectors of length 1."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def sideways(axis: np.ndarray) -> np.ndarray:
    """(N, 3) unit vectors at right angles to unit `axis`."""
    other = np.where(np.abs(axis[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    return unit(np.cross(axis, other))


def prisms(start, end, thick, thin) -> tuple[np.ndarray, np.ndarray]:
    """Open tapered prisms: positions, triangles of N branches from (N, 3) to (N, 3) with radii (N,)."""
    axis = unit(end - start)
    x = sideways(axis)
    y = np.cross(axis, x)
    angle = np.arange(SIDES) * (2 * np.pi / SIDES)
    ring = np.cos(angle)[None, :, None] * x[:, None] + np.sin(angle)[None, :, None] * y[:, None]
    low = start[:, None] + ring * thick[:, None, None]
    high = end[:, None] + ring * thin[:, None, None]
    k = np.arange(SIDES)
    n = (k + 1) % SIDES
    faces = np.concatenate([np.stack([k, n, k + SIDES], 1), np.stack([n, n + SIDES, k + SIDES], 1)])
    positions = np.concatenate([low, high], 1).reshape(-1, 3)
    triangles = (faces[None] + 2 * SIDES * np.arange(len(start))[:, None, None]).reshape(-1, 3)
    return positions, triangles


def blades(base, direction, normal, length, width) -> tuple[np.ndarray, np.ndarray]:
    """Diamond leaves bent along their middle, two triangles each, from (N, 3) along unit (N, 3)."""
    side = unit(np.cross(direction, normal)) * (0.5 * width)[:, None]
    tip = base + direction * length[:, None]
    middle = base + direction * (0.45 * length)[:, None] - normal * (0.12 * width)[:, None]
    positions = np.stack([base, middle + side, tip, middle - side], 1).reshape(-1, 3)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    triangles = (faces[None] + 4 * np.arange(len(base))[:, None, None]).reshape(-1, 3)
    return positions, triangles


def mesh(name: str, material: Material, positions, triangles) -> Mesh:
    """A mesh of one material."""
    return Mesh(name, positions.astype(np.float32), triangles.astype(np.int32), materials=(material,))


def boughs(rng, start, axis, length, per: int, spread: float, lift: float):
    """(start, end) of `per` branches from each parent's outer part, bent away from it by about `spread` radians."""
    n = len(start)
    along = rng.uniform(0.35, 1.0, (n, per))
    foot = start[:, None] + axis[:, None] * (along * length[:, None])[..., None]
    turn = np.repeat(axis[:, None], per, 1).reshape(-1, 3)
    x = sideways(turn)
    y = np.cross(turn, x)
    a = rng.uniform(0, 2 * np.pi, n * per)[:, None]
    b = (spread * rng.uniform(0.6, 1.3, n * per))[:, None]
    out = np.cos(b) * turn + np.sin(b) * (np.cos(a) * x + np.sin(a) * y)
    out = unit(out + [0, 0, lift])
    reach = (length[:, None] * (1.15 - 0.7 * along) * rng.uniform(0.45, 0.7, (n, per))).reshape(-1)
    return foot.reshape(-1, 3), out, reach


def tree(name: str, seed: int, leaf: Material, height: float = 9.0, leaves: int = 160) -> Group:
    """A broadleaf of about 84,000 triangles (with 160 leaves a twig), standing on the origin."""
    rng = np.random.default_rng(seed)
    trunk = np.zeros((1, 3)), np.array([[0, 0, 1.0]]), np.array([0.75 * height])
    limb = boughs(rng, *trunk, 30, 1.1, 0.25)
    twig = boughs(rng, *limb, 8, 0.8, 0.1)
    wood = []
    for (start, axis, length), thick in ((trunk, 0.022), (limb, 0.012), (twig, 0.008)):
        radius = thick * (np.full(1, height) if len(start) == 1 else 3.0 * length)
        joint = start + axis * (0.5 * length)[:, None] + rng.normal(0, 0.04, start.shape) * length[:, None]
        wood.append(prisms(start, joint, radius, 0.7 * radius))
        wood.append(prisms(joint, start + axis * length[:, None], 0.7 * radius, 0.2 * radius))
    offset, positions, triangles = 0, [], []
    for p, t in wood:
        positions.append(p)
        triangles.append(t + offset)
        offset += len(p)
    stem = mesh("wood", BARK, np.concatenate(positions), np.concatenate(triangles))
    start, axis, length = twig
    n = len(start) * leaves
    along = rng.uniform(0.1, 1.1, (len(start), leaves))
    base = (start[:, None] + axis[:, None] * (along * length[:, None])[..., None]).reshape(-1, 3)
    base += rng.normal(0, 0.035 * height, (n, 3)) * np.repeat(length / length.mean(), leaves)[:, None] * 0.5
    direction = unit(np.repeat(axis, leaves, 0) + 0.9 * rng.normal(size=(n, 3)))
    normal = unit(np.cross(direction, rng.normal(size=(n, 3))))
    size = height * rng.uniform(0.011, 0.02, n)
    foliage = mesh("leaves", leaf, *blades(base, direction, normal, size, 0.6 * size))
    return Group(name, [stem, foliage])


def sprig(name: str, seed: int, leaf: Material, leaves: int = 26) -> Group:
    """A twig one metre long along z: a stem and leaves."""
    rng = np.random.default_rng(seed)
    z = np.linspace(0, 1, 4)
    path = np.stack([0.04 * np.sin(5 * z), 0.05 * np.sin(3 * z + 1), z], 1)
    radius = np.linspace(0.018, 0.006, 4)
    stem = mesh("stem", BARK, *prisms(path[:-1], path[1:], radius[:-1], radius[1:]))
    along = rng.uniform(0.1, 1.0, leaves)
    base = np.stack([0.04 * np.sin(5 * along), 0.05 * np.sin(3 * along + 1), along], 1)
    direction = unit(rng.normal(size=(leaves, 3)) + [0, 0, 0.6])
    normal = unit(np.cross(direction, rng.normal(size=(leaves, 3))))
    size = rng.uniform(0.22, 0.34, leaves)
    return Group(name, [stem, mesh("leaves", leaf, *blades(base, direction, normal, size, 0.55 * size))])


def frames(axis: np.ndarray, position: np.ndarray, scale: np.ndarray, spin: np.ndarray) -> np.ndarray:
    """(N, 3, 4) placements whose z goes along unit (N, 3) `axis`, turned about it by `spin` radians."""
    x = sideways(axis)
    y = np.cross(axis, x)
    c, s = np.cos(spin)[:, None], np.sin(spin)[:, None]
    turn = np.stack([c * x + s * y, c * y - s * x, axis], 2)
    return np.concatenate([turn * scale[:, None, None], position[:, :, None]], 2)


def branch(name: str, seed: int, child: Group, count: int, size: float, wood: float) -> Group:
    """`count` copies of a group, each `size` long, along a stem one metre long; the whole is a metre long along z."""
    rng = np.random.default_rng(seed)
    z = np.linspace(0, 1, 6)
    path = np.stack([0.05 * np.sin(4 * z), 0.05 * np.sin(3 * z + 2) - 0.05 * np.sin(2), z], 1)
    radius = np.linspace(wood, 0.2 * wood, 6)
    stem = mesh("stem", BARK, *prisms(path[:-1], path[1:], radius[:-1], radius[1:]))
    along = rng.uniform(0.12, 1.0, count)
    foot = np.stack([0.05 * np.sin(4 * along), 0.05 * np.sin(3 * along + 2) - 0.05 * np.sin(2), along], 1)
    around = rng.uniform(0, 2 * np.pi, count)
    axis = unit(np.stack([np.cos(around), np.sin(around), rng.uniform(0.2, 0.9, count)], 1))
    scale = size * (1.2 - 0.6 * along) * rng.uniform(0.8, 1.2, count)
    placed = frames(axis, foot, scale, rng.uniform(0, 2 * np.pi, count))
    return Group(name, [stem], [Instances((child,), placed)])


def great_tree(name: str, seed: int, leaf: Material, height: float = 14.0) -> Group:
    """A broadleaf of about five million triangles: sprigs on branches on limbs on a trunk."""
    rng = np.random.default_rng(seed)
    small = branch("branch", seed + 1, sprig("sprig", seed, leaf), 44, 0.33, 0.012)
    limb = branch("limb", seed + 2, small, 22, 0.42, 0.022)
    count = 64
    z = np.linspace(0, 0.85, 7) * height
    path = np.stack([0.15 * np.sin(z), 0.15 * np.sin(0.7 * z), z], 1)
    radius = np.linspace(0.026, 0.006, 7) * height
    trunk = mesh("trunk", BARK, *prisms(path[:-1], path[1:], radius[:-1], radius[1:]))
    along = (np.arange(count) + rng.uniform(0, 1, count)) / count
    up = (0.22 + 0.62 * along) * height
    foot = np.stack([0.15 * np.sin(up), 0.15 * np.sin(0.7 * up), up], 1)
    around = np.arange(count) * 2.4 + rng.normal(0, 0.2, count)
    axis = unit(np.stack([np.cos(around), np.sin(around), -0.05 + 1.4 * along**2], 1))
    scale = height * (0.36 - 0.16 * along) * rng.uniform(0.8, 1.15, count)
    placed = frames(axis, foot, scale, rng.uniform(0, 2 * np.pi, count))
    return Group(name, [trunk], [Instances((limb,), placed)])


def tuft(name: str, seed: int, material: Material, count: int = 60) -> Group:
    """Grass blades within half a metre of the origin."""
    rng = np.random.default_rng(seed)
    base = np.concatenate([rng.uniform(-0.5, 0.5, (count, 2)), np.zeros((count, 1))], 1)
    direction = unit(rng.normal(0, 0.35, (count, 3)) + [0, 0, 1.0])
    normal = unit(np.cross(direction, rng.normal(size=(count, 3))))
    length = rng.uniform(0.25, 0.6, count)
    return Group(name, [mesh("blades", material, *blades(base, direction, normal, length, 0.12 * length))])
