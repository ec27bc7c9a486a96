"""What the scene scripts share: meshes from arrays, node graphs in a line a node, saving."""

from __future__ import annotations

import sys
from pathlib import Path

import bmesh
import bpy
import numpy as np
from mathutils import Vector

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import blender_addon  # noqa: E402


def new_scene() -> bpy.types.Scene:
    """An empty file with PointMR as its engine, 640x480."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if not hasattr(bpy.types.Object, "pointmr"):
        blender_addon.register()
    scene = bpy.context.scene
    scene.frame_end = 1
    scene.render.engine = "POINTMR"
    scene.render.resolution_x, scene.render.resolution_y = 640, 480
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "PNG"
    return scene


def save(name: str, folder: str | None = None) -> Path:
    """Write the scene, compressed, beside the scripts or into `folder`."""
    path = Path(folder or HERE) / name
    bpy.context.scene.name = path.stem
    bpy.data.orphans_purge(do_local_ids=True, do_recursive=True)
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True, relative_remap=False)
    return path


def target_folder() -> str | None:
    """The folder named on the command line, None for the scripts' own."""
    return sys.argv[1] if len(sys.argv) > 1 else None


# Objects


def collection(name: str, parent=None) -> bpy.types.Collection:
    """A new collection; without a parent it is in no scene, to be instanced only."""
    c = bpy.data.collections.new(name)
    if parent is not None:
        parent.children.link(c)
    return c


def add(name: str, data=None, to=None, location=(0, 0, 0), rotation=(0, 0, 0), scale=1.0) -> bpy.types.Object:
    """A new object in a collection (the scene's by default)."""
    ob = bpy.data.objects.new(name, data)
    (to or bpy.context.scene.collection).objects.link(ob)
    ob.location, ob.rotation_euler = location, rotation
    ob.scale = (scale,) * 3 if np.isscalar(scale) else scale
    return ob


def look_at(ob, target) -> None:
    """Turn -z of a camera or lamp to a point."""
    ob.rotation_euler = (Vector(target) - ob.location).to_track_quat("-Z", "Y").to_euler()


def area(name, size, power, location, target, color=(1, 1, 1)) -> bpy.types.Object:
    """A rectangular area light, size (x, y) in metres, power in watts."""
    lamp = bpy.data.lights.new(name, "AREA")
    lamp.shape, lamp.size, lamp.size_y = "RECTANGLE", *size
    lamp.energy, lamp.color = power, color
    ob = add(name, lamp, location=location)
    look_at(ob, target)
    return ob


def camera(name, location, target, lens=50.0, focus=None, fstop=None) -> bpy.types.Object:
    """The scene's camera; with an f-stop, in focus at the point `focus`."""
    data = bpy.data.cameras.new(name)
    data.lens = lens
    ob = add(name, data, location=location)
    look_at(ob, target)
    if fstop is not None:
        data.dof.use_dof, data.dof.aperture_fstop = True, fstop
        forward = np.array(target, float) - np.array(location, float)
        forward /= np.linalg.norm(forward)
        data.dof.focus_distance = float(forward @ (np.array(focus, float) - np.array(location, float)))
    bpy.context.scene.camera = ob
    return ob


# Meshes


def mesh(name, positions, faces, materials=(), uv=None, smooth=True, material_index=None) -> bpy.types.Mesh:
    """A mesh from positions (N, 3), faces (lists, or an (F, K) array) and UVs per vertex (N, 2) or corner."""
    data = bpy.data.meshes.new(name)
    positions = np.asarray(positions, np.float32)
    if isinstance(faces, np.ndarray):
        count, sides = faces.shape
        data.vertices.add(len(positions))
        data.vertices.foreach_set("co", positions.ravel())
        data.loops.add(count * sides)
        data.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
        data.polygons.add(count)
        data.polygons.foreach_set("loop_start", np.arange(0, count * sides, sides, dtype=np.int32))
        data.update(calc_edges=True)
    else:
        data.from_pydata(positions.tolist(), [], [list(map(int, f)) for f in faces])
    if smooth:
        data.shade_smooth()
    for m in materials:
        data.materials.append(m)
    if material_index is not None:
        data.polygons.foreach_set("material_index", np.asarray(material_index, np.int32))
    if uv is not None:
        uv = np.asarray(uv, np.float32)
        corners = np.empty(len(data.loops), np.int32)
        data.loops.foreach_get("vertex_index", corners)
        layer = data.uv_layers.new(name="UVMap")
        layer.uv.foreach_set("vector", (uv[corners] if len(uv) == len(positions) else uv).ravel())
    data.validate()
    return data


def point_mesh(name, positions, **attributes) -> bpy.types.Mesh:
    """A mesh of vertices with point attributes: (N,) int, (N,) float or (N, 3) float."""
    data = bpy.data.meshes.new(name)
    positions = np.asarray(positions, np.float32)
    data.vertices.add(len(positions))
    data.vertices.foreach_set("co", positions.ravel())
    for key, values in attributes.items():
        values = np.asarray(values)
        kind = "INT" if values.dtype.kind in "iu" else "FLOAT" if values.ndim == 1 else "FLOAT_VECTOR"
        stored = data.attributes.new(key, kind, "POINT")
        stored.data.foreach_set("vector" if values.ndim == 2 else "value", values.ravel())
    return data


def grid_faces(rows: int, columns: int, wrap: bool = False) -> np.ndarray:
    """Quads between rows x columns points, row by row; wrap joins the last column to the first."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns if wrap else columns - 1), indexing="ij")
    i, j = i.ravel(), j.ravel()
    k = (j + 1) % columns
    return np.stack([i * columns + j, i * columns + k, (i + 1) * columns + k, (i + 1) * columns + j], 1)


def smooth_profile(points, steps: int = 6) -> np.ndarray:
    """A Catmull-Rom curve through (r, z) points; a point given twice is a corner."""
    p = np.asarray(points, float)
    result = [p[:1]]
    for a, b in zip(range(len(p) - 1), range(1, len(p)), strict=True):
        if np.allclose(p[a], p[b]):
            continue
        before = p[a - 1] if a > 0 else p[a]
        after = p[b + 1] if b + 1 < len(p) else p[b]
        t = (np.arange(1, steps + 1) / steps)[:, None]
        m0, m1 = (p[b] - before) / 2, (after - p[a]) / 2
        result.append(
            (2 * t**3 - 3 * t**2 + 1) * p[a]
            + (t**3 - 2 * t**2 + t) * m0
            + (3 * t**2 - 2 * t**3) * p[b]
            + (t**3 - t**2) * m1
        )
    curve = np.concatenate(result)
    curve[:, 0] = np.maximum(curve[:, 0], 0)
    return curve


def lathe(name, profile, materials=(), segments=64, steps=4, shape=None, uv=False) -> bpy.types.Mesh:
    """A surface of revolution of (r, z) points from bottom to top; uv: with UVs around and along.

    Normals point to the right of the profile's direction (outward, going up). shape(positions) may bend it.
    """
    curve = smooth_profile(profile, steps)
    n = len(curve)
    angle = 2 * np.pi * np.arange(segments + 1) / segments
    r, z = curve[:, :1], curve[:, 1:]
    grid = np.stack([r * np.cos(angle), r * np.sin(angle), z + 0 * angle], -1)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    u, v = np.meshgrid(np.arange(segments + 1) / segments, along / along[-1])
    uv_grid = np.stack([u, v], -1)
    # the seam's points are shared, so that shading is smooth across it; UVs are per corner
    faces = grid_faces(n, segments, wrap=True)
    corner = grid_faces(n, segments + 1)
    corner_uv = uv_grid.reshape(-1, 2)[corner]
    points = grid[:, :segments].reshape(-1, 3)
    if shape is not None:
        points = shape(points)
    data = mesh(name, points, faces, materials, corner_uv.reshape(-1, 2) if uv else None)
    # poles: points on the axis become one
    b = bmesh.new()
    b.from_mesh(data)
    bmesh.ops.remove_doubles(b, verts=b.verts, dist=1e-6)
    b.to_mesh(data)
    b.free()
    return data


# Materials


def _snake(socket) -> str:
    return socket.name.lower().replace(" ", "_")


class Nodes:
    """A material's or world's node tree, built by calls."""

    def __init__(self, owner):
        owner.use_nodes = True
        self.tree = owner.node_tree
        self.tree.nodes.clear()

    def __call__(self, kind: str, *inputs, **values):
        """A node "ShaderNode" + kind. Positional inputs by number, keywords by socket name or node property.

        A value that is a socket is linked, else set; a node stands for its first output.
        """
        node = self.tree.nodes.new("ShaderNode" + kind)
        for key in values.keys() - {_snake(s) for s in node.inputs}:
            setattr(node, key, values[key])
        for i, value in enumerate(inputs):
            self._set(node.inputs[i], value)
        sockets = {_snake(s): s for s in reversed(node.inputs) if s.enabled}
        for key in values.keys() & sockets.keys():
            self._set(sockets[key], values[key])
        return node

    def _set(self, socket, value) -> None:
        if value is None:
            return
        if isinstance(value, bpy.types.Node):
            value = next(s for s in value.outputs if s.enabled)
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(socket, value)
            return
        if hasattr(socket.default_value, "__len__"):
            value = (value,) * len(socket.default_value) if np.isscalar(value) else tuple(value)
            if len(value) == 3 and len(socket.default_value) == 4:
                value = (*value, 1.0)
        socket.default_value = value

    def ramp(self, factor, *stops, interpolation="LINEAR"):
        """A colour ramp of (position, colour) stops."""
        node = self("ValToRGB", factor)
        ramp = node.color_ramp
        ramp.interpolation = interpolation
        while len(ramp.elements) < len(stops):
            ramp.elements.new(1.0)
        for element, (position, color) in zip(ramp.elements, stops, strict=True):
            element.position, element.color = position, (*color, 1.0)
        return node.outputs["Color"]

    def math(self, operation, a, b=0.0, c=0.0):
        return self("Math", a, b, c, operation=operation).outputs[0]

    def mix(self, factor, a, b, blend="MIX"):
        """Two colours mixed."""
        node = self("Mix", data_type="RGBA", blend_type=blend)
        self._set(node.inputs["Factor"], factor)
        for socket, value in ((node.inputs[6], a), (node.inputs[7], b)):
            self._set(socket, value)
        return node.outputs[2]

    def surface(self, shader, output="OutputMaterial") -> None:
        self(output, surface=shader)


def material(name: str, build=None, **principled) -> bpy.types.Material:
    """A Principled material; build(nodes) may return inputs for it, or a shader to use instead."""
    m = bpy.data.materials.new(name)
    n = Nodes(m)
    more = build(n) if build is not None else {}
    shader = more if not isinstance(more, dict) else n("BsdfPrincipled", **(principled | more))
    n.surface(shader)
    return m


def image(name: str, pixels: np.ndarray, quality: int = 90) -> bpy.types.Image:
    """A packed sRGB JPEG of pixels (height, width, 3) in 0..1, display values, top row first."""
    import io

    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray((np.clip(pixels, 0, 1) * 255 + 0.5).astype(np.uint8)).save(
        buffer, "JPEG", quality=quality
    )
    result = bpy.data.images.new(name, pixels.shape[1], pixels.shape[0])
    result.pack(data=buffer.getvalue(), data_len=len(buffer.getvalue()))
    result.source = "FILE"
    return result
