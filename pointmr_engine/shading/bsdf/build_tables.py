"""Build tables.npz: albedos of GGX by quadrature, spectra of thin films.

Run `python -m pointmr_engine.shading.bsdf.build_tables`. The sheen table is kept; it comes from
`benchmarks/measure_sheen.py`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from pointmr_engine.numerics.jit import device
from pointmr_engine.shading.bsdf.albedo_tables import PATH, Tables
from pointmr_engine.shading.bsdf.fresnel import dielectric, f0_of_ior, ior_of_f0, remap
from pointmr_engine.shading.bsdf.microfacet import _visible_ggx
from pointmr_engine.shading.bsdf.thin_film import TABLE_RANGE
from pointmr_engine.shading.spectra import RGB_FROM_XYZ, observer

REFLECTION_SIZE = 32
SIZE = 16


@device
def _masking(alpha2, cosine):
    """Smith's lambda."""
    return 0.5 * (math.sqrt(1.0 + alpha2 * (1.0 / (cosine * cosine) - 1.0)) - 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def integrate(roughness, mu, ior, side):
    """Mean over visible normals, seen at cosine mu: (albedo reflecting, albedo of glass, dielectric and fifth-power
    mean mix of f0 and 1). ior is relative; `side` samples each way."""
    alpha = max(roughness, 1e-4) ** 2
    mu = max(mu, 1e-4)
    wi = (math.sqrt(1.0 - mu * mu), 0.0, mu)
    f0 = f0_of_ior(ior)
    g_i = 1.0 + _masking(alpha * alpha, mu)
    white = 0.0
    glass = 0.0
    dielectric_mix = 0.0
    schlick_mix = 0.0
    for a in range(side):
        for b in range(side):
            # a rank-one lattice: far more even than a grid
            u1 = (a * side + b + 0.5) / (side * side)
            u2 = ((a * side + b) * 0.6180339887498949 + 0.5) % 1.0
            h = _visible_ggx(wi, alpha, alpha, u2, u1)
            cos_h = wi[0] * h[0] + wi[2] * h[2]
            f, cos_t = dielectric(cos_h, ior)
            out = 2.0 * cos_h * h[2] - wi[2]
            if out > 0.0:
                ratio = g_i / (g_i + _masking(alpha * alpha, out))
                white += ratio
                glass += f * ratio
                dielectric_mix += remap(f, f0)
                schlick_mix += (1.0 - min(cos_h, 1.0)) ** 5
            if f < 1.0:
                out = (cos_h / ior + cos_t) * h[2] - wi[2] / ior
                if out < 0.0:
                    glass += (1.0 - f) * g_i / (g_i + _masking(alpha * alpha, out))
    n = side * side
    return white / n, glass / n, dielectric_mix / n, schlick_mix / n


@njit(cache=True, nogil=True, error_model="numpy")
def average(roughness, ior, side, steps):
    """Cosine-weighted means of the first two of `integrate` over the view."""
    white = 0.0
    glass = 0.0
    for k in range(steps):
        mu = math.sqrt((k + 0.5) / steps)
        w, g, _, _ = integrate(roughness, mu, ior, side)
        white += w
        glass += g
    return white / steps, glass / steps


def film_table(size: int = 512) -> np.ndarray:
    """(6, size): Fourier transforms of the colour matching functions, real then imaginary rgb, 1 at no path."""
    wavelength = np.linspace(380.0, 780.0, 1601)
    xyz = np.stack([np.interp(wavelength, np.linspace(380.0, 780.0, 81), x) for x in observer().T], axis=1)
    rgb = xyz @ RGB_FROM_XYZ.T
    path = np.linspace(0.0, TABLE_RANGE, size)
    transform = np.exp(-2j * math.pi * path[:, None] / wavelength) @ (rgb / rgb.sum(axis=0))
    return np.concatenate([transform.real.T, transform.imag.T])


def build(side: int = 128, steps: int = 64) -> dict[str, np.ndarray]:
    """All tables of GGX, as in `Tables`."""
    n, m = REFLECTION_SIZE, SIZE
    ggx = np.array(
        [[integrate(x / (n - 1), y / (n - 1), 1.5, 2 * side)[0] for x in range(n)] for y in range(n)]
    )
    ggx_average = np.array([average(x / (n - 1), 1.5, side, steps)[0] for x in range(n)])
    glass = np.empty((2, m, m, m))
    glass_average = np.empty((2, m, m))
    mix = np.empty((m, m, m))
    schlick = np.empty((m, m))
    for z in range(m):
        ior = ior_of_f0(min(max(z / (m - 1), 1e-4), 0.99) ** 4)
        for x in range(m):
            for inverse in range(2):
                eta = 1.0 / ior if inverse else ior
                glass_average[inverse, z, x] = average(x / (m - 1), eta, side, steps)[1]
                for y in range(m):
                    values = integrate(x / (m - 1), y / (m - 1), eta, side)
                    glass[inverse, z, y, x] = values[1]
                    if not inverse:
                        mix[z, y, x] = values[2]
                        schlick[y, x] = values[3]
    return {
        "ggx": ggx[None],
        "ggx_average": ggx_average[None, None],
        "glass": glass,
        "glass_average": glass_average,
        "schlick_dielectric": mix[None],
        "schlick": schlick[None],
        "film": film_table(),
    }


def main() -> None:
    """Write the tables beside this module."""
    tables = build()
    if PATH.exists():
        with np.load(PATH) as old:
            tables["sheen"] = old["sheen"]
    tables.setdefault("sheen", np.zeros((3, 32, 32)))
    np.savez_compressed(PATH, **{name: tables[name].astype(np.float32) for name in Tables._fields})


if __name__ == "__main__":
    main()
