"""Materials and sky of the forest. All surfaces fade into the colour of the air with distance."""

from __future__ import annotations

import bpy
from forest_land import TREE_LINE
from parts import Nodes, material

HAZE = (0.46, 0.63, 0.90)


def hazed(n, shader):
    """A shader that fades into the air's colour with distance, less so high up."""
    distance = n("CameraData").outputs["View Distance"]
    z = n("SeparateXYZ", n("NewGeometry").outputs["Position"]).outputs["Z"]
    thin = n.math("EXPONENT", n.math("MULTIPLY", n.math("MAXIMUM", z, 0.0), -1 / 650))
    density = n.math("MULTIPLY", n.math("MULTIPLY_ADD", thin, 0.66, 0.34), -1 / 17000)
    through = n.math("EXPONENT", n.math("MULTIPLY", distance, density))
    return n("MixShader", through, n("Emission", HAZE, 0.86), shader)


def quiet(m):
    """Air is no lamp: its glow is seen, not sampled."""
    if hasattr(m, "cycles"):
        m.cycles.emission_sampling = "NONE"
    return m


def leaf(name, dark, light, shine):
    """A leaf: diffuse, with light coming through; every twig has a tone of its own."""

    def build(n):
        color = n.ramp(n("ObjectInfo").outputs["Random"], (0.0, dark), (1.0, light))
        through = n("BsdfTranslucent", n.mix(1.0, color, shine, "MULTIPLY"))
        return hazed(n, n("MixShader", 0.36, n("BsdfDiffuse", color), through))

    return quiet(material(name, build))


def bark(name, dark, light, scale=(9, 9, 1.5)):
    def build(n):
        at = n("Mapping", vector=n("TexCoord").outputs["Object"], scale=scale)
        tone = n("TexNoise", vector=at, scale=1.0, detail=4, roughness=0.7)
        return hazed(n, n("BsdfDiffuse", n.ramp(tone, (0.38, dark), (0.60, light))))

    return quiet(material(name, build))


def ground_material():
    def build(n):
        at = n("NewGeometry").outputs["Position"]
        wide = n("TexNoise", vector=at, scale=0.05, detail=5, roughness=0.6)
        fine = n("TexNoise", vector=at, scale=2.2, detail=5, roughness=0.7)
        tone = n.math("MULTIPLY_ADD", fine, 0.5, n.math("MULTIPLY", wide, 0.5))
        grass = n.ramp(
            tone, (0.34, (0.040, 0.030, 0.016)), (0.5, (0.055, 0.075, 0.018)), (0.66, (0.11, 0.12, 0.035))
        )
        crag = n(
            "TexNoise",
            vector=n("Mapping", vector=at, scale=(0.004, 0.004, 0.012)),
            scale=1,
            detail=8,
            roughness=0.65,
        )
        stone = n.ramp(crag, (0.36, (0.09, 0.085, 0.08)), (0.62, (0.27, 0.25, 0.23)))
        z = n("SeparateXYZ", at).outputs["Z"]
        steep = n("SeparateXYZ", n("NewGeometry").outputs["Normal"]).outputs["Z"]
        high = n("MapRange", n.math("MULTIPLY_ADD", crag, 500, z), TREE_LINE + 120, TREE_LINE + 320).outputs[
            0
        ]
        color = n.mix(high, grass, stone)
        snow_at = n(
            "MapRange", n.math("MULTIPLY_ADD", crag, 900, z), TREE_LINE + 700, TREE_LINE + 1000
        ).outputs[0]
        flat = n("MapRange", steep, 0.74, 0.86).outputs[0]
        color = n.mix(n.math("MULTIPLY", snow_at, flat), color, (0.82, 0.85, 0.90))
        relief = n.math("MULTIPLY_ADD", crag, n.math("MULTIPLY", high, 120), n.math("MULTIPLY", fine, 0.12))
        return hazed(n, n("BsdfDiffuse", color, normal=n("Bump", strength=0.9, distance=1.0, height=relief)))

    return quiet(material("Ground", build))


def rock_material():
    def build(n):
        at = n("TexCoord").outputs["Object"]
        grain = n("TexNoise", vector=at, scale=4, detail=7, roughness=0.7)
        moss = n("TexNoise", vector=at, scale=1.7, detail=4, roughness=0.6)
        stone = n.ramp(grain, (0.35, (0.075, 0.070, 0.065)), (0.62, (0.30, 0.285, 0.26)))
        up = n("SeparateXYZ", n("NewGeometry").outputs["Normal"]).outputs["Z"]
        mossy = n("MapRange", n.math("MULTIPLY_ADD", up, 0.28, moss), 0.66, 0.78).outputs[0]
        color = n.mix(mossy, stone, (0.075, 0.095, 0.020))
        return hazed(n, n("BsdfDiffuse", color, normal=n("Bump", strength=0.7, distance=0.06, height=grain)))

    return quiet(material("Rock", build))


def water_material():
    def build(n):
        at = n("NewGeometry").outputs["Position"]
        waves = n(
            "TexNoise",
            vector=n("Mapping", vector=at, scale=(0.05, 0.16, 0.1)),
            scale=1,
            detail=4,
            roughness=0.6,
        )
        bump = n("Bump", strength=0.10, distance=1.0, height=waves)
        water = n(
            "BsdfPrincipled",
            base_color=(0.010, 0.030, 0.034),
            roughness=0.03,
            ior=1.33,
            normal=bump,
            specular_ior_level=0.5,
        )
        return hazed(n, water)

    return quiet(material("Water", build))


def sky() -> bpy.types.World:
    """A gradient with clouds that flatten toward the horizon."""
    world = bpy.data.worlds.new("Sky")
    n = Nodes(world)
    d = n("TexCoord").outputs["Generated"]
    parts = n("SeparateXYZ", d)
    z = parts.outputs["Z"]
    blue = n.ramp(
        z,
        (0.0, (0.62, 0.75, 0.92)),
        (0.10, (0.36, 0.56, 0.90)),
        (0.30, (0.15, 0.33, 0.78)),
        (1.0, (0.06, 0.16, 0.5)),
    )
    over = n.math("ADD", n.math("MAXIMUM", z, 0.0), 0.09)
    plane = n(
        "CombineXYZ",
        n.math("DIVIDE", parts.outputs["X"], over),
        n.math("DIVIDE", parts.outputs["Y"], over),
        0.0,
    )
    puffs = n("TexNoise", vector=plane, scale=0.9, detail=7, roughness=0.58, distortion=0.25)
    cover = n("MapRange", puffs, 0.50, 0.62).outputs[0]
    fade = n("MapRange", z, 0.015, 0.16).outputs[0]
    white = n.ramp(puffs, (0.52, (0.95, 0.93, 0.90)), (0.78, (0.66, 0.70, 0.77)))
    color = n.mix(n.math("MULTIPLY", n.math("MULTIPLY", cover, fade), 0.9), blue, white)
    below = n.math("LESS_THAN", z, 0.0)
    n.surface(n("Background", n.mix(below, color, (0.20, 0.24, 0.22)), 0.95), "OutputWorld")
    return world
