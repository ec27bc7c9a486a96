"""The world as a light: its radiance by direction, and an importance map to sample it by."""

from __future__ import annotations

import copy
import math
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from pointmr_engine.numerics.jit import uncounted
from pointmr_engine.numerics.warps import cosine_hemisphere, uniform_cone
from pointmr_engine.raytracing.world_sun import WorldSun, bright_disc, measure
from pointmr_engine.raytracing.world_texels import directions, row_borders, solid_angles
from pointmr_engine.scene.graph import Link
from pointmr_engine.scene.group import CAMERA, DIFFUSE, GLOSSY, TRANSMISSION
from pointmr_engine.scene.world import World
from pointmr_engine.shading import points as surface_points
from pointmr_engine.shading.nodes.sky import sun_direction
from pointmr_engine.shading.program import Program, compile_graph, evaluate_background

# how the world is sampled as a light: where it has one radiance, on all sides that light comes from, or above alone
OFF, UNIFORM, MAP, ABOVE = 0, 1, 2, 3
_LARGEST_MAP = 4096
_SUN_SHARE = 0.8  # of the samples that go to the world, when its sky has a sun disc
_EVEN = (0.0, 0.25, 0.5, 0.75, 1.0)  # shares of its samples that may go by the cosine
_TRIALS = 4096  # texels by which they are compared

# what the Light Path node sees, by the visibility bit of the ray; 0: a light sample
_RAY_KINDS = {
    0: 0,
    CAMERA: surface_points.RAY_CAMERA,
    DIFFUSE: surface_points.RAY_DIFFUSE | surface_points.RAY_REFLECTION,
    GLOSSY: surface_points.RAY_GLOSSY | surface_points.RAY_REFLECTION,
    TRANSMISSION: surface_points.RAY_TRANSMISSION,
}


class WorldMap(NamedTuple):
    """How to sample the world. Texels: rows of equal angle from straight down, columns of equal azimuth from -pi."""

    mode: int  # OFF, UNIFORM, MAP or ABOVE
    rows: np.ndarray  # (H + 1,) float64 distribution over rows, 0 to 1
    columns: np.ndarray  # (H, W + 1) float32 distribution over the columns of each row, 0 to 1
    edges: np.ndarray  # (H + 1,) float64 height z of the rows' borders
    sun: np.ndarray  # (5,) float64: unit direction, 1 - cos of the half angle, share of samples (0: no sun)
    even: float  # share of the samples but for the sun's that goes by the cosine at the surface, not by the texels
    irradiance: float  # what the world gives to a surface that sees all of it, its mean over all normals
    towards: np.ndarray  # (3,) float64: by how much that changes with the normal, roughly (linear in it)
    # from how wide an angle most of it comes, against a hemisphere's: the root of the solid angles' ratio, up to 1
    width: float


class Environment:
    """The world's program, its importance map and who may see it. every: sampled even where the world says NONE."""

    hidden: WorldSun | None = None  # what a lamp shines for instead: rays of the camera alone see it

    def __init__(self, world: World, every: bool = False):
        self.program: Program = compile_graph(world.graph, "background")
        self.visibility = world.visibility
        self.image_width = _image_width(world)
        self.warnings = list(self.program.warnings)
        self.constant = self.program.constant_emission
        self.black = not self.program.emissive or self.constant == (0.0, 0.0, 0.0)
        self.map = _no_map()
        if self.black or (world.sampling == "NONE" and not every):
            return
        if self.constant is not None:
            self.map = _no_map(UNIFORM, math.pi * abs(float(np.mean(self.constant))))
            return
        width = world.map_resolution if world.sampling == "MANUAL" else self.image_width
        self._weight = _texels(self.program, min(max(int(width), 4), _LARGEST_MAP))
        self._disc = _find_sun(world)
        self.map = _build_map(self._weight, *_sun_samples(self.program, self._disc))

    @cached_property
    def sun(self) -> WorldSun | None:
        """What a small disc of the world has beyond its surroundings, if all rays but the camera's see the same."""
        if self.map.mode != MAP or self.hidden is not None:
            return None
        kinds = [kind for kind in (DIFFUSE, GLOSSY, TRANSMISSION) if self.visibility & kind]
        disc = self._disc or bright_disc(self._weight, solid_angles(*self._weight.shape))
        if disc is None or not kinds:
            return None
        sun, *others = (measure(*disc, partial(self.radiance, visibility=kind)) for kind in (0, *kinds))
        if sun is None or any(o is None or not np.isclose(o.light.power, sun.light.power) for o in others):
            return None
        sun.light.visibility = self.visibility & ~CAMERA  # which sees the disc itself
        return sun

    def without_sun(self) -> Environment:
        """The same world, whose `sun` the camera alone sees."""
        other = copy.copy(self)
        other.hidden = sun = self.sun
        other.__dict__.pop("sun")
        other._weight = self._weight.copy()
        height, width = self._weight.shape
        for row in range(height):
            d = directions(np.full(width, row), np.arange(width), height, width)
            other._weight[row, sun.within(d, 2.0 * math.pi / width)] = np.abs(sun.rim).mean()
        other.map = _build_map(other._weight, np.zeros(5), 0.0)
        return other

    @property
    def unsampled(self) -> bool:
        """Whether it shines, but only rays that a BSDF chose can find it."""
        return self.map.mode == OFF and not self.black

    def uniform(self, visibility: int = 0) -> np.ndarray | None:
        """(3,) float32: the radiance where all directions have the same, else None; visibility as for `radiance`."""
        if self.black or (visibility and not visibility & self.visibility):
            return np.zeros(3, np.float32)
        return None if self.constant is None else np.asarray(self.constant, np.float32)

    def radiance(self, direction: np.ndarray, visibility: int = 0) -> np.ndarray:
        """(N, 3) float32 radiance in unit directions (N, 3), for rays of one visibility bit, or 0 for light samples."""
        uniform = self.uniform(visibility)
        if uniform is not None:
            return np.broadcast_to(uniform, (len(direction), 3)).copy()
        out = evaluate_background(self.program, direction, _RAY_KINDS.get(visibility, 0))
        if self.hidden is not None and visibility != CAMERA:
            out[self.hidden.within(direction)] = self.hidden.rim
        return np.nan_to_num(out, copy=False, nan=0.0, posinf=0.0, neginf=0.0)


def _no_map(mode: int = OFF, irradiance: float = 0.0, width: float = 1.0) -> WorldMap:
    """What needs no texels: nothing, or samples that all go by the cosine."""
    empty = np.zeros((1, 2), np.float32)
    rows, edges = np.array([0.0, 1.0]), np.array([-1.0, 1.0])
    return WorldMap(mode, rows, empty, edges, np.zeros(5), 1.0, irradiance, np.zeros(3), width)


def _image_width(world: World) -> int:
    """Width of the largest image that the world's graph reads; 1024 if there is none."""
    widths = [
        p.pixels.shape[1]
        for n in world.graph.nodes.values()
        for p in n.params.values()
        if hasattr(p, "pixels")
    ]
    return max(widths, default=1024)


def _find_sun(world: World) -> tuple[np.ndarray, float] | None:
    """Direction and half angle of the sun disc of the world's only sky, where nothing turns the sky."""
    skies = [n for n in world.graph.nodes.values() if n.kind == "sky_texture"]
    if len(skies) != 1 or isinstance(skies[0].inputs.get("vector"), Link):
        return None
    params = skies[0].params
    if not params.get("sun_disc", True) or params.get("sky_type") in ("PREETHAM", "HOSEK_WILKIE"):
        return None
    return sun_direction(params), 0.5 * max(float(params.get("sun_size", 0.009512)), 0.0005)


def _texels(program: Program, width: int) -> np.ndarray:
    """(width / 2, width) float32: radiance by which the world is sampled, the channels' mean."""
    height = max(width // 2, 2)
    weight = np.empty(height * width, np.float32)
    for first in range(0, len(weight), 65536):
        texel = np.arange(first, min(first + 65536, len(weight)))
        d = directions(*np.divmod(texel, width), height, width)
        radiance = np.abs(evaluate_background(program, d, 0)).mean(1)
        weight[texel] = np.nan_to_num(radiance, posinf=0.0)
    return weight.reshape(height, width)


def _sun_samples(program: Program, sun: tuple[np.ndarray, float] | None) -> tuple[np.ndarray, float]:
    """(WorldMap.sun, radiance of its disc) of a sky's sun: direction, half angle."""
    row = np.zeros(5)
    if sun is None or not sun[1] > 0.0:
        return row, 0.0
    row[:3], row[3], row[4] = sun[0], 2.0 * math.sin(0.5 * sun[1]) ** 2, _SUN_SHARE
    return row, float(np.abs(evaluate_background(program, sun[0][None, :], 0)).mean())


def _build_map(weight: np.ndarray, sun: np.ndarray, disc: float) -> WorldMap:
    """Importance map of texels of that radiance, or of none where the cosine samples the world better.

    A texel's density is uniform in solid angle. sun: WorldMap.sun; disc: radiance of the sun's disc.
    """
    height, width = weight.shape
    edges, solid_angle = row_borders(height), solid_angles(height, width)
    azimuth = (np.arange(width) + 0.5) * (2.0 * math.pi / width) - math.pi
    angle = (np.arange(height) + 0.5) * (math.pi / height)
    of_rows = np.diff(edges) / (2.0 * width)
    along = weight @ np.stack([np.cos(azimuth), np.sin(azimuth), np.ones(width)], 1)
    mean = float(of_rows @ along[:, 2])
    if not mean > 0.0:
        return _no_map()
    square = float(of_rows @ np.einsum("ij,ij->i", weight, weight, dtype=np.float64))
    towards = of_rows @ (along * np.stack([np.sin(angle), np.sin(angle), -np.cos(angle)], 1))
    of_sun = disc * sun[3] / 2.0
    mean, towards, square = mean + of_sun, towards + of_sun * sun[:3], square + disc * of_sun
    # of light that comes evenly from a part of all directions, the square of its mean over the mean of its square
    wide = min(math.sqrt(2.0 * mean * mean / square), 1.0)
    # spherical harmonics to the first order (Ramamoorthi and Hanrahan 2001)
    irradiance, towards = math.pi * mean, 2.0 * math.pi * towards
    radiance, weight = weight, _widened(weight)
    even = _even_share(radiance, weight, solid_angle, azimuth, angle)
    if even == 1.0:
        return _no_map(MAP, irradiance, wide)._replace(sun=sun, towards=towards)
    columns = np.zeros((height, width + 1), np.float32)
    total = np.cumsum(weight, axis=1, dtype=np.float64)
    row_weight = total[:, -1] * solid_angle
    total /= np.where(total[:, -1:] > 0.0, total[:, -1:], 1.0)
    columns[:, 1:] = total
    rows = np.concatenate([[0.0], np.cumsum(row_weight)])
    return WorldMap(MAP, rows / rows[-1], columns, edges, sun, even, irradiance, towards, wide)


def _even_share(radiance, weight, solid_angle, azimuth, angle) -> float:
    """Which of _EVEN gives the least variance of one sample, over surfaces that face along the axes.

    A sky that is nearly even is sampled best by the cosine at the surface: no sample falls behind it, and few where it
    receives little. Suns are not met that way. radiance, weight (H, W): of the texels, and by which they are sampled;
    solid_angle, angle (H,), azimuth (W,): theirs.
    """
    width = weight.shape[1]
    share = np.cumsum(weight * solid_angle[:, None], dtype=np.float64)  # over all texels, in one row
    at = np.searchsorted(share, (np.arange(_TRIALS) + 0.5) * (share[-1] / _TRIALS))
    row, column = np.divmod(np.minimum(at, weight.size - 1), width)
    density = weight[row, column] / share[-1]
    x, y = np.sin(angle[row]) * np.cos(azimuth[column]), np.sin(angle[row]) * np.sin(azimuth[column])
    d = np.stack([x, y, -np.cos(angle[row])], 1)
    cosine = np.maximum(np.concatenate([d, -d], 1), 1e-9)
    received = radiance[row, column][:, None] * cosine
    squares = [
        (received**2 / (density[:, None] * ((1.0 - e) * density[:, None] + e / math.pi * cosine))).sum()
        for e in _EVEN
    ]
    return _EVEN[int(np.argmin(squares))]


def _widened(weight: np.ndarray) -> np.ndarray:
    """No texel less than a quarter of its neighbours' mean: what is interpolated between texels can be sampled."""
    up = np.concatenate([weight[1:], weight[-1:]])
    down = np.concatenate([weight[:1], weight[:-1]])
    column = up + down + weight
    around = column + np.roll(column, 1, 1) + np.roll(column, -1, 1)
    return np.maximum(weight, around * np.float32(0.25 / 9.0))


@uncounted
def _row_of(borders, x):
    """Last i with borders[i] <= x, within the rows."""
    low, high = 0, len(borders) - 1
    while high - low > 1:
        middle = (low + high) >> 1
        if borders[middle] <= x:
            low = middle
        else:
            high = middle
    return low


@uncounted
def _column_of(columns, row, x):
    """Last i with columns[row, i] <= x, within the columns."""
    low, high = 0, columns.shape[1] - 1
    while high - low > 1:
        middle = (low + high) >> 1
        if columns[row, middle] <= x:
            low = middle
        else:
            high = middle
    return low


@uncounted
def _map_density(world, row, column):
    solid_angle = (world.edges[row + 1] - world.edges[row]) * (2.0 * math.pi / (world.columns.shape[1] - 1))
    share = world.rows[row + 1] - world.rows[row]
    return share * float(world.columns[row, column + 1] - world.columns[row, column]) / solid_angle


@uncounted
def _sun_offset(world, dx, dy, dz):
    """1 - cos of the angle to the sky's sun."""
    ex, ey, ez = dx - world.sun[0], dy - world.sun[1], dz - world.sun[2]
    return 0.5 * (ex * ex + ey * ey + ez * ez)


@uncounted
def _cosine_density(nx, ny, nz, transmissive, dx, dy, dz):
    """Density per solid angle of _cosine_sample."""
    c = nx * dx + ny * dy + nz * dz
    return abs(c) / (2.0 * math.pi) if transmissive else max(0.0, c) / math.pi


@uncounted
def _cosine_sample(nx, ny, nz, transmissive, u1, u2):
    """A direction by the cosine to the normal, on both sides of what transmits."""
    side = 1.0
    if transmissive:
        side = 1.0 if u1 < 0.5 else -1.0
        u1 = 2.0 * u1 if u1 < 0.5 else 2.0 * u1 - 1.0
    dx, dy, dz, _ = cosine_hemisphere(side * nx, side * ny, side * nz, u1, u2)
    return dx, dy, dz


@uncounted
def _texel_density(world, dx, dy, dz):
    width = world.columns.shape[1] - 1
    row = _row_of(world.edges, dz)
    column = min(width - 1, max(0, int((math.atan2(dy, dx) + math.pi) * (width / (2.0 * math.pi)))))
    return _map_density(world, row, column)


@uncounted
def density_by_texels(world, dx, dy, dz):
    """Density per solid angle with which the world's image and its sun choose the direction d, whatever they light."""
    if not world.even < 1.0:
        return 1.0 / (4.0 * math.pi)
    density = _texel_density(world, dx, dy, dz) * (1.0 - world.sun[4])
    if world.sun[4] > 0.0 and _sun_offset(world, dx, dy, dz) <= world.sun[3]:
        density += world.sun[4] / (2.0 * math.pi * world.sun[3])
    return density


@uncounted
def world_density(world, nx, ny, nz, transmissive, dx, dy, dz):
    """Density per solid angle with which `sample_world` chooses the direction d."""
    if world.mode == OFF:
        return 0.0
    transmissive = transmissive and world.mode != ABOVE
    density = _texel_density(world, dx, dy, dz) if world.even < 1.0 else 0.0
    density += world.even * (_cosine_density(nx, ny, nz, transmissive, dx, dy, dz) - density)
    density *= 1.0 - world.sun[4]
    if world.sun[4] > 0.0 and _sun_offset(world, dx, dy, dz) <= world.sun[3]:
        density += world.sun[4] / (2.0 * math.pi * world.sun[3])
    return density


@uncounted
def sample_world(world, nx, ny, nz, transmissive, u1, u2):
    """Choose a direction to the world: (dx, dy, dz, density). n: the unit normal of the surface that is lit."""
    transmissive = transmissive and world.mode != ABOVE
    share = world.sun[4]
    if u1 < share:
        dx, dy, dz, _ = uniform_cone(world.sun[0], world.sun[1], world.sun[2], world.sun[3], u1 / share, u2)
        return dx, dy, dz, world_density(world, nx, ny, nz, transmissive, dx, dy, dz)
    u1 = (u1 - share) / (1.0 - share)
    if u1 < world.even or world.even == 1.0:
        dx, dy, dz = _cosine_sample(nx, ny, nz, transmissive, u1 / world.even, u2)
        return dx, dy, dz, world_density(world, nx, ny, nz, transmissive, dx, dy, dz)
    u1 = (u1 - world.even) / (1.0 - world.even)
    width = world.columns.shape[1] - 1
    row = _row_of(world.rows, u2)
    start = world.rows[row]
    z = world.edges[row] + (u2 - start) / (world.rows[row + 1] - start) * (
        world.edges[row + 1] - world.edges[row]
    )
    column = _column_of(world.columns, row, u1)
    left = float(world.columns[row, column])
    step = float(world.columns[row, column + 1]) - left
    if not step > 0.0:
        return 0.0, 0.0, 1.0, 0.0
    phi = (column + min(1.0, max(0.0, (u1 - left) / step))) * (2.0 * math.pi / width) - math.pi
    r = math.sqrt(max(0.0, 1.0 - z * z))
    dx, dy = r * math.cos(phi), r * math.sin(phi)
    if share == 0.0 and world.even == 0.0:
        return dx, dy, z, _map_density(world, row, column)
    return dx, dy, z, world_density(world, nx, ny, nz, transmissive, dx, dy, z)
