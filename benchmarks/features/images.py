"""Image textures: how they are placed, read and filtered, and their alpha."""

from __future__ import annotations

import numpy as np

from benchmarks.features.registry import feature
from benchmarks.features.stage import (
    CREAM,
    camera,
    cove,
    cube,
    diffuse,
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


@feature()
def texture_image():
    """Image texture on the UV maps of solids: orientation, sRGB decoding, linear interpolation."""
    studio(fill=0.3)
    card = image("Card", tiles())
    surface = diffuse("Card", lambda t: node(t, "ShaderNodeTexImage", image=card).outputs[0])
    sphere(surface, (-1.3, 0, 1.0), 1.0)
    cube(surface, (1.3, 0, 0.75), 1.5, bevel=0.0)


@feature()
def texture_interpolation():
    """Closest, linear and cubic interpolation of a tiny image."""
    studio(fill=0.3)
    pixels = np.random.default_rng(3).uniform(0.05, 0.9, (5, 5, 3))
    small = image("Small", pixels)

    def surface(mode):
        return diffuse(
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

    panels([diffuse(mode, color(mode)) for mode in ("REPEAT", "EXTEND", "CLIP", "MIRROR")])


@feature()
def texture_far():
    """A fine image on a floor that runs to the horizon: far away it must fade to its mean, not flicker or shift."""
    world((0.5, 0.6, 0.75))
    card = image("Card", tiles(128, 16))
    plane(
        diffuse("Floor", lambda t: node(t, "ShaderNodeTexImage", image=card).outputs[0]),
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
        return diffuse(picture.name, lambda t: node(t, "ShaderNodeTexImage", image=picture).outputs[0])

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

        return diffuse("Alpha", color)

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

    surface = diffuse("Box", color)
    monkey(surface, (-1.3, 0, 1.0), 1.2)
    torus(surface, (1.3, 0, 0.5))


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

        return diffuse(projection, build)

    row(color, ("EQUIRECTANGULAR", "MIRROR_BALL"))
