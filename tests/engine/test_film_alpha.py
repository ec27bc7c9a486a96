"""What is held out of the film, and what lies behind the far clipping plane, for every method."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.forward.scenes import look
from pointmr_engine import (
    Group,
    Material,
    RaytraceSettings,
    RenderSettings,
    Scene,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.scene.camera import Camera
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import HOLDOUT, VISIBLE, instance
from tests.engine.small_scenes import from_above, quad

GREY = principled(base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0)
SKY = uniform_world((1.0, 1.0, 1.0))
METHODS = ["distributed", "raytrace", "forward"]


def film(scene: Scene, method: str, transparent: bool = False, **raytrace) -> np.ndarray:
    """(24, 24, 4)."""
    settings = RenderSettings(
        24, 24, method=method, samples=64, film_transparent=transparent, raytrace=RaytraceSettings(**raytrace)
    )
    return render(scene, settings).passes["combined"]


def held_out(share: float) -> Material:
    """Grey, and a share of it a holdout."""
    nodes = {
        "hole": Node("holdout"),
        "grey": Node("diffuse", {"color": (0.8, 0.8, 0.8)}),
        "mix": Node(
            "mix_shader", {"fac": share, "shader": Link("grey", "bsdf"), "shader_b": Link("hole", "holdout")}
        ),
    }
    return Material("held", Graph(nodes, surface=Link("mix", "shader")))


@pytest.mark.parametrize("transparent", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_objects_that_are_held_out_are_holes_in_the_film(method, transparent):
    hole = instance(Group("hole", [quad(1.0, z=1.0)]), visibility=VISIBLE | HOLDOUT)
    scene = Scene(Group("root", [quad(9.0, material=GREY)], [hole]), from_above(4.0), [], SKY)
    found = film(scene, method, transparent)
    assert np.abs(found[11:13, 11:13]).max() < 1e-3
    np.testing.assert_allclose(found[2, 2, 3], 1.0, atol=1e-3)
    assert found[2, 2, 0] > 0.3


@pytest.mark.parametrize("share", [0.3, 1.0])
@pytest.mark.parametrize("visibility", ["masks", "alpha"])
@pytest.mark.parametrize("method", METHODS)
def test_shaders_hold_out_their_share(method, share, visibility):
    scene = Scene(Group("root", [quad(9.0, material=held_out(share))]), from_above(4.0), [], SKY)
    found = film(scene, method, visibility=visibility)[8:16, 8:16].mean((0, 1))
    np.testing.assert_allclose(found, [*3 * [0.8 * (1 - share)], 1 - share], atol=0.02)


@pytest.mark.parametrize("fstop", [0.0, 0.2])
@pytest.mark.parametrize("method", METHODS)
def test_what_lies_behind_the_far_clipping_plane_is_not_seen(method, fstop):
    """A floor that goes on to the horizon, in two triangles: the camera sees it up to ten metres."""
    camera = Camera(look((0, 0, 1), (0, 10, 1)), clip_end=10.0, fstop=fstop, focus_distance=5.0)
    scene = Scene(Group("root", [quad(200.0, material=GREY)]), camera, [], uniform_world((0, 0, 1)))
    found = film(scene, method)
    far = film(replace(scene, camera=replace(camera, clip_end=1000.0)), method)
    assert (
        far[9:11].mean((0, 1))[2] < 0.9 and found[9:11].mean((0, 1))[2] > 0.98
    )  # 14 to 23 metres away: the sky
    np.testing.assert_allclose(found[:5].mean(), far[:5].mean(), rtol=0.02)
