"""Which engine node stands for each of Blender's shader nodes, and how sockets and properties are named on either side.

Sockets are matched by identifier in lower case with underscores ("Base Color" is base_color), which has been stable
from 4.3 to 5.0 where names were not; a rule lists the exceptions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from .node_params import PARAMS


def snake(identifier: str) -> str:
    """A socket identifier as the engine writes it."""
    return identifier.lower().replace(" ", "_")


@dataclass(frozen=True)
class Rule:
    """kind: the engine's node; inputs: engine name of input identifiers, None leaves an input out; outputs alike."""

    kind: str
    inputs: dict[str, str | None] = field(default_factory=dict)
    outputs: dict[str, str] = field(default_factory=dict)
    params: Callable[[Any, Any], dict] | None = None
    warning: str | None = None

    def input_name(self, identifier: str) -> str | None:
        """The engine's name of an input, None for one it has no use for."""
        return self.inputs.get(identifier, snake(identifier))

    def output_name(self, identifier: str) -> str:
        """The engine's name of an output."""
        return self.outputs.get(identifier, snake(identifier))


_SECOND_SHADER = {"Shader_001": "shader_b"}
_RESULT = {"Result": "value"}
_PLAIN = {
    "BsdfDiffuse": "diffuse",
    "BsdfTransparent": "transparent",
    "BsdfTranslucent": "translucent",
    "BsdfRefraction": "refraction",
    "BsdfSheen": "sheen",
    "BsdfGlass": "glass",
    "SubsurfaceScattering": "subsurface",
    "Emission": "emission",
    "Background": "background",
    "Holdout": "holdout",
    "TexImage": "image_texture",
    "TexEnvironment": "environment_texture",
    "Mapping": "mapping",
    "TexCoord": "texture_coordinate",
    "UVMap": "uv_map",
    "Attribute": "attribute",
    "VertexColor": "color_attribute",
    "NewGeometry": "geometry",
    "ObjectInfo": "object_info",
    "CameraData": "camera_data",
    "LightPath": "light_path",
    "LayerWeight": "layer_weight",
    "Fresnel": "fresnel",
    "Tangent": "tangent",
    "Normal": "normal",
    "NormalMap": "normal_map",
    "Bump": "bump",
    "HueSaturation": "hue_saturation",
    "BrightContrast": "bright_contrast",
    "Gamma": "gamma",
    "Invert": "invert",
    "SeparateColor": "separate_color",
    "CombineColor": "combine_color",
    "SeparateXYZ": "separate_xyz",
    "CombineXYZ": "combine_xyz",
    "Blackbody": "blackbody",
    "Wavelength": "wavelength",
    "VectorRotate": "vector_rotate",
    "VectorTransform": "vector_transform",
    "Displacement": "displacement",
    "VectorDisplacement": "vector_displacement",
    "ValToRGB": "color_ramp",
    "RGBCurve": "rgb_curves",
    "VectorCurve": "vector_curves",
    "TexNoise": "noise_texture",
    "TexVoronoi": "voronoi_texture",
    "TexWhiteNoise": "white_noise_texture",
    "TexWave": "wave_texture",
    "TexMagic": "magic_texture",
    "TexBrick": "brick_texture",
    "TexChecker": "checker_texture",
    "TexGradient": "gradient_texture",
    "TexSky": "sky_texture",
    "LightFalloff": "light_falloff",
    "TexIES": "ies_texture",
    "AddShader": "add_shader",
    "MixShader": "mix_shader",
}
_SPECIAL = {
    "BsdfPrincipled": Rule("principled"),
    # Glossy is called Anisotropic inside Blender
    "BsdfAnisotropic": Rule("glossy"),
    "BsdfGlossy": Rule("glossy"),
    "BsdfToon": Rule("toon", {"Size": None, "Smooth": None}, warning="is shown as a diffuse BSDF"),
    "BsdfHair": Rule("hair", {"RoughnessU": "roughness"}, warning="is shown as a glossy BSDF"),
    "BsdfHairPrincipled": Rule("hair", warning="is shown as a glossy BSDF"),
    "EeveeSpecular": Rule("principled", {"Emissive Color": None}, warning="is shown as a Principled BSDF"),
    "AmbientOcclusion": Rule("ambient_occlusion", warning="gives 1: no occlusion is computed"),
    "Bevel": Rule(
        "identity_vector", {"Normal": "vector"}, {"Normal": "vector"}, warning="gives the normal unbevelled"
    ),
    "RGBToBW": Rule("rgb_to_bw", outputs={"Val": "value"}),
    "Clamp": Rule("clamp", outputs=_RESULT),
    "Math": Rule("math", {"Value_001": "value_b", "Value_002": "value_c"}),
    "VectorMath": Rule("vector_math", {"Vector_001": "vector_b", "Vector_002": "vector_c"}),
    "FloatCurve": Rule("float_curve", {"Factor": "fac"}),
    "MixRGB": Rule("mix_color", {"Color1": "a", "Color2": "b"}),
    "MixShader": Rule("mix_shader", _SECOND_SHADER),
    "AddShader": Rule("add_shader", _SECOND_SHADER),
    "BrightContrast": Rule("bright_contrast", {"Brightness": "bright"}),
    # before 4.0 these had nodes of their own
    "SeparateRGB": Rule("separate_color", {"Image": "color"}, {"R": "red", "G": "green", "B": "blue"}),
    "CombineRGB": Rule("combine_color", {"R": "red", "G": "green", "B": "blue"}, {"Image": "color"}),
}
RULES: dict[str, Rule] = {name: Rule(kind) for name, kind in _PLAIN.items()} | _SPECIAL

_MIX = {
    "FLOAT": Rule(
        "mix_float",
        {"Factor_Float": "fac", "A_Float": "a", "B_Float": "b"},
        {"Result_Float": "value"},
    ),
    "VECTOR": Rule(
        "mix_vector",
        {"Factor_Float": "fac", "Factor_Vector": "fac_vector", "A_Vector": "a", "B_Vector": "b"},
        {"Result_Vector": "vector"},
    ),
    "RGBA": Rule(
        "mix_color",
        {"Factor_Float": "fac", "A_Color": "a", "B_Color": "b"},
        {"Result_Color": "color"},
    ),
}
_MAP_RANGE = {
    "FLOAT": Rule("map_range", outputs=_RESULT),
    "FLOAT_VECTOR": Rule(
        "vector_map_range",
        {
            "From_Min_FLOAT3": "from_min",
            "From_Max_FLOAT3": "from_max",
            "To_Min_FLOAT3": "to_min",
            "To_Max_FLOAT3": "to_max",
            "Steps_FLOAT3": "steps",
            # the float version's sockets are there too, hidden
            **dict.fromkeys(("Value", "From Min", "From Max", "To Min", "To Max", "Steps")),
        },
    ),
}


def rule_of(node) -> Rule | None:
    """The rule for a bpy shader node, with its parameters' function; None where the engine has no such node."""
    name = node.bl_idname.removeprefix("ShaderNode")
    if name == "Mix":
        return _MIX.get(node.data_type)
    if name == "MapRange":
        return _MAP_RANGE.get(node.data_type)
    if name == "BsdfMetallic":
        return Rule("metallic")
    return RULES.get(name)


def params_of(node, context) -> dict:
    """The engine's fixed parameters of a node."""
    function = PARAMS.get(node.bl_idname.removeprefix("ShaderNode"))
    return {} if function is None else function(node, context)
