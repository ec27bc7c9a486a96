"""Lamps of the scene's lights: their rows for sampling and meeting them (`raytracing.lamps`)."""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.numerics.transforms import inverse_linear
from pointmr_engine.raytracing.lamps import (
    AX,
    AZ,
    COLUMNS,
    CONE,
    COS_HALF,
    DISC,
    DISTANT,
    ELLIPSE,
    HALF_U,
    HALF_V,
    LOCAL,
    POINT,
    RADIUS,
    RECTANGLE,
    SMOOTH,
    SPHERE,
    SPOT,
    SPOT_CONE,
    SPREAD_SCALE,
    SUN,
    TAN_SPREAD,
    UX,
    UZ,
    VX,
    VZ,
    Lamps,
)
from pointmr_engine.scene.light import Light


def compile_lamps(lights: list[Light]) -> tuple[Lamps, list[str]]:
    """Lamps of all lights that shine, and warnings about those that cannot."""
    rows, warnings = [], []
    for index, light in enumerate(lights):
        row = _compile_lamp(light, warnings)
        if row is not None:
            varying = light.graph is not None
            rows.append((*row, light.cast_shadow, light.visibility & 255, index, varying, 1.0))
    n = len(rows)
    lamps = Lamps(
        np.zeros(n, np.uint8),
        np.zeros((n, COLUMNS)),
        np.zeros((n, 3)),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
        np.zeros(n, np.uint8),
        np.zeros(n, np.int32),
        np.zeros(n, np.bool_),
        np.ones(n),
    )
    for k, row in enumerate(rows):
        for column, value in zip(lamps, row, strict=True):
            column[k] = value
    return lamps, warnings


def _compile_lamp(light: Light, warnings: list[str]):
    """(shape, values, radiance, mis) of one light, or None where it cannot shine."""
    m = np.asarray(light.world_from_light, np.float64)
    numbers = (light.power, light.exposure, light.radius, light.angle, light.spot_angle, light.spot_blend)
    numbers += (light.size_x, light.size_y, light.spread, *light.color)
    if not (np.isfinite(m[:3]).all() and np.isfinite(numbers).all()):
        warnings.append(f"light '{light.name}': a value or its transform is not finite; it is left out")
        return None
    strength = np.asarray(light.color, np.float64) * light.power * 2.0**light.exposure
    if not strength.any():
        return None
    lengths = np.linalg.norm(m[:3, :3], axis=0)
    if lengths[2] == 0.0 and light.kind != "POINT":
        warnings.append(f"light '{light.name}': its transform is scaled to zero; it is left out")
        return None
    unit = m[:3, :3] / np.where(lengths > 0.0, lengths, 1.0)
    values = np.zeros(COLUMNS)
    values[:3] = m[:3, 3]
    values[AX : AZ + 1] = -unit[:, 2]
    values[UX : UZ + 1], values[VX : VZ + 1] = unit[:, 0], unit[:, 1]
    values[TAN_SPREAD] = math.inf
    if light.kind in ("POINT", "SPOT"):
        return _compile_point(light, m, strength, values)
    if light.kind == "SUN":
        return _compile_sun(light, strength, values)
    if light.kind == "AREA":
        return _compile_area(light, lengths, strength, values, warnings)
    warnings.append(
        f"light '{light.name}': kind '{light.kind}' is not POINT, SUN, SPOT or AREA; it is left out"
    )
    return None


def _compile_point(light: Light, m: np.ndarray, strength: np.ndarray, values: np.ndarray):
    radius = max(0.0, light.radius)
    values[RADIUS] = radius
    if light.kind == "SPOT":
        linear = m[:3, :3]
        if abs(np.linalg.det(linear)) < 1e-30:
            linear = np.eye(3)
        half = 0.5 * min(max(light.spot_angle, 1e-4), math.pi)
        values[SPOT] = 1.0
        values[LOCAL : LOCAL + 9] = inverse_linear(linear).ravel()
        values[COS_HALF] = math.cos(half)
        values[SMOOTH] = 1.0 / max((1.0 - math.cos(half)) * light.spot_blend, 1e-12)
        # a scaled spot's cone is an elliptical one: the wider half angle
        scale = np.linalg.norm(linear, axis=0)
        wider = math.atan2(max(scale[0], scale[1]) * math.tan(min(half, 1.57079)), scale[2])
        values[SPOT_CONE] = 1.0 if half >= 1.57079 else 1.0 - math.cos(wider)
    radiance = strength / math.pi
    if light.normalize:
        radiance = radiance / (4.0 * (math.pi * radius * radius if radius > 0.0 else 1.0))
    shape = POINT if radius == 0.0 else (DISC if light.soft_falloff else SPHERE)
    return shape, values, radiance, light.use_mis and radius > 0.0


def _compile_sun(light: Light, strength: np.ndarray, values: np.ndarray):
    half = 0.5 * min(max(light.angle, 0.0), math.pi)
    values[CONE] = 2.0 * math.sin(0.5 * half) ** 2
    if half == 0.0:
        return DISTANT, values, strength, False
    radiance = strength / (math.pi * math.sin(half) ** 2) if light.normalize else strength
    return SUN, values, radiance, light.use_mis


def _compile_area(
    light: Light, lengths: np.ndarray, strength: np.ndarray, values: np.ndarray, warnings: list[str]
):
    size_y = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size_x
    side_u, side_v = abs(light.size_x) * lengths[0], abs(size_y) * lengths[1]
    shape = ELLIPSE if light.shape in ("DISK", "ELLIPSE") else RECTANGLE
    area = side_u * side_v * (math.pi / 4.0 if shape == ELLIPSE else 1.0)
    if area == 0.0:
        warnings.append(f"light '{light.name}': an area light without an area; it is left out")
        return None
    values[HALF_U], values[HALF_V] = 0.5 * side_u, 0.5 * side_v
    radiance = strength / math.pi
    if light.normalize:
        radiance = radiance / area
    half = 0.5 * min(max(light.spread, 0.0), math.pi)
    if half == 0.0:
        values[TAN_SPREAD] = 0.0
        return shape, values, radiance * math.pi, False
    if half < 0.5 * math.pi - 1e-7:
        tangent = math.tan(half)
        values[TAN_SPREAD] = tangent
        # soft box: integrates to the same power at any spread; the series keeps narrow beams exact
        excess = tangent - half if half > 1e-3 else half**3 / 3.0 + 2.0 * half**5 / 15.0
        values[SPREAD_SCALE] = 1.0 / excess
    return shape, values, radiance, light.use_mis
