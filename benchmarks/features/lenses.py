"""Cameras: shift, sensor fit, orthographic, thin lens, clipping."""

from __future__ import annotations

from math import radians

import bpy

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
    matte,
    monkey,
    node,
    softbox,
    sphere,
    tiles,
    torus,
    world,
)
from benchmarks.features.stage import material as make_material


def _avenue() -> None:
    """Solids at several distances on a tiled floor, so that scale and perspective show."""
    world((0.25, 0.28, 0.33))
    card = image("Tiles", tiles(64, 16))
    floor = make_material(
        "Floor",
        lambda t: node(
            t,
            "ShaderNodeBsdfDiffuse",
            {"Color": node(t, "ShaderNodeTexImage", image=card).outputs[0]},
        ).outputs[0],
    )
    from benchmarks.features.stage import plane

    plane(floor, (0, 6, 0), 24.0, uv_scale=3.0)
    for i, (color, solid) in enumerate(
        ((RED, sphere), (CREAM, cube), (BLUE, monkey), (GREEN, sphere), (SAND, cube))
    ):
        solid(matte(color), (-1.0 + 0.95 * i, -1.8 + 2.2 * i, 0.75))
        bpy.context.object.scale *= 0.75
    softbox(900, (-4, -4, 7), 2.5)


@feature()
def lens_shift_fit_vertical():
    """Perspective camera with shift and vertical sensor fit."""
    _avenue()
    camera(
        (0.5, -8, 1.6),
        (0.5, 0, 1.6),
        35,
        shift_x=0.12,
        shift_y=-0.1,
        sensor_fit="VERTICAL",
        sensor_height=20.0,
    )


@feature(size=(72, 120))
def lens_portrait_auto():
    """A picture higher than wide: automatic sensor fit follows the longer side."""
    _avenue()
    camera((1.2, -8, 3.0), (0.4, 0, 0.8), 40, shift_y=0.05)


@feature()
def lens_wide():
    """Very short focal length, fitted horizontally, rolled camera."""
    _avenue()
    item = camera((-1.2, -5.2, 1.7), (0.4, 0, 0.8), 14, sensor_fit="HORIZONTAL", sensor_width=30.0)
    item.rotation_euler.rotate_axis("Z", 0.2)


@feature()
def lens_pixel_aspect():
    """Pixels twice as wide as high."""
    _avenue()
    camera((0.5, -8, 2.2), (0.5, 0, 0.9), 40)
    render = bpy.context.scene.render
    render.pixel_aspect_x, render.pixel_aspect_y = 2.0, 1.0


@feature()
def lens_orthographic():
    """Orthographic camera with shift."""
    _avenue()
    camera((-5, -8, 6), (0.3, 1.0, 0.5), type="ORTHO", ortho_scale=8.0, shift_x=0.05)


@feature()
def lens_orthographic_dof():
    """Orthographic camera with depth of field."""
    _avenue()
    item = camera((-5, -8, 6), (0.3, 1.0, 0.5), type="ORTHO", ortho_scale=8.0)
    item.data.dof.use_dof = True
    item.data.dof.focus_distance, item.data.dof.aperture_fstop = 10.0, 2.0


@feature()
def lens_dof_round():
    """Thin lens with a round aperture, focused on an object."""
    _avenue()
    item = camera((0.6, -7, 1.8), (0.4, 0, 0.8), 50)
    item.data.dof.use_dof = True
    item.data.dof.focus_object = bpy.data.objects["Cube"]
    item.data.dof.aperture_fstop = 0.15


def _lamps_out_of_focus() -> None:
    """Small bright disks behind the focus: their blur shows the shape of the aperture."""
    world((0.08, 0.09, 0.12))
    cove((0.2, 0.2, 0.22), depth=14)
    sphere(matte(CREAM), (0, 0, 0.7), 0.7)
    softbox(150, (-2, -3, 3), 1.0)
    for i, color in enumerate(((1, 0.5, 0.2), (0.3, 0.7, 1), (1, 0.9, 0.6), (0.5, 1, 0.4))):
        sphere(glow(color, 9.0), (-3.3 + 2.2 * i, 9.0, 1.7 + 0.7 * (i % 2)), 0.28, segments=16)


@feature()
def lens_dof_blades():
    """Thin lens with five blades, turned: highlights blur into pentagons."""
    _lamps_out_of_focus()
    item = camera((0, -6, 1.4), (0, 0, 1.2), 60)
    dof = item.data.dof
    dof.use_dof, dof.focus_distance, dof.aperture_fstop = True, 6.0, 0.35
    dof.aperture_blades, dof.aperture_rotation = 5, radians(20)


@feature()
def lens_dof_anamorphic():
    """Thin lens with an aperture ratio of 2 and six blades."""
    _lamps_out_of_focus()
    item = camera((0, -6, 1.4), (0, 0, 1.2), 60)
    dof = item.data.dof
    dof.use_dof, dof.focus_distance, dof.aperture_fstop = True, 6.0, 0.35
    dof.aperture_ratio, dof.aperture_blades = 2.0, 6


@feature()
def lens_clip():
    """Near and far clipping cut through the objects."""
    world((0.3, 0.32, 0.36))
    cove()
    torus(matte(RED), (-0.6, -1.5, 0.4))
    monkey(matte(CREAM), (0.8, 0.4, 0.9))
    softbox()
    camera(clip_start=6.6, clip_end=11.2)
