"""The compiler and evaluator of node graphs: folding, flattening, needs, what varies with what."""

from dataclasses import replace

import numpy as np
import pytest

from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.material import emission, principled
from pointmr_engine.scene.texture import Image
from pointmr_engine.scene.world import uniform_world
from pointmr_engine.shading import leaves as L
from pointmr_engine.shading.points import RAY_CAMERA, RAY_SHADOW, SurfacePoints
from pointmr_engine.shading.program import compile_graph, evaluate_background


def column(leaf, name):
    return leaf.block[:, L.COLUMNS[leaf.kind].index(name)]


def points(n=5, **fields):
    rng = np.random.default_rng(3)
    uv = rng.random((n, 2)).astype(np.float32)
    return SurfacePoints(n, uvs={"": uv}, uv_footprints={"": np.zeros(n, np.float32)}, **fields)


def shader_graph(nodes, surface):
    return Graph(nodes, surface=Link(surface, "shader"))


def test_constant_material_costs_nothing():
    program = compile_graph(principled(base_color=(0.1, 0.2, 0.3), roughness=0.4).graph)
    assert program.needs == frozenset() and program.surface_only and program.opaque and not program.emissive
    assert program.constant_emission == (0, 0, 0)
    (leaf,) = program.evaluate(SurfacePoints(1000))
    assert leaf.block.shape == (1, len(L.COLUMNS[L.PRINCIPLED])) and leaf.normal is None
    assert column(leaf, "base_color_g") == np.float32(0.2) and column(leaf, "roughness") == np.float32(0.4)
    assert program.evaluate(SurfacePoints(7))[0].block is leaf.block


def test_constant_subgraphs_fold():
    nodes = {
        "a": Node("math", {"value": 2.0, "value_b": 3.0}, {"operation": "MULTIPLY"}),
        "m": Node("mix_float", {"fac": 0.25, "a": Link("a", "value"), "b": 10.0}),
        "e": Node("emission", {"strength": Link("m", "value")}),
    }
    program = compile_graph(Graph(nodes, surface=Link("e", "emission")))
    assert program.constant_emission == pytest.approx((7, 7, 7))
    assert program.max_lobes == 0 and program.emissive


def test_dead_nodes_are_not_needed():
    nodes = {
        "uv": Node("uv_map", {}, {"layer": "other"}),
        "noise": Node("noise_texture", {"vector": Link("uv", "uv")}),
        "m": Node("mix_float", {"fac": 0.0, "a": 0.5, "b": Link("noise", "fac")}),
        "unused": Node("noise_texture"),
        "b": Node("principled", {"roughness": Link("m", "value")}),
    }
    program = compile_graph(Graph(nodes, surface=Link("b", "bsdf")))
    assert program.needs == frozenset() and column(program.evaluate(points())[0], "roughness") == 0.5


def test_only_wanted_outputs_are_needed():
    nodes = {"g": Node("geometry"), "b": Node("emission", {"strength": Link("g", "backfacing")})}
    assert compile_graph(Graph(nodes, surface=Link("b", "emission"))).needs == {"backfacing"}
    nodes["b"] = Node("emission", {"color": Link("g", "position")})
    assert compile_graph(Graph(nodes, surface=Link("b", "emission"))).needs == {"position"}


def test_mix_and_add_flatten_with_weights():
    nodes = {
        "d": Node("diffuse", {"color": (0.5, 0.5, 0.5)}),
        "g": Node("glossy", {"color": (1.0, 1.0, 1.0)}),
        "e": Node("emission", {"strength": 2.0}),
        "mix": Node("mix_shader", {"fac": 0.25, "shader": Link("d", "bsdf"), "shader_b": Link("g", "bsdf")}),
        "add": Node("add_shader", {"shader": Link("mix", "shader"), "shader_b": Link("e", "emission")}),
        # the glossy one is reached twice
        "top": Node(
            "mix_shader", {"fac": 0.5, "shader": Link("add", "shader"), "shader_b": Link("g", "bsdf")}
        ),
    }
    program = compile_graph(shader_graph(nodes, "top"))
    weights = {leaf.kind: leaf.block[0, 0] for leaf in program.evaluate(points())}
    assert weights == pytest.approx({L.DIFFUSE: 0.75 * 0.5 * 0.5, L.GLOSSY: 0.125 + 0.5, L.EMISSION: 1.0})
    assert program.max_lobes == 2 and program.constant_emission == pytest.approx((1, 1, 1))


def test_zero_weights_are_dropped():
    nodes = {
        "d": Node("diffuse"),
        "t": Node("transparent"),
        "mix": Node("mix_shader", {"fac": 0.0, "shader": Link("d", "bsdf"), "shader_b": Link("t", "bsdf")}),
    }
    program = compile_graph(shader_graph(nodes, "mix"))
    assert [leaf.kind for leaf in program.leaves] == [L.DIFFUSE] and program.opaque


def test_light_path_mix_varies_with_the_ray_only():
    nodes = {
        "p": Node("light_path"),
        "t": Node("transparent", {"color": (0.5, 1.0, 1.0)}),
        "d": Node("principled", {"base_color": (1.0, 0.0, 0.0)}),
        "mix": Node(
            "mix_shader",
            {"fac": Link("p", "is_shadow_ray"), "shader": Link("d", "bsdf"), "shader_b": Link("t", "bsdf")},
        ),
    }
    program = compile_graph(shader_graph(nodes, "mix"))
    assert program.varying_with == {"ray"} and program.needs == program.transparency_needs == {"ray_kind"}
    assert not program.opaque and not program.surface_only
    plan = next(leaf for leaf in program.leaves if leaf.kind == L.PRINCIPLED)
    assert plan.column_varying["base_color"] == frozenset() and plan.column_varying["weight"] == {"ray"}
    kinds = np.array([RAY_CAMERA, RAY_SHADOW], np.uint8)
    through = program.transparency(SurfacePoints(2, ray_kind=kinds))
    assert through.tolist() == [[0, 0, 0], [0.5, 1, 1]]


def test_principled_alpha_passes_light_and_dims_emission():
    program = compile_graph(principled(alpha=0.25, emission_strength=4.0).graph)
    assert not program.opaque and program.emissive
    assert program.transparency(SurfacePoints(3)) == pytest.approx(np.full((3, 3), 0.75))
    assert program.constant_emission == pytest.approx((1, 1, 1))


@pytest.mark.parametrize(
    ("inputs", "lobes"),
    [
        ({}, 2),
        ({"metallic": 1.0}, 1),
        ({"transmission_weight": 1.0}, 1),
        (
            {
                "transmission_weight": 0.5,
                "coat_weight": 1.0,
                "sheen_weight": 0.1,
                "alpha": 0.5,
                "metallic": 0.2,
            },
            7,
        ),
    ],
)
def test_lobes_are_bounded(inputs, lobes):
    assert compile_graph(principled(**inputs).graph).max_lobes == lobes


def test_inputs_are_limited_as_the_shader_does():
    leaf = compile_graph(
        principled(roughness=3.0, metallic=-1.0, coat_ior=0.5, coat_weight=1.0).graph
    ).evaluate(SurfacePoints(1))[0]
    assert column(leaf, "roughness") == 1 and column(leaf, "metallic") == 0 and column(leaf, "coat_ior") == 1


def test_normals_come_with_leaves_that_bend_them():
    bent = np.tile(np.array([[0, 0.6, 0.8]], np.float32), (5, 1))
    nodes = {
        "n": Node("attribute", {}, {"name": "bent"}),
        "b": Node("principled", {"normal": Link("n", "vector"), "coat_weight": 1.0}),
    }
    program = compile_graph(Graph(nodes, surface=Link("b", "bsdf")))
    p = points(attributes={"bent": np.concatenate([bent, np.ones((5, 1), np.float32)], 1)})
    (leaf,) = program.evaluate(p)
    assert leaf.normal == pytest.approx(bent) and leaf.coat_normal is None
    assert program.needs == {"attribute:bent"}


def test_tangents_only_where_anisotropy_asks():
    assert "world_from_part" not in compile_graph(principled(anisotropic=0.0).graph).needs
    assert {"generated", "normal"} <= compile_graph(principled(anisotropic=0.5).graph).needs


def test_unknown_nodes_warn_once_and_default():
    nodes = {
        "x": Node("from_the_future"),
        "b": Node("diffuse", {"color": Link("x", "color"), "roughness": Link("x", "value")}),
    }
    program = compile_graph(Graph(nodes, surface=Link("b", "bsdf")))
    assert len(program.warnings) == 1 and "from_the_future" in program.warnings[0]
    assert program.evaluate(points())[0].block[0, 0] == pytest.approx(0.8)


def test_cycles_and_missing_nodes_end():
    nodes = {
        "a": Node("math", {"value": Link("b", "value")}),
        "b": Node("math", {"value": Link("a", "value"), "value_b": Link("gone", "value")}),
        "e": Node("emission", {"strength": Link("a", "value")}),
        "m": Node("mix_shader", {"shader": Link("m", "shader"), "shader_b": Link("e", "emission")}),
    }
    assert compile_graph(shader_graph(nodes, "m")).emissive
    assert compile_graph(Graph({}, surface=Link("gone", "x"))).leaves == ()


def test_deep_graphs_compile():
    nodes = {"0": Node("uv_map")}
    for i in range(1, 3000):
        nodes[str(i)] = Node("vector_math", {"vector": Link(str(i - 1), "uv" if i == 1 else "vector")})
    nodes["e"] = Node("emission", {"color": Link("2999", "vector")})
    program = compile_graph(Graph(nodes, surface=Link("e", "emission")))
    p = points()
    assert program.emission(p)[:, :2] == pytest.approx(p.uvs[""])


def test_nan_never_leaves_a_program():
    nodes = {
        "u": Node("uv_map"),
        "d": Node("math", {"value": Link("u", "uv"), "value_b": 0.0}, {"operation": "EXPONENT"}),
        "p": Node("math", {"value": Link("d", "value"), "value_b": 1e30}, {"operation": "MULTIPLY"}),
        "q": Node(
            "math", {"value": Link("p", "value"), "value_b": Link("p", "value")}, {"operation": "POWER"}
        ),
        "e": Node("emission", {"strength": Link("q", "value")}),
    }
    program = compile_graph(Graph(nodes, surface=Link("e", "emission")))
    assert np.isfinite(program.emission(points())).all()
    assert np.isfinite(program.evaluate(points())[0].block).all()


def on_a_ball(footprint):
    """Four points at the top of a ball of radius 1."""
    up = np.tile(np.array([[0, 0, 1]], np.float32), (4, 1))

    def moved(offset, *_):
        bent = up + np.float32(offset)
        bent /= np.linalg.norm(bent, axis=1)[:, None]
        return replace(points, position=offset.copy(), normal=bent, smooth_normal=bent)

    points = SurfacePoints(
        4,
        position=np.zeros((4, 3)),
        normal=up,
        smooth_normal=up,
        geometric_normal=up,
        footprint=np.full(4, footprint, np.float32),
        moved=moved,
    )
    return points


def as_high_as_x_of(coordinate):
    """A bumped material's program."""
    nodes = {
        "p": Node("texture_coordinate"),
        "x": Node("separate_xyz", {"vector": Link("p", coordinate)}),
        "bump": Node("bump", {"height": Link("x", "x"), "distance": 0.5}),
        "b": Node("diffuse", {"normal": Link("bump", "normal")}),
    }
    return compile_graph(Graph(nodes, surface=Link("b", "bsdf")))


def test_bump_tilts_against_the_slope():
    """A height that grows along x leans the normal to -x, whatever the footprint."""
    program = as_high_as_x_of("object")
    up = np.tile(np.array([[0, 0, 1]], np.float32), (4, 1))
    for width in (1e-4, 1e-2):
        p = SurfacePoints(
            4,
            position=np.zeros((4, 3)),
            normal=up,
            geometric_normal=up,
            local=np.zeros((4, 3), np.float32),
            footprint=np.full(4, width, np.float32),
        )
        normal = program.evaluate(p)[0].normal
        assert normal == pytest.approx(np.tile([-0.5, 0, 1] / np.sqrt(1.25), (4, 1)), abs=1e-3)


def test_heights_are_differenced_beneath_one_normal():
    """A height that reads the normal of a bent surface makes no bump, as in Cycles."""
    normal = as_high_as_x_of("normal").evaluate(on_a_ball(1e-2))[0].normal
    assert normal == pytest.approx(np.tile([0, 0, 1], (4, 1)), abs=1e-6)


def test_images_by_normals_are_filtered_as_the_surface_bends():
    """A ball's highlight painted as an image: black and white texels, many in a footprint."""
    pixels = np.ones((64, 64, 4), np.float32)
    pixels[::2, ::2, :3] = pixels[1::2, 1::2, :3] = 0
    image = Image("checks", pixels, colorspace="Linear")
    nodes = {
        "p": Node("texture_coordinate"),
        "m": Node("mapping", {"vector": Link("p", "normal"), "location": (0.5 / 64, 0.5 / 64, 0.0)}),
        "i": Node("image_texture", {"vector": Link("m", "vector")}, {"image": image}),
        "b": Node("diffuse", {"color": Link("i", "color")}),
    }
    program = compile_graph(Graph(nodes, surface=Link("b", "bsdf")))
    (leaf,) = program.evaluate(on_a_ball(0.2))
    assert column(leaf, "color_r") == pytest.approx(0.5, abs=0.05)


def test_displacement_bends_every_normal():
    nodes = {
        "p": Node("texture_coordinate"),
        "x": Node("separate_xyz", {"vector": Link("p", "object")}),
        "d": Node("displacement", {"height": Link("x", "x"), "scale": 0.5}, {"space": "WORLD"}),
        "b": Node("principled", {"coat_weight": 1.0}),
    }
    program = compile_graph(Graph(nodes, surface=Link("b", "bsdf"), displacement=Link("d", "displacement")))
    up = np.tile(np.array([[0, 0, 1]], np.float32), (2, 1))
    p = SurfacePoints(
        2,
        position=np.zeros((2, 3)),
        normal=up,
        geometric_normal=up,
        local=np.zeros((2, 3), np.float32),
        footprint=np.full(2, 1e-3, np.float32),
    )
    (leaf,) = program.evaluate(p)
    assert leaf.normal == pytest.approx(np.tile([-0.5, 0, 1] / np.sqrt(1.25), (2, 1)), abs=1e-3)
    assert leaf.coat_normal is leaf.normal or np.array_equal(leaf.coat_normal, leaf.normal)
    assert leaf.surface_normal is leaf.normal


def test_plain_emission_and_backgrounds():
    assert compile_graph(emission(strength=3.0).graph).constant_emission == (3, 3, 3)
    directions = np.eye(3)
    uniform = compile_graph(uniform_world((0.1, 0.2, 0.3), 2.0).graph, "background")
    assert evaluate_background(uniform, directions) == pytest.approx(np.tile([0.2, 0.4, 0.6], (3, 1)))
    nodes = {
        "c": Node("texture_coordinate"),
        "p": Node("light_path"),
        "b": Node("background", {"color": Link("c", "generated"), "strength": Link("p", "is_camera_ray")}),
    }
    program = compile_graph(Graph(nodes, surface=Link("b", "background")), "background")
    assert evaluate_background(program, directions, RAY_CAMERA) == pytest.approx(directions)
    assert not evaluate_background(program, directions, RAY_SHADOW).any()
    assert not evaluate_background(compile_graph(Graph(), "background"), directions).any()


def test_programs_are_shared_by_threads():
    from concurrent.futures import ThreadPoolExecutor

    nodes = {"n": Node("noise_texture", {"vector": Link("u", "uv")}), "u": Node("uv_map")}
    nodes["e"] = Node("emission", {"color": Link("n", "color")})
    program = compile_graph(Graph(nodes, surface=Link("e", "emission")))
    p = points(2000)
    expected = program.emission(p)
    with ThreadPoolExecutor(4) as pool:
        for result in pool.map(lambda _: program.emission(p), range(16)):
            assert np.array_equal(result, expected)
