"""The engine is in the render tab's menu, and choosing it there shows PointMR's panels."""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
import bpy
import steps


def session():
    steps.register_addon()
    area = steps.area_of("PROPERTIES")
    area.spaces.active.context = "RENDER"
    yield 0.5
    region = steps.region_of(area)
    # The engine's menu button is the second row of the tab.
    steps.click(region.x + region.width * 0.7, region.y + region.height - 55)
    yield 1.0
    steps.screenshot("engine_menu")
    steps.key("p")  # the underlined letter, or what starts the name
    yield 1.0
    steps.values["engine"] = bpy.context.scene.render.engine
    steps.screenshot("engine_panels")


steps.run(session)
