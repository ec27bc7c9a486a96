"""Image Texture: flat, box, sphere and tube projections."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading.nodes.inputs import normal_to_object
from pointmr_engine.shading.nodes.registry import COLOR, FLOAT, VECTOR, Call, From, node
from pointmr_engine.shading.textures import texture_of
from pointmr_engine.shading.values import saturate


def prepare(params: dict) -> dict:
    """The image's pyramid, made when the graph is compiled."""
    image = params.get("image")
    return params if image is None else {**params, "texture": texture_of(image)}


def outputs_of(c: Call, rgba: np.ndarray) -> dict[str, np.ndarray]:
    """The node's two outputs."""
    return {"color": rgba[:, :3], "alpha": rgba[:, 3]}


def sphere_uv(v: np.ndarray) -> np.ndarray:
    """(n, 2) from directions: longitude and latitude as sphere-mapped textures count them."""
    size = np.sqrt((v * v).sum(1))
    safe = np.where(size > 0, size, 1)
    u = np.where((v[:, 0] == 0) & (v[:, 1] == 0), 0, 0.5 - np.arctan2(v[:, 0], v[:, 1]) / (2 * np.pi))
    w = 1 - np.arccos(np.clip(v[:, 2] / safe, -1, 1)) / np.pi
    return np.where((size > 0)[:, None], np.stack([u, w], 1), 0)


def tube_uv(v: np.ndarray) -> np.ndarray:
    """(n, 2) from points around the z axis."""
    inside = np.hypot(v[:, 0], v[:, 1]) > 0
    u = (1 - np.arctan2(v[:, 0], v[:, 1]) / np.pi) / 2
    return np.where(inside[:, None], np.stack([u, (v[:, 2] + 1) / 2], 1), 0)


def box_weights(normal: np.ndarray, blend: float) -> np.ndarray:
    """(n, 3) shares of the projections along x, y and z for unit normals in the object's space."""
    n = np.abs(normal)
    n = n / np.maximum(n.sum(1, keepdims=True), 1e-20)
    limit = 0.5 * (1 + blend)
    x, y, z = n[:, 0], n[:, 1], n[:, 2]
    weights = np.zeros_like(n)
    left = np.ones(len(n), np.bool_)

    def settle(where: np.ndarray, values: tuple) -> None:
        nonlocal left
        here = left & where
        for k, value in enumerate(values):
            weights[here, k] = value if np.isscalar(value) else value[here]
        left = left & ~where

    settle((x > limit * (x + y)) & (x > limit * (x + z)), (1, 0, 0))
    settle((y > limit * (x + y)) & (y > limit * (y + z)), (0, 1, 0))
    settle((z > limit * (x + z)) & (z > limit * (y + z)), (0, 0, 1))
    if blend <= 0:
        settle(left, (1, 0, 0))
        return weights

    def share(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return saturate((a / np.maximum(a + b, 1e-20) - 0.5 * (1 - blend)) / blend)

    settle(z < (1 - limit) * (y + x), (share(x, y), 1 - share(x, y), 0))
    settle(x < (1 - limit) * (y + z), (0, share(y, z), 1 - share(y, z)))
    settle(y < (1 - limit) * (x + z), (share(x, z), 0, 1 - share(x, z)))
    settle(left, tuple(((2 - limit) * n[:, k] + (limit - 1)) / (2 * limit - 1) for k in range(3)))
    return weights


def _reads(params: dict, wanted: frozenset[str]) -> tuple[str, ...]:
    return ("world_from_part",) if params.get("projection") == "BOX" else ()


@node(
    "image_texture",
    {"vector": (VECTOR, From("uv")), "shading_normal": (VECTOR, From("normal"))},
    {"color": COLOR, "alpha": FLOAT},
    reads=_reads,
    ignores=lambda params, wanted: () if params.get("projection") == "BOX" else ("shading_normal",),
    prepare=prepare,
    footprint="vector",
    stepped=lambda params: params.get("interpolation") == "Closest",
)
def _image_texture(c: Call) -> dict[str, np.ndarray]:
    """params: image, projection "FLAT", "BOX", "SPHERE", "TUBE", blend, extension, interpolation.

    unassociate: divide by alpha, as Cycles does where the node's alpha output is used.
    """
    texture = c.params.get("texture")
    co = c["vector"]
    if texture is None:
        return outputs_of(c, np.array([[1, 0, 1, 1]], np.float32))
    options = {
        "footprint": c["footprint"],
        "extension": c.params.get("extension", "REPEAT"),
        "interpolation": c.params.get("interpolation", "Linear"),
        "unassociate": c.params.get("unassociate", True),
    }
    projection = c.params.get("projection", "FLAT")
    if projection == "SPHERE":
        return outputs_of(c, texture.look_up(sphere_uv(2 * co - 1), **options))
    if projection == "TUBE":
        return outputs_of(c, texture.look_up(tube_uv(2 * co - 1), **options))
    if projection != "BOX":
        return outputs_of(c, texture.look_up(co[:, :2], **options))
    normal = normal_to_object(c.points, c["shading_normal"])
    weights = box_weights(normal, float(c.params.get("blend", 0.0)))
    n = max(len(co), len(weights))
    x, y, z = (np.broadcast_to(co[:, k], n) for k in range(3))
    flip = np.broadcast_to(normal, (n, 3))
    # each side sees the image unmirrored
    sides = (
        np.stack([np.where(flip[:, 0] < 0, 1 - y, y), z], 1),
        np.stack([np.where(flip[:, 1] > 0, 1 - x, x), z], 1),
        np.stack([np.where(flip[:, 2] > 0, 1 - y, y), x], 1),
    )
    rgba = sum(weights[:, k : k + 1] * texture.look_up(uv, **options) for k, uv in enumerate(sides))
    return outputs_of(c, rgba)
