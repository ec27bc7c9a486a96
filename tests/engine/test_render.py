"""Whole renders by the engine: closed forms, determinism, cancelling, and what becomes of bad input."""

import math
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from pointmr_engine import (
    Group,
    Instances,
    Light,
    Mesh,
    RenderSettings,
    Scene,
    SceneError,
    emission,
    instance,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.render import Cache, Cancelled
from pointmr_engine.scene.group import CAMERA
from tests.engine.small_scenes import at, from_above, lit_floor, quad

TINY = RenderSettings(width=24, height=16, method="distributed", samples=4)
RENDER = sys.modules["pointmr_engine.render"]  # the module: its name is the function's, too


def combined(scene, **settings):
    return render(scene, replace(TINY, **settings)).passes["combined"]


def test_a_diffuse_plane_under_a_uniform_sky_shows_its_albedo():
    plane = quad(50.0, material=principled(base_color=(0.5, 0.25, 0.125), specular_ior_level=0.0))
    image = combined(
        Scene(Group("root", [plane]), from_above(), [], uniform_world((2.0, 2.0, 2.0))), samples=64
    )
    np.testing.assert_allclose(image[..., :3].mean((0, 1)), [1.0, 0.5, 0.25], rtol=0.01)
    np.testing.assert_array_equal(image[..., 3], 1.0)


def test_a_point_light_follows_the_inverse_square():
    power, height = 100.0, 3.0
    scene = lit_floor(power=power, radius=0.0)
    scene.camera.focal_length = 5000.0  # the middle of the floor only
    image = combined(scene, width=3, height=3, samples=16)
    irradiance = power / (4 * math.pi * height**2)
    np.testing.assert_allclose(image[1, 1, :3], 0.8 / math.pi * irradiance, rtol=0.02)


def test_an_emitter_shows_its_radiance_and_lights_by_its_solid_angle():
    lamp = Mesh(
        "lamp",
        np.array([[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]], np.float32),
        np.array([[0, 2, 1], [0, 3, 2]], np.int32),  # facing down
        materials=(emission("lamp", strength=3.0),),
    )
    floor = quad(20.0, material=principled(base_color=(1, 1, 1), specular_ior_level=0.0))
    camera = from_above(1.0, focal_length=5000.0)  # between lamp and floor
    image = combined(Scene(Group("root", [floor, lamp]), camera), width=4, height=4, samples=256)
    a = 1.0 / math.sqrt(1 + 4)
    irradiance = 3.0 * 4 * a * math.atan(a) * 1.0  # of a square over its centre, seen from below
    np.testing.assert_allclose(image[..., :3].mean(), irradiance / math.pi, rtol=0.03)


@pytest.mark.parametrize("method", ["distributed", "conventional"])
def test_the_image_does_not_depend_on_threads(method):
    glass = quad(2.0, 1.0, principled("glass", transmission_weight=1.0, roughness=0.2), "glass")
    scene = lit_floor(glass, world=uniform_world((0.1, 0.2, 0.3)))
    one, two = (combined(scene, method=method, width=70, height=50, threads=n) for n in (1, 3))
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, combined(scene, method=method, width=70, height=50, seed=1)) or (
        method == "conventional"
    )


def test_one_ray_a_pixel_takes_larger_tiles_and_the_image_does_not_depend_on_them(monkeypatch):
    world = uniform_world((0.1, 0.2, 0.3))
    scene, sizes = lit_floor(world=world), {"method": "conventional", "width": 300, "height": 200}

    def tiles() -> tuple[int, np.ndarray]:
        found = set()
        settings = replace(TINY, **sizes)
        image = render(
            scene, settings, progress=lambda fraction, text, tile: found.add(tile and tile[:2]) and False
        )
        return len(found - {None}), image.passes["combined"]

    few, large = tiles()
    monkeypatch.setattr(RENDER, "TILE_SIZES", (32,))
    many, small = tiles()
    assert (few, many) == (6, 70)
    np.testing.assert_array_equal(large, small)


@pytest.mark.parametrize(
    "size, samples, tile", [((640, 480), 1, 128), ((640, 480), 64, 64), ((160, 120), 64, 32)]
)
def test_tiles_are_large_only_where_samples_are_few(size, samples, tile):
    assert RENDER._tile_size(*size, samples, 65536) == tile


def test_every_pass_is_finite_and_depth_says_where_nothing_is():
    passes = ("combined", "depth", "position", "normal", "diffuse_color", "emission", "object_index",
              "material_index", "sample_count")  # fmt: skip
    group = Group("root", instances=[instance(Group("q", [quad(1.0)]), object_index=7)])
    scene = Scene(group, from_above(), [], uniform_world())
    frame = render(scene, replace(TINY, passes=passes, film_transparent=True))
    for name in passes:
        assert np.isfinite(frame.passes[name]).all(), name
    depth = frame.passes["depth"][..., 0]
    assert depth[8, 12] == pytest.approx(5.0) and depth[0, 0] == np.float32(1e10)
    assert frame.passes["object_index"][8, 12, 0] == 7
    assert frame.passes["combined"][0, 0, 3] == 0 and frame.passes["combined"][8, 12, 3] == 1
    np.testing.assert_allclose(frame.passes["normal"][8, 12], [0, 0, 1], atol=1e-6)


def test_cancel_stops_the_render():
    calls = []

    def progress(fraction, text, tile):
        calls.append(text)
        return len(calls) > 3

    with pytest.raises(Cancelled):
        render(lit_floor(), replace(TINY, width=200, height=200), progress)
    assert len(calls) == 4


def _blas_threads():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_products_of_arrays_take_no_threads_of_their_own_while_any_image_is_made():
    with threadpool_limits(limits=3, user_api="blas"):  # also where there is one processor
        before = _blas_threads()
        assert before and before != {1}
        seen, others = [], []

        def overlap(fraction, text, tile):
            seen.append(_blas_threads())
            if not others:  # another image begins later and ends sooner
                others.append(threading.Thread(target=render, args=(lit_floor(), TINY)))
                others[0].start()
                others[0].join()

        render(lit_floor(), TINY, overlap)
        with pytest.raises(Cancelled):
            render(lit_floor(), TINY, lambda *_: True)
        assert len(seen) > 1 and all(s == {1} for s in seen)
        assert _blas_threads() == before


def test_what_a_scene_does_not_need_is_not_done():
    """Counters, not clocks: no light samples without lights, no shadow frames without transparency."""
    dark = render(Scene(Group("root", [quad(20.0)]), from_above()), TINY)
    assert dark.stats["counters"].get("shadow_rays", 0) == 0
    assert not dark.stats["needs"]["light_samples"] and not dark.stats["needs"]["stray_light"]
    lit = render(lit_floor(), TINY)
    assert lit.stats["counters"]["shadow_rays"] > 0
    assert not lit.stats["needs"]["transparent_shadows"] and not lit.stats["needs"]["window"]


# Bad input: a named error, or a named warning and the rest of the scene.


def broken(name, positions, triangles=((0, 1, 2),)) -> Mesh:
    return Mesh(name, np.array(positions, np.float32), np.array(triangles, np.int32).reshape(-1, 3))


def warned_as_without(bad: Mesh, word: str) -> None:
    """The render warns of `bad` by name, and shows the rest as if it were not there."""
    frame = render(lit_floor(bad), TINY)
    assert any(bad.name in w and word in w for w in frame.warnings), frame.warnings
    np.testing.assert_array_equal(frame.passes["combined"], combined(lit_floor()))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_positions_that_are_not_finite(value):
    warned_as_without(broken("shards", [[0, 0, 1], [value, 0, 1], [0, 1, 1]]), "not finite")


def test_empty_mesh():
    warned_as_without(broken("hollow", np.zeros((0, 3)), np.zeros((0, 3))), "no triangles")


def test_zero_area_triangles_are_harmless():
    flat = broken("needles", [[0, 0, 1], [1, 0, 1], [2, 0, 1], [0, 0, 1]], [[0, 1, 2], [0, 0, 0], [0, 3, 1]])
    np.testing.assert_array_equal(combined(lit_floor(flat)), combined(lit_floor()))


def test_duplicate_triangles_are_seen_once():
    once = quad(2.0, 1.0, principled(base_color=(0.5, 0, 0)))
    twice = replace(once, triangles=np.concatenate([once.triangles, once.triangles]))
    np.testing.assert_allclose(combined(lit_floor(twice)), combined(lit_floor(once)), atol=1e-6)


def test_triangle_out_of_range_names_the_mesh():
    with pytest.raises(SceneError, match="'torn': triangle 1"):
        render(lit_floor(broken("torn", np.eye(3), [[0, 1, 2], [0, 1, 3]])), TINY)


def test_singular_instance_is_skipped_by_name():
    scene, plain = lit_floor(), lit_floor()
    matrix = np.diag([1.0, 0.0, 1.0, 1.0])
    scene.root.instances.append(instance(Group("leaf", [quad(2.0, 1.0)]), matrix, name="squashed"))
    frame = render(scene, TINY)
    assert any("squashed" in w for w in frame.warnings), frame.warnings
    np.testing.assert_array_equal(frame.passes["combined"], combined(plain))


def test_mirrored_instance_is_lit_like_its_original():
    plain, mirrored = lit_floor(), lit_floor()
    tile = Group("tile", [quad(2.0, 1.0, principled(base_color=(0.2, 0.5, 0.2)))])
    plain.root.instances.append(instance(tile))
    mirrored.root.instances.append(instance(tile, np.diag([-1.0, 1.0, 1.0, 1.0])))
    np.testing.assert_allclose(combined(mirrored, samples=64), combined(plain, samples=64), atol=0.15)


def test_cycle_of_groups_is_named():
    a, b = Group("a"), Group("b")
    a.instances.append(instance(b))
    b.instances.append(instance(a))
    with pytest.raises(SceneError, match="a -> b -> a"):
        render(Scene(Group("root", instances=[instance(a)]), from_above()), TINY)


@pytest.mark.parametrize(
    ("meshes", "instances", "message"),
    [
        ([instance(Group("a"))], [], "'odd': Instances among its meshes"),
        ([], [Group("a")], "'odd': Group among its instances"),
        (
            [],
            [Instances(Group("a"), np.eye(4)[None, :3], name="rows")],
            "'rows' in group 'odd': groups is a Group",
        ),
        (
            [],
            [Instances((quad(1.0),), np.eye(4)[None, :3], name="rows")],
            "'rows' in group 'odd': Mesh among",
        ),
    ],
)
def test_what_is_of_another_kind_is_named(meshes, instances, message):
    with pytest.raises(SceneError, match=message):
        render(Scene(Group("odd", meshes, instances), from_above()), TINY)


def test_no_camera():
    with pytest.raises(SceneError, match="no camera"):
        render(Scene(Group("root")), TINY)


def test_no_light_is_black_but_not_an_error():
    image = combined(Scene(Group("root", [quad()]), from_above()))
    assert (image[..., :3] == 0).all() and (image[..., 3] == 1).all()


def test_empty_scene_shows_the_world():
    image = combined(Scene(Group("root"), from_above(), [], uniform_world((0.25, 0.5, 1.0))))
    np.testing.assert_allclose(image[..., :3], np.broadcast_to([0.25, 0.5, 1.0], (16, 24, 3)), rtol=1e-5)


@pytest.mark.parametrize(
    "values, word",
    [
        ({"width": 0}, "image size"),
        ({"method": "magic"}, "magic"),
        ({"samples": 0}, "samples"),
        ({"pixel_filter": "mitchell"}, "mitchell"),
        ({"passes": ("shine",)}, "shine"),
        ({"region": (5, 5, 5, 9)}, "region"),
    ],
)
def test_settings_that_cannot_be_honoured(values, word):
    with pytest.raises(SceneError, match=word):
        render(lit_floor(), replace(TINY, **values))


def test_far_from_the_origin_and_at_any_scale():
    """Moving scene and camera together, or scaling both, leaves the picture as it is."""

    def moved(offset, scale):
        group = lit_floor(quad(1.0, 1.0)).root
        m = np.diag([scale, scale, scale, 1.0])
        m[:3, 3] = offset
        camera = from_above(focal_length=80.0, clip_start=0.01 * scale, clip_end=100 * scale)
        camera.world_from_camera = m @ camera.world_from_camera
        light = Light("SUN", at(0, 0, 3), power=2.0, angle=0.1)
        return combined(Scene(Group("root", instances=[instance(group, m)]), camera, [light]), samples=16)

    reference = moved((0, 0, 0), 1.0)
    for offset, scale in (((1e6, -1e6, 1e6), 1.0), ((0, 0, 0), 1e4), ((0, 0, 0), 1e-4)):
        image = moved(offset, scale)
        assert np.abs(image - reference).mean() < 2e-3, (offset, scale)


def test_one_ray_a_pixel_looks_at_the_lights_once_on_diffuse_surfaces():
    """`conventional` sends no second ray to find the lights again, and is as bright as `distributed` without it."""
    scene = lit_floor(world=uniform_world((0.5, 0.5, 0.5)))
    one = render(scene, replace(TINY, width=64, height=64, method="conventional"))
    assert one.stats["counters"].get("scattered_rays", 0) == 0
    many = combined(scene, samples=64, width=64, height=64)
    assert one.passes["combined"][..., :3].mean() == pytest.approx(many[..., :3].mean(), rel=0.03)


def several_lights(**more) -> Scene:
    """The floor under three lamps and a sun."""
    scene = lit_floor(radius=0.0, **more)
    scene.lights += [
        Light("POINT", at(1, 1, 2), power=40.0, color=(1, 0.2, 0.1)),
        Light("SPOT", at(-1, 0, 3), power=80.0, spot_angle=1.0),
        Light("SUN", at(0, 0, 0), power=0.7, color=(0.1, 0.2, 1), angle=0.0),
    ]
    return scene


def test_one_ray_a_pixel_looks_at_each_of_a_few_lights():
    """Sharp lights leave no chance: the image is free of noise, and the sum of what each light gives."""
    scene = several_lights()
    image = combined(scene, method="conventional", seed=1)[..., :3]
    np.testing.assert_array_equal(image, combined(scene, method="conventional", seed=2)[..., :3])
    alone = [
        combined(replace(scene, lights=[light]), method="conventional")[..., :3] for light in scene.lights
    ]
    np.testing.assert_allclose(image, sum(alone), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("roughness", [0.3, 1.0])
def test_looking_at_each_light_keeps_the_mean(roughness):
    """With soft lamps, a lamp of triangles and a sky, by glossy reflections too."""
    scene = several_lights(world=uniform_world((0.2, 0.3, 0.4)))
    for light in scene.lights:
        light.radius = light.angle = 0.2
        light.visibility &= ~CAMERA  # the edges of lamps would be jagged
    scene.root.meshes[0].materials = (principled("shiny", metallic=0.5, roughness=roughness),)
    lamp = quad(2.0, z=6.0, material=emission("lamp", strength=5.0))  # behind the camera
    scene.root.meshes.append(lamp)
    size = {"width": 64, "height": 64}
    means = [
        np.mean(
            [combined(scene, method="conventional", seed=s, **size)[..., :3].mean((0, 1)) for s in range(4)],
            0,
        ),
        combined(scene, samples=16, **size)[..., :3].mean((0, 1)),
    ]
    np.testing.assert_allclose(*means, rtol=0.02)


def test_what_one_method_compiled_serves_the_next():
    """Forward mapping's samples are not made again for raytracing; unfiltered materials are kept apart."""
    scene, cache = lit_floor(), Cache()
    first = render(scene, replace(TINY, method="forward"), cache=cache)
    assert cache.find(scene, True).acceleration is None and cache.find(scene, False) is None
    sampler, geometry = cache.find(scene, True).sampler, cache.find(scene, True).geometry
    traced = render(scene, replace(TINY, method="raytrace"), cache=cache)
    assert cache.find(scene, True).sampler is sampler and cache.find(scene, True).geometry is geometry
    assert cache.find(scene, True).acceleration is not None
    for method, alone in (("forward", first), ("raytrace", render(scene, replace(TINY, method="raytrace")))):
        again = render(scene, replace(TINY, method=method), cache=cache)
        np.testing.assert_array_equal(again.passes["combined"], alone.passes["combined"])
        assert "compiling materials" not in again.stats["times"]
    np.testing.assert_array_equal(traced.passes["combined"], again.passes["combined"])
    render(scene, TINY, cache=cache)
    assert cache.find(scene, False).sampler is None
    rebuilt = replace(scene, root=Group("root", scene.root.meshes))
    assert cache.find(rebuilt, False) is None
