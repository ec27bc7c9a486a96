"""The world as a light without noise: its sun as a lamp, and the rest filtered for every roughness of a lobe.

Maps hold rows of equal angle from straight down and columns of equal azimuth, one map for each of a few roughnesses,
and one filtered with the cosine. A lobe's light is one lookup in the direction it faces, between the two nearest
roughnesses (split-sum approximation; Karis, Real Shading in Unreal Engine 4, 2013).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import device
from pointmr_engine.raytracing.environment import Environment
from pointmr_engine.raytracing.world_texels import directions, solid_angles
from pointmr_engine.scene.group import DIFFUSE, GLOSSY, TRANSMISSION
from pointmr_engine.scene.light import Light

BASE = 1024  # columns of the sharpest map
FINEST = 4  # places a side of its texels where the world has finer detail
# Halved maps, read between their texels, stand for narrow lobes: of GGX roughness SMOOTHEST / columns if so much of
# each is mixed with as much of the next coarser ones. An edge is then right to 0.3 % (7 % with one map, without tails).
SMOOTHEST, MIXED = 4.19, (0.35, 0.45, 0.11, 0.09)
COARSEST = 8  # columns of the coarsest map that is mixed
BLURRED = (0.1, 0.2, 0.4, 0.7, 1.0)  # roughnesses of maps that are filtered with the lobe itself ...
SOURCE = 64  # ... from the map of so many columns
AT_POLES = (
    0.8,
    1.25,
)  # least and greatest factor that makes up for what halved maps lose, or gain, at their poles
UNIFORM = 4  # columns of the map of a world that is the same everywhere


class WorldMaps(NamedTuple):
    """All maps of one kind of light, behind each other."""

    texels: np.ndarray  # (T, 3) float32 radiance
    # (M + 1,) int64 row of each map's first texel; the last one is filtered with the cosine
    first: np.ndarray
    width: np.ndarray  # (M + 1,) int64 columns; half as many rows
    alpha: np.ndarray  # (M,) float64 GGX roughness that each map is filtered for, increasing


class WorldLight:
    """The world's maps for diffuse, glossy and transmitted light, and its suns as lamps."""

    def __init__(self, environment: Environment):
        self.suns: list[Light] = []
        kinds = (DIFFUSE, GLOSSY, TRANSMISSION)
        apart = "ray_kind" in environment.program.emission_needs
        base = {}
        for kind in kinds:
            if environment.black or not environment.visibility & kind:
                base[kind] = None
            elif not apart and any(b is not None for b in base.values()):
                base[kind] = next(b for b in base.values() if b is not None)
            else:
                base[kind] = _radiance_map(environment, kind)
        sun = environment.sun
        if sun is not None:  # a map would give it the shape of its texels, and no shadow
            self.suns.append(sun.light)
            for texels in {id(b): b for b in base.values() if b is not None}.values():
                width = texels.shape[1]
                texels.reshape(-1, 3)[sun.within(_directions(width), 4.0 / width)] = sun.rim
        halved = {id(b): _halvings(b) for b in base.values()}
        made, blurred = ({k: of(h) for k, h in halved.items()} for of in (_filtered, _blurred))
        self.diffuse, self.glossy, self.transmission = (made[id(base[kind])] for kind in kinds)
        self.glossy_rays, self.transmission_rays = (blurred[id(base[kind])] for kind in kinds[1:])
        texels = base[DIFFUSE]
        self.mean = np.zeros(3)  # radiance over all directions
        if texels is not None:
            self.mean[:] = (texels * _solid_angle(texels.shape[1])).sum((0, 1)) / (4.0 * math.pi)


def _directions(width: int) -> np.ndarray:
    """(width / 2 * width, 3) unit directions of a map's texels."""
    return _towards(np.arange(width // 2 * width), width)


def _towards(texel: np.ndarray, width: int, u: float = 0.5, v: float = 0.5) -> np.ndarray:
    """(N, 3) unit directions of the place u, v in [0, 1) within each of the texels (N,) of a map."""
    row, column = np.divmod(texel, width)
    return directions(row + (v - 0.5), column + (u - 0.5), width // 2, width)


def _radiance_map(environment: Environment, kind: int) -> np.ndarray:
    """(rows, columns, 3) float32."""
    if environment.constant is not None:
        return np.broadcast_to(
            np.asarray(environment.constant, np.float32), (UNIFORM // 2, UNIFORM, 3)
        ).copy()
    # suns of images are smaller than texels
    finer = min(-(-environment.image_width // BASE), FINEST)
    out = _means(environment, kind, np.arange(BASE // 2 * BASE), finer)
    if finer == 1:
        sharp = np.flatnonzero(_differs(out.reshape(BASE // 2, BASE, 3)))
        out[sharp] = _means(environment, kind, sharp, FINEST)
    return out.reshape(BASE // 2, BASE, 3)


def _means(environment: Environment, kind: int, texel: np.ndarray, n: int) -> np.ndarray:
    """(N, 3) float32 mean radiance of n x n places in each of the texels (N,) of the sharpest map."""
    out = np.empty((len(texel), 3), np.float32)
    for first in range(0, len(texel), 1 << 16):
        some = slice(first, first + (1 << 16))
        total, weight = np.zeros((len(texel[some]), 3)), np.zeros((len(texel[some]), 1))
        for k in range(n * n):
            d = _towards(texel[some], BASE, (k % n + 0.5) / n, (k // n + 0.5) / n)
            size = np.sqrt(1.0 - np.minimum(d[:, 2:] ** 2, 1.0))  # of a row
            total += size * environment.radiance(d, kind)
            weight += size
        out[some] = total / weight
    return out


def _differs(texels: np.ndarray) -> np.ndarray:
    """(rows, columns) bool: texels that have less than half, or more than twice, of what one beside them has."""
    bright = np.abs(texels).sum(2)
    found = np.zeros(bright.shape, np.bool_)
    for axis in (0, 1):
        before, t, after = (np.moveaxis(a, 0, axis) for a in _with_neighbours(bright, axis))
        low, high = np.minimum(np.minimum(before, after), t), np.maximum(np.maximum(before, after), t)
        found |= high > 2.0 * low
    return found


def _halvings(base: np.ndarray | None) -> list[np.ndarray]:
    """The sharpest map (None: black) and those of half as many rows and columns each, as far as they are mixed."""
    maps = [np.zeros((UNIFORM // 2, UNIFORM, 3), np.float32) if base is None else base]
    while maps[-1].shape[1] > COARSEST:
        maps.append(_halved(maps[-1]))
    return maps


def _filtered(halved: list[np.ndarray]) -> WorldMaps:
    """All maps for lobes, made from the sharpest one and its halvings."""
    base = halved[0]
    sharp = [m for m in halved if m.shape[1] >= SOURCE] or [base]
    source = sharp[-1]
    maps, alpha = [base], [0.0]
    for level in range(1, len(sharp)):
        maps.append(_mixed(halved[level : level + len(MIXED)]))
        alpha.append(SMOOTHEST / maps[-1].shape[1])
    for a in BLURRED if source.shape[1] > UNIFORM else ():
        maps.append(_lobe_filtered(source, SOURCE if a < 0.3 else SOURCE // 2, a))
        alpha.append(a)
    maps.append(source if source.shape[1] <= UNIFORM else _lobe_filtered(source, SOURCE // 2, None))
    return _behind_each_other(maps, alpha)


def _blurred(halved: list[np.ndarray]) -> WorldMaps:
    """The sharpest map and its halvings, about as wide as lobes of those roughnesses, but without their tails.

    For rays that were drawn from lobes: a lobe's tails would count twice.
    """
    alpha = [0.0] + [SMOOTHEST / m.shape[1] for m in halved[1:]]
    return _behind_each_other([*halved, halved[-1]], alpha)


def _behind_each_other(maps: list[np.ndarray], alpha: list[float]) -> WorldMaps:
    sizes = np.array([m.shape[0] * m.shape[1] for m in maps], np.int64)
    return WorldMaps(
        np.ascontiguousarray(np.concatenate([m.reshape(-1, 3) for m in maps]), np.float32),
        np.cumsum(sizes) - sizes,
        np.array([m.shape[1] for m in maps], np.int64),
        np.array(alpha),
    )


def _solid_angle(width: int) -> np.ndarray:
    """(rows, 1, 1) of a texel."""
    return solid_angles(width // 2, width)[:, None, None]


def _halved(texels: np.ndarray) -> np.ndarray:
    """A map of half as many rows and columns: means by quadratic splines, lest it matter where edges lie in texels."""
    size = _solid_angle(texels.shape[1])
    out = (_thinned(texels * size) / _thinned(np.broadcast_to(size, texels.shape))).astype(np.float32)
    # at the poles rows are of such different size that a sun would lose a tenth each time
    larger = _solid_angle(out.shape[1])
    for fine, cap in ((slice(0, 4), slice(0, 2)), (slice(-4, None), slice(-2, None))):
        before, after = (texels * size)[fine].sum((0, 1)), (out * larger)[cap].sum((0, 1))
        out[cap] *= np.clip(before / np.where(after > 0.0, after, before + 1e-30), *AT_POLES)
    return out


def _thinned(texels: np.ndarray) -> np.ndarray:
    for axis in (0, 1):
        before, t, after = _with_neighbours(texels, axis)
        texels = np.moveaxis(before[::2] + 3.0 * (t[::2] + t[1::2]) + after[1::2], 0, axis)
    return texels


def _with_neighbours(texels: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(the texels before each, itself, those after), with `axis` in front; the last column is beside the first."""
    t = np.moveaxis(texels, axis, 0)
    before, after = np.roll(t, 1, 0), np.roll(t, -1, 0)
    if axis == 0:
        before[0], after[-1] = t[0], t[-1]
    return before, t, after


def _doubled(texels: np.ndarray) -> np.ndarray:
    """A map of twice as many rows and columns, between the texels."""
    for axis in (0, 1):
        before, t, after = _with_neighbours(texels, axis)
        both = np.stack([0.75 * t + 0.25 * before, 0.75 * t + 0.25 * after], 1)
        texels = np.moveaxis(both.reshape(-1, *t.shape[1:]), 0, axis)
    return texels


def _mixed(halved: list[np.ndarray]) -> np.ndarray:
    """Maps, each half as large as the one before, mixed as MIXED says."""
    total = MIXED[-1] * halved[-1]
    for share, texels in zip(MIXED[-2::-1], halved[-2::-1], strict=True):
        total = share * texels + _doubled(total)
    return total.astype(np.float32)


def _lobe_filtered(source: np.ndarray, width: int, alpha: float | None) -> np.ndarray:
    """Means of `source` under a GGX lobe seen along its normal, or under the cosine."""
    width = min(width, source.shape[1])
    lights = _directions(source.shape[1]).astype(np.float32)
    weight_of = np.repeat(_solid_angle(source.shape[1]).ravel(), source.shape[1]).astype(np.float32)
    radiance = source.reshape(-1, 3)
    facing = _directions(width).astype(np.float32)
    out = np.empty((len(facing), 3), np.float32)
    for first in range(0, len(facing), 256):
        cosine = facing[first : first + 256] @ lights.T
        weight = np.maximum(cosine, 0.0)
        if alpha is not None:
            half2 = 0.5 * (1.0 + np.clip(cosine, -1.0, 1.0))  # squared cosine to the half vector
            weight /= (half2 * (alpha * alpha - 1.0) + 1.0) ** 2
        weight *= weight_of
        weight /= weight.sum(1, keepdims=True)
        out[first : first + 256] = weight @ radiance
    return out.reshape(width // 2, width, 3)


@device
def _texel(maps, m, x, y, z):
    """Radiance of map m in the unit direction, between its four nearest texels."""
    width = maps.width[m]
    if width == UNIFORM:
        return (
            np.float64(maps.texels[0, 0]),
            np.float64(maps.texels[0, 1]),
            np.float64(maps.texels[0, 2]),
        )
    height = width >> 1
    u = (math.atan2(y, x) * (0.5 / math.pi) + 0.5) * width - 0.5
    v = math.acos(min(max(-z, -1.0), 1.0)) * (height / math.pi) - 0.5
    u0, v0 = math.floor(u), math.floor(v)
    s, t = u - u0, v - v0
    i = np.int64(u0)
    i = i + width if i < 0 else i
    j = i + 1 if i + 1 < width else np.int64(0)
    low = min(max(np.int64(v0), np.int64(0)), height - 1)
    high = min(max(np.int64(v0) + 1, np.int64(0)), height - 1)
    a, b = maps.first[m] + low * width, maps.first[m] + high * width
    w00, w01, w10, w11 = (1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t
    e = maps.texels
    return (
        w00 * e[a + i, 0] + w01 * e[a + j, 0] + w10 * e[b + i, 0] + w11 * e[b + j, 0],
        w00 * e[a + i, 1] + w01 * e[a + j, 1] + w10 * e[b + i, 1] + w11 * e[b + j, 1],
        w00 * e[a + i, 2] + w01 * e[a + j, 2] + w10 * e[b + i, 2] + w11 * e[b + j, 2],
    )


@device
def world_irradiance(maps, x, y, z):
    """Irradiance over pi (rgb) of a surface that faces the unit direction."""
    return _texel(maps, np.int64(len(maps.alpha)), x, y, z)


@device
def world_lobe(maps, alpha, x, y, z):
    """Mean radiance (rgb) of a lobe of GGX roughness alpha about the unit direction."""
    m, last = np.int64(0), np.int64(len(maps.alpha) - 1)
    while m < last and maps.alpha[m + 1] <= alpha:
        m += 1
    a = _texel(maps, m, x, y, z)
    if m == last:
        return a
    if alpha <= maps.alpha[m]:
        return a
    t = alpha / maps.alpha[m + 1]
    if m > 0:  # edges are as steep as roughness is small
        t = (1.0 - maps.alpha[m] / alpha) / (1.0 - maps.alpha[m] / maps.alpha[m + 1])
    b = _texel(maps, m + 1, x, y, z)
    return a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])
