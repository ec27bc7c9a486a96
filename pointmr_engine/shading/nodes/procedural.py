"""Checker, Gradient, Brick, Magic and Wave textures."""

from __future__ import annotations

import numpy as np

from pointmr_engine.shading.nodes.registry import COLOR, FLOAT, VECTOR, Call, From, node
from pointmr_engine.shading.values import choose, length, saturate

_GENERATED = (VECTOR, From("generated"))
_TWO_PI = np.float32(2 * np.pi)


def _grey(values: np.ndarray) -> dict[str, np.ndarray]:
    return {"fac": values, "color": np.repeat(values[:, None], 3, axis=1)}


@node(
    "checker_texture",
    {"vector": _GENERATED, "color1": (COLOR, 0.8), "color2": (COLOR, 0.2), "scale": (FLOAT, 5.0)},
    {"color": COLOR, "fac": FLOAT},
    fine=True,
)
def _checker(c: Call) -> dict[str, np.ndarray]:
    half = np.zeros(1)  # of the squares' numbers; axis by axis, for NumPy is slow along three
    for axis in range(3):
        # nudged, so that coordinates on the very edge of a square fall to one side
        place = c["vector"][:, axis] * c["scale"] + np.float32(0.000001)
        half = half + 0.5 * np.floor(place * np.float32(0.999999))
    first = half != np.floor(half)
    return {"color": choose(first, c["color1"], c["color2"]), "fac": first.astype(np.float32)}


@node("gradient_texture", {"vector": _GENERATED}, {"color": COLOR, "fac": FLOAT})
def _gradient(c: Call) -> dict[str, np.ndarray]:
    """params: type "LINEAR", "QUADRATIC", "EASING", "DIAGONAL", "RADIAL", "SPHERICAL", "QUADRATIC_SPHERE"."""
    kind, v = c.params.get("type", "LINEAR"), c["vector"]
    x, y = v[:, 0], v[:, 1]
    if kind == "QUADRATIC":
        f = np.maximum(x, 0) ** 2
    elif kind == "EASING":
        r = np.clip(x, 0, 1)
        f = r * r * (3 - 2 * r)
    elif kind == "DIAGONAL":
        f = (x + y) / 2
    elif kind == "RADIAL":
        f = np.arctan2(y, x) / _TWO_PI + np.float32(0.5)
    elif kind in ("SPHERICAL", "QUADRATIC_SPHERE"):
        f = np.maximum(np.float32(0.999999) - length(v), 0)
        f = f * f if kind == "QUADRATIC_SPHERE" else f
    else:
        f = x
    return _grey(saturate(f))


def _brick_tint(n: np.ndarray) -> np.ndarray:
    """A random 0..1 per brick number (n,) int64, by a fast integer hash of 31 bits."""
    n = (n + 1013) & 0x7FFFFFFF
    n = (n >> 13) ^ n
    square = (n * n) & 0xFFFFFFFF
    n = (n * ((square * 60493 + 19990303) & 0xFFFFFFFF) + 1376312589) & 0x7FFFFFFF
    return (n / 1073741824.0).astype(np.float32) * np.float32(0.5)


@node(
    "brick_texture",
    {
        "vector": _GENERATED,
        "color1": (COLOR, 0.8),
        "color2": (COLOR, 0.2),
        "mortar": (COLOR, 0.0),
        "scale": (FLOAT, 5.0),
        "mortar_size": (FLOAT, 0.02),
        "mortar_smooth": (FLOAT, 0.1),
        "bias": (FLOAT, 0.0),
        "brick_width": (FLOAT, 0.5),
        "row_height": (FLOAT, 0.25),
    },
    {"color": COLOR, "fac": FLOAT},
    fine=True,
)
def _brick(c: Call) -> dict[str, np.ndarray]:
    """params: offset, offset_frequency, squash, squash_frequency."""
    p = c["vector"] * c.vector("scale")
    height, width = c["row_height"], c["brick_width"]
    row = _cells(p[:, 1], height)
    shift = np.zeros(1, np.float32)
    every_offset, every_squash = c.params.get("offset_frequency", 2), c.params.get("squash_frequency", 2)
    if every_offset and every_squash:
        squash, offset = c.params.get("squash", 1.0), c.params.get("offset", 0.5)
        width = width * np.where(np.fmod(row, every_squash) != 0, 1, squash).astype(np.float32)
        shift = np.where(np.fmod(row, every_offset) != 0, 0, width * offset).astype(np.float32)
    brick = _cells(p[:, 0] + shift, width)
    x, y = (p[:, 0] + shift) - width * brick, p[:, 1] - height * row
    tint = saturate(_brick_tint((row << 16) + (brick & 0xFFFF)) + c["bias"])
    distance = np.minimum(np.minimum(x, y), np.minimum(width - x, height - y))
    size, smooth = c["mortar_size"], c["mortar_smooth"]
    inside = 1 - distance / np.where(size != 0, size, 1)
    t = np.clip(inside / np.where(smooth != 0, smooth, 1), 0, 1)
    mortar = np.where(smooth == 0, 1, t * t * (3 - 2 * t))
    mortar = np.where(distance >= size, 0, mortar).astype(np.float32)
    t, m = tint[:, None], mortar[:, None]
    color = np.where(m != 1, (1 - t) * c["color1"] + t * c["color2"], c["color1"])
    return {"color": color * (1 - m) + c["mortar"] * m, "fac": mortar}


def _cells(x: np.ndarray, size: np.ndarray) -> np.ndarray:
    ratio = np.nan_to_num(x / size, nan=0.0, posinf=0.0, neginf=0.0)
    return np.floor(np.clip(ratio, -2e9, 2e9)).astype(np.int64)


@node(
    "magic_texture",
    {"vector": _GENERATED, "scale": (FLOAT, 5.0), "distortion": (FLOAT, 1.0)},
    {"color": COLOR, "fac": FLOAT},
    fine=True,
)
def _magic(c: Call) -> dict[str, np.ndarray]:
    """params: depth, how often the waves are bent by each other (0 to 10)."""
    v, d = np.fmod(c["vector"], _TWO_PI), c["distortion"]
    scale = 5 * c["scale"]
    x = np.sin((v[:, 0] + v[:, 1] + v[:, 2]) * scale)
    y = np.cos((-v[:, 0] + v[:, 1] - v[:, 2]) * scale)
    z = -np.cos((-v[:, 0] - v[:, 1] + v[:, 2]) * scale)
    depth = int(c.params.get("depth", 2))
    if depth > 0:
        x, y, z = x * d, y * d, z * d
    bends = (
        ("y", lambda: -np.cos(x - y + z)),
        ("x", lambda: np.cos(x - y - z)),
        ("z", lambda: np.sin(-x - y - z)),
        ("x", lambda: -np.cos(-x + y - z)),
        ("y", lambda: -np.sin(-x + y + z)),
        ("y", lambda: -np.cos(-x + y + z)),
        ("x", lambda: np.cos(x + y + z)),
        ("z", lambda: np.sin(x + y - z)),
        ("x", lambda: -np.cos(-x - y + z)),
        ("y", lambda: -np.sin(x - y + z)),
    )
    for axis, bend in bends[:depth]:
        value = bend() * d
        if axis == "x":
            x = value
        elif axis == "y":
            y = value
        else:
            z = value
    divisor = np.where(d != 0, 2 * d, 1)
    n = max(len(x), len(divisor))
    color = np.stack([np.broadcast_to(np.float32(0.5) - w / divisor, n) for w in (x, y, z)], 1)
    return {"color": color, "fac": color.sum(1) / 3}


@node(
    "wave_texture",
    {
        "vector": _GENERATED,
        "scale": (FLOAT, 5.0),
        "distortion": (FLOAT, 0.0),
        "detail": (FLOAT, 2.0),
        "detail_scale": (FLOAT, 1.0),
        "detail_roughness": (FLOAT, 0.5),
        "phase_offset": (FLOAT, 0.0),
    },
    {"color": COLOR, "fac": FLOAT},
    fine=True,
)
def _wave(c: Call) -> dict[str, np.ndarray]:
    """params: type "BANDS" or "RINGS", bands and rings directions, profile "SIN", "SAW" or "TRI"."""
    p = (c["vector"] * c.vector("scale") + np.float32(0.000001)) * np.float32(0.999999)
    if c.params.get("type", "BANDS") == "BANDS":
        direction = c.params.get("bands", "X")
        n = (
            (p[:, 0] + p[:, 1] + p[:, 2]) * 10
            if direction == "DIAGONAL"
            else p[:, "XYZ".index(direction)] * 20
        )
    else:
        direction = c.params.get("rings", "X")
        kept = np.array([direction != axis for axis in "XYZ"], np.float32)
        n = length(p * kept) * 20
    n = n + c["phase_offset"]
    if c["distortion"].any():
        n = n + c["distortion"] * (_fractal(p, c) * 2 - 1)
    profile = c.params.get("profile", "SIN")
    if profile == "SIN":
        return _grey(0.5 + 0.5 * np.sin(n - np.float32(np.pi / 2)))
    n = n / _TWO_PI
    return _grey(n - np.floor(n) if profile == "SAW" else np.abs(n - np.floor(n + 0.5)) * 2)


def _fractal(p: np.ndarray, c: Call) -> np.ndarray:
    """Normalised fractal noise (n,) that bends the waves."""
    from pointmr_engine.shading.kernels.noise import noise_texture

    scaled = p * c.vector("detail_scale")
    points = np.zeros((len(scaled), 4), np.float32)
    points[:, :3] = scaled
    zero = np.zeros(1, np.float32)
    columns = (c["detail"], c["detail_roughness"], zero + 2, zero, zero, zero)
    parameters = np.ascontiguousarray(np.stack(np.broadcast_arrays(*columns), 1), np.float32)
    if len(parameters) > len(points):
        points = np.repeat(points, len(parameters), axis=0)
    out = np.empty((len(points), 3), np.float32)
    noise_texture(points, parameters, np.zeros((6, 4), np.float32), 3, 0, True, 1, out)
    return out[:, 0]
