"""Materials of nodes drawn at random: patterns, bump and normal maps, every BSDF, layers, displacement."""

from __future__ import annotations

from random import Random

import bpy
import numpy as np

from benchmarks.features.displacement import displace
from benchmarks.features.stage import image, material, node, tiles, tree_of

DEEPEST = 2  # mix and add shaders within each other


def color(dice: Random) -> tuple[float, float, float]:
    """Linear RGB, neither black nor white."""
    return tuple(dice.uniform(0.03, 0.9) for _ in range(3))


def shared(name: str, draw) -> bpy.types.Image:
    """A picture that all image textures of a scene share, drawn at its first use."""
    return bpy.data.images.get(name) or image(name, draw())


def leaf() -> np.ndarray:
    """A leaf with a soft outline, and nothing about it: (64, 64, 4)."""
    y, x = np.mgrid[0:64, 0:64] / 32.0 - 1.0
    inside = np.clip(8.0 * (0.8 - np.hypot(x / (0.7 - 0.4 * y), y)), 0.0, 1.0)
    picture = np.stack([0.2 + 0.2 * x, 0.5 - 0.3 * np.abs(x), 0.1 + 0.1 * y, inside], -1)
    return np.clip(picture, 0.0, 1.0)


def pattern(tree, dice: Random) -> bpy.types.NodeSocket:
    """A value 0..1 that varies over the surface, at a scale from an object to far below a pixel."""
    coordinates = node(tree, "ShaderNodeTexCoord").outputs[dice.choice(["Object", "Generated", "UV"])]
    scale = dice.choice([1.5, 4.0, 15.0, 60.0])
    where = {
        "Vector": node(
            tree,
            "ShaderNodeMapping",
            {
                "Vector": coordinates,
                "Rotation": tuple(dice.uniform(-1, 1) for _ in range(3)),
                "Scale": (scale, scale * dice.choice([1, 2]), scale),
            },
        ).outputs[0]
    }
    kind = dice.choice(["Noise", "Voronoi", "Wave", "Checker", "Brick", "Magic", "Gradient", "Image"])
    if kind == "Image":
        extension = dice.choice(["REPEAT", "EXTEND", "CLIP"])
        shown = node(tree, "ShaderNodeTexImage", where, image=shared("Card", tiles), extension=extension)
        return shown.outputs[dice.choice(["Color", "Color", "Alpha"])]
    if kind != "Gradient":
        where["Scale"] = 1.0
    if kind == "Noise":
        where["Detail"] = dice.choice([0.0, 2.0, 4.0])
    if kind == "Wave":
        where["Distortion"] = dice.choice([0.0, 3.0])
    found = node(tree, f"ShaderNodeTex{kind}", where)
    if kind == "Voronoi":
        found.feature = dice.choice(["F1", "SMOOTH_F1", "DISTANCE_TO_EDGE"])
    return next(s for s in found.outputs if s.name in ("Fac", "Factor", "Distance") and s.enabled)


def of_the_object(tree, dice: Random) -> bpy.types.NodeSocket:
    """A value 0..1 of the object, of the way it is seen, or of its mesh."""
    kind = dice.choice(["random", "facing", "fresnel", "backside", "attribute"])
    if kind == "random":
        return node(tree, "ShaderNodeObjectInfo").outputs["Random"]
    if kind == "facing":
        return node(tree, "ShaderNodeLayerWeight", {"Blend": dice.uniform(0.2, 0.7)}).outputs["Facing"]
    if kind == "fresnel":
        return node(tree, "ShaderNodeFresnel", {"IOR": dice.uniform(1.2, 1.8)}).outputs[0]
    if kind == "backside":
        return node(tree, "ShaderNodeNewGeometry").outputs["Backfacing"]
    return node(tree, "ShaderNodeAttribute", attribute_name="shade").outputs["Fac"]


def shade(tree, dice: Random) -> bpy.types.NodeSocket:
    """A value 0..1 that varies by anything."""
    found = of_the_object(tree, dice) if dice.random() < 0.3 else pattern(tree, dice)
    if dice.random() < 0.2:
        operation = dice.choice(["POWER", "MULTIPLY", "PINGPONG", "GREATER_THAN"])
        found = node(
            tree, "ShaderNodeMath", {0: found, 1: dice.uniform(0.3, 0.9)}, operation=operation
        ).outputs[0]
    return found


def varied(tree, dice: Random) -> bpy.types.NodeSocket:
    """A colour that varies: a mix of two, or a ramp of three."""
    factor = shade(tree, dice)
    if dice.random() < 0.3:
        ramp = node(tree, "ShaderNodeValToRGB", {"Fac": factor})
        ramp.color_ramp.interpolation = dice.choice(["LINEAR", "CONSTANT", "EASE"])
        ramp.color_ramp.elements.new(0.5)
        for element in ramp.color_ramp.elements:
            element.color = (*color(dice), 1.0)
        return ramp.outputs["Color"]
    mix = node(tree, "ShaderNodeMix", {"Factor": factor}, data_type="RGBA")
    mix.inputs[6].default_value, mix.inputs[7].default_value = (*color(dice), 1.0), (*color(dice), 1.0)
    return mix.outputs[2]


def normal(tree, dice: Random) -> bpy.types.NodeSocket:
    """A bumped normal, or one of a map in tangent space."""
    if dice.random() < 0.3:
        strength = dice.uniform(0.1, 0.6)
        return node(tree, "ShaderNodeNormalMap", {"Color": varied(tree, dice), "Strength": strength}).outputs[
            0
        ]
    height = {"Height": pattern(tree, dice), "Strength": dice.uniform(0.1, 0.5), "Distance": 0.05}
    return node(tree, "ShaderNodeBump", height).outputs[0]


def principled(tree, dice: Random, base, roughness: float, extra: dict) -> bpy.types.NodeSocket:
    """A Principled BSDF with some of its layers."""
    inputs = {
        "Base Color": base,
        "Roughness": roughness,
        "Metallic": dice.choice([0.0, 0.0, 1.0, 0.5]),
        **extra,
    }
    if dice.random() < 0.2:
        inputs["Roughness"] = shade(tree, dice)
    if dice.random() < 0.25:
        inputs |= {"Coat Weight": dice.random(), "Coat Roughness": dice.choice([0.0, 0.1, 0.4])}
    if dice.random() < 0.2:
        inputs |= {"Transmission Weight": dice.choice([0.5, 1.0]), "IOR": dice.choice([1.1, 1.33, 1.5])}
    if dice.random() < 0.2:
        inputs["Sheen Weight"] = dice.random()
    if dice.random() < 0.3:
        kind = dice.choice(["even", "varied", "varied", "leaf"])
        inputs["Alpha"] = shade(tree, dice) if kind == "varied" else dice.random()
        if kind == "leaf":
            shown = node(tree, "ShaderNodeTexImage", image=shared("Leaf", leaf)).outputs
            inputs |= {"Base Color": shown["Color"], "Alpha": shown["Alpha"]}
    if dice.random() < 0.15:
        inputs |= {"Emission Strength": dice.random(), "Emission Color": color(dice)}
    if dice.random() < 0.2:
        inputs["Anisotropic"] = dice.random()
    if dice.random() < 0.15:
        inputs["Thin Film Thickness"] = dice.uniform(200, 600)
    return node(tree, "ShaderNodeBsdfPrincipled", inputs).outputs[0]


def shader(tree, dice: Random, depth: int = 0) -> bpy.types.NodeSocket:
    """Any shader; mixes and sums are at most DEEPEST deep."""
    base = varied(tree, dice) if dice.random() < 0.5 else color(dice)
    plain = ["principled"] * 5 + [
        "Diffuse",
        "Anisotropic",
        "Glass",
        "Refraction",
        "Translucent",
        "Transparent",
    ]
    plain += ["Sheen", "emission"]
    kind = dice.choice(plain + ["Mix", "Mix", "Add"] if depth < DEEPEST else plain)
    roughness = dice.choice([0.0, 0.1, 0.3, 0.6, 1.0])
    extra = {}
    if kind in ("principled", "Diffuse", "Anisotropic") and dice.random() < 0.3:
        extra["Normal"] = normal(tree, dice)
    if kind == "principled":
        return principled(tree, dice, base, roughness, extra)
    if kind == "emission":
        return node(tree, "ShaderNodeEmission", {"Color": base, "Strength": dice.uniform(0.2, 2)}).outputs[0]
    if kind in ("Mix", "Add"):
        both = shader(tree, dice, depth + 1), shader(tree, dice, depth + 1)
        if kind == "Add":
            return node(tree, "ShaderNodeAddShader", {0: both[0], 1: both[1]}).outputs[0]
        factor = shade(tree, dice) if dice.random() < 0.6 else dice.random()
        return node(tree, "ShaderNodeMixShader", {0: factor, 1: both[0], 2: both[1]}).outputs[0]
    inputs = {"Color": base, **extra}
    if kind in ("Diffuse", "Sheen", "Glass", "Refraction"):
        few = {"Diffuse": [0.0, 0.7], "Sheen": [0.2, 0.6], "Glass": [0.0, 0.0, 0.2], "Refraction": [0.0, 0.2]}
        inputs["Roughness"] = dice.choice(few[kind])
    if kind in ("Glass", "Refraction"):
        inputs["IOR"] = dice.choice([1.1, 1.33, 1.5])
    if kind == "Anisotropic":
        inputs |= {"Roughness": roughness, "Anisotropy": dice.choice([0.0, 0.0, 0.6])}
    return node(tree, f"ShaderNodeBsdf{kind}", inputs).outputs[0]


def materials(dice: Random) -> list[bpy.types.Material]:
    """Two to four materials, a fifth of them displaced."""
    found = []
    for k in range(dice.randint(2, 4)):
        found.append(material(f"Material {k}", lambda tree: shader(tree, dice)))
        if dice.random() < 0.2:
            height, scale = pattern(tree_of(found[-1]), dice), dice.uniform(0.05, 0.25)
            method = dice.choice(["DISPLACEMENT", "BOTH", "BUMP"])
            displace(found[-1], method, Height=height, Scale=scale, Midlevel=0.5)
    return found
