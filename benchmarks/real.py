"""Drivers of real scenes that nobody here made: each opens a file of POINTMR_SCENES and makes it renderable."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.sources import Source, file_hash, open_blend, scenes_folder, text_hash


@dataclass(frozen=True)
class Real:
    """A file below POINTMR_SCENES and what is done to it after it is opened."""

    name: str
    file: str
    prepare: Callable[[], None]
    size: tuple[int, int]
    overrides: dict = field(default_factory=dict)


REAL: dict[str, Real] = {}


def real(file: str, size: tuple[int, int], **overrides):
    """Register a driver under its function's name."""

    def register(prepare: Callable[[], None]) -> Callable[[], None]:
        REAL[prepare.__name__] = Real(prepare.__name__, file, prepare, size, overrides)
        return prepare

    return register


def available(name: str) -> bool:
    """Whether POINTMR_SCENES has the file of this real scene."""
    folder = scenes_folder()
    return folder is not None and (folder / REAL[name].file).is_file()


def source(name: str) -> Source:
    """The real scene as a Source of the judge. Raises FileNotFoundError when POINTMR_SCENES does not hold it."""
    item, folder = REAL[name], scenes_folder()
    if folder is None:
        raise FileNotFoundError(f"'{name}' needs the folder of third-party scenes in POINTMR_SCENES")
    path = folder / item.file
    if not path.is_file():
        raise FileNotFoundError(f"'{name}': no file {path}")

    def load() -> None:
        if path.suffix == ".blend":
            open_blend(path)
        else:
            import_gltf(path)
        item.prepare()

    helpers = [inspect.getsource(f) for f in (frame, sun, ambient, import_gltf)]
    content = text_hash(file_hash(path), inspect.getsource(item.prepare), *helpers)
    return Source(name, load, content, item.size, item.overrides, "real")


# ---- what the drivers share -------------------------------------------------------------------------------------


def bounds(depsgraph=None):
    """Corners (lo, hi) of all that renders, instances included, in world space."""
    import bpy
    import numpy as np

    depsgraph = depsgraph or bpy.context.evaluated_depsgraph_get()
    lo, hi = np.full(3, np.inf), np.full(3, -np.inf)
    for instance in depsgraph.object_instances:
        item = instance.object
        if item.type not in {"MESH", "CURVE", "SURFACE", "META", "FONT"} or item.hide_render:
            continue
        corners = np.array([corner[:] for corner in item.bound_box])
        matrix = np.array(instance.matrix_world)
        world = corners @ matrix[:3, :3].T + matrix[:3, 3]
        if np.isfinite(world).all():
            lo, hi = np.minimum(lo, world.min(axis=0)), np.maximum(hi, world.max(axis=0))
    return lo, hi


def frame(direction=(0.6, -1.0, 0.45), lens=50.0, margin=1.0, target=None, extent=None) -> None:
    """Add a camera that looks along -direction and holds all that renders (or `extent` metres about `target`)."""
    import bpy
    import numpy as np
    from mathutils import Vector

    lo, hi = bounds()
    centre = Vector(target) if target is not None else Vector((lo + hi) / 2)
    size = extent or float(np.linalg.norm(hi - lo))
    item = bpy.data.objects.new("Judge camera", bpy.data.cameras.new("Judge camera"))
    bpy.context.scene.collection.objects.link(item)
    away = Vector(direction).normalized()
    distance = margin * size * lens / 36.0
    item.location = centre + away * distance
    item.rotation_euler = (-away).to_track_quat("-Z", "Y").to_euler()
    item.data.lens = lens
    item.data.clip_start, item.data.clip_end = distance * 0.001, distance * 20 + size
    bpy.context.scene.camera = item


def sun(strength=3.0, direction=(-0.4, -0.6, 0.8), angle=0.1) -> None:
    """Add a sun that shines from `direction`."""
    import bpy
    from mathutils import Vector

    light = bpy.data.lights.new("Judge sun", "SUN")
    light.energy, light.angle = strength, angle
    item = bpy.data.objects.new("Judge sun", light)
    bpy.context.scene.collection.objects.link(item)
    item.rotation_euler = Vector(direction).to_track_quat("Z", "Y").to_euler()


def ambient(color=(0.35, 0.42, 0.55), strength=0.8) -> None:
    """A uniform world."""
    import bpy

    world = bpy.data.worlds.new("Judge world")
    bpy.context.scene.world = world
    if world.node_tree is None:
        world.use_nodes = True
    background = next(n for n in world.node_tree.nodes if n.bl_idname == "ShaderNodeBackground")
    background.inputs[0].default_value = (*color, 1)
    background.inputs[1].default_value = strength


def import_gltf(path: Path) -> None:
    """Import a glTF file into an empty scene, light and frame it."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(path))
    frame()
    sun()
    ambient()


def at_frame(number: int) -> None:
    """Go to a frame of the animation."""
    import bpy

    bpy.context.scene.frame_set(number)


# ---- the scenes -------------------------------------------------------------------------------------------------


@real("bmw27/bmw27_cpu.blend", (240, 135))
def bmw27():
    """Blender's old benchmark: cars lit by emissive meshes, glass, metal, depth of field."""


@real("gn_trees/LowpolyGeometrynodeTree.blend", (240, 135), transparent_max_bounces=36)  # as the file has it
def gn_trees():
    """45,839 instances scattered by geometry nodes, leaves cut out by alpha; it has no camera of its own."""
    frame((0.35, -1.0, 0.28), lens=35, margin=0.55)


@real("scans/scans.blend", (240, 180))
def scans():
    """836,044 triangles of scans: glass, gold, copper, diffuse."""


@real("skinned9/animation_instanced.blend", (240, 135))
def skinned9():
    """Nine skinned characters under a sky texture."""
    at_frame(9)


@real("bunnies_newyear/New_Year_Animation.blend", (240, 135))
def bunnies_newyear():
    """Shape keys, textures of which some are missing, one sun."""
    at_frame(60)


@real("retro_car/retrosubdiv.blend", (240, 135))
def retro_car():
    """Cycles materials of an old version, curves and arrays, armature."""


@real("castle_lights/castle.blend", (240, 135))
def castle_lights():
    """Nine point lights and a sun."""


@real("fox_packed/fox.blend", (200, 150))
def fox_packed():
    """A rigged fox with a packed texture; it has neither camera nor light."""
    frame((1.0, -0.7, 0.35), lens=50)
    sun()
    ambient()


@real("particles_birth/particle_emitter.blend", (180, 180))
def particles_birth():
    """Particles with birth and death that show an object."""
    at_frame(24)


@real("spritefright_props/lib/props/dirt_hill/dirt_hill.blend", (240, 135))
def dirt_hill():
    """A prop of a film: linked node groups, curves, Voronoi, displacement, four area lights."""


@real("gltf_pack/CesiumMilkTruck.glb", (200, 150))
def gltf_truck():
    """A truck with a texture, imported from glTF."""


@real("gltf_pack/chess-board.glb", (200, 150))
def gltf_chess():
    """A chess board, imported from glTF."""


@real("gltf_pack/house.glb", (200, 150))
def gltf_house():
    """A house, imported from glTF."""


@real("gltf_pack/mannequiny-0.3.0.glb", (200, 150))
def gltf_mannequin():
    """A rigged mannequin, imported from glTF."""


@real("gltf_pack/morph-stress-test.glb", (200, 150))
def gltf_morph():
    """Eight morph targets, imported from glTF."""


@real("gltf_pack/low-poly-jungle-scene/scene.gltf", (200, 150))
def gltf_jungle():
    """A jungle of textured cards with alpha, imported from glTF with its textures."""


@real("armory_small/particle_hair.blend", (200, 112))
def armory_hair():
    """200 hair instances under a sky texture."""


@real("armory_small/instancing.blend", (200, 112))
def armory_instancing():
    """Subdivision, checkers, a sun and a sky."""
