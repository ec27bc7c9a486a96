"""The material preview in the Properties editor is rendered by PointMR."""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
import bpy
import steps


def session():
    steps.register_addon()
    steps.small_scene()
    previews = []
    from blender_addon import engine

    render = engine.PointMRRender._render_layer

    def watched(self, scene, settings, layer):
        render(self, scene, settings, layer)
        previews.append([self.is_preview, settings.width, settings.height, settings.samples])

    engine.PointMRRender._render_layer = watched
    area = steps.area_of("PROPERTIES")
    area.spaces.active.context = "MATERIAL"
    yield 1.0
    region = steps.region_of(area)
    region_before = steps.region_pixels(region)
    steps.screenshot("material_tab")
    # The preview panel is closed at first, above the surface panel: open it by its header.
    steps.values["panel"] = hasattr(bpy.types, "MATERIAL_PT_preview")
    steps.click(region.x + region.width * 0.3, region.y + region.height - 175)
    yield lambda: any(width > 100 for _, width, *_ in previews)
    yield 2.0
    steps.screenshot("preview")
    steps.values["previews"] = previews
    steps.values["changed"] = bool((steps.region_pixels(region) != region_before).any())


steps.run(session)
