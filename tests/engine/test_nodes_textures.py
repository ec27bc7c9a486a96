"""Textures: interpolation, wrapping, alpha, the mip pyramid and its use by footprint; colours of spectra."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointmr_engine.scene.errors import SceneError
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.texture import Image
from pointmr_engine.shading.nodes.lights import parse_ies
from pointmr_engine.shading.points import SurfacePoints
from pointmr_engine.shading.program import compile_graph
from pointmr_engine.shading.spectra import blackbody_rgb
from pointmr_engine.shading.textures import Texture, texture_of

NO_FOOTPRINT = np.zeros(1, np.float32)


def picture(height=5, width=7, seed=1, **options):
    pixels = np.random.default_rng(seed).random((height, width, 4)).astype(np.float32)
    pixels[..., 3] = 1
    return Image("picture", pixels, **{"colorspace": "Linear", **options})


def test_texel_centres_are_exact_and_between_them_linear():
    image = picture()
    texture = Texture(image)
    v, u = np.meshgrid((np.arange(5) + 0.5) / 5, (np.arange(7) + 0.5) / 7, indexing="ij")
    uv = np.stack([u, v], -1).reshape(-1, 2)
    assert texture.look_up(uv, NO_FOOTPRINT) == pytest.approx(image.pixels.reshape(-1, 4), abs=1e-6)
    middle = texture.look_up(np.array([[1 / 7, 0.5 / 5]]), NO_FOOTPRINT)
    assert middle[0] == pytest.approx((image.pixels[0, 0] + image.pixels[0, 1]) / 2, abs=1e-6)


@pytest.mark.parametrize(
    ("extension", "expected"), [("REPEAT", 6), ("EXTEND", 0), ("MIRROR", 0), ("CLIP", None)]
)
def test_what_lies_beyond_the_edge(extension, expected):
    image = picture()
    found = Texture(image).look_up(np.array([[-0.5 / 7, 0.1]]), NO_FOOTPRINT, extension)[0]
    want = np.zeros(4) if expected is None else image.pixels[0, expected]
    assert found == pytest.approx(want, abs=1e-6)


@given(st.sampled_from(["EXTEND", "CLIP"]), *[st.floats(-2.0, 3.0)] * 2, st.floats(0.5, 30.0), st.booleans())
def test_wide_footprints_know_what_lies_beyond_the_edge(extension, u, v, side, straight):
    """The mean over the footprint: of what is within by coarse levels, and of the edge's texels, or nothing, beyond."""
    pixels = np.full((64, 64, 4), (0.1, 0.8, 0.5, 1.0), np.float32)
    pixels[1:-1, 1:-1, :3] = (0.9, 0.2, 0.1)  # within a border of one texel
    pixels[:, -1, :3] = (0.4, 0.4, 1.0)
    pixels[..., 3] = 1.0 if not straight else 0.25
    texture = Texture(Image("framed", pixels, "Linear", "STRAIGHT" if straight else "NONE"))
    along = (np.arange(200) + 0.5) / 200 - 0.5
    uv = np.stack(np.meshgrid(u + side * along, v + side * along), -1).reshape(-1, 2)
    points = texture.look_up(uv, NO_FOOTPRINT, extension, unassociate=straight).astype(float)
    alpha = points[:, 3:] if straight else np.ones((len(points), 1))
    expected = np.append((points[:, :3] * alpha).sum(0) / max(alpha.sum(), 1e-9), points[:, 3].mean())
    found = texture.look_up(
        np.array([[u, v]]), np.full(1, side, np.float32), extension, unassociate=straight
    )[0]
    if straight:  # colours count by what they cover
        expected[:3] *= expected[3]
        found[:3] *= found[3]
    assert found == pytest.approx(expected, abs=0.1 * (0.25 if straight else 1.0))


def test_closest_takes_one_texel():
    image = picture()
    found = Texture(image).look_up(np.array([[0.99 / 7, 0.01]]), NO_FOOTPRINT, interpolation="Closest")[0]
    assert found == pytest.approx(image.pixels[0, 0])


@pytest.mark.parametrize("interpolation", ["Cubic", "Smart"])
def test_cubic_is_the_uniform_b_spline(interpolation):
    """A lone bright texel spreads as the spline: 2/3 at its centre, 23/48 halfway to the next, 1/6 at the next."""
    pixels = np.zeros((1, 9, 4), np.float32)
    pixels[0, 4] = 1
    u = np.array([4.5, 5.0, 5.5, 6.5]) / 9
    uv = np.stack([u, np.full(4, 0.5)], -1)
    texture = Texture(Image("dot", pixels, "Linear"))
    found = texture.look_up(uv, NO_FOOTPRINT, "REPEAT", interpolation)[:, 3]
    assert found == pytest.approx([2 / 3, 23 / 48, 1 / 6, 0], abs=1e-6)


def test_wide_footprints_average_in_linear_light():
    """A checkerboard of black and white bytes is 50% light from afar, not the 21% that averaged sRGB would give."""
    board = (np.indices((64, 64)).sum(0) % 2 * 255).astype(np.uint8)
    pixels = np.stack([board, board, board, np.full_like(board, 255)], -1)
    texture = Texture(Image("board", pixels, "sRGB"))
    found = texture.look_up(np.array([[0.3, 0.7]]), np.ones(1, np.float32))[0]
    assert found[:3] == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("alpha", [1.0, 0.5])
def test_coarse_levels_are_read_in_linear_light(alpha):
    """Black and white stripes, four texels wide, read at footprints of a stripe: wherever they lie, half is light."""
    pixels = np.zeros((64, 64, 4), np.uint8)
    pixels[:, (np.arange(64) // 4) % 2 == 1, :3] = 255
    pixels[..., 3] = round(255 * alpha)
    texture = Texture(Image("stripes", pixels, "sRGB"))
    uv = np.random.default_rng(3).random((4000, 2)).astype(np.float32)
    found = texture.look_up(uv, np.full(1, 4 / 64, np.float32), unassociate=True)
    assert found[:, :3].std() > 0.1  # that stripes are seen
    assert found[:, :3].mean() == pytest.approx(0.5, abs=0.01)
    assert found[:, 3] == pytest.approx(pixels[0, 0, 3] / 255, abs=1e-3)


@pytest.mark.parametrize("size", [(16, 16), (5, 7), (1, 9), (33, 2)])
def test_pyramid_keeps_the_mean(size):
    image = picture(*size)
    texture = Texture(image)
    assert tuple(texture.pyramid[1][-1, 1:]) == (1, 1)
    found = texture.look_up(np.array([[0.5, 0.5]]), np.full(1, 4.0, np.float32))[0]
    assert found == pytest.approx(image.pixels.mean((0, 1)), abs=1e-5)


def test_large_images_are_halved_in_bands():
    rng = np.random.default_rng(6)
    pixels = rng.integers(0, 256, (600, 4, 4), dtype=np.uint8)
    texture = Texture(Image("tall", pixels, "Linear", "NONE"))
    texels, levels = texture.pyramid
    offset, width, height = levels[1]
    second = texels[offset : offset + 4 * width * height].reshape(height, width, 4)[..., :3]
    mean = pixels.reshape(300, 2, 2, 2, 4).mean((1, 3))[..., :3]
    assert np.abs(second - mean).max() <= 0.5


def test_footprint_blends_between_levels():
    texture = Texture(picture(64, 64))
    uv = np.random.default_rng(2).random((200, 2)).astype(np.float32)
    spread = [
        texture.look_up(uv, np.full(1, w, np.float32)).std(0)[:3].mean()
        for w in (0, 1 / 64, 1 / 24, 1 / 8, 1)
    ]
    assert all(a >= b for a, b in zip(spread, spread[1:], strict=False)) and spread[-1] < 1e-3 < spread[-2]


def test_alpha_modes():
    pixels = np.array([[[200, 100, 50, 128]]], np.uint8)
    uv = np.array([[0.5, 0.5]])

    def look(mode, unassociate):
        image = Image("dot", pixels, "Linear", mode)
        return Texture(image).look_up(uv, NO_FOOTPRINT, unassociate=unassociate)[0] * 255

    assert look("STRAIGHT", True) == pytest.approx([200, 100, 50, 128], abs=2)
    assert look("STRAIGHT", False) == pytest.approx([100, 50, 25, 128], abs=1)
    assert look("CHANNEL_PACKED", False) == pytest.approx([200, 100, 50, 128], abs=1e-3)
    assert look("NONE", True) == pytest.approx([200, 100, 50, 255], abs=1e-3)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("size", [(32, 32), (21, 13)])
def test_no_level_is_brighter_than_the_colour_under_its_alpha(size, dtype):
    """A leaf's image: sRGB, one colour where it is opaque, anything where it is clear. All levels have that colour."""
    rng = np.random.default_rng(3)
    for color in (1.0, 0.5):
        pixels = rng.random((*size, 4)).astype(np.float32)
        pixels[..., 3] = rng.random(size) < 0.3
        pixels[pixels[..., 3] == 1, :3] = color
        alpha = pixels[..., 3].mean()
        if dtype == np.uint8:
            pixels = (pixels * 255 + 0.5).astype(np.uint8)
        texture = Texture(Image("leaf", pixels, "sRGB", alpha="STRAIGHT"))
        levels = len(texture.pyramid[1])
        code = np.rint(255 * color) / 255 if dtype == np.uint8 else color
        expected = 1.0 if color == 1.0 else ((code + 0.055) / 1.055) ** 2.4
        uv = rng.random((300, 2)).astype(np.float32)
        for k in range(1, levels + 1):
            footprint = np.full(1, 2.0**k / np.sqrt(size[0] * size[1]), np.float32)  # of one level alone
            found = texture.look_up(uv, footprint, unassociate=True)
            seen = found[:, 3] > 0.1
            assert found.max() <= 1.0 + 1e-3
            assert texture.look_up(uv, 1.4 * footprint, unassociate=True).max() <= 1.0 + 1e-3
            assert found[seen, :3] == pytest.approx(expected, abs=0.03)
            assert found[:, 3].mean() == pytest.approx(alpha, abs=0.05 if k < 3 else 0.02)
        assert found[:, 3] == pytest.approx(alpha, abs=0.003)


def test_one_pyramid_per_image():
    image = picture()
    assert texture_of(image) is texture_of(image)


def test_bad_images_are_named():
    with pytest.raises(SceneError, match="broken"):
        Image("broken", np.zeros((2, 2, 3), np.float32))
    with pytest.raises(SceneError, match="colour space"):
        Image("odd", np.zeros((2, 2, 4), np.float32), "ACES")


def textured(mapping_scale=None, footprint=0.0):
    nodes = {
        "u": Node("uv_map"),
        "t": Node("image_texture", {"vector": Link("u", "uv")}, {"image": picture(64, 64)}),
    }
    if mapping_scale is not None:
        nodes["m"] = Node("mapping", {"vector": Link("u", "uv"), "scale": (mapping_scale,) * 3})
        nodes["t"].inputs["vector"] = Link("m", "vector")
    nodes["e"] = Node("emission", {"color": Link("t", "color")})
    program = compile_graph(Graph(nodes, surface=Link("e", "emission")))
    uv = np.random.default_rng(4).random((300, 2)).astype(np.float32)
    points = SurfacePoints(300, uvs={"": uv}, uv_footprints={"": np.full(300, footprint, np.float32)})
    assert program.needs == {"uv:", "uv_footprint:"}
    return program.emission(points)


def test_footprints_follow_the_mapping():
    sharp, soft = textured().std(0).mean(), textured(footprint=0.1).std(0).mean()
    assert soft < 0.5 * sharp
    # the same footprint covers ten times fewer texels of a texture that is stretched ten times
    assert textured(0.1, 0.1).std() > 1.2 * textured(1.0, 0.1).std()


def test_footprints_of_any_coordinate_are_differenced():
    nodes = {
        "c": Node("texture_coordinate"),
        "s": Node("math", {"value": Link("x", "x")}, {"operation": "SINE"}),
        "x": Node("separate_xyz", {"vector": Link("c", "object")}),
        "v": Node("combine_xyz", {"x": Link("s", "value"), "y": Link("x", "y")}),
        "t": Node("image_texture", {"vector": Link("v", "vector")}, {"image": picture(64, 64)}),
        "e": Node("emission", {"color": Link("t", "color")}),
    }
    program = compile_graph(Graph(nodes, surface=Link("e", "emission")))
    rng = np.random.default_rng(5)
    local = rng.random((300, 3)).astype(np.float32)
    up = np.tile(np.array([[0, 0, 1]], np.float32), (300, 1))
    spread = []
    for width in (1e-4, 0.3):
        footprint = np.full(300, width, np.float32)
        points = SurfacePoints(300, local=local, position=local, geometric_normal=up, footprint=footprint)
        spread.append(program.emission(points).std())
    assert spread[1] < 0.5 * spread[0]


def test_blackbodies_have_known_colours():
    """CIE: the chromaticity of 6500 K is (0.3135, 0.3237); warm is red, and luminance is 1."""
    rgb = blackbody_rgb(np.array([2000.0, 6500.0, 12000.0]))
    assert rgb @ [0.2126, 0.7152, 0.0722] == pytest.approx(1, abs=2e-3)
    xyz = np.linalg.inv([[3.2404542, -1.5371385, -0.4985314], [-0.969266, 1.8760108, 0.041556],
                         [0.0556434, -0.2040259, 1.0572252]]) @ rgb[1]  # fmt: skip
    assert xyz[:2] / xyz.sum() == pytest.approx([0.3135, 0.3237], abs=1e-3)


IES = """IESNA:LM-63-2002
TILT=NONE
1 1000 1 3 2 1 2 0 0 0
1 1 10
0 90 180
0 180
100 50 0
200 60 0
"""


def test_ies_profiles():
    web = parse_ies(IES)
    assert len(web.horizontal) == 3 and web.horizontal[-1] == pytest.approx(2 * np.pi)
    down, level = web.look_up(np.array([0.0, 0.0]), np.array([1e-6, np.pi / 2]))
    assert down == pytest.approx(2 * level, rel=0.01)
    with pytest.raises(ValueError, match="TILT"):
        parse_ies("not a profile")


@pytest.mark.parametrize("size", [3.0, 1e6])  # the second beyond where coordinates repeat
def test_solid_noise_is_the_same_in_blocks(size):
    from pointmr_engine.shading.kernels.noise import noise_texture, solid_texture
    from pointmr_engine.shading.nodes.noise import _seed_offsets

    points = (np.random.default_rng(2).normal(size=(37, 4)) * size).astype(np.float32)
    points[3] = -2.0
    points[4, 1] = np.nan
    for detail, distortion, normalize in (
        (0.0, 0.0, True),
        (2.0, 0.7, False),
        (3.4, 0.0, True),
        (1.2, 0.3, False),
    ):
        row = np.array([detail, 0.6, 2.3, 0, 1, distortion], np.float32)
        one, blocks = np.empty((2, 37, 3), np.float32)
        noise_texture(points, row[None], _seed_offsets(3), 3, 0, normalize, 3, one)
        solid_texture(points, row, _seed_offsets(3), normalize, 3, np.empty((11, 16)), blocks)
        np.testing.assert_array_equal(one, blocks)
        assert np.isfinite(np.delete(one, 4, 0)).all()
