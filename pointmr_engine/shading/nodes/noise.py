"""Noise, Voronoi and White Noise textures."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pointmr_engine.shading.nodes.registry import COLOR, FLOAT, VECTOR, Call, From, node

_GENERATED = (VECTOR, From("generated"))
NOISE_TYPES = ("FBM", "MULTIFRACTAL", "HYBRID_MULTIFRACTAL", "RIDGED_MULTIFRACTAL", "HETERO_TERRAIN")
FEATURES = ("F1", "F2", "SMOOTH_F1", "DISTANCE_TO_EDGE", "N_SPHERE_RADIUS")
BLOCK = 256  # points of a solid texture that are worked on at once: what the first-level cache holds
METRICS = ("EUCLIDEAN", "MANHATTAN", "CHEBYCHEV", "MINKOWSKI")


def dimensions_of(params: dict) -> int:
    """1 to 4, from Blender's "1D" to "4D"."""
    return int(str(params.get("dimensions", "3D"))[0])


def hash_floats(words: list[np.ndarray]) -> np.ndarray:
    """(n,) hashes in 0..1 of one to four float arrays (n or 1,), by their bits."""
    from pointmr_engine.shading.kernels.hashes import hash_bits

    n = max(len(w) for w in words)
    bits = np.zeros((n, 4), np.uint32)
    for k, w in enumerate(words):
        bits[:, k] = np.ascontiguousarray(w, np.float32).view(np.uint32)
    out = np.empty(n, np.float32)
    hash_bits(bits, len(words), out)
    return out


@lru_cache(maxsize=4)
def _seed_offsets(dimensions: int) -> np.ndarray:
    """(6, 4) shifts of the coordinates, 100 to 200, that stand for seeds 0 to 5."""
    seeds = np.arange(6, dtype=np.float32)
    out = np.zeros((6, 4), np.float32)
    for axis in range(dimensions):
        words = [seeds] if dimensions == 1 else [seeds, np.full(1, axis, np.float32)]
        out[:, axis] = 100 + hash_floats(words) * np.float32(100)
    return out


def coordinates(c: Call, scale: np.ndarray) -> np.ndarray:
    """(n, 4) float32 coordinates scaled, x y z w; w first where there is only one dimension."""
    v, w = c["vector"], c["w"]
    n = max(len(v), len(w), len(scale))
    out = np.empty((n, 4), np.float32)
    if dimensions_of(c.params) == 1:
        out[:, 1:] = 0
        out[:, 0] = w * scale
    else:
        for axis in range(3):  # NumPy is slow along three
            out[:, axis] = v[:, axis] * scale
        out[:, 3] = w * scale
    return out


def _ignores_unused(params: dict, wanted: frozenset[str]) -> tuple[str, ...]:
    d = dimensions_of(params)
    return ("vector",) if d == 1 else ("w",) if d < 4 else ()


def _table(*columns: np.ndarray) -> np.ndarray:
    out = np.empty((max(len(c) for c in columns), len(columns)), np.float32)
    for k, column in enumerate(columns):
        out[:, k] = column
    return out


class _Inputs(dict):
    """Inputs of a call; those that it ignores read as zeros."""

    def __missing__(self, name: str) -> np.ndarray:
        return np.zeros((1, 3) if name == "vector" else 1, np.float32)


def _complete(c: Call) -> Call:
    return Call(_Inputs(c.inputs), c.params, c.points, c.wanted, c.moved)


@node(
    "noise_texture",
    {
        "vector": _GENERATED,
        "w": (FLOAT, 0.0),
        "scale": (FLOAT, 5.0),
        "detail": (FLOAT, 2.0),
        "roughness": (FLOAT, 0.5),
        "lacunarity": (FLOAT, 2.0),
        "offset": (FLOAT, 0.0),
        "gain": (FLOAT, 1.0),
        "distortion": (FLOAT, 0.0),
    },
    {"fac": FLOAT, "color": COLOR},
    ignores=_ignores_unused,
    fine=True,
)
def _noise(c: Call) -> dict[str, np.ndarray]:
    """params: dimensions "1D" to "4D", type (NOISE_TYPES), normalize."""
    from pointmr_engine.shading.kernels.noise import noise_texture, solid_texture

    c = _complete(c)
    points = coordinates(c, c["scale"])
    parameters = _table(
        np.clip(c["detail"], 0, 15),
        np.maximum(c["roughness"], 0),
        c["lacunarity"],
        c["offset"],
        c["gain"],
        c["distortion"],
    )
    if len(parameters) > len(points):
        points = np.repeat(points, len(parameters), axis=0)
    d = dimensions_of(c.params)
    out = np.empty((len(points), 3), np.float32)
    kind = NOISE_TYPES.index(c.params.get("type", "FBM"))
    normalize, channels = bool(c.params.get("normalize", True)), 3 if "color" in c.wanted else 1
    if d == 3 and kind == 0 and len(parameters) == 1:
        scratch = np.empty((11, BLOCK))
        solid_texture(points, parameters[0], _seed_offsets(d), normalize, channels, scratch, out)
    else:
        noise_texture(points, parameters, _seed_offsets(d), d, kind, normalize, channels, out)
    return {"fac": out[:, 0], "color": out}


def _most_distant(parameters: np.ndarray, dimensions: int, feature: int, metric: int) -> np.ndarray:
    """(n or 1,) float32: how far a point can be from its feature, which normalised distances are divided by."""
    half = 0.5 + 0.5 * parameters[:, 5]
    if FEATURES[feature] == "DISTANCE_TO_EDGE":
        return half
    d = 1.0 if METRICS[metric] == "CHEBYCHEV" else float(dimensions)
    exponents = {"EUCLIDEAN": 0.5, "MINKOWSKI": 1 / np.where(parameters[:, 4] != 0, parameters[:, 4], 1)}
    far = half * d ** exponents.get(METRICS[metric], 1.0)
    return (2 * far if FEATURES[feature] == "F2" else far).astype(np.float32)


@node(
    "voronoi_texture",
    {
        "vector": _GENERATED,
        "w": (FLOAT, 0.0),
        "scale": (FLOAT, 5.0),
        "detail": (FLOAT, 0.0),
        "roughness": (FLOAT, 0.5),
        "lacunarity": (FLOAT, 2.0),
        "smoothness": (FLOAT, 1.0),
        "exponent": (FLOAT, 0.5),
        "randomness": (FLOAT, 1.0),
    },
    {"distance": FLOAT, "color": COLOR, "position": VECTOR, "w": FLOAT, "radius": FLOAT},
    ignores=_ignores_unused,
    fine=True,
)
def _voronoi(c: Call) -> dict[str, np.ndarray]:
    """params: dimensions "1D" to "4D", feature (FEATURES), metric (METRICS), normalize."""
    from pointmr_engine.shading.kernels import voronoi

    c = _complete(c)
    points = coordinates(c, c["scale"])
    parameters = _table(
        np.clip(c["detail"], 0, 15),
        np.clip(c["roughness"], 0, 1),
        c["lacunarity"],
        np.clip(c["smoothness"] / 2, 0, 0.5),
        c["exponent"],
        np.clip(c["randomness"], 0, 1),
        c["scale"],
    )
    if len(parameters) > len(points):
        points = np.repeat(points, len(parameters), axis=0)
    d = dimensions_of(c.params)
    feature = FEATURES.index(c.params.get("feature", "F1"))
    metric = METRICS.index(c.params.get("metric", "EUCLIDEAN"))
    if feature == voronoi.SMOOTH_F1 and not parameters[:, voronoi.SMOOTHNESS].any():
        feature = voronoi.F1
    texture = (
        voronoi.nearest_texture,
        voronoi.nearest_texture,
        voronoi.smooth_texture,
        voronoi.edge_texture,
        voronoi.radius_texture,
    )[feature]
    far = _most_distant(parameters, d, feature, metric)
    out = np.empty((len(points), 8), np.float32)
    texture(points, parameters, far, d, feature, metric, bool(c.params.get("normalize", False)), out)
    return {
        "distance": out[:, 0],
        "color": out[:, 1:4],
        # a texture of w alone has no position
        "position": np.zeros((1, 3), np.float32) if d == 1 else out[:, 4:7],
        "w": out[:, 4] if d == 1 else out[:, 7],
        "radius": out[:, 0],
    }


@node(
    "white_noise_texture",
    {"vector": (VECTOR, 0.0), "w": (FLOAT, 0.0)},
    {"value": FLOAT, "color": COLOR},
    ignores=_ignores_unused,
    fine=True,
)
def _white_noise(c: Call) -> dict[str, np.ndarray]:
    """params: dimensions "1D" to "4D"."""
    d = dimensions_of(c.params)
    c = _complete(c)
    x, y, z, w = c["vector"][:, 0], c["vector"][:, 1], c["vector"][:, 2], c["w"]
    words = {1: [w], 2: [x, y], 3: [x, y, z], 4: [x, y, z, w]}[d]
    value = hash_floats(words)
    if "color" not in c.wanted:
        return {"value": value}
    if d == 4:
        others = [hash_floats([z, x, w, y]), hash_floats([w, z, y, x])]
    else:
        others = [hash_floats([*words, np.full(1, k, np.float32)]) for k in (1, 2)]
    return {"value": value, "color": np.stack([value, *others], 1)}
