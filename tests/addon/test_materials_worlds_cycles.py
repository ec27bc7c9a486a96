"""World graphs seen all around, against Cycles' panorama of the same world."""

import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
sys.path.insert(0, str(Path(__file__).parent))

import node_planes  # noqa: E402
from node_cases import image  # noqa: E402

from blender_addon.sync.materials import MaterialSync  # noqa: E402
from pointmr_engine.shading.program import compile_graph, evaluate_background  # noqa: E402

WIDTH, HEIGHT = 64, 32


def directions():
    """(HEIGHT * WIDTH, 3) of an equirectangular camera that looks along +y, bottom row first."""
    azimuth = np.pi * (1 - 2 * (np.arange(WIDTH) + 0.5) / WIDTH)
    theta = np.pi * (1 - (np.arange(HEIGHT) + 0.5) / HEIGHT)
    a, t = np.meshgrid(azimuth, theta)
    return np.stack([-np.sin(t) * np.sin(a), np.sin(t) * np.cos(a), np.cos(t)], -1).reshape(-1, 3)


def compare(tmp_path, make):
    """Cycles' and our radiance of the world that `make` shows."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("world")
    scene.world.cycles.sampling_method = "NONE"  # no importance map is needed to look at it
    scene.world.node_tree.nodes.clear()
    tree = node_planes.Tree(scene.world.node_tree)
    background = tree.node("Background", {"Color": make(tree)})
    tree.tree.links.new(background.outputs[0], tree.node("OutputWorld").inputs[0])
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.panorama_type = "PANO", "EQUIRECTANGULAR"
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.camera.rotation_euler = (np.pi / 2, 0, 0)
    scene.collection.objects.link(scene.camera)
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.resolution_percentage = 100
    theirs = node_planes.render(tmp_path / "world.exr")
    graph = MaterialSync(lambda level, message: pytest.fail(message)).world_graph(scene.world)
    ours = evaluate_background(compile_graph(graph, "background"), directions())
    return theirs, ours.reshape(HEIGHT, WIDTH, 3)


def sky(**properties):
    return lambda tree: tree.node("TexSky", **properties).outputs[0]


SUN = {"sun_elevation": 0.6, "sun_rotation": 2.4, "altitude": 500, "air_density": 1.3, "aerosol_density": 0.7}
SUN |= {"sun_size": 0.2, "sun_intensity": 0.01}
OLD = {"sun_direction": (0.3, 0.5, 0.7), "turbidity": 3.0}


@pytest.mark.parametrize(
    ("make", "tolerance"),
    [
        (sky(), 0.001),
        (sky(sky_type="MULTIPLE_SCATTERING", **SUN), 0.001),
        (sky(sky_type="SINGLE_SCATTERING", **SUN), 0.001),
        (sky(sky_type="MULTIPLE_SCATTERING", **SUN | {"sun_elevation": -0.05, "sun_rotation": 5.0}), 0.001),
        (sky(sky_type="MULTIPLE_SCATTERING", **SUN | {"sun_elevation": 2.0, "sun_rotation": -1.0}), 0.001),
        (sky(sky_type="PREETHAM", **OLD), 0.002),
        (sky(sky_type="HOSEK_WILKIE", **OLD), 0.03),
        (sky(sky_type="HOSEK_WILKIE", turbidity=1.0, ground_albedo=1.0), 0.002),
    ],
    ids=[
        "usual",
        "multiple",
        "single",
        "dusk",
        "beyond the zenith",
        "preetham",
        "hosek",
        "hosek at the zenith",
    ],
)
def test_skies(tmp_path, make, tolerance):
    """The relative mean difference; a pixel on the sun disc's edge may fall to either side."""
    theirs, ours = compare(tmp_path, make)
    difference = np.abs(theirs - ours)
    difference[difference.max(-1) > 20 * np.median(theirs)] = 0
    assert difference.mean() < tolerance * theirs.mean()


def _environment(tree):
    node = tree.node("TexEnvironment")
    node.image = image("around")
    return node.outputs[0]


def _turned(tree):
    coordinates = tree.node("TexCoord").outputs["Generated"]
    mapping = tree.node("Mapping", {0: coordinates, "Rotation": (0.3, 0.2, 1.1)}).outputs[0]
    node = tree.node("TexEnvironment", {0: mapping})
    node.image = image("turned")
    return node.outputs[0]


def _coordinate(name):
    def make(tree):
        socket = tree.node("TexCoord").outputs[name]
        return tree.node(
            "VectorMath", {0: socket, 1: (0.3,) * 3, 2: (0.5,) * 3}, operation="MULTIPLY_ADD"
        ).outputs[0]

    return make


def _geometry(name):
    def make(tree):
        socket = tree.node("NewGeometry").outputs[name]
        return tree.node(
            "VectorMath", {0: socket, 1: (0.3,) * 3, 2: (0.5,) * 3}, operation="MULTIPLY_ADD"
        ).outputs[0]

    return make


CASES = {
    "environment": _environment,
    "environment turned": _turned,
    "noise": lambda tree: tree.node("TexNoise", {"Scale": 3.0}).outputs[1],
    **{
        f"coordinates {name}": _coordinate(name)
        for name in ("Generated", "Normal", "UV", "Object", "Reflection")
    },
    **{f"geometry {name}": _geometry(name) for name in ("Position", "Normal", "Incoming", "True Normal")},
    "is camera ray": lambda tree: tree.node("LightPath").outputs["Is Camera Ray"],
    "gradient": lambda tree: tree.node("TexGradient", gradient_type="SPHERICAL").outputs[0],
}


@pytest.mark.parametrize("name", CASES)
def test_world_nodes(tmp_path, name):
    theirs, ours = compare(tmp_path, CASES[name])
    # pixel centres are hit to a hundredth, which shows where an image is steep
    assert (np.abs(theirs - ours).max(-1) > 6e-3).mean() < 0.02
