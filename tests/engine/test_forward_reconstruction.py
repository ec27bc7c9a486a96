"""How forward mapping makes pixels of what it sampled: every combination of its settings, and exact polygons."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointmr_engine import (
    ForwardSettings,
    Group,
    Instances,
    Mesh,
    RenderSettings,
    Scene,
    emission,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.forward import analytic, points_method
from pointmr_engine.render import Cache, Cancelled
from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.settings import PASSES
from tests.engine.instanced import random_transforms
from tests.engine.small_scenes import from_above, quad
from tests.engine.test_forward_image import GREY, RED, ball, image, lit, sun

SIZE = RenderSettings(width=64, height=48, method="forward", samples=64, film_transparent=True)
BLACK = uniform_world((0.0, 0.0, 0.0))
# mean error of simple scenes; pixels without a filter have jagged edges
BOUNDS = {"pixel": 0.022, "gaussian": 0.014, "subpixel": 0.012, "analytic": 0.008}


def few_balls(rings=10, camera=None) -> Scene:
    placed = random_transforms(np.random.default_rng(3), 14, scale=(0.3, 0.7), spread=0.9)
    floor = quad(30.0, -3.0, RED, "floor")
    return lit(Group("root", [floor], [Instances((Group("ball", [ball(rings)]),), placed)]), camera)


def picture(scene, cache=None, size=SIZE, **forward):
    return render(scene, replace(size, forward=ForwardSettings(**forward)), cache=cache)


@pytest.fixture(scope="module")
def balls():
    scene = few_balls()
    scene.lights[0] = sun(cast_shadow=True)
    return scene, Cache(), render(scene, replace(SIZE, method="distributed", passes=PASSES)).passes


@pytest.mark.parametrize("sampling", ["static", "dynamic"])
@pytest.mark.parametrize("reconstruction", list(BOUNDS))
def test_every_combination_is_near_many_rays(balls, sampling, reconstruction):
    scene, cache, truth = balls
    for shading, draws in itertools.product(("simple", "full"), ("stratified", "random")):
        drawn = sampling == "dynamic" and reconstruction != "analytic"
        if draws != "stratified" and (shading == "full" or not drawn):
            continue
        frame = picture(
            scene, cache, replace(SIZE, passes=PASSES), sampling=sampling, reconstruction=reconstruction,
            shading=shading, draws=draws,
        )  # fmt: skip
        assert np.isfinite(frame.passes["combined"]).all()
        error = np.abs(frame.passes["combined"] - truth["combined"]).mean()
        assert error < BOUNDS[reconstruction], (shading, draws, error)
        far = np.abs(frame.passes["depth"] - truth["depth"]) > 0.05 * truth["depth"]
        assert far.mean() < 0.06
        for name in ("normal", "diffuse_color"):
            assert np.abs(frame.passes[name] - truth[name]).mean() < 0.06, name
        assert (frame.passes["material_index"] == truth["material_index"]).mean() > 0.95


@pytest.fixture(scope="module")
def fine_balls():
    """Triangles so small that points stand for them."""
    scene = few_balls(120)
    scene.lights[0] = sun(cast_shadow=True)
    return scene, Cache(), render(scene, replace(SIZE, method="distributed")).passes


@pytest.mark.parametrize("reconstruction", ["pixel", "gaussian", "subpixel"])
def test_more_points_come_nearer(fine_balls, reconstruction):
    scene, cache, truth = fine_balls
    errors = [
        np.abs(
            picture(
                scene,
                cache,
                sampling="dynamic",
                reconstruction=reconstruction,
                subpixels=8,
                samples_per_pixel=n,
            ).passes["combined"]
            - truth["combined"]
        ).mean()
        for n in (0.1, 1.0, 16.0)
    ]
    assert errors[2] < 1.02 * errors[1] and errors[1] < errors[0]


def test_drawn_images_are_the_same_for_any_threads_and_other_for_other_seeds():
    scene = few_balls(60)
    size = replace(SIZE, width=130, height=110)
    a, b, c = (
        picture(scene, size=replace(size, threads=n, seed=seed), sampling="dynamic").passes["combined"]
        for n, seed in ((1, 0), (3, 0), (1, 7))
    )
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()


@pytest.mark.parametrize("sampling, reconstruction", [("dynamic", "subpixel"), ("static", "analytic")])
def test_regions_films_and_worlds(balls, sampling, reconstruction):
    scene = lit(Group("root", [ball(12)]))
    how = {"sampling": sampling, "reconstruction": reconstruction, "shading": "simple"}
    clear = picture(scene, **how).passes["combined"]
    solid = picture(scene, size=replace(SIZE, film_transparent=False), **how).passes["combined"]
    assert clear[0, 0].tolist() == [0, 0, 0, 0] and clear[24, 32, 3] > 0.99
    sky = np.float32((0.3, 0.4, 0.6))
    np.testing.assert_allclose(solid[..., :3], clear[..., :3] + (1 - clear[..., 3:]) * sky, atol=1e-4)
    part = picture(scene, size=replace(SIZE, region=(17, 9, 47, 40)), **how).passes["combined"]
    assert part.shape == (31, 30, 4)
    assert np.abs(part - clear[9:40, 17:47]).mean() < (1e-5 if reconstruction == "analytic" else 0.012)


@pytest.mark.parametrize("how", [{"sampling": "dynamic"}, {"reconstruction": "analytic"}])
def test_cancelling_while_points_or_polygons_are_made(how):
    calls = [0]

    def progress(fraction, text, tile):
        calls[0] += text == "rendering"
        return calls[0] > 3

    with pytest.raises(Cancelled):
        render(few_balls(), replace(SIZE, width=400, height=300, forward=ForwardSettings(**how)), progress)


def test_missing_pixels_are_sampled_again(monkeypatch):
    """So few points that holes are many: a bright wall behind a dark one shows through them."""
    glow, dark = emission("glow", (1, 0, 0), 1.0), emission("dark", (0, 0, 1), 0.5)
    n = 300  # triangles smaller than a pixel
    x, y = np.meshgrid(np.linspace(-4, 4, n + 1), np.linspace(-4, 4, n + 1))
    k = np.arange(n * n)
    a = k // n * (n + 1) + k % n
    faces = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    walls = [
        Mesh(str(z), np.stack([x, y, 0 * x + z], -1).reshape(-1, 3).astype(np.float32), faces.astype(np.int32),
             materials=(m,))
        for z, m in ((0.0, dark), (-2.0, glow))
    ]  # fmt: skip
    scene, found = Scene(Group("root", walls), from_above(4.0), [], BLACK), []
    for again in (0, 2):
        monkeypatch.setattr(points_method, "AGAIN", again)
        frame = picture(
            scene, sampling="dynamic", reconstruction="pixel", draws="random", samples_per_pixel=0.2, failure=0.999,
            shading="simple",
        )  # fmt: skip
        found.append((frame.passes["combined"][..., 0].mean(), frame.stats["counters"]))
    assert found[1][1]["holes"] > 0 and found[1][1]["drawn_again"] > 0
    assert found[0][0] > 0
    assert found[1][0] < 0.5 * found[0][0]


def test_gaps_of_the_scene_are_not_sampled_again():
    """Strips with gaps of a pixel or two: at the density that failure asks for they can be nothing else."""
    n = 300
    x, y = np.meshgrid(np.linspace(-4, 4, n + 1), np.linspace(-4, 4, n + 1))
    k = np.arange(n * n)
    k = k[(k // n) % 12 < 9]
    a = k // n * (n + 1) + k % n
    faces = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    strips = Mesh(
        "strips", np.stack([x, y, 0 * x], -1).reshape(-1, 3).astype(np.float32), faces.astype(np.int32)
    )
    scene = Scene(Group("root", [strips]), from_above(4.0), [], BLACK)
    counters = picture(scene, sampling="dynamic", reconstruction="pixel", shading="simple").stats["counters"]
    assert counters["holes"] > 100 and counters["drawn_again"] == 0


@pytest.mark.parametrize("rings", [8, 120], ids=["rasterised", "points"])
def test_what_is_not_there_is_not_drawn(rings):
    gone = principled("gone", alpha=0.0)
    scene = lit(Group("root", [ball(rings, gone, radius=1.5), quad(0.5, 0.0, RED)]), from_above(5.0))
    alpha = picture(scene, sampling="dynamic", shading="simple").passes["combined"][..., 3]
    through = render(scene, replace(SIZE, method="distributed")).passes["combined"][..., 3]
    assert 0 < through.mean() < 0.1
    assert np.abs(alpha - through).mean() < 0.005


# Exact polygons


def flat(corners, material, name="flat") -> Mesh:
    return Mesh(name, np.array(corners, np.float32), np.array([[0, 1, 2]], np.int32), materials=(material,))


def seen(meshes, size=SIZE, **camera) -> np.ndarray:
    """Pixels of one unit's side, before an orthographic camera 5 above; the image's middle is the origin."""
    camera = from_above(5.0, kind="ORTHOGRAPHIC", ortho_scale=float(size.width), **camera)
    scene = Scene(Group("root", list(meshes)), camera, [], BLACK)
    size = replace(size, pixel_filter="box")
    return picture(scene, size=size, reconstruction="analytic", shading="simple").passes["combined"]


@given(st.floats(-2.9, 2.9), st.floats(-0.4, 0.4))
@settings(max_examples=15)
def test_half_planes_cover_what_they_cover(offset, slope):
    """Alpha right of the line x = offset + slope y, one triangle, is the exact area."""
    size = replace(SIZE, width=8, height=6)
    top, low = 1000.0, -1000.0
    wall = flat(
        [(offset + slope * low, low, 0), (3000, 0, 0), (offset + slope * top, top, 0)],
        emission("e", (1, 1, 1), 1.0),
    )
    alpha = seen([wall], size)[..., 3]
    y = np.linspace(-3, 3, 6 * 4000 + 1)
    y = 0.5 * (y[1:] + y[:-1])
    for column in range(8):
        right = column - 4 + 1
        exact = np.clip(right - (offset + slope * y), 0, 1).reshape(6, -1).mean(1)
        np.testing.assert_allclose(alpha[:, column], exact, atol=2e-4)


@given(st.floats(-1.9, 1.9), st.floats(0.05, 5.0), st.floats(0.05, 5.0))
@settings(max_examples=15)
def test_crossing_triangles_meet_in_a_line(x, rise, fall):
    """Left of x the red one is nearer, right of it the green one."""
    size = replace(SIZE, width=8, height=6)
    red, green = emission("red", (1, 0, 0), 1.0), emission("green", (0, 1, 0), 1.0)

    def tilted(slope):
        far = 400.0
        return [(px, py, (px - x) * slope * 1e-3) for px, py in ((-far, -far), (far, -far), (0.0, far))]

    colour = seen([flat(tilted(-rise), red), flat(tilted(fall), green)], size)
    np.testing.assert_allclose(colour[..., 3], 1.0, atol=1e-5)
    share = np.clip(x - (np.arange(8) - 4), 0, 1)
    np.testing.assert_allclose(colour[..., 0], np.tile(share, (6, 1)), atol=1e-3)
    np.testing.assert_allclose(colour[..., 1], 1 - np.tile(share, (6, 1)), atol=1e-3)


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=8)
def test_soups_of_triangles_are_what_many_subpixels_see(seed, perspective):
    rng = np.random.default_rng(seed)
    meshes = [
        flat(rng.uniform(-1.5, 1.5, (3, 3)), emission(str(k), tuple(rng.uniform(0, 1, 3)), 1.0), str(k))
        for k in range(25)
    ]
    camera = from_above(4.0) if perspective else from_above(4.0, kind="ORTHOGRAPHIC", ortho_scale=4.0)
    scene, size = Scene(Group("root", meshes), camera, [], BLACK), replace(SIZE, width=48, height=36)
    exact, subpixels = (
        picture(
            scene,
            size=size,
            reconstruction=r,
            subpixels=8,
            samples_per_pixel=64.0,
            shading="simple",
            shadows=False,
        ).passes["combined"]
        for r in ("analytic", "subpixel")
    )
    assert exact[..., 3].max() <= 1.0 + 1e-5
    assert np.abs(exact - subpixels).mean() < 0.002
    np.testing.assert_allclose(exact.mean((0, 1)), subpixels.mean((0, 1)), atol=1e-3)


def test_two_triangles_in_one_plane_show_the_first():
    size = replace(SIZE, width=8, height=6)
    corners = [(-400, -400, 0), (400, -400, 0), (0, 400, 0)]
    red, green = emission("red", (1, 0, 0), 1.0), emission("green", (0, 1, 0), 1.0)
    colour = seen([flat(corners, red), flat(corners, green)], size)
    np.testing.assert_allclose(colour[..., :3].sum(2), 1.0, atol=1e-5)


def test_what_is_behind_the_camera_or_crosses_its_plane():
    """A floor that begins behind the camera is cut, not folded."""
    floor = Mesh(
        "floor", np.array([[-50, -50, -1], [50, -50, -1], [50, 50, -1], [-50, 50, -1]], np.float32),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32), materials=(GREY,),
    )  # fmt: skip
    m = np.eye(4)
    m[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # looks along y
    camera = replace(from_above(0.0), world_from_camera=m)
    scene = lit(Group("root", [floor]), camera)
    a, b = (image(scene, method=k, forward_reconstruction="analytic") for k in ("forward", "distributed"))
    assert 0.4 < b[..., 3].mean() < 0.6
    assert np.abs(a - b).mean() < 0.004


def test_what_is_not_simple_enough_is_named(monkeypatch):
    how = {"reconstruction": "analytic"}
    monkeypatch.setattr(analytic, "TRIANGLES", 500)
    with pytest.raises(SceneError, match="more than 500 triangles are in view"):
        picture(few_balls(), **how)
    monkeypatch.setattr(analytic, "PLACED", 1000)
    with pytest.raises(SceneError, match="the scene has .* triangles, more than 1000"):
        picture(few_balls(), **how)
    monkeypatch.undo()
    glass = principled("veil", alpha=0.5)
    with pytest.raises(SceneError, match="material 'veil' is not opaque"):
        picture(lit(Group("root", [quad(1.0, 0.0, glass)])), **how)
    monkeypatch.setattr(analytic, "PAIRS", 10)
    with pytest.raises(SceneError, match="overlap"):
        picture(few_balls(), **how)


def test_an_empty_scene_is_empty():
    for how in ({"sampling": "dynamic"}, {"reconstruction": "analytic"}, {"reconstruction": "gaussian"}):
        assert not picture(lit(Group("nothing")), **how).passes["combined"].any()
