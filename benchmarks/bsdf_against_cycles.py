"""BSDF values of shading/lobes.py beside those of Cycles, for shader inputs at random. Needs bpy.

Run `python -m benchmarks.bsdf_against_cycles`: a line for every setting, with the share of points that differ by more
than a per cent, and the largest difference.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from benchmarks.bsdf_probe import probe
from pointmr_engine.shading import leaves, lobes
from pointmr_engine.shading.leaves import COLUMNS, Leaf

PRINCIPLED_DEFAULTS = {
    "base_color": (0.8, 0.8, 0.8),
    "roughness": 0.5,
    "ior": 1.5,
    "alpha": 1.0,
    "specular_ior_level": 0.5,
    "specular_tint": (1.0, 1.0, 1.0),
    "coat_roughness": 0.03,
    "coat_ior": 1.5,
    "coat_tint": (1.0, 1.0, 1.0),
    "sheen_roughness": 0.5,
    "sheen_tint": (1.0, 1.0, 1.0),
    "thin_film_ior": 1.33,
}

# leaf kind -> node, defaults, our column of a socket that is named differently
NODES = {
    leaves.PRINCIPLED: ("ShaderNodeBsdfPrincipled", PRINCIPLED_DEFAULTS, {}),
    leaves.DIFFUSE: ("ShaderNodeBsdfDiffuse", {"color": (0.8, 0.8, 0.8), "roughness": 0.0}, {}),
    leaves.GLOSSY: ("ShaderNodeBsdfAnisotropic", {"color": (0.8, 0.8, 0.8), "roughness": 0.5}, {}),
    leaves.GLASS: ("ShaderNodeBsdfGlass", {"color": (1.0, 1.0, 1.0), "roughness": 0.0, "ior": 1.5}, {}),
    leaves.REFRACTION: (
        "ShaderNodeBsdfRefraction",
        {"color": (1.0, 1.0, 1.0), "roughness": 0.0, "ior": 1.45},
        {},
    ),
    leaves.TRANSLUCENT: ("ShaderNodeBsdfTranslucent", {"color": (0.8, 0.8, 0.8)}, {}),
    leaves.SHEEN: ("ShaderNodeBsdfSheen", {"color": (0.8, 0.8, 0.8), "roughness": 0.5}, {}),
    leaves.METALLIC: (
        "ShaderNodeBsdfMetallic",
        {"base_color": (0.6, 0.5, 0.4), "edge_tint": (0.7, 0.8, 0.9), "roughness": 0.5},
        {"anisotropic": "anisotropy"},
    ),
}


def make_block(kind: int, n: int, values: dict[str, np.ndarray]) -> np.ndarray:
    """The leaf block (n, columns) of shader inputs, each a constant or (n,) or (n, 3)."""
    _, defaults, renamed = NODES[kind]
    columns = COLUMNS[kind]
    block = np.zeros((n, len(columns)), np.float32)
    block[:, :3] = 1.0
    for name, value in {**defaults, **values}.items():
        name = renamed.get(name, name)
        value = np.asarray(value, np.float32)
        if name + "_r" in columns:
            start = columns.index(name + "_r")
            block[:, start : start + 3] = value
        elif name in columns:
            block[:, columns.index(name)] = value
        if name == "color":
            block[:, :3] *= value
    return block


@njit(cache=True, error_model="numpy")
def _evaluate_all(lb, wi, wo, out):
    for i in range(len(out)):
        a = (wi[i, 0], wi[i, 1], wi[i, 2])
        b = (wo[i, 0], wo[i, 1], wo[i, 2])
        d, _, g, t, pdf = lobes.evaluate(lb, i, a, b)
        for c in range(3):
            out[i, c] = d[c] + g[c] + t[c]
        out[i, 3] = pdf


def expand(kind, normals, values, smooth=False, geometric=None, correction=True, backfacing=False, **leaf):
    """Lobes of n points seen from +z, whose plane is z = 0, with those normals."""
    n = len(normals)
    incoming = np.tile(np.float32([0, 0, 1]), (n, 1))
    normals = np.asarray(normals, np.float32)
    flat = incoming if geometric is None else geometric
    view = lobes.View(
        incoming, normals if smooth else flat, flat, np.full(n, backfacing), np.zeros(n, np.bool_)
    )
    lb = lobes.allocate(n, 7)
    lobes.reset(lb, view, correction)
    leaf = Leaf(kind, make_block(kind, n, values), normal=None if smooth else normals, **leaf)
    lobes.append(lb, leaf, np.arange(n), view, lobes.load_tables())
    return lb, view


def ours(kind, normals, light, values, **options):
    """BSDF * |cos| (n, 3) toward `light`."""
    lb, view = expand(kind, normals, values, **options)
    out = np.empty((len(normals), 4))
    light = np.tile(np.asarray(light, np.float64), (len(normals), 1))
    _evaluate_all(lb, view.incoming.astype(np.float64), light, out)
    return out[:, :3], lb


def random_normals(rng, n: int, steepest: float = 1.2) -> np.ndarray:
    """Unit normals within that angle of +z."""
    theta = steepest * np.sqrt(rng.random(n))
    phi = 2.0 * math.pi * rng.random(n)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)


def compare(
    kind, light, constants=None, ranges=None, properties=None, seed=0, side=16, correction=True, **leaf
):
    """(ours, Cycles', lobes) for `ranges`: name -> (low, high), drawn per point; low, high of a colour are tuples."""
    rng = np.random.default_rng(seed)
    n = side * side
    normals = random_normals(rng, n).astype(np.float32).astype(np.float64)
    drawn = {}
    for name, (low, high) in (ranges or {}).items():
        low, high = np.asarray(low, float), np.asarray(high, float)
        drawn[name] = (low + (high - low) * rng.random((n, *low.shape))).astype(np.float32)
    constants = dict(constants or {})
    light = np.asarray(light, float) / np.linalg.norm(light)
    node, defaults, _ = NODES[kind]
    inputs = {**defaults, **constants}
    reference = probe(
        node,
        np.tile([0, 0, 1.0], (n, 1)),
        light,
        inputs,
        {**drawn, "normal": normals},
        properties,
        correction,
    )
    leaf |= {name: drawn[name] for name in ("tangent", "coat_normal") if name in drawn}
    result, lb = ours(kind, normals, light, {**constants, **drawn}, correction=correction, **leaf)
    return result, reference, lb


WHITE_RANGE = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
ROUGH = {"roughness": (0.15, 1.0)}
TANGENTS = ((0.2, -1.0, -1.0), (1.0, 1.0, 1.0))
UP, LOW, BEHIND = (0.3, 0.2, 0.93), (0.85, -0.1, 0.4), (-0.2, 0.1, -0.97)
P = leaves.PRINCIPLED
SETTINGS = {
    "diffuse": (leaves.DIFFUSE, LOW, {}, {"color": WHITE_RANGE}),
    "oren-nayar": (leaves.DIFFUSE, LOW, {}, {"color": WHITE_RANGE, "roughness": (0.0, 1.0)}),
    "translucent": (leaves.TRANSLUCENT, BEHIND, {}, {"color": WHITE_RANGE}),
    "sheen": (leaves.SHEEN, LOW, {}, {"color": WHITE_RANGE, "roughness": (0.0, 1.0)}),
    "velvet": (
        leaves.SHEEN,
        LOW,
        {},
        {"color": WHITE_RANGE, "roughness": (0.0, 1.0)},
        {"distribution": "ASHIKHMIN"},
    ),
    "glossy multi": (leaves.GLOSSY, UP, {}, {"color": WHITE_RANGE, **ROUGH}, {"distribution": "MULTI_GGX"}),
    "glossy ggx": (leaves.GLOSSY, UP, {}, {"color": WHITE_RANGE, **ROUGH}, {"distribution": "GGX"}),
    "glossy beckmann": (leaves.GLOSSY, UP, {}, {"color": WHITE_RANGE, **ROUGH}, {"distribution": "BECKMANN"}),
    "glossy ashikhmin": (leaves.GLOSSY, UP, {}, ROUGH, {"distribution": "ASHIKHMIN_SHIRLEY"}),
    "metallic": (
        leaves.METALLIC,
        UP,
        {},
        {"base_color": WHITE_RANGE, "edge_tint": WHITE_RANGE, **ROUGH},
        {"distribution": "MULTI_GGX", "fresnel_type": "F82"},
    ),
    "glass reflecting": (leaves.GLASS, UP, {}, {"ior": (1.01, 2.5), "color": WHITE_RANGE, **ROUGH}),
    "glass refracting": (leaves.GLASS, BEHIND, {}, {"ior": (1.1, 2.5), "color": WHITE_RANGE, **ROUGH}),
    "glass below 1": (leaves.GLASS, BEHIND, {}, {"ior": (0.4, 0.9), "color": WHITE_RANGE, **ROUGH}),
    "glass beckmann": (leaves.GLASS, BEHIND, {}, {"ior": (1.1, 2.0), **ROUGH}, {"distribution": "BECKMANN"}),
    "refraction": (leaves.REFRACTION, BEHIND, {}, {"ior": (1.1, 2.0), **ROUGH}, {"distribution": "GGX"}),
    "plain": (P, LOW, {}, {"base_color": WHITE_RANGE, **ROUGH}),
    "specular": (
        P,
        UP,
        {},
        {"ior": (1.0, 3.0), "specular_ior_level": (0.0, 1.0), "specular_tint": WHITE_RANGE, **ROUGH},
    ),
    "ior below 1": (P, UP, {}, {"ior": (0.3, 1.0), "specular_ior_level": (0.0, 1.0), **ROUGH}),
    "metal": (P, UP, {"metallic": 1.0}, {"base_color": WHITE_RANGE, "specular_tint": WHITE_RANGE, **ROUGH}),
    "half metal": (P, UP, {}, {"metallic": (0.0, 1.0), "base_color": WHITE_RANGE, **ROUGH}),
    "coat": (
        P,
        UP,
        {},
        {
            "coat_weight": (0.0, 1.0),
            "coat_roughness": (0.1, 1.0),
            "coat_ior": (1.0, 3.0),
            "coat_tint": WHITE_RANGE,
            **ROUGH,
        },
    ),
    "sheen layer": (
        P,
        LOW,
        {},
        {"sheen_weight": (0.0, 1.0), "sheen_roughness": (0.0, 1.0), "sheen_tint": WHITE_RANGE, **ROUGH},
    ),
    "rough diffuse": (P, LOW, {}, {"diffuse_roughness": (0.0, 1.0), "base_color": WHITE_RANGE, **ROUGH}),
    "transmission": (
        P,
        BEHIND,
        {"transmission_weight": 1.0},
        {"base_color": WHITE_RANGE, "ior": (1.1, 2.5), "specular_tint": WHITE_RANGE, **ROUGH},
    ),
    "transmission, lit above": (P, UP, {"transmission_weight": 1.0}, {"base_color": WHITE_RANGE, **ROUGH}),
    "alpha": (P, UP, {}, {"alpha": (0.0, 1.0), **ROUGH}),
    "film": (
        P,
        UP,
        {},
        {"thin_film_thickness": (50.0, 900.0), "thin_film_ior": (1.1, 2.2), "ior": (1.2, 2.5), **ROUGH},
    ),
    "film on metal": (
        P,
        UP,
        {"metallic": 1.0},
        {
            "thin_film_thickness": (50.0, 900.0),
            "thin_film_ior": (1.1, 2.2),
            "base_color": WHITE_RANGE,
            **ROUGH,
        },
    ),
    "anisotropic": (
        P,
        UP,
        {"metallic": 0.5},
        {"anisotropic": (0.0, 1.0), "anisotropic_rotation": (0.0, 1.0), "tangent": TANGENTS, **ROUGH},
    ),
    "glossy anisotropic": (
        leaves.GLOSSY,
        UP,
        {},
        {"anisotropy": (-1.0, 1.0), "rotation": (0.0, 1.0), "tangent": TANGENTS, **ROUGH},
        {"distribution": "MULTI_GGX"},
    ),
    "glossy anisotropic beckmann": (
        leaves.GLOSSY,
        UP,
        {},
        {"anisotropy": (-0.5, 0.5), "tangent": TANGENTS, **ROUGH},
        {"distribution": "BECKMANN"},
    ),
    "glossy anisotropic ashikhmin": (
        leaves.GLOSSY,
        UP,
        {},
        {"anisotropy": (-0.5, 0.5), "tangent": TANGENTS, **ROUGH},
        {"distribution": "ASHIKHMIN_SHIRLEY"},
    ),
    "coat over a bumped base": (
        P,
        UP,
        {"coat_weight": 1.0, "coat_roughness": 0.4, "sheen_weight": 0.5},
        ROUGH,
    ),
    "coat bumped apart": (
        P,
        UP,
        {"coat_weight": 1.0, "coat_roughness": 0.4, "sheen_weight": 0.5},
        {"coat_normal": ((-0.5, -0.5, 0.8), (0.5, 0.5, 1.0)), **ROUGH},
    ),
    "everything": (
        P,
        UP,
        {},
        {
            "base_color": WHITE_RANGE,
            "metallic": (0.0, 0.5),
            "transmission_weight": (0.0, 0.5),
            "coat_weight": (0.0, 1.0),
            "coat_roughness": (0.1, 0.5),
            "sheen_weight": (0.0, 0.5),
            "diffuse_roughness": (0.0, 1.0),
            **ROUGH,
        },
    ),
}
DISTRIBUTIONS = {
    "MULTI_GGX": "multi_ggx",
    "GGX": "ggx",
    "BECKMANN": "beckmann",
    "ASHIKHMIN_SHIRLEY": "ashikhmin_shirley",
    "ASHIKHMIN": "ashikhmin",
}


def run(name: str, **options):
    """`compare` of one of SETTINGS."""
    kind, light, constants, ranges, *rest = SETTINGS[name]
    properties = dict(rest[0]) if rest else {}
    if kind in (leaves.PRINCIPLED, leaves.GLASS):
        properties.setdefault("distribution", "MULTI_GGX")
    distribution = DISTRIBUTIONS[properties.get("distribution", "GGX")]
    return compare(kind, light, constants, ranges, properties, distribution=distribution, **options)


def differences(result, reference):
    """Relative difference of each point, against its own size but no less than a hundredth of the mean."""
    floor = 0.01 * max(reference.mean(), 1e-6)
    return np.abs(result - reference).max(axis=1) / np.maximum(reference.max(axis=1), floor)


def main() -> None:
    """All settings."""
    for name in SETTINGS:
        result, reference, _ = run(name)
        d = differences(result, reference)
        print(
            f"{name:26s} mean {reference.mean():.4f} ratio {result.mean() / reference.mean():.5f} "
            f"median {np.median(d):.1e} over 1%: {100 * np.mean(d > 0.01):5.1f}% largest {d.max():.1e}",
            flush=True,
        )


if __name__ == "__main__":
    main()
