"""Skies by closed formulas of the angles to zenith and sun: Preetham's, and Hosek and Wilkie's.

Preetham et al., "A practical analytic model for daylight" (1999); Hosek and Wilkie, "An analytic model for full
spectral sky-dome radiance" (2012). Colours are XYZ.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

# ---- Preetham


def _perez(c: np.ndarray, theta: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    ct, cg = np.cos(theta), np.cos(gamma)
    return (1 + c[0] * np.exp(c[1] / ct)) * (1 + c[2] * np.exp(c[3] * gamma) + c[4] * cg * cg)


def preetham(sun_theta: float, turbidity: float, theta: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """(n, 3) XYZ at angles theta from the zenith and gamma from the sun."""
    t, s = turbidity, min(max(sun_theta, 0.0), np.pi / 2)
    coefficients = {
        "Y": (
            (0.17872, -1.46303),
            (-0.35540, 0.42749),
            (-0.02266, 5.32505),
            (0.12064, -2.57705),
            (-0.06696, 0.37027),
        ),
        "x": (
            (-0.01925, -0.25922),
            (-0.06651, 0.00081),
            (-0.00041, 0.21247),
            (-0.06409, -0.89887),
            (-0.00325, 0.04517),
        ),
        "y": (
            (-0.01669, -0.26078),
            (-0.09495, 0.00921),
            (-0.00792, 0.21023),
            (-0.04405, -1.65369),
            (-0.01092, 0.05291),
        ),
    }
    powers = np.array([s**3, s**2, s, 1.0])
    turbidities = np.array([t * t, t, 1.0])
    x_zenith = [
        [0.00166, -0.00375, 0.00209, 0.0],
        [-0.02903, 0.06377, -0.03202, 0.00394],
        [0.11693, -0.21196, 0.06052, 0.25886],
    ]
    y_zenith = [
        [0.00275, -0.00610, 0.00317, 0.0],
        [-0.04214, 0.08970, -0.04153, 0.00516],
        [0.15346, -0.26756, 0.06670, 0.26688],
    ]
    chi = (4 / 9 - t / 120) * (np.pi - 2 * s)
    zenith = {
        "Y": 0.06 * ((4.0453 * t - 4.9710) * np.tan(chi) - 0.2155 * t + 2.4192),
        "x": turbidities @ np.array(x_zenith) @ powers,
        "y": turbidities @ np.array(y_zenith) @ powers,
    }
    theta = np.minimum(theta, np.pi / 2 - 0.001)
    found = {}
    for name, lines in coefficients.items():
        c = np.array([slope * t + base for slope, base in lines])
        found[name] = zenith[name] * _perez(c, theta, gamma) / _perez(c, np.float64(0), np.float64(s))
    big = found["Y"] / np.where(found["y"] != 0, found["y"], 1)
    return np.stack([found["x"] * big, found["Y"], (1 - found["x"] - found["y"]) * big], -1)


# ---- Hosek and Wilkie


def hosek_factors(p: np.ndarray, theta: np.ndarray, gamma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The formula's factor (n,) that depends on theta alone, and the five terms (n, 5) that it multiplies.

    p: A, B of the first; E, H of the terms' exponential and Mie lobes.
    """
    cosine, g, h = np.cos(theta), np.cos(gamma), p[3]
    horizon = 1 + p[0] * np.exp(p[1] / (cosine + 0.01))
    mie = (1 + g * g) / (1 + h * h - 2 * h * g) ** 1.5
    terms = (np.ones_like(g), np.exp(p[2] * gamma), g * g, mie, np.sqrt(np.maximum(cosine, 0)))
    return horizon, np.stack(terms, -1)


@lru_cache(maxsize=1)
def _hosek_table() -> dict[str, np.ndarray]:
    with np.load(Path(__file__).with_name("hosek_sky.npz")) as data:
        return {name: data[name].astype(np.float64) for name in data.files}


def _bracket(nodes: np.ndarray, value: float) -> list[tuple[int, float]]:
    """Indices around a value, with weights."""
    at = float(np.interp(value, nodes, np.arange(len(nodes))))
    i = min(int(at), len(nodes) - 2)
    return [(k, w) for k, w in ((i, 1 - (at - i)), (i + 1, at - i)) if w > 0]


def hosek(
    elevation: float, turbidity: float, albedo: float, theta: np.ndarray, gamma: np.ndarray
) -> np.ndarray:
    """(n, 3) XYZ of Hosek and Wilkie's sky at angles theta from the zenith and gamma from the sun.

    Their formula, with coefficients measured on a grid (benchmarks/measure_hosek_sky.py); skies between are blended.
    """
    data = _hosek_table()
    theta = np.minimum(theta, np.pi / 2 - 0.001)
    total = np.zeros((len(theta), 3))
    for i, u in _bracket(data["turbidities"], turbidity):
        for j, v in _bracket(data["albedos"], albedo):
            for k, w in _bracket(data["elevations"] ** (1 / 3), max(elevation, 0.0) ** (1 / 3)):
                for c in range(3):
                    p = data["coefficients"][i, j, k, c]
                    horizon, terms = hosek_factors(p[:4], theta, gamma)
                    total[:, c] += u * v * w * horizon * (terms @ p[4:])
    return np.maximum(total, 0)
