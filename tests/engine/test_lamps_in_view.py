"""Lamps that the camera looks at, before the world and before surfaces, against random rays."""

from dataclasses import replace

import numpy as np
import pytest

from pointmr_engine import Camera, Group, Light, RenderSettings, Scene, render, uniform_world
from pointmr_engine.scene.group import CAMERA
from pointmr_engine.scene.settings import RaytraceSettings
from tests.engine.small_scenes import at, from_above, half_a_sky, quad
from tests.engine.test_wide_lamps import GREY

UP = at(0.3, 0.2, 1) @ np.diag([1.0, -1.0, -1.0, 1.0])
LAMPS = {
    "area": Light("AREA", UP, power=2.0, size_x=1.0),
    "disk": Light("AREA", UP, power=2.0, size_x=0.9, shape="DISK"),
    "point": Light("POINT", UP, power=4.0, radius=0.5),
    "ball": Light("POINT", UP, power=4.0, radius=0.5, soft_falloff=False),
    "spot": Light("SPOT", UP, power=4.0, radius=0.5, spot_angle=2.0),
    "sun": Light("SUN", UP, power=0.3, angle=0.3),
}
SETTINGS = RenderSettings(48, 36, samples=64, passes=("combined",))
FLOOR, SPECK = quad(6.0, z=-1.0, material=GREY), quad(0.1, z=-9.0, material=GREY)


def image(scene: Scene, **values) -> np.ndarray:
    return render(scene, replace(SETTINGS, **values)).passes["combined"].astype(float)


def close(scene: Scene, method: str, **values) -> None:
    exact, ours = (image(scene, method=m, **values) for m in ("distributed", method))
    assert exact[..., :3].max() > 0.3
    assert np.abs(ours - exact).mean() < 0.05 * exact[..., :3].mean()
    assert ours.mean((0, 1)) == pytest.approx(exact.mean((0, 1)), rel=0.03, abs=1e-3)


@pytest.mark.parametrize("method", ["raytrace", "forward"])
@pytest.mark.parametrize("name", LAMPS)
def test_before_the_world(name, method):
    scene = Scene(Group("root", [SPECK]), from_above(4.0), [LAMPS[name]], uniform_world((0.1, 0.1, 0.2)))
    close(scene, method)
    close(replace(scene, world=half_a_sky()), method)


@pytest.mark.parametrize("method", ["raytrace", "forward"])
@pytest.mark.parametrize("name", ["area", "disk", "ball"])
def test_before_a_floor(name, method):
    light = replace(LAMPS[name], cast_shadow=False)
    close(Scene(Group("root", [FLOOR]), from_above(4.0), [light], uniform_world((0.3, 0.3, 0.3))), method)


@pytest.mark.parametrize("method", ["raytrace", "forward"])
def test_behind_what_hides_it(method):
    scene = Scene(
        Group("root", [quad(6.0, z=2.0, material=GREY)]), from_above(4.0), [LAMPS["area"]], uniform_world((1, 1, 1))
    )  # fmt: skip
    lit, dark = image(scene, method=method), image(replace(scene, lights=[]), method=method)
    shown = image(replace(scene, root=Group("root", [SPECK])), method=method)
    assert shown[..., :3].max() > 1.5
    assert lit[..., :3].max() < 1.2 * dark[..., :3].max()


CAMERAS = {
    "orthographic": Camera(at(0, 0, 4), kind="ORTHOGRAPHIC", ortho_scale=3.0),
    "lens": from_above(4.0, fstop=0.2, focus_distance=2.0),
    "orthographic lens": Camera(
        at(0, 0, 4), kind="ORTHOGRAPHIC", ortho_scale=3.0, fstop=6.0, focus_distance=2.0
    ),
}


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("floor", [False, True])
def test_through_other_cameras(name, floor):
    group = Group("root", [FLOOR if floor else SPECK])
    close(Scene(group, CAMERAS[name], [LAMPS["area"]], uniform_world((0.1, 0.1, 0.2))), "raytrace")


@pytest.mark.parametrize("method", ["raytrace", "forward"])
def test_on_a_transparent_film(method):
    scene = Scene(Group("root", [SPECK]), from_above(4.0), [LAMPS["area"]], uniform_world((0.5, 0.5, 0.5)))
    close(scene, method, film_transparent=True)
    assert image(scene, method=method, film_transparent=True)[..., 3].max() < 0.5


def test_by_alpha():
    scene = Scene(Group("root", [FLOOR]), from_above(4.0), [LAMPS["area"]], uniform_world((0.1, 0.1, 0.2)))
    close(scene, "raytrace", raytrace=RaytraceSettings(visibility="alpha"))


@pytest.mark.parametrize("method", ["raytrace", "forward"])
def test_hidden_from_the_camera(method):
    hidden = replace(LAMPS["area"], visibility=LAMPS["area"].visibility & ~CAMERA)
    scene = Scene(Group("root", [SPECK]), from_above(4.0), [hidden], uniform_world((0.1, 0.1, 0.1)))
    assert image(scene, method=method)[..., :3].max() < 0.15


@pytest.mark.parametrize("method", ["raytrace", "forward"])
def test_tubes_are_as_thin_as_they_are(method):
    """Thinner than a pixel, level in the image: looks in rows found 1.12 times as much of it."""
    tube = Light("AREA", UP, power=2.0, shape="RECTANGLE", size_x=2.0, size_y=0.04)
    for turn in (0.0, 0.5):
        c, s = np.cos(turn), np.sin(turn)
        turned = UP @ np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        scene = Scene(Group("root", []), from_above(4.0), [replace(tube, world_from_light=turned)])
        exact, ours = (image(scene, method=m, samples=1024)[..., :3].mean() for m in ("distributed", method))
        assert ours == pytest.approx(exact, rel=0.04)
