"""Measures Hosek and Wilkie's sky in Cycles and fits their formula to it, for pointmr_engine/shading/hosek_sky.npz.

For every turbidity, albedo and elevation of the sun on a grid, a panorama of the sky is rendered, and for X, Y and Z
the nine coefficients of "An analytic model for full spectral sky-dome radiance" (2012) are found: four by a search, the
other five, in which the formula is linear, by least squares. Run it with the Blender wheel's Python.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import bpy
import numpy as np

from pointmr_engine.shading.sky_formulas import hosek_factors
from pointmr_engine.shading.spectra import RGB_FROM_XYZ

# 2.2 and 0.3 are Blender's defaults
TURBIDITIES = np.array([1.0, 2.0, 2.2, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0])
ALBEDOS = np.array([0.0, 0.3, 0.6, 1.0])
ELEVATIONS = np.pi / 2 * np.linspace(0.0, 1.0, 13) ** 3
WIDTH, HEIGHT = 48, 24
GOOD = 2e-4  # relative error at which a fit is not tried from other starts


def scene() -> bpy.types.ShaderNodeTexSky:
    """A world of nothing but sky, seen by a panoramic camera; the sky's node."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    s = bpy.context.scene
    s.world = bpy.data.worlds.new("sky")
    tree = s.world.node_tree
    tree.nodes.clear()
    sky, background = tree.nodes.new("ShaderNodeTexSky"), tree.nodes.new("ShaderNodeBackground")
    output = tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(sky.outputs[0], background.inputs[0])
    tree.links.new(background.outputs[0], output.inputs[0])
    sky.sky_type = "HOSEK_WILKIE"
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.panorama_type = "PANO", "EQUIRECTANGULAR"
    s.camera = bpy.data.objects.new("camera", camera)
    s.camera.rotation_euler = (np.pi / 2, 0, 0)
    s.collection.objects.link(s.camera)
    s.render.engine = "CYCLES"
    s.cycles.samples, s.cycles.use_adaptive_sampling, s.cycles.use_denoising = 1, False, False
    s.cycles.pixel_filter_type, s.cycles.filter_width = "GAUSSIAN", 0.01
    s.render.resolution_x, s.render.resolution_y, s.render.resolution_percentage = WIDTH, HEIGHT, 100
    s.render.image_settings.file_format, s.render.image_settings.color_depth = "OPEN_EXR", "32"
    return sky


def render(path: Path) -> np.ndarray:
    """The panorama (HEIGHT, WIDTH, 3), bottom row first."""
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    values = np.empty(WIDTH * HEIGHT * image.channels, np.float32)
    image.pixels.foreach_get(values)
    bpy.data.images.remove(image)
    return values.reshape(HEIGHT, WIDTH, -1)[..., :3].astype(np.float64)


def directions() -> np.ndarray:
    """(HEIGHT, WIDTH, 3) of the pixels: +y in the middle, x to the right."""
    u = np.pi * (1 - 2 * (np.arange(WIDTH) + 0.5) / WIDTH)
    v = np.pi * (1 - (np.arange(HEIGHT) + 0.5) / HEIGHT)
    azimuth, theta = np.meshgrid(u, v)
    return np.stack([-np.sin(theta) * np.sin(azimuth), np.sin(theta) * np.cos(azimuth), np.cos(theta)], -1)


def solve_linear(p: np.ndarray, theta: np.ndarray, gamma: np.ndarray, values: np.ndarray) -> tuple:
    """The five linear coefficients for given (A, B, E, H), and the relative residuals."""
    horizon, basis = hosek_factors(p, theta, gamma)
    weight = 1 / (values + 0.02 * values.mean())
    matrix = basis * (horizon * weight)[:, None]
    # a little damping: some terms nearly cancel
    scale = np.linalg.norm(matrix, axis=0)
    padded = np.concatenate([matrix / scale, 1e-5 * np.eye(5)])
    x = np.linalg.lstsq(padded, np.concatenate([values * weight, np.zeros(5)]), rcond=None)[0] / scale
    return x, matrix @ x - values * weight


def fit(theta: np.ndarray, gamma: np.ndarray, values: np.ndarray, starts: list[np.ndarray]) -> tuple:
    """(A, B, E, H, and the five linear ones) and the root mean square of the relative residuals: best of all starts."""
    best = (np.inf, starts[0], np.zeros(5))
    for start in starts:
        p, damping = start.copy(), 1e-2
        x, r = solve_linear(p, theta, gamma, values)
        for _ in range(60):
            steps = 1e-5 * np.maximum(np.abs(p), 0.1)
            jacobian = np.stack(
                [(solve_linear(p + s, theta, gamma, values)[1] - r) / s.sum() for s in np.diag(steps)], 1
            )
            normal = jacobian.T @ jacobian
            move = -np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), jacobian.T @ r)
            trial = np.clip(p + move, [-3, -3, -20, 0.0], [6, 1, 2, 0.97])
            y, q = solve_linear(trial, theta, gamma, values)
            if q @ q < r @ r:
                done = (r @ r - q @ q) < 1e-7 * (r @ r)
                p, x, r, damping = trial, y, q, damping * 0.3
                if done:
                    break
            else:
                damping *= 4
                if damping > 1e6:
                    break
        error = float(np.sqrt((r * r).mean()))
        if error < best[0]:
            best = (error, p, x)
        if error < GOOD:
            break
    return np.concatenate(best[1:]), best[0]


def main() -> None:
    """Measure, fit, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    output = parser.parse_args().output
    sky = scene()
    d = directions().reshape(-1, 3)
    # below the horizon the sky goes on with the horizon's first factor
    theta = np.minimum(np.arccos(d[:, 2]), np.pi / 2 - 0.001)
    xyz_from_rgb = np.linalg.inv(RGB_FROM_XYZ)
    found = np.zeros((len(TURBIDITIES), len(ALBEDOS), len(ELEVATIONS), 3, 9), np.float32)
    errors = np.zeros(found.shape[:-1])
    usual = [
        np.array([-1.1, -0.3, -2.0, 0.6]),
        np.array([-1.0, -0.15, -6.0, 0.8]),
        np.array([-0.5, -0.8, -0.5, 0.4]),
    ]
    with tempfile.TemporaryDirectory() as folder:
        for k, elevation in enumerate(ELEVATIONS):
            sun = np.array([0.0, np.cos(elevation), np.sin(elevation)])
            sky.sun_direction = tuple(sun)
            gamma = np.arccos(np.clip(d @ sun, -1, 1))
            for j, albedo in enumerate(ALBEDOS):
                sky.ground_albedo = albedo
                for i, turbidity in enumerate(TURBIDITIES):
                    sky.turbidity = turbidity
                    rgb = render(Path(folder) / "sky.exr").reshape(-1, 3)
                    use = (rgb > 0).all(1)
                    xyz = rgb[use] @ xyz_from_rgb.T
                    for c in range(3):
                        near = [found[i - 1, j, k, c, :4].astype(np.float64)] if i else []
                        near += [found[i, j, k - 1, c, :4].astype(np.float64)] if k else []
                        result = fit(theta[use], gamma[use], np.maximum(xyz[:, c], 1e-9), near + usual)
                        found[i, j, k, c], errors[i, j, k, c] = result
            print(f"elevation {np.degrees(elevation):.1f}: error mean {errors[:, :, k].mean():.4f} "
                  f"max {errors[:, :, k].max():.4f}", flush=True)  # fmt: skip
    np.savez_compressed(
        output, coefficients=found, turbidities=TURBIDITIES, albedos=ALBEDOS, elevations=ELEVATIONS
    )


if __name__ == "__main__":
    main()
