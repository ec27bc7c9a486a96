"""The README's picture: a small still life, rendered with F12 in Blender's window, PointMR's settings beside it."""

import os
import sys
from math import radians

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
import bpy
import steps


def material(name, **inputs):
    new = bpy.data.materials.new(name)
    new.use_nodes = True
    bsdf = new.node_tree.nodes["Principled BSDF"]
    for key, value in inputs.items():
        bsdf.inputs[key.replace("_", " ")].default_value = value
    return new


def add(kind, mat, smooth=True, **where):
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**where)
    ob = bpy.context.object
    ob.data.materials.append(mat)
    if smooth:
        bpy.ops.object.shade_smooth()
    return ob


def area(location, rotation, size, power, color):
    bpy.ops.object.light_add(type="AREA", location=location, rotation=[radians(a) for a in rotation])
    light = bpy.context.object.data
    light.size, light.energy, light.color = size, power, color


def still_life():
    for ob in list(bpy.data.objects):
        if ob.type != "CAMERA":
            bpy.data.objects.remove(ob)
    ground = material("Ground", Roughness=0.35)
    checker = ground.node_tree.nodes.new("ShaderNodeTexChecker")
    checker.inputs["Scale"].default_value = 60
    checker.inputs["Color1"].default_value = (0.55, 0.5, 0.44, 1)
    checker.inputs["Color2"].default_value = (0.16, 0.15, 0.15, 1)
    links = ground.node_tree.links
    links.new(checker.outputs["Color"], ground.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    coordinates = ground.node_tree.nodes.new("ShaderNodeTexCoord")
    links.new(coordinates.outputs["UV"], checker.inputs["Vector"])
    add("plane", ground, smooth=False, size=30)
    glass = material(
        "Glass", Roughness=0.0, Transmission_Weight=1.0, IOR=1.5, Base_Color=(0.95, 1.0, 0.97, 1)
    )
    gold = material("Gold", Metallic=1.0, Roughness=0.18, Base_Color=(1.0, 0.72, 0.3, 1))
    red = material("Red", Base_Color=(0.7, 0.03, 0.03, 1), Roughness=0.25, Coat_Weight=1.0)
    blue = material("Blue", Base_Color=(0.05, 0.16, 0.55, 1), Roughness=0.5)
    monkey = add("monkey", red, location=(-0.1, 0.2, 0.87), rotation=(radians(-12), 0, radians(12)), size=2)
    monkey.modifiers.new("Smooth", "SUBSURF").render_levels = 2
    add("uv_sphere", glass, location=(1.65, -0.75, 0.7), radius=0.7, segments=96, ring_count=48)
    add(
        "torus", gold, location=(-1.75, -0.6, 0.26), major_radius=0.62, minor_radius=0.26,
        major_segments=96, minor_segments=48,
    )  # fmt: skip
    add("uv_sphere", blue, location=(-1.75, -0.6, 0.62), radius=0.42, segments=64, ring_count=32)
    add("cube", gold, smooth=False, location=(1.9, 1.5, 0.6), size=1.2, rotation=(0, 0, radians(30)))
    area((-4, -3, 5), (45, 0, -52), 2.5, 450, (1.0, 0.86, 0.7))
    area((4, 2, 4), (-48, 12, 20), 2.0, 250, (0.65, 0.8, 1.0))
    bpy.context.scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (
        0.09,
        0.11,
        0.15,
        1,
    )
    camera = bpy.context.scene.camera
    camera.location, camera.rotation_euler = (0.55, -6.6, 2.7), (radians(72.5), 0, radians(4.5))
    camera.data.lens = 46
    camera.data.dof.use_dof, camera.data.dof.focus_distance, camera.data.dof.aperture_fstop = True, 6.6, 2.8


def session():
    steps.register_addon()
    scene = bpy.context.scene
    scene.render.engine = "POINTMR"
    still_life()
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 1200, 780, 60
    scene.pointmr.method, scene.pointmr.samples = "DISTRIBUTED", 16
    scene.pointmr.sample_clamp_indirect = 4.0
    bpy.context.preferences.view.render_display_type = "AREA"
    steps.area_of("PROPERTIES").spaces.active.context = "RENDER"
    done = []
    bpy.app.handlers.render_complete.append(lambda *_: done.append(True))
    region = steps.region_of(steps.area_of("VIEW_3D"))
    steps.move(region.x + region.width / 2, region.y + 12)
    yield 1.0
    steps.key("F12")
    yield lambda: bool(done)
    yield 1.0
    editor = steps.area_of("IMAGE_EDITOR")
    with bpy.context.temp_override(area=editor, region=steps.region_of(editor)):
        bpy.ops.image.view_all(fit_view=True)
    yield 2.0
    steps.screenshot("picture")


steps.run(session)
