"""What the feature scenes are put together from: a photographer's cove, a camera, lamps, solids and materials."""

from __future__ import annotations

from math import cos, pi, sin

import bpy
import numpy as np
from mathutils import Euler, Vector

GREY = (0.5, 0.5, 0.5)
RED, GREEN, BLUE = (0.62, 0.07, 0.04), (0.10, 0.38, 0.09), (0.06, 0.16, 0.55)
CREAM, SAND, SLATE = (0.75, 0.68, 0.55), (0.55, 0.40, 0.24), (0.10, 0.12, 0.15)
GOLD, COPPER = (0.95, 0.62, 0.22), (0.88, 0.42, 0.27)


def empty_scene() -> None:
    """Start over: nothing but a scene with a black world, rendered with a film that is not transparent."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("World")
    world(color=(0, 0, 0))


# ---- node trees -------------------------------------------------------------------------------------------------


def tree_of(owner) -> bpy.types.NodeTree:
    """The node tree of a material, world or light, switched on."""
    if owner.node_tree is None:
        owner.use_nodes = True
    return owner.node_tree


def node(tree, kind: str, inputs: dict | None = None, **properties) -> bpy.types.Node:
    """Add a node. `inputs` maps socket names (or positions) to values or to output sockets, which are linked."""
    item = tree.nodes.new(kind)
    for name, value in properties.items():
        setattr(item, name, value)
    for key, value in (inputs or {}).items():
        socket = item.inputs[key]
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, socket)
        elif isinstance(value, tuple) and socket.type == "RGBA" and len(value) == 3:
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value
    return item


def material(name: str, surface) -> bpy.types.Material:
    """A material whose surface is what surface(tree) returns: an output socket of a shader."""
    item = bpy.data.materials.new(name)
    tree = tree_of(item)
    tree.nodes.clear()
    node(tree, "ShaderNodeOutputMaterial", {"Surface": surface(tree)})
    return item


def principled(name: str = "Principled", **inputs) -> bpy.types.Material:
    """A Principled BSDF; keywords are its sockets' names with underscores: Base_Color=RED, Roughness=0.2."""
    sockets = {k.replace("_", " "): v for k, v in inputs.items()}
    return material(name, lambda t: node(t, "ShaderNodeBsdfPrincipled", sockets).outputs[0])


def matte(color=GREY, name: str = "Matte") -> bpy.types.Material:
    """A Lambertian surface."""
    return diffuse(name, lambda tree: color)


def diffuse(name: str, color) -> bpy.types.Material:
    """A diffuse surface whose colour is what color(tree) returns: a socket or a value."""
    return material(name, lambda t: node(t, "ShaderNodeBsdfDiffuse", {"Color": color(t)}).outputs[0])


def glow(color=(1, 1, 1), strength=5.0, name: str = "Glow") -> bpy.types.Material:
    """A surface that only emits."""
    return material(
        name, lambda t: node(t, "ShaderNodeEmission", {"Color": color, "Strength": strength}).outputs[0]
    )


def world(color=(0.05, 0.05, 0.05), strength=1.0) -> None:
    """A uniform background."""
    tree = tree_of(bpy.context.scene.world)
    tree.nodes.clear()
    background = node(tree, "ShaderNodeBackground", {"Color": color, "Strength": strength})
    node(tree, "ShaderNodeOutputWorld", {"Surface": background.outputs[0]})


def image(name: str, pixels: np.ndarray, colorspace: str = "sRGB", is_float: bool = False) -> bpy.types.Image:
    """A generated image from (height, width, 3 or 4) values, bottom row first, packed into the file."""
    pixels = np.asarray(pixels, dtype=np.float32)
    height, width, channels = pixels.shape
    if channels == 3:
        pixels = np.dstack([pixels, np.ones((height, width), np.float32)])
    item = bpy.data.images.new(name, width, height, alpha=True, float_buffer=is_float)
    item.colorspace_settings.name = colorspace
    item.pixels.foreach_set(np.ascontiguousarray(pixels).ravel())
    item.update()
    item.pack()
    return item


def tiles(size: int = 64, cells: int = 8, a=(0.85, 0.80, 0.70), b=(0.15, 0.25, 0.45)) -> np.ndarray:
    """A drawn test card: checks with a red corner, a green disk and a gradient, so that no two corners look alike."""
    y, x = np.mgrid[0:size, 0:size] / size
    check = ((x * cells).astype(int) + (y * cells).astype(int)) % 2
    card = np.where(check[..., None] == 0, a, b) * (0.6 + 0.4 * y[..., None])
    card[(x < 0.25) & (y < 0.25)] = (0.8, 0.08, 0.05)
    card[(x - 0.7) ** 2 + (y - 0.65) ** 2 < 0.03] = (0.1, 0.6, 0.15)
    return card.astype(np.float32)


# ---- objects ----------------------------------------------------------------------------------------------------


def link(item) -> bpy.types.Object:
    """Put an object into the scene."""
    bpy.context.scene.collection.objects.link(item)
    return item


def mesh_object(
    name, positions, faces, surface=None, smooth=False, at=(0, 0, 0), uv=None
) -> bpy.types.Object:
    """An object from vertex positions, faces and, per face corner, uv."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([tuple(map(float, p)) for p in positions], [], [tuple(map(int, f)) for f in faces])
    if uv is not None:
        layer = mesh.uv_layers.new(name="UVMap")
        layer.uv.foreach_set("vector", np.asarray(uv, np.float32).ravel())
    mesh.polygons.foreach_set("use_smooth", np.full(len(mesh.polygons), smooth))
    if surface:
        mesh.materials.append(surface)
    mesh.update()
    item = link(bpy.data.objects.new(name, mesh))
    item.location = at
    return item


def _finish(item, surface, smooth) -> bpy.types.Object:
    item.data.polygons.foreach_set("use_smooth", np.full(len(item.data.polygons), smooth))
    if surface:
        item.data.materials.append(surface)
    return item


def sphere(surface=None, at=(0, 0, 1), radius=1.0, smooth=True, segments=64) -> bpy.types.Object:
    """A UV sphere with its poles up and down."""
    bpy.ops.mesh.primitive_uv_sphere_add(
        radius=radius, location=at, segments=segments, ring_count=segments // 2
    )
    return _finish(bpy.context.object, surface, smooth)


def cube(surface=None, at=(0, 0, 1), size=1.5, bevel=0.08, turn=0.5) -> bpy.types.Object:
    """A cube with rounded edges (a modifier), turned about z by `turn` radians."""
    bpy.ops.mesh.primitive_cube_add(size=size, location=at, rotation=(0, 0, turn))
    item = _finish(bpy.context.object, surface, bevel > 0)
    if bevel > 0:
        modifier = item.modifiers.new("Bevel", "BEVEL")
        modifier.width, modifier.segments, modifier.harden_normals = bevel, 3, True
    return item


def torus(surface=None, at=(0, 0, 0.4), major=0.9, minor=0.35) -> bpy.types.Object:
    """A smooth ring lying flat."""
    bpy.ops.mesh.primitive_torus_add(
        location=at, major_radius=major, minor_radius=minor, major_segments=64, minor_segments=24
    )
    return _finish(bpy.context.object, surface, True)


def monkey(surface=None, at=(0, 0, 1), size=1.3, turn=0.4, levels=1) -> bpy.types.Object:
    """Blender's monkey head, subdivided."""
    bpy.ops.mesh.primitive_monkey_add(size=1.35 * size, location=at, rotation=(-0.35, 0, turn))
    item = _finish(bpy.context.object, surface, True)
    if levels:
        item.modifiers.new("Subdivision", "SUBSURF").render_levels = levels
    return item


def plane(surface=None, at=(0, 0, 0), size=2.0, rotation=(0, 0, 0), uv_scale=1.0) -> bpy.types.Object:
    """A square with its UV map covering 0..uv_scale."""
    bpy.ops.mesh.primitive_plane_add(size=size, location=at, rotation=rotation)
    item = _finish(bpy.context.object, surface, False)
    if uv_scale != 1.0:
        layer = item.data.uv_layers[0].uv
        values = np.empty(2 * len(layer), np.float32)
        layer.foreach_get("vector", values)
        layer.foreach_set("vector", values * uv_scale)
    return item


def cove(color=GREY, depth=3.0, surface=None) -> bpy.types.Object:
    """Floor and back wall joined by a quarter round, as in a photographer's studio."""
    radius, width = 2.0, 16.0
    profile = [(-12.0, 0.0), (depth, 0.0)]
    profile += [(depth + radius * sin(a), radius * (1 - cos(a))) for a in np.linspace(0, pi / 2, 13)[1:]]
    profile.append((depth + radius, 9.0))
    positions = [(s * width, y, z) for y, z in profile for s in (-1, 1)]
    faces = [(2 * i, 2 * i + 1, 2 * i + 3, 2 * i + 2) for i in range(len(profile) - 1)]
    return mesh_object("Cove", positions, faces, surface or matte(color, "Cove"), smooth=True)


def look_at(item, target) -> None:
    """Turn an object so that its -z axis points at the target and its y axis up."""
    direction = Vector(target) - item.location
    item.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()


def camera(at=(0, -7.5, 3.0), target=(0, 0, 0.85), lens=50.0, **data) -> bpy.types.Object:
    """The scene's camera; keywords set its data."""
    item = link(bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera")))
    item.location = at
    look_at(item, target)
    item.data.lens = lens
    for name, value in data.items():
        setattr(item.data, name, value)
    bpy.context.scene.camera = item
    return item


def lamp(
    kind: str, power=100.0, at=(-3, -3, 4), target=(0, 0, 0.6), color=(1, 1, 1), **data
) -> bpy.types.Object:
    """A lamp that looks at the target; keywords set its data."""
    light = bpy.data.lights.new(kind.title(), kind)
    light.energy, light.color = power, color
    for name, value in data.items():
        setattr(light, name, value)
    item = link(bpy.data.objects.new(kind.title(), light))
    item.location = at
    look_at(item, target)
    return item


def softbox(power=250.0, at=(-3.2, -3.5, 4.5), size=1.5, **data) -> bpy.types.Object:
    """The usual key light: a square area lamp from the upper left."""
    return lamp("AREA", power, at, size=size, **data)


def studio(fill=0.15, power=300.0, floor=GREY, lens=50.0, key=1.5) -> None:
    """Cove, camera, softbox with sides of `key` metres, and a little light from all around."""
    world((fill, fill, fill * 1.15))
    cove(floor)
    camera(lens=lens)
    softbox(power, size=key)


def turned(item, x=0.0, y=0.0, z=0.0) -> bpy.types.Object:
    """Set an object's rotation, radians."""
    item.rotation_euler = Euler((x, y, z))
    return item


def row(make, values) -> None:
    """Spheres side by side that fill the picture, the i-th with the material make(values[i])."""
    count = len(values)
    radius = min(1.0, 2.45 / count)
    for i, value in enumerate(values):
        sphere(make(value), ((2 * i + 1 - count) * radius * 1.05, 0, radius), radius)


def panels(surfaces) -> None:
    """Squares side by side that fill the picture, leaning back, one for each material."""
    count = len(surfaces)
    side = min(2.0, 5.2 / count)
    for i, surface in enumerate(surfaces):
        plane(surface, ((2 * i + 1 - count) * side * 0.52, 0, side * 0.55), side, (1.35, 0, 0))
