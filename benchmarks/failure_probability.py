"""How often images of random points have holes, beside the probability that was promised.

    python -m benchmarks.failure_probability [--seeds 4000] [--output docs/benchmarks/failure_probability.md]

Instances of a bumpy sphere before a wall are drawn at the density that `sample_count` gives for a failure
probability f, with one seed after another. A hole is a pixel whose nearest point lies deeper than the surface there, or
that has no point at all. What the surface is, rays tell: 4 x 4 of them through each pixel, its corners among them. Only
pixels count in which all of them hit the same placement at depths that differ little, since f is a promise for pixels
that one surface covers; the depth allowed is the farthest of them. Nothing is drawn again. The bound counts a hole in
any of all pixels; the share of images with a hole must not exceed f.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from pointmr_engine.forward.drawing.cut_outs import no_cut_outs
from pointmr_engine.forward.drawing.subpixels import allocate_target, clear, make_view
from pointmr_engine.forward.points_method import make_draws
from pointmr_engine.forward.selection.dynamic import PointScratch, sample_tile
from pointmr_engine.forward.selection.point_draws import World
from pointmr_engine.forward.selection.sample_count import points_per_pixel
from pointmr_engine.hierarchy.acceleration import build_acceleration
from pointmr_engine.hierarchy.distribution import build_distribution
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.hierarchy.octree import build_octree, triangle_corners
from pointmr_engine.raytracing import walk
from pointmr_engine.raytracing.camera import camera_ray, compile_camera
from pointmr_engine.raytracing.rays import allocate_hits, allocate_rays
from pointmr_engine.scene.camera import Camera
from pointmr_engine.scene.group import Group, Instances
from pointmr_engine.scene.mesh import Mesh
from pointmr_engine.scene.scene import Scene
from pointmr_engine.scene.settings import ForwardSettings, RenderSettings

WIDTH, HEIGHT = 32, 24
ACROSS = 4  # rays per side of a pixel
SAME = 0.05  # relative: depths in a pixel that differ by more are not one surface
TOLERANCE = 1e-3  # relative, beyond the farthest of them


def bumpy_sphere(rings: int = 160) -> Mesh:
    """A closed mesh of about 2 rings^2 triangles, smaller than a point's share at the benchmark's size."""
    theta, phi = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, rings, endpoint=False), indexing="ij"
    )
    p = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    p *= 1 + 0.1 * (np.sin(9 * p[:, :1]) * np.sin(8 * p[:, 1:2]) * np.cos(7 * p[:, 2:]))
    k = np.arange(rings * rings)
    row, column = k // rings, k % rings
    a, b = row * rings + column, row * rings + (column + 1) % rings
    triangles = np.concatenate([np.stack([a, a + rings, b], 1), np.stack([b, a + rings, b + rings], 1)])
    return Mesh("bumpy sphere", p.astype(np.float32), triangles.astype(np.int32))


def scene(placements: int = 60) -> Group:
    """Turned and scaled placements in front of each other, over a wall that fills the view."""
    rng = np.random.default_rng(1)
    q, _ = np.linalg.qr(rng.normal(size=(placements, 3, 3)))
    m = np.concatenate(
        [
            q * rng.uniform(0.7, 1.4, (placements, 1, 1)),
            rng.uniform(-1, 1, (placements, 3, 1)) * [[4], [3], [3]],
        ],
        2,
    )
    n = 400
    x, y = np.meshgrid(np.linspace(-9, 9, n + 1), np.linspace(-9, 9, n + 1))
    wall = np.stack([x, y, -4.0 + 0.3 * np.sin(2 * x) * np.sin(3 * y)], -1).reshape(-1, 3).astype(np.float32)
    k = np.arange(n * n)
    a = k // n * (n + 1) + k % n
    faces = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    return Group(
        "root",
        [Mesh("wall", wall, faces.astype(np.int32))],
        [Instances((Group("sphere", [bumpy_sphere()]),), np.ascontiguousarray(m))],
    )


def exact_depths(geometry, camera) -> tuple[np.ndarray, np.ndarray]:
    """(farthest z (H, W) that rays through each pixel hit, (H, W) bool: one surface covers the pixel)."""
    step = np.linspace(1e-3, 1 - 1e-3, ACROSS)
    y, x, v, u = np.meshgrid(np.arange(HEIGHT), np.arange(WIDTH), step, step, indexing="ij")
    x, y = (x + u).ravel(), (y + v).ravel()
    rays, hits = allocate_rays(len(x)), allocate_hits(len(x))
    width, spread = np.empty(len(x), np.float32), np.empty(len(x), np.float32)
    for k in range(len(x)):
        camera_ray(camera, x[k], y[k], 0.5, 0.5, rays, k, width, spread)
    walk.intersect(build_acceleration(geometry), rays, hits)
    z = rays.origin + rays.direction * hits.t[:, None]
    z = (z @ camera.camera_from_world[2, :3] + camera.camera_from_world[2, 3]).reshape(HEIGHT, WIDTH, -1)
    path = hits.path.reshape(z.shape)
    one = np.isfinite(z).all(2) & (path == path[:, :, :1]).all(2) & (z.max(2) <= (1 + SAME) * z.min(2))
    return z.max(2), one


def holes(geometry, octree, distribution, camera, draws: str, failure: float, seeds: int, farthest, one):
    """(images with a hole, holes, points drawn per pixel) of `seeds` images."""
    options = ForwardSettings(draws=draws, failure=failure, reconstruction="pixel")
    how = make_draws(options, 1, WIDTH * HEIGHT)._replace(kept=np.inf)
    world = World(
        octree.arrays, distribution, triangle_corners(octree), geometry.tables, geometry.instances,
        no_cut_outs(len(geometry.parts)),
    )  # fmt: skip
    view, target = make_view(camera, 1, (1.0, 30.0)), allocate_target(WIDTH, HEIGHT)
    scratch = PointScratch(target, geometry.depth)
    images = pixels = 0
    for seed in range(seeds):
        clear(target, WIDTH)
        sample_tile(view, world, camera.camera_from_world, how, seed, (0, 0, WIDTH, HEIGHT), scratch, True, 1)
        nearness = target.depth[:HEIGHT, :WIDTH]
        z = np.divide(1.0, nearness, out=np.full(nearness.shape, np.inf), where=nearness > 0)
        found = int(((z > farthest * (1 + TOLERANCE)) & one).sum())
        images += found > 0
        pixels += found
    drawn = int(scratch.counters[scratch.names.index("points_drawn")])
    return images, pixels, drawn / seeds / (WIDTH * HEIGHT)


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4000)
    parser.add_argument("--output", type=Path, default=Path("docs/benchmarks/failure_probability.md"))
    options = parser.parse_args()
    geometry = compile_geometry(Scene(scene()))
    octree = build_octree(geometry)
    distribution = build_distribution(octree)
    world = np.eye(4)
    world[2, 3] = 14.0
    camera = compile_camera(
        Camera(world, focal_length=40.0), RenderSettings(width=WIDTH, height=HEIGHT, method="forward")
    )
    farthest, one = exact_depths(geometry, camera)
    lines = [
        "# Holes in images of random points",
        "",
        f"`python -m benchmarks.failure_probability --seeds {options.seeds}`: {options.seeds} seeds of a",
        f"{WIDTH}x{HEIGHT} image of {geometry.instanced_triangles:,} triangles ({int(one.sum())} of {one.size} pixels",
        "are covered by one surface alone and count).",
        "A hole is a pixel without a point, or with none on the surface that all of 16 rays through it hit;",
        "counted before anything is drawn again.",
        "f is what the density promises at most for all pixels together (`forward/selection/sample_count.py`).",
        "",
        "| draws | f | points per pixel of area | drawn per pixel | images with a hole | holes per 1000 images |",
        "|---|---|---|---|---|---|",
    ]
    for draws in ("random", "stratified"):
        for failure in (0.5, 0.1, 0.01):
            images, pixels, drawn = holes(
                geometry, octree, distribution, camera, draws, failure, options.seeds, farthest, one
            )
            density = points_per_pixel(draws, WIDTH * HEIGHT, failure)
            lines.append(
                f"| {draws} | {failure:g} | {density:.1f} | {drawn:.0f} | {images / options.seeds:.2%} "
                f"| {1000 * pixels / options.seeds:.2f} |"
            )
            print(lines[-1], flush=True)
    options.output.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
