"""The sheen table of shading/bsdf/tables.npz, measured on Cycles (Zeltner, Burley, Chiang 2022).

The lobe is a cosine lobe under a linear transform with two coefficients; for every node (roughness, cosine) they follow
from noise-free BSDF values in a few directions, and the albedo from the diffuse colour pass. Needs bpy.
Run `python -m benchmarks.measure_sheen`; it prints the residual and rewrites the table.
"""

from __future__ import annotations

import numpy as np

from benchmarks.bsdf_probe import probe
from pointmr_engine.shading.bsdf.albedo_tables import PATH

SIZE = 32
LIGHTS = np.array(
    [
        (0.9, 0.0, 0.435),
        (0.6, 0.5, 0.62),
        (0.25, -0.7, 0.66),
        (0.1, 0.0, 0.99),
        (0.97, 0.1, 0.2),
        (0.2, 0.9, 0.38),
        (0.05, 0.3, 0.95),
    ]
)
LIGHTS /= np.linalg.norm(LIGHTS, axis=1, keepdims=True)


def measure() -> tuple[np.ndarray, float]:
    """Table (3, roughness, cosine) of a, b, albedo, and the largest residual relative to the lobe's peak."""
    cosine = np.tile(np.arange(SIZE) / (SIZE - 1), SIZE)
    roughness = np.repeat(np.arange(SIZE) / (SIZE - 1), SIZE)
    sine = np.sqrt(1.0 - cosine**2)
    normal = np.stack([sine, np.zeros_like(sine), cosine], axis=1)
    up = np.tile([0.0, 0.0, 1.0], (len(normal), 1))
    attributes = {"roughness": roughness, "normal": normal}
    arguments = {"attributes": attributes, "inputs": {"color": (1.0, 1.0, 1.0)}, "correction": False}
    node = "ShaderNodeBsdfSheen"
    albedo = probe(node, up, LIGHTS[0], layer="Diffuse Color", **arguments)[:, 0]
    values = np.array([probe(node, up, light, **arguments)[:, 0] for light in LIGHTS])

    # local frame: z the normal, x toward the viewer, who is at +z of the world
    tangent = np.stack([-cosine, np.zeros_like(sine), sine], axis=1)
    x = LIGHTS @ tangent.T
    z = LIGHTS @ normal.T
    y = np.repeat(LIGHTS[:, 1:2], len(normal), axis=1)
    seen = albedo > 1e-5
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.sqrt(np.maximum(values, 0.0) * np.pi / (albedo * z))
    s = np.where(seen, s, 1.0)
    a, b = _fit(x, y, z, s)
    model = a / ((a * x + b * z) ** 2 + (a * y) ** 2 + z**2)
    residual = np.abs(np.where(seen, model - s, 0.0)).max(axis=0) / s.max(axis=0)
    table = np.stack([a, b, albedo]).reshape(3, SIZE, SIZE)
    seen = seen.reshape(SIZE, SIZE)
    for row in range(SIZE):  # unseen entries take the nearest seen ones' transform; their albedo stays 0
        known = np.flatnonzero(seen[row])
        if len(known):
            nearest = known[np.abs(np.arange(SIZE)[:, None] - known).argmin(axis=1)]
            table[:2, row] = table[:2, row, nearest]
    table[2][~seen] = 0.0
    # Cycles clamps the roughness to 0.001, so that the first row was seen 0.031 of the way to the second
    t = 1e-3 * (SIZE - 1)
    table[2, 0] = np.maximum((table[2, 0] - t * table[2, 1]) / (1.0 - t), 0.0)
    table[:2, 0] = table[:2, 1]
    return table, float(residual.max())


def _fit(x: np.ndarray, y: np.ndarray, z: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """a, b of each column with s = a / ((a x + b z)^2 + (a y)^2 + z^2), by grid search and Gauss-Newton."""
    weight = 1.0 / s.max(axis=0)

    def error(a, b):
        return (a / ((a * x + b * z) ** 2 + (a * y) ** 2 + z**2) - s) * weight

    grid_a, grid_b = (g.ravel() for g in np.meshgrid(np.geomspace(0.01, 1.5, 60), np.linspace(-1.0, 0.4, 57)))
    best = np.array([(error(p, q) ** 2).sum(axis=0) for p, q in zip(grid_a, grid_b, strict=True)]).argmin(
        axis=0
    )
    a, b = grid_a[best], grid_b[best]
    damping = np.full_like(a, 1e-3)
    cost = (error(a, b) ** 2).sum(axis=0)
    for _ in range(200):
        e = error(a, b)
        ja = (error(a * (1 + 1e-6), b) - e) / (a * 1e-6)
        jb = (error(a, b + 1e-7) - e) / 1e-7
        aa, ab, bb = (ja * ja).sum(axis=0), (ja * jb).sum(axis=0), (jb * jb).sum(axis=0)
        ga, gb = (ja * e).sum(axis=0), (jb * e).sum(axis=0)
        aa, bb = aa * (1 + damping), bb * (1 + damping)
        determinant = np.maximum(aa * bb - ab * ab, 1e-300)
        new_a = np.maximum(a - (bb * ga - ab * gb) / determinant, 1e-4)
        new_b = b - (aa * gb - ab * ga) / determinant
        new_cost = (error(new_a, new_b) ** 2).sum(axis=0)
        better = new_cost < cost
        a, b = np.where(better, new_a, a), np.where(better, new_b, b)
        cost = np.where(better, new_cost, cost)
        damping = np.where(better, damping * 0.3, damping * 5.0).clip(1e-12, 1e6)
    return a, b


def main() -> None:
    """Measure and store."""
    table, residual = measure()
    print(f"sheen: largest residual of the fit {residual:.1e} of the lobe's peak")
    with np.load(PATH) as file:
        tables = dict(file)
    tables["sheen"] = table.astype(np.float32)
    np.savez_compressed(PATH, **tables)


if __name__ == "__main__":
    main()
