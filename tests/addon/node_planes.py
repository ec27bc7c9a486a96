"""Node graphs shown by Cycles on a grid of tilted planes, and the same points evaluated by the engine's programs.

Each case is a function over a `Tree` that returns the socket to look at; its plane emits that colour. One small render
(a pixel filter so narrow that samples sit on pixel centres) shows all cases at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler, Matrix

from blender_addon.sync.derived import DERIVED, derived
from pointmr_engine.shading.points import RAY_CAMERA, SurfacePoints

PIXELS = 32  # per unit of the grid
WINDOW = 16  # pixels compared per case, in the middle of its plane
SIDE = 0.8  # of a plane
TILT = Euler((0.35, -0.3, 0.25))
STRETCH = (1.0, 0.9, 1.0)


class Tree:
    """A material's nodes, made briefly."""

    def __init__(self, tree) -> None:
        self.tree = tree

    def node(self, kind: str, inputs: dict | None = None, **properties):
        """A new node; inputs by index, name or identifier: constants or sockets."""
        node = self.tree.nodes.new("ShaderNode" + kind)
        for name, value in properties.items():
            setattr(node, name, value)
        for name, value in (inputs or {}).items():
            sockets = [s for s in node.inputs if s.identifier == name]
            socket = node.inputs[name] if isinstance(name, int) or not sockets else sockets[0]
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, socket)
            else:
                socket.default_value = value
        return node

    def coordinates(self, scale: float = 1.0):
        """A vector that varies in all three components over the plane."""
        uv = self.node("UVMap").outputs["UV"]
        inputs = {0: uv, "Location": (0.3, -0.2, 0.7), "Rotation": (0.5, 0.9, 0.3), "Scale": (scale,) * 3}
        return self.node("Mapping", inputs).outputs[0]

    def ramp(self, axis: int = 0):
        """A float that grows along u (0) or v (1) from 0 to 1."""
        uv = self.node("UVMap").outputs["UV"]
        return self.node("SeparateXYZ", {0: uv}).outputs[axis]

    def color(self):
        """Colours of many hues, some above 1."""
        u, v = self.ramp(0), self.ramp(1)
        red = self.node("Math", {0: u, 1: 1.4}, operation="MULTIPLY").outputs[0]
        blue = self.node("Math", {0: u, 1: v}, operation="MULTIPLY").outputs[0]
        return self.node("CombineColor", {0: red, 1: v, 2: blue}).outputs[0]


Case = Callable[[Tree], bpy.types.NodeSocket]


def _plane(name: str, x: float, y: float, z: float = 0.0):
    mesh = bpy.data.meshes.new(name)
    h = SIDE / 2
    mesh.from_pydata([(-h, -h, 0), (h, -h, 0), (h, h, 0), (-h, h, 0)], [], [(0, 1, 2, 3)])
    mesh.use_auto_texspace = False
    mesh.texspace_location, mesh.texspace_size = (0, 0, 0.3), (h, h, 1)
    uv = mesh.uv_layers.new(name="UVMap")
    uv.uv.foreach_set("vector", np.array([0, 0, 1, 0, 1, 1, 0, 1], np.float32))
    color = mesh.color_attributes.new("Col", "FLOAT_COLOR", "POINT")
    values = np.array([[1, 0, 0, 1], [0, 1, 0, 0.5], [0, 0, 1, 0.25], [1, 1, 0, 0]], np.float32)
    color.data.foreach_set("color", values.ravel())
    attribute = mesh.attributes.new("height", "FLOAT", "POINT")
    attribute.data.foreach_set("value", np.array([0, 1, 0.5, 0.25], np.float32))
    obj = bpy.data.objects.new(name, mesh)
    obj.matrix_world = Matrix.LocRotScale((x, y, z), TILT, STRETCH)
    obj.pass_index = 3
    obj.color = (0.2, 0.4, 0.6, 0.8)
    obj["tint"] = 0.625
    bpy.context.scene.collection.objects.link(obj)
    return obj


def build(cases: dict[str, Case]) -> dict[str, bpy.types.Object]:
    """A new scene with one plane per case, and the camera that sees them all."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    columns = int(np.ceil(np.sqrt(len(cases))))
    rows = -(-len(cases) // columns)
    objects = {}
    for i, (name, case) in enumerate(cases.items()):
        obj = _plane(name, i % columns + 0.5, i // columns + 0.5)
        material = bpy.data.materials.new(name)
        material.pass_index = 2
        tree = Tree(material.node_tree)
        material.node_tree.nodes.clear()
        obj.data.materials.append(material)
        objects[name] = obj
        socket = case(tree)
        output = tree.node("OutputMaterial")
        if socket.type == "SHADER":
            tree.tree.links.new(socket, output.inputs[0])
        else:
            emission = tree.node("Emission", {"Color": socket})
            tree.tree.links.new(emission.outputs[0], output.inputs[0])
    camera = bpy.data.cameras.new("camera")
    camera.type = "ORTHO"
    camera.ortho_scale = max(columns, rows)
    obj = bpy.data.objects.new("camera", camera)
    obj.location = (columns / 2, rows / 2, 5)
    scene.collection.objects.link(obj)
    scene.camera = obj
    scene.render.resolution_x, scene.render.resolution_y = columns * PIXELS, rows * PIXELS
    scene.render.resolution_percentage = 100
    return objects


def render(path: Path, samples: int = 1, bounces: int = 0) -> np.ndarray:
    """Cycles' picture of the current scene, as `written`."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = samples
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "GAUSSIAN"
    scene.cycles.filter_width = 0.01
    scene.cycles.max_bounces = bounces
    return written(path)


def written(path: Path) -> np.ndarray:
    """The picture of the current scene by its engine, (h, w, 3), bottom row first."""
    scene = bpy.context.scene
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.threads_mode = "FIXED"
    scene.render.threads = 2
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    values = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(image.size[1], image.size[0], image.channels)[..., :3]
    bpy.data.images.remove(image)
    return values


def window(picture: np.ndarray, index: int, count: int) -> np.ndarray:
    """(WINDOW, WINDOW, 3) of the picture: the middle of case number `index`'s plane."""
    columns = int(np.ceil(np.sqrt(count)))
    x0 = (index % columns) * PIXELS + (PIXELS - WINDOW) // 2
    y0 = (index // columns) * PIXELS + (PIXELS - WINDOW) // 2
    return picture[y0 : y0 + WINDOW, x0 : x0 + WINDOW]


def points_of(obj) -> SurfacePoints:
    """The surface points that the pixels of an object's window see."""
    start = (PIXELS - WINDOW) // 2
    t = (np.arange(WINDOW) + start + 0.5) / PIXELS - 0.5
    x, y = np.meshgrid(t + obj.location.x, t + obj.location.y)
    m = np.array(obj.matrix_world, np.float64)
    n = m[:3, 2] / np.linalg.norm(m[:3, 2])
    z = m[2, 3] - (n[0] * (x - m[0, 3]) + n[1] * (y - m[1, 3])) / n[2]
    return _points(obj, m, n, np.stack([x, y, z], -1).reshape(-1, 3))


def _of_mesh(name: str, mesh) -> tuple[float, ...]:
    """What is derived from a plane, of which all is alike, as the channels of an attribute."""
    positions = np.array([v.co for v in mesh.vertices], np.float32)
    value = float(derived(name, mesh, np.array([[0, 1, 2]], np.int32), positions).values[0, 0])
    return value, value, value, 1.0


def _points(obj, m: np.ndarray, n: np.ndarray, position: np.ndarray) -> SurfacePoints:
    count = len(position)
    local = (position - m[:3, 3]) @ np.linalg.inv(m[:3, :3]).T
    uv = (local[:, :2] / SIDE + 0.5).astype(np.float32)
    camera = np.array(bpy.context.scene.camera.matrix_world, np.float64)
    render = bpy.context.scene.render
    scale = bpy.context.scene.camera.data.ortho_scale
    side = max(render.resolution_x, render.resolution_y)
    seen = (position[:, :2] - camera[:2, 3]) / scale * side
    screen = seen / np.array([render.resolution_x, render.resolution_y]) + 0.5

    def rows(v: np.ndarray, dtype=np.float32) -> np.ndarray:
        return np.repeat(np.asarray(v, dtype)[None], count, axis=0)

    # the quad's two triangles, as Blender splits it
    lower = uv[:, 0] >= uv[:, 1]
    corners = np.array([[1, 0, 0, 1], [0, 1, 0, 0.5], [0, 0, 1, 0.25], [1, 1, 0, 0]], np.float32)
    heights = np.array([0, 1, 0.5, 0.25], np.float32)
    u, v = uv[:, :1], uv[:, 1:]
    below = np.concatenate([1 - u, u - v, v], 1)
    above = np.concatenate([1 - v, u, v - u], 1)
    weights = np.where(lower[:, None], below, above)
    which = np.where(lower[:, None], [[0, 1, 2]], [[0, 2, 3]])
    colors = (corners[which] * weights[..., None]).sum(1)
    height = (heights[which] * weights).sum(1)
    tangent = m[:3, 0] / np.linalg.norm(m[:3, 0])
    points = SurfacePoints(
        count,
        position=position,
        normal=rows(n),
        geometric_normal=rows(n),
        smooth_normal=rows(n),
        incoming=rows((0, 0, 1)),
        backfacing=np.zeros(count, np.bool_),
        generated=np.concatenate([uv, np.full((count, 1), 0.35, np.float32)], 1),
        local=local.astype(np.float32),
        world_from_part=rows(m[:3], np.float64),
        uvs={"": uv, "UVMap": uv},
        tangents=dict.fromkeys(("", "UVMap"), rows((*tangent, 1.0))),
        uv_footprints=dict.fromkeys(("", "UVMap"), np.zeros(count, np.float32)),
        attributes={
            "Col": colors.astype(np.float32),
            "": colors.astype(np.float32),
            "height": np.stack([height] * 3 + [np.ones_like(height)], 1).astype(np.float32),
            **{name: rows(_of_mesh(name, obj.data)) for name in DERIVED.values()},
        },
        instance_attributes={"tint": rows((0.625, 0.625, 0.625, 1.0))},
        footprint=np.full(count, 1 / PIXELS, np.float32),
        barycentric=np.stack([weights[:, 1], weights[:, 2]], 1).astype(np.float32),
        object_location=rows(m[:3, 3]),
        object_color=rows(tuple(obj.color)),
        object_index=np.full(count, obj.pass_index, np.int32),
        object_random=np.zeros(count, np.float32),
        ray_kind=np.full(count, RAY_CAMERA, np.uint8),
        # rays start on the near clipping plane
        ray_length=(camera[2, 3] - bpy.context.scene.camera.data.clip_start - position[:, 2]).astype(
            np.float32
        ),
        ray_depth=np.zeros(count, np.int32),
        diffuse_depth=np.zeros(count, np.int32),
        glossy_depth=np.zeros(count, np.int32),
        transmission_depth=np.zeros(count, np.int32),
        transparent_depth=np.zeros(count, np.int32),
        camera_from_world=np.diag([1.0, 1.0, -1.0]) @ np.linalg.inv(camera)[:3],
        window=screen.astype(np.float32),
    )
    return replace(
        points,
        moved=lambda offset, needs=None, narrower=None, bump=False: _points(obj, m, n, position + offset),
    )
