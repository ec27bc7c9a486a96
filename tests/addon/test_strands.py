"""Strands of hair: their shape, what materials read of them, and images beside those of Cycles."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
sys.path.insert(0, str(Path(__file__).parent))

import node_planes  # noqa: E402

from benchmarks import methods  # noqa: E402
from benchmarks.features import stage  # noqa: E402
from benchmarks.features.displacement import displace  # noqa: E402
from benchmarks.sources import exported  # noqa: E402
from blender_addon.sync import strands as S  # noqa: E402
from blender_addon.sync.attributes import NOTHING  # noqa: E402
from pointmr_engine.render import Cache, render  # noqa: E402

pytestmark = pytest.mark.usefixtures("engine")

SIZE = (64, 48)


def strands(*lines, radius: float = 0.1) -> S.Strands:
    counts = np.array([len(line) for line in lines])
    points = np.concatenate([np.asarray(line, float).reshape(-1, 3) for line in lines])
    return S.Strands(points, np.full(len(points), radius), np.cumsum(counts) - counts, counts, {}, {}, None)


@pytest.mark.parametrize("sides", [4, 6, 8])
def test_tubes_are_as_wide_as_round_ones_on_the_mean(sides, monkeypatch):
    monkeypatch.setattr(S, "SIDES", ((np.inf, sides),))
    mesh = S.tubes("straight", strands([(0, 0, 0), (0, 0, 1)]), NOTHING)
    angles = np.linspace(0.0, np.pi, 1000, endpoint=False)
    across = mesh.positions[:, :2] @ np.array([np.cos(angles), np.sin(angles)])
    assert np.ptp(across, axis=0).mean() == pytest.approx(0.2, rel=1e-3)


def test_strands_are_curves_through_their_points():
    """Those through six points of a quarter of a circle are it, nearly."""
    turn = np.linspace(0.0, np.pi / 2, 6)
    mesh = S.tubes("bent", strands(np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1), radius=0.02), NOTHING)
    sides = next(n for most, n in S.SIDES if most > 100)
    rings = mesh.positions.reshape(-1, sides, 3).mean(1)
    assert len(rings) > 6
    assert np.abs(np.linalg.norm(rings, axis=1) - 1.0).max() < 0.008  # 0.012 by straight lines
    for t in turn:
        assert np.linalg.norm(rings - (np.cos(t), np.sin(t), 0.0), axis=1).min() < 1e-6
    straight = S.tubes("straight", strands([(0, 0, z) for z in range(5)]), NOTHING)
    assert len(straight.triangles) == 4 * 2 * sides  # no more pieces than segments


def test_single_points_are_nothing():
    assert S.tubes("point", strands([(0, 0, 0)]), NOTHING) is None
    mesh = S.tubes("both", strands([(0, 0, 0)], [(1, 0, 0), (1, 0, 1)]), NOTHING)
    assert mesh.positions[:, 0].min() > 0.8


def hair(material) -> None:
    """Three wide strands beside each other, of unequal points."""
    data = bpy.data.hair_curves.new("hair")
    data.add_curves([3, 5, 4])
    heights = (0, 0.5, 2), (0, 0.2, 0.5, 1.5, 2), (0, 0.5, 1, 2)
    points = [
        (x, 0.3 * z * (2 - z), z) for x, column in zip((-1, 0, 1), heights, strict=True) for z in column
    ]
    data.points.foreach_set("position", np.array(points, np.float32).ravel())
    radius = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    radius.data.foreach_set("value", np.linspace(0.11, 0.09, 12, dtype=np.float32))
    uv = data.attributes.new("surface_uv_coordinate", "FLOAT2", "CURVE")
    uv.data.foreach_set("vector", np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], np.float32))
    own = data.attributes.new("shade", "FLOAT", "POINT")
    own.data.foreach_set("value", np.linspace(0.0, 1.0, 12, dtype=np.float32))
    data.materials.append(material)
    stage.link(bpy.data.objects.new("hair", data))


def view() -> None:
    stage.camera(at=(0, -10, 1), target=(0, 0, 1)).data.type = "ORTHO"
    bpy.context.scene.camera.data.ortho_scale = 3.2


VALUES = {
    "is strand": lambda t: t.node("HairInfo").outputs["Is Strand"],
    "intercept": lambda t: t.node("HairInfo").outputs["Intercept"],
    "length": lambda t: t.node("HairInfo").outputs["Length"],
    "thickness": lambda t: t.node("HairInfo").outputs["Thickness"],
    "random": lambda t: t.node("HairInfo").outputs["Random"],
    "uv": lambda t: t.node("TexCoord").outputs["UV"],
    "object": lambda t: t.node("TexCoord").outputs["Object"],
    "generated": lambda t: t.node("TexCoord").outputs["Generated"],
    "own": lambda t: t.node("Attribute", attribute_name="shade").outputs["Fac"],
}


def showing(socket_of) -> bpy.types.Material:
    """A material that shines with what socket_of(tree) has."""
    material = bpy.data.materials.new("shown")
    material.node_tree.nodes.clear()
    tree = node_planes.Tree(material.node_tree)
    emission = tree.node("Emission", {0: socket_of(tree)})
    tree.tree.links.new(emission.outputs[0], tree.node("OutputMaterial").inputs[0])
    return material


def images(tmp_path, samples: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The scene by Cycles, and by our methods."""
    scene = bpy.context.scene
    methods.configure(scene, methods.Method("cycles", samples), 0, SIZE, {}, 2)
    theirs = node_planes.written(tmp_path / "cycles.exr").astype(float)
    methods.configure(scene, methods.Method("distributed", samples), 0, SIZE, {}, 2)
    ours, settings, _ = exported()
    cache, found = Cache(), {}
    for method in ("distributed", "raytrace"):
        image = render(ours, replace(settings, passes=("combined",), method=method), cache=cache)
        found[method] = image.passes["combined"][..., :3].astype(float)
    return theirs, found


@pytest.mark.parametrize("name", VALUES)
def test_materials_read_of_strands_what_they_do_in_cycles(tmp_path, name):
    stage.empty_scene()
    stage.world((0, 0, 0), 0)
    hair(showing(VALUES[name]))
    view()
    theirs, found = images(tmp_path, 16)
    for image in found.values():
        for x in (11, 31, 51):
            seen, expected = image[8:40, x], theirs[8:40, x]
            if name in ("object", "generated"):  # ribbons have no depth
                seen, expected = seen[:, [0, 2]], expected[:, [0, 2]]
            np.testing.assert_allclose(seen, expected, atol=0.06)


@pytest.mark.parametrize(("alpha", "height"), [(1.0, 0.0), (0.5, 0.0), (1.0, 0.5)])
def test_strands_look_as_in_cycles(tmp_path, alpha, height):
    """Half transparent ones hide half of what lies behind them, not three quarters; displacement moves none."""
    stage.empty_scene()
    stage.world((0.4, 0.5, 0.6), 1.0)
    material = stage.principled("hair", Base_Color=(0.6, 0.3, 0.1, 1), Roughness=0.9, Alpha=alpha)
    if height:
        displace(material, "DISPLACEMENT", Height=height, Midlevel=0.0)
    hair(material)
    stage.lamp("SUN", 2.0, (-2, -4, 4), (0, 0, 1), angle=0.0)
    view()
    theirs, found = images(tmp_path, 64)
    for method, image in found.items():
        assert np.abs(image - theirs).mean() < 0.025 * theirs.mean(), method
        assert image.mean((0, 1)) == pytest.approx(theirs.mean((0, 1)), rel=0.015), method


@pytest.mark.parametrize("output", ["UV", "Generated"])
def test_particle_hair_has_the_colour_of_its_roots(tmp_path, output):
    """Coordinates are those of the mesh where a strand grows."""
    stage.empty_scene()
    stage.world((0, 0, 0), 0)
    ob = stage.plane(showing(lambda tree: tree.node("TexCoord").outputs[output]), (0, 0, 0), 2.0)
    settings = ob.modifiers.new("hair", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.count, settings.hair_length = "HAIR", 20, 2.0
    settings.root_radius = settings.tip_radius = 10.0
    ob.show_instancer_for_render = False
    view()
    theirs, found = images(tmp_path, 32)
    assert theirs.max() > 0.3
    for image in found.values():
        assert np.abs(image - theirs).mean() < 0.05 * theirs.mean()
