"""The benchmarks' scenes as .blend files for Cycles, and .blend files as scenes of the benchmarks.

    python -m benchmarks.forward.blend forest out/forward/forest.blend

Run in a process of its own, for it uses bpy.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from benchmarks.forward import scenes
from benchmarks.forward.plants import diffuse
from benchmarks.sources import scenes_folder, text_hash
from pointmr_engine import Material, Scene
from pointmr_engine.scene.group import CAMERA, unique_groups

ROOT = Path(__file__).resolve().parents[2]


def named(name: str) -> Scene | None:
    """A scene that is made without Blender, by name; None if the name is that of a file."""
    if name == "forest":
        return scenes.forest(5000).views()[5]
    if name == "dragon":
        folder = scenes_folder()
        if folder is None:
            raise FileNotFoundError("the dragon needs the folder of third-party scenes in POINTMR_SCENES")
        return scenes.dragon(folder / "scans/dragon_vrip.ply.gz").scene
    return None


def matte(material: Material | None) -> Material:
    """A Lambertian material of the constant colour that a material begins with."""
    color, name = (0.5, 0.5, 0.5), "no material" if material is None else material.name
    for node in () if material is None else material.graph.nodes.values():
        for socket in ("base_color", "color"):
            value = node.inputs.get(socket)
            if node.kind in ("principled", "diffuse") and value is not None and np.ndim(value) == 1:
                color = tuple(float(c) for c in value[:3])
    return diffuse(name, *color)


def simplified(scene: Scene) -> Scene:
    """A scene of flat triangles, one Lambertian colour a material, the benchmarks' sun and sky, and its own camera."""
    made: dict[int, Material] = {}
    for group in unique_groups(scene.root):
        for mesh in group.meshes:
            mesh.normals = None  # as `to_blend` writes it
            mesh.materials = tuple(made.setdefault(id(m), matte(m)) for m in mesh.materials or (None,))
    return scenes.stage(scene.root, scene.camera)


def from_blend(path: str) -> Scene:
    """The scene of a .blend file, or of a real scene with a driver ("gn_trees"), simplified."""
    from benchmarks import sources

    sources.find(path).load()
    return simplified(sources.exported()[0])


def to_blend(scene: Scene, path: Path) -> None:
    """Write a scene of any nesting as objects that share their meshes; each placement becomes an object."""
    import bpy
    from mathutils import Matrix

    from benchmarks.features import stage

    stage.empty_scene()
    materials: dict[int, object] = {}
    meshes: dict[int, object] = {}

    def material_of(m):
        if id(m) not in materials:
            color = next(iter(m.graph.nodes.values())).inputs["color"]
            made = bpy.data.materials.new(m.name)
            if made.node_tree is None:
                made.use_nodes = True
            tree = made.node_tree
            tree.nodes.clear()
            bsdf, out = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
            bsdf.inputs["Color"].default_value = (*color, 1.0)
            tree.links.new(bsdf.outputs[0], out.inputs["Surface"])
            materials[id(m)] = made
        return materials[id(m)]

    def mesh_of(m):
        if id(m) not in meshes:
            made = bpy.data.meshes.new(m.name)
            t = np.ascontiguousarray(m.triangles, np.int32)
            made.vertices.add(len(m.positions))
            made.vertices.foreach_set("co", np.asarray(m.positions, np.float32).ravel())
            made.loops.add(t.size)
            made.loops.foreach_set("vertex_index", t.ravel())
            made.polygons.add(len(t))
            made.polygons.foreach_set("loop_start", np.arange(0, t.size, 3, dtype=np.int32))
            if m.material_index is not None:
                made.polygons.foreach_set("material_index", m.material_index)
            for one in m.materials:
                made.materials.append(material_of(one))
            made.update()
            made.shade_flat()
            meshes[id(m)] = made
        return meshes[id(m)]

    collection = bpy.context.scene.collection

    def place(group, matrix):
        for m in group.meshes:
            item = bpy.data.objects.new(m.name, mesh_of(m))
            item.matrix_world = Matrix(matrix)
            collection.objects.link(item)
        for batch in group.instances:
            for i, t in enumerate(batch.transforms):
                child = batch.groups[0 if batch.group_index is None else batch.group_index[i]]
                place(child, matrix @ np.vstack([t, [0, 0, 0, 1]]))

    place(scene.root, np.eye(4))
    c = scene.camera
    data = bpy.data.cameras.new("Camera")
    data.lens, data.clip_start, data.clip_end = c.focal_length, c.clip_start, c.clip_end
    view = bpy.data.objects.new("Camera", data)
    view.matrix_world = Matrix(c.world_from_camera)
    collection.objects.link(view)
    bpy.context.scene.camera = view
    add_light(scene)
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()), compress=True)


def add_light(scene: Scene) -> None:
    """The benchmarks' sun and sky in the open .blend file."""
    import bpy
    from mathutils import Matrix

    from benchmarks.features import stage

    for light in scene.lights:
        data = bpy.data.lights.new("Sun", "SUN")
        data.energy, data.angle, data.use_shadow = light.power, light.angle, light.cast_shadow
        item = bpy.data.objects.new("Sun", data)
        item.matrix_world = Matrix(light.world_from_light)
        bpy.context.scene.collection.objects.link(item)
    stage.world(scenes.SKY, 1.0)
    see = bpy.context.scene.world.cycles_visibility
    for kind in ("diffuse", "glossy", "transmission", "scatter"):
        setattr(see, kind, scene.world.visibility != CAMERA)


def ensure(name: str, folder: Path) -> Path:
    """The .blend file of a scene, written by another process if it is not there."""
    made_by = [Path(m.__file__).read_text() for m in (scenes, scenes.plants)] + [Path(__file__).read_text()]
    path = folder / f"{name}-{text_hash(name, made_by)}.blend"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run(
            [sys.executable, "-m", "benchmarks.forward.blend", name, str(path)], check=True, cwd=ROOT
        )
    return path


def main() -> None:
    name, path = sys.argv[1], Path(sys.argv[2])
    to_blend(named(name) or from_blend(name), path)


if __name__ == "__main__":
    main()
