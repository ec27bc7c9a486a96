"""What materials read of the camera, the object and the material, in images of every method and of Cycles."""

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

SIZE = (96, 24)  # four squares of 24 pixels


def show(tree, socket):
    """What a socket has, made small enough to be seen."""
    inputs = {0: socket, 1: (0.1, 0.1, 0.1), 2: (0.5, 0.5, 0.5)}
    return tree.node("VectorMath", inputs, operation="MULTIPLY_ADD").outputs[0]


VALUES = {
    "depth": lambda t: t.node("CameraData").outputs["View Z Depth"],
    "view vector": lambda t: t.node("CameraData").outputs["View Vector"],
    "camera coordinates": lambda t: t.node("TexCoord").outputs["Camera"],
    "to camera space": lambda t: t.node(
        "VectorTransform",
        {0: t.node("NewGeometry").outputs["Normal"]},
        vector_type="NORMAL",
        convert_from="WORLD",
        convert_to="CAMERA",
    ).outputs[0],
    "material index": lambda t: t.node("ObjectInfo").outputs["Material Index"],
    "object colour": lambda t: t.node("ObjectInfo").outputs["Color"],
    "checks of one colour": lambda t: t.node(
        "TexChecker", {0: t.node("ObjectInfo").outputs["Material Index"], "Scale": 0.7}
    ).outputs[0],
}


def collection_instance(name: str, ob, color, x: float):
    """An empty at x that instances a collection of the object alone."""
    collection = bpy.data.collections.new(name)
    for user in list(ob.users_collection):
        user.objects.unlink(ob)
    collection.objects.link(ob)
    empty = bpy.data.objects.new(name, None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    empty.location.x, empty.color = x, color
    bpy.context.scene.collection.objects.link(empty)
    return empty


def build(make) -> None:
    """Planes before a tilted camera: one alone, one in a collection, one in a collection in a collection, one below."""
    stage.empty_scene()
    stage.world((0, 0, 0), 0)
    material = bpy.data.materials.new("shown")
    material.pass_index = 7
    material.node_tree.nodes.clear()
    tree = node_planes.Tree(material.node_tree)
    emission = tree.node("Emission", {0: show(tree, make(tree))})
    tree.tree.links.new(emission.outputs[0], tree.node("OutputMaterial").inputs[0])
    for k in range(4):
        ob = stage.plane(material, (-1.5 + k if k in (0, 3) else 0.0, 0.0, -0.5 if k == 3 else 0.0), 1.0)
        ob.color, ob.pass_index = (0.9, 0.1 * k, 0.1, 1.0), k
        if k in (1, 2):
            empty = collection_instance(f"in {k}", ob, (0.1, 0.2 * k, 0.9, 1.0), -0.5 + (k - 1))
        if k == 2:
            empty.location.x = 0.0
            collection_instance("outer", empty, (0.6, 0.9, 0.3, 1.0), 0.5)
    camera = stage.camera(at=(0.0, -0.8, 5.0), target=(0, 0, 0))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 4.0


@pytest.mark.parametrize("name", VALUES)
def test_values_are_those_of_cycles(tmp_path, name):
    build(VALUES[name])
    scene = bpy.context.scene
    methods.configure(scene, methods.Method("cycles", 16), 0, SIZE, {}, 2)
    theirs = node_planes.written(tmp_path / "cycles.exr").astype(float)
    methods.configure(scene, methods.Method("distributed", 16), 0, SIZE, {}, 2)
    ours, settings, _ = exported()
    cache = Cache()
    for method in ("distributed", "raytrace", "forward"):
        chosen = replace(settings, passes=("combined",), method=method)
        found = render(ours, chosen, cache=cache).passes["combined"][..., :3].astype(float)
        for k in range(4):  # the middle of each plane
            at = np.s_[9:15, 24 * k + 9 : 24 * k + 15]
            assert found[at].mean((0, 1)) == pytest.approx(theirs[at].mean((0, 1)), abs=0.01), (method, k)


def test_islands_have_the_numbers_of_cycles(tmp_path):
    """Four squares of one mesh; one of several faces, another next to it that shares no edge."""
    build(lambda t: t.node("NewGeometry").outputs["Random Per Island"])
    scene = bpy.context.scene
    material = bpy.data.materials["shown"]
    for ob in list(bpy.data.objects):
        if ob.type != "CAMERA":
            bpy.data.objects.remove(ob)
    points, faces = [], []
    for k, cells in enumerate((1, 3, 1, 2)):
        first, x = len(points), np.linspace(-2.0 + k, -1.0 + k, cells + 1)
        points += [(a, y, 0.0) for a in x for y in (-0.5, 0.5)]
        faces += [
            (first + 2 * c, first + 2 * c + 2, first + 2 * c + 3, first + 2 * c + 1) for c in range(cells)
        ]
    mesh = bpy.data.meshes.new("squares")
    mesh.from_pydata(points, [], faces[::-1])
    mesh.materials.append(material)
    scene.collection.objects.link(bpy.data.objects.new("squares", mesh))
    methods.configure(scene, methods.Method("cycles", 16), 0, SIZE, {}, 2)
    theirs = node_planes.written(tmp_path / "cycles.exr").astype(float)
    methods.configure(scene, methods.Method("distributed", 16), 0, SIZE, {}, 2)
    ours, settings, _ = exported()
    found = render(ours, replace(settings, passes=("combined",))).passes["combined"][..., :3].astype(float)
    numbers = [found[9:15, 24 * k + 9 : 24 * k + 15].mean() for k in range(4)]
    assert numbers == pytest.approx(
        [theirs[9:15, 24 * k + 9 : 24 * k + 15].mean() for k in range(4)], abs=1e-4
    )
    assert len(np.unique(np.round(numbers, 4))) == 4


def test_pointiness_is_that_of_cycles(tmp_path):
    build(lambda t: t.node("NewGeometry").outputs["Pointiness"])
    scene, material = bpy.context.scene, bpy.data.materials["shown"]
    for ob in list(bpy.data.objects):
        if ob.type != "CAMERA":
            bpy.data.objects.remove(ob)
    stage.monkey(material, (0, 0, 0), 1.5, 0.0).rotation_euler.x = -1.2
    scene.camera.data.ortho_scale = 2.5
    methods.configure(scene, methods.Method("cycles", 16), 0, (64, 48), {}, 2)
    theirs = node_planes.written(tmp_path / "cycles.exr").astype(float)[..., 0]
    methods.configure(scene, methods.Method("distributed", 16), 0, (64, 48), {}, 2)
    ours, settings, _ = exported()
    found = render(ours, replace(settings, passes=("combined",))).passes["combined"][..., 0].astype(float)
    inside = theirs > 0.5  # of the outline, pixels see less
    assert inside.mean() > 0.1 and np.ptp(theirs[inside]) > 0.01
    assert np.median(np.abs(found - theirs)[inside]) < 2e-4
