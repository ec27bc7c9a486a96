"""Lamps whose nodes decide about their light, in images of every method and of Cycles."""

import math
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
from benchmarks.sources import exported  # noqa: E402
from pointmr_engine.render import Cache, render  # noqa: E402

pytestmark = pytest.mark.usefixtures("engine")

SIZE = (32, 24)


def web() -> str:
    """An IES file of a lamp that shines in two lobes, and a little upwards."""
    vertical, horizontal = range(0, 181, 15), range(0, 361, 45)
    rows = [
        [300 * (1 + 0.8 * math.cos(math.radians(2 * h))) * max(math.cos(math.radians(v / 2)), 0) ** 2 for v in vertical]
        for h in horizontal
    ]  # fmt: skip
    numbers = [vertical, horizontal, *rows]
    head = f"IESNA:LM-63-1995\nTILT=NONE\n1 1000 1 {len(vertical)} {len(horizontal)} 1 2 0 0 0\n1 1 100\n"
    return head + "\n".join(" ".join(f"{x:.2f}" for x in row) for row in numbers) + "\n"


def photometric(tree) -> tuple:
    text = bpy.data.texts.new("web")
    text.write(web())
    node = tree.node("TexIES", {1: 0.5})
    node.mode, node.ies = "INTERNAL", text
    return (1.0, 0.9, 0.7, 1.0), node.outputs[0]


def picture(tree) -> tuple:
    image = bpy.data.images.new("slide", 4, 4, float_buffer=True)
    pixels = np.random.default_rng(3).random((4, 4, 4)).astype(np.float32)
    pixels[:2, :2, :3] *= 0.1
    image.pixels.foreach_set(pixels.ravel())
    node = tree.node("TexImage")
    node.image = image
    return node.outputs[0], 1.0


def falloff(output: str, smooth: float = 0.0):
    def make(tree) -> tuple:
        return (1.0, 0.8, 0.6, 1.0), tree.node("LightFalloff", {0: 0.3, 1: smooth}).outputs[output]

    return make


def coordinates(output: str):
    """A lamp's coordinates as its colour."""

    def make(tree) -> tuple:
        scaled = {0: tree.node("TexCoord").outputs[output], 1: (0.2, 0.3, 0.2), 2: (0.5, 0.6, 0.7)}
        return tree.node("VectorMath", scaled, operation="MULTIPLY_ADD").outputs[0], 1.0

    return make


# kind of lamp, its properties, its nodes
CASES = {
    "linear falloff": ("POINT", {"shadow_soft_size": 0.0}, falloff("Linear")),
    "constant falloff": ("SPOT", {"shadow_soft_size": 0.3, "spot_size": 1.8}, falloff("Constant")),
    "smooth falloff": ("AREA", {"size": 1.0}, falloff("Quadratic", 6.0)),
    "photometric point": ("POINT", {"shadow_soft_size": 0.05, "use_soft_falloff": False}, photometric),
    "photometric area": ("AREA", {"size": 0.8}, photometric),
    "slide": ("SPOT", {"shadow_soft_size": 0.0, "spot_size": 1.2, "spot_blend": 0.0}, picture),
    "slide before a panel": ("AREA", {"shape": "RECTANGLE", "size": 2.0, "size_y": 1.0}, picture),
    "ball": ("POINT", {"shadow_soft_size": 0.5, "use_soft_falloff": False}, coordinates("Object")),
    "panel": ("AREA", {"shape": "DISK", "size": 1.5}, coordinates("UV")),
    "spot": ("SPOT", {"shadow_soft_size": 0.1, "spot_size": 1.2}, coordinates("UV")),
    "sun": ("SUN", {"angle": 0.4}, coordinates("UV")),
    "sun by normals": ("SUN", {"angle": 0.4}, coordinates("Normal")),
}


def build(kind: str, properties: dict, make) -> None:
    """A floor and a ball, lit by one lamp alone."""
    stage.empty_scene()
    stage.world((0, 0, 0), 0)
    stage.plane(stage.matte((0.6, 0.6, 0.6)), (0, 0, 0), 12.0)
    stage.sphere(stage.matte((0.5, 0.6, 0.8)), (0.8, 0.3, 0.6), 0.6)
    light = bpy.data.lights.new("lamp", kind)
    light.energy = 3.0 if kind == "SUN" else 150.0
    for name, value in properties.items():
        setattr(light, name, value)
    ob = bpy.data.objects.new("lamp", light)
    bpy.context.scene.collection.objects.link(ob)
    ob.location, ob.rotation_euler = (-0.7, -0.5, 2.6), (0.25, -0.3, 0.4)
    light.use_nodes = True
    light.node_tree.nodes.clear()
    tree = node_planes.Tree(light.node_tree)
    color, strength = make(tree)
    emission = tree.node("Emission", {0: color, 1: strength})
    tree.tree.links.new(emission.outputs[0], tree.node("OutputLight").inputs[0])
    stage.camera(at=(0.0, -6.0, 4.0), target=(0, 0, 0.2))


@pytest.mark.parametrize("name", CASES)
def test_lamps_shine_as_in_cycles(tmp_path, name):
    build(*CASES[name])
    scene = bpy.context.scene
    methods.configure(scene, methods.Method("cycles", 256), 0, SIZE, {}, 2)
    theirs = node_planes.written(tmp_path / "cycles.exr").astype(float)
    methods.configure(scene, methods.Method("distributed", 256), 0, SIZE, {}, 2)
    ours, settings, warnings = exported()
    assert ours.lights[0].graph is not None
    cache, means = Cache(), {}
    for method in ("distributed", "raytrace", "forward"):
        chosen = replace(settings, passes=("combined",), method=method)
        four = replace(settings.raytrace, cones=4)
        chosen = replace(chosen, forward=replace(settings.forward, shadows=True), raytrace=four)
        found = render(ours, chosen, cache=cache).passes["combined"][..., :3].astype(float)
        error, size = np.abs(found - theirs).mean((0, 1)), theirs.mean((0, 1))
        means[method] = found.mean((0, 1)) / size
        assert (error < BOUNDS[method] * size.max()).all(), (method, error / size)
    assert means["distributed"] == pytest.approx(1.0, abs=0.01)


BOUNDS = {"distributed": 0.03, "raytrace": 0.03, "forward": 0.08}


def test_simple_shading_knows_of_lamps_nodes():
    """Under Lambert's law alone, a falloff that cancels the inverse-square law lights a floor as a sun does."""
    build("POINT", {"shadow_soft_size": 0.0}, falloff("Constant"))
    bpy.data.objects["lamp"].location = (0.0, 0.0, 3.0)
    methods.configure(bpy.context.scene, methods.Method("forward", 1), 0, SIZE, {}, 2)
    ours, settings, _ = exported()
    simple = replace(settings.forward, shading="simple", shadows=False)
    chosen = replace(settings, passes=("combined",), method="forward", forward=simple)
    image = render(ours, chosen).passes["combined"][..., :3].astype(float)
    intensity, albedo = 150.0 / (4.0 * math.pi) * 0.3, 0.6
    assert image[..., 0].max() == pytest.approx(intensity * albedo / math.pi, rel=0.02)
