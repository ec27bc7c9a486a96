"""Scenes that the subjects need and no file holds: Blender scenes built by script, the same for every renderer."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
DRAGON = "scans/dragon_vrip.ply.gz"
CUT = 250.0  # metres of forest that Cycles is given


def triangles_to_mesh(name: str, positions: np.ndarray, triangles: np.ndarray, material, smooth: bool):
    """A bpy mesh from (V, 3) positions and (T, 3) triangles."""
    import bpy

    made = bpy.data.meshes.new(name)
    indices = np.ascontiguousarray(triangles, np.int32)
    made.vertices.add(len(positions))
    made.vertices.foreach_set("co", np.ascontiguousarray(positions, np.float32).ravel())
    made.loops.add(indices.size)
    made.loops.foreach_set("vertex_index", indices.ravel())
    made.polygons.add(len(indices))
    made.polygons.foreach_set("loop_start", np.arange(0, indices.size, 3, dtype=np.int32))
    made.materials.append(material)
    made.update()
    made.polygons.foreach_set("use_smooth", np.full(len(indices), smooth))
    return made


def daylight(angle: float = 0.02) -> None:
    """A sun of `angle` radians across, and a uniform sky."""
    from benchmarks.features import stage

    stage.world((0.42, 0.55, 0.78), 0.8)
    stage.lamp("SUN", 3.2, (-3.0, -4.0, 5.0), (0, 0, 0), (1.0, 0.95, 0.86), angle=angle)


def boxes(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(positions (8 N, 3), triangles (12 N, 3)) of N boxes between corners (N, 3)."""
    corner = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    positions = np.where(corner[None] == 1, high[:, None], low[:, None]).reshape(-1, 3)
    quads = np.array([(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)])
    one = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return positions, (one[None] + 8 * np.arange(len(low))[:, None, None]).reshape(-1, 3)


# ---- scans ------------------------------------------------------------------------------------------------------


def dragons(side: int, step: float):
    """A floor with side x side dragons, a metre long, turned at random."""
    from benchmarks.features import stage
    from benchmarks.sources import scenes_folder
    from benchmarks.speed_rays import read_ply

    stage.empty_scene()
    positions, triangles = read_ply(scenes_folder() / DRAGON)
    positions = positions[:, [0, 2, 1]] * np.float32([1, -1, 1])  # y up -> z up
    low, high = positions.min(0), positions.max(0)
    middle = 0.5 * (low + high)
    positions = (positions - [middle[0], middle[1], low[2]]) / float((high - low).max())
    jade = stage.principled("Jade", Base_Color=(0.18, 0.45, 0.26), Roughness=0.35)
    body = triangles_to_mesh("Dragon", positions, triangles, jade, smooth=True)
    import bpy

    rng = np.random.default_rng(5)
    for k in range(side * side):
        item = stage.link(bpy.data.objects.new(f"Dragon {k}", body))
        j, i = divmod(k, side)
        item.location = ((i - (side - 1) / 2) * step, (j - (side - 1) / 2) * step, 0.0)
        item.rotation_euler = (0.0, 0.0, rng.uniform(0, 6.28) if side > 1 else 0.0)
    stage.plane(stage.matte((0.45, 0.42, 0.38), "Floor"), size=20.0 + 8 * side * step)
    daylight()


def dragon_near() -> None:
    """One dragon that fills the picture."""
    from benchmarks.features import stage

    dragons(1, 1.0)
    stage.camera((0.5, -1.25, 0.75), (0, 0, 0.33), 40.0, clip_start=0.01)


def dragon_far() -> None:
    """20 x 20 dragons seen from above a corner."""
    from benchmarks.features import stage

    dragons(20, 1.3)
    stage.camera((2.0, -26.0, 9.0), (0, -1.0, 0.0), 35.0, clip_end=500.0)


# ---- fine detail ------------------------------------------------------------------------------------------------


def horizon() -> None:
    """Checks of 0.2 m, tinted by noise, on a plane of 4 km, with blocks more and more distant."""
    from benchmarks.features import stage

    stage.empty_scene()

    def surface(tree):
        at = stage.node(tree, "ShaderNodeNewGeometry").outputs["Position"]
        checks = stage.node(
            tree,
            "ShaderNodeTexChecker",
            {"Vector": at, "Color1": (0.75, 0.70, 0.60), "Color2": (0.05, 0.07, 0.12), "Scale": 5.0},
        )
        noise = stage.node(tree, "ShaderNodeTexNoise", {"Vector": at, "Scale": 7.0, "Detail": 3.0})
        mixed = stage.node(tree, "ShaderNodeMix", data_type="RGBA", blend_type="MULTIPLY")
        mixed.inputs["Factor"].default_value = 0.7
        tree.links.new(checks.outputs["Color"], mixed.inputs[6])
        tree.links.new(noise.outputs["Color"], mixed.inputs[7])
        return stage.node(tree, "ShaderNodeBsdfDiffuse", {"Color": mixed.outputs[2]}).outputs[0]

    # off the lattice of the checks: at z = 0 rounding would decide which colour shows
    stage.plane(stage.material("Checks", surface), (0, 0, 0.05), size=4000.0)
    block = stage.matte((0.6, 0.16, 0.08), "Block")
    for k in range(8):
        stage.cube(
            block, ((-1) ** k * (1.4 + 0.9 * 1.5**k), 2.0 + 5.0 * 1.6**k, 0.85), 1.6, bevel=0.0, turn=0.3 * k
        )
    daylight()
    stage.camera((0, -6.0, 1.8), (0, 30.0, 0.6), 28.0, clip_end=5000.0)


def fence() -> None:
    """Twelve rows of wire mesh from 3 m to 60 m, wires of 3 mm every 5 cm, before coloured posts."""
    import bpy

    from benchmarks.features import stage

    stage.empty_scene()
    steel = stage.principled("Steel", Base_Color=(0.55, 0.57, 0.6), Metallic=1.0, Roughness=0.4)
    wide, tall, cell, wire = 4.0, 2.0, 0.05, 0.0015
    x = np.arange(-wide / 2, wide / 2, cell)
    z = np.arange(cell / 2, tall, cell)
    low = np.concatenate(
        [
            np.stack([x - wire, 0 * x - wire, 0 * x], 1),
            np.stack([0 * z - wide / 2, 0 * z + wire, z - wire], 1),
        ]
    )
    high = np.concatenate(
        [
            np.stack([x + wire, 0 * x + wire, 0 * x + tall], 1),
            np.stack([0 * z + wide / 2, 0 * z + 3 * wire, z + wire], 1),
        ]
    )
    panel = triangles_to_mesh("Panel", *boxes(low, high), steel, smooth=False)
    rng = np.random.default_rng(4)
    for row, distance in enumerate(3.0 * 1.31 ** np.arange(12)):
        count = int(np.ceil(1.6 * distance / wide / 2)) + 1
        for i in range(-count, count + 1):
            item = stage.link(bpy.data.objects.new(f"Panel {row} {i}", panel))
            item.location = (i * wide, distance, 0.0)
            item.rotation_euler = (0, 0, rng.normal(0, 0.03))
    colors = (stage.RED, stage.GREEN, stage.BLUE, stage.CREAM)
    surfaces = [stage.matte(c, f"Post {i}") for i, c in enumerate(colors)]
    for k in range(24):
        distance = rng.uniform(3.5, 60.0)
        at = (rng.uniform(-0.55, 0.55) * distance, distance, 1.2)
        stage.cube(surfaces[k % 4], at, 0.5 + 0.03 * distance, bevel=0.0, turn=k)
    stage.plane(stage.matte((0.20, 0.24, 0.12), "Grass"), size=600.0)
    daylight()
    stage.camera((0.4, -0.5, 1.5), (0, 20.0, 1.2), 32.0, clip_end=1000.0)


def mirrors() -> None:
    """Balls and rings of chrome, glass and satin metal on checks, small blocks between them, under half a sky."""
    from benchmarks.features import stage

    stage.empty_scene()

    def surface(tree):
        at = stage.node(tree, "ShaderNodeNewGeometry").outputs["Position"]
        colors = {"Color1": (0.8, 0.75, 0.7), "Color2": (0.1, 0.12, 0.2), "Scale": 1.0}
        checks = stage.node(tree, "ShaderNodeTexChecker", {"Vector": at, **colors})
        return stage.node(tree, "ShaderNodeBsdfDiffuse", {"Color": checks.outputs["Color"]}).outputs[0]

    # off the lattice of the checks
    stage.plane(stage.material("Checks", surface), (0, 0, 0.01), size=40.0)
    kinds = (
        stage.principled("Chrome", Base_Color=(0.9, 0.9, 0.9), Metallic=1.0, Roughness=0.0),
        stage.principled("Glass", Base_Color=(1, 1, 1), Transmission_Weight=1.0, Roughness=0.0, IOR=1.45),
        stage.principled("Satin", Base_Color=(0.9, 0.7, 0.5), Metallic=1.0, Roughness=0.1),
    )
    for i in range(9):
        at = (2.4 * (i % 3 - 1), 3.0 * (i // 3), 1.0)
        if i % 2:
            stage.sphere(kinds[i % 3], at)
        else:
            stage.turned(stage.torus(kinds[i % 3], at, 0.8, 0.3), 1.2, 0.3 * i)
    blocks = [stage.matte(c, f"Block {i}") for i, c in enumerate((stage.RED, stage.GREEN, stage.BLUE))]
    for i in range(30):
        at = (1.1 * (7 * i % 13 - 6), 5 * i % 11 - 3.0, 0.2)
        stage.cube(blocks[i % 3], at, 0.35, bevel=0.0, turn=0.0)
    stage.world((0.42, 0.55, 0.78), 1.0)
    stage.plane(stage.matte((0.05, 0.05, 0.05), "Wall"), (0, 30.0, 0), 60.0, (1.5708, 0, 0))
    stage.camera((0, -7.0, 3.0), (0, 0, 0.67), 50.0)


# ---- the forest that Cycles can load ----------------------------------------------------------------------------


def forest_cut() -> None:
    """The forest of 10^15 without groves and stands, its trees within CUT metres, each limb one mesh; placed by
    geometry nodes, which every renderer sees. Without random colours, for in instances of instances every renderer has
    random numbers of its own.
    """
    import bpy

    import blender_addon
    from benchmarks.sources import open_blend

    sys.path.insert(0, str(ROOT / "scenes_blend"))
    import plants

    if not hasattr(bpy.types.Object, "pointmr"):
        blender_addon.register()
    open_blend(ROOT / "scenes_blend" / "forest_1e15.blend")
    for name in ("Groves in the valley", "Stands to the horizon"):
        bpy.data.objects.remove(bpy.data.objects[name])
    keep_near("Trees nearby")
    limbs = {
        o.pointmr.instance_collection for o in bpy.data.objects if o.name.endswith(("limbs", "branches"))
    }
    for limb in limbs:
        realise(limb)
    for material in bpy.data.materials:
        if material.node_tree:
            same_for_all(material.node_tree)
    for item in list(bpy.data.objects):
        source = item.pointmr.instance_collection
        if source is not None and item.pointmr.instance_on == "POINTS":
            chosen = "index" in item.data.attributes
            item.pointmr.instance_collection = None
            modifier = item.modifiers.new("Instances", "NODES")
            modifier.node_group = plants.instance_nodes(source, chosen)


def same_for_all(tree) -> None:
    """Replace Object Info's Random in a material's nodes by its mean."""
    for info in [n for n in tree.nodes if n.bl_idname == "ShaderNodeObjectInfo"]:
        value = tree.nodes.new("ShaderNodeValue")
        value.outputs[0].default_value = 0.5
        for link in list(info.outputs["Random"].links):
            tree.links.new(link.to_socket, value.outputs[0])


def keep_near(name: str) -> None:
    """Remove the points of an object that lie farther than CUT from the origin."""
    import bmesh
    import bpy

    mesh = bpy.data.objects[name].data
    edit = bmesh.new()
    edit.from_mesh(mesh)
    bmesh.ops.delete(edit, geom=[v for v in edit.verts if v.co.xy.length > CUT], context="VERTS")
    edit.to_mesh(mesh)
    edit.free()


def realise(collection) -> None:
    """Replace what a collection holds, instances and all, by one mesh."""
    import bpy
    import plants

    tree = plants.instance_nodes(collection, False)
    place = next(n for n in tree.nodes if n.bl_idname == "GeometryNodeInstanceOnPoints")
    out = next(n for n in tree.nodes if n.bl_idname == "NodeGroupOutput")
    real = tree.nodes.new("GeometryNodeRealizeInstances")
    tree.links.new(real.inputs[0], place.outputs[0])
    tree.links.new(out.inputs[0], real.outputs[0])
    point = plants.point_mesh("One", [(0, 0, 0)], rotation=np.zeros((1, 3)), scale=np.ones(1))
    carrier = bpy.data.objects.new("Carrier", point)
    bpy.context.scene.collection.objects.link(carrier)
    carrier.modifiers.new("Realise", "NODES").node_group = tree
    evaluated = carrier.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = bpy.data.meshes.new_from_object(evaluated)
    bpy.data.objects.remove(carrier)
    for item in list(collection.objects):
        bpy.data.objects.remove(item)
    collection.objects.link(bpy.data.objects.new(f"{collection.name} whole", mesh))
