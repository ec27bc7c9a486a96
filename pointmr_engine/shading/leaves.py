"""Leaf shaders: what a material program yields, before view-dependent expansion into lobes.

A program turns surface points into leaves; `shading.lobes` turns leaves, view and normals into BSDF lobes. A leaf is
what the surface alone decides, and can be stored with a sample of a hierarchy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# kinds
(
    PRINCIPLED,
    DIFFUSE,
    GLOSSY,
    GLASS,
    REFRACTION,
    TRANSPARENT,
    TRANSLUCENT,
    EMISSION,
    SHEEN,
    SUBSURFACE,
    HOLDOUT,
    BACKGROUND,
    METALLIC,
) = range(13)

# Columns of a leaf's block, a float32 array (m, len(columns)), m = number of points, or 1 where nothing varies.
# The first three are always the weight (product of the mix factors above it, as RGB).
_WEIGHT = ("weight_r", "weight_g", "weight_b")


def _rgb(name: str) -> tuple[str, str, str]:
    return (f"{name}_r", f"{name}_g", f"{name}_b")


COLUMNS: dict[int, tuple[str, ...]] = {
    PRINCIPLED: (
        *_WEIGHT,
        *_rgb("base_color"),
        "metallic",
        "roughness",
        "ior",
        "alpha",
        "diffuse_roughness",
        "subsurface_weight",
        "specular_ior_level",
        *_rgb("specular_tint"),
        "anisotropic",
        "anisotropic_rotation",
        "transmission_weight",
        "coat_weight",
        "coat_roughness",
        "coat_ior",
        *_rgb("coat_tint"),
        "sheen_weight",
        "sheen_roughness",
        *_rgb("sheen_tint"),
        *_rgb("emission"),  # emission_color * emission_strength
        "thin_film_thickness",
        "thin_film_ior",
    ),
    # weight includes the colour, here and below; where multiple scattering needs the colour alone, it has columns too
    # (all zero: the weight is taken for it)
    DIFFUSE: (*_WEIGHT, "roughness", *_rgb("color")),
    GLOSSY: (*_WEIGHT, "roughness", "anisotropy", "rotation", *_rgb("color")),
    GLASS: (*_WEIGHT, "roughness", "ior", *_rgb("color"), "thin_film_thickness", "thin_film_ior"),
    REFRACTION: (*_WEIGHT, "roughness", "ior"),
    TRANSPARENT: _WEIGHT,
    TRANSLUCENT: _WEIGHT,
    EMISSION: _WEIGHT,  # radiance
    SHEEN: (*_WEIGHT, "roughness"),
    SUBSURFACE: _WEIGHT,
    HOLDOUT: _WEIGHT,
    BACKGROUND: _WEIGHT,  # radiance
    METALLIC: (
        *_WEIGHT,
        *_rgb("base_color"),
        *_rgb("edge_tint"),
        "roughness",
        "anisotropy",
        "rotation",
        "thin_film_thickness",
        "thin_film_ior",
    ),
}

# variants, by name, that a leaf may carry in `distribution`
DISTRIBUTIONS = ("multi_ggx", "ggx", "beckmann", "sharp", "ashikhmin_shirley", "microfiber", "ashikhmin")


@dataclass
class Leaf:
    """One leaf shader over a batch of points. Normals (n, 3) float32 or None for the point's own shading normal.

    surface_normal: what displacement shown as bump makes of the points' own shading normal, for all their leaves.
    """

    kind: int
    block: np.ndarray  # (n or 1, len(COLUMNS[kind])) float32
    normal: np.ndarray | None = None
    coat_normal: np.ndarray | None = None
    tangent: np.ndarray | None = None
    surface_normal: np.ndarray | None = None
    distribution: str = "multi_ggx"


def reduce_leaves(leaves: list[Leaf], count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(albedo (n, 3), emission (n, 3), alpha (n,)) float32 of a program's leaves."""
    albedo, emission = np.zeros((count, 3), np.float32), np.zeros((count, 3), np.float32)
    clear = np.zeros(count, np.float32)
    for leaf in leaves:
        weight = leaf.block[:, :3]
        if leaf.kind == PRINCIPLED:
            column = COLUMNS[PRINCIPLED].index
            base, glow = column("base_color_r"), column("emission_r")
            alpha = leaf.block[:, column("alpha"), None]
            albedo += weight * alpha * leaf.block[:, base : base + 3]
            emission += weight * alpha * leaf.block[:, glow : glow + 3]
            clear += (weight * (1.0 - alpha)).mean(1)
        elif leaf.kind == TRANSPARENT:
            clear += weight.mean(1)
        elif leaf.kind in (EMISSION, BACKGROUND):
            emission += weight
        elif leaf.kind == METALLIC:
            base = COLUMNS[METALLIC].index("base_color_r")
            albedo += weight * leaf.block[:, base : base + 3]
        elif leaf.kind != HOLDOUT:
            albedo += weight
    alpha = np.clip(1.0 - np.nan_to_num(clear), 0.0, 1.0)
    back = (1.0 / np.maximum(alpha, 1e-6))[:, None]
    albedo, emission = np.nan_to_num(albedo), np.nan_to_num(emission)
    return np.clip(albedo * back, 0.0, 1.0), np.maximum(emission * back, 0.0), alpha
