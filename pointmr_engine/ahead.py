"""Ahead of the first render: compile the kernels of all default methods and keep them on disk.

    python -m pointmr_engine.ahead

A few small scenes are rendered that between them need most of what the methods can call. Whoever installs PointMR for
many (an image for a farm) runs it once; the add-on starts it in the background. It may run beside a renderer.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from pointmr_engine import (
    Camera,
    Group,
    Light,
    Material,
    Mesh,
    RenderSettings,
    Scene,
    emission,
    instance,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.warm import save_beside

METHODS = ("raytrace", "forward", "distributed")
_GRAINS = 3000  # triangles of what is far too fine for the image


def _place(x: float, y: float, z: float, pitch: float = 0.0) -> np.ndarray:
    c, s = np.cos(pitch), np.sin(pitch)
    return np.array([[1, 0, 0, x], [0, c, -s, y], [0, s, c, z], [0, 0, 0, 1]], float)


def _mesh(name: str, positions, triangles, material) -> Mesh:
    return Mesh(
        name,
        np.asarray(positions, np.float32),
        np.asarray(triangles, np.int32),
        materials=(material,),
    )


def _card(name: str, size: float, material, z: float = 0.0) -> Mesh:
    corners = [(-size, -size, z), (size, -size, z), (size, size, z), (-size, size, z)]
    return _mesh(name, corners, [(0, 1, 2), (0, 2, 3)], material)


def _bead(size: float, material, z: float) -> Mesh:
    """A smooth ball of eight triangles: behind so small a one of glass, rays see lamps blurred."""
    corners = np.float32([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
    sides = [(k, (k + 1) % 4, top) for k in range(4) for top in (4, 5)]
    triangles = [(a, b, c) if c == 4 else (b, a, c) for a, b, c in sides]
    bead = _mesh("bead", size * corners + np.float32((0.5, -2.0, z)), triangles, material)
    return replace(bead, normals=corners)


def _grains(material) -> Group:
    """A cloud of triangles that no view shows one by one."""
    rng = np.random.default_rng(1)
    middle = rng.normal(size=(_GRAINS, 1, 3))
    positions = (middle + 0.05 * rng.normal(size=(_GRAINS, 3, 3))).reshape(-1, 3)
    return Group("grains", [_mesh("grains", positions, np.arange(3 * _GRAINS).reshape(-1, 3), material)])


def _plot(material, grains: Group) -> Group:
    """Ground with clouds on it, for instances that no view shows in parts."""
    clouds = [instance(grains, _place(0.3 * x, 0.3 * y, 0.1)) for x in range(-3, 4) for y in range(-3, 4)]
    return Group("plot", [_card("ground", 1.0, material)], clouds)


def scenes() -> Iterator[Scene]:
    """Scenes with most of what kernels are compiled for: lamps of every kind, materials, instances, lens, worlds."""
    dull = principled("dull", base_color=(0.6, 0.5, 0.4), specular_ior_level=0.0)
    glossy = principled("glossy", roughness=0.3, metallic=0.5)
    glass = principled("glass", transmission_weight=1.0, roughness=0.1)
    veil = principled("veil", alpha=0.5)
    node = Node("glossy", {"color": (1.0, 1.0, 1.0), "roughness": 0.1}, {"distribution": "ggx"})
    metal = Material("metal", Graph({"bsdf": node}, surface=Link("bsdf", "bsdf")))
    node = Node("diffuse", {"color": (0.3, 0.4, 0.2)})
    soil = Material("soil", Graph({"bsdf": node}, surface=Link("bsdf", "bsdf")))
    floor, far = _card("floor", 5.0, dull), _grains(dull)
    camera = Camera(_place(0, -8, 5, 1.25))
    sky = uniform_world((0.3, 0.4, 0.5))
    placed = [instance(far, _place(3.0 * x - 4.5, 12.0, 0.0)) for x in range(4)]
    placed += [instance(_plot(soil, far), _place(4.0 * x - 60.0, 80.0, 0.0)) for x in range(30)]
    sun = Light("SUN", _place(0, 0, 5, 0.5), power=3.0, angle=0.0)
    yield Scene(Group("root", [floor, _card("roof", 1.0, dull, 1.0)], placed), camera, [sun], sky)
    things = [
        floor,
        _card("glossy", 1.0, glossy, 1.0),
        _card("glass", 0.7, glass, 2.0),
        _bead(0.5, glass, 1.0),
        _card("veil", 0.7, veil, 1.5),
        _card("metal", 0.5, metal, 0.5),
    ]
    wide = [
        Light("SUN", _place(0, 0, 5, 0.5), power=3.0, angle=0.2),
        Light("AREA", _place(0, 0, 5), power=50.0),
    ]
    yield Scene(Group("root", things, placed), camera, wide, sky)
    things.append(_card("lamp", 0.2, emission("lamp", strength=5.0), 3.0))
    lamps = [Light(kind, _place(0, 0, 4), power=50.0, radius=0.1) for kind in ("POINT", "SPOT", "AREA")]
    lens = Camera(_place(0, -8, 5, 1.25), fstop=0.1, focus_distance=4.0)
    yield Scene(Group("root", things, placed), lens, [*lamps, sun], sky)


def compile_methods(methods: tuple[str, ...] = METHODS) -> None:
    """Render the scenes by each of the methods, each other scene with diffuse bounces."""
    for number, scene in enumerate(scenes()):
        for method in methods:
            settings = RenderSettings(
                24, 18, method=method, samples=2, diffuse_bounces=number % 2, filter_glossy=1.0, threads=1
            )
            render(scene, settings)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="pointmr_engine.ahead",
        description="Compile the kernels of all default methods ahead of renders.",
    )
    parser.add_argument("--with-parent", action="store_true", help="end when the standard input ends")
    parser.add_argument("--note", type=Path, help="a file to make when it is done")
    args = parser.parse_args()
    saving = threading.Lock()
    if args.with_parent:
        if hasattr(os, "nice"):
            os.nice(10)

        def watch():
            sys.stdin.read()
            with saving:
                os._exit(0)

        threading.Thread(target=watch, daemon=True).start()
    save_beside(saving)
    compile_methods()
    if args.note:
        args.note.touch()


if __name__ == "__main__":
    main()
