"""Texture Coordinate, UV Map, and the footprints of coordinates."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading.nodes.inputs import normal_to_object, uv_vector
from pointmr_engine.shading.nodes.registry import FLOAT, VECTOR, Call, From, node
from pointmr_engine.shading.values import dot, length, transform_point


def _reads(params: dict, wanted: frozenset[str]) -> set[str]:
    needs: set[str] = set()
    if "generated" in wanted:
        needs.add("generated")
    if "normal" in wanted:
        needs.add("world_from_part")
    if "uv" in wanted:
        needs.add("uv:")
    if "object" in wanted:
        needs.add("local" if params.get("object_from_world") is None else "position")
    if "camera" in wanted:
        needs |= {"position", "camera_from_world"}
    if "window" in wanted:
        needs.add("window")
    if "reflection" in wanted:
        needs.add("incoming")
    return needs


@node(
    "texture_coordinate",
    {"shading_normal": (VECTOR, From("normal"))},
    {
        "generated": VECTOR,
        "normal": VECTOR,
        "uv": VECTOR,
        "object": VECTOR,
        "camera": VECTOR,
        "window": VECTOR,
        "reflection": VECTOR,
    },
    reads=_reads,
    ignores=lambda params, wanted: () if wanted & {"normal", "reflection"} else ("shading_normal",),
)
def _texture_coordinate(c: Call) -> dict[str, np.ndarray]:
    """params: object_from_world (3, 4) or None for the point's own object."""
    p, out = c.points, {}
    for name in c.wanted:
        if name == "generated":
            out[name] = p.generated
        elif name == "normal":
            out[name] = normal_to_object(p, c["shading_normal"])
        elif name == "uv":
            out[name] = uv_vector(p.uvs[""])
        elif name == "object":
            m = c.params.get("object_from_world")
            out[name] = p.local if m is None else transform_point(np.asarray(m, np.float64), p.position)
        elif name == "camera":
            out[name] = transform_point(p.camera_from_world, p.position)
        elif name == "window":
            out[name] = uv_vector(p.window)
        else:
            n = c["shading_normal"]
            out[name] = 2 * dot(n, p.incoming)[:, None] * n - p.incoming
    return out


@node("uv_map", {}, {"uv": VECTOR}, reads=lambda params, wanted: (f"uv:{params.get('layer', '')}",))
def _uv_map(c: Call) -> np.ndarray:
    """params: layer, "" for the mesh's active one."""
    return uv_vector(c.points.uvs[c.params.get("layer", "")])


@node(
    "footprint:uv",
    {},
    {"value": FLOAT},
    reads=lambda params, wanted: (f"uv_footprint:{params.get('layer', '')}",),
)
def _uv_footprint(c: Call) -> np.ndarray:
    return _narrowed(c, c.points.uv_footprints[c.params.get("layer", "")])


def _narrowed(c: Call, width: np.ndarray) -> np.ndarray:
    return width if c.points.narrower is None else width * c.points.narrower


@node(
    "footprint:differences",
    {"vector": (VECTOR, 0.0)},
    {"value": FLOAT},
    reads=lambda params, wanted: ("moved", "footprint", "geometric_normal"),
    differenced=("vector",),
)
def _difference_footprint(c: Call) -> np.ndarray:
    """Width of a coordinate's footprint by moving the point one footprint along two axes."""
    a, b = (length(c.moved("vector", axis, 1.0) - c["vector"]) for axis in (0, 1))
    return _narrowed(c, np.sqrt(a * b))
