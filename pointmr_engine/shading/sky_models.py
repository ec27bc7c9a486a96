"""Skies by scattering: radiance over directions, and the sun's disc, for Blender's Sky Texture.

single_scattering: Nishita et al., "Display of the Earth taking into account atmospheric scattering" (1993), 21
wavelengths, with an ozone layer. multiple_scattering: Garcia Linan, "Spectral sky" (fgarlin.com, 2024), 4 wavelengths,
higher orders by a fit.
Colours are XYZ in W/(m^2 sr), z is up, and the sun stands over +x or -x as each model says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointmr_engine.shading.spectra import observer

WIDTH, HEIGHT = 512, 256  # of a sky's table


@dataclass(frozen=True)
class Atmosphere:
    """altitude in metres; densities relative to a clean, clear day; sun_elevation in radians."""

    sun_elevation: float
    altitude: float = 100.0
    air: float = 1.0
    aerosol: float = 1.0
    ozone: float = 1.0


def _sphere_exit(height: np.ndarray, cosine: np.ndarray, radius: float) -> np.ndarray:
    """Distance to a sphere from a point inside it, `height` from its centre, along a ray at `cosine` to the zenith."""
    b = height * cosine
    return -b + np.sqrt(np.maximum(b * b - height * height + radius * radius, 0))


# ---- single scattering, lengths in metres
_RADIUS, _TOP = 6360e3, 6420e3
_AIR_SCALE, _AEROSOL_SCALE = 8000.0, 1200.0
_AEROSOL, _G = 2e-5, 0.76
_STEPS = 32
# 380 to 780 nm in steps of 20: the sun's irradiance in W/(m^2 nm), scattering by air and absorption by ozone in 1/m
_IRRADIANCE = np.array(
    "1.457568 1.565963 1.651485 1.714962 1.757980 1.782564 1.790951 1.785416 1.768156 1.741221 1.706471 "
    "1.665561 1.619934 1.570836 1.519323 1.466285 1.412459 1.358450 1.304749 1.251750 1.199760".split(),
    np.float64,
)
_RAYLEIGH = 1e-6 * np.array(
    "54.24820 44.18550 36.35152 30.17929 25.26320 21.30859 18.09838 15.47057 13.30285 11.50185 9.995574 "
    "8.728000 7.655137 6.742172 5.961341 5.290346 4.711157 4.209105 3.772184 3.390513 3.055915".split(),
    np.float64,
)
_OZONE = 1e-9 * np.array(
    "3.251268 5.853954 19.77191 73.09569 200.8456 403.8396 635.5134 967.0704 1547.974 2090.386 2461.281 "
    "2735.513 2151.259 1590.518 1123.562 735.2755 464.5013 330.9608 225.1261 148.7913 168.2862".split(),
    np.float64,
)


def _densities(height: np.ndarray) -> np.ndarray:
    """(..., 3) relative densities of air, aerosols and ozone at heights above the ground."""
    ozone = np.maximum(1 - np.abs(height - 25000) / 15000, 0)
    return np.stack([np.exp(-height / _AIR_SCALE), np.exp(-height / _AEROSOL_SCALE), ozone], -1)


def _quadrature() -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Laguerre nodes and weights for functions that fall off along a ray, over its length."""
    nodes, weights = np.polynomial.laguerre.laggauss(8)
    end = 25.0
    return nodes / end, weights * np.exp(nodes) / end


def _optical_depth(height: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """(..., 3) densities integrated from `height` (from the Earth's centre) to the top of the atmosphere."""
    length = _sphere_exit(height, cosine, _TOP)
    total = np.zeros((*np.broadcast(height, cosine).shape, 3))
    for node, weight in zip(*_quadrature(), strict=True):
        t = length * node
        there = np.sqrt(height * height + 2 * height * cosine * t + t * t)
        total += _densities(there - _RADIUS) * weight
    return total * length[..., None]


def _extinction() -> np.ndarray:
    """(3, 21) of each component; aerosols absorb a tenth more than they scatter."""
    return np.stack([_RAYLEIGH, np.full(21, 1.11 * _AEROSOL), _OZONE])


def _spectrum_to_xyz(spectrum: np.ndarray) -> np.ndarray:
    return spectrum @ observer()[::4] * 20.0


# A sky's table depends smoothly on azimuth once the phase functions are taken out of it: so few columns are marched.
_COLUMNS = 33


def _rays(elevation: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """(rows * columns, 3) unit vectors."""
    el, az = (v.ravel() for v in np.meshgrid(elevation, azimuth, indexing="ij"))
    return np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], -1)


def _spread(marched: np.ndarray, coarse: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """(rows, len(coarse), k) resampled along azimuth, to (rows, len(fine), k)."""
    at = np.interp(fine, coarse, np.arange(len(coarse)))
    i = np.clip(at.astype(np.int64), 0, len(coarse) - 2)
    f = (at - i)[None, :, None]
    # Catmull-Rom, mirrored at both ends as the sky is
    get = [marched[:, np.abs(len(coarse) - 1 - np.abs(len(coarse) - 1 - (i + k)))] for k in (-1, 0, 1, 2)]
    a, b, c, d = get
    return b + 0.5 * f * (c - a + f * (2 * a - 5 * b + 4 * c - d + f * (3 * (b - c) + d - a)))


def _rayleigh_phase(mu: np.ndarray) -> np.ndarray:
    return 3 / (16 * np.pi) * (1 + mu * mu)


def single_scattering(a: Atmosphere) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) XYZ of the sky. Rows are denser toward the horizon, which is the middle one."""
    half = HEIGHT // 2
    rows = np.arange(half, HEIGHT)
    latitude = np.pi / 2 * (rows / half - 1.0) ** 2
    longitude = np.arange(WIDTH // 2) * (2 * np.pi / WIDTH) - np.pi
    coarse = np.linspace(-np.pi, 0, _COLUMNS)
    ray = _rays(latitude, coarse)
    sun = np.array([np.cos(a.sun_elevation), 0.0, np.sin(a.sun_elevation)])
    start = _RADIUS + np.clip(a.altitude, 1, 59999)
    step = _sphere_exit(np.float64(start), ray[:, 2], _TOP) / _STEPS
    scale = np.array([a.air, a.aerosol, a.ozone])
    extinction = _extinction()
    depth = np.zeros((len(ray), 3))
    by_air, by_aerosol = np.zeros((len(ray), 21)), np.zeros((len(ray), 21))
    for i in range(_STEPS):
        point = ray * ((i + 0.5) * step)[:, None]
        point[:, 2] += start
        radius = np.sqrt((point * point).sum(1))
        density = _densities(radius - _RADIUS) * scale
        depth += density * step[:, None]
        cosine = point @ sun / radius
        light = np.exp(-(depth + scale * _optical_depth(radius, cosine)) @ extinction)
        below = (sun[2] < 0) & (radius * np.sqrt(np.maximum(1 - cosine**2, 0)) <= _RADIUS)
        light[below] = 0
        light *= step[:, None]
        by_air += light * density[:, :1]
        by_aerosol += light * density[:, 1:2]
    xyz = np.concatenate([_spectrum_to_xyz(by_air * _RAYLEIGH * _IRRADIANCE),
                          _spectrum_to_xyz(by_aerosol * _AEROSOL * _IRRADIANCE)], 1)  # fmt: skip
    xyz = _spread(xyz.reshape(len(rows), _COLUMNS, 6), coarse, longitude)
    mu = (_rays(latitude, longitude) @ sun).reshape(len(rows), -1, 1)
    g2 = _G * _G
    mie = 3 * (1 - g2) * (1 + mu * mu) / (8 * np.pi * (2 + g2) * (1 + g2 - 2 * _G * mu) ** 1.5)
    sky = xyz[..., :3] * _rayleigh_phase(mu) + xyz[..., 3:] * mie
    table = np.empty((HEIGHT, WIDTH, 3))
    table[rows, : WIDTH // 2] = sky
    table[rows, WIDTH // 2 :] = sky[:, ::-1]
    # no ground is modelled: the horizon's colour fades out below it
    depth_below = np.sin(np.pi / 2 * (np.arange(half) / half - 1.0) ** 2)
    fade = np.maximum(1 - 2.5 * depth_below, 0) ** 3
    table[:half] = table[half] * fade[:, None, None]
    return table


def single_scattering_sun(a: Atmosphere, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """XYZ of the lowest and the highest point of a sun disc of full angle `angle`."""
    height = np.array([_RADIUS + np.clip(a.altitude, 1, 59999)])

    def radiance(elevation: float) -> np.ndarray:
        depth = _optical_depth(height, np.array([np.sin(max(elevation, 0.0))]))[0]
        depth = depth * np.array([a.air, a.aerosol, 0.0])
        return _spectrum_to_xyz(_IRRADIANCE * np.exp(-depth @ _extinction()) / _solid_angle(angle))

    low, high = a.sun_elevation - angle / 2, a.sun_elevation + angle / 2
    black = np.zeros(3)
    return radiance(low) if low > 0 else black, radiance(high) if high > 0 else black


def _solid_angle(angle: float) -> float:
    return 2 * np.pi * (1 - np.cos(angle / 2))


# ---- multiple scattering, lengths in kilometres, at 630, 560, 490 and 430 nm
_EARTH, _THICKNESS = 6371.0, 100.0
_MARCH = 64
_SUN = np.array([1.679, 1.828, 1.986, 1.307])
_AIR_SCATTERING = np.array([6.605e-3, 1.067e-2, 1.842e-2, 3.156e-2])
_OZONE_ABSORPTION = 334.5 * np.array([3.472e-25, 3.914e-25, 1.349e-25, 11.03e-27])
_AEROSOL_ABSORPTION = np.array([2.8722e-24, 4.6168e-24, 7.9706e-24, 1.3578e-23])
_AEROSOL_SCATTERING = np.array([1.5908e-22, 1.7711e-22, 2.0942e-22, 2.4033e-22])
_XYZ = np.array(
    [
        [53.3869177, 22.9813375, 0.0],
        [43.9048445, 71.3477957, 0.1025069],
        [1.6137278, 18.4229606, 31.7429212],
        [20.7626687, 2.3614214, 110.4800964],
    ]
)


class _Air:
    """The atmosphere of one day: what it scatters and absorbs at a height, and its transmittance toward the sun."""

    COSINES, HEIGHTS = 256, 64

    def __init__(self, a: Atmosphere) -> None:
        self.a = a
        # extinction of a unit of air, aerosols and ozone
        self._extinction = np.stack(
            [_AIR_SCATTERING, _AEROSOL_SCATTERING + _AEROSOL_ABSORPTION, _OZONE_ABSORPTION]
        )
        self._table: np.ndarray | None = None

    def densities(self, height: np.ndarray) -> np.ndarray:
        """(..., 3) of air, aerosols and ozone at heights in km."""
        h = np.maximum(height, 0)
        log_height = np.log(np.maximum(h, 1e-4))
        return np.stack(
            [
                np.exp(-0.07771971 * h**1.16364243) * self.a.air,
                (1.3681e20 * np.exp(-h / 0.73) + 2e6) * self.a.aerosol,
                3.78547397e20
                * np.exp(-((log_height - 3.22261) ** 2) * 5.55555555 - log_height)
                * self.a.ozone,
            ],
            -1,
        )

    def extinction(self, densities: np.ndarray) -> np.ndarray:
        """(..., 4) per km."""
        return densities @ self._extinction

    def transmittance(self, cosine: np.ndarray, height: np.ndarray) -> np.ndarray:
        """(..., 4) from a height to the top, at `cosine` to the zenith; the Earth does not stand in the way."""
        start = _EARTH + height
        step = _sphere_exit(start, cosine, _EARTH + _THICKNESS) / _MARCH
        depth = np.zeros((*np.broadcast(cosine, height).shape, 3))
        for i in range(_MARCH):
            t = (i + 0.5) * step
            radius = np.sqrt(start * start + 2 * start * cosine * t + t * t)
            depth += self.densities(radius - _EARTH) * step[..., None]
        return np.exp(-self.extinction(depth))

    def look_up(self, cosine: np.ndarray, height: np.ndarray) -> np.ndarray:
        """`transmittance` (n, 4) from a table made at first, bilinear."""
        if self._table is None:
            c, h = (
                np.linspace(-1, 1, self.COSINES)[None, :],
                np.linspace(0, _THICKNESS, self.HEIGHTS)[:, None],
            )
            self._table = self.transmittance(c, h)
        x = np.clip(cosine * 0.5 + 0.5, 0, 1) * (self.COSINES - 1)
        y = np.clip(height / _THICKNESS, 0, 1) * (self.HEIGHTS - 1)
        i, j = (
            np.minimum(x.astype(np.int64), self.COSINES - 2),
            np.minimum(y.astype(np.int64), self.HEIGHTS - 2),
        )
        fx, fy = (x - i)[..., None], (y - j)[..., None]
        t = self._table
        low = t[j, i] * (1 - fx) + t[j, i + 1] * fx
        return low * (1 - fy) + (t[j + 1, i] * (1 - fx) + t[j + 1, i + 1] * fx) * fy

    def ambient(self, cosine: np.ndarray, height: np.ndarray) -> np.ndarray:
        """(n, 4) light of higher orders that reaches a point: a fit for the air, and the sunlit ground below."""
        radius = _EARTH + height
        ground_angle = 2 * np.pi * (1 - np.sqrt(1 - (_EARTH / radius) ** 2))
        zenith, level = np.ones_like(cosine), np.zeros_like(height)
        to_ground = self.look_up(zenith, level) / self.look_up(zenith, height)
        lit = self.look_up(cosine, level) * cosine[..., None]
        ground = ground_angle[..., None] / (4 * np.pi) * (0.3 / np.pi) * lit * to_ground
        air = 0.02 * np.array([0.217, 0.347, 0.594, 1.0]) / (1 + 5 * np.exp(-17.92 * cosine))[..., None]
        return air + ground


def multiple_scattering(a: Atmosphere) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) XYZ of the sky and, below the horizon, of the air in front of the ground.

    Rows are denser toward the horizon.
    """
    air = _Air(a)
    y = (np.arange(HEIGHT) + 0.5) / HEIGHT * 2 - 1
    elevation = np.copysign(y * y, y) * (np.pi / 2)
    azimuth = 2 * np.pi * (np.arange(WIDTH // 2) + 0.5) / WIDTH
    coarse = np.linspace(0, np.pi, _COLUMNS)
    ray = _rays(elevation, coarse)
    sun = np.array([-np.cos(a.sun_elevation), 0.0, np.sin(a.sun_elevation)])
    start = _EARTH + np.clip(a.altitude, 1, 99999) / 1000
    length = _sphere_exit(np.float64(start), ray[:, 2], _EARTH + _THICKNESS)
    b = start * ray[:, 2]
    inside = b * b - start * start + _EARTH * _EARTH
    length = np.where((b < 0) & (inside >= 0), -b - np.sqrt(np.maximum(inside, 0)), length)
    step = length / _MARCH
    through = np.ones((len(ray), 4))
    # light scattered by air, by aerosols, and once more by either; the phase functions come later
    parts = np.zeros((3, len(ray), 4))
    for i in range(_MARCH):
        point = ray * ((i + 0.5) * step)[:, None]
        point[:, 2] += start
        radius = np.sqrt((point * point).sum(1))
        height = np.maximum(radius - _EARTH, 0)
        cosine = point @ sun / radius
        densities = air.densities(height)
        extinction = air.extinction(densities)
        passed = np.exp(-extinction * step[:, None])
        share = through * (1 - passed) / np.maximum(extinction, 1e-7)
        direct = share * air.look_up(cosine, height)
        by_air, by_aerosol = densities[:, :1] * _AIR_SCATTERING, densities[:, 1:2] * _AEROSOL_SCATTERING
        parts[0] += by_air * direct
        parts[1] += by_aerosol * direct
        parts[2] += (by_air + by_aerosol) * share * air.ambient(cosine, height)
        through *= passed
    xyz = np.concatenate(list((parts * _SUN) @ _XYZ), 1).reshape(HEIGHT, _COLUMNS, 9)
    xyz = _spread(xyz, coarse, azimuth)
    mu = (_rays(elevation, azimuth) @ sun).reshape(HEIGHT, -1, 1)
    g = 0.8
    mie = (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * mu) ** 1.5)
    half = xyz[..., :3] * _rayleigh_phase(mu) + xyz[..., 3:6] * mie + xyz[..., 6:]
    return np.concatenate([half, half[:, ::-1]], 1)


def multiple_scattering_sun(a: Atmosphere, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """XYZ of the lowest and the highest point of a sun disc of full angle `angle`."""
    air = _Air(a)
    height = np.array([np.clip(a.altitude, 1, 99999) / 1000])

    def radiance(elevation: float) -> np.ndarray:
        through = air.transmittance(np.array([np.sin(elevation)]), height)[0]
        return _SUN * through / _solid_angle(angle) @ _XYZ

    return radiance(a.sun_elevation - angle / 2), radiance(a.sun_elevation + angle / 2)


def horizon_dip(altitude: float) -> float:
    """Angle below the horizontal at which the ground begins, seen from `altitude` metres."""
    return float(np.pi / 2 - np.arcsin(_EARTH / (_EARTH + altitude / 1000)))
