"""Each kind of light, with the settings that change its shape, strength and colour."""

from __future__ import annotations

from math import pi, radians

import bpy
import numpy as np

from benchmarks.features.registry import feature
from benchmarks.features.stage import (
    BLUE,
    COPPER,
    CREAM,
    GREY,
    RED,
    camera,
    cove,
    cube,
    glow,
    image,
    lamp,
    link,
    matte,
    monkey,
    node,
    plane,
    principled,
    softbox,
    sphere,
    tiles,
    torus,
    tree_of,
    world,
)


def _group() -> None:
    """Three matte solids on a cove, seen from the usual place; no light yet."""
    cove()
    camera()
    sphere(matte(CREAM), (-1.35, 0.2, 0.9), 0.9)
    cube(matte(RED), (1.25, 0.1, 0.65), 1.3)
    torus(matte(BLUE), (0.05, -1.3, 0.22), 0.5, 0.2)


@feature()
def light_point_sharp():
    """Point light of radius 0: hard shadow edges, brightness P/(4 pi^2 r^2)."""
    _group()
    lamp("POINT", 500, (-2.2, -2.5, 3.6), shadow_soft_size=0.0)


@feature()
def light_point_soft():
    """Point light with a radius: shadows widen with distance; no soft falloff is visible at this distance."""
    _group()
    lamp("POINT", 500, (-2.2, -2.5, 3.2), shadow_soft_size=0.5)


@feature()
def light_point_near():
    """Sphere lights close to surfaces, with and without soft falloff."""
    _group()
    lamp("POINT", 60, (-0.3, -0.6, 0.9), shadow_soft_size=0.35, use_soft_falloff=True)
    lamp("POINT", 60, (2.6, -1.0, 0.9), shadow_soft_size=0.35, use_soft_falloff=False)


@feature()
def light_sun_sharp():
    """Sun without angular size."""
    _group()
    lamp("SUN", 2.5, (-3, -3, 5), angle=0.0)


@feature()
def light_sun_angle():
    """Sun of 15 degrees: penumbrae proportional to distance, irradiance in W/m^2."""
    _group()
    lamp("SUN", 2.5, (-3, -3, 5), angle=radians(15))


@feature()
def light_spot():
    """Sharp-edged spot of radius 0 that lights a disk of the floor."""
    _group()
    lamp("SPOT", 1200, (-2.0, -3.0, 5.0), spot_size=radians(40), spot_blend=0.0, shadow_soft_size=0.0)


@feature()
def light_spot_blend():
    """Spot with blend and radius: a soft rim, soft shadows; and a narrow scaled spot (an elliptic cone)."""
    _group()
    lamp("SPOT", 1200, (-2.0, -3.0, 5.0), spot_size=radians(50), spot_blend=0.6, shadow_soft_size=0.4)
    narrow = lamp(
        "SPOT", 500, (3.5, -2.0, 4.0), (1.5, 0, 0), (1, 0.6, 0.3), spot_size=radians(35), spot_blend=0.3
    )
    narrow.scale = (1.0, 1.0, 1.6)


@feature()
def light_area_square():
    """Square area light, L = P/(pi A)."""
    _group()
    lamp("AREA", 250, (-2.5, -2.5, 3.5), shape="SQUARE", size=1.4)


@feature()
def light_area_rectangle():
    """Long rectangular area light: penumbrae differ along and across it."""
    _group()
    lamp("AREA", 250, (-2.5, -2.5, 3.5), shape="RECTANGLE", size=3.5, size_y=0.3)


@feature()
def light_area_disk():
    """Disk area light."""
    _group()
    lamp("AREA", 250, (-2.5, -2.5, 3.5), shape="DISK", size=1.8)


@feature()
def light_area_ellipse():
    """Elliptic area light."""
    _group()
    lamp("AREA", 250, (-2.5, -2.5, 3.5), shape="ELLIPSE", size=3.0, size_y=0.6)


@feature()
def light_area_spread():
    """Area light narrowed by spread, beside one of the full half space: a pool of light with a soft rim."""
    _group()
    lamp("AREA", 120, (-1.5, -1.5, 4.0), (-1.0, 0, 0), shape="SQUARE", size=1.0, spread=radians(50))
    lamp("AREA", 60, (3.0, -1.5, 3.0), (1.2, 0, 0), (1, 0.7, 0.4), shape="DISK", size=0.8, spread=radians(15))


@feature()
def light_area_scaled():
    """Area lights under an object scale that is not uniform: their area, and so their radiance, follows."""
    _group()
    lamp("AREA", 250, (-2.5, -2.5, 3.5), shape="DISK", size=1.0).scale = (2.0, 0.7, 1.0)
    lamp("AREA", 100, (3.0, -2.0, 3.0), color=(1, 0.7, 0.4), shape="SQUARE", size=0.5).scale = (0.5, 2.5, 1.0)


@feature()
def light_visible():
    """Lamps seen by the camera and in a mirror: an area, a sphere and a spot light in the picture."""
    _group()
    world((0.02, 0.02, 0.03))
    sphere(principled(Base_Color=COPPER, Metallic=1.0, Roughness=0.05), (0.1, 1.6, 1.0), 1.0)
    lamp("AREA", 90, (-1.7, 0.9, 2.2), (0.5, -2.5, 0.5), shape="RECTANGLE", size=1.3, size_y=0.6)
    lamp("POINT", 120, (1.4, -0.8, 1.9), color=(1, 0.6, 0.3), shadow_soft_size=0.3)


@feature()
def light_world_uniform():
    """Uniform coloured world alone: ambient shadows."""
    _group()
    world((0.55, 0.65, 0.8), 1.2)


def _sky(sun: float) -> np.ndarray:
    """An equirectangular sky with a small sun of radiance `sun` left of the camera and a dark ground."""
    height, width = 64, 128
    elevation = (np.arange(height) + 0.5) / height * pi - pi / 2
    azimuth = (np.arange(width) + 0.5) / width * 2 * pi
    up = np.clip(np.sin(elevation), 0, 1)[:, None, None]
    pixels = np.where(up > 0, np.array([0.7, 0.75, 0.8]) * (1 - up) + np.array([0.15, 0.3, 0.7]) * up, 0.12)
    pixels = np.broadcast_to(pixels, (height, width, 3)).copy()
    distance = (elevation[:, None] - 0.75) ** 2 + (np.cos(0.75) * (azimuth[None, :] - 1.0)) ** 2
    pixels[distance < 0.012] = (sun, sun * 0.85, sun * 0.6)
    return pixels


def _environment(strength=1.0, rotation=0.0, sun=60.0) -> None:
    tree = tree_of(bpy.context.scene.world)
    tree.nodes.clear()
    coordinates = node(tree, "ShaderNodeTexCoord")
    turn = node(
        tree, "ShaderNodeMapping", {"Vector": coordinates.outputs["Generated"], "Rotation": (0, 0, rotation)}
    )
    picture = image("Sky", _sky(sun), "Linear Rec.709", True)
    sky = node(tree, "ShaderNodeTexEnvironment", {"Vector": turn.outputs[0]}, image=picture)
    background = node(tree, "ShaderNodeBackground", {"Color": sky.outputs[0], "Strength": strength})
    node(tree, "ShaderNodeOutputWorld", {"Surface": background.outputs[0]})


@feature()
def light_world_equirectangular():
    """HDR sky with a bright small sun, turned by a Mapping node; seen directly, in a mirror, and by its shadows."""
    _environment(0.8, rotation=1.1)
    plane(matte(GREY), (0, 0, 0), 200.0)
    camera(at=(0, -7.5, 2.0), target=(0, 0, 1.2), lens=38)
    sphere(principled(Base_Color=(0.9, 0.9, 0.9), Metallic=1.0, Roughness=0.03), (-1.35, 0.2, 1.0), 1.0)
    monkey(matte(CREAM), (1.3, 0.0, 0.95), 1.15)


@feature()
def light_world_mixed():
    """World seen by the camera differs from the world that lights (Light Path), as artists set it up."""
    _group()
    bpy.data.objects["Cove"].hide_render = True
    tree = tree_of(bpy.context.scene.world)
    tree.nodes.clear()
    path = node(tree, "ShaderNodeLightPath")
    lit = node(tree, "ShaderNodeBackground", {"Color": (0.9, 0.8, 0.6), "Strength": 1.0})
    seen = node(tree, "ShaderNodeBackground", {"Color": (0.05, 0.12, 0.3), "Strength": 1.0})
    mixed = node(
        tree, "ShaderNodeMixShader", {0: path.outputs["Is Camera Ray"], 1: lit.outputs[0], 2: seen.outputs[0]}
    )
    node(tree, "ShaderNodeOutputWorld", {"Surface": mixed.outputs[0]})


@feature()
def light_sky_texture():
    """Blender's sky texture as the only light."""
    plane(matte(GREY), (0, 0, 0), 200.0)
    camera(at=(0, -7.5, 2.0), target=(0, 0, 1.2), lens=38)
    sphere(matte(CREAM), (-1.35, 0.2, 0.9), 0.9)
    cube(matte(RED), (1.25, 0.1, 0.65), 1.3)
    tree = tree_of(bpy.context.scene.world)
    tree.nodes.clear()
    sky = node(tree, "ShaderNodeTexSky", sky_type="PREETHAM", sun_direction=(-0.5, -0.5, 0.7), turbidity=3.0)
    background = node(tree, "ShaderNodeBackground", {"Color": sky.outputs[0], "Strength": 0.3})
    node(tree, "ShaderNodeOutputWorld", {"Surface": background.outputs[0]})


@feature()
def light_sky_sun():
    """A sky's sun: sharp shadows, and highlights in rough and polished metal."""
    plane(matte(GREY), (0, 0, 0), 200.0)
    camera(at=(0, -7.5, 2.0), target=(0, 0, 1.2), lens=38)
    rough = principled("Rough", Base_Color=(0.9, 0.9, 0.9), Metallic=1.0, Roughness=0.3)
    polished = principled("Polished", Base_Color=(0.9, 0.9, 0.9), Metallic=1.0, Roughness=0.1)
    sphere(rough, (-1.35, 0.2, 0.9), 0.9)
    sphere(polished, (-0.3, -1.6, 0.4), 0.4)
    cube(matte(RED), (1.25, 0.1, 0.65), 1.3)
    tree = tree_of(bpy.context.scene.world)
    tree.nodes.clear()
    sky = node(tree, "ShaderNodeTexSky", sun_elevation=0.6, sun_rotation=2.4, sun_size=0.02)
    background = node(tree, "ShaderNodeBackground", {"Color": sky.outputs[0], "Strength": 0.05})
    node(tree, "ShaderNodeOutputWorld", {"Surface": background.outputs[0]})


@feature()
def light_nodes_varying():
    """Nodes of lamps: a slide in a spot, and a photometric web over the wall."""
    _group()
    spot = lamp(
        "SPOT", 900, (-2.6, -3.0, 3.6), (0.2, 0.1, 0.4), spot_size=0.7, spot_blend=0.1, shadow_soft_size=0.02
    )
    tree = _emission_of(spot)
    slide = node(tree, "ShaderNodeTexImage", image=image("slide", tiles()))
    tree.links.new(slide.outputs[0], tree.nodes["Emission"].inputs["Color"])
    wall = lamp("POINT", 60, (1.8, 1.2, 2.6), shadow_soft_size=0.05)
    tree = _emission_of(wall)
    web = node(tree, "ShaderNodeTexIES", mode="INTERNAL", ies=bpy.data.texts.new("web"))
    web.ies.write(_photometric_web())
    tree.links.new(web.outputs[0], tree.nodes["Emission"].inputs["Strength"])


@feature()
def light_falloff():
    """An area light that does not fall off with the distance."""
    _group()
    tree = _emission_of(lamp("AREA", 30, (2.6, -2.6, 3.2), (0, 0, 0.5), size=1.0))
    falloff = node(tree, "ShaderNodeLightFalloff", {"Strength": 1.0})
    tree.links.new(falloff.outputs["Constant"], tree.nodes["Emission"].inputs["Strength"])


def _emission_of(item):
    """The node tree of a lamp, an Emission node alone."""
    item.data.use_nodes = True
    tree = item.data.node_tree
    tree.nodes.clear()
    emission = node(tree, "ShaderNodeEmission", {"Strength": 1.0})
    node(tree, "ShaderNodeOutputLight", {"Surface": emission.outputs[0]})
    return tree


def _photometric_web() -> str:
    """An IES file of two beams, downwards and upwards."""
    angles = np.arange(0, 181, 10)
    candela = 900.0 * np.abs(np.cos(np.radians(angles))) ** 12 + 20.0
    head = f"IESNA:LM-63-1995\nTILT=NONE\n1 1000 1 {len(angles)} 1 1 2 0 0 0\n1 1 100\n"
    return head + " ".join(map(str, angles)) + "\n0\n" + " ".join(f"{c:.1f}" for c in candela) + "\n"


@feature()
def light_seen():
    """Lamps that the camera sees: a panel and a ball before a floor and before the world."""
    world((0.1, 0.13, 0.2))
    camera(at=(0, -7.5, 2.0), target=(0, 0, 1.6), lens=38)
    plane(matte(GREY), (0, 0, 0), 9.0)
    sphere(matte(CREAM), (-1.35, 0.2, 0.9), 0.9)
    lamp(
        "AREA", 120, (0.6, 1.0, 1.8), (0, -3, 0.8), shape="RECTANGLE", size=1.6, size_y=0.9
    ).visible_camera = True
    lamp("POINT", 60, (-0.2, -0.6, 3.3), shadow_soft_size=0.35).visible_camera = True


@feature()
def light_emissive_mesh():
    """Emissive meshes as the only light: a panel that shines to both sides and a glowing ring."""
    cove()
    camera()
    sphere(matte(CREAM), (-1.35, 0.2, 0.9), 0.9)
    cube(matte(RED), (1.25, 0.1, 0.65), 1.3)
    plane(glow((1.0, 0.9, 0.75), 12.0), (-1.9, -2.2, 3.0), 1.6, (0.7, -0.5, 0))
    torus(glow((0.3, 0.6, 1.0), 4.0), (0.1, -1.3, 0.2), 0.5, 0.08)


@feature()
def light_emissive_instances():
    """One emissive mesh used by several scaled objects, one of them mirrored."""
    cove()
    camera()
    sphere(matte(CREAM), (-1.35, 0.2, 0.9), 0.9)
    cube(matte(RED), (1.25, 0.1, 0.65), 1.3)
    panel = plane(glow((1.0, 0.9, 0.75), 10.0), (-1.9, -2.2, 3.0), 1.3, (0.7, -0.5, 0))
    for at, scale in (((2.9, -1.2, 2.0), (0.7, 1.6, 1)), ((0.2, 2.0, 2.6), (-2.5, 0.3, 1))):
        other = link(bpy.data.objects.new("Panel", panel.data))
        other.location, other.scale, other.rotation_euler = at, scale, (0.5, -0.6, 0.2)


@feature()
def light_temperature():
    """Colour temperature and exposure of lamps: a warm one at left, a cold one at right."""
    _group()
    warm, _ = [
        lamp(
            "AREA",
            30,
            (side * 3.0, -2.5, 3.2),
            size=1.0,
            use_temperature=True,
            temperature=kelvin,
            exposure=2.0,
        )
        for side, kelvin in ((-1, 2700.0), (1, 9500.0))
    ]
    warm.data.exposure = 2.5


@feature()
def light_not_normalized():
    """Lamps whose power does not follow their size (normalisation off): area, point, sun and spot."""
    _group()
    lamp("AREA", 12, (-3.0, -2.5, 3.2), size=1.6, normalize=False)
    lamp("POINT", 30, (2.8, -2.0, 2.4), color=(1, 0.6, 0.3), shadow_soft_size=0.4, normalize=False)
    lamp("SUN", 6, (1, -3, 5), color=(0.4, 0.6, 1.0), angle=radians(25), normalize=False)


@feature()
def light_no_shadow():
    """A lamp that casts no shadow beside one that does."""
    _group()
    lamp("AREA", 150, (-3.0, -2.5, 3.2), size=0.8)
    lamp("POINT", 150, (2.8, -2.0, 3.0), color=(1, 0.6, 0.3), shadow_soft_size=0.0, use_shadow=False)


@feature()
def light_nodes():
    """A lamp whose colour and strength come from its node tree: an emission node, tinted."""
    _group()
    item = lamp("AREA", 40, (-2.5, -2.5, 3.5), size=1.2)
    tree = tree_of(item.data)
    tree.nodes.clear()
    emission = node(tree, "ShaderNodeEmission", {"Color": (1.0, 0.55, 0.25), "Strength": 6.0})
    node(tree, "ShaderNodeOutputLight", {"Surface": emission.outputs[0]})


@feature()
def light_many():
    """Two dozen coloured point lights: the choice among them must lose none."""
    _group()
    generator = np.random.default_rng(4)
    for _ in range(24):
        x, y = generator.uniform(-3.5, 3.5), generator.uniform(-2.5, 2.5)
        hue = generator.uniform(0.2, 1.0, 3)
        at, tint = (x, y, generator.uniform(1.0, 3.0)), tuple(hue / hue.max())
        lamp("POINT", 30, at, color=tint, shadow_soft_size=0.1)


@feature()
def light_glossy_visibility():
    """Lamps that rays of some kinds do not see: one without specular reflection, one hidden from the camera."""
    _group()
    sphere(principled(Base_Color=(0.02, 0.02, 0.02), Roughness=0.15), (0.1, 1.6, 1.0), 1.0)
    softbox(200)
    hidden = lamp("AREA", 80, (2.4, 0.6, 2.4), (0.0, 1.2, 0.8), (1, 0.6, 0.3), size=0.9)
    hidden.visible_camera = False
    dull = lamp("AREA", 80, (0.2, -2.0, 4.0), (0, 0.5, 0.5), (0.4, 0.6, 1.0), size=1.2)
    dull.visible_glossy = False
