"""Procedural textures."""

from __future__ import annotations

import bpy
from node_planes import Case, Tree

from node_cases.registry import CASES, EXACT, LOOSE, case, offset


def _noise(dimensions: str, kind: str, normalize: bool, output: int) -> Case:
    def make(t: Tree):
        inputs = {
            0: t.coordinates(),
            "W": t.ramp(),
            "Scale": 4.0,
            "Detail": 2.6,
            "Roughness": 0.6,
            "Lacunarity": 2.1,
        }
        inputs |= {"Distortion": 0.4} | (
            {"Offset": 0.3, "Gain": 1.2} if "FRACTAL" in kind or "TERRAIN" in kind else {}
        )
        node = t.node("TexNoise", noise_dimensions=dimensions, noise_type=kind)
        if hasattr(node, "normalize"):
            node.normalize = normalize
        for name, value in inputs.items():
            s = next((s for s in node.inputs if s.identifier == name), None)
            if s is None:
                continue
            if isinstance(value, bpy.types.NodeSocket):
                t.tree.links.new(value, s)
            else:
                s.default_value = value
        return offset(t, node.outputs[output])

    return make


for _d in ("1D", "2D", "3D", "4D"):
    CASES[f"noise {_d} color"] = (_noise(_d, "FBM", True, 1), LOOSE)
    CASES[f"noise {_d} value"] = (_noise(_d, "FBM", False, 0), LOOSE)
for _kind in ("MULTIFRACTAL", "HYBRID_MULTIFRACTAL", "RIDGED_MULTIFRACTAL", "HETERO_TERRAIN"):
    CASES[f"noise {_kind}"] = (_noise("3D", _kind, False, 0), LOOSE)
    CASES[f"noise 2D {_kind}"] = (_noise("2D", _kind, False, 0), LOOSE)


def _voronoi(
    dimensions: str, feature: str, metric: str, output: str, detail: float = 0.0, normalize: bool = False
) -> Case:
    def make(t: Tree):
        node = t.node(
            "TexVoronoi", voronoi_dimensions=dimensions, feature=feature, distance=metric, normalize=normalize
        )
        values = {
            "Vector": t.coordinates(),
            "W": t.ramp(),
            "Scale": 4.0,
            "Randomness": 0.8,
            "Smoothness": 0.6,
        }
        values |= {"Exponent": 1.7, "Detail": detail, "Roughness": 0.4, "Lacunarity": 1.9}
        for name, value in values.items():
            s = next((s for s in node.inputs if s.identifier == name), None)
            if s is None:
                continue
            if isinstance(value, bpy.types.NodeSocket):
                t.tree.links.new(value, s)
            else:
                s.default_value = value
        return offset(t, next(s for s in node.outputs if s.identifier == output))

    return make


for _d in ("1D", "2D", "3D", "4D"):
    for _feature in ("F1", "F2", "SMOOTH_F1"):
        CASES[f"voronoi {_d} {_feature} color"] = (_voronoi(_d, _feature, "EUCLIDEAN", "Color"), LOOSE)
        CASES[f"voronoi {_d} {_feature} distance"] = (
            _voronoi(_d, _feature, "EUCLIDEAN", "Distance", 2.4, True),
            LOOSE,
        )
    CASES[f"voronoi {_d} edge"] = (
        _voronoi(_d, "DISTANCE_TO_EDGE", "EUCLIDEAN", "Distance", 1.5, True),
        LOOSE,
    )
    CASES[f"voronoi {_d} radius"] = (_voronoi(_d, "N_SPHERE_RADIUS", "EUCLIDEAN", "Radius"), LOOSE)
for _metric in ("MANHATTAN", "CHEBYCHEV", "MINKOWSKI"):
    CASES[f"voronoi {_metric}"] = (_voronoi("3D", "F1", _metric, "Distance"), LOOSE)
CASES["voronoi position"] = (_voronoi("3D", "F1", "EUCLIDEAN", "Position"), LOOSE)
CASES["voronoi w"] = (_voronoi("4D", "F2", "EUCLIDEAN", "W"), LOOSE)


def _white(dimensions: str) -> Case:
    def make(t: Tree):
        v = t.node("VectorMath", {0: t.coordinates(), 1: (0.25,) * 3}, operation="SNAP").outputs[0]
        w = t.node("Math", {0: t.ramp(), 1: 0.25}, operation="SNAP").outputs[0]
        node = t.node("TexWhiteNoise", noise_dimensions=dimensions)
        for s in node.inputs:
            t.tree.links.new(w if s.identifier == "W" else v, s)
        return node.outputs["Color"]

    return make


for _d in ("1D", "2D", "3D", "4D"):
    CASES[f"white noise {_d}"] = (_white(_d), EXACT)


@case("white noise of nothing")
def _white_noise_of_nothing(t: Tree):
    return t.node("TexWhiteNoise", noise_dimensions="3D").outputs[1]


for _kind in ("LINEAR", "QUADRATIC", "EASING", "DIAGONAL", "RADIAL", "SPHERICAL", "QUADRATIC_SPHERE"):
    CASES[f"gradient {_kind}"] = (
        lambda t, kind=_kind: t.node("TexGradient", {0: t.coordinates()}, gradient_type=kind).outputs[0],
        EXACT,
    )
for _depth in (0, 1, 2, 4, 7, 10):
    CASES[f"magic {_depth}"] = (
        lambda t, depth=_depth: offset(
            t, t.node("TexMagic", {0: t.coordinates(), 1: 2.0, 2: 1.5}, turbulence_depth=depth).outputs[0]
        ),
        LOOSE,
    )


def _wave(kind: str, direction: str, profile: str) -> Case:
    def make(t: Tree):
        node = t.node(
            "TexWave", {0: t.coordinates(), 1: 1.3, 2: 2.0, 3: 1.5}, wave_type=kind, wave_profile=profile
        )
        setattr(node, "bands_direction" if kind == "BANDS" else "rings_direction", direction)
        return node.outputs[0]

    return make


for _kind, _direction, _profile in (
    ("BANDS", "X", "SIN"),
    ("BANDS", "DIAGONAL", "TRI"),
    ("RINGS", "Y", "SIN"),
    ("RINGS", "SPHERICAL", "TRI"),
):
    CASES[f"wave {_kind} {_direction}"] = (_wave(_kind, _direction, _profile), 5e-3)


@case("checker")
def _checker(t: Tree):
    return t.node("TexChecker", {0: t.coordinates(), 1: t.color(), 3: 6.0}).outputs[0]


@case("brick", 1e-3)
def _brick(t: Tree):
    node = t.node("TexBrick", {0: t.coordinates(), 1: t.color(), 3: (0.9, 0.1, 0.4, 1), "Mortar Smooth": 0.5})
    node.inputs["Mortar Size"].default_value = 0.06
    node.squash, node.squash_frequency, node.offset_frequency = 0.7, 3, 2
    return node.outputs[0]
