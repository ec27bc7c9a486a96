"""Environment Texture: images over directions."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading.nodes.image_texture import outputs_of, prepare
from pointmr_engine.shading.nodes.registry import COLOR, FLOAT, VECTOR, Call, From, node
from pointmr_engine.shading.values import normalize

_NO_FOOTPRINT = np.zeros(1, np.float32)


def equirectangular_uv(d: np.ndarray) -> np.ndarray:
    """(n, 2) image position of directions (n, 3): +x in the middle, +y at u = 0.25, z up."""
    u = 0.5 - np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi)
    size = np.sqrt((d * d).sum(1))
    v = 1 - np.arccos(np.clip(d[:, 2] / np.maximum(size, 1e-20), -1, 1)) / np.pi
    return np.where((size > 0)[:, None], np.stack([u, v], 1), 0)


def mirror_ball_uv(d: np.ndarray) -> np.ndarray:
    """(n, 2) image position of directions in a photograph of a mirroring ball."""
    y = d[:, 1] - 1
    scale = 2 * np.sqrt(np.maximum(-0.5 * y, 0))
    safe = np.where(scale > 0, scale, 1)
    return np.stack([d[:, 0] / safe + 1, d[:, 2] / safe + 1], 1) / 2


@node(
    "environment_texture",
    {"vector": (VECTOR, From("position"))},
    {"color": COLOR, "alpha": FLOAT},
    prepare=prepare,
)
def _environment_texture(c: Call) -> dict[str, np.ndarray]:
    """params: image, projection "EQUIRECTANGULAR" or "MIRROR_BALL", interpolation, unassociate."""
    texture = c.params.get("texture")
    if texture is None:
        return outputs_of(c, np.array([[1, 0, 1, 1]], np.float32))
    d = normalize(c["vector"])
    uv = mirror_ball_uv(d) if c.params.get("projection") == "MIRROR_BALL" else equirectangular_uv(d)
    rgba = texture.look_up(
        uv,
        _NO_FOOTPRINT,
        "REPEAT",
        c.params.get("interpolation", "Linear"),
        c.params.get("unassociate", True),
    )
    return outputs_of(c, rgba)
