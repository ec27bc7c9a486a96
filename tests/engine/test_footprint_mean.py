"""Means of procedural textures over footprints: against closed forms, and evaluated no more often than needed."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine import (
    Camera,
    Material,
    RenderSettings,
    Scene,
    render,
    uniform_world,
)
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import Group
from pointmr_engine.scene.texture import Image
from pointmr_engine.shading.differentials import moved_points
from pointmr_engine.shading.footprint_mean import (
    ALL,
    FIRST,
    GRAZING,
    MORE,
    NEEDS,
    Slopes,
    footprint_means,
    stretched_means,
)
from pointmr_engine.shading.footprint_slopes import allocate_texture_slopes, fill_slopes
from pointmr_engine.shading.points import SurfacePoints
from pointmr_engine.shading.program import compile_graph
from tests.engine.small_scenes import from_above, quad

BLACK, WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)


def checkered(scale=1.0, shader="emission", kind="checker_texture") -> Graph:
    """Black and white squares of side 1 / scale in the object's space."""
    inputs = {"vector": Link("c", "object"), "scale": scale}
    if kind == "checker_texture":
        inputs |= {"color1": WHITE, "color2": BLACK}
    nodes = {
        "c": Node("texture_coordinate"),
        "t": Node(kind, inputs),
        "e": Node(shader, {"color": Link("t", "color")}),
    }
    return Graph(nodes, surface=Link("e", "emission" if shader == "emission" else "bsdf"))


def plane_points(position, width, incoming=(0.0, 0.0, 1.0)):
    """Points (n, 3) of the plane z = 0.5 with square footprints, seen along -incoming."""
    n = len(position)
    position = np.column_stack([np.asarray(position, float), np.full(n, 0.5)])
    up = np.tile(np.array([[0, 0, 1]], np.float32), (n, 1))
    seen = np.tile(np.array([incoming], np.float32), (n, 1))
    return SurfacePoints(
        n, position=position, local=position.astype(np.float32), geometric_normal=up, incoming=seen,
        footprint=np.full(n, width, np.float32),
    )  # fmt: skip


def taken(points):
    """`gather` of these points, for footprint_means."""

    def gather(rows):
        return SurfacePoints(
            len(rows),
            **{
                name: getattr(points, name)[rows]
                for name in ("position", "local", "geometric_normal", "incoming", "footprint")
            },
        )

    return gather


def white(program, points, seed=0) -> np.ndarray:
    """(n,) mean of the texture over the footprints."""
    rows = np.arange(points.count)
    means, _, _ = footprint_means(program.fine_values, taken(points), rows, program.fine_needs, seed)
    (value,) = means.values()
    return value[:, 0]


@pytest.mark.parametrize("scale", [3.7, 50.0, 1e4])
def test_far_squares_are_grey(scale):
    rng = np.random.default_rng(1)
    program = compile_graph(checkered(scale))
    points = plane_points(rng.random((400, 2)), 2.0)
    found = white(program, points)
    assert found.mean() == pytest.approx(0.5, abs=0.02)
    assert found.std() < 0.5 / np.sqrt(ALL) * 1.3
    # at their centres they are black or white
    centre = program.fine_values(points).popitem()[1]
    assert set(np.unique(centre)) == {0.0, 1.0}


@given(st.floats(0.02, 0.98))
def test_an_edge_is_resolved_as_far_as_places_are(share):
    """A footprint of which `share` lies beyond an edge; ALL places, stratified along each axis."""
    program = compile_graph(checkered(1.0))
    x = 1.0 - (0.5 - share) * 0.1
    tilted = (0.0, 0.01, 0.99995)  # so that the footprint's sides are along the axes
    found = white(program, plane_points([[x, 0.5]], 0.1, tilted))
    beyond = white(program, plane_points([[1.5, 0.5]], 0.1, tilted))
    covered = found if beyond[0] == 1.0 else 1.0 - found
    assert covered[0] == pytest.approx(share, abs=1.01 / FIRST if covered[0] in (0.0, 1.0) else 1.01 / ALL)


def test_what_is_even_is_asked_at_a_few_places_only():
    program, counts = compile_graph(checkered(1.0)), []

    def run(points):
        counts.append(points.count)
        return program.fine_values(points)

    # nine footprints within white squares, one on a corner, of which the ninth is told
    position = np.array([[2 * k + 1.5, 0.5] for k in range(9)] + [[3.0, 1.0]])
    footprint_means(run, taken(plane_points(position, 0.2)), np.arange(10), program.fine_needs)
    assert counts == [10 * FIRST, 2 * (MORE - FIRST), ALL - MORE]
    # what is not worth more than a few takes no more, whatever they are like
    counts.clear()
    few = np.arange(10) == 9
    footprint_means(run, taken(plane_points(position, 0.2)), np.arange(10), program.fine_needs, 0, few)
    assert counts == [10 * FIRST, MORE - FIRST]


def of_plane(run, n=300, width=0.1):
    """Slopes of the values of run(points) over n footprints of the plane that are seen from aside."""
    points = plane_points(np.random.default_rng(4).random((n, 2)), width, (0.6, 0.0, 0.8))
    mean, _, slopes = footprint_means(run, taken(points), np.arange(n), frozenset({"position"}))
    return mean, slopes


def test_slopes_of_what_is_linear_are_exact():
    def run(points):
        x, y = points.position[:, 0], points.position[:, 1]
        return {
            "one": (1.0 + 2.0 * x - 3.0 * y).astype(np.float32),
            "two": np.stack([x, y], 1).astype(np.float32),
        }

    mean, slopes = of_plane(run)
    at = slopes.rows
    assert len(at) > 200  # those that differ
    for sides, found in zip(slopes.sides, slopes.along, strict=True):
        np.testing.assert_allclose(found["one"], sides @ [2.0, -3.0, 0.0], atol=2e-3)
        np.testing.assert_allclose(found["two"], sides[:, :2], atol=2e-3)


def test_slopes_of_what_comes_by_chance_vanish():
    """Planes nearest to white noise are not flat: to 32 places, they rise by 0.25."""
    rng = np.random.default_rng(6)
    _, slopes = of_plane(lambda p: {"noise": rng.random(p.count).astype(np.float32)})
    steep = np.hypot(*(found["noise"] for found in slopes.along))
    assert np.median(steep) < 0.05 and np.sqrt((steep**2).mean()) < 0.15


def test_slopes_of_an_edge_are_those_of_the_nearest_plane():
    """Half black, half white: the mean and a slope of 1.5 have the same first moments."""
    _, slopes = of_plane(lambda p: {"step": (np.floor(p.position[:, 1] / 0.1) % 2).astype(np.float32)})
    y = plane_points(np.random.default_rng(4).random((300, 2)), 0.1).position[slopes.rows, 1] / 0.1
    rest, sign = y % 1, np.where(np.floor(y) % 2, -1.0, 1.0)
    middle = np.abs(rest - 0.5) > 0.35  # edges near the middle of the footprint
    sign = np.where(rest > 0.5, sign, -sign)
    across = np.sign(slopes.sides[0][:, 1]) * slopes.along[0]["step"]
    share = np.minimum(rest, 1 - rest)
    exact = sign * 6.0 * (0.5 - share) * (0.5 + share)
    assert middle.sum() > 50
    np.testing.assert_allclose(across[middle], exact[middle], atol=0.25)


def striped(*more: tuple[str, Node]) -> Graph:
    """An image of black and white stripes, ten to a metre of x, whose edges the pyramid knows exactly."""
    pixels = np.zeros((64, 64, 4), np.float32)
    pixels[:, 32:, :3], pixels[..., 3] = 1.0, 1.0
    nodes = {
        "c": Node("texture_coordinate"),
        "m": Node("mapping", {"vector": Link("c", "object"), "scale": (5.0, 5.0, 5.0)}),
        "t": Node(
            "image_texture", {"vector": Link("m", "vector")}, {"image": Image("stripes", pixels, "Linear")}
        ),
        "d": Node("diffuse", {"color": Link("t", "color")}),
    } | dict(more)
    return Graph(nodes, surface=Link("d", "bsdf"))


@pytest.mark.parametrize("cosine", [0.5, 0.2, 0.06])
def test_images_are_averaged_along_oblique_footprints(cosine):
    """Stripes across the view: the mean of a long footprint, where a square of its width would show black or white."""
    width, sine = 0.01, np.sqrt(1 - cosine**2)
    program = compile_graph(striped())
    points = plane_points(np.random.default_rng(5).random((500, 2)), width, (sine, 0.0, cosine))
    rows = np.arange(500)
    means = stretched_means(
        program.image_values, taken(points), rows, program.image_needs, np.full(500, cosine, np.float32)
    )
    (found,) = means.values()
    x = points.position[:, 0, None] + width / cosine * (np.arange(400) + 0.5 - 200) / 400
    exact = ((5.0 * x) % 1.0 >= 0.5).mean(1)
    (square,) = program.image_values(points).values()
    rms, before = (np.sqrt(((v[:, 0] - exact) ** 2).mean()) for v in (found, square))
    assert rms < 0.06 and rms < 0.5 * before


def test_means_of_images_and_of_fine_textures_are_apart():
    """What an image alone decides is no fine texture; what is fine, and takes an image, is averaged but once."""
    assert compile_graph(striped()).fine_needs == frozenset()
    assert compile_graph(striped(), filtered=False).image_needs == frozenset()
    assert compile_graph(checkered(1.0, "diffuse")).image_needs == frozenset()
    noisy = striped(
        ("n", Node("noise_texture", {"vector": Link("t", "color")})),
        ("d", Node("diffuse", {"color": Link("n", "color")})),
    )
    program = compile_graph(noisy)
    assert program.fine_needs >= NEEDS and program.image_needs == frozenset()


@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.1, 0.01])
def test_places_fill_the_footprint_on_the_surface(cosine):
    """Width across the view, width / cosine along it."""
    sine = np.sqrt(1 - cosine**2)
    points, places = plane_points(np.random.default_rng(2).random((300, 2)), 0.1, (sine, 0.0, cosine)), []

    def run(moved):
        places.append(moved.position[:, :2])
        return {"x": moved.position[:, 0].astype(np.float32)}

    footprint_means(run, taken(points), np.arange(300), frozenset({"position"}))
    offset = places[0] - np.tile(points.position[:, :2], (FIRST, 1))
    wide = 0.1 / max(cosine, GRAZING)
    extent = np.abs(offset).max(0)
    if cosine == 1.0:
        assert np.linalg.norm(offset, axis=1).max() == pytest.approx(0.5 * 0.1 * np.sqrt(2), rel=0.05)
    else:
        assert extent == pytest.approx([0.5 * wide, 0.5 * 0.1], rel=0.05)
    assert abs(offset.mean(0)) == pytest.approx(np.zeros(2), abs=0.03 * wide)


def test_other_seeds_have_other_places():
    program = compile_graph(checkered(40.0))
    points = plane_points(np.random.default_rng(3).random((200, 2)), 1.0)
    first, again, other = white(program, points), white(program, points), white(program, points, seed=1)
    assert np.array_equal(first, again)
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.3


@pytest.mark.parametrize(
    "kind",
    [
        "noise_texture",
        "voronoi_texture",
        "white_noise_texture",
        "brick_texture",
        "magic_texture",
        "wave_texture",
    ],
)
def test_every_procedural_texture_is_averaged(kind):
    graph = checkered(50.0, kind=kind)
    if kind == "white_noise_texture":
        del graph.nodes["t"].inputs["scale"]
    program = compile_graph(graph)
    points = plane_points(np.random.default_rng(4).random((300, 2)), 3.0)
    centre = program.fine_values(points).popitem()[1][:, 0]
    assert white(program, points).std() < 0.6 * centre.std()


def test_slopes_are_of_what_is_fine_alone():
    """What an image was averaged to, beside a fine texture, is no change of it."""
    graph = striped(
        ("f", Node("checker_texture", {"vector": Link("c", "object"), "color1": WHITE, "color2": BLACK}))
    )
    graph.nodes["d"] = Node("diffuse", {"color": Link("f", "color")})
    graph.nodes["e"] = Node("emission", {"color": Link("t", "color")})
    graph.nodes["a"] = Node("add_shader", {"shader": Link("d", "bsdf"), "shader_b": Link("e", "emission")})
    graph.surface = Link("a", "shader")
    program, points = compile_graph(graph), plane_points([[0.2, 0.2], [0.4, 0.6]], 0.1)
    (fine,), (image,), rows = program.fine_values(points), program.image_values(points), np.arange(2)
    grey = np.full((2, 3), 0.5, np.float32)
    means, values = [(rows, {fine: grey}), (rows, {image: 0.5 * grey})], program.values(points)
    change = np.full((1, 3), 0.3, np.float32)
    slopes = Slopes(rows[1:], np.ones((2, 1, 3)), ({fine: change}, {fine: 0 * change}))
    found = allocate_texture_slopes(4)
    leaves = program.fill_leaves(values, means)
    fill_slopes(program, values, means, leaves, slopes, np.array([3, 1]), found)
    assert found.known.tolist() == [False, True, False, False]
    np.testing.assert_allclose(found.change[:, 1], [[0.3 / 0.75] * 3, [0.0] * 3], atol=1e-5)


def test_only_what_is_fine_and_filtered_is_averaged():
    plain = Graph({"e": Node("emission", {"color": WHITE})}, surface=Link("e", "emission"))
    assert compile_graph(plain).fine_needs == frozenset()
    assert compile_graph(checkered(), filtered=False).fine_needs == frozenset()
    assert compile_graph(checkered()).fine_needs >= NEEDS
    assert compile_graph(checkered()).normal_needs == frozenset()
    # the normals that bumps bend are, and what differences heights for a column is not
    program = compile_graph(bumpy(Node("glossy", {"roughness": 0.1})))
    assert program.normal_needs >= NEEDS and program.fine_needs == frozenset()
    # not those of lobes that are wider than what a bump would make of them
    for blunt in (
        Node("diffuse"),
        Node("glossy", {"roughness": 0.5}),
        Node("principled", {"roughness": 0.5}),
    ):
        assert compile_graph(bumpy(blunt)).normal_needs == frozenset(), blunt
    for sharp in ({"roughness": 0.3}, {"roughness": 0.5, "coat_weight": 0.5, "coat_roughness": 0.1}):
        assert compile_graph(bumpy(Node("principled", sharp))).normal_needs, sharp
    graph = checkered(shader="emission")
    graph.nodes["b"] = Node("bump", {"height": Link("t", "fac")})
    graph.nodes["e"].inputs = {"color": Link("b", "normal")}
    assert compile_graph(graph).fine_needs == frozenset()


def bumpy(shader: Node, scale=40.0, distance=0.05) -> Graph:
    """A surface that a noise bends, whose waves are 1 / scale long."""
    shader.inputs["normal"] = Link("b", "normal")
    nodes = {
        "c": Node("texture_coordinate"),
        "t": Node("noise_texture", {"vector": Link("c", "object"), "scale": scale, "detail": 2.0}),
        "b": Node("bump", {"height": Link("t", "fac"), "distance": distance}),
        "e": shader,
    }
    return Graph(nodes, surface=Link("e", "bsdf"))


@pytest.mark.parametrize(("method", "bound"), [("raytrace", 0.1), ("forward", 0.17)])
def test_a_floor_of_far_squares_has_no_moire(method, bound):
    """Seen straight and towards the horizon: far smaller than a pixel they are grey, but for noise."""
    floor = quad(2000.0, material=Material("squares", checkered(7.3)))
    look = np.array([[1, 0, 0, 0], [0, 0.3, -0.954, 0], [0, 0.954, 0.3, 30.0], [0, 0, 0, 1]])
    cameras = {"straight": from_above(50.0), "horizon": Camera(look)}
    settings = RenderSettings(32, 24, method=method)
    settings = dataclasses.replace(settings, forward=dataclasses.replace(settings.forward, shading="full"))
    for name, camera in cameras.items():
        scene = Scene(Group("root", [floor]), camera, [], uniform_world((0.5, 0.5, 0.5)))
        image = render(scene, settings).passes["combined"][..., :3].astype(float)
        assert image.mean() == pytest.approx(0.5, abs=0.02), name
        assert image.std() < bound, name


def test_points_moved_to_several_places_at_once_are_those_moved_to_each():
    """Without `moved`, too, where local places follow the object's transform."""
    rng = np.random.default_rng(3)
    points = plane_points(rng.uniform(-1, 1, (5, 2)), 0.2)
    points.local = rng.uniform(-1, 1, (5, 3)).astype(np.float32)
    points.world_from_part = np.tile(np.diag((2.0, 3.0, 4.0, 1.0))[:3], (5, 1, 1))
    offsets = rng.uniform(-0.1, 0.1, (3, 5, 3))
    whole = moved_points(points, offsets.reshape(-1, 3), frozenset({"position", "local"}))
    for k in range(3):
        one = moved_points(points, offsets[k], frozenset({"position", "local"}))
        np.testing.assert_array_equal(whole.position[5 * k : 5 * k + 5], one.position)
        np.testing.assert_array_equal(whole.local[5 * k : 5 * k + 5], one.local)
    assert whole.count == 15
