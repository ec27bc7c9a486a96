"""Mirrors that bend, seen as lobes: they show no lamp that is a point, and are mirrors to materials."""

import numpy as np
import pytest

from benchmarks.forward.scenes import look
from pointmr_engine import Camera, Group, Light, Material, Mesh, Scene, principled
from pointmr_engine.multires.cones.cones import allocate_cones
from pointmr_engine.multires.lobes import lobe_cones, lobe_view
from pointmr_engine.render import Cache
from pointmr_engine.scene.graph import Graph, Link, Node
from tests.engine.small_scenes import quad
from tests.engine.test_raytrace_glass import ball
from tests.engine.test_raytrace_light import DARK, image

EYE = Camera(look((0.0, -6.0, 2.0), (0.0, 0.0, 0.0)))


@pytest.mark.parametrize("method", ["raytrace", "forward"])
@pytest.mark.parametrize("kind", ["POINT", "SUN"])
def test_polish_shows_no_lamp_that_is_a_point(method, kind):
    polished = principled(base_color=(0.3, 0.3, 0.3), roughness=0.0, ior=1.8)
    size = {"radius": 0.0} if kind == "POINT" else {"angle": 0.0}
    lamp = Light(kind, look((-3, -3, 4), (0, 0, 0)), power=500.0 if kind == "POINT" else 3.0, **size)
    scene = Scene(Group("root", [ball(polished)]), EYE, [lamp], DARK)
    cache = Cache()
    exact = image(scene, cache, method="distributed", samples=64)
    assert image(scene, cache, method=method).max() < 1.1 * exact.max()


def bevelled() -> Mesh:
    """Two faces and a narrow bent strip between them, with smooth normals."""
    angle = np.linspace(-0.8, 0.8, 9)
    edge = 0.06 * np.stack([np.sin(angle), np.cos(angle)], 1)
    profile = np.concatenate([edge[:1] + [[-0.7, -0.7]], edge, edge[-1:] + [[0.7, -0.7]]])
    x, z = profile.T
    n = len(profile)
    positions = np.concatenate([np.stack([x, np.full(n, y), z], 1) for y in (-1.0, 1.0)]).astype(np.float32)
    turn = np.concatenate([angle[:1], angle, angle[-1:]])
    normal = np.stack([np.sin(turn), np.zeros(n), np.cos(turn)], 1).astype(np.float32)
    k = np.arange(n - 1)
    triangles = np.concatenate([np.stack([k, k + 1, k + n], 1), np.stack([k + 1, k + n + 1, k + n], 1)])
    return Mesh("bevelled", positions, triangles.astype(np.int32), normals=np.tile(normal, (2, 1)))


def test_rays_of_bent_mirrors_are_singular_to_materials():
    """A wall that only singular rays see lit, in the bent edge of a mirror."""
    nodes = {
        "path": Node("light_path"),
        "e": Node("emission", {"strength": Link("path", "is_singular_ray")}),
    }
    lit = Material("lit", Graph(nodes, surface=Link("e", "emission")), emission_sampling="NONE")
    mirror = bevelled()
    mirror.materials = (principled(metallic=1.0, roughness=0.0, base_color=(1.0, 1.0, 1.0)),)
    walls = [quad(400.0, 50.0, lit)]
    above = Camera(look((0.0, -0.5, 6.0), (0.0, 0.0, 0.0)))
    scene = Scene(Group("root", [mirror, *walls]), above, [], DARK)
    cache = Cache()
    edge = np.s_[8:28, 20:28]
    exact = image(scene, cache, method="distributed", samples=256)[edge].mean()
    assert exact > 0.05
    # light samples, too, look for what is in so wide a lobe, and are of no ray of this kind
    assert image(scene, cache)[edge].mean() == pytest.approx(exact, rel=0.2)


@pytest.mark.parametrize("beckmann", [False, True])
@pytest.mark.parametrize("alpha", [1e-4, 2.57e-3, 0.01, 0.3])
def test_sub_rays_of_lobes_narrower_than_cells_weigh_one_together(alpha, beckmann):
    """They were not a number where a lobe is far narrower than its cells, and a black square in the image."""
    lobes = lobe_cones.allocate_lobe_cones(1, allocate_cones(1))
    lobes.cones.axes[0], lobes.cones.spread[0] = np.eye(3), 0.61
    lobes.alpha[0], lobes.normal[0], lobes.incoming[0] = alpha, 0.0, (0.0, 0.0, 1.0)
    lobes.part[0], lobes.beckmann[0], lobes.even[0] = 0, beckmann, False
    lobe_view.weigh_sub_rays(lobes, np.int64(1))
    assert np.isfinite(lobes.weights).all() and (lobes.weights >= 0.0).all()
    assert lobes.weights.sum() == pytest.approx(1.0, rel=1e-5)
