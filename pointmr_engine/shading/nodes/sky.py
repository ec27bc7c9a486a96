"""Sky Texture."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pointmr_engine.shading.nodes.registry import COLOR, VECTOR, Call, From, node
from pointmr_engine.shading.sky_formulas import hosek, preetham
from pointmr_engine.shading.sky_models import (
    HEIGHT,
    WIDTH,
    Atmosphere,
    horizon_dip,
    multiple_scattering,
    multiple_scattering_sun,
    single_scattering,
    single_scattering_sun,
)
from pointmr_engine.shading.spectra import RGB_FROM_XYZ
from pointmr_engine.shading.values import length

_SINGLE = ("SINGLE_SCATTERING", "NISHITA")


@lru_cache(maxsize=4)
def _sky_table(kind: str, atmosphere: Atmosphere) -> np.ndarray:
    make = single_scattering if kind in _SINGLE else multiple_scattering
    return make(atmosphere).astype(np.float32)


def _sun_position(params: dict) -> tuple[float, float]:
    """Elevation within a quarter turn of the horizon, and rotation (counter-clockwise, 0 to 2 pi)."""
    elevation = np.fmod(params.get("sun_elevation", np.radians(15)), 2 * np.pi)
    rotation = params.get("sun_rotation", 0.0)
    if abs(elevation) >= np.pi:
        elevation -= np.copysign(2 * np.pi, elevation)
    if abs(elevation) >= np.pi / 2:
        elevation = np.copysign(np.pi, elevation) - elevation
        rotation += np.pi
    return float(elevation), float(2 * np.pi - np.mod(rotation, 2 * np.pi))


def sun_direction(params: dict) -> np.ndarray:
    """(3,) unit vector to the sun of a sky with a sun disc."""
    elevation, rotation = _sun_position(params)
    theta, phi = elevation - np.pi / 2, rotation - np.pi / 2
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def _prepare(params: dict) -> dict:
    kind = params.get("sky_type", "MULTIPLE_SCATTERING")
    if kind in ("PREETHAM", "HOSEK_WILKIE"):
        return params
    elevation, _ = _sun_position(params)
    atmosphere = Atmosphere(
        elevation,
        params.get("altitude", 100.0),
        params.get("air_density", 1.0),
        params.get("aerosol_density", 1.0),
        params.get("ozone_density", 1.0),
    )
    sun = single_scattering_sun if kind in _SINGLE else multiple_scattering_sun
    angle = max(params.get("sun_size", 0.009512), 0.0005)
    return {
        **params,
        "table": _sky_table(kind, atmosphere),
        "sun": sun(atmosphere, angle),
        "sun_angle": angle,
    }


@node("sky_texture", {"vector": (VECTOR, From("generated"))}, {"color": COLOR}, prepare=_prepare)
def _sky(c: Call) -> np.ndarray:
    """params: sky_type and the other properties of Blender's node."""
    d = c["vector"].astype(np.float64)
    size = length(d)[:, None]
    d = d / np.where(size > 0, size, 1)
    if "table" not in c.params:
        xyz = _analytic(c.params, d)
    else:
        xyz = _scattering(c.params, d)
    return np.maximum(xyz @ RGB_FROM_XYZ.T, 0)


def _analytic(params: dict, d: np.ndarray) -> np.ndarray:
    sun = np.asarray(params.get("sun_direction", (0, 0, 1)), np.float64)
    sun = sun / max(np.linalg.norm(sun), 1e-9)
    theta = np.arccos(np.clip(d[:, 2], -1, 1))
    gamma = np.arccos(np.clip(d @ sun, -1, 1))
    turbidity = params.get("turbidity", 2.2)
    if params["sky_type"] == "PREETHAM":
        return preetham(float(np.arccos(sun[2])), turbidity, theta, gamma)
    return hosek(float(np.arcsin(sun[2])), turbidity, params.get("ground_albedo", 0.3), theta, gamma)


def _scattering(params: dict, d: np.ndarray) -> np.ndarray:
    elevation, rotation = _sun_position(params)
    height = np.arcsin(np.clip(d[:, 2], -1, 1))
    azimuth = np.arctan2(d[:, 1], d[:, 0])
    x = (-azimuth - np.pi / 2 + rotation) / (2 * np.pi)
    # rows are denser toward the horizon
    y = np.copysign(np.sqrt(np.abs(height) * 2 / np.pi), height) * 0.5 + 0.5
    xyz = _bilinear(params["table"], x - np.floor(x), y)
    angle = params["sun_angle"]
    if not params.get("sun_disc", True):
        return xyz
    sun = sun_direction(params)
    away = 2 * np.arctan2(np.linalg.norm(d - sun, axis=1), np.linalg.norm(d + sun, axis=1))
    inside = (away < angle / 2) & (height > -horizon_dip(params.get("altitude", 100.0)))
    low, high = params["sun"]
    t = ((height - elevation) / angle + 0.5)[:, None]
    darkening = 1 - 0.6 * (1 - np.sqrt(np.maximum(1 - (away / (angle / 2)) ** 2, 0)))
    disc = (low + (high - low) * t) * (params.get("sun_intensity", 1.0) * darkening)[:, None]
    return xyz + np.where(inside[:, None], disc, 0)


def _bilinear(table: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n, 3) from a table at 0..1, its edges extended."""
    x, y = x * WIDTH - 0.5, y * HEIGHT - 0.5
    i, j = np.floor(x), np.floor(y)
    fx, fy = (x - i)[:, None], (y - j)[:, None]
    i0, i1 = (np.clip(i + k, 0, WIDTH - 1).astype(np.int64) for k in (0, 1))
    j0, j1 = (np.clip(j + k, 0, HEIGHT - 1).astype(np.int64) for k in (0, 1))
    low = table[j0, i0] * (1 - fx) + table[j0, i1] * fx
    return low * (1 - fy) + (table[j1, i0] * (1 - fx) + table[j1, i1] * fx) * fy
