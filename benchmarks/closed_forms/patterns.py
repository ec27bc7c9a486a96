"""Patterns as fine as pixels: a floor that glows by a sine of its place, seen straight on.

The pixel filter is a product, so it scales a wave of (u, v) radians a pixel by the product of its cosine transforms.
"""

from __future__ import annotations

import numpy as np

from benchmarks.closed_forms.stage import DARK, Case, View, filter_nodes, look_down, rectangle
from pointmr_engine import Group, Material, Scene
from pointmr_engine.scene.graph import Graph, Link, Node

HEIGHT = 1.5
ROLL = 0.3  # radians: so that waves lie across rows and columns
VIEW = View(32, 24, look_down(HEIGHT, roll=ROLL), 1.0)


def waves(wave_number: float) -> Material:
    """Glows by 1/2 + 1/2 sin(wave_number x)."""
    nodes = {
        "place": Node("geometry"),
        "axes": Node("separate_xyz", {"vector": Link("place", "position")}),
        "phase": Node("math", {"value": Link("axes", "x"), "value_b": wave_number}, {"operation": "MULTIPLY"}),
        "sine": Node("math", {"value": Link("phase", "value")}, {"operation": "SINE"}),
        "glow": Node(
            "math", {"value": Link("sine", "value"), "value_b": 0.5, "value_c": 0.5}, {"operation": "MULTIPLY_ADD"}
        ),
        "e": Node("emission", {"strength": Link("glow", "value")}),
    }  # fmt: skip
    material = Material("waves", Graph(nodes, surface=Link("e", "emission")))
    material.emission_sampling = "NONE"
    return material


def _case(pixels: float) -> Case:
    pixel = HEIGHT / (VIEW.width * VIEW.focal)  # metres
    k = 2.0 * np.pi / (pixels * pixel)

    def scene() -> Scene:
        floor = rectangle(-2.0, 2.0, -2.0, 2.0, 0.0, waves(k))
        return Scene(Group("root", [floor]), VIEW.camera(), [], DARK)

    def exact() -> np.ndarray:
        offsets, weights = filter_nodes(512)
        turns = 2.0 * np.pi / pixels * np.array([np.cos(ROLL), -np.sin(ROLL)])
        kept = np.prod([np.sum(weights * np.cos(t * offsets)) for t in turns])
        x, y = np.meshgrid(np.arange(VIEW.width) + 0.5, np.arange(VIEW.height) + 0.5)
        return 0.5 + 0.5 * kept * np.sin(k * VIEW.on_floor(x, y)[..., 0])

    return Case(f"waves of {pixels:g} pixels", f"a floor that glows in sine waves {pixels:g} pixels long", VIEW,
                scene, exact)  # fmt: skip


def cases() -> list[Case]:
    """Waves that a pixel filter of 1.5 pixels keeps much and little of."""
    return [_case(4.0), _case(2.5)]
