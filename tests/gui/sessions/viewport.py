"""The rendered viewport shows the scene, follows the view, its size and changes, and lives beside F12."""

import os
import sys
import time

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
import bpy
import numpy as np
import steps
from mathutils import Quaternion


def reddish(pixels):
    """Where pixels are red rather than grey: the cube, its shaded sides too."""
    p = pixels.astype(int)
    return (p[..., 0] > 30) & (p[..., 0] > 2 * p[..., 1]) & (p[..., 0] > 2 * p[..., 2])


def red(pixels) -> float:
    """The share of the pixels that show the cube."""
    return float(reddish(pixels).mean())


def middle_of_red(pixels):
    """The middle of the box around the cube, (x, y) from the upper left."""
    rows, columns = np.nonzero(reddish(pixels))
    return [float(v.min() + v.max()) / 2 for v in (columns, rows)] if len(rows) else None


def session():
    steps.register_addon()
    steps.small_scene((320, 240), samples=64)
    bpy.context.scene.pointmr.preview_samples = 8
    area = steps.area_of("VIEW_3D")
    region, space = steps.region_of(area), area.spaces.active
    space.overlay.show_overlays = False
    space.show_gizmo = False
    space.show_region_toolbar = space.show_region_header = space.show_region_tool_header = False
    # Solid mode in one red: where Blender itself draws the cube.
    shading = space.shading
    shading.light, shading.color_type, shading.single_color = "FLAT", "SINGLE", (0.8, 0.05, 0.02)
    bpy.ops.object.select_all(action="DESELECT")
    yield 1.5
    steps.screenshot("solid")
    solid = middle_of_red(steps.region_pixels(region))
    steps.values["solid_red"] = red(steps.region_pixels(region))
    shading.color_type = "MATERIAL"
    shading.single_color = (0.5, 0.5, 0.5)
    space.shading.type = "RENDERED"
    start = time.monotonic()
    yield lambda: red(steps.region_pixels(region)) > 0.005
    steps.values["seconds_to_first_image"] = time.monotonic() - start
    yield 3.0
    steps.screenshot("viewport")
    first = steps.region_pixels(region)
    steps.values["red"] = red(first)
    steps.values["rendered_middle"], steps.values["solid_middle"] = middle_of_red(first), solid

    # Orbit: the picture must follow, and the window must stay alive meanwhile.
    turns, longest = 8, 0.0
    for _ in range(turns):
        space.region_3d.view_rotation = space.region_3d.view_rotation @ Quaternion((0, 1, 0), 0.1)
        start = time.monotonic()
        yield 0.1
        longest = max(longest, time.monotonic() - start)
    steps.values["longest_pause_in_orbit"] = longest
    yield 3.0
    orbit = steps.region_pixels(region)
    steps.values["changed_by_orbit"] = float(np.abs(orbit.astype(int) - first).mean())

    # A change of the scene.
    bpy.data.objects["Cube"].scale = (2, 2, 2)
    yield 4.0
    steps.values["red_when_larger"] = red(steps.region_pixels(region))
    steps.screenshot("viewport_larger")

    # Through the camera, orthographic, and another size of the region.
    space.region_3d.view_perspective = "CAMERA"
    yield 3.0
    steps.screenshot("viewport_camera")
    steps.values["red_through_camera"] = red(steps.region_pixels(region))
    space.region_3d.view_perspective = "ORTHO"
    space.show_region_ui = True
    yield 3.0
    steps.screenshot("viewport_ortho")
    steps.values["red_orthographic"] = red(steps.region_pixels(steps.region_of(area)))

    # F12 while the viewport renders.
    done = []
    bpy.app.handlers.render_complete.append(lambda *_: done.append(True))
    bpy.context.scene.pointmr.preview_samples = 1024
    bpy.context.preferences.view.render_display_type = "NONE"
    yield 0.5
    bpy.ops.render.render("INVOKE_DEFAULT")
    yield lambda: bool(done)
    yield 1.0
    space.shading.type = "SOLID"
    yield 1.0
    space.shading.type = "RENDERED"
    yield 2.0
    steps.values["rendered_beside_viewport"] = True
    space.shading.type = "SOLID"
    yield 0.5


steps.run(session)
