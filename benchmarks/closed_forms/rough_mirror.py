"""A rough mirror over which a glowing half plane begins: GGX with Smith's height-correlated masking, no Fresnel.

    L_o = integral over the half plane of D(h) / (4 cos_o (1 + Lambda_i + Lambda_o)) d omega_i
Directions to the plane z = H are given by their slopes (u, v), d omega = du dv / (1 + u^2 + v^2)^(3/2); the integral is
taken by Gauss-Legendre points after u = u_m + s sinh(t), and v likewise, dense about the mirrored direction.
"""

from __future__ import annotations

import numpy as np

from benchmarks.closed_forms.stage import DARK, Case, View, filtered, glow, look_at, mirror, rectangle
from pointmr_engine import Group, Scene

HEIGHT = 3.0  # of the half plane x > 0
REACH = 60.0  # its extent
NODES = 32


def _smith(alpha: float, tan2: np.ndarray) -> np.ndarray:
    return 0.5 * (np.sqrt(1.0 + alpha * alpha * tan2) - 1.0)


def _stretched(first, last, middle, scale):
    """Points and weights (..., NODES) from first to last, dense within `scale` of `middle`; all of shape (...)."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    a, b = np.arcsinh((first - middle) / scale)[..., None], np.arcsinh((last - middle) / scale)[..., None]
    t = 0.5 * (a + b) + 0.5 * (b - a) * x
    scale = scale[..., None]
    return middle[..., None] + scale * np.sinh(t), 0.5 * (b - a) * w * scale * np.cosh(t)


def reflected(p: np.ndarray, wo: np.ndarray, alpha: float) -> np.ndarray:
    """Radiance (N,) from floor points p (N, 3) towards wo (N, 3), unit, by a half plane of radiance 1."""
    um, vm = -wo[:, 0] / wo[:, 2], -wo[:, 1] / wo[:, 2]
    # the lobe is an ellipse in slopes, longer by k along the plane of incidence: its covariance and v's for given u
    k = 1.0 + um * um + vm * vm
    along = (k * k - 1.0) / np.maximum(k - 1.0, 1e-12)
    uu, uv = 1.0 + along * um * um, along * um * vm
    u, du = _stretched(-p[:, 0] / HEIGHT, (REACH - p[:, 0]) / HEIGHT, um, 2.0 * alpha * np.sqrt(uu))
    ridge = vm[:, None] + (uv / uu)[:, None] * (u - um[:, None])
    low, high = ((y - p[:, 1:2]) / HEIGHT for y in (-REACH, REACH))
    v, dv = _stretched(low, high, ridge, np.broadcast_to((2.0 * alpha * k / np.sqrt(uu))[:, None], u.shape))
    u = u[:, :, None]
    length2 = 1.0 + u * u + v * v
    cos_i = 1.0 / np.sqrt(length2)
    hx, hy, hz = (a[:, None, None] + b * cos_i for a, b in zip(wo.T, (u, v, 1.0), strict=True))
    slope2 = (hx * hx + hy * hy) / (hz * hz)
    cos2 = 1.0 / (1.0 + slope2)
    d = 1.0 / (np.pi * alpha**2 * cos2**2 * (1.0 + slope2 / alpha**2) ** 2)
    cos_o = wo[:, 2][:, None, None]
    masking = 1.0 / (1.0 + _smith(alpha, length2 - 1.0) + _smith(alpha, 1.0 / cos_o**2 - 1.0))
    return np.einsum("nij,ni,nij->n", d * masking / (4.0 * cos_o) * cos_i**3, du, dv)


def _case(name: str, roughness: float, view: View, what: str) -> Case:
    def scene() -> Scene:
        floor = rectangle(-90, 90, -90, 90, 0.0, mirror(roughness), "mirror")
        half_plane = rectangle(0, REACH, -REACH, REACH, HEIGHT, glow(lights=True), "half plane")
        return Scene(Group("root", [floor, half_plane]), view.camera(), [], DARK)

    def exact() -> np.ndarray:
        def radiance_at(px, py):
            p = view.on_floor(px, py).reshape(-1, 3)
            wo = view.world_from_camera[:3, 3] - p
            wo /= np.linalg.norm(wo, axis=-1, keepdims=True)
            return reflected(p, wo, roughness**2).reshape(px.shape)

        return filtered(view, radiance_at, 6)

    return Case(name, what, view, scene, exact, "reflection")


def cases() -> list[Case]:
    """Roughness 0.2, 0.35 and 0.5, from 30 to 65 degrees of incidence, the edge across and along the view."""
    steep = View(32, 8, look_at((-0.6, -1.0, 2.0), (-0.3, 0.0, 0.0)), 0.5)
    across = View(32, 8, look_at((-2.0, -0.2, 1.2), (-4.2 / 3, 0.0, 0.0), roll=np.pi / 2), 0.5)
    slanted = View(32, 8, look_at((0.3, -2.4, 1.6), (0.1, 0.0, 0.0), roll=0.2), 0.7)
    return [
        _case("rough mirror 0.2", 0.2, steep, "edge in a GGX mirror of roughness 0.2 seen at 27 degrees"),
        _case(
            "rough mirror 0.35", 0.35, slanted, "edge in a GGX mirror of roughness 0.35 seen at 63 degrees"
        ),
        _case("rough mirror 0.5", 0.5, across, "edge across the view in a GGX mirror of roughness 0.5"),
    ]
