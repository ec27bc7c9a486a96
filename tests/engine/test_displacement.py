"""True displacement: vertices, normals and seams of displaced meshes, and that nothing else pays for it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine import Camera, Group, Instances, Material, Mesh, RenderSettings, Scene, principled, render
from pointmr_engine.displacement import displaced
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.material import RESTING
from pointmr_engine.scene.mesh import GENERATED
from pointmr_engine.scene.world import uniform_world
from tests.engine.small_scenes import from_above

HEIGHT = 0.3


def hilly(method: str, scale=HEIGHT, **nodes: Node) -> Material:
    """White, and as high as the sine of the object's x."""
    graph = {
        "c": Node("texture_coordinate"),
        "x": Node("separate_xyz", {"vector": Link("c", "object")}),
        "s": Node("math", {"value": Link("x", "x")}, {"operation": "SINE"}),
        "d": Node("displacement", {"height": Link("s", "value"), "midlevel": 0.0, "scale": scale}),
        "b": Node("diffuse", {"color": (0.8, 0.8, 0.8)}),
    } | nodes
    return Material(method, Graph(graph, Link("b", "bsdf"), Link("d", "displacement")), bump_method=method)


def grid(n: int, *materials, smooth=True, size=6.0) -> Mesh:
    """n x n squares about the origin, facing up; of several materials each has a strip of them."""
    side = np.linspace(-0.5 * size, 0.5 * size, n + 1)
    x, y = np.meshgrid(side, side, indexing="xy")
    positions = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3).astype(np.float32)
    low = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    squares = np.stack([low, low + 1, low + n + 2, low, low + n + 2, low + n + 1], 1)
    triangles = squares.reshape(-1, 3).astype(np.int32)
    normals = np.tile(np.float32([[0, 0, 1]]), (len(positions), 1)) if smooth else None
    index = (np.arange(len(triangles)) * len(materials) // len(triangles)).astype(np.int32)
    return Mesh("grid", positions, triangles, normals, material_index=index, materials=materials)


def moved(mesh: Mesh) -> Mesh:
    geometry, warnings = displaced(compile_geometry(Scene(Group("root", [mesh]))))
    assert not warnings
    return geometry.parts[0]


@given(st.integers(1, 30), st.floats(-2.0, 2.0))
def test_vertices_move_along_their_normals(n, scale):
    flat = grid(n, hilly("DISPLACEMENT", scale))
    found = moved(flat)
    x = flat.positions[:, 0]
    assert found.positions[:, :2] == pytest.approx(flat.positions[:, :2], abs=1e-6)
    assert found.positions[:, 2] == pytest.approx(scale * np.sin(x), abs=1e-5)
    assert found.positions.dtype == flat.positions.dtype and not flat.positions[:, 2].any()


def test_normals_are_those_of_the_moved_surface():
    flat = grid(80, hilly("DISPLACEMENT"))
    found = moved(flat)
    x = flat.positions[:, 0]
    exact = np.stack([-HEIGHT * np.cos(x), np.zeros_like(x), np.ones_like(x)], 1)
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    inside = np.abs(flat.positions[:, :2]).max(1) < 2.9
    assert np.abs(found.normals - exact)[inside].max() < 0.01
    assert np.linalg.norm(found.normals, axis=1) == pytest.approx(1.0, abs=1e-5)


def test_what_is_displaced_and_bumped_keeps_its_normals():
    """Its bump is that of the resting surface: normals that had moved would tell the slope twice."""
    flat = grid(10, hilly("BOTH"))
    assert moved(flat).normals is flat.normals
    assert moved(replace(flat, normals=None)).normals == pytest.approx(flat.normals)


def box(material: Material, size=(2.0, 2.0, 2.0)) -> Mesh:
    """A flat box about the origin; of each side's square two triangles, cut along either diagonal."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    turned = [side[k % 2 :] + side[: k % 2] for k, side in enumerate(sides)]
    triangles = np.array([t for a, b, c, d in turned for t in ((a, b, c), (a, c, d))], np.int32)
    return Mesh("box", corners.astype(np.float32), triangles, materials=(material,))


@given(st.tuples(*[st.floats(0.5, 4.0)] * 3))
def test_flat_boxes_grow_evenly(size):
    """Each corner moves along its own normal, however its triangles lie; not along that of one side."""
    even = hilly("DISPLACEMENT", 0.5, s=Node("math", {"value": 1.0, "value_b": 0.0}, {"operation": "ADD"}))
    resting = box(even, size)
    found = moved(resting)
    along = np.sign(resting.positions) / np.sqrt(3.0)
    assert found.positions == pytest.approx(resting.positions + 0.5 * along, abs=1e-5)
    assert found.normals is None
    both = moved(box(replace(even, bump_method="BOTH"), size))
    assert both.positions == pytest.approx(found.positions) and both.normals == pytest.approx(along, abs=1e-6)


def test_corners_with_normals_of_their_own_move_along_their_mean():
    even = hilly("DISPLACEMENT", 1.0, s=Node("math", {"value": 1.0, "value_b": 0.0}, {"operation": "ADD"}))
    flat = grid(2, even)
    tilted = np.where(
        (flat.positions[flat.triangles].mean(1)[:, 0] < 0.0)[:, None], [0.6, 0, 0.8], [-0.6, 0, 0.8]
    )
    corners = np.repeat(tilted[:, None], 3, 1).astype(np.float32)
    seam = flat.positions[:, 0] == 0.0
    by = moved(replace(flat, normals=corners)).positions - flat.positions
    assert by[seam] == pytest.approx(np.tile([[0.0, 0.0, 1.0]], (3, 1)), abs=1e-6)
    assert np.abs(by[~seam, 0]) == pytest.approx(0.6) and by[~seam, 2] == pytest.approx(0.8)


def test_generated_coordinates_are_those_of_the_resting_mesh():
    flat = grid(10, hilly("DISPLACEMENT"))
    found = moved(flat).attributes[GENERATED]
    assert found.domain == "vertex"
    assert found.values[:, :2] == pytest.approx(flat.positions[:, :2] / 6.0 + 0.5, abs=1e-6)
    assert not found.values[:, 2].any()


def test_bumps_of_what_is_displaced_read_the_resting_mesh():
    """Where they read the object's coordinates; what the surface reads itself is the moved mesh."""
    flat = grid(10, hilly("BOTH", b=Node("diffuse", {"color": Link("c", "object")})))
    assert moved(flat).attributes[RESTING].values == pytest.approx(flat.positions)
    graph = flat.materials[0].surface_graph
    assert graph.nodes["b"].inputs["color"] == Link("c", "object") and graph.surface == Link("b", "bsdf")
    assert set(graph.nodes) == {"c", "x", "s", "d", "b"} | {f"{RESTING}:{k}" for k in "cxsd"} | {RESTING}
    for method in ("DISPLACEMENT", "BUMP"):
        assert RESTING not in hilly(method).surface_graph.nodes
    by_generated = hilly("BOTH", x=Node("separate_xyz", {"vector": Link("c", "generated")}))
    assert by_generated.surface_graph.nodes == by_generated.graph.nodes
    assert RESTING not in moved(grid(10, by_generated)).attributes


def test_what_is_not_displaceable_has_bumps_of_what_it_is():
    """Strands of a material that displaces and bumps: they rest."""
    strands = grid(10, hilly("BOTH"))
    strands.displaceable = False
    left = moved(strands)
    assert left.positions is strands.positions
    assert left.attributes[RESTING].values == pytest.approx(strands.positions)


def test_flat_meshes_stay_flat():
    assert moved(grid(10, hilly("DISPLACEMENT"), smooth=False)).normals is None


def test_sharp_edges_stay_sharp():
    """Corners of a vertex that had two normals have two."""
    flat = grid(8, hilly("DISPLACEMENT"))
    corners = np.tile(np.float32([0, 0, 1]), (len(flat.triangles), 3, 1))
    corners[len(corners) // 2 :] = np.float32([0, 0.6, 0.8])
    found = moved(replace(flat, normals=corners)).normals
    plain = moved(flat)
    halves = flat.triangles[:64], flat.triangles[64:]
    shared = np.intersect1d(*(np.unique(h) for h in halves))
    assert len(shared) == 9
    beside = np.unique(
        halves[0][np.isin(halves[0], shared).any(1)]
    )  # which the seam's own displacement tilts
    inner = ~np.isin(halves[0], beside)
    assert found[:64][inner] == pytest.approx(plain.normals[halves[0]][inner], abs=1e-6)
    for vertex in shared:
        one, other = (
            np.unique(n[h == vertex], axis=0) for n, h in zip((found[:64], found[64:]), halves, strict=True)
        )
        assert len(one) == len(other) == 1
        assert np.abs(one - other).max() > 1e-3


def test_materials_beside_each_other_leave_no_crack():
    """Vertices that two materials share have one place; what is not displaced keeps its others."""
    still = principled("still")
    flat = grid(8, hilly("DISPLACEMENT"), still, hilly("BOTH"))
    found = moved(flat)
    assert found.positions.shape == flat.positions.shape
    own = flat.triangles[flat.material_index == 1]
    alone = np.setdiff1d(own, flat.triangles[flat.material_index != 1])
    assert len(alone) and not found.positions[alone, 2].any()
    high = np.setdiff1d(np.arange(len(flat.positions)), alone)
    assert found.positions[high, 2] == pytest.approx(HEIGHT * np.sin(flat.positions[high, 0]), abs=1e-5)
    assert found.normals.shape == (len(flat.triangles), 3, 3)  # some rest, some are moved


def test_what_has_no_finite_displacement_stays_and_is_named():
    odd = hilly(
        "DISPLACEMENT", s=Node("math", {"value": Link("x", "x"), "value_b": 0.5}, {"operation": "LOGARITHM"})
    )
    endless = replace(odd, graph=replace(odd.graph, nodes=odd.graph.nodes | {
        "s": Node("math", {"value": 1e38, "value_b": 1e38}, {"operation": "MULTIPLY"})}))  # fmt: skip
    for material in (odd, endless):
        mesh = grid(4, material)
        geometry, warnings = displaced(compile_geometry(Scene(Group("root", [mesh]))))
        assert np.isfinite(geometry.parts[0].positions).all()
        assert all("grid" in w for w in warnings)


def test_what_is_not_displaceable_stays_beside_what_moves():
    stays, moves = grid(4, hilly("DISPLACEMENT")), grid(4, hilly("DISPLACEMENT"))
    stays.displaceable = False
    geometry, _ = displaced(compile_geometry(Scene(Group("root", [stays, moves]))))
    assert geometry.parts[0] is stays and geometry.parts[1].positions[:, 2].any()


def test_parts_share_what_they_shared():
    mesh = grid(4, hilly("DISPLACEMENT"))
    groups = (Group("a", [mesh]), Group("b", [replace(mesh, name="twin")]))
    places = np.tile(np.eye(4)[:3], (2, 1, 1))
    root = Group("root", instances=[Instances(groups, places, np.array([0, 1], np.int32))])
    geometry, _ = displaced(compile_geometry(Scene(root)))
    assert len(geometry.parts) == 2 and len(geometry.shapes) == 1
    assert geometry.unique_triangles == 32


def test_without_displacement_the_geometry_is_left_alone():
    for material in (principled("plain"), hilly("BUMP"), None):
        geometry = compile_geometry(Scene(Group("root", [grid(4, material)])))
        assert displaced(geometry)[0] is geometry


@pytest.mark.parametrize("method", ["conventional", "raytrace", "forward"])
def test_images_show_the_moved_surface(method):
    """A step in a white floor hides what stands behind it; a bump would not."""
    above = Camera(from_above(8.0).world_from_camera)
    pictures = {}
    for kind in ("BUMP", "DISPLACEMENT"):
        wave = hilly(kind, 3.0, b=Node("emission", {"color": (1.0, 1.0, 1.0)}))
        wave.graph.surface = Link("b", "emission")
        root = Group("root", [grid(60, wave)])
        settings = RenderSettings(48, 36, method=method, passes=("combined", "depth"))
        frame = render(Scene(root, above, [], uniform_world((0, 0, 0))), settings)
        pictures[kind] = frame.passes["depth"]
    seen = pictures["BUMP"] < 100.0
    assert pictures["BUMP"][seen].std() < 0.5 < pictures["DISPLACEMENT"][seen].std()
