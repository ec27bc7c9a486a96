"""F12 renders with PointMR in a window; Esc in the middle of a long render ends it at once."""

import os
import sys
import time

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
import bpy
import steps

progress = {"init": 0, "complete": 0, "cancel": 0}


def watch():
    handlers = bpy.app.handlers
    handlers.render_init.append(lambda *_: progress.update(init=progress["init"] + 1))
    handlers.render_complete.append(lambda *_: progress.update(complete=progress["complete"] + 1))
    handlers.render_cancel.append(lambda *_: progress.update(cancel=progress["cancel"] + 1))


def session():
    steps.register_addon()
    steps.small_scene((480, 320), samples=16)
    watch()
    view = steps.area_of("VIEW_3D")
    region = steps.region_of(view)
    steps.move(region.x + region.width / 2, region.y + region.height / 2)
    yield 0.5
    steps.key("F12")
    yield lambda: progress["complete"] == 1
    yield 1.0
    steps.screenshot("f12")
    bpy.data.images["Render Result"].save_render(str(steps.SHARED / "f12_result.png"))

    # The render window takes the mouse and the keys from now on.
    bpy.context.scene.pointmr.samples = 1 << 20
    bpy.context.scene.render.resolution_x = 1920
    bpy.context.scene.render.resolution_y = 1080
    yield 0.5
    steps.key("F12")
    yield lambda: progress["init"] == 2
    yield 3.0
    steps.screenshot("rendering")
    start = time.monotonic()
    steps.key("Escape")
    yield lambda: progress["cancel"] == 1
    steps.values["seconds_to_cancel"] = time.monotonic() - start
    yield 1.0
    steps.screenshot("cancelled")
    steps.values["progress"] = progress


steps.run(session)
