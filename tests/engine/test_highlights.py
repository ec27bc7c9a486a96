"""Highlights of lamps about as wide as the lobes that show them: as bright in their middle and far beside it."""

import math

import numpy as np
import pytest

from benchmarks.forward.scenes import look
from pointmr_engine import Camera, Group, Light, Scene, principled
from tests.engine.small_scenes import quad
from tests.engine.test_raytrace_light import DARK, image

MIDDLE = np.s_[12:24, 18:30]
AT = look((-3 * math.sin(0.9), 0.2, 3 * math.cos(0.9)), (0.0, 0.0, 0.0))  # the lamp


def highlight(light: Light, roughness: float, view: float) -> tuple[Scene, float]:
    """A metal plane that is seen at an angle to its normal, and how bright its middle is by random rays."""
    metal = principled(base_color=(0.8, 0.8, 0.8), metallic=1.0, roughness=roughness)
    eye = Camera(look((6 * math.sin(view), 0.0, 6 * math.cos(view)), (0.0, 0.0, 0.0)))
    scene = Scene(Group("root", [quad(4.0, material=metal)]), eye, [light], DARK)
    return scene, image(scene, method="distributed", samples=256)[MIDDLE].mean()


@pytest.mark.parametrize("view", [0.9, 1.0, 1.1, 1.3, 0.3])
@pytest.mark.parametrize("roughness", [0.1, 0.2])
@pytest.mark.parametrize("kind", ["SUN", "POINT"])
def test_highlights_are_as_wide_as_their_lobes(kind, roughness, view):
    """One point for a lamp, and a lobe wider by it, was up to 1.77 times too bright about the middle: a lamp of a tenth
    of a metre does so three metres off.
    """
    light = (
        Light(kind, AT, power=3.0, angle=0.05) if kind == "SUN" else Light(kind, AT, power=300.0, radius=0.1)
    )
    scene, exact = highlight(light, roughness, view)
    assert image(scene)[MIDDLE].mean() == pytest.approx(exact, rel=0.1)


@pytest.mark.parametrize("view", [1.0, 1.3])
def test_a_suns_highlights_by_forward_mapping(view):
    scene, exact = highlight(Light("SUN", AT, power=3.0, angle=0.05), 0.2, view)
    assert image(scene, method="forward")[MIDDLE].mean() == pytest.approx(exact, rel=0.03)
