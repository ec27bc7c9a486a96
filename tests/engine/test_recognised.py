"""Scenes that follow each other: what is the same in content is known again, and what was made of it is used again."""

import copy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from instanced import sphere
from small_scenes import at, from_above, quad

from pointmr_engine import (
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
from pointmr_engine.render import Cache, Cancelled
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.material import Material
from pointmr_engine.scene.recognised import recognised
from pointmr_engine.scene.texture import Image


def painted() -> Material:
    """A material with an image."""
    pixels = np.random.default_rng(1).random((4, 4, 4)).astype(np.float32)
    nodes = {
        "image": Node("image_texture", {}, {"image": Image("dots", pixels)}),
        "bsdf": Node("diffuse", {"color": Link("image", "color")}),
    }
    return Material("painted", Graph(nodes, surface=Link("bsdf", "bsdf")))


def meadow() -> Scene:
    """Cards placed twice, two of which cannot be told apart, on a floor under a lamp."""
    grey, dots = principled("grey"), painted()
    card, twin, odd = quad(1.0, 0.3, grey, "card"), quad(1.0, 0.3, grey, "card"), quad(0.5, 0.6, dots, "odd")
    odd.positions[3] = np.nan
    patch = Group("patch", [card, twin, odd])
    places = np.tile(np.eye(4)[:3], (5, 1, 1))
    places[:, 0, 3] = np.arange(5)
    batch = Instances((patch,), places, object_index=np.arange(5, dtype=np.int32), name="patches")
    root = Group("root", [quad(9.0, material=grey, name="floor")], [batch, instance(patch, at(0, 2, 0))])
    lamps = [Light("POINT", at(0, 0, 3), power=100.0, radius=0.1), Light("SUN", at(0, 0, 5))]
    return Scene(root, from_above(6.0), lamps, uniform_world((0.1, 0.2, 0.3)))


def patch_of(scene: Scene) -> Group:
    return scene.root.instances[0].groups[0]


def test_a_copy_is_the_same_objects():
    first = meadow()
    second = copy.deepcopy(first)
    second.camera = from_above(5.0)
    found = recognised(second, first)
    assert found.root is first.root and found.world is first.world
    assert all(a is b for a, b in zip(found.lights, first.lights, strict=True))
    assert found.camera is second.camera and second.root is not first.root


def _vertex(scene):
    patch_of(scene).meshes[2].positions[1, 0] += 1e-6


def _pixel(scene):
    patch_of(scene).meshes[2].materials[0].graph.nodes["image"].params["image"].pixels[2, 1, 0] += 0.1


def _grey(scene):
    scene.root.meshes[0].materials[0].graph.nodes["bsdf"].inputs["roughness"] = 0.25


def _move(scene):
    scene.root.instances[0].transforms[3, 1, 3] += 1e-6


def _index(scene):
    scene.root.instances[0].object_index[4] = 7


def _lamp(scene):
    scene.lights[1].power *= 1.5


def _world(scene):
    scene.world.graph.nodes["background"].inputs["strength"] = 2.0


def _name(scene):
    patch_of(scene).meshes[0].name = "other"


def parts(scene: Scene) -> dict:
    patch = patch_of(scene)
    named = dict(zip(("card", "twin", "odd"), patch.meshes, strict=True))
    lamps = {f"lamp {light.kind}": light for light in scene.lights}
    return {
        "root": scene.root,
        "patch": patch,
        "floor": scene.root.meshes[0],
        "world": scene.world,
        **named,
        **lamps,
    }


@pytest.mark.parametrize(
    ("change", "others"),
    [
        (_vertex, {"root", "patch", "odd"}),
        (_pixel, {"root", "patch", "odd"}),
        (_grey, {"root", "patch", "card", "twin", "floor"}),
        (_move, {"root"}),
        (_index, {"root"}),
        (_lamp, {"lamp SUN"}),
        (_world, {"world"}),
        (_name, {"root", "patch", "card", "twin"}),
    ],
)
def test_what_differs_is_another_and_all_that_holds_it(change, others):
    """Of cards that cannot be told apart, the first in order is the first there was."""
    first = meadow()
    second = copy.deepcopy(first)
    change(second)
    before, found = parts(first), parts(recognised(second, first))
    assert {name for name in found if found[name] is not before[name]} == others
    # neither was changed
    again = parts(second)
    assert all(again[name] is not before[name] for name in again)


def test_roundings_do_not_count():
    """As Blender's bevels have them, of which no two are the same to the last bit. Places in the world are exact."""
    first = meadow()
    second = copy.deepcopy(first)
    odd = patch_of(second).meshes[2]
    odd.positions[:] = np.nextafter(odd.positions, np.float32(9.0))
    assert recognised(second, first).root is first.root
    second.root.instances[0].transforms[3, 0, 3] += 1e-13
    assert recognised(second, first).root is not first.root


def test_fewer_lamps_and_other_groups():
    first = meadow()
    second = copy.deepcopy(first)
    del second.lights[0]
    second.root.instances.pop()
    found = recognised(second, first)
    assert [light.kind for light in found.lights] == ["SUN"] and found.root is not first.root
    assert patch_of(found) is patch_of(first)


@given(st.integers(0, 2**32 - 1))
def test_whatever_is_recognised_has_the_content_that_it_had(seed):
    """Of random scenes of like-named meshes, some of which are the same."""
    rng = np.random.default_rng(seed)

    def scene() -> Scene:
        meshes = [quad(1.0 + rng.integers(2), 0.0, None, f"card {rng.integers(2)}") for _ in range(4)]
        groups = [
            Group(f"group {rng.integers(2)}", list(rng.permutation(meshes)[: rng.integers(1, 3)]))
            for _ in range(3)
        ]
        return Scene(Group("root", meshes[:1], [instance(g, at(rng.integers(2), 0, 0)) for g in groups]))

    first, second = scene(), scene()
    found = recognised(second, first)

    def told(group: Group):
        meshes = [(m.name, m.positions.tobytes()) for m in group.meshes]
        return group.name, meshes, [(i.transforms.tobytes(), told(i.groups[0])) for i in group.instances]

    assert told(found.root) == told(second.root)
    own = [m for i in second.root.instances for m in i.groups[0].meshes]
    kept = [m for i in found.root.instances for m in i.groups[0].meshes]
    # what was one is one, and what was two is two
    assert [[a is b for b in own] for a in own] == [[a is b for b in kept] for a in kept]


@pytest.fixture
def built(monkeypatch) -> list:
    """Names of what was built, as it is built."""
    import pointmr_engine.forward.method as splatted
    import pointmr_engine.hierarchy.acceleration as walked
    import pointmr_engine.raytracing.lights as lights

    names = []
    for module, name in (
        (splatted, "build_octree"),
        (walked, "build_acceleration"),
        (lights, "build_lights"),
    ):
        real = getattr(module, name)

        def count(*values, real=real, name=name, **more):
            names.append(name)
            return real(*values, **more)

        monkeypatch.setattr(module, name, count)
    return names


@pytest.mark.parametrize("method", ["raytrace", "forward", "distributed"])
def test_frames_of_an_animation_are_built_once(method, built):
    """Frames with a camera that moves; then one under another lamp, another world, and one of another surface."""
    settings = RenderSettings(24, 16, method=method, samples=2)
    scene, cache = meadow(), Cache()
    render(scene, settings, cache=cache)
    all_of_it = {
        "raytrace": {"build_octree", "build_acceleration", "build_lights"},
        "forward": {"build_octree"},
        "distributed": {"build_acceleration", "build_lights"},
    }[method]
    assert set(built) == all_of_it
    lights = all_of_it & {"build_lights"}
    for change, made in (
        (None, set()), (_lamp, lights), (None, set()), (_world, lights), (_vertex, all_of_it), (None, set())
    ):  # fmt: skip
        scene = copy.deepcopy(scene)
        scene.camera.world_from_camera[0, 3] += 0.3
        if change is not None:
            change(scene)
        built.clear()
        found = render(scene, settings, cache=cache)
        assert set(built) == made
        fresh = render(scene, settings)
        assert found.warnings == fresh.warnings
        for name, pixels in fresh.passes.items():
            assert np.array_equal(found.passes[name], pixels, equal_nan=True), (change, name)


@pytest.mark.parametrize("method", ["raytrace", "forward", "distributed"])
def test_what_the_world_warns_of_is_said_of_every_frame(method):
    """Where another lamp was all that is new, and nothing was made of the world again."""
    scene, cache = meadow(), Cache()
    scene.world.graph.nodes["odd"] = Node("unheard_of")
    scene.world.graph.nodes["background"].inputs["strength"] = Link("odd", "value")
    for _ in range(3):
        frame = render(scene, RenderSettings(8, 8, method=method, samples=2), cache=cache)
        assert len([w for w in frame.warnings if "unheard_of" in w]) == 1
        scene = copy.deepcopy(scene)
        _lamp(scene)


def test_a_method_that_follows_another_adds_what_it_needs(built):
    scene, cache = meadow(), Cache()
    splatted, walked = (
        RenderSettings(8, 8, method="forward"),
        RenderSettings(8, 8, method="distributed", samples=2),
    )
    render(scene, splatted, cache=cache)
    scene = copy.deepcopy(scene)
    _world(scene)
    built.clear()
    found = render(scene, walked, cache=cache)
    assert built == ["build_acceleration", "build_lights"]
    assert np.array_equal(found.passes["combined"], render(scene, walked).passes["combined"])
    found = render(scene, splatted, cache=cache)
    assert np.array_equal(found.passes["combined"], render(scene, splatted).passes["combined"])


# What is left of a scene in which things move


def wood(leafy: Material) -> Scene:
    """Trees of leaves far away, and a ball that may roll among them."""
    rng = np.random.default_rng(3)
    corners = rng.normal(size=(3000, 1, 3)) + 0.02 * rng.normal(size=(3000, 3, 3))
    uvs = {"UVMap": np.tile(np.array([[[0, 0], [1, 0], [0, 1]]], np.float32), (3000, 1, 1))}
    crown = Mesh(
        "crown", corners.reshape(-1, 3).astype(np.float32), np.arange(9000, dtype=np.int32).reshape(-1, 3), uvs=uvs,
        materials=(leafy,), active_uv="UVMap",
    )  # fmt: skip
    tree = Group("tree", [crown])
    places = np.tile(np.eye(4)[:3], (30, 1, 1))
    places[:, :2, 3] = rng.uniform(-8, 8, (30, 2))
    p, t = sphere(6, 8)
    ball = Mesh("ball", p.astype(np.float32), t.astype(np.int32), materials=(principled("red"),))
    batches = [
        instance(Group("ball", [ball]), at(0, 0, 2), name="ball"),
        Instances((tree,), places, name="trees"),
    ]
    sun = Light("SUN", at(0, 0, 5), angle=0.1)
    return Scene(
        Group("root", [quad(20.0, -1.0, principled("grey"), "floor")], batches), from_above(40.0), [sun]
    )


def leaves(placed: bool = False) -> Material:
    """With holes by an image; `placed`: other ones in each tree."""
    pixels = np.ones((8, 8, 4), np.float32)
    pixels[2:5, 1:7, 3] = 0.0
    alpha = Link("image", "alpha")
    nodes = {"image": Node("image_texture", {}, {"image": Image("holes", pixels)})}
    if placed:
        nodes["object"] = Node("object_info")
        nodes["alpha"] = Node(
            "math", {"value": alpha, "value_b": Link("object", "random")}, {"operation": "MULTIPLY"}
        )
        alpha = Link("alpha", "value")
    nodes["bsdf"] = Node("principled", {"alpha": alpha, "base_color": (0.2, 0.5, 0.1)})
    return Material("leaves", Graph(nodes, surface=Link("bsdf", "bsdf")))


def _roll(scene):
    scene.root.instances[0].transforms[0, 0, 3] += 1.0


def _squash(scene):
    scene.root.instances[0].groups[0].meshes[0].positions[:, 2] *= 0.5


def crown_of(scene: Scene) -> Mesh:
    return scene.root.instances[1].groups[0].meshes[0]


def _dry(scene):
    crown_of(scene).materials[0].graph.nodes["bsdf"].inputs["base_color"] = (0.5, 0.4, 0.1)


def _wither(scene):
    crown_of(scene).materials[0].graph.nodes["image"].params["image"].pixels[5:, :, 3] = 0.0


def _plant(scene):
    """Another tree, and another kind of things before all others."""
    batch = scene.root.instances[1]
    batch.transforms = np.concatenate([batch.transforms, batch.transforms[:1] + 1.5])
    scene.root.instances.insert(
        0, instance(Group("card", [quad(0.5, 1.0, principled("blue"), "card")]), name="card")
    )


@pytest.mark.parametrize("method", ["raytrace", "forward"])
@pytest.mark.parametrize(
    ("placed", "change", "kept"),
    [
        (False, _roll, {"holes", "sets"}),
        (False, _squash, {"holes", "sets"}),
        (False, _dry, set()),
        (False, _wither, set()),
        (False, _plant, {"sets"}),
        (True, _roll, set()),
    ],
)
def test_where_things_move_the_others_are_as_they_were(placed, change, kept, method, monkeypatch):
    import pointmr_engine.forward.method as splatted

    looked, real = [], splatted.build_cut_outs
    monkeypatch.setattr(splatted, "build_cut_outs", lambda *values: looked.append(1) or real(*values))
    settings = RenderSettings(40, 30, method=method)
    first, cache = wood(leaves(placed)), Cache()
    render(first, settings, cache=cache)
    second = copy.deepcopy(first)
    change(second)
    looked.clear()
    found = render(second, settings, cache=cache)
    assert bool(looked) == ("holes" not in kept)
    needs = found.stats["needs"]
    fresh = render(second, settings)
    if "sets" in kept and method == "raytrace":  # the other takes sets of the whole wood
        assert needs["sample_sets_adopted"] > 0
        assert fresh.stats["needs"]["sample_sets_made"] > needs["sample_sets_made"]
    for name, pixels in fresh.passes.items():
        assert np.array_equal(found.passes[name], pixels, equal_nan=True), name


def test_a_scene_that_was_cancelled_passes_on_what_was_before_it():
    """As scenes are while an object is dragged in a viewport."""
    settings, cache = RenderSettings(40, 30), Cache()
    scene = wood(leaves())
    render(scene, settings, cache=cache)
    for stopped_at in ("comparing scenes", "building hierarchies", "rendering"):
        scene = copy.deepcopy(scene)
        _roll(scene)
        with pytest.raises(Cancelled):
            render(scene, settings, lambda fraction, text, tile, at=stopped_at: text == at, cache=cache)
    scene = copy.deepcopy(scene)
    _roll(scene)
    found = render(scene, settings, cache=cache)
    assert found.stats["needs"]["sample_sets_adopted"] > 0
    assert np.array_equal(found.passes["combined"], render(scene, settings).passes["combined"])
