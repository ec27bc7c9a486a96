"""What PointMR's instancers place, shown in the viewport as boxes."""

from __future__ import annotations

import bpy
import numpy as np

from ..sync import instancer_points
from ..sync.report import Watch
from ..sync.transforms import compose, matrix

MAX_BOXES = 5000  # of one instancer; of more, an even choice is drawn
COLOR = (0.9, 0.55, 0.15, 0.7)
EDGES = ((0, 1), (1, 3), (3, 2), (2, 0), (4, 5), (5, 7), (7, 6), (6, 4), (0, 4), (1, 5), (2, 6), (3, 7))

_handler = None
_lines: dict[int, np.ndarray] = {}  # line ends by view layer, kept until something changes


def corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The eight corners of a box, (8, 3)."""
    return np.array([[(low, high)[i >> a & 1][a] for a in range(3)] for i in range(8)])


def geometry_set(ob):
    try:
        return ob.evaluated_geometry()
    except (
        AttributeError,
        RuntimeError,
        TypeError,
    ):  # an old Blender, or a kind of object that has no geometry
        return None


class BoundsOf:
    """Boxes of collections and of what they instance, each computed once. All in (2, 3) float64, None for nothing."""

    def __init__(self, depsgraph):
        self.depsgraph = depsgraph
        self._boxes: dict[int, np.ndarray | None] = {}

    def collection(self, collection) -> np.ndarray | None:
        """The box of a collection's objects, relative to its instance offset."""
        key = collection.as_pointer()
        if key not in self._boxes:
            self._boxes[key] = None  # ends cycles
            boxes = []
            for ob in collection.all_objects:
                ob = ob.evaluated_get(self.depsgraph)
                world = matrix(ob.matrix_world)
                boxes += [moved(b, world[None, :3]) for b in self.parts(ob)]
            box = union(boxes)
            self._boxes[key] = None if box is None else box - np.array(collection.instance_offset)
        return self._boxes[key]

    def parts(self, ob) -> list[np.ndarray]:
        """Boxes in an object's space: of itself, and of what it instances."""
        result = []
        shown = ob.type in {"CURVE", "SURFACE", "FONT", "META", "CURVES", "POINTCLOUD", "VOLUME"}
        if shown or (ob.type == "MESH" and len(ob.data.polygons)):
            box = np.array([c[:] for c in ob.bound_box])
            result.append(np.stack([box.min(0), box.max(0)]))
        if ob.instance_type == "COLLECTION" and ob.instance_collection is not None:
            box = self.collection(ob.instance_collection)
            result += [] if box is None else [box]
        placed = self.instances(ob)
        if placed is not None:
            result.append(moved(*placed))
        return result

    def instances(self, ob):
        """(box, object_from_instance (N, 3, 4)) of a PointMR instancer, None for an object that is none."""
        settings = ob.pointmr
        if settings.instance_collection is None:
            return None
        box = self.collection(settings.instance_collection)
        if box is None:
            return None
        if settings.instance_on == "ORIGIN":
            return box, np.eye(4)[None, :3]
        points = instancer_points.point_transforms(ob, geometry_set, Watch(None))
        if points is None:
            return None
        if points[1] is not None and settings.reset_children:
            # a child by itself: a box around the origin that holds any of them
            half = np.maximum(box[1] - box[0], 0) / 2
            box = np.stack([-half, half])
        return box, points[0]


def moved(box: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """The box around a box's placements (N, 3, 4)."""
    points = transforms[:, :, :3] @ corners(*box).T + transforms[:, :, 3:]
    return np.stack([points.min((0, 2)), points.max((0, 2))])


def union(boxes: list[np.ndarray]) -> np.ndarray | None:
    """The box around boxes."""
    if not boxes:
        return None
    return np.stack([np.min([b[0] for b in boxes], 0), np.max([b[1] for b in boxes], 0)])


def box_lines(depsgraph, objects) -> np.ndarray:
    """Line ends (2 E, 3) float32 of the boxes of these PointMR instancers' instances, in world space."""
    bounds = BoundsOf(depsgraph)
    lines = [np.empty((0, 3))]
    edges = np.array(EDGES).ravel()
    for ob in objects:
        ob = ob.evaluated_get(depsgraph)
        placed = bounds.instances(ob)
        if placed is None:
            continue
        box, at = placed
        at = at[:: -(-len(at) // MAX_BOXES)]
        world = compose(matrix(ob.matrix_world), at)
        ends = world[:, :, :3] @ corners(*box).T + world[:, :, 3:]  # (N, 3, 8)
        lines.append(ends.transpose(0, 2, 1)[:, edges].reshape(-1, 3))
    return np.concatenate(lines).astype(np.float32)


def _shown_lines(context) -> np.ndarray:
    """Line ends of all boxes in the view layer."""
    layer = context.view_layer
    key = layer.as_pointer()
    if key not in _lines:
        shown = [
            ob
            for ob in layer.objects
            if ob.pointmr.instance_collection is not None
            and ob.pointmr.show_bounds
            and ob.visible_get(view_layer=layer)
        ]
        _lines[key] = box_lines(context.evaluated_depsgraph_get(), shown)
    return _lines[key]


def _draw() -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    context = bpy.context
    if not context.space_data.overlay.show_overlays:
        return
    lines = _shown_lines(context)
    if not len(lines):
        return
    # a batch kept between draws would outlive the GPU when Blender quits
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    batch = batch_for_shader(shader, "LINES", {"pos": lines})
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.blend_set("ALPHA")
    shader.uniform_float("color", COLOR)
    batch.draw(shader)
    gpu.state.blend_set("NONE")
    gpu.state.depth_test_set("NONE")


@bpy.app.handlers.persistent
def _changed(*_) -> None:
    _lines.clear()


def register() -> None:
    """Draw from now on; nothing in background mode, which has no window."""
    global _handler
    if bpy.app.background or _handler is not None:
        return
    _handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")
    bpy.app.handlers.depsgraph_update_post.append(_changed)
    bpy.app.handlers.load_post.append(_changed)
    bpy.app.handlers.frame_change_post.append(_changed)


def unregister() -> None:
    global _handler
    if _handler is None:
        return
    bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
    for handlers in (
        bpy.app.handlers.depsgraph_update_post,
        bpy.app.handlers.load_post,
        bpy.app.handlers.frame_change_post,
    ):
        handlers.remove(_changed)
    _handler = None
    _changed()
