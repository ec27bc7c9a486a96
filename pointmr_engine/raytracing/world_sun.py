"""The sun of a world: what comes from a small disc of its directions, told from the rest, so that it can be a lamp.

Samples of a whole world find a sun often enough (raytracing.environment), but whoever filters the world, or shares its
light among neighbours, would blur it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.warps import orthonormal_basis
from pointmr_engine.raytracing.world_texels import directions
from pointmr_engine.scene.light import Light

WIDEST = 0.05  # half angle (rad): of larger discs mirrors would show the shape
SHARE = 0.2  # of all the world's light, at least: else the disc is one of many bright spots
FADED = 0.02  # of a disc's mean is left around it
AROUND = 1.5  # so many times its radius is what counts as around
ROUND = 0.2  # of the variance along a disc is across it, at least: a strip is no disc
NARROWEST = 0.00025  # half angle (rad) of the lamp
EDGE = 1.005  # of a disc's radius are hidden, lest rounding shows some of its edge
PLACES = 4096  # at which a disc is measured

Radiance = Callable[[np.ndarray], np.ndarray]  # (N, 3) of unit directions (N, 3)


class WorldSun(NamedTuple):
    """A disc of directions, and the lamp that shines like what it has beyond its surroundings."""

    light: Light
    direction: np.ndarray  # (3,) float64 unit, of the disc's middle
    reach: float  # 1 - cos of its half angle
    rim: np.ndarray  # (3,) float32 radiance around it, which is the world's where the lamp stands apart

    def within(self, direction: np.ndarray, beyond: float = 0.0) -> np.ndarray:
        """(N,) bool: which unit directions (N, 3) lie in the disc, or up to an angle beyond it (rad)."""
        reach = self.reach
        if beyond > 0.0:
            reach = 1.0 - math.cos(min(math.acos(1.0 - reach) + beyond, math.pi))
        away = direction - self.direction  # of close directions, a dot product would lose the angle
        return 0.5 * np.einsum("ij,ij->i", away, away) <= reach


def bright_disc(weight: np.ndarray, solid_angle: np.ndarray) -> tuple[np.ndarray, float] | None:
    """(unit direction, half angle) of the only small disc that much of a world's light comes from.

    weight (H, W): radiance of texels, in rows of equal angle from straight down and columns of equal azimuth from -pi;
    solid_angle (H,): theirs.
    """
    height, width = weight.shape
    step = math.pi / height
    brightest = directions(*np.divmod(np.array([weight.argmax()]), width), height, width)[0]
    d, light, size = _near(weight, solid_angle, brightest, 2.0 * WIDEST)
    bright = light >= 0.5 * light.max()
    middle = ((light * size)[bright, None] * d[bright]).sum(0)
    middle /= np.linalg.norm(middle)
    d, light, size = _near(weight, solid_angle, middle, AROUND * WIDEST)
    away = np.linalg.norm(d - middle, axis=1)
    light = light * size
    for half in np.arange(2.0, WIDEST / step) * step:
        inside, beside = away <= half, (away > half) & (away <= AROUND * half)
        disc, around = (light[of].sum() / size[of].sum() for of in (inside, beside))
        if around <= FADED * disc:
            all_light = float(weight.sum(1, dtype=np.float64) @ solid_angle)
            of_sun = (disc - around) * size[inside].sum()
            return (middle, float(half)) if of_sun >= SHARE * all_light else None
    return None


def _near(
    weight: np.ndarray, solid_angle: np.ndarray, middle: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(directions (N, 3), radiance (N,), solid angles (N,)) of the texels within an angle of a direction."""
    height, width = weight.shape
    row, rows = math.acos(-middle[2]) / math.pi * height, math.ceil(reach / math.pi * height)
    first, end = max(int(row) - rows, 0), min(int(row) + rows + 1, height)
    r, c = (a.ravel() for a in np.meshgrid(np.arange(first, end), np.arange(width), indexing="ij"))
    d = directions(r, c, height, width)
    close = np.linalg.norm(d - middle, axis=1) <= reach
    return d[close], weight[first:end].ravel()[close].astype(np.float64), solid_angle[r[close]]


def measure(direction: np.ndarray, half: float, radiance: Radiance) -> WorldSun | None:
    """The disc of that half angle (rad) about a unit direction as a lamp; None: it is dark, or no disc."""
    frame = np.stack([*np.array(orthonormal_basis(*direction)).reshape(2, 3), direction])
    # a sunflower's seeds: even in the disc, and at no angle twice
    k = np.arange(PLACES)
    turn, away = k * (math.pi * (3.0 - math.sqrt(5.0))), half * np.sqrt((k + 0.5) / PLACES)
    ring = AROUND * half
    rim = radiance(_about(frame, turn[:256], np.full(256, ring))).astype(np.float64).mean(0)
    beyond = np.maximum(radiance(_about(frame, turn, away)) - rim, 0.0).astype(np.float64)
    share = beyond.mean(1)
    if not share.sum() > 0.0:
        return None
    place = np.stack([away * np.cos(turn), away * np.sin(turn)])
    x, y = np.average(place, axis=1, weights=share)
    spread = np.linalg.eigvalsh(np.cov(place, aweights=share, bias=True))
    if spread[0] < ROUND * spread[1]:
        return None
    irradiance = beyond.mean(0) * math.pi * math.sin(half) ** 2
    # of an even disc, the mean square of the distance to its middle is half that of its radius
    lamp = min(max(math.sqrt(2.0 * spread.sum()), NARROWEST), half)
    towards = x * frame[0] + y * frame[1] + frame[2]
    towards /= np.linalg.norm(towards)
    placed = np.eye(4)
    placed[:3, :3] = np.stack([*np.array(orthonormal_basis(*towards)).reshape(2, 3), towards], 1)
    peak = float(irradiance.max())
    colour = tuple((irradiance / peak).tolist())
    light = Light("SUN", placed, colour, peak, angle=2.0 * lamp, name="sun of the world")
    return WorldSun(light, direction, 2.0 * math.sin(0.5 * EDGE * half) ** 2, rim.astype(np.float32))


def _about(frame: np.ndarray, turn: np.ndarray, away: np.ndarray) -> np.ndarray:
    """(N, 3) unit directions at angles `away` from the third row of `frame` (3, 3), turned about it."""
    flat = np.sin(away)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), np.cos(away)], 1) @ frame
