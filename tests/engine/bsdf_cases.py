"""Shader settings for the tests of lobes, and kernels that run `evaluate` and `sample` over many points."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.shading import leaves, lobes
from pointmr_engine.shading.bsdf import ashikhmin_shirley
from pointmr_engine.shading.leaves import COLUMNS, Leaf

PRINCIPLED_DEFAULTS = {
    "base_color": 0.8,
    "roughness": 0.5,
    "ior": 1.5,
    "alpha": 1.0,
    "specular_ior_level": 0.5,
    "specular_tint": 1.0,
    "coat_roughness": 0.03,
    "coat_ior": 1.5,
    "coat_tint": 1.0,
    "sheen_roughness": 0.5,
    "sheen_tint": 1.0,
    "thin_film_ior": 1.33,
}
ANY_TANGENT = np.float32([[0.8, 0.6, 0.1]])

# name -> (kind, values, leaf options); rough enough for quadrature
ROUGH = {
    "lambert": (leaves.DIFFUSE, {}, {}),
    "oren-nayar": (leaves.DIFFUSE, {"roughness": 0.9, "weight": (0.9, 0.5, 0.2)}, {}),
    "translucent": (leaves.TRANSLUCENT, {}, {}),
    "sheen": (leaves.SHEEN, {"roughness": 0.4}, {}),
    "velvet": (leaves.SHEEN, {"roughness": 0.6}, {"distribution": "ashikhmin"}),
    "glossy": (leaves.GLOSSY, {"roughness": 0.6}, {}),
    "glossy beckmann": (leaves.GLOSSY, {"roughness": 0.6}, {"distribution": "beckmann"}),
    "glossy ashikhmin": (leaves.GLOSSY, {"roughness": 0.6}, {"distribution": "ashikhmin_shirley"}),
    "glossy anisotropic": (leaves.GLOSSY, {"roughness": 0.6, "anisotropy": 0.6}, {"tangent": ANY_TANGENT}),
    "beckmann anisotropic": (
        leaves.GLOSSY,
        {"roughness": 0.6, "anisotropy": -0.5},
        {"tangent": ANY_TANGENT, "distribution": "beckmann"},
    ),
    "ashikhmin anisotropic": (
        leaves.GLOSSY,
        {"roughness": 0.6, "anisotropy": 0.5, "rotation": 0.1},
        {"tangent": ANY_TANGENT, "distribution": "ashikhmin_shirley"},
    ),
    "metallic": (leaves.METALLIC, {"base_color": 0.7, "edge_tint": 0.5, "roughness": 0.6}, {}),
    "glass": (leaves.GLASS, {"roughness": 0.6, "ior": 1.5}, {}),
    "glass from inside": (leaves.GLASS, {"roughness": 0.6, "ior": 1.5}, {"backfacing": True}),
    "glass beckmann": (leaves.GLASS, {"roughness": 0.6, "ior": 1.5}, {"distribution": "beckmann"}),
    "refraction": (leaves.REFRACTION, {"roughness": 0.6, "ior": 1.3}, {}),
    "plain": (leaves.PRINCIPLED, {}, {}),
    "see-through": (leaves.PRINCIPLED, {"alpha": 0.4, "metallic": 0.5}, {}),
    "film": (leaves.PRINCIPLED, {"thin_film_thickness": 400.0, "roughness": 0.6, "ior": 1.8}, {}),
    "everything": (
        leaves.PRINCIPLED,
        {
            "metallic": 0.3,
            "transmission_weight": 0.4,
            "coat_weight": 0.6,
            "coat_roughness": 0.6,
            "sheen_weight": 0.5,
            "diffuse_roughness": 0.5,
            "subsurface_weight": 0.3,
            "anisotropic": 0.5,
            "base_color": (0.9, 0.4, 0.1),
        },
        {"tangent": ANY_TANGENT},
    ),
}


def make_block(kind: int, n: int, values: dict) -> np.ndarray:
    """A leaf's block (n, columns); values are numbers or arrays of n, (3,) or (n, 3)."""
    columns = COLUMNS[kind]
    block = np.zeros((n, len(columns)), np.float32)
    block[:, :3] = 1.0
    for name, value in {**(PRINCIPLED_DEFAULTS if kind == leaves.PRINCIPLED else {}), **values}.items():
        value = np.asarray(value, np.float32)
        if name + "_r" in columns:
            start = columns.index(name + "_r")
            block[:, start : start + 3] = value[:, None] if value.ndim == 1 and len(value) != 3 else value
        else:
            block[:, columns.index(name)] = value
    return block


def make_lobes(kind, wi, values, normal=None, shading=None, geometric=None, backfacing=False, **leaf):
    """Lobes of n points: directions to the viewer (n, 3), leaf normal, shading and geometric normal (default +z)."""
    wi = np.atleast_2d(np.asarray(wi, np.float32))
    n = len(wi)
    up = np.tile(np.float32([0.0, 0.0, 1.0]), (n, 1))
    shading = up if shading is None else np.asarray(shading, np.float32)
    geometric = shading if geometric is None else np.asarray(geometric, np.float32)
    facing = np.broadcast_to(np.asarray(backfacing, np.bool_), (n,)).copy()
    view = lobes.View(wi, shading, geometric, facing, np.zeros(n, np.bool_))
    lb = lobes.allocate(n, 7)
    lobes.reset(lb, view)
    leaf = Leaf(kind, make_block(kind, n, values), normal=normal, **leaf)
    lobes.append(lb, leaf, np.arange(n), view, lobes.load_tables())
    return lb


def viewer(cosine: float, phi: float = 0.4) -> np.ndarray:
    """Unit direction at that cosine to +z, as single precision stores it."""
    sine = math.sqrt(1.0 - cosine * cosine)
    return np.float32([sine * math.cos(phi), sine * math.sin(phi), cosine])


@njit(cache=True, nogil=True, error_model="numpy")
def _evaluate(lb, i, wi, wo, out):
    for k in range(len(wo)):
        row = i if i >= 0 else k
        d, _, g, t, pdf = lobes.evaluate(
            lb, row, (wi[row, 0], wi[row, 1], wi[row, 2]), (wo[k, 0], wo[k, 1], wo[k, 2])
        )
        for c in range(3):
            out[k, c] = d[c] + g[c] + t[c]
        out[k, 3] = pdf


@njit(cache=True, nogil=True, error_model="numpy")
def _sample(lb, i, wi, u, out, labels):
    for k in range(len(u)):
        row = i if i >= 0 else k
        wo, value, pdf, label, alpha, eta = lobes.sample(
            lb, row, (wi[row, 0], wi[row, 1], wi[row, 2]), u[k, 0], u[k, 1], u[k, 2]
        )
        for c in range(3):
            out[k, c] = wo[c]
            out[k, 3 + c] = value[c]
        out[k, 6] = pdf
        out[k, 7] = alpha
        out[k, 8] = eta
        labels[k] = label


def evaluate(lb, wi, wo, i: int = -1) -> np.ndarray:
    """Columns rgb, pdf; of point i toward every wo, or (i = -1) of each point toward its own."""
    out = np.empty((len(wo), 4))
    _evaluate(lb, i, np.atleast_2d(wi).astype(np.float64), np.ascontiguousarray(wo, np.float64), out)
    return out


def sample(lb, wi, u, i: int = -1) -> tuple[np.ndarray, np.ndarray]:
    """Columns wo, value, pdf, alpha, eta, and labels; of point i for every u, or of each point for its own."""
    out = np.empty((len(u), 9))
    labels = np.empty(len(u), np.int64)
    _sample(lb, i, np.atleast_2d(wi).astype(np.float64), np.ascontiguousarray(u, np.float64), out, labels)
    return out, labels


def even_numbers(n: int) -> np.ndarray:
    """n points of the unit cube, evenly spread (the R3 lattice)."""
    g = 1.2207440846057596
    return (0.5 + np.arange(1, n + 1)[:, None] * np.array([1 / g, 1 / g**2, 1 / g**3])) % 1.0


def sphere(rows: int) -> tuple[np.ndarray, float]:
    """Directions (2 rows^2, 3) that share the sphere evenly, and the solid angle of each."""
    z = -1.0 + 2.0 * (np.arange(rows) + 0.5) / rows
    phi = 2.0 * math.pi * (np.arange(2 * rows) + 0.5) / (2 * rows)
    z, phi = (a.ravel() for a in np.meshgrid(z, phi))
    sine = np.sqrt(1.0 - z * z)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), z], axis=1), 4.0 * math.pi / (2 * rows * rows)


@njit(cache=True, nogil=True, error_model="numpy")
def albedo_of_phong(lb, wi):
    """What lobe 0 of point 0, by Ashikhmin and Shirley, reflects of even light along wi (3,) float64."""
    return ashikhmin_shirley.albedo(lb.kind[0, 0], lb.data, 0, 0, (wi[0], wi[1], wi[2]))
