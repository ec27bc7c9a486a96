"""Bumps seen from before and behind, in images beside those of Cycles."""

from math import pi

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from benchmarks.features import stage  # noqa: E402
from tests.addon.beside_cycles import image  # noqa: E402

pytestmark = pytest.mark.usefixtures("engine")

SIZE = (64, 64)
# samples a pixel, and how much of the image's mean square may differ
METHODS = {"distributed": (32, 2e-3), "raytrace": (4, 4e-3)}


def bumped(coordinates: str) -> bpy.types.Material:
    """A mirror with waves of a texture coordinate, or of the attribute "wave"."""

    def surface(tree):
        if coordinates == "attribute":
            height = stage.node(tree, "ShaderNodeAttribute", attribute_name="wave").outputs["Fac"]
        else:
            at = stage.node(tree, "ShaderNodeTexCoord").outputs[coordinates]
            height = stage.node(tree, "ShaderNodeTexWave", {"Vector": at, "Scale": 1.0}).outputs["Fac"]
        normal = stage.node(tree, "ShaderNodeBump", {"Height": height, "Distance": 0.04}).outputs[0]
        inputs = {"Color": (1, 1, 1), "Roughness": 0.0, "Normal": normal}
        return stage.node(tree, "ShaderNodeBsdfAnisotropic", inputs).outputs[0]

    return stage.material("bumped", surface)


def surrounded_by_directions() -> None:
    """A world whose colour is the direction."""
    tree = stage.tree_of(bpy.context.scene.world)
    tree.nodes.clear()
    way = stage.node(tree, "ShaderNodeTexCoord").outputs["Generated"]
    shine = stage.node(tree, "ShaderNodeBackground", {"Color": way})
    stage.node(tree, "ShaderNodeOutputWorld", {"Surface": shine.outputs[0]})


@pytest.mark.parametrize("behind", [False, True])
@pytest.mark.parametrize("coordinates", ["UV", "Generated", "attribute", "Object"])
def test_bumps_are_those_of_cycles_from_either_side(tmp_path, coordinates, behind):
    """Of what is stored with the mesh bumps are dents from behind, of positions they are bumps."""
    stage.empty_scene()
    surrounded_by_directions()
    plane = stage.plane(bumped(coordinates), (0, 0, 0), 2.0, (pi / 2 + 0.6 + pi * behind, 0, 0))
    plane.modifiers.new("fine", "SUBSURF").render_levels = 3
    plane.modifiers["fine"].subdivision_type = "SIMPLE"
    heights = plane.data.attributes.new("wave", "FLOAT", "POINT").data
    heights.foreach_set("value", np.array([0.0, 2.0, 0.0, 1.0], np.float32))
    stage.camera(at=(0, -6, 0), target=(0, 0, 0))
    theirs = image(tmp_path / "cycles.exr", "cycles", 64, SIZE)
    for method, (samples, most) in METHODS.items():
        ours = image(tmp_path / f"{method}.exr", method, samples, SIZE)
        error = ((ours - theirs) ** 2).mean() / (theirs**2).mean()
        assert error < most, f"{method}: {error:.1e}"
