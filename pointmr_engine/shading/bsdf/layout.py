"""How lobes lie in memory: the arrays, their columns and flags."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# What a lobe is (low byte of Lobes.kind). Order matters: everything up to TRANSLUCENT counts as diffuse.
LAMBERT, OREN_NAYAR, SHEEN, VELVET, TRANSLUCENT = np.arange(1, 6)
REFLECTION, REFRACTION, GLASS, ASHIKHMIN_SHIRLEY = np.arange(6, 10)
KIND_MASK = 0xFF
# modifiers, above the low byte
BECKMANN = 0x100  # microfacet distribution; GGX without it
SINGULAR_LOBE = 0x200  # too smooth to evaluate, can only be sampled
BUMPED = 0x400  # the lobe's normal is not the point's shading normal
ANISOTROPIC = 0x800
THIN_FILM = 0x1000
COAT = 0x4000  # a Principled BSDF's coat, which has a normal of its own
MIRROR = 0x2000  # singular by its material, and a lobe only as normals differ within a footprint
FRESNEL_DIELECTRIC = 0x10000  # plain dielectric
FRESNEL_SCHLICK = 0x20000  # dielectric curve remapped to f0..1, tinted
FRESNEL_F82 = 0x40000  # metallic, Schlick with a tint at 82 degrees
FRESNEL_MASK = 0x70000

# Columns of Lobes.data. (numpy integers here and above: numba would compile a function anew for every value of a
# Python one that is passed to it.)
WEIGHT = np.int64(0)  # rgb, energy compensation included
SAMPLE = np.int64(3)  # weight for choosing a lobe
NORMAL = np.int64(4)  # xyz
TANGENT = np.int64(7)  # xyz: orthonormal tangent where anisotropic; for sheen too
ALPHA_X = np.int64(10)  # Oren-Nayar: a; sheen: LTC a; velvet: 1 / sigma^2
ALPHA_Y = np.int64(11)  # Oren-Nayar: b; sheen: LTC b
IOR = np.int64(12)  # relative: behind / in front
FILM_THICKNESS = np.int64(13)  # nanometres
FILM_IOR = np.int64(14)
F0 = np.int64(15)  # rgb; Oren-Nayar: multiple-scattering term
TINT = np.int64(18)  # rgb: tint of the reflection; for FRESNEL_F82 the edge term
TRANSMISSION_TINT = np.int64(21)  # rgb
COLUMN_COUNT = 24

# Lobes.flags, per point
HAS_EVALUATION = 1  # some lobe can be evaluated, so that light sampling is worth it
HAS_TRANSMISSION = 2  # light from behind the surface matters
HAS_DIFFUSE = 4
HAS_SINGULAR = 8
BUMP_CORRECTION = 16

# Labels of a sampled direction
LABEL_NONE = 0  # nothing scattered: the path ends here
LABEL_DIFFUSE = 1
LABEL_GLOSSY = 2
LABEL_SINGULAR = 4
LABEL_REFLECT = 8
LABEL_TRANSMIT = 16
LABEL_TRANSPARENT = 32  # straight on, unscattered

WEIGHT_CUTOFF = 1e-5  # lobes whose mean weight is less are dropped
SINGULAR_ALPHA_SQUARED = 2e-10  # alpha_x * alpha_y up to this is a perfect mirror


class Lobes(NamedTuple):
    """Lobes of n points, up to L each. Refilled for every batch by `reset` and `append`.

    The first `count[i]` lobes of point i are valid. Emission, transparency and holdout are sums over leaves.
    """

    count: np.ndarray  # (n,) int32
    kind: np.ndarray  # (n, L) int32, a kind of this module and its modifiers
    data: np.ndarray  # (n, L, COLUMN_COUNT) float32
    emission: np.ndarray  # (n, 3) float32, radiance toward the viewer
    transparency: np.ndarray  # (n, 3) float32, weight of what is straight behind; alpha = 1 - mean, clamped
    holdout: np.ndarray  # (n,) float32, weight of holdout leaves
    diffuse_color: np.ndarray  # (n, 3) float32, albedo of the diffuse lobes (Diffuse Color pass)
    flags: np.ndarray  # (n,) uint8, HAS_*
    normal: np.ndarray  # (n, 3) float32, the points' shading normal, viewer's side, displacement included
    geometric_normal: np.ndarray  # (n, 3) float32, viewer's side
    film_table: np.ndarray  # (6, m) float32, spectral sensitivities for thin films


class View(NamedTuple):
    """From where and how n points are seen: what expands leaves into lobes. World space, unit vectors."""

    incoming: np.ndarray  # (n, 3) float32, from the point to the viewer
    normal: np.ndarray  # (n, 3) float32, interpolated shading normal on the viewer's side
    geometric_normal: np.ndarray  # (n, 3) float32, on the viewer's side
    backfacing: np.ndarray  # (n,) bool, the viewer is behind the surface: indices of refraction are inverted
    diffuse_ray: np.ndarray  # (n,) bool, the ray that came here left a diffuse lobe (caustics switches ask)
