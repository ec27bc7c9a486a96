"""Rays a second on a scanned mesh, beside Embree on one thread: `python -m benchmarks.speed_rays [--size 512]`.

Both see the same float32 mesh and the same rays, in turn, several times; a rate is that of the fastest round in
processor time, for the machine may have other work. Agreement of the hits is checked in the same run.
"""

from __future__ import annotations

import argparse
import gzip
import json
import time
from pathlib import Path

import numpy as np

from benchmarks.sources import scenes_folder


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """(positions (V, 3) float32, triangles (T, 3) int32) of an ASCII .ply or .ply.gz file of triangles."""
    with gzip.open(path) if path.suffix == ".gz" else open(path, "rb") as file:
        counts = {}
        while (line := file.readline().split()) != [b"end_header"]:
            if not line:
                raise ValueError(f"{path}: no PLY header")
            if line[0] == b"element":
                counts[line[1]] = int(line[2])
        lines = file.read().split(b"\n")
    v, t = counts[b"vertex"], counts[b"face"]
    positions = np.array([row.split()[:3] for row in lines[:v]], np.float32)
    return positions, np.array([row.split()[1:4] for row in lines[v : v + t]], np.int32)


def sphere(rings: int) -> tuple[np.ndarray, np.ndarray]:
    """A bumpy sphere of about 4 rings^2 triangles, where no scan is at hand."""
    n = 2 * rings
    theta, phi = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, n + 1), indexing="ij"
    )
    radius = 1 + 0.02 * np.sin(40 * theta) * np.sin(40 * phi)
    p = (
        np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
        * radius[..., None]
    )
    i = (np.arange(rings)[:, None] * (n + 1) + np.arange(n)).ravel()
    t = np.concatenate([np.stack([i, i + n + 1, i + 1], 1), np.stack([i + 1, i + n + 1, i + n + 2], 1)])
    return p.reshape(-1, 3).astype(np.float32), t.astype(np.int32)


def camera_rays(positions: np.ndarray, size: int, zoom: float) -> tuple[np.ndarray, np.ndarray]:
    """Origin (3,) and directions (size^2, 3) float64 of a pinhole view of the mesh, in tiles of 32 x 32."""
    lower, upper = positions.min(0).astype(float), positions.max(0).astype(float)
    center, extent = (lower + upper) / 2, (upper - lower).max()
    eye = center + np.array([0.3, 0.3, 1.6]) * extent
    forward = (center - eye) / np.linalg.norm(center - eye)
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    at = (np.arange(size) + 0.5) / size - 0.5
    d = forward + zoom * (at[None, :, None] * right + at[:, None, None] * np.cross(right, forward))
    d = d.reshape(size // 32, 32, size // 32, 32, 3).swapaxes(1, 2).reshape(-1, 3)
    return eye, d / np.linalg.norm(d, axis=1, keepdims=True)


def bounce(origin, direction, t, triangle, positions, triangles) -> tuple[np.ndarray, np.ndarray]:
    """Diffuse rays from where camera rays hit, just off the surface."""
    k = triangle >= 0
    p = positions[triangles[triangle[k]]].astype(float)
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal *= -np.sign((normal * direction[k]).sum(1, keepdims=True))
    away = np.random.default_rng(0).normal(size=normal.shape)
    away = away / np.linalg.norm(away, axis=1, keepdims=True) + normal
    start = origin + direction[k] * t[k, None] + normal * 1e-5 * np.ptp(positions)
    return start, away / np.linalg.norm(away, axis=1, keepdims=True)


def fastest(rounds: int, *work) -> list[float]:
    """Least processor time of each function, called in turn."""
    best = [np.inf] * len(work)
    for _ in range(rounds):
        for i, function in enumerate(work):
            start = time.thread_time()
            function()
            best[i] = min(best[i], time.thread_time() - start)
    return best


def measure(positions: np.ndarray, triangles: np.ndarray, size: int = 512, rounds: int = 7) -> dict:
    """Build time, rates of both in rays/s, their ratios, and how far the hits agree."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    from pointmr_engine.hierarchy.acceleration import build_acceleration
    from pointmr_engine.hierarchy.geometry import compile_geometry
    from pointmr_engine.raytracing import walk
    from pointmr_engine.raytracing.rays import allocate_hits, allocate_rays
    from pointmr_engine.scene.group import Group
    from pointmr_engine.scene.mesh import Mesh
    from pointmr_engine.scene.scene import Scene

    def accelerate(count: int):
        return build_acceleration(
            compile_geometry(Scene(Group("root", [Mesh("mesh", positions, triangles[:count])])))
        )

    accelerate(100)  # compiled before it is measured
    start = time.thread_time()
    acceleration = accelerate(len(triangles))
    result = {"triangles": len(triangles), "build_s": time.thread_time() - start}
    embree = rtcore_scene.EmbreeScene()
    TriangleMesh(embree, positions, triangles)

    def compare(name: str, origin: np.ndarray, direction: np.ndarray):
        n = len(direction)
        rays, hits = allocate_rays(n), allocate_hits(n)
        rays.origin[:], rays.direction[:] = origin, direction
        o, d = rays.origin.astype(np.float32), direction.astype(np.float32)
        found = embree.run(o[:1], d[:1], query="INTERSECT", output=1)
        walk.intersect(acceleration, rays, hits, 0, 1)
        theirs, ours = fastest(
            rounds,
            lambda: embree.run(o, d, query="INTERSECT", output=1),
            lambda: walk.intersect(acceleration, rays, hits),
        )
        found = embree.run(o, d, query="INTERSECT", output=1)
        result[name] = {
            "rays": n,
            "hit": float((hits.triangle >= 0).mean()),
            "ours_per_s": n / ours,
            "embree_per_s": n / theirs,
            "ratio": theirs / ours,
            "same_triangle": float((found["primID"] == hits.triangle).mean()),
            "hit_or_miss_differs": int(((found["primID"] >= 0) != (hits.triangle >= 0)).sum()),
        }
        walk.shadow(acceleration, rays, hits, 0, 1)
        theirs, ours = fastest(
            rounds, lambda: embree.run(o, d, query="OCCLUDED"), lambda: walk.shadow(acceleration, rays, hits)
        )
        result[name] |= {
            "shadow_ours_per_s": n / ours,
            "shadow_embree_per_s": n / theirs,
            "shadow_ratio": theirs / ours,
        }
        walk.intersect(acceleration, rays, hits)
        return hits

    eye, direction = camera_rays(positions, size, 0.75)
    compare("whole_object", eye, direction)
    eye, direction = camera_rays(positions, size, 0.3)
    hits = compare("close_up", eye, direction)
    start, away = bounce(eye, direction, hits.t, hits.triangle, positions, triangles)
    compare("diffuse_bounce", start, away)
    return result


def main() -> None:
    """Print the figures as a table, and as JSON with --json."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--mesh", type=Path, help="a .ply or .ply.gz; else the scanned dragon of POINTMR_SCENES"
    )
    parser.add_argument("--size", type=int, default=512, help="side of the image in pixels, a multiple of 32")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path, help="write the figures here")
    arguments = parser.parse_args()
    folder = scenes_folder()
    path = arguments.mesh or (folder / "scans" / "dragon_vrip.ply.gz" if folder else None)
    mesh = read_ply(path) if path is not None and path.exists() else sphere(466)
    result = measure(*mesh, arguments.size, arguments.rounds)
    print(f"{result['triangles']} triangles, built in {result['build_s']:.2f} s (one thread)")
    print(
        f"{'rays':16}{'hit':>6}{'ours M/s':>10}{'Embree':>8}{'ratio':>7}"
        f"{'shadow M/s':>12}{'Embree':>8}{'ratio':>7}  same hit"
    )
    for name, r in result.items():
        if isinstance(r, dict):
            print(
                f"{name:16}{r['hit']:6.2f}{r['ours_per_s'] / 1e6:10.2f}{r['embree_per_s'] / 1e6:8.2f}{r['ratio']:7.2f}"
                f"{r['shadow_ours_per_s'] / 1e6:12.2f}{r['shadow_embree_per_s'] / 1e6:8.2f}{r['shadow_ratio']:7.2f}"
                f"  {r['same_triangle']:.5f}"
            )
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
