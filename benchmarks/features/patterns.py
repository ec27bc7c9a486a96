"""Procedural textures."""

from __future__ import annotations

from benchmarks.features.registry import feature
from benchmarks.features.stage import diffuse, node, plane, row, sphere, studio


@feature()
def texture_noise():
    """Noise: value and colour, detail, distortion, and the kinds of fractal."""
    studio(fill=0.3)

    def color(settings):
        inputs, properties, output = settings
        return diffuse("Noise", lambda t: node(t, "ShaderNodeTexNoise", inputs, **properties).outputs[output])

    row(
        color,
        (
            ({"Scale": 3.0, "Detail": 2.0}, {}, 0),
            ({"Scale": 3.0, "Detail": 5.0, "Roughness": 0.7, "Distortion": 1.0}, {}, 1),
            ({"Scale": 4.0, "Detail": 3.0}, {"noise_type": "RIDGED_MULTIFRACTAL", "normalize": True}, 0),
        ),
    )


@feature()
def texture_noise_dimensions():
    """Noise in one, two, three and four dimensions."""
    studio(fill=0.3)
    row(
        lambda d: diffuse(
            d,
            lambda t: node(
                t,
                "ShaderNodeTexNoise",
                {"Scale": 4.0, **({"W": 1.3} if d in "1D4D" else {})},
                noise_dimensions=d,
            ).outputs[1],
        ),
        ("1D", "2D", "3D", "4D"),
    )


@feature()
def texture_voronoi():
    """Voronoi: distance, colour, smooth and edge distance."""
    studio(fill=0.3)

    def color(settings):
        kind, output = settings
        return diffuse(
            kind, lambda t: node(t, "ShaderNodeTexVoronoi", {"Scale": 3.0}, feature=kind).outputs[output]
        )

    row(
        color,
        (("F1", "Distance"), ("F1", "Color"), ("SMOOTH_F1", "Distance"), ("DISTANCE_TO_EDGE", "Distance")),
    )


@feature()
def texture_checker():
    """Checker on generated and UV coordinates, and brick."""
    studio(fill=0.3)

    def checker(tree):
        at = node(tree, "ShaderNodeTexCoord").outputs["Generated"]
        inputs = {"Vector": at, "Scale": 6.0, "Color1": (0.8, 0.3, 0.1), "Color2": (0.1, 0.2, 0.3)}
        return node(tree, "ShaderNodeTexChecker", inputs).outputs[0]

    def brick(tree):
        at = node(tree, "ShaderNodeTexCoord").outputs["UV"]
        inputs = {"Vector": at, "Scale": 4.0, "Color1": (0.6, 0.15, 0.08), "Color2": (0.45, 0.2, 0.1)}
        return node(tree, "ShaderNodeTexBrick", inputs | {"Mortar": (0.6, 0.58, 0.55)}).outputs[0]

    sphere(diffuse("Checker", checker), (-1.3, 0.03, 1.0), 1.0)
    plane(diffuse("Brick", brick), (1.3, 0, 1.1), 2.0, (1.3, 0, 0.2))


@feature()
def texture_gradient_ramp():
    """Gradient and wave through colour ramps: linear, constant and eased stops, RGB and HSV."""
    studio(fill=0.3)

    def color(settings):
        kind, interpolation, mode = settings

        def build(tree):
            at = node(tree, "ShaderNodeTexCoord").outputs["Generated"]
            turned = node(tree, "ShaderNodeMapping", {"Vector": at, "Rotation": (0, 0.9, 0)}).outputs[0]
            if kind == "wave":
                value = node(
                    tree, "ShaderNodeTexWave", {"Vector": at, "Scale": 2.0, "Distortion": 3.0}
                ).outputs["Fac"]
            else:
                value = node(tree, "ShaderNodeTexGradient", {"Vector": turned}, gradient_type=kind).outputs[
                    "Fac"
                ]
            ramp = node(tree, "ShaderNodeValToRGB", {"Fac": value})
            ramp.color_ramp.color_mode = mode
            if mode == "RGB":
                ramp.color_ramp.interpolation = interpolation
            for element, paint in zip(
                ramp.color_ramp.elements, ((0.05, 0.1, 0.5, 1), (0.9, 0.7, 0.2, 1)), strict=True
            ):
                element.color = paint
            ramp.color_ramp.elements.new(0.45).color = (0.7, 0.1, 0.1, 1)
            return ramp.outputs[0]

        return diffuse(kind, build)

    row(
        color,
        (
            ("LINEAR", "LINEAR", "RGB"),
            ("SPHERICAL", "CONSTANT", "RGB"),
            ("QUADRATIC", "EASE", "RGB"),
            ("wave", "LINEAR", "HSV"),
        ),
    )
