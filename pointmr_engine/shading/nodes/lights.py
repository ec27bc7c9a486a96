"""Nodes of lamps: Light Falloff and IES profiles."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading.nodes.registry import FLOAT, VECTOR, Call, From, node
from pointmr_engine.shading.values import normalize

_FAR = 1e30


@node(
    "light_falloff",
    {"strength": (FLOAT, 100.0), "smooth": (FLOAT, 0.0)},
    {"quadratic": FLOAT, "linear": FLOAT, "constant": FLOAT},
    reads=lambda params, wanted: ("ray_length",),
)
def _light_falloff(c: Call) -> dict[str, np.ndarray]:
    """Strengths that cancel the inverse-square law partly; suns, infinitely far, keep theirs."""
    r = c.points.ray_length
    far = r >= _FAR
    r = np.where(far, 1, r).astype(np.float32)
    smooth = np.maximum(c["smooth"], 0)
    damp = np.where((smooth > 0) & ~far, r * r / (smooth + r * r), 1)
    base = c["strength"] * damp
    return {"quadratic": base, "linear": base * r, "constant": base * r * r}


class PhotometricWeb:
    """Intensities over angles: vertical (v,) and horizontal (h,) in radians, values (h, v)."""

    def __init__(self, vertical: np.ndarray, horizontal: np.ndarray, values: np.ndarray) -> None:
        self.vertical = np.asarray(vertical, np.float64)
        self.horizontal = np.asarray(horizontal, np.float64)
        self.values = np.asarray(values, np.float64)
        full = self.horizontal[0] < 1e-7 and self.horizontal[-1] > 2 * np.pi - 1e-7
        low, high = self.vertical[0] < 1e-7, self.vertical[-1] > np.pi - 1e-7
        # one more row on every side, so that cubics have four values everywhere
        rows = [self.values[-2] if full else self.values[0], *self.values]
        rows.append(self.values[1] if full else self.values[0])
        grid = np.array(rows)
        first = grid[:, 1] if low else grid[:, 0]
        last = grid[:, -2] if high else grid[:, -1]
        self._grid = np.concatenate([first[:, None], grid, last[:, None]], 1)

    def look_up(self, horizontal: np.ndarray, vertical: np.ndarray) -> np.ndarray:
        """Intensities (n,) by Catmull-Rom cubics; 0 outside the measured angles."""
        h, v = self.horizontal, self.vertical
        inside = (vertical >= v[0]) & (vertical < v[-1]) & (horizontal >= h[0]) & (horizontal < h[-1])
        i = np.clip(np.searchsorted(h, horizontal, "left") - 1, 0, len(h) - 2)
        j = np.clip(np.searchsorted(v, vertical, "left") - 1, 0, len(v) - 2)
        s, t = (horizontal - h[i]) / (h[i + 1] - h[i]), (vertical - v[j]) / (v[j + 1] - v[j])
        across = [_cubic(*(self._grid[i + k, j + m] for m in range(4)), t) for k in range(4)]
        return np.where(inside, np.maximum(_cubic(*across, s), 0), 0)


def _cubic(a, b, c, d, t):
    return 0.5 * (((d + 3 * (b - c) - a) * t + (2 * a - 5 * b + 4 * c - d)) * t + (c - a)) * t + b


def parse_ies(text: str) -> PhotometricWeb:
    """Read an IES LM-63 file (TILT=NONE or INCLUDE, type C). Raises ValueError for anything else."""
    head, marker, rest = text.partition("TILT=")
    if not marker:
        raise ValueError("no TILT line: not an IES file")
    lines = rest.splitlines()
    numbers = " ".join(lines[1:]).replace(",", " ").split()
    values = np.array([float(n) for n in numbers])
    at = 0
    if lines[0].strip().upper() == "INCLUDE":
        at = 2 + 2 * int(values[1])
    multiplier, n_vertical, n_horizontal, kind = (
        values[at + 2],
        int(values[at + 3]),
        int(values[at + 4]),
        values[at + 5],
    )
    ballast = values[at + 10] * values[at + 11]
    if kind != 1:
        raise ValueError("only type C photometry is supported")
    at += 13
    vertical = values[at : at + n_vertical]
    horizontal = values[at + n_vertical : at + n_vertical + n_horizontal]
    at += n_vertical + n_horizontal
    candela = values[at : at + n_vertical * n_horizontal].reshape(n_horizontal, n_vertical)
    candela = candela * (multiplier * ballast)
    horizontal, candela = _unfold(horizontal - horizontal[0], candela)
    # candela to the strengths of Cycles: 4 pi / 177.83 lm/W
    return PhotometricWeb(np.radians(vertical), np.radians(horizontal), candela * (4 * np.pi / 177.83))


def _unfold(angles: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All of 0 to 360 degrees from the part that a symmetric lamp's file gives."""
    if len(angles) == 1:
        return np.array([0.0, 360.0]), np.repeat(values, 2, axis=0)
    while angles[-1] in (90.0, 180.0):
        end = 2 * angles[-1]
        angles = np.concatenate([angles, end - angles[-2::-1]])
        values = np.concatenate([values, values[-2::-1]])
    return angles, values


def _prepare(params: dict) -> dict:
    if "web" in params or not params.get("ies"):
        return params
    try:
        return {**params, "web": parse_ies(params["ies"])}
    except (ValueError, IndexError):
        return params


@node(
    "ies_texture",
    {"vector": (VECTOR, From("object_incoming")), "strength": (FLOAT, 1.0)},
    {"fac": FLOAT},
    prepare=_prepare,
)
def _ies_texture(c: Call) -> np.ndarray:
    """params: ies, the text of the file. Directions point from the lamp; straight down is the vertical angle 0."""
    web = c.params.get("web")
    if web is None:
        return c["strength"] * 100
    d = normalize(c["vector"])
    vertical = np.arccos(np.clip(-d[:, 2], -1, 1))
    horizontal = np.arctan2(d[:, 0], d[:, 1]) + np.pi
    return c["strength"] * web.look_up(horizontal, vertical)
