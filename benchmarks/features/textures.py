"""Textures, coordinates and the colour and math nodes between them and a shader."""

from __future__ import annotations

import bpy
import numpy as np

from benchmarks.features.registry import feature
from benchmarks.features.stage import (
    CREAM,
    camera,
    cove,
    cube,
    image,
    material,
    matte,
    monkey,
    node,
    panels,
    plane,
    row,
    softbox,
    sphere,
    studio,
    tiles,
    torus,
    world,
)


def _diffuse(name, color):
    """A diffuse material whose colour is what color(tree) returns."""
    return material(name, lambda t: node(t, "ShaderNodeBsdfDiffuse", {"Color": color(t)}).outputs[0])


@feature()
def texture_image():
    """Image texture on the UV maps of solids: orientation, sRGB decoding, linear interpolation."""
    studio(fill=0.3)
    card = image("Card", tiles())
    surface = _diffuse("Card", lambda t: node(t, "ShaderNodeTexImage", image=card).outputs[0])
    sphere(surface, (-1.3, 0, 1.0), 1.0)
    cube(surface, (1.3, 0, 0.75), 1.5, bevel=0.0)


@feature()
def texture_interpolation():
    """Closest, linear and cubic interpolation of a tiny image."""
    studio(fill=0.3)
    pixels = np.random.default_rng(3).uniform(0.05, 0.9, (5, 5, 3))
    small = image("Small", pixels)

    def surface(mode):
        return _diffuse(
            mode, lambda t: node(t, "ShaderNodeTexImage", image=small, interpolation=mode).outputs[0]
        )

    panels([surface(mode) for mode in ("Closest", "Linear", "Cubic")])


@feature()
def texture_extension():
    """Repeat, extend, clip and mirror outside 0..1, through a Mapping node."""
    studio(fill=0.3)
    card = image("Card", tiles())

    def color(mode):
        def build(tree):
            uv = node(tree, "ShaderNodeTexCoord").outputs["UV"]
            mapping = {
                "Vector": uv,
                "Location": (-0.6, -0.7, 0),
                "Scale": (2.2, 2.2, 1),
                "Rotation": (0, 0, 0.2),
            }
            placed = node(tree, "ShaderNodeMapping", mapping).outputs[0]
            return node(tree, "ShaderNodeTexImage", {"Vector": placed}, image=card, extension=mode).outputs[0]

        return build

    panels([_diffuse(mode, color(mode)) for mode in ("REPEAT", "EXTEND", "CLIP", "MIRROR")])


@feature()
def texture_far():
    """A fine image on a floor that runs to the horizon: far away it must fade to its mean, not flicker or shift."""
    world((0.5, 0.6, 0.75))
    card = image("Card", tiles(128, 16))
    plane(
        _diffuse("Floor", lambda t: node(t, "ShaderNodeTexImage", image=card).outputs[0]),
        (0, 90, 0),
        200,
        uv_scale=60,
    )
    camera((0, -8, 1.6), (0, 0, 1.0), 40)
    softbox(900, (-4, -4, 7), 2.5)


@feature()
def texture_color_spaces():
    """The same numbers read as sRGB, as non-colour and from a float image."""
    studio(fill=0.3)
    ramp = np.linspace(0, 1, 16)[None, :, None] * np.array([1.0, 0.8, 0.6])
    ramp = np.repeat(ramp, 4, axis=0)
    pictures = [
        image("S", ramp, "sRGB"),
        image("N", ramp, "Non-Color"),
        image("F", ramp, "Linear Rec.709", True),
    ]

    def surface(picture):
        return _diffuse(picture.name, lambda t: node(t, "ShaderNodeTexImage", image=picture).outputs[0])

    panels([surface(picture) for picture in pictures])


@feature()
def texture_alpha():
    """Image alpha, straight as stored: mixing with transparent, and colour under alpha."""
    studio(fill=0.3)
    y, x = np.mgrid[0:32, 0:32] / 31.0
    soft = np.clip(1.3 - 3 * ((x - 0.5) ** 2 + (y - 0.5) ** 2) * 2, 0, 1)
    picture = image("Soft", np.dstack([x, 0.3 + 0 * x, 1 - y, soft]))

    def surface(tree):
        texture = node(tree, "ShaderNodeTexImage", image=picture)
        clear = node(tree, "ShaderNodeBsdfTransparent").outputs[0]
        paint = node(tree, "ShaderNodeBsdfDiffuse", {"Color": texture.outputs[0]}).outputs[0]
        return node(tree, "ShaderNodeMixShader", {0: texture.outputs["Alpha"], 1: clear, 2: paint}).outputs[0]

    cube(matte(CREAM), (0, 1.4, 0.7), 1.2)
    plane(material("Soft", surface), (0, 0, 1.2), 2.2, (1.35, 0, 0))


@feature()
def texture_alpha_modes():
    """Colour that hides under alpha 0, seen without its alpha: straight (alpha used and not), packed, ignored."""
    studio(fill=0.3)
    y, x = np.mgrid[0:32, 0:32] / 31.0
    disk = np.clip(3 - 9 * np.hypot(x - 0.5, y - 0.5), 0, 1)
    pixels = np.dstack([0.9 + 0 * x, x, 1 - y, disk])

    def surface(mode, linked):
        picture = image(f"{mode} {linked}", pixels)
        picture.alpha_mode = mode

        def color(tree):
            texture = node(tree, "ShaderNodeTexImage", image=picture)
            if not linked:
                return texture.outputs[0]
            # a little of the alpha, linked: with a factor of 0 the link would be folded away
            little = node(tree, "ShaderNodeMath", {0: texture.outputs[1], 1: 1e-6}, operation="MULTIPLY")
            both = {0: texture.outputs[0], 1: little.outputs[0]}
            return node(tree, "ShaderNodeVectorMath", both, operation="ADD").outputs[0]

        return _diffuse("Alpha", color)

    kinds = (("STRAIGHT", True), ("STRAIGHT", False), ("CHANNEL_PACKED", True), ("NONE", True))
    panels([surface(*kind) for kind in kinds])


@feature()
def texture_leaves():
    """Leaves as artists make them: Principled with alpha plus transparent of the picture's colour, many in a row."""
    studio(fill=0.3)
    y, x = np.mgrid[0:32, 0:32] / 31.0
    inside = (np.hypot((x - 0.5) * 2.2, y - 0.5) < 0.45).astype(float)
    leaf = np.dstack(
        [0.15 + 0.3 * y + 0.5 * (1 - inside), 0.5 + 0.4 * (1 - inside), 0.1 + 0.8 * (1 - inside), inside]
    )
    picture = image("Leaf", leaf)

    def surface(tree):
        texture = node(tree, "ShaderNodeTexImage", image=picture)
        color, alpha = texture.outputs
        through = node(tree, "ShaderNodeBsdfTransparent", {"Color": color}).outputs[0]
        front = node(tree, "ShaderNodeBsdfPrincipled", {"Base Color": color, "Alpha": alpha}).outputs[0]
        return node(tree, "ShaderNodeAddShader", {0: front, 1: through}).outputs[0]

    paper = material("Leaf", surface)
    for i in range(10):
        plane(paper, (-1.8 + 0.4 * i, -0.8 + 0.25 * i, 1.1), 1.7, (1.4, 0.1 * i, 0.1))


@feature()
def texture_box_projection():
    """Image in box projection with blending, on object coordinates."""
    studio(fill=0.3)
    card = image("Card", tiles())

    def color(tree):
        at = node(tree, "ShaderNodeTexCoord").outputs["Object"]
        return node(
            tree, "ShaderNodeTexImage", {"Vector": at}, image=card, projection="BOX", projection_blend=0.3
        ).outputs[0]

    surface = _diffuse("Box", color)
    monkey(surface, (-1.3, 0, 1.0), 1.2)
    torus(surface, (1.3, 0, 0.5))


@feature()
def texture_noise():
    """Noise: value and colour, detail, distortion, and the kinds of fractal."""
    studio(fill=0.3)

    def color(settings):
        inputs, properties, output = settings
        return _diffuse(
            "Noise", lambda t: node(t, "ShaderNodeTexNoise", inputs, **properties).outputs[output]
        )

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
        lambda d: _diffuse(
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
        return _diffuse(
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

    sphere(_diffuse("Checker", checker), (-1.3, 0.03, 1.0), 1.0)
    plane(_diffuse("Brick", brick), (1.3, 0, 1.1), 2.0, (1.3, 0, 0.2))


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

        return _diffuse(kind, build)

    row(
        color,
        (
            ("LINEAR", "LINEAR", "RGB"),
            ("SPHERICAL", "CONSTANT", "RGB"),
            ("QUADRATIC", "EASE", "RGB"),
            ("wave", "LINEAR", "HSV"),
        ),
    )


@feature()
def texture_coordinates():
    """Generated, object, normal and UV coordinates shown as colours, on a turned and scaled object."""
    studio(fill=0.3)
    for i, output in enumerate(("Generated", "Object", "Normal", "UV")):

        def color(tree, output=output):
            at = node(tree, "ShaderNodeTexCoord").outputs[output]
            inputs = {0: at, 1: (0.4, 0.4, 0.4), 2: (0.5, 0.5, 0.5)}
            return node(tree, "ShaderNodeVectorMath", inputs, operation="MULTIPLY_ADD").outputs[0]

        item = sphere(_diffuse(output, color), (-1.95 + 1.3 * i, 0, 0.7), 0.62)
        item.rotation_euler, item.scale = (0.4, 0.3, 0.6), (1, 0.8, 1.1)


@feature()
def texture_view_coordinates():
    """Camera, window and reflection coordinates, geometry position and incoming direction."""
    studio(fill=0.3)

    def color(kind):
        def build(tree):
            if kind in ("Position", "Incoming"):
                at = node(tree, "ShaderNodeNewGeometry").outputs[kind]
            else:
                at = node(tree, "ShaderNodeTexCoord").outputs[kind]
            scaled = {0: at, 1: (0.3, 0.3, 0.3), 2: (0.5, 0.5, 0.5)}
            return node(tree, "ShaderNodeVectorMath", scaled, operation="MULTIPLY_ADD").outputs[0]

        return _diffuse(kind, build)

    row(color, ("Window", "Reflection", "Position", "Incoming"))


@feature()
def texture_color_nodes():
    """Hue/saturation, invert, gamma, bright/contrast and RGB curves on an image."""
    studio(fill=0.3)
    card = image("Card", tiles())

    def color(kind):
        def build(tree):
            value = node(tree, "ShaderNodeTexImage", image=card).outputs[0]
            if kind == "hue":
                inputs = {"Hue": 0.7, "Saturation": 1.4, "Value": 0.9, "Fac": 0.8, "Color": value}
                return node(tree, "ShaderNodeHueSaturation", inputs).outputs[0]
            if kind == "invert":
                return node(tree, "ShaderNodeInvert", {"Fac": 0.75, "Color": value}).outputs[0]
            if kind == "contrast":
                bright = node(
                    tree, "ShaderNodeBrightContrast", {"Color": value, "Bright": 0.05, "Contrast": 0.4}
                )
                return node(tree, "ShaderNodeGamma", {"Color": bright.outputs[0], "Gamma": 1.4}).outputs[0]
            curve = node(tree, "ShaderNodeRGBCurve", {"Color": value})
            curve.mapping.curves[3].points.new(0.3, 0.6)
            curve.mapping.curves[0].points.new(0.5, 0.35)
            curve.mapping.update()
            return curve.outputs[0]

        return _diffuse(kind, build)

    panels([color(kind) for kind in ("hue", "invert", "contrast", "curves")])


@feature()
def texture_mix_modes():
    """The mix node's blend modes, one strip each."""
    studio(fill=0.3)
    card = image("Card", tiles())
    modes = (
        "MIX", "MULTIPLY", "ADD", "SUBTRACT", "SCREEN", "OVERLAY", "DARKEN", "LIGHTEN", "DIFFERENCE", "DODGE", "BURN",
        "SOFT_LIGHT", "LINEAR_LIGHT", "DIVIDE", "HUE", "SATURATION", "VALUE", "COLOR",
    )  # fmt: skip
    for i, mode in enumerate(modes):

        def color(tree, mode=mode):
            value = node(tree, "ShaderNodeTexImage", image=card).outputs[0]
            mix = node(tree, "ShaderNodeMix", data_type="RGBA", blend_type=mode)
            mix.inputs[0].default_value = 0.7
            tree.links.new(value, mix.inputs[6])
            mix.inputs[7].default_value = (0.7, 0.45, 0.2, 1)
            return mix.outputs[2]

        plane(_diffuse(mode, color), (-2.15 + 0.86 * (i % 6), 0, 0.4 + 0.83 * (i // 6)), 0.78, (1.35, 0, 0))


@feature()
def texture_math():
    """Math, map range, separate and combine, vector math: patterns from arithmetic on coordinates."""
    studio(fill=0.3)

    def stripes(tree):
        at = node(tree, "ShaderNodeTexCoord").outputs["Object"]
        part = node(tree, "ShaderNodeSeparateXYZ", {0: at})
        scaled = node(tree, "ShaderNodeMath", {0: part.outputs[2], 1: 9.0}, operation="MULTIPLY").outputs[0]
        wave = node(tree, "ShaderNodeMath", {0: scaled}, operation="SINE").outputs[0]
        level = node(tree, "ShaderNodeMapRange", {"Value": wave, 1: -1.0, 2: 1.0, 3: 0.1, 4: 0.8})
        red = node(tree, "ShaderNodeMath", {0: part.outputs[0]}, operation="ABSOLUTE").outputs[0]
        inputs = {0: red, 1: level.outputs[0], 2: 0.3}
        return node(tree, "ShaderNodeCombineColor", inputs).outputs[0]

    def rings(tree):
        at = node(tree, "ShaderNodeTexCoord").outputs["Object"]
        length = node(tree, "ShaderNodeVectorMath", {0: at, 1: (0, 0, 1)}, operation="DISTANCE").outputs[
            "Value"
        ]
        ring = node(tree, "ShaderNodeMath", {0: length, 1: 0.25}, operation="PINGPONG").outputs[0]
        step = node(tree, "ShaderNodeMath", {0: ring, 1: 0.12}, operation="GREATER_THAN").outputs[0]
        mix = node(tree, "ShaderNodeMix", data_type="RGBA")
        tree.links.new(step, mix.inputs[0])
        mix.inputs[6].default_value, mix.inputs[7].default_value = (0.6, 0.1, 0.05, 1), (0.8, 0.75, 0.6, 1)
        return mix.outputs[2]

    sphere(_diffuse("Stripes", stripes), (-1.2, 0, 1.0), 1.0)
    monkey(_diffuse("Rings", rings), (1.3, 0, 1.0), 1.2)


@feature()
def texture_attribute():
    """Vertex colours by name, and a float attribute per face."""
    studio(fill=0.3)
    item = sphere(None, (-1.2, 0, 1.0), 1.0)
    mesh = item.data
    colors = mesh.color_attributes.new("Paint", "FLOAT_COLOR", "POINT")
    at = np.array([v.co[:] for v in mesh.vertices])
    values = np.clip(np.column_stack([at * 0.4 + 0.5, np.ones(len(at))]), 0, 1)
    colors.data.foreach_set("color", values.astype(np.float32).ravel())
    mesh.materials.append(
        _diffuse("Paint", lambda t: node(t, "ShaderNodeAttribute", attribute_name="Paint").outputs["Color"])
    )
    other = monkey(None, (1.3, 0, 1.0), 1.2, levels=0)
    face = other.data.attributes.new("shade", "FLOAT", "FACE")
    shades = np.random.default_rng(1).uniform(0.05, 0.9, len(other.data.polygons)).astype(np.float32)
    face.data.foreach_set("value", shades)
    other.data.materials.append(
        _diffuse("Shade", lambda t: node(t, "ShaderNodeAttribute", attribute_name="shade").outputs["Fac"])
    )


@feature()
def texture_object_info():
    """Object Info: colour, index and random, and material index, on objects that share one mesh."""
    studio(fill=0.3)

    def color(tree):
        info = node(tree, "ShaderNodeObjectInfo")
        part = node(
            tree, "ShaderNodeMath", {0: info.outputs["Object Index"], 1: 4.0}, operation="DIVIDE"
        ).outputs[0]
        mix = node(tree, "ShaderNodeMix", data_type="RGBA", blend_type="MIX")
        tree.links.new(part, mix.inputs[0])
        tree.links.new(info.outputs["Color"], mix.inputs[6])
        mix.inputs[7].default_value = (0.9, 0.9, 0.9, 1)
        return mix.outputs[2]

    first = sphere(_diffuse("Info", color), (-1.95, 0, 0.62), 0.62)
    for i in range(4):
        item = first if i == 0 else bpy.data.objects.new("Copy", first.data)
        if i:
            bpy.context.scene.collection.objects.link(item)
            item.location = (-1.95 + 1.3 * i, 0, 0.62)
        item.pass_index = i
        item.color = (0.8, 0.15 + 0.2 * i, 0.1, 1)


@feature()
def texture_node_group():
    """A node group with inputs, used twice with different values."""
    studio(fill=0.3)
    group = bpy.data.node_groups.new("Stripes", "ShaderNodeTree")
    group.interface.new_socket("Scale", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Tint", in_out="INPUT", socket_type="NodeSocketColor")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    start, end = node(group, "NodeGroupInput"), node(group, "NodeGroupOutput")
    inputs = {"Scale": start.outputs[0], "Color1": start.outputs[1], "Color2": (0.1, 0.1, 0.1)}
    group.links.new(node(group, "ShaderNodeTexChecker", inputs).outputs[0], end.inputs[0])

    def color(settings):
        scale, tint = settings

        def build(tree):
            user = node(tree, "ShaderNodeGroup", node_tree=group)
            user.inputs["Scale"].default_value, user.inputs["Tint"].default_value = scale, (*tint, 1)
            return user.outputs[0]

        return _diffuse("Group", build)

    row(color, ((4.3, (0.8, 0.2, 0.1)), (9.7, (0.1, 0.4, 0.8))))


def _displaced(method: str, scale: float):
    """A diffuse material, displaced by a noise."""
    item = _diffuse(method, lambda t: node(t, "ShaderNodeRGB").outputs[0])
    tree = item.node_tree
    noise = node(tree, "ShaderNodeTexNoise", {"Scale": 3.0, "Detail": 1.0})
    height = node(tree, "ShaderNodeDisplacement", {"Height": noise.outputs[0], "Scale": scale})
    end = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(height.outputs[0], end.inputs["Displacement"])
    item.displacement_method = method
    return item


@feature()
def texture_displacement():
    """Material displacement that moves the surface: alone, with bump, and of an object that is stretched and flat."""
    studio(fill=0.3)
    for method, x, smooth in (
        ("DISPLACEMENT", -1.9, True),
        ("BOTH", 0.0, True),
        ("DISPLACEMENT", 1.9, False),
    ):
        item = _displaced(method, 0.6)
        ball = sphere(item, (x, 0, 1.0), 0.8, smooth)
        if not smooth:
            ball.scale = (0.8, 0.8, 1.3)


@feature()
def texture_displaced_bump():
    """Material displacement, bump only: a height texture shades as bump without moving the surface."""
    studio(fill=0.3)
    item = _displaced("BUMP", 0.4)
    color = next(n for n in item.node_tree.nodes if n.bl_idname == "ShaderNodeRGB")
    color.outputs[0].default_value = (0.6, 0.5, 0.4, 1)
    sphere(item, (-1.2, 0, 1.0), 1.0)
    cube(item, (1.2, 0, 0.8))


@feature()
def texture_environment_mirror():
    """Mirror-ball and equirectangular images on generated coordinates of a surface."""
    cove()
    camera()
    softbox(300)
    world((0.2, 0.2, 0.25))
    card = image("Card", tiles())

    def color(projection):
        def build(tree):
            at = node(tree, "ShaderNodeTexCoord").outputs["Normal"]
            return node(tree, "ShaderNodeTexEnvironment", {0: at}, image=card, projection=projection).outputs[
                0
            ]

        return _diffuse(projection, build)

    row(color, ("EQUIRECTANGULAR", "MIRROR_BALL"))
