"""Images of method "raytrace": their error falls with the cones, they repeat, and only what they need is done."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.closed_forms import curved_mirror
from benchmarks.closed_forms.stage import mirror
from benchmarks.forward.scenes import forest, look
from pointmr_engine import (
    Camera,
    Group,
    Light,
    Mesh,
    RenderSettings,
    Scene,
    SceneError,
    principled,
    render,
    uniform_world,
)
from pointmr_engine.render import Cache
from pointmr_engine.scene.group import CAMERA, SHADOW, instance
from pointmr_engine.scene.settings import RaytraceSettings
from tests.engine.instanced import sphere
from tests.engine.small_scenes import at, from_above, lit_floor, quad

TINY = RenderSettings(width=48, height=36, method="raytrace")
DARK = uniform_world((0.0, 0.0, 0.0))
SHARP_SUN = Light("SUN", look((-2, -3, 7), (0, 0, 0)), power=4.5, angle=0.0)


def image(scene, cache=None, cones=1, **settings) -> np.ndarray:
    """(height, width, 3) float64."""
    settings = replace(TINY, raytrace=RaytraceSettings(cones=cones), **settings)
    return render(scene, settings, cache=cache).passes["combined"][..., :3].astype(float)


def counters(scene, **settings) -> dict:
    return render(scene, replace(TINY, **settings)).stats["counters"]


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """RMS relative to the mean of b."""
    return math.sqrt(((a - b) ** 2).mean()) / b.mean()


def most(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of both but for the few that differ most: in some seeds one meets a lamp in many mirrors."""
    square = ((a - b) ** 2).mean(-1)
    kept = square <= np.quantile(square, 0.995)
    return a[kept], b[kept]


def ball(x: float, y: float, radius: float, material) -> Mesh:
    mesh = curved_mirror.sphere(32)
    positions = (mesh.positions * radius + (x, y, radius)).astype(np.float32)
    return replace(mesh, positions=positions, materials=(material,))


def balls(sun=SHARP_SUN) -> Scene:
    """A ball of glass and one that is a mirror, on a floor with a wall, under the sun and an even sky."""
    floor = quad(20.0, material=principled("floor", base_color=(0.7, 0.6, 0.4), specular_ior_level=0.0))
    board = quad(2.0, 0.01, principled("board", base_color=(0.1, 0.2, 0.7), specular_ior_level=0.0), "board")
    glass = principled("glass", transmission_weight=1.0, roughness=0.0, ior=1.45)
    group = Group("root", [floor, board, ball(-1.0, 0.0, 0.8, glass), ball(1.0, 0.0, 0.8, mirror())])
    camera = Camera(look((0.0, -5.0, 3.0), (0.0, 0.0, 0.6)))
    return Scene(group, camera, [sun], uniform_world((0.3, 0.4, 0.6)))


def trees() -> Scene:
    flight = forest(60)
    return Scene(flight.root, flight.cameras[3], [SHARP_SUN], uniform_world((0.3, 0.4, 0.6)))


# Consistency


@pytest.fixture(scope="module", params=["forest", "balls"])
def judged(request):
    """(name, scene, cache, exact image)."""
    scene, cache = {"forest": trees, "balls": balls}[request.param](), Cache()
    exact = image(scene, cache, method="distributed", samples=512)
    return request.param, scene, cache, exact


# RMS at 1 and 4 cones, the second over the first, and the mean; measured 0.116, 0.082, 0.71, 0.015 and, mostly at the
# balls' rims, 0.041, 0.034, 0.85, 0.004; the exact images' noise is 0.025 and 0.010 of it
BOUNDS = {"forest": (0.14, 0.10, 0.85, 0.03), "balls": (0.05, 0.042, 0.95, 0.01)}


def test_the_error_falls_with_the_cones(judged):
    name, scene, cache, exact = judged
    one, four = (image(scene, cache, n) for n in (1, 4))
    errors = difference(one, exact), difference(four, exact)
    means = [x.mean() / exact.mean() - 1 for x in (one, four)]
    assert errors[0] < BOUNDS[name][0] and errors[1] < BOUNDS[name][1]
    assert errors[1] < BOUNDS[name][2] * errors[0]
    assert max(abs(m) for m in means) < BOUNDS[name][3]


# Determinism


def room() -> Scene:
    """All kinds of light and of lobes."""
    scene = balls(replace(SHARP_SUN, angle=0.1))
    scene.root.meshes[1].materials = (principled("rough", roughness=0.3),)
    scene.lights.append(Light("POINT", at(-1, -2, 2), power=50.0))
    return scene


def test_the_image_does_not_depend_on_threads():
    scene, cache = room(), Cache()
    one, two = (image(scene, cache, width=150, height=40, threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(one, image(room(), width=150, height=40, threads=2))
    assert not np.array_equal(one, image(scene, cache, width=150, height=40, seed=1))


def part_and_whole(scene, cache, **settings) -> tuple[np.ndarray, np.ndarray]:
    settings |= {"width": 96, "height": 72}
    part = image(scene, cache, region=(13, 21, 70, 55), **settings)
    return part, image(scene, cache, **settings)[21:55, 13:70]


def test_a_region_is_a_part_of_the_whole():
    floor = lit_floor(quad(1.0, 1.0, principled("dull", specular_ior_level=0.0)), world=uniform_world())
    # at a tile's border fewer neighbours say how many rays are worth it
    np.testing.assert_allclose(*part_and_whole(floor, Cache()), rtol=0.02)


def test_a_region_of_what_is_left_to_chance_differs_by_no_more_than_noise():
    scene, cache = room(), Cache()
    part, whole = part_and_whole(scene, cache)
    _, other = part_and_whole(scene, cache, seed=1)
    assert difference(part, whole) < 1.5 * difference(other, whole)
    assert part.mean() == pytest.approx(whole.mean(), rel=0.01)


# What a scene does not need is not done


def test_sharp_lamps_take_no_cones():
    for lamp in (
        SHARP_SUN,
        Light("POINT", at(0, 0, 3), power=100.0),
        Light("SPOT", at(0, 0, 3), power=100.0),
    ):
        scene = replace(lit_floor(), lights=[lamp])
        found = counters(scene)
        assert found.get("lamp_cones", 0) == 0
        assert found["shadow_rays"] > 0
    assert counters(lit_floor(radius=0.1))["lamp_cones"] > 0
    assert counters(replace(lit_floor(), lights=[replace(SHARP_SUN, angle=0.2)]))["lamp_cones"] > 0


def test_what_is_not_glossy_takes_no_cones():
    def of(material):
        return counters(lit_floor(quad(1.0, 1.0, material)))

    dull = of(principled("dull", specular_ior_level=0.0))
    assert dull.get("lobe_cones", 0) == 0 and dull.get("lobe_fragments", 0) == 0
    glossy = of(principled("glossy", metallic=1.0, roughness=0.3))
    assert glossy["lobe_cones"] > 0


def test_nothing_is_asked_for_light_where_there_is_none():
    dark = lit_floor()
    dark.lights.clear()
    found = counters(dark)
    assert found.get("shadow_rays", 0) == 0 and found.get("lamp_cones", 0) == 0
    assert counters(replace(dark, world=uniform_world()))["shadow_rays"] > 0


def test_lamps_without_shadow_take_no_cones():
    assert counters(lit_floor(radius=0.1, cast_shadow=False)).get("lamp_cones", 0) == 0


def test_what_is_not_seen_has_no_samples():
    """Sets of a group that is hidden from the camera, behind it, or in view."""

    def sets(*more):
        seen = quad(1.0, material=principled("seen", specular_ior_level=0.0))
        scene = Scene(Group("root", [seen], list(more)), from_above(), [SHARP_SUN], DARK)
        return render(scene, TINY).stats["needs"]["sample_sets"]

    def fine():
        return Group("fine", [Mesh("fine", *sphere(64, 128, 0.5))])

    alone = sets()
    assert sets(instance(fine(), at(0, 0, 1), visibility=SHADOW)) == alone
    assert sets(instance(fine(), at(0, 0, 9))) == alone
    assert sets(instance(fine(), at(0, 0, 1), visibility=CAMERA)) > alone


# Bad input


def test_without_a_camera_the_error_says_so():
    with pytest.raises(SceneError, match="no camera"):
        render(Scene(Group("root")), TINY)


@pytest.mark.parametrize("lights", [[], [SHARP_SUN], [replace(SHARP_SUN, angle=0.2)]])
def test_an_empty_scene_is_its_world(lights):
    for world in (DARK, uniform_world((0.25, 0.5, 1.0))):
        found = image(Scene(Group("root"), from_above(), lights, world))
        assert found == pytest.approx(np.broadcast_to(world_color(world), found.shape), abs=1e-6)


def world_color(world) -> tuple:
    return (0.0, 0.0, 0.0) if world is DARK else (0.25, 0.5, 1.0)


def test_without_lights_all_is_black():
    scene = lit_floor(quad(1.0, 1.0, mirror()))
    scene.lights.clear()
    assert (image(scene) == 0).all()


def bad_meshes() -> list[Mesh]:
    """Vertices that are no numbers, triangles without area, normals of length 0."""
    broken = quad(2.0, 1.0, principled("broken"))
    broken.positions[3] = np.nan
    needle = quad(2.0, 1.5, mirror(), "needle")
    needle.positions[:, 1] = 0.0
    blank = replace(quad(1.0, 0.5, mirror(0.3), "blank"), normals=np.zeros((4, 3), np.float32))
    return [broken, needle, blank, Mesh("none", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))]


LAMPS = [
    Light("POINT", at(0, 0, 0), power=10.0),  # in the floor
    Light("POINT", at(0, 0, 0.1), power=10.0, radius=0.5),  # half below it
    Light("AREA", at(0.5, 0, 0), power=10.0, size_x=1.0),
    Light("AREA", at(0, 0.5, 2), power=10.0, size_x=0.0),
    Light("SUN", at(0, 0, 0), power=1.0, angle=math.pi),
    Light("SPOT", np.diag([0.0, 0.0, 0.0, 1.0]), power=1.0, radius=0.1),
]


@pytest.mark.parametrize("lamp", LAMPS, ids=lambda lamp: lamp.kind)
@pytest.mark.parametrize("material", ["dull", "mirror", "glass"])
def test_every_pixel_is_a_number(lamp, material):
    surface = {
        "dull": principled("dull"),
        "mirror": mirror(),
        "glass": principled("glass", transmission_weight=1.0, roughness=0.1),
    }[material]
    meshes = [quad(20.0, material=surface), *bad_meshes(), quad(20.0, 5.0, surface, "through the camera")]
    scene = Scene(Group("root", meshes), from_above(), [lamp], uniform_world((0.5, 0.5, 0.5)))
    found = image(scene, width=24, height=18)
    assert np.isfinite(found).all() and (found >= 0).all()


# Far from the origin


def carried(scene: Scene, m: np.ndarray) -> Scene:
    """All of the scene placed by the 4x4 matrix m."""
    camera = replace(scene.camera, world_from_camera=m @ scene.camera.world_from_camera)
    lights = [replace(lamp, world_from_light=m @ lamp.world_from_light) for lamp in scene.lights]
    return Scene(Group("root", [], [instance(scene.root, m)]), camera, lights, scene.world)


@pytest.mark.parametrize("name", ["floor", "room"])
def test_a_million_metres_away_the_image_is_the_same(name):
    """But for noise, whose places move with the scene."""
    scene = (
        room() if name == "room" else lit_floor(quad(1.0, 1.0, principled("dull", specular_ior_level=0.0)))
    )
    near, far = (image(carried(scene, m), cones=4) for m in (np.eye(4), at(1e6, -1e6, 1e6)))
    if name == "room":  # what is left to chance differs as much as between two seeds
        other = image(carried(scene, np.eye(4)), cones=4, seed=1)
        bound = 1.5 * difference(*most(other, near))
        far, near = most(far, near)
    else:
        bound = 1e-3
    assert difference(far, near) < bound
    assert far.mean() == pytest.approx(near.mean(), rel=0.005)
