"""One scene for each input of the Principled BSDF."""

from __future__ import annotations

import numpy as np

from benchmarks.features.registry import feature
from benchmarks.features.stage import (
    BLUE,
    COPPER,
    CREAM,
    GOLD,
    RED,
    SAND,
    cube,
    image,
    lamp,
    material,
    matte,
    monkey,
    node,
    plane,
    principled,
    row,
    sphere,
    studio,
    tiles,
    torus,
)


def _stage(key=2.0, fill=0.25, power=300.0) -> None:
    """Studio with a second, warm light from the right, so that reflections have something to show.

    key: sides of the softbox. Where paths find it only by chance, a wider one makes the same light with less noise.
    """
    studio(fill=fill, key=key, power=power)
    lamp("AREA", 60, (3.4, -2.0, 2.5), color=(1.0, 0.75, 0.5), shape="RECTANGLE", size=0.6 * key, size_y=2.0)


@feature()
def principled_base():
    """Default Principled in three base colours: a dielectric coat over diffuse."""
    _stage()
    row(lambda c: principled(Base_Color=c), (RED, CREAM, BLUE))


@feature()
def principled_metallic():
    """Metallic 0.3, 0.7 and 1."""
    _stage()
    row(lambda m: principled(Base_Color=COPPER, Metallic=m, Roughness=0.3), (0.3, 0.7, 1.0))


@feature()
def principled_metal_roughness():
    """Gold from a mirror to rough: GGX with its energy made up for."""
    _stage(key=3.0)
    row(
        lambda r: principled(Base_Color=GOLD, Metallic=1.0, Roughness=r),
        (0.0, 0.25, 0.5, 1.0),
    )


@feature()
def principled_edge_tint():
    """Metal with a dark specular tint: reflectance at grazing angles (F82)."""
    _stage(key=3.0)
    row(
        lambda t: principled(Base_Color=(0.8, 0.6, 0.3), Metallic=1.0, Roughness=0.2, Specular_Tint=t),
        ((1, 1, 1), (0.2, 0.5, 0.9), (0, 0, 0)),
    )


@feature()
def principled_roughness():
    """Dielectric from glossy to rough."""
    _stage()
    row(lambda r: principled(Base_Color=RED, Roughness=r), (0.0, 0.25, 0.5, 1.0))


@feature()
def principled_specular():
    """Specular level 0, 0.5 and 1."""
    _stage()
    row(
        lambda s: principled(Base_Color=(0.05, 0.1, 0.2), Roughness=0.15, Specular_IOR_Level=s),
        (0.0, 0.5, 1.0),
    )


@feature()
def principled_specular_tint():
    """Specular tint of a dielectric."""
    _stage()
    row(
        lambda t: principled(
            Base_Color=(0.1, 0.1, 0.1), Roughness=0.2, Specular_Tint=t, Specular_IOR_Level=1.0
        ),
        ((1, 1, 1), (1, 0.3, 0.1), (0.1, 0.4, 1)),
    )


@feature()
def principled_ior():
    """Index of refraction of an opaque dielectric: 1.1, 1.5 and 2.5."""
    _stage()
    row(lambda i: principled(Base_Color=(0.02, 0.03, 0.03), Roughness=0.1, IOR=i), (1.1, 1.5, 2.5))


@feature()
def principled_diffuse_roughness():
    """Diffuse roughness (Oren-Nayar, energy preserving) 0, 0.5 and 1."""
    _stage()
    row(lambda r: principled(Base_Color=SAND, Diffuse_Roughness=r, Specular_IOR_Level=0.0), (0.0, 0.5, 1.0))


def _glass_stage() -> None:
    _stage(key=4.5, fill=0.6, power=150.0)
    plane(_card(), (0, 2.6, 1.3), 6.0, (1.45, 0, 0), uv_scale=2.0)


def _card():
    card = image("Card", tiles())
    return material(
        "Card",
        lambda t: node(
            t, "ShaderNodeBsdfDiffuse", {"Color": node(t, "ShaderNodeTexImage", image=card).outputs[0]}
        ).outputs[0],
    )


@feature()
def principled_transmission():
    """Smooth glass: the card behind it stands on its head, through several bounces."""
    _glass_stage()
    sphere(principled(Base_Color=(1, 1, 1), Transmission_Weight=1.0, Roughness=0.0), (-1.2, 0, 1.0), 1.0)
    cube(
        principled(Base_Color=(0.6, 0.9, 0.7), Transmission_Weight=1.0, Roughness=0.0, IOR=1.3), (1.2, 0, 0.8)
    )


@feature()
def principled_transmission_rough():
    """Frosted glass, roughness 0.15 and 0.5."""
    _glass_stage()
    row(
        lambda r: principled(Base_Color=(0.95, 0.95, 1), Transmission_Weight=1.0, Roughness=r),
        (0.15, 0.5),
    )


@feature()
def principled_transmission_mix():
    """Half diffuse, half transmission."""
    _glass_stage()
    row(
        lambda w: principled(Base_Color=(0.9, 0.5, 0.3), Transmission_Weight=w, Roughness=0.1),
        (0.3, 0.7),
    )


@feature()
def principled_coat():
    """Clear coat over rough metal and over paint; a tinted coat darkens toward grazing angles."""
    _stage()
    sphere(
        principled(Base_Color=RED, Roughness=0.6, Coat_Weight=1.0, Coat_Roughness=0.03),
        (-1.72, 0, 0.82),
        0.82,
    )
    sphere(
        principled(
            Base_Color=GOLD, Metallic=1.0, Roughness=0.6, Coat_Weight=1.0, Coat_Roughness=0.1, Coat_IOR=1.8
        ),
        (0, 0, 0.82),
        0.82,
    )
    sphere(
        principled(
            Base_Color=CREAM, Roughness=0.5, Coat_Weight=1.0, Coat_Roughness=0.05, Coat_Tint=(1, 0.5, 0.2)
        ),
        (1.72, 0, 0.82),
        0.82,
    )


@feature()
def principled_alpha():
    """Alpha of one half and a cut-out from an image: both show what is behind them."""
    _glass_stage()
    sphere(principled(Base_Color=BLUE, Alpha=0.5, Roughness=0.3), (-1.2, 0, 1.0), 1.0)
    y, x = np.mgrid[0:32, 0:32]
    holes = np.dstack([np.full((32, 32, 3), 0.7), ((x // 8 + y // 8) % 2).astype(float)])
    picture = image("Holes", holes)

    def surface(tree):
        texture = node(tree, "ShaderNodeTexImage", image=picture, interpolation="Closest")
        inputs = {"Base Color": RED, "Alpha": texture.outputs["Alpha"]}
        return node(tree, "ShaderNodeBsdfPrincipled", inputs).outputs[0]

    plane(material("Screen", surface), (1.3, -0.2, 1.0), 1.9, (1.35, 0, 0.25))


@feature()
def principled_emission():
    """Emission colour and strength on top of the surface; it lights the floor."""
    _stage()
    sphere(
        principled(Base_Color=CREAM, Emission_Color=(1, 0.4, 0.1), Emission_Strength=1.5), (-1.2, 0, 0.9), 0.9
    )
    cube(
        principled(Base_Color=(0, 0, 0), Roughness=0.2, Emission_Color=(0.1, 0.4, 1), Emission_Strength=3.0),
        (1.3, 0, 0.7),
        1.3,
    )


@feature()
def principled_sheen():
    """Sheen, white and tinted, smooth and rough."""
    _stage()
    dark = (0.08, 0.03, 0.03)
    row(
        lambda s: principled(
            Base_Color=dark, Roughness=0.9, Sheen_Weight=1.0, Sheen_Roughness=s[0], Sheen_Tint=s[1], IOR=1.3
        ),
        ((0.5, (1, 1, 1)), (0.2, (1, 0.5, 0.3)), (0.9, (0.5, 0.7, 1))),
    )


@feature()
def principled_anisotropic():
    """Brushed metal: anisotropy 0.8 with the default and a turned tangent."""
    _stage(key=3.0)
    row(
        lambda r: principled(
            Base_Color=(0.8, 0.8, 0.82), Metallic=1.0, Roughness=0.35, Anisotropic=0.8, Anisotropic_Rotation=r
        ),
        (0.0, 0.125, 0.25),
    )


@feature()
def principled_thin_film():
    """Thin film of 300 to 700 nm over a metal and a dielectric."""
    _stage()
    row(
        lambda m: principled(
            Base_Color=(0.7, 0.7, 0.7),
            Metallic=m,
            Roughness=0.15,
            Thin_Film_Thickness=420.0,
            Thin_Film_IOR=1.33,
        ),
        (0.0, 1.0),
    )


def _waves(size=64) -> np.ndarray:
    """A tangent-space normal map of round studs."""
    y, x = (np.mgrid[0:size, 0:size] + 0.5) / size * 4 % 1 - 0.5
    inside = (x**2 + y**2) < 0.16
    nx, ny = np.where(inside, 1.6 * x, 0), np.where(inside, 1.6 * y, 0)
    nz = np.sqrt(1 - nx**2 - ny**2)
    return np.dstack([nx, ny, nz]) * 0.5 + 0.5


@feature()
def principled_normal_map():
    """Tangent-space normal map on a sphere and a tilted plane, at full and half strength."""
    _stage()
    picture = image("Studs", _waves(), "Non-Color")

    def surface(strength):
        def build(tree):
            texture = node(tree, "ShaderNodeTexImage", image=picture)
            bent = node(tree, "ShaderNodeNormalMap", {"Color": texture.outputs[0], "Strength": strength})
            inputs = {"Base Color": SAND, "Roughness": 0.3, "Normal": bent.outputs[0]}
            return node(tree, "ShaderNodeBsdfPrincipled", inputs).outputs[0]

        return material("Studs", build)

    sphere(surface(0.5), (-1.3, 0, 1.0), 1.0)
    plane(surface(1.0), (1.2, 0, 1.1), 2.0, (0.9, 0.1, 0.3))


@feature()
def principled_bump():
    """Bump from a noise texture, outward and inverted."""
    _stage()

    def surface(invert):
        def build(tree):
            noise = node(tree, "ShaderNodeTexNoise", {"Scale": 3.0, "Detail": 1.0})
            bump = node(
                tree, "ShaderNodeBump", {"Height": noise.outputs[0], "Strength": 0.6, "Distance": 0.4}
            )
            bump.invert = invert
            inputs = {"Base Color": SAND, "Roughness": 0.4, "Normal": bump.outputs[0]}
            return node(tree, "ShaderNodeBsdfPrincipled", inputs).outputs[0]

        return material("Bump", build)

    sphere(surface(False), (-1.2, 0, 1.0), 1.0)
    cube(surface(True), (1.2, 0, 0.8))


@feature()
def principled_interreflection():
    """Mirrors that see mirrors: four glossy bounces, then black."""
    _stage(key=3.0)
    mirror = principled(Base_Color=(0.9, 0.9, 0.9), Metallic=1.0, Roughness=0.02)
    plane(mirror, (-1.9, 0.6, 1.2), 2.6, (1.5708, 0, 0.9))
    plane(mirror, (1.9, 0.6, 1.2), 2.6, (1.5708, 0, -0.9))
    monkey(matte(CREAM), (0, -0.4, 0.8), 1.0, 0.0)
    torus(principled(Base_Color=COPPER, Metallic=1.0, Roughness=0.2), (0, -1.6, 0.15), 0.6, 0.12)


@feature()
def principled_subsurface_off():
    """Subsurface weight is the one part of Principled that is left out: at 0 its other inputs must change nothing."""
    _stage()
    row(
        lambda c: principled(
            Base_Color=c, Subsurface_Weight=0.0, Subsurface_Scale=0.5, Subsurface_Radius=(1, 0.5, 0.2)
        ),
        (RED, CREAM, BLUE),
    )
