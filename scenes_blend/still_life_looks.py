"""Materials of the still life, and the images that are packed into it."""

from __future__ import annotations

import numpy as np
from parts import material

# Images, packed


def plate_image(size: int = 512) -> np.ndarray:
    """A blue pattern on white glaze: u around a bowl, v from its foot over the rim to its middle."""
    u, v = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size)
    v = 1 - v
    petals = np.cos(2 * np.pi * 12 * u)
    bands = [
        (np.abs(v - 0.555) < 0.008) | (np.abs(v - 0.300) < 0.007) | (np.abs(v - 0.525) < 0.003),
        np.abs(v - (0.415 + 0.075 * petals)) < 0.007,
        np.abs(v - (0.415 - 0.075 * petals)) < 0.007,
        np.abs(v - 0.415) < 0.045 * np.clip(np.cos(2 * np.pi * 24 * u), 0, 1),
        np.abs(v - 0.800) < 0.02 + 0.02 * petals,
    ]
    ink = np.clip(sum(b.astype(float) for b in bands), 0, 1)
    rng = np.random.default_rng(4)
    shade = 0.8 + 0.2 * rng.random((size // 16, size // 16)).repeat(16, 0).repeat(16, 1)
    white, blue = np.array([0.93, 0.92, 0.88]), np.array([0.10, 0.20, 0.52])
    return white + (ink * shade)[..., None] * (blue - white)


def label_image(width: int = 640, height: int = 420) -> np.ndarray:
    """A bottle's paper label."""
    from PIL import Image, ImageDraw, ImageFont

    picture = Image.new("RGB", (width, height), (232, 222, 196))
    draw = ImageDraw.Draw(picture)
    for inset, line in ((14, 5), (26, 2)):
        draw.rectangle((inset, inset, width - inset, height - inset), outline=(120, 84, 40), width=line)

    def text(y, words, size, color):
        draw.text((width / 2, y), words, fill=color, font=ImageFont.load_default(size), anchor="mm")

    text(92, "CHÂTEAU", 44, (70, 46, 24))
    text(180, "PointMR", 96, (110, 18, 24))
    draw.line((150, 248, width - 150, 248), fill=(120, 84, 40), width=3)
    text(296, "GRAND CRU DES SURFELS", 34, (70, 46, 24))
    text(352, "10   triangles", 38, (70, 46, 24))
    draw.text((276, 330), "15", fill=(70, 46, 24), font=ImageFont.load_default(24), anchor="mm")
    return np.asarray(picture, float) / 255


def linen_image(size: int = 512) -> np.ndarray:
    """A woven cloth with a striped border; it tiles."""
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    rng = np.random.default_rng(9)
    warp, weft = rng.normal(0, 0.035, size)[None, :], rng.normal(0, 0.035, size)[:, None]
    weave = 0.04 * np.where((x // 2 + y // 2) % 2, 1, -1)
    base = np.array([0.86, 0.83, 0.76])
    stripe = np.zeros(size)
    for center, half in ((0.12, 0.035), (0.185, 0.008), (0.055, 0.008)):
        stripe[np.abs(np.arange(size) / size - center) < half] = 1
    across = np.clip(stripe[None, :] * 0.8 + stripe[:, None] * 0.8, 0, 1)
    color = base + across[..., None] * (np.array([0.42, 0.10, 0.10]) - base)
    return color * (1 + warp + weft + weave)[..., None]


# Materials


def glass(name, color=(1, 1, 1), roughness=0.0, ior=1.5, shadow=(0.9, 0.9, 0.9)):
    """Glass that lets tinted light through to shadow rays, as caustics by way of diffuse bounces are left out."""

    def build(n):
        bsdf = n(
            "BsdfPrincipled",
            base_color=color,
            roughness=roughness,
            ior=ior,
            transmission_weight=1.0,
            metallic=0.0,
        )
        clear = n("BsdfTransparent", shadow)
        return n("MixShader", n("LightPath").outputs["Is Shadow Ray"], bsdf, clear)

    return material(name, build)


def wood():
    def build(n):
        at = n("TexCoord").outputs["Object"]
        plank = n(
            "TexBrick",
            vector=at,
            color1=(0, 0, 0),
            color2=(1, 1, 1),
            mortar=(0.5, 0.5, 0.5),
            scale=1.0,
            mortar_size=0.0012,
            mortar_smooth=0.3,
            brick_width=3.1,
            row_height=0.145,
            offset=0.37,
        )
        shift = n("VectorMath", at, n("VectorMath", plank, (7, 3, 5), operation="MULTIPLY"), operation="ADD")
        stretch = n("Mapping", vector=shift, scale=(1.1, 13, 13))
        grain = n("TexNoise", vector=stretch, scale=2.2, detail=6, roughness=0.62, distortion=0.9)
        fibre = n("TexNoise", vector=n("Mapping", vector=shift, scale=(5, 160, 160)), scale=2, detail=3)
        tone = n.math("ADD", n.math("MULTIPLY", grain, 0.75), n.math("MULTIPLY", fibre, 0.25))
        color = n.ramp(
            tone,
            (0.30, (0.028, 0.012, 0.006)),
            (0.46, (0.105, 0.046, 0.019)),
            (0.58, (0.20, 0.094, 0.038)),
            (0.74, (0.30, 0.155, 0.068)),
        )
        color = n.mix(
            n.math("MULTIPLY", plank, 0.35), color, n.mix(1.0, color, (0.62, 0.50, 0.42), "MULTIPLY")
        )
        joint = plank.outputs["Fac"]
        color = n.mix(joint, color, (0.008, 0.004, 0.002))
        height = n.math("SUBTRACT", n.math("MULTIPLY", tone, 0.5), n.math("MULTIPLY", joint, 1.5))
        return {
            "base_color": color,
            "roughness": n("MapRange", tone, 0.3, 0.7, 0.52, 0.30).outputs[0],
            "normal": n("Bump", strength=0.35, distance=0.003, height=height),
        }

    return material("Oak", build, coat_weight=0.25, coat_roughness=0.18)


def wall():
    def build(n):
        at = n("TexCoord").outputs["Object"]
        large = n("TexNoise", vector=at, scale=1.6, detail=5, roughness=0.6)
        fine = n("TexNoise", vector=at, scale=24, detail=5, roughness=0.65)
        tone = n.math("ADD", n.math("MULTIPLY", large, 0.8), n.math("MULTIPLY", fine, 0.2))
        color = n.ramp(
            tone, (0.36, (0.050, 0.046, 0.036)), (0.52, (0.098, 0.088, 0.066)), (0.7, (0.15, 0.13, 0.095))
        )
        return {"base_color": color, "normal": n("Bump", strength=0.3, distance=0.01, height=fine)}

    return material("Plaster", build, roughness=0.9, specular_ior_level=0.2)


def skin(name, stops, scale=3.0, stretch=(1, 1, 0.35), roughness=0.32, dots=None, rough_bump=None):
    """Fruit skin: a colour ramp over noise in the fruit's own box, with pores."""

    def build(n):
        at = n("TexCoord").outputs["Generated"]
        other = n("VectorMath", at, n("Mapping", vector=n("CombineXYZ", n("ObjectInfo").outputs["Random"]),
                  scale=(9, 1, 1)), operation="ADD")  # fmt: skip
        tone = n(
            "TexNoise", vector=n("Mapping", vector=other, scale=stretch), scale=scale, detail=5, roughness=0.6
        )
        color = n.ramp(tone, *stops)
        inputs = {}
        if dots is not None:
            spot = n("TexVoronoi", vector=at, scale=dots[0], feature="F1")
            color = n.mix(n.math("LESS_THAN", spot.outputs["Distance"], 0.16), color, dots[1])
        if rough_bump is not None:
            pores = n("TexVoronoi", vector=at, scale=rough_bump[0], feature="SMOOTH_F1")
            inputs["normal"] = n(
                "Bump", strength=rough_bump[1], distance=0.002, height=pores.outputs["Distance"]
            )
        return inputs | {"base_color": color}

    return material(name, build, roughness=roughness, coat_weight=0.35, coat_roughness=0.12)


def brass():
    def build(n):
        at = n("TexCoord").outputs["Object"]
        worn = n("TexNoise", vector=at, scale=38, detail=5, roughness=0.7)
        return {
            "base_color": n.ramp(worn, (0.35, (0.50, 0.29, 0.10)), (0.6, (0.86, 0.60, 0.25))),
            "roughness": n("MapRange", worn, 0.3, 0.7, 0.34, 0.13).outputs[0],
            "normal": n(
                "Bump", strength=0.06, distance=0.002, height=n("TexNoise", vector=at, scale=9, detail=2)
            ),
        }

    return material("Brass", build, metallic=1.0)
