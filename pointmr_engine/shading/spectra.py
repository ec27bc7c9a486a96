"""Colours of spectra: single wavelengths and blackbodies, in scene-linear Rec.709."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

# CIE 1931 standard observer (2 degrees), 380 to 780 nm in steps of 5 nm, in ten-thousandths
_X = """
14 22 42 76 143 232 435 776 1344 2148 2839 3285 3483 3481 3362 3187 2908 2511 1954 1421 956 580 320
147 49 24 93 291 633 1096 1655 2257 2904 3597 4334 5121 5945 6784 7621 8425 9163 9786 10263 10567
10622 10456 10026 9384 8544 7514 6424 5419 4479 3608 2835 2187 1649 1212 874 636 468 329 227 158 114
81 58 41 29 20 14 10 7 5 3 2 2 1 1 1 0
"""
_Y = """
0 1 1 2 4 6 12 22 40 73 116 168 230 298 380 480 600 739 910 1126 1390 1693 2080 2586 3230 4073 5030
6082 7100 7932 8620 9149 9540 9803 9950 10000 9950 9786 9520 9154 8700 8163 7570 6949 6310 5668 5030
4412 3810 3210 2650 2170 1750 1382 1070 816 610 446 320 232 170 119 82 57 41 29 21 15 10 7 5 4 2 2 1
1 1 0 0 0 0
"""
_Z = """
65 105 201 362 679 1102 2074 3713 6456 10391 13856 16230 17471 17826 17721 17441 16692 15281 12876
10419 8130 6162 4652 3533 2720 2123 1582 1117 782 573 422 298 203 134 87 57 39 27 21 18 17 14 11 10
8 6 3 2 2 1 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0
"""

RGB_FROM_XYZ = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)
_COLDEST, _HOTTEST = 800.0, 12000.0


@lru_cache(maxsize=1)
def observer() -> np.ndarray:
    """(81, 3) colour matching functions at 380, 385, ... 780 nm."""
    return np.array([[int(v) for v in t.split()] for t in (_X, _Y, _Z)], np.float64).T / 1e4


def wavelength_xyz(nanometres: np.ndarray) -> np.ndarray:
    """(n, 3) XYZ of single wavelengths; 0 outside 380..780 nm."""
    t = (np.asarray(nanometres, np.float64) - 380) / 5
    i = np.clip(np.floor(t), 0, 79).astype(np.int64)
    table = observer()
    f = (t - i)[:, None]
    return np.where(((t > -1) & (t < 80))[:, None], table[i] * (1 - f) + table[i + 1] * f, 0)


@lru_cache(maxsize=1)
def _blackbody_table() -> tuple[np.ndarray, np.ndarray]:
    temperatures = np.geomspace(_COLDEST, _HOTTEST, 512)
    metres = np.arange(380, 781, 5) * 1e-9
    hc_over_k = 1.438777e-2
    # radiance up to a factor; relative to one wavelength so that cold bodies do not underflow
    exponent = hc_over_k / temperatures[:, None] * (1 / metres - 1 / metres[-1])
    power = metres**-5 * np.exp(-exponent) / (1 - np.exp(-hc_over_k / (metres * temperatures[:, None])))
    xyz = power @ observer()
    return np.log(temperatures), (xyz / xyz[:, 1:2]) @ RGB_FROM_XYZ.T


def blackbody_rgb(kelvin: np.ndarray) -> np.ndarray:
    """(n, 3) colour of blackbodies at unit luminance; temperatures are clamped to 800..12000 K. May be negative."""
    logs, colors = _blackbody_table()
    t = np.log(np.clip(np.atleast_1d(np.asarray(kelvin, np.float64)), _COLDEST, _HOTTEST))
    return np.stack([np.interp(t, logs, colors[:, k]) for k in range(3)], 1)
