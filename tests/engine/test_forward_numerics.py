"""Forward mapping far from the origin, at any scale, over any range of depths, with the camera in awkward places."""

from dataclasses import replace

import numpy as np
import pytest

from pointmr_engine import (
    Camera,
    ForwardSettings,
    Group,
    Instances,
    Light,
    Mesh,
    RenderSettings,
    Scene,
    instance,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.scene.group import CAMERA
from tests.engine.instanced import random_transforms, sphere
from tests.engine.small_scenes import at, from_above, quad

SETTINGS = RenderSettings(
    width=96,
    height=72,
    method="forward",
    samples=64,
    film_transparent=True,
    passes=("combined", "depth"),
    forward=ForwardSettings(shading="simple", shadows=False),
)
GREY = principled("grey", base_color=(0.6, 0.6, 0.6), specular_ior_level=0.0)


def lit(root: Group, camera: Camera) -> Scene:
    turn = np.eye(4)
    c, s = np.cos(0.7), np.sin(0.7)
    turn[:3, :3] = [[1, 0, 0], [0, c, -s], [0, s, c]]
    world = uniform_world((0.3, 0.4, 0.6))
    world.visibility = CAMERA
    return Scene(root, camera, [Light("SUN", turn, power=3.0, angle=0.0, cast_shadow=False)], world)


def ball(rings: int = 24, radius: float = 1.0, shift=(0.0, 0.0, 0.0)) -> Mesh:
    positions, triangles = sphere(rings, 2 * rings)
    return Mesh(
        "ball", positions.astype(np.float64) * radius + np.asarray(shift), triangles, materials=(GREY,)
    )


def picture(scene: Scene, **values) -> np.ndarray:
    pixels = render(scene, replace(SETTINGS, **values)).passes["combined"]
    assert np.isfinite(pixels).all()
    return pixels


def moved(scale: float, shift) -> Scene:
    """Balls over a floor, all of it scaled about the origin and then moved, camera and clipping with it."""
    rng = np.random.default_rng(2)
    shift = np.asarray(shift, float)
    small = Group("ball", [ball(24, scale)])
    placed = random_transforms(rng, 40, scale=(0.2, 0.6), spread=1.0)
    placed[:, :, 3] = placed[:, :, 3] * scale + shift
    floor = quad(30.0, -3.0, GREY)
    floor.positions = floor.positions.astype(np.float64) * scale + shift
    camera = np.eye(4)
    camera[:3, 3] = np.array([0.4, -0.3, 6.0]) * scale + shift
    view = Camera(camera, clip_start=0.1 * scale, clip_end=1000.0 * scale)
    return lit(Group("root", [floor], [Instances((small,), placed)]), view)


@pytest.fixture(scope="module")
def at_home():
    return picture(moved(1.0, (0, 0, 0)))


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (1e6, -1e6, 1e6)])
def test_the_picture_does_not_depend_on_where_and_how_large_the_scene_is(at_home, scale, shift):
    # positions are float64: at 10^6 they are known to 10^-10, a millionth of the smallest scene
    there = picture(moved(scale, shift))
    difference = np.abs(there - at_home)
    assert difference.mean() < 3e-4
    # hardly a sample falls on the other side of a subpixel's border
    assert (difference.max(-1) > 0.01).mean() < 0.01


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_a_mesh_far_from_its_own_origin(at_home, scale):
    """The same picture when it is the mesh, and not its placement, that lies far away."""
    shift = np.array([1e6, -1e6, 1e6])
    scene, there = moved(1.0, (0, 0, 0)), moved(scale, shift)
    mesh = there.root.instances[0].groups[0].meshes[0]
    assert mesh.positions.dtype == np.float64
    mesh.positions = mesh.positions + shift
    batch = there.root.instances[0]
    batch.transforms = batch.transforms.copy()
    batch.transforms[:, :, 3] -= np.einsum("nij,j->ni", batch.transforms[:, :, :3], shift)
    del scene
    difference = np.abs(picture(there) - at_home)
    assert difference.mean() < 1e-3 if scale < 1 else difference.mean() < 2e-4


@pytest.mark.parametrize("tau", [1e3, 1e6, 1e9])
def test_any_range_of_depths(tau):
    """Balls of one size in the image, from depth 1 to tau, side by side."""
    columns, rows = 8, 6
    n = columns * rows
    rng = np.random.default_rng(7)
    z = tau ** rng.permutation(np.linspace(0, 1, n))
    u, v = (c.ravel() for c in np.meshgrid(np.arange(columns), np.arange(rows)))
    wide = 36.0 / 50.0
    size = 0.4 * wide / columns
    placed = np.zeros((n, 3, 4))
    placed[:, [0, 1, 2], [0, 1, 2]] = (size * z)[:, None]
    placed[:, 0, 3] = ((u + 0.5) / columns - 0.5) * wide * z
    placed[:, 1, 3] = ((v + 0.5) / rows - 0.5) * wide * 0.75 * z
    placed[:, 2, 3] = -z
    camera = Camera(np.eye(4), clip_start=0.1, clip_end=10 * tau)
    scene = lit(Group("root", [], [Instances((Group("ball", [ball(40)]),), placed)]), camera)
    pixels = picture(scene)
    cells = pixels[..., 3].reshape(rows, 12, columns, 12).mean((1, 3))
    # every ball covers the same part of its cell, near or far (those aside are stretched a little)
    np.testing.assert_allclose(cells, np.pi * 0.4**2, rtol=0.12)
    truth = picture(scene, method="distributed")
    assert np.abs(pixels - truth).mean() < 0.02


def room(side: float = 10.0, cells: int = 40) -> Group:
    """A box of quads, each in cells x cells x 2 triangles, and a ball in a corner."""
    a = np.linspace(-side / 2, side / 2, cells + 1)
    x, y = np.meshgrid(a, a)
    flat = np.stack([x, y, np.full_like(x, -side / 2)], -1).reshape(-1, 3)
    i = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    faces = np.concatenate(
        [np.stack([i, i + 1, i + cells + 2], 1), np.stack([i, i + cells + 2, i + cells + 1], 1)]
    )
    meshes = []
    for k, axes in enumerate(([0, 1, 2], [1, 2, 0], [2, 0, 1])):
        for sign in (1.0, -1.0):
            color = np.full(3, 0.25)
            color[k] = 0.7 if sign > 0 else 0.4
            wall = principled(f"wall {k} {sign}", base_color=tuple(color), specular_ior_level=0.0)
            meshes.append(
                Mesh("wall", (flat * sign)[:, axes].copy(), faces.astype(np.int32), materials=(wall,))
            )
    return Group("room", [*meshes, ball(30, 1.0, (3.0, 3.0, 3.0))])


@pytest.mark.parametrize(
    "place",
    [(0.0, 0.0, 0.0), (0.0, 0.0, 5.0), (5.0, 5.0, 5.0), (0.0, 0.0, -4.9), (2.5, 2.5, 3.3)],
    ids=["middle", "on a wall", "in a corner", "at the floor", "at the ball"],
)
@pytest.mark.parametrize("turned", [False, True])
def test_a_camera_inside_a_box_and_on_its_faces(place, turned):
    camera = at(*place)
    if turned:  # along x, so that walls stretch from beside the camera to the far end
        camera[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    scene = lit(room(), Camera(camera, focal_length=24.0, clip_start=1e-3))
    forward, truth = picture(scene), picture(scene, method="distributed")
    assert np.abs(forward - truth).mean() < 0.02
    assert forward[..., 3][truth[..., 3] == 1.0].min(initial=1.0) > 0.97


def test_a_camera_inside_an_instance_inside_an_instance():
    inner = room()
    turn = np.eye(4)
    turn[:3, :3] = 3.0 * np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn[:3, 3] = 1e5, -2e5, 3e5
    back = np.linalg.inv(turn)
    outer = Group("outer", [], [instance(inner, turn), instance(inner, turn @ at(30, 0, 0))])
    scene = lit(Group("root", [], [instance(outer, back)]), Camera(at(0.5, 0.2, 4.0), clip_start=1e-3))
    alone = lit(inner, Camera(at(0.5, 0.2, 4.0), clip_start=1e-3))
    assert np.abs(picture(scene) - picture(alone)).mean() < 5e-3


def test_what_reaches_through_the_near_plane_is_cut_there():
    floor = quad(1000.0, -1.0, GREY)
    camera = np.eye(4)
    camera[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # along y, up is z
    scene = lit(Group("root", [floor]), Camera(camera, clip_start=5.0))
    forward, truth = picture(scene), picture(scene, method="distributed")
    assert np.abs(forward - truth).mean() < 0.01
    assert truth[0, 48, 3] == 0.0 and forward[0, 48, 3] < 0.01  # the floor before the near plane is not seen
    assert forward[30, 48, 3] > 0.99


def test_far_clipping():
    group = Group("ball", [ball(24)])
    scene = lit(
        Group("root", [], [instance(group, at(0, 0, -2)), instance(group, at(9, 0, -30))]), from_above(5.0)
    )
    scene.camera.clip_end = 20.0
    pixels = picture(scene)
    assert pixels[36, 48, 3] > 0.99
    assert pixels[:, 75:, 3].max() < 0.01


def test_needles_and_points_do_no_harm():
    """Triangles without area, thinner than rounding, or enormous."""
    corners = np.array(
        [
            [[0, 0, 0], [0, 0, 0], [0, 0, 0]],
            [[-1, 0, 0], [0, 0, 0], [1, 0, 0]],
            [[-1, 0.5, 0], [1, 0.5, 0], [1, 0.5 + 1e-9, 0]],
            [[-1e8, -1e8, -5], [1e8, -1e8, -5], [0, 1e8, -5]],
        ]
    )
    mesh = Mesh(
        "odd", corners.reshape(-1, 3), np.arange(12, dtype=np.int32).reshape(-1, 3), materials=(GREY,)
    )
    pixels = picture(lit(Group("root", [mesh]), from_above(5.0)))
    assert pixels[..., 3].min() > 0.99
    truth = picture(lit(Group("root", [mesh]), from_above(5.0)), method="distributed")
    assert np.abs(pixels - truth).mean() < 5e-3
