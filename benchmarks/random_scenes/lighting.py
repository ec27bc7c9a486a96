"""Lamps, emissive panels, world, camera and film drawn at random."""

from __future__ import annotations

from math import pi
from random import Random

import bpy

from benchmarks.features import stage
from benchmarks.random_scenes.shaders import color

LAMPS = ("POINT", "SUN", "SPOT", "AREA")


def lamp(dice: Random) -> None:
    """A lamp above the scene, sharp or wide."""
    kind = dice.choice(LAMPS)
    power = dice.uniform(1, 4) if kind == "SUN" else dice.uniform(100, 600) * (2 if kind == "SPOT" else 1)
    at = (dice.uniform(-4, 4), dice.uniform(-4, 3), dice.uniform(3, 6))
    tint = tuple(dice.uniform(0.5, 1) for _ in range(3))
    data = {}
    if kind == "SUN":
        data["angle"] = dice.choice([0.0, 0.01, 0.2])
    elif kind != "AREA":
        data["shadow_soft_size"] = dice.choice([0.0, 0.1, 0.5])
    if kind == "SPOT":
        data |= {"spot_size": dice.uniform(0.5, 1.5), "spot_blend": dice.random()}
    if kind == "AREA":
        data |= {"shape": dice.choice(["SQUARE", "RECTANGLE", "DISK", "ELLIPSE"])}
        data |= {
            "size": dice.uniform(0.5, 2),
            "size_y": dice.uniform(0.5, 2),
            "spread": dice.choice([pi, pi, 1]),
        }
    stage.lamp(kind, power, at, (0, 0.5, 0.5), tint, **data)


def lamps(dice: Random) -> None:
    """One to three lamps, seldom a dozen; sometimes a shining panel."""
    for _ in range(12 if dice.random() < 0.1 else dice.randint(1, 3)):
        lamp(dice)
    if dice.random() < 0.15:
        panel = stage.glow(color(dice), dice.uniform(2, 10))
        at = (dice.uniform(-3, 3), dice.uniform(0, 3), dice.uniform(2, 4))
        stage.plane(panel, at, dice.uniform(0.5, 2), (dice.uniform(-1, 1), dice.uniform(-1, 1), 0))


def world(dice: Random) -> None:
    """Even, a sky, or a gradient from left to right."""
    kind = dice.choice(["even", "even", "sky", "gradient"])
    if kind == "even":
        stage.world(tuple(dice.uniform(0, 0.4) for _ in range(3)))
        return
    tree = stage.tree_of(bpy.context.scene.world)
    tree.nodes.clear()
    if kind == "sky":
        shine = {"Color": stage.node(tree, "ShaderNodeTexSky", sky_type="HOSEK_WILKIE").outputs[0]}
        shine["Strength"] = 0.15
    else:
        way = stage.node(tree, "ShaderNodeTexCoord").outputs["Generated"]
        factor = stage.node(tree, "ShaderNodeTexGradient", {"Vector": way}).outputs["Fac"]
        mix = stage.node(tree, "ShaderNodeMix", {"Factor": factor}, data_type="RGBA")
        mix.inputs[6].default_value, mix.inputs[7].default_value = (0.1, 0.1, 0.1, 1), (*color(dice), 1)
        shine = {"Color": mix.outputs[2], "Strength": 0.7}
    background = stage.node(tree, "ShaderNodeBackground", shine)
    stage.node(tree, "ShaderNodeOutputWorld", {"Surface": background.outputs[0]})


def camera(dice: Random) -> None:
    """A camera that sees most of the scene, and its film."""
    at = (dice.uniform(-3, 3), dice.uniform(-8, -5), dice.uniform(1, 4))
    data = stage.camera(at, (0, 0.5, 0.6), dice.uniform(28, 60)).data
    if dice.random() < 0.2:
        data.dof.use_dof, data.dof.focus_distance = True, dice.uniform(5, 8)
        data.dof.aperture_fstop = dice.choice([0.3, 1.0])
    if dice.random() < 0.15:
        data.type, data.ortho_scale = "ORTHO", 6
    if dice.random() < 0.15:
        data.shift_x = 0.1
    bpy.context.scene.render.film_transparent = dice.random() < 0.2
