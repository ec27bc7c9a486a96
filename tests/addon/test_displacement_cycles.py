"""Displaced meshes and their normals, in images beside those of Cycles."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from benchmarks.features import stage  # noqa: E402
from tests.addon.beside_cycles import image  # noqa: E402

pytestmark = pytest.mark.usefixtures("engine")

SIZE = (64, 64)


def showing_normals(method: str, coordinates: str | None, mapped: float | None = None) -> bpy.types.Material:
    """Shines in the colours of its normals; as high as waves of a texture coordinate, or evenly raised.

    mapped: the strength of a tangent normal map of one colour that tilts them.
    """

    def surface(tree):
        normal = stage.node(tree, "ShaderNodeNewGeometry").outputs["Normal"]
        if mapped is not None:
            tilt = {"Strength": mapped, "Color": (0.8, 0.35, 0.75, 1.0)}
            normal = stage.node(tree, "ShaderNodeNormalMap", tilt).outputs[0]
        half = {0: normal, 1: (0.5, 0.5, 0.5), 2: (0.5, 0.5, 0.5)}
        colour = stage.node(tree, "ShaderNodeVectorMath", half, operation="MULTIPLY_ADD").outputs[0]
        return stage.node(tree, "ShaderNodeEmission", {"Color": colour}).outputs[0]

    made = stage.material("normals", surface)
    made.displacement_method = method
    tree = made.node_tree
    height = 1.0
    if coordinates is not None:
        at = stage.node(tree, "ShaderNodeTexCoord").outputs[coordinates]
        height = stage.node(tree, "ShaderNodeTexWave", {"Vector": at, "Scale": 0.5}).outputs["Fac"]
    moves = stage.node(tree, "ShaderNodeDisplacement", {"Height": height, "Scale": 0.4}).outputs[0]
    tree.links.new(moves, tree.get_output_node("ALL").inputs["Displacement"])
    return made


def assert_as_cycles(folder, bound: float) -> None:
    theirs = image(folder / "cycles.exr", "cycles", 16, SIZE)
    ours = image(folder / "ours.exr", "distributed", 16, SIZE)
    assert theirs.max() > 0.5 and theirs.std() > 0.1
    difference = np.abs(ours - theirs).max(-1)
    assert difference.mean() < bound and np.quantile(difference, 0.95) < 5.0 * bound


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("coordinates", [None, "Generated", "Object"])
@pytest.mark.parametrize("method", ["DISPLACEMENT", "BOTH"])
def test_displaced_boxes_are_those_of_cycles(tmp_path, method, coordinates, smooth):
    """Corners move along their own normals. What is displaced and bumped is shaded smooth, even if its mesh is flat."""
    stage.empty_scene()
    bpy.ops.mesh.primitive_cube_add()
    box = bpy.context.object
    box.data.materials.append(showing_normals(method, coordinates))
    for side in box.data.polygons:
        side.use_smooth = smooth
    stage.camera(at=(3, -5, 3.5), target=(0, 0, 0))
    # differences of positions Cycles takes along the moved triangles
    assert_as_cycles(tmp_path, 0.02 if coordinates == "Object" else 0.01)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("method", ["DISPLACEMENT", "BUMP"])
def test_what_stays_beside_what_is_displaced_is_as_in_cycles(tmp_path, method, smooth):
    """It shares the normals of the moved surface where they meet; a flat mesh, in which it was smooth, stays flat."""
    stage.empty_scene()
    bpy.ops.mesh.primitive_torus_add(major_segments=16, minor_segments=8)
    ring = bpy.context.object
    for displacement, height in (("DISPLACEMENT", "Object"), (method, None)):
        ring.data.materials.append(showing_normals(displacement, height))
    if method == "BUMP":  # not displaced at all
        tree = ring.data.materials[1].node_tree
        tree.links.remove(tree.get_output_node("ALL").inputs["Displacement"].links[0])
    for k, side in enumerate(ring.data.polygons):
        side.use_smooth, side.material_index = smooth, k // 3 % 2
    stage.camera(at=(3, -5, 3.5), target=(0, 0, 0))
    assert_as_cycles(tmp_path, 0.01)


@pytest.mark.parametrize("height", [3.5, -3.5])
@pytest.mark.parametrize("coordinates", ["UV", "Generated", "Object"])
@pytest.mark.parametrize("method", ["BUMP", "BOTH"])
def test_displaced_floors_are_those_of_cycles_from_either_side(tmp_path, method, coordinates, height):
    """From behind bumps of UVs are dents, and bumps where they have moved the surface, too."""
    stage.empty_scene()
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=12, y_subdivisions=12, size=3)
    bpy.context.object.data.materials.append(showing_normals(method, coordinates))
    stage.camera(at=(3, -5, height), target=(0, 0, 0))
    assert_as_cycles(tmp_path, 0.02 if coordinates == "Object" else 0.01)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("strength", [0.4, 1.0])
@pytest.mark.parametrize("method", ["BUMP", "DISPLACEMENT", "BOTH"])
def test_normal_maps_of_displaced_meshes_are_those_of_cycles(tmp_path, method, strength, smooth):
    """They tilt the normals that smooth meshes had before, and by their strength those that these have now."""
    stage.empty_scene()
    bpy.ops.mesh.primitive_torus_add(major_segments=48, minor_segments=24)
    ring = bpy.context.object
    ring.data.materials.append(showing_normals(method, "UV", strength))
    for side in ring.data.polygons:
        side.use_smooth = smooth
    stage.camera(at=(3, -5, 3.5), target=(0, 0, 0))
    assert_as_cycles(tmp_path, 0.01)
