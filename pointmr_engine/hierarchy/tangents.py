"""Tangents per corner for normal maps: UV gradients, averaged where a surface and its UVs are smooth."""

from __future__ import annotations

import numpy as np

from pointmr_engine.scene.mesh import Mesh


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.where(length > 0, v / np.where(length > 0, length, 1), 0)


def corner_tangents(mesh: Mesh, uv: np.ndarray) -> np.ndarray:
    """(T, 3, 4) float32: unit tangent, square to the corner's normal, and the bitangent's sign.

    Like MikkTSpace: corners that share place, normal, UV and orientation share a tangent, the mean of their triangles'
    UV gradients, each brought into the tangent plane and weighted by the corner's angle. bitangent = sign * normal x
    tangent. Zero where UVs or triangle are degenerate and no neighbour helps.
    """
    p = np.asarray(mesh.positions, np.float64)[mesh.triangles]
    uv = np.asarray(uv, np.float64)
    with np.errstate(all="ignore"):
        e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        s, t = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        area = s[:, 0] * t[:, 1] - s[:, 1] * t[:, 0]
        sign = np.where(area < 0, -1.0, 1.0)
        gradient = (e1 * t[:, 1:] - e2 * s[:, 1:]) * sign[:, None]
        gradient = np.where((np.isfinite(gradient).all(1) & (area != 0))[:, None], gradient, 0.0)
        face = _unit(np.cross(e1, e2))
        if mesh.normals is None:
            normals = np.repeat(face[:, None], 3, axis=1)
        elif mesh.normals.ndim == 3:
            normals = np.asarray(mesh.normals, np.float64)
        else:
            normals = np.asarray(mesh.normals, np.float64)[mesh.triangles]
        flat = gradient[:, None] - normals * (normals * gradient[:, None]).sum(-1, keepdims=True)
        to_next = p[:, [1, 2, 0]] - p
        to_last = p[:, [2, 0, 1]] - p
        # the angle as seen in the tangent plane of the corner's normal
        to_next = _unit(to_next - normals * (normals * to_next).sum(-1, keepdims=True))
        to_last = _unit(to_last - normals * (normals * to_last).sum(-1, keepdims=True))
        angle = np.arccos(np.clip((to_next * to_last).sum(-1), -1, 1))
        weighted = np.nan_to_num(_unit(flat) * angle[..., None])
    n = len(p)
    keys = np.concatenate(
        [p.reshape(-1, 3), normals.reshape(-1, 3), uv.reshape(-1, 2), np.repeat(sign, 3)[:, None]], axis=1
    ).astype(np.float32)
    _, same = np.unique(
        (keys + np.float32(0)).view(np.dtype((np.void, keys.shape[1] * 4))), return_inverse=True
    )
    same = same.reshape(-1)
    total = np.zeros((same.max(initial=-1) + 1, 3))
    for k in range(3):
        total[:, k] = np.bincount(same, weighted.reshape(-1, 3)[:, k], minlength=len(total))
    result = np.empty((n, 3, 4), np.float32)
    result[..., :3] = _unit(total)[same].reshape(n, 3, 3)
    result[..., 3] = sign[:, None]
    return result
