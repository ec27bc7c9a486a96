"""Nodes that compute: numbers, vectors and colours."""

from __future__ import annotations

from node_planes import Case, Tree

from node_cases.registry import CASES, EXACT, case, offset

MATH = (
    "ADD SUBTRACT MULTIPLY DIVIDE MULTIPLY_ADD POWER LOGARITHM SQRT INVERSE_SQRT ABSOLUTE EXPONENT MINIMUM MAXIMUM "
    "LESS_THAN GREATER_THAN SIGN COMPARE SMOOTH_MIN SMOOTH_MAX ROUND FLOOR CEIL TRUNC FRACT MODULO FLOORED_MODULO "
    "WRAP SNAP PINGPONG SINE COSINE TANGENT ARCSINE ARCCOSINE ARCTANGENT ARCTAN2 SINH COSH TANH RADIANS DEGREES"
).split()
VECTOR_MATH = (
    "ADD SUBTRACT MULTIPLY DIVIDE MULTIPLY_ADD CROSS_PRODUCT PROJECT REFLECT REFRACT FACEFORWARD DOT_PRODUCT "
    "DISTANCE LENGTH SCALE NORMALIZE ABSOLUTE POWER SIGN MINIMUM MAXIMUM FLOOR CEIL FRACTION MODULO WRAP SNAP SINE "
    "COSINE TANGENT"
).split()


def _math(operation: str) -> Case:
    def make(t: Tree):
        a = t.node("Math", {0: t.ramp(0), 1: 3.1, 2: -1.3}, operation="MULTIPLY_ADD").outputs[0]
        b = t.node("Math", {0: t.ramp(1), 1: 2.3, 2: -0.7}, operation="MULTIPLY_ADD").outputs[0]
        r = t.node("Math", {0: a, 1: b, 2: 0.37}, operation=operation).outputs[0]
        # a factor keeps steep functions inside the tolerance's meaning
        return t.node(
            "Math", {0: r, 1: 0.05 if operation in ("TANGENT", "DEGREES") else 1.0}, operation="MULTIPLY"
        ).outputs[0]

    return make


def _vector_math(operation: str) -> Case:
    def make(t: Tree):
        b = t.node("VectorRotate", {0: t.coordinates(), "Angle": 1.1}).outputs[0]
        inputs = {0: t.coordinates(), 1: b, 2: (0.3, -0.4, 0.2), 3: 0.7}
        if operation == "WRAP":
            inputs = {0: t.coordinates(), 1: (0.9, 0.8, 0.7), 2: (0.3, -0.4, 0.2)}
        node = t.node("VectorMath", inputs, operation=operation)
        scale = 0.01 if operation in ("DIVIDE", "TANGENT") else 0.2
        socket = node.outputs[0] if node.outputs[0].enabled else node.outputs[1]
        return offset(t, socket, scale)

    return make


for _operation in MATH:
    CASES[f"math {_operation}"] = (_math(_operation), 1e-4)
for _operation in VECTOR_MATH:
    CASES[f"vector math {_operation}"] = (_vector_math(_operation), 1e-4)


def _map_range(kind: str, vector: bool) -> Case:
    def make(t: Tree):
        if vector:
            node = t.node("MapRange", data_type="FLOAT_VECTOR", interpolation_type=kind)
            t.tree.links.new(t.coordinates(), node.inputs["Vector"])
            values = {"From_Min_FLOAT3": (0.2, 0.1, 0), "From_Max_FLOAT3": (0.9, 0.6, 1.1)}
            values |= {"To_Min_FLOAT3": (0, 1, 0.5), "To_Max_FLOAT3": (1, 0.2, 1.5)}
            for s in node.inputs:
                if s.identifier in values:
                    s.default_value = values[s.identifier]
            return node.outputs["Vector"]
        inputs = {0: t.ramp(), 1: 0.8, 2: 0.3, 3: 0.1, 4: 1.2}
        return t.node("MapRange", inputs, interpolation_type=kind).outputs[0]

    return make


for _kind in ("LINEAR", "STEPPED", "SMOOTHSTEP", "SMOOTHERSTEP"):
    CASES[f"map range {_kind}"] = (_map_range(_kind, False), EXACT)
    CASES[f"vector map range {_kind}"] = (_map_range(_kind, True), EXACT)


@case("clamp")
def _clamp(t: Tree):
    return t.node("Clamp", {0: t.ramp(), 1: 0.7, 2: 0.4}, clamp_type="RANGE").outputs[0]


def _mapping(kind: str) -> Case:
    def make(t: Tree):
        inputs = {0: t.coordinates(), "Location": (0.1, 0.2, 0.3), "Rotation": (0.4, -0.6, 0.8)}
        inputs["Scale"] = (1.5, 0.5, 2.0)
        return offset(t, t.node("Mapping", inputs, vector_type=kind).outputs[0])

    return make


for _kind in ("POINT", "TEXTURE", "VECTOR", "NORMAL"):
    CASES[f"mapping {_kind}"] = (_mapping(_kind), EXACT)


def _rotate(kind: str, invert: bool) -> Case:
    def make(t: Tree):
        inputs = {0: t.coordinates(), "Center": (0.2, 0.1, 0), "Axis": (0.3, 0.5, 0.9), "Angle": 0.8}
        if kind == "EULER_XYZ":
            inputs["Rotation"] = (0.3, 0.4, 0.5)
        return offset(t, t.node("VectorRotate", inputs, rotation_type=kind, invert=invert).outputs[0])

    return make


for _kind in ("AXIS_ANGLE", "X_AXIS", "Y_AXIS", "Z_AXIS", "EULER_XYZ"):
    CASES[f"vector rotate {_kind}"] = (_rotate(_kind, _kind == "EULER_XYZ"), EXACT)


def _transform(kind: str, source: str, target: str) -> Case:
    def make(t: Tree):
        node = t.node(
            "VectorTransform", {0: t.coordinates()}, vector_type=kind, convert_from=source, convert_to=target
        )
        return offset(t, node.outputs[0], 0.05)

    return make


for _kind in ("POINT", "VECTOR", "NORMAL"):
    for _source, _target in (
        ("WORLD", "OBJECT"),
        ("OBJECT", "WORLD"),
        ("WORLD", "CAMERA"),
        ("CAMERA", "OBJECT"),
    ):
        CASES[f"vector transform {_kind} {_source} {_target}"] = (_transform(_kind, _source, _target), 1e-4)


BLENDS = (
    "MIX DARKEN MULTIPLY BURN LIGHTEN SCREEN DODGE ADD OVERLAY SOFT_LIGHT LINEAR_LIGHT DIFFERENCE EXCLUSION SUBTRACT "
    "DIVIDE HUE SATURATION COLOR VALUE"
).split()


def _blend(blend: str) -> Case:
    def make(t: Tree):
        node = t.node("Mix", data_type="RGBA", blend_type=blend, clamp_result=blend == "LINEAR_LIGHT")
        other = t.node("HueSaturation", {"Hue": 0.8, "Saturation": 0.7, "Color": t.color()}).outputs[0]
        links = {"Factor_Float": t.ramp(1), "A_Color": t.color(), "B_Color": other}
        for s in node.inputs:
            if s.identifier in links:
                t.tree.links.new(links[s.identifier], s)
        return next(s for s in node.outputs if s.identifier == "Result_Color")

    return make


for _kind in BLENDS:
    CASES[f"mix {_kind}"] = (_blend(_kind), 1e-4)


@case("mix legacy")
def _mix_legacy(t: Tree):
    return t.node(
        "MixRGB", {0: t.ramp(), 1: t.color(), 2: (0.2, 0.5, 0.9, 1)}, blend_type="SCREEN", use_clamp=True
    ).outputs[0]


@case("mix vector non-uniform")
def _mix_vector(t: Tree):
    node = t.node("Mix", data_type="VECTOR", factor_mode="NON_UNIFORM")
    for s in node.inputs:
        if s.identifier in ("Factor_Vector", "A_Vector"):
            t.tree.links.new(t.coordinates(1.0 if s.identifier == "A_Vector" else 2.0), s)
        elif s.identifier == "B_Vector":
            s.default_value = (0.9, 0.1, 0.4)
    return next(s for s in node.outputs if s.identifier == "Result_Vector")


@case("mix float unclamped")
def _mix_float(t: Tree):
    node = t.node("Mix", {"A_Float": 0.3, "B_Float": 0.9}, data_type="FLOAT", clamp_factor=False)
    twice = t.node("Math", {0: t.ramp(), 1: 2.0}, operation="MULTIPLY").outputs[0]
    t.tree.links.new(twice, node.inputs[0])
    return node.outputs[0]


@case("hue saturation", 1e-4)
def _hue(t: Tree):
    return t.node(
        "HueSaturation", {"Hue": 0.7, "Saturation": 1.3, "Value": 0.8, "Fac": 0.7, "Color": t.color()}
    ).outputs[0]


@case("bright contrast")
def _bright(t: Tree):
    return t.node("BrightContrast", {0: t.color(), 1: 0.2, 2: 0.6}).outputs[0]


@case("gamma of nought", 1e-4)
def _gamma_of_nought(t: Tree):
    return t.node("Gamma", {0: (0.5, 0.0, 1.2, 1.0), 1: 0.0}).outputs[0]


@case("a value that is not shown", EXACT)
def _hidden(t: Tree):
    """Blender hides the vector's value, and Cycles reads it."""
    inputs = {"Vector": (-0.5, -1.4, -1.2), "Center": (-0.9, -1.2, 0.4), "Angle": t.ramp()}
    return offset(t, t.node("VectorRotate", inputs, rotation_type="X_AXIS").outputs[0])


@case("gamma", 1e-4)
def _gamma(t: Tree):
    return t.node("Gamma", {0: t.color(), 1: 2.2}).outputs[0]


@case("invert")
def _invert(t: Tree):
    return t.node("Invert", {0: 0.7, 1: t.color()}).outputs[0]


@case("rgb to bw")
def _bw(t: Tree):
    return t.node("RGBToBW", {0: t.color()}).outputs[0]


@case("color to float")
def _color_to_float(t: Tree):
    return t.node("Math", {0: t.color(), 1: 0.0}).outputs[0]


@case("vector to float")
def _vector_to_float(t: Tree):
    return t.node("Math", {0: t.coordinates(), 1: 0.0}).outputs[0]


for _mode in ("RGB", "HSV", "HSL"):

    def _separate(t: Tree, mode=_mode):
        s = t.node("SeparateColor", {0: t.color()}, mode=mode).outputs
        return t.node("CombineColor", {0: s[2], 1: s[0], 2: s[1]}).outputs[0]

    def _combine(t: Tree, mode=_mode):
        return t.node("CombineColor", {0: t.ramp(0), 1: t.ramp(1), 2: 0.4}, mode=mode).outputs[0]

    CASES[f"separate {_mode}"] = (_separate, 1e-4)
    CASES[f"combine {_mode}"] = (_combine, 1e-4)


@case("blackbody", 5e-3)
def _blackbody(t: Tree):
    kelvin = t.node("Math", {0: t.ramp(), 1: 12500.0, 2: 600.0}, operation="MULTIPLY_ADD").outputs[0]
    return t.node("Blackbody", {0: kelvin}).outputs[0]


@case("wavelength", 1e-3)
def _wavelength(t: Tree):
    nanometres = t.node("Math", {0: t.ramp(), 1: 500.0, 2: 350.0}, operation="MULTIPLY_ADD").outputs[0]
    return t.node("Wavelength", {0: nanometres}).outputs[0]


def _ramp(interpolation: str, mode: str = "RGB") -> Case:
    def make(t: Tree):
        node = t.node("ValToRGB", {0: t.ramp()})
        ramp = node.color_ramp
        ramp.color_mode, ramp.interpolation = mode, interpolation
        ramp.elements[0].position, ramp.elements[1].position = 0.2, 0.85
        ramp.elements[0].color = (0.9, 0.1, 0.1, 1)
        middle = ramp.elements.new(0.5)
        middle.color = (0.1, 0.8, 0.3, 0.5)
        return node.outputs[0]

    return make


for _kind in ("LINEAR", "CONSTANT", "EASE", "CARDINAL", "B_SPLINE"):
    CASES[f"color ramp {_kind}"] = (_ramp(_kind), EXACT)
CASES["color ramp HSV"] = (_ramp("LINEAR", "HSV"), EXACT)


@case("rgb curves")
def _rgb_curves(t: Tree):
    node = t.node("RGBCurve", {0: 0.9, 1: t.color()})
    node.mapping.curves[0].points.new(0.4, 0.7)
    node.mapping.curves[3].points.new(0.6, 0.4)
    node.mapping.update()
    return node.outputs[0]


@case("vector curves")
def _vector_curves(t: Tree):
    node = t.node("VectorCurve", {1: t.coordinates()})
    node.mapping.curves[1].points.new(0.4, 0.7)
    node.mapping.update()
    return offset(t, node.outputs[0])


@case("float curve")
def _float_curve(t: Tree):
    node = t.node("FloatCurve", {1: t.ramp()})
    node.mapping.curves[0].points.new(0.3, 0.8)
    node.mapping.update()
    return node.outputs[0]
