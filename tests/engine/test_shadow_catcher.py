"""Shadow catchers: what is seen of them are the shadows of others."""

import numpy as np
import pytest

from pointmr_engine import Group, Light, RenderSettings, Scene, principled, render, uniform_world
from pointmr_engine.render import Cache
from pointmr_engine.scene.catchers import has_catchers
from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.group import SHADOW_CATCHER, VISIBLE, Instances, instance
from pointmr_engine.scene.settings import ForwardSettings
from tests.engine.small_scenes import at, from_above, quad

METHODS = ["raytrace", "distributed", "conventional", "forward"]
CATCHER = VISIBLE | SHADOW_CATCHER
WHITE = principled("white", base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0)
BLACK = uniform_world((0.0, 0.0, 0.0))


def lamp(**values) -> Light:
    return Light("POINT", at(0, 0, 4), power=100.0, **values)


def caught(root: Group | None = None, lamps: tuple = (lamp(),), world=BLACK) -> Scene:
    """A card of side 1 at height 2 over a catcher: its shadow is a square of side 2."""
    if root is None:
        floor, card = Group("floor", [quad(20.0, 0.0, WHITE)]), Group("card", [quad(1.0, 2.0, WHITE)])
        root = Group("root", [], [instance(floor, visibility=CATCHER), instance(card)])
    # from the side, so that the card hides little of its shadow
    camera = from_above(6.0)
    camera.world_from_camera[0, 3] = 1.0
    return Scene(root, camera, list(lamps), world)


def shot(scene: Scene, method: str = "raytrace", film_transparent: bool = True, **more) -> np.ndarray:
    chosen = RenderSettings(
        96, 64, method=method, samples=4, film_transparent=film_transparent,
        forward=ForwardSettings(shadows=True, shading="full"), **more,
    )  # fmt: skip
    return render(scene, chosen).passes["combined"]


def pixel_of(x: float, y: float, z: float) -> tuple[int, int]:
    """(row, column) of a point of the world."""
    f = 96 * 50.0 / 36.0
    return round(31.5 + f * y / (6.0 - z)), round(47.5 + f * (x - 1.0) / (6.0 - z))


@pytest.mark.parametrize("method", METHODS)
def test_a_catcher_shows_shadows_only(method):
    image = shot(caught(), method)
    shadow, lit, card = (image[pixel_of(*p)] for p in ((0.7, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 2.0)))
    np.testing.assert_allclose(shadow, (0, 0, 0, 1), atol=0.02)
    np.testing.assert_allclose(lit, (0, 0, 0, 0), atol=0.02)
    assert card[3] > 0.98


def test_an_opaque_film_shows_the_world_behind():
    image = shot(caught(world=uniform_world((0.2, 0.3, 0.4))), "distributed", film_transparent=False)
    lit, shadow = image[pixel_of(2.5, 0.0, 0.0)], image[pixel_of(0.7, 0.0, 0.0)]
    np.testing.assert_allclose(lit, (0.2, 0.3, 0.4, 1.0), rtol=0.05)
    assert 0.02 < shadow[0] < 0.15
    np.testing.assert_allclose(shadow[:3] / shadow[0], (1.0, 1.5, 2.0), rtol=0.05)
    assert shadow[3] == 1.0


def test_lamps_that_are_not_of_the_catcher_leave_no_shadow():
    image = shot(caught(lamps=(lamp(lights_catchers=False),)))
    np.testing.assert_allclose(image[pixel_of(0.7, 0.0, 0.0)], 0.0, atol=0.02)
    assert image[pixel_of(0.0, 0.0, 2.0)][0] > 0.1  # the card is lit by it


def test_catchers_do_not_catch_each_other_s_shadows():
    floor, card = Group("floor", [quad(20.0, 0.0, WHITE)]), Group("card", [quad(1.0, 2.0, WHITE)])
    both = [instance(floor, visibility=CATCHER), instance(card, visibility=CATCHER)]
    image = shot(caught(Group("root", [], both)), "distributed")
    assert image[..., 3].max() < 0.05


@pytest.mark.parametrize("method", ["raytrace", "distributed"])
def test_catchers_may_lie_anywhere_in_a_tree_of_groups(method):
    """Beside others of a group that is placed, and a group both as a catcher and not."""
    floor, card = Group("floor", [quad(20.0, 0.0, WHITE)]), Group("card", [quad(1.0, 0.0, WHITE)])
    low = Instances((card, floor), np.stack([at(0, 0, 2.0)[:3], at(0, 0, 0)[:3]]), np.array([0, 1], np.int32),
                    np.array([VISIBLE, CATCHER], np.uint8))  # fmt: skip
    nested = Group("nested", [], [instance(Group("set", [], [low]))])
    spare = instance(card, at(3.5, 0, 0.01), visibility=CATCHER)
    image = shot(caught(Group("root", [], [instance(nested), spare])), method)
    np.testing.assert_allclose(image, shot(caught(), method), atol=0.05)


def test_meshes_of_the_root_are_objects():
    root = Group(
        "root", [quad(1.0, 2.0, WHITE)], [instance(Group("f", [quad(20.0, 0.0, WHITE)]), visibility=CATCHER)]
    )
    np.testing.assert_allclose(shot(caught(root)), shot(caught()), atol=0.05)


def test_a_scene_is_compiled_once_for_all_pictures():
    cache, scene, messages = Cache(), caught(), []
    chosen = RenderSettings(32, 32, method="raytrace", film_transparent=True)

    def progress(fraction, text, tile):
        messages.append((fraction, text))

    first = render(scene, chosen, progress, cache)
    compiled = cache._compiled
    assert sum(text == "building hierarchies" and fraction == 0 for fraction, text in messages) == 1
    fractions = [fraction for fraction, text in messages if text == "rendering"]
    assert fractions == sorted(fractions)
    np.testing.assert_array_equal(
        render(scene, chosen, None, cache).passes["combined"], first.passes["combined"]
    )
    assert cache._compiled is compiled


def test_scenes_without_catchers_are_left_alone():
    floor = Group("floor", [quad(20.0, 0.0, WHITE)])
    assert not has_catchers(Group("root", [], [instance(floor)]))
    messages = []
    scene = Scene(Group("root", [], [instance(floor)]), from_above(), [lamp()], BLACK)
    render(scene, RenderSettings(16, 16), lambda fraction, text, tile: messages.append(text) and None)
    assert messages.count("gathering lights") <= 1


def test_malformed_batches_are_named():
    floor = Group("floor", [quad(20.0, 0.0, WHITE)])
    bad = Instances(
        (floor,), np.stack([at(0, 0, 0)[:3]] * 3), None, np.full(2, CATCHER, np.uint8), name="cards"
    )
    with pytest.raises(SceneError, match="'cards' in group 'root': 2 values of visibility for 3 placements"):
        shot(caught(Group("root", [], [bad])))
