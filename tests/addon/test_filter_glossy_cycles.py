"""Filter Glossy beside Cycles': what lights a floor by way of metal and glass."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from benchmarks.features import stage  # noqa: E402
from tests.addon.beside_cycles import image  # noqa: E402

pytestmark = pytest.mark.usefixtures("engine")

SIZE = (48, 48)
MATERIALS = {
    "metal": dict(Metallic=1.0, Roughness=0.0),
    "satin": dict(Metallic=1.0, Roughness=0.15),
    "glass": dict(Transmission_Weight=1.0, Roughness=0.0),
}


def build(material: str) -> None:
    """A block on a matt floor under a small sun."""
    stage.empty_scene()
    stage.plane(stage.matte(stage.CREAM), (0, 0, -0.5), 20.0)
    stage.cube(
        stage.principled(material, Base_Color=stage.GOLD, **MATERIALS[material]), (0, 0, 0.02), 1.0, bevel=0.0
    )
    stage.lamp("SUN", 3.0, (3.0, -2.0, 3.5), (0, 0, 0), angle=0.009)
    stage.camera((0, -5.35, 2.72), (0, 0, 0), 60.0)


def picture(path, method: str, samples: int, blur: float) -> np.ndarray:
    """Means (12, 12, 3) of 4 x 4 pixels."""
    part = image(path, method, samples, SIZE, diffuse_bounces=3, blur_glossy=blur)
    return part.reshape(12, 4, 12, 4, 3).mean((1, 3))


@pytest.mark.parametrize("material", MATERIALS)
def test_blocks_light_floors_as_in_cycles(material, tmp_path):
    build(material)
    for blur in (1.0, 10.0):
        truth = picture(tmp_path / "cycles.exr", "cycles", 512, blur)
        for method, samples in (("distributed", 256), ("raytrace", 4)):
            found = picture(tmp_path / "ours.exr", method, samples, blur)
            assert found.mean() == pytest.approx(truth.mean(), rel=0.01), method
            assert np.sqrt(((found - truth) ** 2).mean()) < 0.025 * truth.mean(), method
