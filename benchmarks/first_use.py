"""Time to the first image: cold (no compiled kernel on disk), cold without the second process, and warm.

    python -m benchmarks.first_use [FILE.blend] [--repeat N]

Each case is a process of its own with its own folder for kernels, from the start of Python to the end of a render of
64 x 48 pixels by method distributed: of a small scene made here, or of FILE.blend through the `pointmr` command. Beside
the wall time stand the processor times of the renderer, which is what an idle machine would take, and of the second
process.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SIZE = (64, 48)


def render_small_scene() -> None:
    """Render a floor and three spheres' worth of materials under a lamp and a sky."""
    import numpy as np

    from pointmr_engine import (
        Camera,
        Group,
        Light,
        Mesh,
        RenderSettings,
        Scene,
        principled,
        render,
        uniform_world,
    )

    def quad(z, size, material):
        s = size / 2
        corners = np.array([[-s, -s, z], [s, -s, z], [s, s, z], [-s, s, z]], np.float32)
        return Mesh(material.name, corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), materials=(material,))

    above, lamp = np.eye(4), np.eye(4)
    above[2, 3], lamp[:3, 3] = 5.0, (1.0, 1.0, 3.0)
    meshes = [
        quad(0.0, 10.0, principled("floor", base_color=(0.8, 0.7, 0.6))),
        quad(0.5, 1.0, principled("glass", transmission_weight=1.0, roughness=0.0)),
        quad(1.0, 0.5, principled("metal", metallic=1.0, roughness=0.2)),
    ]
    lights = [Light("POINT", lamp, power=300.0, radius=0.3)]
    scene = Scene(Group("root", meshes), Camera(above), lights, uniform_world((0.3, 0.4, 0.5)))
    render(scene, RenderSettings(*SIZE, method="distributed", samples=4))


def command(blend: Path | None, alone: bool) -> list[str]:
    """Python and its arguments for one case."""
    code = "import atexit, os, sys; atexit.register(lambda: print(*os.times()[:4])); "
    if alone:
        code += "from pointmr_engine import warm; warm.Helper.start = lambda self, python=None: None; "
    if blend is None:
        code += "from benchmarks.first_use import render_small_scene; render_small_scene()"
        return [sys.executable, "-c", code]
    code += "from blender_addon.cli import main; sys.exit(main(sys.argv[1:]))"
    size = f"{SIZE[0]}x{SIZE[1]}"
    output = str(Path(tempfile.gettempdir()) / "first_use.exr")
    arguments = ["--size", size, "--method", "distributed", "--samples", "1", "-o", output]
    return [sys.executable, "-c", code, "render", str(blend), *arguments]


def measure(name: str, arguments: list[str], kernels: str) -> None:
    """Run one case and print its times."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": kernels}
    start = time.perf_counter()
    done = subprocess.run(arguments, check=True, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)
    wall = time.perf_counter() - start
    user, system, user_2, system_2 = map(float, done.stdout.splitlines()[-1].split())
    print(f"{name:>20} {wall:6.1f} {user + system:9.1f} {user_2 + system_2:9.1f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", nargs="?", type=Path, metavar="FILE.blend")
    parser.add_argument("--repeat", type=int, default=1, metavar="N")
    options = parser.parse_args()
    blend = options.file.resolve() if options.file else None
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; seconds:")
    print(f"{'':20}   wall  renderer    helper")
    for _ in range(options.repeat):
        for name, alone in (("cold, one process", True), ("cold", False)):
            with tempfile.TemporaryDirectory() as kernels:
                measure(name, command(blend, alone), kernels)
                if not alone:
                    for _ in range(2):  # what the two processes missed is compiled by the first of these
                        measure("warm", command(blend, alone), kernels)


if __name__ == "__main__":
    main()
