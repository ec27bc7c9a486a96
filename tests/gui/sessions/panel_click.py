"""Clicks in PointMR's panels change its properties; every tab draws without an error."""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
import bpy
import steps

TABS = ("RENDER", "OUTPUT", "VIEW_LAYER", "SCENE", "WORLD", "OBJECT", "DATA", "MATERIAL")


def session():
    steps.register_addon()
    steps.small_scene()
    area = steps.area_of("PROPERTIES")
    area.spaces.active.context = "RENDER"
    yield 1.0
    region = steps.region_of(area)
    before = bpy.context.scene.pointmr.method
    # Sampling is the first panel, and its first row the method.
    steps.click(region.x + region.width * 0.7, region.y + region.height - 120)
    yield 1.0
    steps.screenshot("method_menu")
    steps.key("c")
    yield 1.0
    steps.values["methods"] = [before, bpy.context.scene.pointmr.method]
    for active in ("Cube", "Light", "Camera"):
        bpy.context.view_layer.objects.active = bpy.data.objects[active]
        for tab in TABS:
            try:
                area.spaces.active.context = tab
            except TypeError:  # this object has no such tab
                continue
            area.tag_redraw()
            yield 0.3
            steps.screenshot(f"tab_{active}_{tab}")
    steps.values["light"] = bpy.data.lights["Light"].type


steps.run(session)
