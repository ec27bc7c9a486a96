"""Diffuse light that bounces, beside Cycles: a box with coloured walls under a lamp, and under a sky."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from benchmarks.features import stage  # noqa: E402
from tests.addon.beside_cycles import image  # noqa: E402

pytestmark = pytest.mark.usefixtures("engine")

SIZE = (48, 36)
INSIDE = np.s_[4:32, 8:40]
WALLS = {
    "floor": ([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], (0.8, 0.8, 0.8)),
    "back": ([(-1, 1, 0), (1, 1, 0), (1, 1, 2), (-1, 1, 2)], (0.8, 0.8, 0.8)),
    "left": ([(-1, 1, 0), (-1, 1, 2), (-1, -1, 2), (-1, -1, 0)], (0.8, 0.1, 0.1)),
    "right": ([(1, 1, 0), (1, -1, 0), (1, -1, 2), (1, 1, 2)], (0.1, 0.8, 0.1)),
    "top": ([(-1, -1, 2), (-1, 1, 2), (1, 1, 2), (1, -1, 2)], (0.8, 0.8, 0.8)),
}


def build(lit_by: str) -> None:
    """The box, open to the camera, with a block of the default material in it."""
    stage.empty_scene()
    for name, (corners, color) in WALLS.items():
        wall = stage.principled(name, Base_Color=color, Specular_IOR_Level=0.0)
        stage.mesh_object(name, corners, [(0, 1, 2, 3)], wall)
    bpy.ops.mesh.primitive_cube_add(size=0.7, location=(0.2, 0.2, 0.35), rotation=(0, 0, 0.4))
    if lit_by == "sky":
        stage.world()
    else:
        stage.lamp("AREA", 20.0, at=(0, 0, 1.9), target=(0, 0, 0), size=0.5)
    stage.camera(at=(0, -4.2, 1.0), target=(0, 0, 1.0))


def picture(path, method: str, samples: int, bounces: int) -> np.ndarray:
    """Means (7, 8, 3) of 4 x 4 pixels of the box' inside."""
    part = image(path, method, samples, SIZE, diffuse_bounces=bounces)[INSIDE]
    return part.reshape(7, 4, 8, 4, 3).mean((1, 3))


@pytest.mark.parametrize("lit_by", ["lamp", "sky"])
def test_walls_light_each_other_as_in_cycles(lit_by, tmp_path):
    build(lit_by)
    direct = picture(tmp_path / "direct.exr", "cycles", 512, 0)
    for bounces in (1, 3):
        truth = picture(tmp_path / "cycles.exr", "cycles", 512, bounces)
        assert truth.mean() > 1.1 * direct.mean()
        for method, samples in (("distributed", 256), ("raytrace", 16)):
            found = picture(tmp_path / "ours.exr", method, samples, bounces)
            assert found.mean() == pytest.approx(truth.mean(), rel=0.01)
            assert np.sqrt((((found - truth) / truth.mean((0, 1))) ** 2).mean()) < 0.02, method
