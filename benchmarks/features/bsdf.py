"""The single shaders and how they are mixed and added."""

from __future__ import annotations

from benchmarks.features.principled import _card
from benchmarks.features.registry import feature
from benchmarks.features.stage import (
    BLUE,
    COPPER,
    CREAM,
    GREEN,
    RED,
    SAND,
    cube,
    lamp,
    material,
    monkey,
    node,
    plane,
    row,
    sphere,
    studio,
)


def _stage(card: bool = False, key=2.0) -> None:
    studio(fill=0.25 if key < 4 else 0.4, key=key)
    warm = (1.0, 0.75, 0.5)
    lamp("AREA", 60, (3.4, -2.0, 2.5), color=warm, shape="RECTANGLE", size=0.6 * key, size_y=2.0)
    if card:
        plane(_card(), (0, 2.6, 1.3), 6.0, (1.45, 0, 0), uv_scale=2.0)


def _single(kind: str, inputs: dict, **properties):
    return material(kind, lambda t: node(t, kind, inputs, **properties).outputs[0])


@feature()
def bsdf_diffuse():
    """Diffuse shader, roughness 0, 0.5 and 1."""
    _stage()
    row(lambda r: _single("ShaderNodeBsdfDiffuse", {"Color": SAND, "Roughness": r}), (0.0, 0.5, 1.0))


@feature()
def bsdf_glossy():
    """Glossy shader with multiple-scattering GGX, GGX and Beckmann."""
    _stage()
    row(
        lambda d: _single("ShaderNodeBsdfAnisotropic", {"Color": COPPER, "Roughness": 0.45}, distribution=d),
        ("MULTI_GGX", "GGX", "BECKMANN"),
    )


@feature()
def bsdf_glossy_ashikhmin():
    """Glossy shader with the Ashikhmin-Shirley distribution, rough and smooth."""
    _stage()
    row(
        lambda r: _single(
            "ShaderNodeBsdfAnisotropic", {"Color": COPPER, "Roughness": r}, distribution="ASHIKHMIN_SHIRLEY"
        ),
        (0.1, 0.4),
    )


@feature()
def bsdf_glossy_anisotropic():
    """Glossy shader with anisotropy of both signs, along the UV tangent."""
    _stage(key=3.0)

    def surface(anisotropy):
        def build(tree):
            tangent = node(tree, "ShaderNodeTangent", direction_type="RADIAL", axis="Z")
            inputs = {
                "Color": (0.8, 0.8, 0.8),
                "Roughness": 0.3,
                "Anisotropy": anisotropy,
                "Tangent": tangent.outputs[0],
            }
            return node(tree, "ShaderNodeBsdfAnisotropic", inputs).outputs[0]

        return material("Brushed", build)

    row(surface, (-0.8, 0.0, 0.8))


@feature()
def bsdf_mirror():
    """Glossy shader of roughness 0."""
    _stage(card=True, key=4.5)
    row(
        lambda c: _single("ShaderNodeBsdfAnisotropic", {"Color": c, "Roughness": 0.0}),
        (CREAM, (0.9, 0.4, 0.3)),
    )


@feature()
def bsdf_glass():
    """Glass shader, smooth and rough."""
    _stage(card=True, key=4.5)
    row(
        lambda r: _single("ShaderNodeBsdfGlass", {"Color": (0.9, 1, 0.95), "Roughness": r, "IOR": 1.45}),
        (0.0, 0.3),
    )


@feature()
def bsdf_glass_thin():
    """A pane of glass of real thickness: parallel faces must leave the view unbent."""
    _stage(card=True, key=4.5)
    pane = cube(
        _single("ShaderNodeBsdfGlass", {"Color": (0.85, 0.95, 0.9), "Roughness": 0.0}),
        (0, -0.3, 1.1),
        2.0,
        0.0,
        0.3,
    )
    pane.scale = (1.0, 0.06, 1.0)


@feature()
def bsdf_refraction():
    """Refraction shader alone: no reflection at all."""
    _stage(card=True, key=4.5)
    row(
        lambda r: _single("ShaderNodeBsdfRefraction", {"Color": (1, 1, 1), "Roughness": r, "IOR": 1.3}),
        (0.0, 0.2),
    )


@feature()
def bsdf_translucent():
    """Translucent leaf lit from behind, beside a diffuse one."""
    studio(fill=0.05, power=60)
    lamp("AREA", 250, (0.5, 3.2, 3.4), (0, 0, 1), size=1.0)
    plane(_single("ShaderNodeBsdfTranslucent", {"Color": GREEN}), (-1.3, 0, 1.1), 2.0, (1.3, 0, 0.2))
    plane(_single("ShaderNodeBsdfDiffuse", {"Color": GREEN}), (1.3, 0, 1.1), 2.0, (1.3, 0, -0.2))


@feature()
def bsdf_transparent():
    """Coloured transparent shader: colours multiply where sheets overlap, and tint their shadows."""
    _stage(card=True)
    for i, color in enumerate(((1, 0.4, 0.3), (0.4, 1, 0.4), (0.4, 0.5, 1))):
        plane(
            _single("ShaderNodeBsdfTransparent", {"Color": color}),
            (-0.9 + 0.9 * i, -0.8 + 0.5 * i, 1.15),
            1.7,
            (1.4, 0.2 * i, 0.1),
        )


@feature()
def bsdf_mix():
    """Mix of diffuse and glossy, by a constant and by Fresnel, and with layer weight."""
    _stage()

    def surface(kind):
        def build(tree):
            a = node(tree, "ShaderNodeBsdfDiffuse", {"Color": BLUE}).outputs[0]
            b = node(
                tree, "ShaderNodeBsdfAnisotropic", {"Color": (0.9, 0.9, 0.9), "Roughness": 0.15}
            ).outputs[0]
            factor = 0.35
            if kind == "fresnel":
                factor = node(tree, "ShaderNodeFresnel", {"IOR": 1.6}).outputs[0]
            elif kind == "facing":
                factor = node(tree, "ShaderNodeLayerWeight", {"Blend": 0.6}).outputs["Facing"]
            return node(tree, "ShaderNodeMixShader", {0: factor, 1: a, 2: b}).outputs[0]

        return material(kind, build)

    row(surface, ("constant", "fresnel", "facing"))


@feature()
def bsdf_add():
    """Sum of diffuse and emission, and of two glossy lobes."""
    _stage()

    def glow(tree):
        a = node(tree, "ShaderNodeBsdfDiffuse", {"Color": RED}).outputs[0]
        b = node(tree, "ShaderNodeEmission", {"Color": (0.1, 0.5, 0.9), "Strength": 0.4}).outputs[0]
        return node(tree, "ShaderNodeAddShader", {0: a, 1: b}).outputs[0]

    def lobes(tree):
        a = node(tree, "ShaderNodeBsdfAnisotropic", {"Color": (0.4, 0.2, 0.1), "Roughness": 0.5}).outputs[0]
        b = node(tree, "ShaderNodeBsdfAnisotropic", {"Color": (0.3, 0.3, 0.3), "Roughness": 0.1}).outputs[0]
        return node(tree, "ShaderNodeAddShader", {0: a, 1: b}).outputs[0]

    sphere(material("Glow", glow), (-1.2, 0, 0.95), 0.95)
    sphere(material("Lobes", lobes), (1.2, 0, 0.95), 0.95)


@feature()
def bsdf_backfacing():
    """Two sides of a sheet with different shaders (Geometry: Backfacing)."""
    _stage()

    def surface(tree):
        side = node(tree, "ShaderNodeNewGeometry").outputs["Backfacing"]
        front = node(tree, "ShaderNodeBsdfDiffuse", {"Color": RED}).outputs[0]
        back = node(tree, "ShaderNodeBsdfDiffuse", {"Color": BLUE}).outputs[0]
        return node(tree, "ShaderNodeMixShader", {0: side, 1: front, 2: back}).outputs[0]

    sheet = material("Sheet", surface)
    plane(sheet, (-1.3, 0, 1.0), 1.8, (1.2, 0, 0.3))
    plane(sheet, (1.3, 0, 1.0), 1.8, (-1.9, 0, 0.3))


@feature()
def bsdf_metallic_node():
    """Metallic BSDF with physical n and k, and with F82 tint."""
    _stage()
    sphere(
        _single("ShaderNodeBsdfMetallic", {"Roughness": 0.25}, fresnel_type="F82"),
        (-1.2, 0, 0.95),
        0.95,
    )
    sphere(
        _single("ShaderNodeBsdfMetallic", {"Roughness": 0.25}, fresnel_type="PHYSICAL_CONDUCTOR"),
        (1.2, 0, 0.95),
        0.95,
    )


@feature()
def bsdf_sheen():
    """Sheen shader on its own (microfiber), added to diffuse."""
    _stage()

    def surface(tree):
        a = node(tree, "ShaderNodeBsdfDiffuse", {"Color": (0.1, 0.02, 0.03)}).outputs[0]
        b = node(tree, "ShaderNodeBsdfSheen", {"Color": (0.8, 0.6, 0.6), "Roughness": 0.4}).outputs[0]
        return node(tree, "ShaderNodeAddShader", {0: a, 1: b}).outputs[0]

    monkey(material("Velvet", surface), (0, 0, 1.05), 1.5)


@feature()
def bsdf_velvet():
    """Sheen shader of the older kind (Ashikhmin velvet), alone and mixed with glossy, on spheres and on the floor."""
    _stage()

    def velvet(tree):
        inputs = {"Color": (0.7, 0.5, 0.5), "Roughness": 0.4}
        return node(tree, "ShaderNodeBsdfSheen", inputs, distribution="ASHIKHMIN").outputs[0]

    def mixed(tree):
        inputs = {"Color": (0.2, 0.2, 0.25), "Roughness": 0.32}
        glossy = node(tree, "ShaderNodeBsdfAnisotropic", inputs, distribution="GGX").outputs[0]
        return node(tree, "ShaderNodeMixShader", {0: 0.5, 1: glossy, 2: velvet(tree)}).outputs[0]

    sphere(material("Velvet", velvet), (-1.2, 0, 0.95), 0.95)
    sphere(material("Mixed", mixed), (1.2, 0, 0.95), 0.95)
    plane(material("Floor", mixed), (0, 0, 0.01), 20.0)


@feature()
def bsdf_glossy_grazing():
    """A rough glossy floor alone, seen at grazing angles under a world light: GGX, then Beckmann spheres on it."""
    studio(fill=0.6, power=60, key=3.0)
    floor = _single(
        "ShaderNodeBsdfAnisotropic", {"Color": (0.4, 0.4, 0.5), "Roughness": 0.32}, distribution="GGX"
    )
    plane(floor, (0, 0, 0.01), 40.0)
    beckmann = {"Color": (0.8, 0.5, 0.4), "Roughness": 0.32}
    row(
        lambda c: _single("ShaderNodeBsdfAnisotropic", beckmann | {"Color": c}, distribution="BECKMANN"),
        (RED, CREAM),
    )
