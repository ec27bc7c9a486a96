"""Normals and tangents: Normal Map, Tangent, Normal, and displacement seen as bump."""

from __future__ import annotations

import numpy as np

from pointmr_engine.numerics.transforms import inverse_linear
from pointmr_engine.scene.material import RESTING_NORMAL, resting_tangent
from pointmr_engine.shading.nodes.inputs import (
    normal_to_object,
    normal_to_world,
    project_tangent,
    radial_tangent,
)
from pointmr_engine.shading.nodes.registry import COLOR, FLOAT, VECTOR, Call, From, node
from pointmr_engine.shading.points import SurfacePoints
from pointmr_engine.shading.values import cross, dot, normalize, saturate, transform_direction


def _normal_map_reads(params: dict, wanted: frozenset[str]) -> list[str]:
    space = params.get("space", "TANGENT")
    if space == "TANGENT":
        layer, reads = params.get("layer", ""), ["smooth_normal", "backfacing", "world_from_part"]
        if not params.get("resting"):
            return [*reads, f"tangent:{layer}"]
        frame = (f"attribute:{name}" for name in (RESTING_NORMAL, resting_tangent(layer)))
        return [*reads, "geometric_normal", *frame]
    return ["backfacing"] + ["world_from_part"] * ("OBJECT" in space)


def object_frame(points: SurfacePoints, tangents: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tangent, bitangent and smooth normal (n, 3) in the object's space, where normal maps were made.

    tangents (n, 4): world tangents and the sign that makes sign * cross(normal, tangent) the world bitangent.
    """
    tangent, up, sign = tangents[:, :3], points.smooth_normal, tangents[:, 3:]
    m = points.world_from_part
    if m is not None:
        linear = inverse_linear(m)
        tangent = normalize(np.einsum("...ij,...j->...i", linear, tangent).astype(np.float32))
        up = normal_to_object(points, up)
        # a mirrored object turns its frames over
        sign = sign * np.where(np.linalg.det(m[..., :3]) < 0, -1, 1)[:, None]
    return tangent, cross(up, tangent) * sign, up


def _resting_frame(c: Call) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """`object_frame` before the mesh was displaced, and whether triangles are smooth (n, 1): the normals of flat ones
    are those that they have now.
    """
    points, attributes = c.points, c.points.attributes
    tangents = attributes[resting_tangent(c.params.get("layer", ""))]
    tangent, up = tangents[:, :3], attributes[RESTING_NORMAL][:, :3]
    smooth = (up != 0).any(1)[:, None]
    own = np.where(points.backfacing[:, None], -points.geometric_normal, points.geometric_normal)
    up = np.where(smooth, up, normal_to_object(points, own))
    return tangent, cross(up, tangent) * tangents[:, 3:], up, smooth


@node(
    "normal_map",
    {
        "strength": (FLOAT, 1.0),
        "color": (COLOR, (0.5, 0.5, 1.0)),
        "shading_normal": (VECTOR, From("normal")),
    },
    {"normal": VECTOR},
    reads=_normal_map_reads,
)
def _normal_map(c: Call) -> np.ndarray:
    """params: space "TANGENT", "OBJECT", "WORLD", "BLENDER_OBJECT", "BLENDER_WORLD"; layer of the tangents; resting:
    they, and the normals of smooth triangles, are those from before the mesh was displaced, and the strength mixes the
    result with the normals of now, as in Cycles.
    """
    space, points = c.params.get("space", "TANGENT"), c.points
    color = 2 * c["color"] - 1
    strength = c.vector("strength")
    shading = c["shading_normal"]
    mixed = space != "TANGENT"  # with what is there without the map
    if space == "TANGENT":
        if c.params.get("resting"):
            tangent, across, up, mixed = _resting_frame(c)
        else:
            tangent, across, up = object_frame(points, points.tangents[c.params.get("layer", "")])
        within = np.where(mixed, 1, strength)
        x, y = color[:, :1] * within, color[:, 1:2] * within
        z = 1 + (color[:, 2:] - 1) * saturate(within)
        n = normal_to_world(points, x * tangent + y * across + z * up)
        n = np.where((tangent == 0).all(1)[:, None], points.smooth_normal, n)
    else:
        if space.startswith("BLENDER"):
            color = color * np.array([1, -1, -1], np.float32)
        n = normal_to_world(points, color) if space.endswith("OBJECT") else normalize(color)
    n = np.where(points.backfacing[:, None], -n, n)
    whole = ~np.asarray(mixed) | (strength == 1)
    n = np.where(whole, n, normalize(shading + (n - shading) * np.maximum(strength, 0)))
    bad = ~np.isfinite(n).all(1) | (n == 0).all(1)
    return np.where(bad[:, None], shading, n)


def _tangent_reads(params: dict, wanted: frozenset[str]) -> list[str]:
    if params.get("direction", "RADIAL") == "UV_MAP":
        return [f"tangent:{params.get('layer', '')}"]
    return ["generated", "world_from_part"]


@node("tangent", {"shading_normal": (VECTOR, From("normal"))}, {"tangent": VECTOR}, reads=_tangent_reads)
def _tangent(c: Call) -> np.ndarray:
    """params: direction "RADIAL" with axis, or "UV_MAP" with layer."""
    n = c["shading_normal"]
    if c.params.get("direction", "RADIAL") == "UV_MAP":
        return project_tangent(c.points.tangents[c.params.get("layer", "")][:, :3], n)
    return radial_tangent(c.points, c.points.generated, n, c.params.get("axis", "Z"))


@node("normal", {"normal": (VECTOR, From("normal"))}, {"normal": VECTOR, "dot": FLOAT})
def _normal(c: Call) -> dict[str, np.ndarray]:
    """params: direction, the vector that the node's sphere shows."""
    direction = normalize(np.asarray(c.params.get("direction", (0.0, 0.0, 1.0)), np.float32).reshape(1, 3))
    return {"normal": direction, "dot": dot(direction, normalize(c["normal"]))}


@node(
    "displacement",
    {
        "height": (FLOAT, 0.0),
        "midlevel": (FLOAT, 0.5),
        "scale": (FLOAT, 1.0),
        "normal": (VECTOR, From("normal")),
    },
    {"displacement": VECTOR},
    reads=lambda params, wanted: ("world_from_part",) if params.get("space", "OBJECT") == "OBJECT" else (),
)
def _displacement(c: Call) -> np.ndarray:
    """params: space "OBJECT" or "WORLD"."""
    amount = ((c["height"] - c["midlevel"]) * c["scale"])[:, None]
    if c.params.get("space", "OBJECT") == "WORLD" or c.points.world_from_part is None:
        return c["normal"] * amount
    local = normal_to_object(c.points, c["normal"])
    return transform_direction(c.points.world_from_part, local * amount)


def _vector_displacement_reads(params: dict, wanted: frozenset[str]) -> list[str]:
    space = params.get("space", "TANGENT")
    if space == "WORLD":
        return []
    if space == "OBJECT":
        return ["world_from_part"]
    return ["world_from_part", f"tangent:{params.get('layer', '')}"]


@node(
    "vector_displacement",
    {
        "vector": (COLOR, 0.0),
        "midlevel": (FLOAT, 0.0),
        "scale": (FLOAT, 1.0),
        "shading_normal": (VECTOR, From("normal")),
    },
    {"displacement": VECTOR},
    reads=_vector_displacement_reads,
)
def _vector_displacement(c: Call) -> np.ndarray:
    """params: space "TANGENT" (x tangent, y normal, z bitangent), "OBJECT" or "WORLD"; layer of the tangents."""
    space = c.params.get("space", "TANGENT")
    v = (c["vector"] - c.vector("midlevel")) * c.vector("scale")
    if space == "WORLD":
        return v
    if space == "TANGENT":
        tangent = c.points.tangents[c.params.get("layer", "")]
        n = c["shading_normal"]
        across = normalize(cross(n, tangent[:, :3])) * tangent[:, 3:]
        return tangent[:, :3] * v[:, :1] + n * v[:, 1:2] + across * v[:, 2:]
    return v if c.points.world_from_part is None else transform_direction(c.points.world_from_part, v)


@node("displacement_height", {"vector": (VECTOR, 0.0), "normal": (VECTOR, From("normal"))}, {"value": FLOAT})
def _displacement_height(c: Call) -> np.ndarray:
    return dot(c["vector"], c["normal"])
