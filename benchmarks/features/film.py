"""Film and visibility: pixel filters, transparency, holdout, border, cut-outs, flags, normals."""

from __future__ import annotations

import bpy
import numpy as np

from benchmarks.features.registry import feature
from benchmarks.features.stage import (
    BLUE,
    CREAM,
    GREEN,
    RED,
    SAND,
    camera,
    cove,
    cube,
    glow,
    image,
    lamp,
    material,
    matte,
    monkey,
    node,
    plane,
    principled,
    softbox,
    sphere,
    studio,
    torus,
    world,
)


def _bars() -> None:
    """Thin bright bars on black, slightly turned: what a pixel filter does shows at once."""
    world((0.1, 0.1, 0.1))
    camera((0, -8, 0), (0, 0, 0))
    for i in range(7):
        bar = plane(
            glow((1, 0.9, 0.7) if i % 2 else (0.4, 0.7, 1), 1.0),
            (-2.4 + 0.8 * i, 0, 0),
            1.0,
            (1.5708, 0.12 * i, 0),
        )
        bar.scale = (0.05 + 0.02 * i, 4.0, 1.0)


@feature(size=(64, 48), pixel_filter_type="BOX", filter_width=1.5)
def film_filter_box():
    """Box filter: one pixel whatever the width says."""
    _bars()


@feature(size=(64, 48), pixel_filter_type="GAUSSIAN", filter_width=2.0)
def film_filter_gaussian():
    """Gaussian filter of width 2 (sigma a quarter of it)."""
    _bars()


@feature(size=(64, 48), pixel_filter_type="BLACKMAN_HARRIS", filter_width=1.5)
def film_filter_blackman_harris():
    """Blackman-Harris filter of the default width."""
    _bars()


@feature(size=(64, 48), pixel_filter_type="BLACKMAN_HARRIS", filter_width=4.0)
def film_filter_wide():
    """Blackman-Harris filter of width 4."""
    _bars()


@feature()
def film_transparent():
    """Transparent film: alpha of surfaces, of glass (opaque) and of half-transparent ones; the world still lights."""
    world((0.4, 0.45, 0.55))
    camera()
    softbox(300)
    sphere(principled(Base_Color=RED, Alpha=0.5), (-1.75, 0, 0.85), 0.8)
    monkey(matte(CREAM), (0.0, 0, 0.85), 0.8)
    sphere(principled(Transmission_Weight=1.0, Roughness=0.0), (1.75, 0, 0.85), 0.8)
    bpy.context.scene.render.film_transparent = True


@feature()
def film_holdout():
    """A holdout object cuts a hole into a transparent film, and a holdout shader into an opaque one."""
    studio(fill=0.3)
    bpy.context.scene.render.film_transparent = True
    sphere(matte(RED), (-1.2, 0.6, 0.9), 0.9)
    cube(matte(CREAM), (1.3, 0.5, 0.7), 1.3)
    torus(None, (-0.2, -1.0, 0.8), 0.7, 0.25).is_holdout = True
    plane(
        material("Hole", lambda t: node(t, "ShaderNodeHoldout").outputs[0]),
        (1.7, -0.8, 0.9),
        0.8,
        (1.3, 0, 0),
    )


@feature()
def film_border():
    """Render region without cropping: the rest stays empty."""
    studio(fill=0.3)
    monkey(matte(CREAM), (0, 0, 1.0), 1.4)
    render = bpy.context.scene.render
    render.use_border, render.use_crop_to_border = True, False
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.2, 0.7, 0.25, 0.85


@feature()
def film_border_crop():
    """Render region cropped to its size."""
    studio(fill=0.3)
    monkey(matte(CREAM), (0, 0, 1.0), 1.4)
    render = bpy.context.scene.render
    render.use_border, render.use_crop_to_border = True, True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.2, 0.8, 0.1, 0.9


@feature(film_exposure=1.8)
def film_exposure():
    """Film exposure multiplies the picture."""
    studio(fill=0.1, power=120)
    monkey(principled(Base_Color=BLUE, Roughness=0.3), (0, 0, 1.0), 1.4)


@feature()
def film_cutout_shadow():
    """Alpha cut-outs cast the shadow of their picture, through several layers."""
    studio(fill=0.1, power=0.1)
    y, x = np.mgrid[0:64, 0:64] / 63.0 * 2 - 1
    angle, radius = np.arctan2(y, x), np.hypot(x, y)
    star = (radius < 0.55 + 0.35 * np.cos(5 * angle)).astype(float)
    picture = image("Star", np.dstack([0.7 + 0 * x, 0.5 + 0 * x, 0.1 + 0 * x, star]))

    def surface(tree):
        texture = node(tree, "ShaderNodeTexImage", image=picture)
        inputs = {"Base Color": texture.outputs[0], "Alpha": texture.outputs["Alpha"]}
        return node(tree, "ShaderNodeBsdfPrincipled", inputs).outputs[0]

    paper = material("Star", surface)
    for i in range(3):
        plane(paper, (-1.9 + 1.7 * i, -0.6 + 0.4 * i, 1.2), 1.7, (1.2, 0.3 * i, 0.2))
    lamp("SUN", 3.0, (-3, -5, 6), angle=0.02)


@feature()
def film_visibility():
    """Objects hidden from the camera, from shadows and from reflections, and shadow-only ones."""
    studio(fill=0.3, key=3.5)
    sphere(principled(Base_Color=(0.9, 0.9, 0.9), Metallic=1.0, Roughness=0.05), (0, 1.4, 1.1), 1.1)
    unseen = cube(matte(RED), (-2.0, -0.3, 0.6), 1.1)
    unseen.visible_camera = False
    unshadowed = cube(matte(GREEN), (0.0, -1.2, 0.6), 0.9)
    unshadowed.visible_shadow = False
    unreflected = cube(matte(BLUE), (2.0, -0.3, 0.6), 1.1)
    unreflected.visible_glossy = False


@feature()
def film_visibility_light():
    """Objects that diffuse or transmission rays do not see, behind glass."""
    studio(fill=0.3, key=3.5)
    sphere(principled(Transmission_Weight=1.0, Roughness=0.0), (0, -0.6, 1.1), 1.0)
    cube(matte(RED), (-1.0, 1.6, 0.8), 1.2).visible_transmission = False
    panel = plane(glow((0.4, 0.7, 1.0), 6.0), (2.8, 0.4, 1.6), 1.4, (0, -1.2, 0))
    panel.visible_diffuse = False


@feature()
def film_normals():
    """Flat, smooth and split normals on coarse meshes."""
    studio(fill=0.2)
    sphere(matte(SAND), (-1.72, 0, 0.82), 0.82, smooth=False, segments=12)
    sphere(matte(SAND), (0, 0, 0.82), 0.82, smooth=True, segments=12)
    last = sphere(matte(SAND), (1.72, 0, 0.82), 0.82, smooth=True, segments=12)
    sharp = last.data.attributes.new("sharp_edge", "BOOLEAN", "EDGE")
    flags = np.array([abs(last.data.vertices[e.vertices[0]].co.z) < 0.3 for e in last.data.edges])
    sharp.data.foreach_set("value", flags)


@feature()
def film_many_layers():
    """More transparent layers than the bounces allow: what lies behind the last one is black."""
    studio(fill=0.3)
    sheet = material(
        "Sheet", lambda t: node(t, "ShaderNodeBsdfTransparent", {"Color": (0.9, 0.95, 1)}).outputs[0]
    )
    for i in range(12):
        plane(sheet, (-1.6 + 0.25 * i, -1.5 + 0.3 * i, 1.0), 1.6, (1.5708, 0, 0))
    cube(matte(RED), (1.0, 2.4, 0.8), 1.2)


@feature()
def film_material_slots():
    """Material slots per face, a slot on the object instead of the mesh, and an empty slot."""
    studio(fill=0.3)
    item = monkey(matte(RED), (-1.2, 0, 1.0), 1.1, levels=0)
    item.data.materials.append(matte(BLUE))
    for polygon in item.data.polygons:
        polygon.material_index = polygon.index % 2
    other = bpy.data.objects.new("Other", item.data)
    bpy.context.scene.collection.objects.link(other)
    other.location, other.rotation_euler = (1.3, 0, 1.0), (-0.35, 0, -0.4)
    other.scale = (1.0, 1.0, 1.0)
    other.material_slots[0].link = "OBJECT"
    other.material_slots[0].material = matte(GREEN)
    empty = cube(None, (0.1, -1.4, 0.3), 0.5)
    empty.data.materials.append(None)


@feature()
def film_shadow_terminator():
    """Coarse smooth spheres in grazing light: where it ends, with the usual shadow terminator offset and without."""
    cove()
    camera()
    sphere(matte(CREAM), (-1.2, 0, 1.0), 1.0, segments=16)
    item = sphere(matte(CREAM), (1.2, 0, 1.0), 1.0, segments=16)
    item.shadow_terminator_geometry_offset = 0.0
    lamp("SUN", 3.0, (-5, -1.0, 1.5), (0, 0, 0.6), angle=0.0)


@feature()
def film_shadow_catcher():
    """A shadow catcher: on an opaque film it shows the world behind it, with the shadow that falls on it."""
    world((0.3, 0.35, 0.45))
    camera()
    softbox(300)
    plane(matte(SAND), (0, 0, 0), 14.0).is_shadow_catcher = True
    monkey(matte(RED), (0, 0, 0.9), 1.1)


@feature()
def film_shadow_catcher_transparent():
    """On a transparent film a catcher is its shadows' opacity; a lamp that is not its own outshines them."""
    world((0.3, 0.35, 0.45))
    camera()
    softbox(300)
    bpy.context.scene.render.film_transparent = True
    plane(matte(SAND), (0, 0, 0), 14.0).is_shadow_catcher = True
    monkey(matte(RED), (0, 0, 0.9), 1.1)
    lamp("POINT", 60.0, (2.5, -1.5, 2.0), (0, 0, 0), shadow_soft_size=0.1).is_shadow_catcher = False
    wall = plane(matte(BLUE), (-2.5, 0.5, 0.0), 1.5)
    wall.is_shadow_catcher, wall.rotation_euler = True, (0.0, 1.2, 0.3)
