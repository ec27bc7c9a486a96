"""What is compared with Cycles, node by node: name -> (case, tolerance)."""

from __future__ import annotations

import bpy
import numpy as np
from node_planes import Case, Tree

EXACT = 2e-5  # of float32 arithmetic in another order
LOOSE = 2e-3
CASES: dict[str, tuple[Case, float]] = {}


def case(name: str, tolerance: float = EXACT):
    """Register a function over a Tree as a case."""

    def register(function: Case) -> Case:
        CASES[name] = (function, tolerance)
        return function

    return register


def offset(t: Tree, socket, scale: float = 0.2, shift: float = 0.5):
    """scale * vector + shift, so that signed values can be seen."""
    node = t.node("VectorMath", {0: socket, 1: (scale,) * 3, 2: (shift,) * 3}, operation="MULTIPLY_ADD")
    return node.outputs[0]


# ---- math
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


# ---- vectors
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


# ---- colours
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


# ---- procedural textures
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


# ---- images
def image(name: str, kind: str = "byte", alpha: bool = False) -> bpy.types.Image:
    """A small packed picture of smooth noise."""
    width, height = 24, 16
    rng = np.random.default_rng(7)
    values = rng.random((height, width, 4)).astype(np.float32)
    values[..., 3] = np.where(rng.random((height, width)) < 0.3, 0.4, 0.9) if alpha else 1.0
    found = bpy.data.images.new(name, width, height, alpha=alpha, float_buffer=kind == "float")
    found.pixels.foreach_set(values.ravel())
    found.update()
    found.pack()
    return found


def _image(
    projection: str = "FLAT", extension: str = "REPEAT", interpolation: str = "Linear", **options
) -> Case:
    def make(t: Tree):
        inputs = {0: t.coordinates(1.6)}
        node = t.node(
            "TexImage", inputs, projection=projection, extension=extension, interpolation=interpolation
        )
        node.projection_blend = options.get("blend", 0.0)
        name = f"{projection}{extension}{interpolation}{options}"
        node.image = image(name, options.get("kind", "byte"), options.get("alpha", False))
        if options.get("data"):
            node.image.colorspace_settings.name = "Non-Color"
        if options.get("mode"):
            node.image.alpha_mode = options["mode"]
        if options.get("use_alpha"):
            alpha = t.node("CombineXYZ", {0: node.outputs[1]}).outputs[0]
            return t.node("VectorMath", {0: node.outputs[0], 1: alpha}).outputs[0]
        return node.outputs[0]

    return make


for _extension in ("REPEAT", "EXTEND", "CLIP", "MIRROR"):
    CASES[f"image {_extension}"] = (_image(extension=_extension), 1e-4)
CASES["image closest"] = (_image(interpolation="Closest"), 1e-4)
for _extension in ("REPEAT", "EXTEND", "CLIP", "MIRROR"):
    CASES[f"image cubic {_extension}"] = (_image(extension=_extension, interpolation="Cubic"), 1e-4)
CASES["image smart"] = (_image(interpolation="Smart"), 1e-4)
CASES["image data"] = (_image(data=True), 1e-4)
CASES["image float"] = (_image(kind="float"), 1e-4)
CASES["image sphere"] = (_image("SPHERE"), 1e-3)
CASES["image tube"] = (_image("TUBE"), 1e-3)
CASES["image box"] = (_image("BOX"), 1e-4)
CASES["image box blend"] = (_image("BOX", blend=0.7), 1e-3)
for _mode in ("STRAIGHT", "CHANNEL_PACKED", "NONE"):
    CASES[f"image alpha {_mode}"] = (_image(alpha=True, mode=_mode), 6e-3)
    CASES[f"image alpha used {_mode}"] = (_image(alpha=True, mode=_mode, use_alpha=True), 6e-3)
CASES["image alpha float"] = (_image(alpha=True, kind="float", use_alpha=True), 1e-3)


@case("environment", 1e-3)
def _environment(t: Tree):
    node = t.node("TexEnvironment", {0: t.coordinates()})
    node.image = image("environment")
    return node.outputs[0]


@case("environment ball", 1e-3)
def _ball(t: Tree):
    node = t.node("TexEnvironment", {0: t.coordinates()}, projection="MIRROR_BALL")
    node.image = image("ball")
    return node.outputs[0]


# ---- what points know
for _output in ("Generated", "Normal", "UV", "Object", "Camera", "Window", "Reflection"):
    CASES[f"coordinates {_output}"] = (
        lambda t, output=_output: offset(t, t.node("TexCoord").outputs[output], 0.05),
        1e-4,
    )


@case("coordinates of an object", 1e-4)
def _object(t: Tree):
    empty = bpy.data.objects.new("empty", None)
    empty.location, empty.rotation_euler, empty.scale = (1, 2, 3), (0.2, 0.5, 0.9), (1.5, 1, 0.7)
    bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    return offset(t, t.node("TexCoord", object=empty).outputs["Object"], 0.05)


for _output in ("Position", "Normal", "Tangent", "True Normal", "Incoming", "Parametric", "Backfacing"):
    CASES[f"geometry {_output}"] = (
        lambda t, output=_output: offset(t, t.node("NewGeometry").outputs[output], 0.05),
        1e-4,
    )
for _output in ("Location", "Color", "Alpha", "Object Index", "Material Index"):
    CASES[f"object info {_output}"] = (
        lambda t, output=_output: offset(t, t.node("ObjectInfo").outputs[output], 0.05),
        1e-4,
    )
for _output in ("View Vector", "View Z Depth", "View Distance"):
    CASES[f"camera {_output}"] = (
        lambda t, output=_output: offset(t, t.node("CameraData").outputs[output], 0.05),
        1e-4,
    )
for _output in (
    "Is Camera Ray",
    "Is Shadow Ray",
    "Is Diffuse Ray",
    "Ray Length",
    "Ray Depth",
    "Transparent Depth",
):
    CASES[f"light path {_output}"] = (
        lambda t, output=_output: offset(t, t.node("LightPath").outputs[output], 0.05),
        1e-4,
    )
for _name, _kind, _output in (
    ("Col", "GEOMETRY", "Color"),
    ("Col", "GEOMETRY", "Fac"),
    ("Col", "GEOMETRY", "Alpha"),
    ("height", "GEOMETRY", "Fac"),
    ("tint", "OBJECT", "Fac"),
):

    def _attribute(t: Tree, name=_name, kind=_kind, output=_output):
        node = t.node("Attribute", attribute_name=name, attribute_type=kind)
        return next(s for s in node.outputs if s.identifier == output)

    CASES[f"attribute {_name} {_output}"] = (_attribute, 1e-4)


@case("color attribute", 1e-4)
def _color_attribute(t: Tree):
    node = t.node("VertexColor", layer_name="Col")
    return t.node(
        "Mix", {"Factor_Float": node.outputs[1], "A_Color": node.outputs[0]}, data_type="RGBA"
    ).outputs[2]


def _tilted(t: Tree):
    """Unit normals that vary over the plane and lean to the viewer."""
    v = t.node("CombineXYZ", {0: t.ramp(0), 1: t.ramp(1), 2: 0.6}).outputs[0]
    return t.node("VectorMath", {0: v}, operation="NORMALIZE").outputs[0]


@case("fresnel", 1e-4)
def _fresnel(t: Tree):
    return t.node("Fresnel", {0: 1.7, 1: _tilted(t)}).outputs[0]


for _blend in (0.3, 0.5, 0.8):
    for _output in (0, 1):
        CASES[f"layer weight {_blend} {_output}"] = (
            lambda t, blend=_blend, output=_output: t.node("LayerWeight", {0: blend, 1: _tilted(t)}).outputs[
                output
            ],
            1e-4,
        )


@case("normal dot")
def _normal_dot(t: Tree):
    node = t.node("Normal", {0: _tilted(t)})
    node.outputs[0].default_value = (0.3, 0.4, 0.866)
    return node.outputs[1]


for _space in ("TANGENT", "OBJECT", "WORLD", "BLENDER_OBJECT", "BLENDER_WORLD"):

    def _normal_map(t: Tree, space=_space):
        color = t.node("CombineColor", {0: t.ramp(0), 1: t.ramp(1), 2: 0.9}).outputs[0]
        node = t.node("NormalMap", {0: 0.7, 1: color}, space=space)
        if space == "TANGENT":
            node.uv_map = "UVMap"
        return offset(t, node.outputs[0], 0.4)

    CASES[f"normal map {_space}"] = (_normal_map, 2e-3)
for _axis in "XYZ":
    CASES[f"tangent radial {_axis}"] = (
        lambda t, axis=_axis: offset(
            t, t.node("Tangent", direction_type="RADIAL", axis=axis).outputs[0], 0.4
        ),
        1e-3,
    )


@case("tangent uv", 1e-3)
def _tangent_uv(t: Tree):
    return offset(t, t.node("Tangent", direction_type="UV_MAP", uv_map="UVMap").outputs[0], 0.4)


@case("bump of a ramp", 1e-3)
def _bump(t: Tree):
    square = t.node("Math", {0: t.ramp(), 1: t.ramp(1)}, operation="MULTIPLY").outputs[0]
    return offset(t, t.node("Bump", {"Height": square, "Distance": 0.5, "Strength": 0.8}).outputs[0], 0.4)


@case("bump of noise", 2e-2)
def _bump_noise(t: Tree):
    vector = t.node("TexCoord").outputs["Object"]
    noise = t.node("TexNoise", {0: vector, "Scale": 3.0}).outputs[0]
    return offset(t, t.node("Bump", {"Height": noise, "Distance": 0.3}, invert=True).outputs[0], 0.4)


@case("bump on bump", 2e-2)
def _bump_on_bump(t: Tree):
    vector = t.node("TexCoord").outputs["Generated"]
    noise = t.node("TexNoise", {0: vector, "Scale": 3.0}).outputs[0]
    first = t.node("Bump", {"Height": noise, "Distance": 0.3}).outputs[0]
    return offset(t, t.node("Bump", {"Height": t.ramp(1), "Distance": 0.5, "Normal": first}).outputs[0], 0.4)


PHOTOMETRY = """IESNA:LM-63-2002
TILT=NONE
1 1000 1 5 1 1 2 0 0 0
1 1 10
0 30 60 75 90
0
1000 800 500 200 0
"""


@case("ies profile")
def _ies(t: Tree):
    node = t.node("TexIES", {1: 0.01}, mode="INTERNAL")
    node.ies = bpy.data.texts.new("profile")
    node.ies.from_string(PHOTOMETRY)
    uv = t.node("UVMap").outputs["UV"]
    t.tree.links.new(t.node("Mapping", {0: uv, "Location": (0.1, 0.2, -0.9)}).outputs[0], node.inputs[0])
    return node.outputs[0]


# ---- trees of shaders
@case("mix and add shaders")
def _shaders(t: Tree):
    red = t.node("Emission", {0: (1, 0.2, 0.1, 1), 1: 0.7}).outputs[0]
    blue = t.node("Emission", {0: t.color(), 1: 0.4}).outputs[0]
    mixed = t.node("MixShader", {0: t.ramp(), 1: red, 2: blue}).outputs[0]
    camera = t.node("LightPath").outputs["Is Camera Ray"]
    added = t.node("AddShader", {0: mixed, 1: blue}).outputs[0]
    return t.node("MixShader", {0: camera, 1: red, 2: added}).outputs[0]


@case("principled emission")
def _principled(t: Tree):
    inputs = {"Base Color": (0, 0, 0, 1), "IOR": 1.0, "Emission Color": t.color(), "Emission Strength": 0.6}
    return t.node("BsdfPrincipled", inputs).outputs[0]


@case("group, reroute and mute")
def _group(t: Tree):
    group = bpy.data.node_groups.new("tinting", "ShaderNodeTree")
    group.interface.new_socket("Amount", in_out="INPUT", socket_type="NodeSocketFloat").default_value = 0.25
    group.interface.new_socket("Tint", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Result", in_out="OUTPUT", socket_type="NodeSocketColor")
    inside, out = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    tree = Tree(group)
    node = tree.node("Mix", {"B_Color": (0.9, 0.6, 0.1, 1)}, data_type="RGBA")
    reroute = group.nodes.new("NodeReroute")
    group.links.new(inside.outputs[0], reroute.inputs[0])
    group.links.new(reroute.outputs[0], node.inputs[0])
    a = next(s for s in node.inputs if s.identifier == "A_Color")
    # a colour goes through a float socket of a group
    group.links.new(inside.outputs[1], a)
    muted = tree.node("Gamma", {0: next(s for s in node.outputs if s.identifier == "Result_Color"), 1: 4.0})
    muted.mute = True
    group.links.new(muted.outputs[0], out.inputs[0])
    user = t.tree.nodes.new("ShaderNodeGroup")
    user.node_tree = group
    t.tree.links.new(t.color(), user.inputs[1])
    return user.outputs[0]


@case("group with an unlinked vector", LOOSE)
def _group_vector(t: Tree):
    group = bpy.data.node_groups.new("spotted", "ShaderNodeTree")
    group.interface.new_socket("Vector", in_out="INPUT", socket_type="NodeSocketVector")
    group.interface.new_socket("Result", in_out="OUTPUT", socket_type="NodeSocketFloat")
    inside, out = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    noise = Tree(group).node("TexNoise", {0: inside.outputs[0], "Scale": 3.0})
    group.links.new(noise.outputs[0], out.inputs[0])
    user = t.tree.nodes.new("ShaderNodeGroup")
    user.node_tree = group
    return user.outputs[0]
